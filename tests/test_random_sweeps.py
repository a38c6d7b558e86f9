"""Sweeps of random lattices of many kinds, against elimination with as many digits as it takes.

    python tests/test_random_sweeps.py FIRST LAST

takes other cases and prints what it finds.
"""

import logging
import math
import sys
from dataclasses import dataclass

import mpmath
import numpy as np
from mpi4py import MPI
from mpmath import mp, mpf
from reference import Reference, exact_amplitudes
from samples import HAS_KLU, bond_arrays, option_values

from pgran.errors import InputError
from pgran.parallel.crew import Crew
from pgran.physics.lattice import Lattice
from pgran.scenes.response import sweep
from pgran.solve.database import holding

SHAPES = [
    *[(1,), (2,), (17,), (60,), (90,), (1, 6), (6, 1), (3, 1), (4, 5), (7, 8), (20, 2)],
    *[(2, 2, 2), (2, 3, 2), (4, 3, 5)],
]
LAWS = ("uniform", "loguniform", "bimodal", "with zeros", "constant")
FEW = "-steady_ksp_max_it 200"
SOLVERS = {
    "default": "",
    "ilu": f"-steady_pc_type ilu {FEW}",
    "icc": f"-steady_pc_type icc {FEW}",
    "preonly, ilu": "-steady_ksp_type preonly -steady_pc_type ilu",
    "preonly, lu": "-steady_ksp_type preonly -steady_pc_type lu",
    "mumps": "-steady_pc_factor_mat_solver_type mumps",
    "superlu_dist": "-steady_pc_type lu -steady_pc_factor_mat_solver_type superlu_dist",
    "gmres, jacobi": f"-steady_ksp_type gmres -steady_pc_type jacobi -steady_ksp_rtol 1e-3 {FEW}",
    # solves with the conjugate matrix
    "preonly, klu": "-steady_ksp_type preonly -steady_pc_type lu "
    "-steady_pc_factor_mat_solver_type klu",
}


@dataclass(frozen=True)
class Case:
    """A lattice, how it is driven and solved, and with how many digits it is eliminated."""

    seed: int
    lattice: Lattice
    omegas: np.ndarray
    sites: np.ndarray
    solver: str
    tolerance: float
    floor: float
    digits: int


@dataclass(frozen=True)
class Point:
    """One amplitude: what it is, how wrong, what is said of it."""

    case: Case
    omega: float
    size: float
    error: float
    bound: float
    good: bool
    broken: bool
    wrong: bool

    def __str__(self):
        """Say what it takes to see the point again."""
        case = self.case
        return (
            f"case {case.seed}, {case.lattice.shape}, {case.solver}, omega {self.omega:.17g}: "
            f"|A| {self.size:.1e}, error {self.error:.1e}, bound {self.bound:.1e}, asked "
            f"{case.tolerance:.0e}{', good' if self.good else ''}"
        )


def random_case(seed):
    """Constants over up to 300 orders of magnitude, any damping or none, also on eigenvalues."""
    rng = np.random.default_rng([11, seed])
    shape = SHAPES[rng.integers(len(SHAPES))]
    orders = rng.uniform(0, 300) if rng.random() < 0.4 else rng.uniform(0, 14)
    unit = 10 ** rng.uniform(-200, 200) if rng.random() < 0.2 else 0.25
    law = LAWS[rng.integers(len(LAWS))]
    draw = {
        "uniform": lambda size: rng.uniform(0, 1, size),
        "loguniform": lambda size: 10 ** -(orders * rng.uniform(0, 1, size)),
        "bimodal": lambda size: rng.choice([10**-orders, 1.0], size, p=[0.4, 0.6]),
        "with zeros": lambda size: rng.choice([0.0, 1.0], size, p=[0.3, 0.7]),
        "constant": lambda size: np.ones(size),
    }[law]
    stiffness = bond_arrays(shape, draw)
    mass = 10 ** rng.uniform(-3, 3)
    damping = 0.0 if rng.random() < 0.4 else math.sqrt(mass) * 10 ** rng.uniform(-10, 1)
    einstein = math.sqrt(2 * len(shape) / mass)
    omegas = list(einstein * 10 ** rng.uniform(-3, 0.7, rng.integers(1, 5)))
    if rng.random() < 0.3:
        eigenvalues = Reference(stiffness).eigenvalues()
        chosen = rng.choice(eigenvalues, min(2, len(eigenvalues)), replace=False)
        omegas += list(np.sqrt(np.maximum(chosen, 1e-300) / mass))
    if law == "constant":  # where every diagonal entry of S vanishes: often an eigenvalue exactly
        omegas.append(einstein)
    return Case(
        seed,
        Lattice(tuple(unit * k for k in stiffness), unit * mass, unit * damping, kmax=unit),
        np.unique(omegas),
        np.array([[rng.integers(n) for n in shape] for _ in range(rng.integers(1, 3))]),
        [name for name in SOLVERS if HAS_KLU or "klu" not in name][
            rng.integers(len(SOLVERS) - (not HAS_KLU))
        ],
        10 ** rng.uniform(-12, -1),
        (1e-20, 0.0)[rng.integers(2)],
        60 + math.ceil(1.1 * orders),
    )


