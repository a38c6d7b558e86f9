"""Scene `modes`: normal or damped modes, or how many lie below each of some frequencies.

There are four ways to modes, of which `route` chooses one:

| | normal modes, K f = m omega^2 f | damped modes, S(s) x = 0 |
|---|---|---|
| `eps` | slices of the spectrum, an EPS search each (`slices`, `normal`) | a PEP near a target |
| `dense` | the whole spectrum by LAPACK (`dense`) | all by LAPACK (both in `damped`) |
"""

import contextlib
import dataclasses
import math
import time
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pgran.errors import InputError
from pgran.experiments.modes.density_options import BY_MOMENTS, DENSITY
from pgran.experiments.modes.record import DampedModes, Modes, exactness
from pgran.experiments.modes.shapes import RESIDUAL, Resonances, least_frequency, participation
from pgran.medium.base import EPSILON, Medium, check_frequency, medium, warn_above_modes
from pgran.run.agreement import on_root
from pgran.run.crew import Crew
from pgran.run.experiment import (
    PROGRESS,
    Asked,
    Caution,
    Scene,
    call,
    in_parallel,
    option,
    options_of,
    window,
)
from pgran.run.machine import check_memory
from pgran.run.options import INTEGER, INTEGERS, REAL, REALS, alternatives, check_ends
from pgran.run.task import Task, carry_out
from pgran.store.estimate import counted
from pgran.store.record import ball_names, columns_of, row_of
from pgran.store.si import SI

MARGIN = 1.01  # covers the rounding of bounds
TRIED = 600  # unknowns of a whole spectrum that a dry run computes
SMALL = 200  # unknowns up to which LAPACK has all damped modes sooner than a search has some
LOUDEST = 3  # modes that a summary names
# How strongly the drive makes each mode resound there.
SITES = option(
    None, "balls for which the modes' residues are computed, indices from 0",
    key="modes_detectors", kind=INTEGERS, low=0, high=2**63 - 1,
)  # fmt: skip
DETECTORS = Asked((SITES,), SITES.of_run)


