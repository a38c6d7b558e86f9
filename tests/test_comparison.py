"""Bounds ball by ball, the floor of amplitudes, and numbers whose squares vanish."""

import math
import sys
from functools import partial

import numpy as np
import pytest
from mpi4py import MPI
from mpmath import mp
from reference import Reference, exact_amplitudes, refined_field
from samples import bond_arrays, random_lattice, skip_unless_ranks_fit

from pgran.errors import InputError
from pgran.parallel.crew import Crew
from pgran.physics.bondlaw import BondLaw
from pgran.physics.lattice import Lattice
from pgran.results import LatticeRecord, Result
from pgran.scenes.relaxation import relax
from pgran.scenes.response import summary, sweep
from pgran.solve.comparison import Comparison
from pgran.solve.operators import Operators
from pgran.solve.steady import SteadySolver


def swept(lattice, omegas, sites, **more):
    """The response, on this rank alone."""
    with Crew(MPI.COMM_SELF, 1) as crew:
        return sweep(lattice, np.array(omegas), sites, crew, **more)


def exact(lattice, omegas, sites, digits=60):
    """Amplitudes by elimination with many digits, shape (nw, nd)."""
    with mp.workdps(digits):
        return [
            exact_amplitudes(lattice.stiffness, lattice.mass, lattice.damping, omega, sites)
            for omega in omegas
        ]


def errors(response, reference):
    """|A - A~|, in doubles, however small."""
    with mp.workdps(60):
        return np.array(
            [
                [float(abs(mp.mpmathify(complex(a)) - b)) for a, b in zip(*row, strict=True)]
                for row in zip(response.displacement, reference, strict=True)
            ]
        )


@pytest.mark.parametrize("damping", [0.003, 0.0, 1e-9])
@pytest.mark.parametrize(
    ("shape", "site"),
    [((100,), (8,)), ((30, 6), (2, 3)), ((1, 30), (0, 1)), ((12, 3, 2), (0, 1, 1))],
)
def test_tiny_amplitudes_above_the_highest_mode(shape, site, damping):
    """Far below what norms can prove each amplitude has its relative bound."""
    lattice = random_lattice(shape, 5, damping)
    highest = math.sqrt(Reference(lattice.stiffness).eigenvalues()[-1])
    omegas = highest * np.array([1.05, 1.3, 2.0, 6.0])
    found = swept(lattice, omegas, site, error_tolerance=1e-9, error_floor=0.0)
    reference = exact(lattice, omegas, [site])
    wrong = errors(found, reference)
    assert np.all(found.converged_reason > 0)
    assert np.all(wrong <= found.error_bound)
    assert np.all(found.error_bound <= 1e-9 * found.amplitude)
    assert not found.at_floor.any()


@pytest.mark.parametrize("damping", [0.003, 0.0])
def test_no_error_of_the_field_exceeds_its_bound(comm, damping):
    """The vector bounds all balls; inside the band of frequencies there is none."""
    shape = (9, 7)
    skip_unless_ranks_fit(shape, comm)
    lattice = random_lattice(shape, 2, damping)
    reference = Reference(lattice.stiffness, 1.0, damping)
    highest = math.sqrt(reference.eigenvalues()[-1])
    with (
        Operators(lattice, comm) as operators,
        SteadySolver(operators, [[1, 1]], 1e-3) as solver,
        Comparison(operators) as comparison,
    ):
        for omega, known in ((1.2 * highest, True), (0.5 * highest, False), (0.9 * highest, False)):
            solver.solve(omega)
            v = comparison.errors(solver.bounds.residuals(solver.primal), solver.bounds)
            assert (v is not None) == known
            if known:
                bound, field = operators.field(v), operators.field(solver.field)
                if comm.rank == 0:
                    missed = np.abs(field - reference.field(omega))
                    assert np.all(missed <= bound.real)
                    assert np.all(bound.real <= 1e-11 * np.abs(field))


