"""Scene `relaxation`: the amplitude at the detectors while one bond a step is redrawn."""

import contextlib
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pgran.driven import drive as driven
from pgran.driven.amplitudes import below_relative_accuracy
from pgran.errors import InputError
from pgran.experiments.relaxation import fluctuations
from pgran.experiments.relaxation.record import Relaxation
from pgran.medium.base import Medium, check_frequency, medium
from pgran.medium.law import TRIED, Redraw, check_law, make_law
from pgran.run.agreement import agreeing
from pgran.run.crew import Crew
from pgran.run.experiment import PROGRESS, Asked, Scene, call, in_parallel, option, options_of
from pgran.run.machine import check_memory
from pgran.run.numbers import fingerprint
from pgran.run.options import REAL, Option, check_ends
from pgran.run.task import Task, carry_out
from pgran.store.estimate import counted
from pgran.store.record import columns_of, row_of

OMEGA = Option("relax_omega", REAL, 0.6, "driving frequency", "angular", above=0)
# None draws from the network's own constants.
LAW = Asked((), lambda options, *others: options.bonds_law and make_law(options), check_law)
STEPS_IN_UNIT = 512  # what a group of ranks solves at a stretch, in whole windows


@in_parallel(
    "relax", shares_lattice=True, lattice=medium, detectors=driven.DETECTORS, law=LAW, omega=OMEGA
)
def relax(
    lattice: Medium,
    law: Callable | None,
    omega: float,
    detectors: "ArrayLike",
    crew: Crew | None = None,
    *,
    steps: int = option(20000, "number of steps; each redraws one bond", low=1),
    seed: int = option(1, "seed of the changes", low=0, high=2**63 - 1),
    method: str = option(
        "window",
        "window: many known changes on one factorization; krylov: iterate from the last step; "
        "direct: factor at each step",
        choices=("window", "krylov", "direct"),
    ),
    window: int = option(0, "steps of a window; 0 = what costs least", low=0, high=4096),
    trajectories: int = option(1, "independent trajectories, all from the same bonds", low=1),
    time: float | None = option(
        None, "time of a step: figures and summaries in s and Hz", "s", kind=REAL, above=0
    ),
    error_tolerance: float = driven.STEADY["error_tolerance"],
    error_floor: float = driven.STEADY["error_floor"],
    refresh_iterations: int = driven.STEADY["refresh_iterations"],
    progress: str = PROGRESS,
) -> Relaxation:
    """Redraw one bond a step and solve the steady state each time (paper: section 5, timeres).

    After each step t the amplitudes A of S_t(i omega) A = f_t are those of the bonds as they are
    then, whose changes are drawn by (seed, trajectory, t) alone.

    Parameters
    ----------
    law : callable or None
        Turns an array of numbers uniform on [0, 1) into bond constants, each number by itself, the
        same always and on all ranks; None draws from the present constants.
    omega : float
        Driving frequency, angular.

    Examples
    --------
    >>> lattice = pgran.Lattice.random((6, 5), seed=1)
    >>> found = pgran.relax(lattice, pgran.BondLaw("uniform"), 0.6, [(2, 2)], steps=20)
    >>> found.amplitude.shape  # trajectories, states, detectors
    (1, 21, 1)
    """
    steady = driven.steady(error_tolerance, error_floor, refresh_iterations)
    with agreeing(crew.world) as asked:
        march = March(omega, steps, trajectories, seed, method, window, time)
        task = Steps(lattice, law, detectors, march, steady)
        asked["law"] = fingerprint(task.redraw.law(TRIED))
    driven.check_driven(lattice, crew.world, omega)
    return carry_out(task, crew, progress)


def check(values, given):
    """Raise where options contradict each other."""
    if values["network_file"] is not None and "bonds_law" not in given:
        values["bonds_law"] = None  # the network's own constants
    if values["bonds_law"] == "file":
        raise InputError("-bonds_law file: a relaxation needs a law to draw new constants from")
    if values["bonds_redrawn"] and values["bonds_redrawn_seed"] == values["relax_seed"]:
        raise InputError(
            "-bonds_redrawn: the relaxation would repeat these changes; give -bonds_redrawn_seed"
        )
    check_ends("spectrum_fit", values)
    if values.get("spectrum_fit_min") is not None:  # a study of accuracy has no such window
        fluctuations.check_window(values["spectrum_fit_min"], values["spectrum_fit_max"])