@in_parallel("modes", lattice=medium, detectors=DETECTORS)
def find_modes(
    lattice: Medium,
    crew: Crew | None = None,
    *,
    interval: tuple[float, float] | None = window(
        option(
            None, "lower end of the interval of modes", "angular", key="modes_omega_min", kind=REAL,
            low=0,
        ),
        option(
            None, "upper end of the interval of modes", "angular", key="modes_omega_max", kind=REAL,
            above=0,
        ),
    ),
    targets: "ArrayLike | None" = option(
        None, "find modes nearest to these frequencies", "angular", key="modes_target", kind=REALS,
        low=0,
    ),
    count: int | None = option(
        None,
        "how many modes nearest to a target; of a projection without one, to each frequency",
        kind=INTEGER, low=1,
    ),
    method: str = option(
        "auto",
        "eps, slices of the spectrum by SLEPc, certified by counts; dense, the whole spectrum by "
        "LAPACK, proven by residuals; auto, eps for lattices, what is faster for networks",
        choices=("auto", "eps", "dense"),
    ),
    damped: bool = option(
        False,
        "find damped modes, S(s) x = 0, with frequencies and widths: all by LAPACK, or those "
        "nearest to i times -modes_target by SLEPc's PEP",
    ),
    certificate: str = option(
        "auto",
        "whether no damped mode near a target is missing: counted, by the phase of det S around "
        "them; proven, each mode too, which takes long; none; auto, counted up to 5000 unknowns",
        choices=("auto", "none", "counted", "proven"),
    ),
    detectors: "ArrayLike | None" = None,
    shapes: bool = option(False, "store the shapes of the modes", key="output_fields"),
    progress: str = PROGRESS,
) -> Modes | DampedModes | None:  # fmt: skip
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

    Examples
    --------
    >>> lattice = pgran.Lattice.random((6, 5), seed=1)
    >>> modes = pgran.find_modes(lattice, targets=[0.5], count=3)
    >>> modes.omega.round(3)
    array([0.48 , 0.489, 0.523])
    >>> modes.count_certified  # none is missing
    True
    """
    if interval is not None and targets is not None:
        raise InputError("-modes_target: contradicts an interval; give one of them")
    if (targets is None) != (count is None):
        raise InputError("-modes_target and -modes_count belong together: give both")
    started = time.perf_counter()
    if interval is not None:
        warn_above_modes(lattice, crew.world, interval[0])
    resonances = Resonances(lattice, detectors)
    wanted = Wanted(interval, targets, count)
    scaled, _ = lattice.undamped().in_own_unit()
    check_frequency(scaled, max(targets or interval or (0.0,)))
    way = on_root(crew.world, lambda: route(method, scaled, wanted, damped))
    with contextlib.ExitStack() as held:
        if damped:
            from pgran.experiments.modes.damped import DampedSearch

            task = DampedSearch(lattice, resonances, shapes, way, certificate, wanted)
        elif way == "dense":
            from pgran.experiments.modes.dense import DenseSolver, memory

            whole = LeadingBlock(scaled.size)
            task = Whole(DenseSolver(scaled), [whole], resonances, shapes, wanted)
            task.untried = memory(scaled.size) * (scaled.size > TRIED)
        else:
            from mpi4py import MPI

            from pgran.driven.operators import Operators
            from pgran.experiments.modes.normal import ModeSolver
            from pgran.experiments.modes.slices import find_slices

            operators = held.enter_context(Operators(scaled, MPI.COMM_SELF))
            solver = held.enter_context(ModeSolver(operators))
            slices = find_slices(solver, crew, wanted)
            task = Slices(solver, slices, resonances, shapes, wanted)
        modes = carry_out(task, crew, progress)
    seconds = time.perf_counter() - started  # counts included
    return modes and dataclasses.replace(modes, solve_seconds=seconds)


class Wanted(NamedTuple):
    """Which modes are asked for: those of an interval, or near targets, so many each; else all."""

    interval: tuple | None = None
    targets: tuple | None = None
    count: int | None = None

    def number(self, medium):
        """Return how many modes of a medium these are, as if they were spread evenly."""
        if self.targets is not None:
            return min(medium.size, len(self.targets) * self.count)
        top = math.sqrt(medium.stiffness_norm / medium.mass) or 1.0
        low, high = np.clip(np.divide(self.interval or (0.0, top), top), 0.0, 1.0)
        return medium.size * (high - low)

    def among(self, omega, error=0.0):
        """Return which of some modes are wanted; of an interval those that may lie in it."""
        if self.targets is None:
            low, high = self.interval or (0.0, np.inf)
            # from 0 on means from the lowest, unstable ones too
            return ((omega.real + error >= low) | (low == 0)) & (omega.real - error <= high)
        wanted = np.zeros(len(omega), bool)
        for target in self.targets:
            wanted[np.argsort(np.abs(omega - target), kind="stable")[: self.count]] = True
        return wanted


def route(method, medium, wanted, damped):
    """Return `eps` or `dense`, which finds the modes that are wanted of an undamped `medium`.

    By `auto` that is for damped modes a search if there are few of many; for normal ones of a
    lattice slices, whose factors are cheap; for those of a network what is faster, if it fits into
    the memory. Where keys for SLEPc's solvers are set, these search.
    """
    from pgran.run.petsc import PETSc

    asked = bool(PETSc.Options("damped_" if damped else "normal_").getAll())
    if damped:
        near = wanted.targets is not None and len(wanted.targets) == 1
        few = near and 4 * wanted.count < medium.size
        if method == "eps" and not few:
            raise InputError(
                "-modes_method eps: damped modes are searched for near one -modes_target, fewer "
                "than a quarter of the unknowns; -modes_method dense finds all"
            )
        by_search = few and (medium.size > SMALL or asked)
    else:
        by_search = medium.is_grid or asked
        if method == "auto" and not by_search:
            from pgran.experiments.modes import dense

            by_search = not dense.is_faster(medium, wanted.number(medium))
    if method != "auto":
        return method
    return "eps" if by_search else "dense"


class Slices(Task):
    """The modes of slices of the spectrum, which the `solver` finds."""

    items = "modes"

    def __init__(self, solver, slices, resonances, shapes, wanted):
        self.solver, self.lattice, self.resonances = solver, solver.lattice, resonances
        self.wanted = wanted
        self.units = list(enumerate(slices))
        without = resonances.left_out + ("vector",) * (not shapes)
        heard = np.shape(resonances.sites)[:1]
        columns = row_of(Modes, without, balls=self.lattice.shape, detector_number=heard)
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
        # without bounds cuts have left out what is outside of an interval
        wanted = self.wanted.among(omega, np.inf if bound is None else bound)
        omega, rows = omega[wanted], rows[wanted]
        columns = columns_of(Modes, rows)
        return Modes(
            count_expected=len(rows) + missing,
            count_certified=complete and accurate and not math.isinf(radius),
            solve_seconds=seconds,
            omega=omega,
            omega_bound=None if bound is None else bound[wanted],
            detector=self.resonances.sites,
            residue=self.resonances.residues(omega, columns),
            **columns,
        )

    def _root(self, values):
        """Return sqrt(lambda / m), of unstable modes -sqrt(-lambda / m)."""
        return np.sign(values) * np.sqrt(np.abs(values) / self.lattice.mass)


class LeadingBlock(NamedTuple):
    """The first unknowns of a medium, `count` of them; all but in a dry run."""

    count: int


class Whole(Slices):
    """All modes by LAPACK on one rank, proven: one slice holds the whole spectrum."""

    def length(self, unit):
        """See `Task`; a part of a spectrum is as long as its part of the work."""
        n, part = self.lattice.size, unit[1].count
        return n if part == n else n * (part / n) ** 3

    def sample(self, unit):
        """See `Task`: the spectrum of the first unknowns."""
        number, piece = unit
        return number, LeadingBlock(min(piece.count, TRIED))

    def blank(self, unit):
        """See `Task`; modes are spread evenly, for what an interval stores of them."""
        rows = super().blank(unit)
        rows["value"] = self.lattice.stiffness_norm * np.linspace(0.0, 1.0, len(rows)) ** 2
        return rows


def check(values, given):
    """Raise where options contradict each other; counts stand for modes, or the other way round."""
    if values.get("modes_density") is not None:  # an accuracy study has no such option
        chosen = "modes_target", "modes_damped", "modes_count", "modes_method", "modes_detectors"
        alternatives(("modes_density",), chosen, values, given, whole=chosen[:2])
        if values["modes_density"] is not None and values["output_fields"]:
            fields = given["output_fields"]
            if fields.rank >= given["modes_density"].rank:
                raise InputError(
                    f"-output_fields{fields.where}: -modes_density computes no shapes; give one of "
                    "them"
                )
            values["output_fields"] = False
    moot, owner = [option.name for option in BY_MOMENTS.values()], "-modes_density"
    if values.get("modes_density") is not None:
        first, *moot = moot
        moot, owner = moot if values[first] == "count" else [], f"-{first} moments"
    for name in moot:
        if name in given:
            raise InputError(f"-{name}{given[name].where}: belongs to {owner}")
        if name in values:
            values[name] = None
    check_modes(values, given)
    if values["modes_count"] is not None and values["modes_target"] is None:
        raise InputError("-modes_count: -modes_target must say where")


def check_modes(values, given):
    """Raise where the options that choose modes contradict each other."""
    if values.get("modes_certificate") not in (None, "auto") and not values.get("modes_damped"):
        raise InputError("-modes_certificate belongs to -modes_damped")
    interval, nearest = ("modes_omega_min", "modes_omega_max"), ("modes_target", "modes_count")
    alternatives(interval, nearest, values, given)
    if (values["modes_omega_min"] is None) != (values["modes_omega_max"] is None):
        raise InputError("-modes_omega_min and -modes_omega_max belong together: give both")
    check_ends("modes_omega", values)
    if values["modes_target"] is not None and values["modes_count"] is None:
        raise InputError("-modes_target: -modes_count must say how many modes")


def run(lattice, options, crew):
    """Return the modes, or their numbers; see `pgran.run.experiment.Scene`."""
    if options.modes_density:
        from pgran.experiments.modes import density

        omegas = density.frequencies(options, lattice)
        record = call(density.count_modes, options, crew, lattice, omegas)
    else:
        record = call(find_modes, options, crew, lattice)
    return record and [record]


def summary(result):
    """Yield in words what a run found."""
    if hasattr(result, "density"):
        from pgran.experiments.modes import density

        yield from density.summary(result)
    elif hasattr(result, "damped_modes"):
        from pgran.experiments.modes import damped

        yield from damped.summary(result)
    else:
        yield from _normal_modes(result)


def _normal_modes(result):
    """Yield in words which normal modes there are, how they move, and what stands out."""
    from pgran.experiments.modes.levels import spacings

    modes, medium, si = result.modes, result.medium, SI.of(result)
    yield f"{counted(len(modes.omega), 'mode')} in {modes.solve_seconds:.2f} s"
    yield certificate(modes)
    if not len(modes.omega):
        return
    yield f"residuals at most {modes.residual.max():.1e} of |K|"
    moving = modes.moving(medium.built)
    if len(moving.omega) < len(modes.omega):
        yield at_rest(len(modes.omega) - len(moving.omega), medium)
    if not len(moving.omega):
        return
    ends = moving.omega[0], moving.omega[-1]
    yield "omega from {:.6g} to {:.6g}".format(*ends) + si.say("Hz", *ends)
    unstable = np.count_nonzero(modes.omega < 0)
    if unstable:
        yield Caution(
            f"UNSTABLE: {counted(unstable, 'mode')} with omega^2 < 0, given as a negative omega; "
            "the network leaves these positions at a rate of |omega|"
        )
    few, many = moving.participation.min(), moving.participation.max()
    low, high = few / medium.free_balls, many / medium.free_balls
    yield f"participation from {few:.3g} to {many:.3g} balls, {low:.2g} to {high:.2g} of all"
    yield from resonances(moving, si)
    yield from spacings([moving.omega], medium.omega_mx)


def certificate(record):
    """Return in words whether all modes were found."""
    found, expected = record.count_found, record.count_expected
    if record.count_certified:
        return f"all {expected} modes found, {exactness(record)}"
    if found != expected:
        return Caution(f"NOT ALL MODES: {found} found where there are {expected}")
    return Caution(
        f"NOT CERTIFIED: of {found} modes some have residuals above {RESIDUAL:g} or overlap"
    )


def at_rest(count, medium):
    """Return in words what modes of omega = 0 are."""
    whole, loose = 0, "balls that no spring connects with a wall"
    if medium.group == "network":
        whole = 0 if np.any(medium.held[medium.bond]) else medium.built.axes
        loose = "balls that are loose or turn freely (-network_rattlers remove holds rattlers)"
    parts = [f"{whole} translations of the whole, which nothing holds"] * (whole > 0)
    parts += [loose] * (count > whole)
    return f"{counted(count, 'mode')} at rest, left out of what follows: {' and '.join(parts)}"


def resonances(modes, si):
    """Yield in words how wide the moving modes of a record are, and which of them sound loudest."""
    sharp = None if modes.width is None else modes.quality[modes.omega > 0]
    if sharp is None or not np.isfinite(sharp).any():
        return
    yield f"quality omega / width: median {np.median(sharp):.3g}, {sharp.min():.3g} at least"
    for d, ball in enumerate([] if modes.residue is None else ball_names(modes.detector)):
        peaks = np.nan_to_num(modes.peak[:, d])
        loudest = [f"{modes.omega[n]:.6g}{si.say('Hz', modes.omega[n])} with |A| = {peaks[n]:.3g}"
                   for n in np.argsort(-peaks)[:LOUDEST]]  # fmt: skip
        yield f"{ball}: the strongest modes, each alone, are at omega = {', '.join(loudest)}"


OPTIONS = (*options_of(find_modes), DENSITY, *BY_MOMENTS.values())
SCENE = Scene(OPTIONS, run, summary, check, function=find_modes)
