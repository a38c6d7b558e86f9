"""Normal modes: all, of an interval, or nearest to targets; proven, or certified by a count."""

import contextlib
import dataclasses
import math
import time

import numpy as np

from pgran.errors import InputError
from pgran.experiments.modes import dense
from pgran.experiments.modes.record import Modes
from pgran.experiments.modes.resonances import Resonances
from pgran.experiments.modes.shapes import RESIDUAL, least_frequency, participation
from pgran.medium.base import EPSILON, check_frequency, medium, warn_above_modes
from pgran.run.agreement import on_root
from pgran.run.experiment import PROGRESS, Asked, in_parallel, option, window
from pgran.run.machine import check_memory
from pgran.run.options import INTEGER, INTEGERS, REAL, REALS
from pgran.run.task import Task, carry_out
from pgran.store.record import columns_of, row_of

MARGIN = 1.01  # covers the rounding of bounds
TRIED = 600  # unknowns of a whole spectrum that a dry run computes
# How strongly the drive makes each mode resound there.
SITES = option(
    None, "balls for which the modes' residues are computed, indices from 0",
    key="modes_detectors", kind=INTEGERS, low=0, high=2**63 - 1,
)  # fmt: skip
DETECTORS = Asked((SITES,), SITES.of_run)


@in_parallel("modes", lattice=medium, detectors=DETECTORS)
def find_modes(
    lattice,
    crew=None,
    *,
    interval=window(
        option(
            None, "lower end of the interval of modes", "angular", key="modes_omega_min", kind=REAL,
            low=0,
        ),
        option(
            None, "upper end of the interval of modes", "angular", key="modes_omega_max", kind=REAL,
            above=0,
        ),
    ),
    targets=option(
        None, "find modes nearest to these frequencies", "angular", key="modes_target", kind=REALS,
        low=0,
    ),
    count=option(
        None,
        "how many modes nearest to a target; of a projection without one, to each frequency",
        kind=INTEGER, low=1,
    ),
    method=option(
        "auto",
        "eps, slices of the spectrum by SLEPc, of networks in real arithmetic first, certified by "
        "counts; dense, the whole spectrum by LAPACK, proven by residuals; auto, eps for lattices, "
        "what is faster for networks",
        choices=("auto", "eps", "dense"),
    ),
    damped=option(
        False,
        "find damped modes, S(s) x = 0, with frequencies and widths: all by LAPACK, or those "
        "nearest to i times -modes_target by SLEPc's PEP",
    ),
    certificate=option(
        "auto",
        "whether no damped mode near a target is missing: counted, by the phase of det S around "
        "them; proven, each mode too, which takes long; none; auto, counted up to 5000 unknowns",
        choices=("auto", "none", "counted", "proven"),
    ),
    detectors=None,
    shapes=option(False, "store the shapes of the modes", key="output_fields"),
    progress=PROGRESS,
):  # fmt: skip
    """Find the normal modes K f = m omega^2 f, all unless an interval or targets are given.

    Collective. By `eps` the spectrum is cut into slices by counts, which every rank makes, and the
    slices are shared out over the ranks; no slice depends on the number of ranks. By `dense` rank 0
    computes the whole spectrum, and all other modes are left out.

    Parameters
    ----------
    interval : tuple of float, optional
        Lowest and highest omega; both ends belong to it.
    targets : sequence of float, optional
        The modes found are those among the `count` nearest to one of these omegas.
    detectors : array_like of int, optional
        Balls for which the residues of modes are computed.

    Returns
    -------
    pgran.results.Modes or None
        With a crew of the caller's None on all ranks but rank 0; `DampedModes` if `damped`.
        `count_certified` is False if modes are missing; it is proven with an `omega_bound`, and
        otherwise rests on counts.

    Raises
    ------
    InputError
        If the interval or the targets are too high to compute with, or a whole spectrum does not
        fit into the memory.
    PgranError
        If the modes cannot be counted, or LAPACK fails.
    """
    if interval is not None and targets is not None:
        raise InputError("-modes_target: contradicts an interval; give one of them")
    if (targets is None) != (count is None):
        raise InputError("-modes_target and -modes_count belong together: give both")
    started = time.perf_counter()
    if interval is not None:
        warn_above_modes(lattice, crew.world, interval[0])
    resonances = Resonances(lattice, detectors)
    wanted = {"interval": interval, "targets": targets, "count": count}
    scaled, _ = lattice.undamped().in_own_unit()
    check_frequency(scaled, max(targets or interval or (0.0,)))
    if damped:
        from pgran.experiments.modes.damped import DampedSearch

        task = DampedSearch(lattice, resonances, shapes, method, certificate, **wanted)
        return carry_out(task, crew, progress)
    method = on_root(crew.world, lambda: dense.method_of(method, scaled, **wanted))
    with contextlib.ExitStack() as held:
        if method == "dense":
            task = Whole(dense.DenseSolver(scaled), resonances, shapes, targets, count, interval)
        else:
            from mpi4py import MPI

            from pgran.driven.operators import Operators
            from pgran.experiments.modes.normal import ModeSolver
            from pgran.experiments.modes.slices import find_slices

            operators = held.enter_context(Operators(scaled, MPI.COMM_SELF))
            solver = held.enter_context(ModeSolver(operators))
            slices = find_slices(solver, crew, **wanted)
            task = Slices(solver, slices, resonances, shapes, targets, count)
        modes = carry_out(task, crew, progress)
    seconds = time.perf_counter() - started  # counts included
    return modes and dataclasses.replace(modes, solve_seconds=seconds)


