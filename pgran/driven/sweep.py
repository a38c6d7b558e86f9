"""Driven steady states over a sweep of frequencies; a scene says what it keeps of each."""

import contextlib

import numpy as np

from pgran.medium.units import check_frequency
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

    def __init__(self, lattice, omegas, sites, kept, choices, sigma=0.0):
        """Cut the sweep into ranges of frequencies."""
        self.lattice, self.sites, self.sigma = lattice, sites, sigma
        self.omegas = np.asarray(omegas)
        self.row, self.choices = np.dtype([*kept, ("factorizations", np.int64)]), choices
        check_memory("sweep_points", len(self.omegas) * self.row.itemsize)
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
        from pgran.driven.judge import SteadyState
        from pgran.driven.operators import Operators
        from pgran.driven.steady import SteadySolver

        same = [name for name in SteadyState._fields if name in self.row.names]
        with (
            Operators(self.scaled, group) as operators,
            SteadySolver(operators, self.sites, **self.choices) as solver,
        ):
            self.prepare(operators)

            def work(unit):
                solver.restart()
                points = np.zeros(len(unit), self.row)
                columns = [(points[name], name) for name in same]
                for n, index in enumerate(unit):
                    before = solver.factorizations
                    state = solver.solve(complex(self.sigma, self.omegas[index]))
                    for column, name in columns:
                        column[n] = getattr(state, name)
                    points["factorizations"][n] = solver.factorizations - before
                    self.keep(points[n], solver)
                self.complete(points)
                return points

            yield work

    def sample(self, unit):
        """See `Task`."""
        return unit[:2]


def ranges(count):
    """Cut a sweep into ranges of frequencies, in the same way for any number of ranks."""
    length = min(LONGEST_UNIT, max(1, count // 64))
    return [range(start, min(start + length, count)) for start in range(0, count, length)]
