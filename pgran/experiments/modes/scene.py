"""Scene `modes`: normal modes, all, of an interval, or nearest to a target; or their number."""

import contextlib
import dataclasses
import math
import time

import numpy as np

from pgran.driven import drive as driven
from pgran.errors import InputError
from pgran.experiments.modes import density, levels
from pgran.experiments.modes.record import Modes
from pgran.experiments.modes.shapes import RESIDUAL, participation
from pgran.medium.base import medium
from pgran.medium.units import check_frequency, einstein_frequency
from pgran.run.experiment import Caution, Scene
from pgran.run.interface import in_parallel
from pgran.run.keys import with_solver
from pgran.run.keywords import PROGRESS, Window, call, option, options_of
from pgran.run.machine import check_memory
from pgran.run.numbers import numbers
from pgran.run.options import INTEGER, REAL, Option, alternatives, check_ends
from pgran.run.task import Task, carry_out
from pgran.store.estimate import counted
from pgran.store.si import SI

TARGET = Option("modes_target", REAL, None, "the modes nearest to this frequency", "angular", low=0)
REGIMES = ("below .3", 0.0, 0.3), ("from .3 to 1", 0.3, 1.0), ("above 1", 1.0, math.inf)
# A frequency smaller than this part of what the stiffest bonds make is a zero mode's, but for
# rounding; omega_mx may be any number that the user gives.
ZERO = 1e-6


def check(values, given):
    """Raise where options contradict each other. Not collective."""
    density.check(values, given)
    check_modes(values, given)
    if values["modes_count"] is not None and values["modes_target"] is None:
        raise InputError("-modes_count: -modes_target must say where")


def check_modes(values, given):
    """Raise where the options that choose modes contradict each other. Not collective."""
    alternatives(
        ("modes_omega_min", "modes_omega_max"), ("modes_target", "modes_count"), values, given
    )
    low, high, target, count = (
        values[f"modes_{name}"] for name in ("omega_min", "omega_max", "target", "count")
    )
    if (low is None) != (high is None):
        raise InputError("-modes_omega_min and -modes_omega_max belong together: give both")
    check_ends("modes_omega", values)
    if target is not None and count is None:
        raise InputError("-modes_target: -modes_count must say how many modes")


def chosen(options):
    """Return which modes the options ask for, as `find_modes` takes it. Not collective."""
    if options.modes_omega_min is not None:
        return {"interval": (options.modes_omega_min, options.modes_omega_max)}
    if options.modes_target is not None:
        return {"targets": [options.modes_target], "count": options.modes_count}
    return {}


def summary(result):
    """Return in words what a run found. Not collective."""
    if hasattr(result, "density"):
        yield from density.summary(result)
        return
    modes, si = result.modes, SI.of(result)
    yield f"{counted(len(modes.omega), 'mode')} in {modes.solve_seconds:.2f} s"
    yield certificate(modes)
    if len(modes.omega):
        ends = modes.omega[0], modes.omega[-1]
        yield "omega from {:.6g} to {:.6g}".format(*ends) + si.say("Hz", *ends)
        unstable = np.count_nonzero(modes.omega < 0)
        if unstable:
            yield Caution(
                f"UNSTABLE: {unstable} modes have omega^2 < 0, given as a negative omega; the "
                "network leaves these positions at a rate of |omega|"
            )
        yield f"residuals at most {modes.residual.max():.1e} of |K|"
        yield (
            f"participation from {modes.participation.min():.3g} to "
            f"{modes.participation.max():.3g} balls"
        )
        yield from spacings([modes.omega], result.medium.omega_mx)


def spacings(spectra, unit):
    """Yield in words how the modes of samples keep apart, in three ranges of frequencies.

    Not collective. Nothing of ranges with too few modes, or where three of them coincide.

    Parameters
    ----------
    spectra : sequence of numpy.ndarray
        All frequencies of each sample, or those of an interval.
    unit : float
        Their unit, omega_mx.
    """
    said = []
    for name, *ends in REGIMES:
        with contextlib.suppress(InputError):
            found = levels.spacing_ratio(spectra, [end * unit for end in ends])
            said.append(f"{found.value:.3f} +- {found.error:.3f} {name}")
    if said:
        yield (
            f"mean ratio of neighbouring spacings {', '.join(said)} omega_mx (extended modes "
            f"{levels.GOE_SPACING_RATIO:.3f}, localized ones {levels.POISSON_SPACING_RATIO:.3f})"
        )


def certificate(record):
    """Return in words whether all modes were found. Not collective."""
    if record.count_certified:
        return f"all {record.count_expected} modes found, certified by their count"
    found = record.count_found
    if found != record.count_expected:
        return Caution(f"NOT ALL MODES: {found} found where there are {record.count_expected}")
    return Caution(
        f"NOT CERTIFIED: the residuals of some of the {found} modes are above {RESIDUAL:g}"
    )


