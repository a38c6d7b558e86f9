"""Driven steady states over a sweep of frequencies; a scene says what it keeps of each."""

import contextlib

import numpy as np

from pgran.medium.base import check_frequency
from pgran.run.machine import check_memory
from pgran.run.task import Task

LONGEST_UNIT = 16  # frequencies that share factorizations


class FrequencySweep(Task):
    """Steady states of one lattice, one frequency after the other.

    Frequencies `omegas` (nw,) are angular and increase, `sites` (nd, dim) are the detectors. `kept`
    are the fields of a row, named like those of `SteadyState` where they hold the same; `choices`
    are keywords of `steady.SteadySolver`; `sigma` is the real part of s = sigma + i omega.
    """

    items = "frequencies"
    key = "sweep_points"  # the option that says how many there are

    def __init__(self, lattice, omegas, sites, kept, choices, sigma=0.0):
        self.lattice, self.sites, self.omegas = lattice, sites, np.asarray(omegas)
        self.row, self.choices = np.dtype([*kept, ("factorizations", np.int64)]), choices
        key = "output_fields" if "field" in self.row.names else self.key
        check_memory(key, len(self.omegas) * self.row.itemsize)
        self.s = sigma + 1j * self.omegas
        self.scaled, self.unit = lattice.in_own_unit()
        check_frequency(self.scaled, self.omegas[-1])
        self.units = ranges(len(self.omegas))

    def prepare(self, operators):
        """Make what `keep` needs of the lattice at all frequencies. Collective over a group."""

    def keep(self, point, solver):
        """Put into a row what is wanted besides a `SteadyState`. Collective over a group."""

    def complete(self, points):
        """Put into the rows of a unit what is computed for all of them together."""

    @contextlib.contextmanager
    def open(self, group):
        """See `Task`."""
        from pgran.driven.operators import Operators

        with Operators(self.scaled, group) as operators, self.solver(operators) as solver:
            self.prepare(operators)

            def work(unit):
                solver.restart()
                points = np.zeros(len(unit), self.row)
                for point, s in zip(points, self.s[unit.start : unit.stop], strict=True):
                    before = solver.factorizations
                    self.solve(point, solver, s)
                    point["factorizations"] = solver.factorizations - before
                self.complete(points)
                return points

            yield work

    def solver(self, operators):
        """Return what solves. Collective over a group."""
        from pgran.driven.steady import SteadySolver

        return SteadySolver(operators, self.sites, **self.choices)

    def solve(self, point, solver, s):
        """Solve at an s, and put into a row what is wanted. Collective over a group."""
        state = solver.solve(s)
        for name in set(state._fields) & set(self.row.names):
            point[name] = getattr(state, name)
        self.keep(point, solver)

    def sample(self, unit):
        """See `Task`."""
        return unit[:2]


def ranges(count):
    """Cut a sweep into ranges of frequencies, in the same way for any number of ranks."""
    length = min(LONGEST_UNIT, max(1, count // 64))
    return [range(start, min(start + length, count)) for start in range(0, count, length)]


class PatternSweep(FrequencySweep):
    """What patterns of balls pass on to one another, at one s = sigma + i omega after the other."""

    def compute(self, point, solver, s):
        """Put into a row what is wanted of the solved patterns. Collective over a group."""

    def solver(self, operators):
        """See `FrequencySweep`."""
        from pgran.driven.patterns import PatternSolver

        return PatternSolver(operators, **self.choices)

    def solve(self, point, solver, s):
        """See `FrequencySweep`."""
        solver.solve(s)
        self.compute(point, solver, s)
        point["backward_error"] = solver.backward_error
