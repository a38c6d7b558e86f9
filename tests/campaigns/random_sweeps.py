"""Sweeps of random lattices of many kinds, against elimination with as many digits as it takes.

    python tests/campaigns/random_sweeps.py FIRST LAST

prints what it finds. tests/test_random_sweeps.py is the short version.
"""

import logging
import math
import sys
from dataclasses import dataclass
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1]))

import mpmath
import numpy as np
from mpmath import mp
from reference import exact_amplitudes
from samples import SOLVERS, Case, option_values, random_case, swept

from pgran.errors import InputError
from pgran.solve.database import holding


@dataclass(frozen=True)
class Point:
    """One amplitude: what it is, how wrong, what is said of it."""

    case: Case
    omega: float
    size: float
    error: float
    bound: float
    good: bool

    @property
    def fault(self):
        """What is false of what is said, if anything."""
        if math.isfinite(self.bound) and not self.error <= self.bound:
            return "BROKEN"
        allowed = max(self.case.tolerance * self.size, self.case.floor)
        return "WRONG" if self.good and not self.error <= allowed else ""

    def __str__(self):
        """Say what it takes to see the point again."""
        case = self.case
        return (
            f"{self.fault} case {case.seed}, {case.lattice.shape}, {case.solver}, "
            f"omega {self.omega:.17g}: |A| {self.size:.1e}, error {self.error:.1e}, "
            f"bound {self.bound:.1e}, asked {case.tolerance:.0e}{', good' if self.good else ''}"
        )


def response(case, omegas):
    """What a case's solver finds, on this rank alone; every frequency is a unit of its own."""
    asked = {"error_tolerance": case.tolerance, "error_floor": case.floor}
    with holding(option_values(SOLVERS[case.solver])):
        return swept(case.lattice, omegas, case.sites, **asked)


def points(case):
    """Solve a case; yield what came out at each frequency and ball."""
    found, lattice = response(case, case.omegas), case.lattice
    for n, omega in enumerate(case.omegas):
        with mp.workdps(case.digits):
            constants = lattice.stiffness, lattice.mass, lattice.damping
            exact = exact_amplitudes(*constants, omega, case.sites)
            for d, x in enumerate(exact):
                value = mpmath.mpmathify(complex(found.displacement[n, d]))
                error = abs(value - x) if mpmath.isfinite(x) else mp.inf
                bound, good = float(found.error_bound[n, d]), found.converged_reason[n] > 0
                yield Point(case, omega, float(abs(x)), float(error), bound, bool(good))


def differing(case):
    """The frequencies that come out otherwise when they are solved alone, in whatever digit."""
    together = response(case, case.omegas)
    for n, omega in enumerate(case.omegas):
        alone = response(case, case.omegas[n : n + 1])
        good = together.converged_reason[n] > 0
        same = (alone.converged_reason[0] > 0) == good
        if good:
            same &= np.array_equal(alone.displacement[0], together.displacement[n])
            same &= np.array_equal(alone.error_bound[0], together.error_bound[n])
        if not same:
            yield omega


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
            if point.fault:
                print(point, flush=True)
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