def swept(case, omegas):
    """The response, on this rank alone; every frequency is a unit of its own."""
    asked = {"error_tolerance": case.tolerance, "error_floor": case.floor}
    with holding(option_values(SOLVERS[case.solver])), Crew(MPI.COMM_SELF, 1) as crew:
        return sweep(case.lattice, omegas, case.sites, crew, **asked)


def points(case):
    """Solve a case; yield what came out at each frequency and ball."""
    found, lattice = swept(case, case.omegas), case.lattice
    for n, omega in enumerate(case.omegas):
        good = bool(found.converged_reason[n] > 0)
        with mp.workdps(case.digits):
            constants = lattice.stiffness, lattice.mass, lattice.damping
            exact = exact_amplitudes(*constants, omega, case.sites)
            for value, said, x in zip(
                found.displacement[n], found.error_bound[n], exact, strict=True
            ):
                value, bound, finite = complex(value), float(said), bool(mpmath.isfinite(x))
                error = abs(mpmath.mpmathify(value) - x) if finite else mp.inf
                broken = math.isfinite(bound) and not error <= mpf(bound)
                wrong = good and not error <= max(case.tolerance * abs(x), case.floor)
                yield Point(
                    *(case, omega, float(abs(x)), float(error), bound, good, broken, bool(wrong))
                )


def differing(case):
    """The frequencies that come out otherwise when they are solved alone, in whatever digit."""
    together = swept(case, case.omegas)
    for n, omega in enumerate(case.omegas):
        alone = swept(case, case.omegas[n : n + 1])
        good = together.converged_reason[n] > 0
        same = (alone.converged_reason[0] > 0) == good
        if good:
            same &= np.array_equal(alone.displacement[0], together.displacement[n])
            same &= np.array_equal(alone.error_bound[0], together.error_bound[n])
        if not same:
            yield omega


def test_sweeps_of_all_kinds(world):
    """No bound is broken, nothing wrong passes, and no frequency depends on the others."""
    mine = [random_case(seed) for seed in range(world.rank, 90, world.size)]
    found = [point for case in mine for point in points(case)]
    assert [str(point) for point in found if point.broken or point.wrong] == []
    assert [(case.seed, omega) for case in mine[::3] for omega in differing(case)] == []
    good = world.allreduce(sum(point.good for point in found))
    assert good > 0.6 * world.allreduce(len(found))


def report(first, last):
    """Print what a campaign finds."""
    logging.disable()  # what PETSc fails at
    count, good, undamped, refused, ratios, others = 0, 0, 0, 0, [], []
    for seed in range(first, last):
        case = random_case(seed)
        try:
            others += [(seed, omega) for omega in differing(case)]
        except InputError:  # numbers too far apart for doubles
            refused += 1
            continue
        for point in points(case):
            count, good = count + 1, good + point.good
            undamped += case.lattice.damping == 0
            if point.broken or point.wrong:
                print("BROKEN" if point.broken else "WRONG", point, flush=True)
            if point.good and point.error > 1e-13 * point.size > 0:
                ratios.append(point.bound / point.error)
    print(
        f"cases {first} to {last}: {refused} refused; {count} amplitudes, {undamped} of them "
        f"undamped, {good} good; frequencies that differ alone: {others}; where the error is more "
        f"than rounding, bound / error: median {np.median(ratios):.3g}, nine of ten below "
        f"{np.quantile(ratios, 0.9):.3g}",
        flush=True,
    )


if __name__ == "__main__":
    report(int(sys.argv[1]), int(sys.argv[2]))