def summary(result):
    """Return in words what a run found."""
    relaxation = result.relaxation
    steps = counted(relaxation.bond_axis.size, "step")
    factorizations = counted(relaxation.factorizations, "factorization")
    yield f"{steps} with {factorizations} in {relaxation.solve_seconds:.2f} s"
    yield from driven.reached_accuracy(relaxation, ~np.isnan(relaxation.displacement).any(axis=2))
    if relaxation.drift > 0:
        line = "largest relative difference between a window's end and the next one's start"
        yield f"{line}: {relaxation.drift:.1e}"
    yield from fluctuations.summary(result)


def run(lattice, options, crew):
    """Return the relaxation, its spectrum and memory; see `pgran.run.experiment.Scene`."""
    import scipy.signal  # noqa: F401 (which spectra take: a missing one is said before the work)

    relaxation = call(relax, options, crew, lattice)
    if relaxation is None or crew.dry:
        return relaxation and [relaxation]
    window = options.spectrum_fit_min, options.spectrum_fit_max
    return fluctuations.measured(relaxation, window, len(lattice.existing))


class March(NamedTuple):
    """How far the bonds change, and how their states are solved: keywords of `relax`."""

    omega: float
    steps: int
    trajectories: int
    seed: int
    method: str
    window: int
    time: float | None


class Steps(Task):
    """The states of all trajectories, some steps of one trajectory at a time."""

    items = "states"

    def __init__(self, lattice, law, detectors, march, steady):
        self.lattice, self.march, self.steady = lattice, march, steady
        self.redraw = Redraw(lattice, law, march.seed)
        self.sites = lattice.sites(detectors)
        # Measured: the factorization's price a step falls like 1/s, that of the algebra grows
        # like s^2.
        self.window = march.window or (64 if lattice.size < 5000 else 128)
        self.scaled, self.unit = lattice.in_own_unit()
        check_frequency(self.scaled, march.omega)
        # A row is one state of one trajectory: its arrays have the axis of detectors alone.
        states = row_of(Relaxation, state=(), detector_number=(len(self.sites),))
        self.row = np.dtype([*states, ("drift", float), ("factorizations", np.int64)])
        count = march.trajectories * (march.steps + 1)
        check_memory("relax_steps", count * self.row.itemsize)
        length = max(1, STEPS_IN_UNIT // self.window) * self.window
        self.units = [
            (trajectory, first, min(length, march.steps - first))
            for trajectory in range(march.trajectories)
            for first in range(0, march.steps, length)
        ]

    @contextlib.contextmanager
    def open(self, group):
        """See `Task`."""
        from pgran.driven.operators import Operators
        from pgran.driven.steady import SteadySolver
        from pgran.experiments.relaxation.windows import BondExchange, states_along

        march, draw = self.march, partial(self.redraw, unit=self.unit)
        with (
            Operators(self.scaled, group) as operators,
            SteadySolver(operators, self.sites, **self.steady) as solver,
        ):
            exchange = BondExchange(self.scaled, operators, draw)

            def work(unit):
                trajectory, first, count = unit
                before, changes = solver.factorizations, draw(*unit)
                exchange.move_to(trajectory, first)
                solver.restart()
                states = states_along(
                    exchange, solver, 1j * march.omega, changes, march.method, self.window
                )
                rows = np.zeros(count + 1, self.row)
                rows["displacement"], rows["error_bound"], rows["drift"] = states
                rows[-1]["factorizations"] = solver.factorizations - before
                # The last state of a unit is the first one of the next, and counts once.
                return rows[int(first > 0) :]

            yield work

    def length(self, unit):
        """See `Task`."""
        _, first, count = unit
        return count + (first == 0)

    def sample(self, unit):
        """See `Task`."""
        trajectory, first, count = unit
        most = 4 * self.window if self.march.method == "window" else 32
        return trajectory, first, min(count, most)

    def collect(self, rows, seconds):
        """See `Task`."""
        march = self.march
        changes = [self.redraw(number, 0, march.steps) for number in range(march.trajectories)]
        axis, index = self.lattice.bond_places(np.stack([c.bond for c in changes]))
        states = columns_of(Relaxation, rows.reshape(march.trajectories, march.steps + 1))
        amplitudes = states["error_bound"], states["displacement"]
        return Relaxation(
            omega=march.omega,
            factorizations=int(rows["factorizations"].sum()),
            solve_seconds=seconds,
            drift=float(rows["drift"].max()),
            step=march.time,
            bond_axis=axis,
            bond_index=index,
            stiffness=np.stack([c.stiffness for c in changes]),
            detector=self.sites,
            at_floor=below_relative_accuracy(*amplitudes, self.steady["error_tolerance"]),
            **states,
        )


OPTIONS = (*options_of(relax), *fluctuations.SPECTRUM)
SCENE = Scene(OPTIONS, run, summary, check, draws=True, shares_lattice=True, function=relax)
