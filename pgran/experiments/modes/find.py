"""Normal modes: all, of an interval, or nearest to targets, certified by their number."""

import contextlib
import dataclasses
import time

import numpy as np

from pgran.errors import InputError
from pgran.experiments.modes.record import Modes
from pgran.experiments.modes.shapes import RESIDUAL, participation
from pgran.medium.base import medium
from pgran.medium.units import check_frequency, einstein_frequency, warn_above_modes
from pgran.run.interface import in_parallel
from pgran.run.keys import with_solver
from pgran.run.keywords import PROGRESS, Window, option
from pgran.run.machine import check_memory
from pgran.run.options import INTEGER, REAL, REALS
from pgran.run.task import Task, carry_out
from pgran.store.record import columns_of, row_of

# A frequency smaller than this part of what the stiffest bonds make is a zero mode's, but for
# rounding; omega_mx may be any number that the user gives.
ZERO = 1e-6


@in_parallel("modes", lattice=medium)
@with_solver
def find_modes(
    lattice,
    crew=None,
    *,
    interval=Window(
        option(
            None, "interval of modes: its lower end", "angular", key="modes_omega_min", kind=REAL,
            low=0,
        ),
        option(
            None, "interval of modes: its upper end", "angular", key="modes_omega_max", kind=REAL,
            above=0,
        ),
    ),
    targets=option(
        None, "the modes nearest to these frequencies", "angular", key="modes_target", kind=REALS,
        low=0,
    ),
    count=option(
        None,
        "how many nearest modes; a projection without target: nearest to each driving frequency",
        kind=INTEGER, low=1,
    ),
    shapes=option(False, "store the shapes of the modes", key="output_fields"),
    progress=PROGRESS,
):  # fmt: skip
    """Find the normal modes K f = m omega^2 f, all unless an interval or targets are given.

    Collective. The spectrum is cut into slices by counts, which every rank makes, and the slices
    are shared out over the ranks; no slice depends on the number of ranks.

    Parameters
    ----------
    interval : tuple of float, optional
        Lowest and highest omega; both ends belong to it.
    targets : sequence of float, optional
        Modes are wanted that are among the `count` nearest to any of these omegas.

    Returns
    -------
    pgran.results.Modes or None
        With a crew of the caller's None on all ranks but rank 0. `count_certified` is False if
        modes are missing.

    Raises
    ------
    InputError
        If the interval or the targets are too high to compute with.
    PgranError
        If the modes cannot be counted.
    """
    if interval is not None and targets is not None:
        raise InputError("-modes_target: contradicts an interval; give one of them")
    if (targets is None) != (count is None):
        raise InputError("-modes_target and -modes_count belong together: give both")
    started = time.perf_counter()
    if interval is not None:
        warn_above_modes(lattice, crew.world, interval[0])
    lattice, _ = dataclasses.replace(lattice, damping=0.0).in_own_unit()
    check_frequency(lattice, max(targets or interval or (0.0,)))
    from mpi4py import MPI

    from pgran.driven.operators import Operators
    from pgran.experiments.modes.normal import ModeSolver
    from pgran.experiments.modes.slices import find_slices

    with Operators(lattice, MPI.COMM_SELF) as operators, ModeSolver(operators) as solver:
        slices = find_slices(solver, crew, interval, targets, count)
        modes = carry_out(Slices(solver, slices, shapes, targets, count), crew, progress)
    seconds = time.perf_counter() - started  # counts included
    return modes and dataclasses.replace(modes, solve_seconds=seconds)


class Slices(Task):
    """The modes of slices of the spectrum, each certified by its count, on this rank's K."""

    items = "modes"

    def __init__(self, solver, slices, shapes, targets, count):
        """Say what a mode travels in."""
        self.solver, self.lattice = solver, solver.lattice
        self.targets, self.count = targets, count
        self.units = list(enumerate(slices))
        without = () if shapes else ("vector",)
        columns = row_of(Modes, without, balls=self.lattice.shape)
        self.row = np.dtype([("slice", int), ("value", float), *columns])
        self.expected = sum(map(self.length, self.units))
        check_memory("output_fields", self.expected * self.row.itemsize)

    @contextlib.contextmanager
    def open(self, group):
        """See `Task`."""
        yield self._work

    def _work(self, unit):
        """Return the rows of a slice's modes."""
        number, piece = unit
        values, vectors, residual = self.solver.solve(*piece)
        rows = np.zeros(len(values), self.row)
        rows["slice"] = number
        rows["value"] = values
        rows["residual"] = residual
        rows["participation"] = participation(self.lattice, vectors)
        if "vector" in self.row.names:
            rows["vector"] = vectors
        return rows

    def length(self, unit):
        """See `Task`."""
        return unit[1].count

    def collect(self, rows, seconds):
        """See `Task`; modes that no target asks for are left out."""
        sizes = [self.length(unit) for unit in self.units]
        complete = np.array_equal(np.bincount(rows["slice"], minlength=len(sizes)), sizes)
        accurate = bool(np.all(rows["residual"] <= RESIDUAL))
        rows = rows[np.argsort(rows["value"], kind="stable")]
        omega, missing = self._omega(rows["value"]), self.expected - len(rows)
        if self.targets is not None:
            wanted = np.zeros(len(rows), dtype=bool)
            for target in self.targets:
                wanted[np.argsort(np.abs(omega - target), kind="stable")[: self.count]] = True
            rows, omega = rows[wanted], omega[wanted]
        return Modes(
            count_expected=len(rows) + missing,
            count_certified=complete and accurate,
            solve_seconds=seconds,
            omega=omega,
            **columns_of(Modes, rows),
        )

    def _omega(self, values):
        """Return sqrt(lambda / m), of unstable modes -sqrt(-lambda / m).

        Zero modes come out as rounding, of either sign: only what is below that is unstable.
        """
        squares = values / self.lattice.mass
        stiff = einstein_frequency(self.lattice.axes, self.lattice.stiffest, self.lattice.mass)
        unstable = squares < -((ZERO * stiff) ** 2)
        omega = np.sqrt(np.maximum(squares, 0.0))
        omega[unstable] = -np.sqrt(-squares[unstable])
        return omega