def targets_of(targets):
    """Return the targets that were handed in, one at least. Not collective."""
    targets = numbers("-modes_target", targets)
    if targets.ndim != 1 or not len(targets):
        raise InputError("-modes_target: a list of one target or more is needed")
    return list(map(TARGET.check, targets))


@in_parallel("modes", lattice=medium, targets=targets_of)
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
    targets=None,
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
    crew : pgran.run.crew.Crew, optional
        All ranks unless given; of groups of one rank.
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
        driven.warn_above_modes(lattice, crew.world, interval[0])
    lattice, _ = dataclasses.replace(lattice, damping=0.0).in_own_unit()
    check_frequency(lattice, max(targets if targets is not None else interval or (0.0,)))
    from pgran.experiments.modes.slicing import find_slices, hermitian_operators

    with hermitian_operators(lattice) as operators:
        slices = find_slices(operators, crew, interval, targets, count)
        task = Slices(operators, slices, shapes, targets, count)
        modes = carry_out(task, crew, progress)
    seconds = time.perf_counter() - started  # counts included
    return modes and dataclasses.replace(modes, solve_seconds=seconds)


class Slices(Task):
    """The modes of some slices of the spectrum, each certified by its count.

    Parameters
    ----------
    operators : pgran.driven.operators.Operators
        Of this rank alone, K flagged symmetric and Hermitian.
    slices : sequence of (low, high, count)
        Ends in lambda = m omega^2, and how many modes lie between them.
    shapes : bool
        Keep the shapes.
    targets, count
        As in `find_modes`.
    """

    items = "modes"

    def __init__(self, operators, slices, shapes=False, targets=None, count=None):
        """Say what a mode travels in."""
        self.operators, self.shapes = operators, shapes
        self.lattice = lattice = operators.lattice
        self.targets, self.count = targets, count
        self.units = list(enumerate(slices))
        numbers = [("slice", int), ("value", float), ("residual", float), ("participation", float)]
        self.row = np.dtype(numbers + ([("vector", float, lattice.shape)] if shapes else []))
        self.expected = sum(map(self.length, self.units))
        check_memory("output_fields", self.expected * self.row.itemsize)

    @contextlib.contextmanager
    def open(self, group):
        """See `Task`."""
        from pgran.experiments.modes.normal import ModeSolver

        with ModeSolver(self.operators) as solver:

            def work(unit):
                number, piece = unit
                values, vectors, missed = solver.solve(*piece)
                rows = np.zeros(len(values), self.row)
                rows["slice"] = number
                rows["value"] = values
                rows["residual"] = missed
                rows["participation"] = participation(self.lattice, vectors)
                if self.shapes:
                    rows["vector"] = vectors
                return rows

            yield work

    def length(self, unit):
        """See `Task`."""
        _, (_, _, count) = unit
        return count

    def collect(self, rows, seconds):
        """See `Task`; modes that no target asks for are left out."""
        sizes = [self.length(unit) for unit in self.units]
        found = np.bincount(rows["slice"], minlength=len(sizes))
        certified = np.array_equal(found, sizes) and bool(np.all(rows["residual"] <= RESIDUAL))
        rows = rows[np.argsort(rows["value"], kind="stable")]
        squares = rows["value"] / self.lattice.mass
        # zero modes come out as rounding, of either sign; what is below that is unstable
        stiff = einstein_frequency(self.lattice.axes, self.lattice.stiffest, self.lattice.mass)
        unstable = squares < -((ZERO * stiff) ** 2)
        omega = np.sqrt(np.maximum(squares, 0.0))
        omega[unstable] = -np.sqrt(-squares[unstable])
        expected = self.expected
        if self.targets is not None:
            wanted = np.zeros(len(rows), dtype=bool)
            for target in self.targets:
                nearest = np.argsort(np.abs(omega - target), kind="stable")[: self.count]
                wanted[nearest] = True
            expected += int(np.count_nonzero(wanted)) - len(rows)
            rows, omega = rows[wanted], omega[wanted]
        return Modes(
            count_expected=expected,
            count_certified=certified,
            solve_seconds=seconds,
            omega=omega,
            residual=rows["residual"],
            participation=rows["participation"],
            vector=rows["vector"] if self.shapes else None,
        )


def run(lattice, options, crew):
    """Return the modes, or their numbers; see `pgran.run.experiment.Scene`."""
    if options.modes_density:
        omegas = density.frequencies(options, lattice)
        counts = call(density.count_modes, options, crew, lattice, omegas)
        return counts and [counts]
    modes = call(find_modes, options, crew, lattice, **chosen(options))
    return modes and [modes]


WHICH = (*options_of(find_modes)[:2], TARGET, options_of(find_modes)[2])
SCENE = Scene(
    options=(*WHICH, density.DENSITY, *options_of(find_modes)),
    run=run,
    summary=summary,
    check=check,
)
