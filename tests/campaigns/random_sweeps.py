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
from pgran.run.petsc import holding


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


def points(case, eliminate=exact_amplitudes, stride=1):
    """Solve a case; yield what came out at every ball, and every so many frequencies."""
    found, lattice = response(case, case.omegas), case.lattice
    constants = lattice.stiffness, lattice.mass, lattice.damping
    for n, omega in list(enumerate(case.omegas))[::stride]:
        with mp.workdps(case.digits):
            for d, x in enumerate(eliminate(*constants, omega, case.sites)):
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


def report(title, found):
    """Print what is false of some points, and then a line about all of them."""
    found = list(found)
    for point in found:
        if point.fault:
            print(point)
    undamped = sum(point.case.lattice.damping == 0 for point in found)
    good = [point for point in found if point.good]
    ratios = [p.bound / p.error for p in good if p.error > 1e-13 * p.size > 0]
    half, most = np.quantile(ratios or [np.nan], (0.5, 0.9))
    print(
        f"{title}: {len(found)} amplitudes, {undamped} of them undamped, {len(good)} good, the "
        f"smallest {min(point.size for point in found):.1e}; where the error is more than "
        f"rounding, bound / error: median {half:.3g}, nine of ten below {most:.3g}",
        flush=True,
    )


def main(first, last):
    """Carry out random cases; print what is false."""
    logging.disable()  # what PETSc fails at
    found, refused = [], 0
    for seed in range(first, last):
        case = random_case(seed)
        try:
            for omega in differing(case):
                print(f"case {seed}: omega {omega:.17g} differs alone", flush=True)
        except InputError:  # numbers too far apart for doubles
            refused += 1
            continue
        found += points(case)
    report(f"cases {first} to {last}, {refused} of them refused", found)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