def test_amplitudes_that_vanish_are_not_good(comm):
    """What no double can hold is known to nothing but the floor, however the lattice is shared."""
    lattice = random_lattice((12, 12), 3, damping=0.0)
    for floor in (0.0, 1e-20):
        with (
            Operators(lattice, comm) as operators,
            SteadySolver(operators, [[1, 5]], 1e-4, error_floor=floor) as solver,
        ):
            for omega in (1e15, 1e20):
                state = solver.solve(omega)
                assert (state.converged_reason > 0) == (floor > 0)
                assert not floor or 0 < state.error_bound[0] <= floor


def test_the_floor():
    """Far behind strong damping, inside the band: good with a floor, marked without one."""
    lattice = random_lattice((120,), 4, damping=0.3)
    omegas, site = [0.55, 0.6], (1,)
    without = swept(lattice, omegas, site, error_floor=0.0)
    assert np.all(without.converged_reason <= 0)
    assert not without.at_floor.any()
    found = swept(lattice, omegas, site)
    assert np.all(found.converged_reason > 0)
    assert np.all(found.at_floor == 1)
    assert np.all(found.error_bound <= 1e-20)
    assert np.all(errors(found, exact(lattice, omegas, [site])) <= found.error_bound)
    assert np.isnan(found.phase).all()  # nothing is known of it
    text = "\n".join(summary(Result([LatticeRecord.of(lattice), found])))
    assert "2 of 2 amplitudes are known to -error_floor of the wall's only" in text


def test_the_floor_of_a_relaxation():
    """By every method; and no spectrum is made of what is not known."""
    lattice = random_lattice((120,), 4, damping=0.3)
    for method in ("window", "krylov", "direct"):
        with Crew(MPI.COMM_SELF, 1) as crew:
            arguments = (lattice, BondLaw("uniform"), 0.6, (1,), crew)
            found = relax(*arguments, steps=20, method=method)
            without = relax(*arguments, steps=20, method=method, error_floor=0.0)
        assert np.all(found.at_floor == 1)
        assert found.failures == 0
        assert without.failures == 21


def test_windows_keep_the_relative_accuracy_of_their_start():
    """Above the highest mode, where the bound of a window is about the floor, as elsewhere."""
    lattice = random_lattice((12, 12), 2)
    with Crew(MPI.COMM_SELF, 1) as crew:
        arguments = (lattice, BondLaw("uniform"), 6.0, (1, 5), crew)
        found = relax(*arguments, steps=40)
    assert not found.at_floor.any()
    assert np.all(found.error_bound <= 1e-4 * np.abs(found.displacement))


CASES = [
    # bonds, mass, frequencies, detector
    ("bimodal 6.2e-231 .25", (2, 2, 2), 1.0, [0.0755, 0.5778], (0, 0, 0)),
    ("loguniform 2.34e-208 .25", (3, 1), 1.0, [0.05, 0.1, 0.5], (1, 0)),
    ("loguniform 1e-300 1", (5,), 1.0, [0.05, 0.3, 1.5, 30.0], (1,)),
    ("bimodal 1e-150 1", (4, 3), 1.0, [0.02, 0.4, 1.1], (0, 1)),
    ("uniform 0 1e-250", (4, 3), 1e-250, [0.3, 1.0, 2.9], (1, 1)),
    ("uniform 0 1e-250", (4, 3), 1.0, [3e-126, 1e-125], (1, 1)),
    ("uniform 0 1e250", (4, 3), 1e250, [0.3, 1.0, 2.9], (1, 1)),
]


def draw_bonds(rng, law, low, high, size):
    """Constants over hundreds of orders of magnitude."""
    low, high = float(low), float(high)
    if law == "bimodal":
        return rng.choice([low, high], size)
    if law == "uniform":
        return rng.uniform(low, high, size)
    return high * np.exp(rng.uniform(np.log(low) - np.log(high), 0, size))