class Slices(Task):
    """The modes of slices of the spectrum, which the `solver` finds."""

    items = "modes"

    def __init__(self, solver, slices, resonances, shapes, targets, count):
        self.solver, self.lattice, self.resonances = solver, solver.lattice, resonances
        self.targets, self.count = targets, count
        self.units = list(enumerate(slices))
        without = resonances.left_out + ("vector",) * (not shapes)
        heard = np.shape(resonances.sites)[:1]
        lengths = {"balls": self.lattice.shape, "detector_number": heard}
        columns = row_of(Modes, without, **lengths)
        self.row = np.dtype([("slice", int), ("value", float), ("radius", float), *columns])
        self.expected = sum(piece.count for _, piece in self.units)
        check_memory("output_fields", self.expected * self.row.itemsize)

    def work(self, unit, group):
        """See `Task`."""
        number, piece = unit
        values, vectors, residual = self.solver.solve(*piece)
        rows = np.zeros(len(values), self.row)
        rows["slice"] = number
        rows["value"] = values
        rows["radius"] = self.solver.radius
        rows["residual"] = residual
        rows["participation"] = participation(self.lattice, vectors)
        for name, values in self.resonances.of(vectors).items():
            rows[name] = values
        if "vector" in self.row.names:
            rows["vector"] = vectors
        return rows

    def length(self, unit):
        """See `Task`."""
        return unit[1].count

    def collect(self, rows, seconds):
        """See `Task`; modes that are not asked for are left out."""
        sizes = [piece.count for _, piece in self.units]
        complete = np.array_equal(np.bincount(rows["slice"], minlength=len(sizes)), sizes)
        accurate = bool(np.all(rows["residual"] <= RESIDUAL))
        missing = self.expected - len(rows)
        rows = rows[np.argsort(rows["value"], kind="stable")]
        omega, bound = self._root(rows["value"]), None
        # modes at rest come out as rounding, of either sign: only what is below that is unstable
        omega = np.where(omega < -least_frequency(self.lattice), omega, np.maximum(omega, 0.0))
        radius = rows["radius"][0] if len(rows) else math.nan
        if not math.isnan(radius):
            low, high = (self._root(rows["value"] + side * radius) for side in (-1, 1))
            rounding = 4 * EPSILON * np.abs(omega)
            bound = MARGIN * np.maximum(high - omega, omega - low) + rounding
        wanted = self.wanted(omega, bound)
        if not np.all(wanted):
            rows, omega = rows[wanted], omega[wanted]
            bound = bound if bound is None else bound[wanted]
        columns = columns_of(Modes, rows)
        return Modes(
            count_expected=len(rows) + missing,
            count_certified=complete and accurate and not math.isinf(radius),
            solve_seconds=seconds,
            omega=omega,
            omega_bound=bound,
            detector=self.resonances.sites,
            residue=self.resonances.residues(omega, columns),
            **columns,
        )

    def wanted(self, omega, bound):
        """Return which modes are asked for, of those that are found."""
        wanted = np.full(len(omega), self.targets is None)
        for target in self.targets or ():
            wanted[np.argsort(np.abs(omega - target), kind="stable")[: self.count]] = True
        return wanted

    def _root(self, values):
        """Return sqrt(lambda / m), of unstable modes -sqrt(-lambda / m)."""
        return np.sign(values) * np.sqrt(np.abs(values) / self.lattice.mass)


class Whole(Slices):
    """All modes by LAPACK on one rank, proven: one slice holds the whole spectrum.

    Those of an interval are the ones that may lie in it, by their bounds.
    """

    def __init__(self, solver, resonances, shapes, targets, count, interval):
        self.interval, size = interval, solver.lattice.size
        super().__init__(solver, [dense.Part(size)], resonances, shapes, targets, count)
        self.untried = dense.memory(size) * (size > TRIED)

    def length(self, unit):
        """See `Task`; a part of a spectrum is as long as its part of the work."""
        n, part = self.lattice.size, unit[1].count
        return n if part == n else n * (part / n) ** 3

    def sample(self, unit):
        """See `Task`: the spectrum of the first unknowns."""
        number, piece = unit
        return number, dense.Part(min(piece.count, TRIED))

    def blank(self, unit):
        """See `Task`; modes are spread evenly, for what an interval stores of them."""
        rows = super().blank(unit)
        rows["value"] = self.lattice.stiffness_norm * np.linspace(0.0, 1.0, len(rows)) ** 2
        return rows

    def wanted(self, omega, bound):
        """See `Slices`."""
        if self.interval is None:
            return super().wanted(omega, bound)
        low, high = self.interval
        # from 0 on means from the lowest, unstable ones too
        return ((omega + bound >= low) | (low == 0)) & (omega - bound <= high)