@pytest.mark.parametrize("solver", ["", "-steady_pc_type ilu -steady_ksp_type preonly"])
@pytest.mark.parametrize("damping", [0.0, 1e-3])
@pytest.mark.parametrize("case", CASES, ids=lambda case: case[0])
def test_what_vanishes_is_counted(case, damping, solver, solver_options):
    """Constants and amplitudes down to 1e-300: no bound is broken, nothing wrong passes."""
    solver_options(solver)
    law, shape, mass, omegas, site = case
    high, marked = float(law.split()[-1]), []
    for seed in range(6):
        draw = partial(draw_bonds, np.random.default_rng(seed), *law.split())
        beta = damping * math.sqrt(high) * math.sqrt(mass)
        lattice = Lattice(bond_arrays(shape, draw), mass, beta, kmax=high)
        found = swept(lattice, omegas, site)
        reference = exact(lattice, omegas, [site], 700)
        wrong = errors(found, reference)
        good = found.converged_reason > 0
        size = np.array([[float(abs(a)) for a in row] for row in reference])
        known = ~np.isnan(found.error_bound)
        assert np.all(wrong[known] <= found.error_bound[known])
        assert np.all(found.error_bound[good] > 0)
        assert np.all(wrong[good] <= np.maximum(1e-4 * size[good], 1e-20))
        marked.append(~good)
    if not solver:
        assert np.mean(marked) < 0.2


def test_units_that_do_not_fit_together_are_refused():
    """Frequencies are right for a lattice in any units, but doubles end somewhere."""
    stiffness = bond_arrays((3, 2), lambda size: np.full(size, 1e-200))
    with pytest.raises(InputError, match="lattice_mass: 1e\\+200 and bond constants"):
        Lattice(stiffness, 1e200).in_own_unit()
    with pytest.raises(InputError, match="lattice_damping: 1e\\+200 and bond constants"):
        Lattice(stiffness, 1.0, 1e200).in_own_unit()


@pytest.mark.parametrize("scale", [1e-250, 0.3, 1e200])
def test_own_unit(scale):
    """The largest bond constant lies between 1 and 2, and nothing is rounded."""
    lattice = random_lattice((4, 5), 1, 0.01 * scale, scale)
    lattice = Lattice(tuple(scale * k for k in lattice.stiffness), scale, 0.01 * scale)
    own, unit = lattice.in_own_unit()
    assert 1 <= max(k.max() for k in own.stiffness) < 2
    assert own.mass * unit == lattice.mass
    assert own.damping * unit == lattice.damping
    for scaled, k in zip(own.stiffness, lattice.stiffness, strict=True):
        assert np.array_equal(scaled * unit, k)
    assert own.omega_mx == pytest.approx(lattice.omega_mx, rel=1e-14)


def report(shape, site, stride):
    """Print how the default sweep compares with 60 digits at every `stride`-th frequency."""
    lattice = Lattice(BondLaw("uniform").draw(shape, 1993), kmax=0.25)
    found = swept(lattice, np.linspace(0.01, 1.3, 1291), site)
    some = slice(None, None, stride)
    omegas, displacement, bound = (
        values[some] for values in (found.omega, found.displacement[:, 0], found.error_bound[:, 0])
    )
    wrong, size = np.empty((2, len(omegas)))
    with mp.workdps(60):
        for place, (omega, amplitude) in enumerate(zip(omegas, displacement, strict=True)):
            field = refined_field(lattice.stiffness, lattice.mass, lattice.damping, omega)
            wrong[place] = abs(mp.mpmathify(complex(amplitude)) - field[site])
            size[place] = abs(field[site])
    relative = ~(found.at_floor[some, 0] > 0)
    print(
        f"{shape}, ball {site}: {found.failures} of {len(found.omega)} marked, "
        f"{np.count_nonzero(found.at_floor)} at the floor; of {len(omegas)} compared "
        f"{np.count_nonzero(wrong > bound)} bounds are broken; smallest |A| {size.min():.1e}, "
        f"largest relative error {np.max((wrong / size)[relative]):.1e}; "
        f"bound / error: median {np.median(bound / wrong):.3g}",
        flush=True,
    )


if __name__ == "__main__":
    report((31,), (8,), 1)
    report((100,), (8,), 1)
    report((40, 40), (8, 10), int(sys.argv[1]))
    report((60, 60), (8, 10), int(sys.argv[1]))
