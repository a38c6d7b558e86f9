"""Scene `pulse`: the wall moves as it likes, and balls are listened to in time."""

import math
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from pgran.driven import drive as driven
from pgran.driven.drive import TOGETHER
from pgran.errors import InputError, log
from pgran.experiments.pulse.laplace import PulseLine
from pgran.experiments.pulse.record import Signals
from pgran.experiments.pulse.signals import Recording, front_speed
from pgran.experiments.pulse.wall import SHAPES, Pulse, Samples
from pgran.medium.base import Medium, medium
from pgran.run.agreement import agreeing, on_root
from pgran.run.crew import Crew
from pgran.run.experiment import (
    PROGRESS,
    Asked,
    Caution,
    Scene,
    in_parallel,
    option,
    options_of,
    run_of,
)
from pgran.run.numbers import numbers
from pgran.run.options import FILE, alternatives
from pgran.run.task import carry_out
from pgran.store.estimate import counted, with_error
from pgran.store.record import ball_names
from pgran.store.si import SI
from pgran.store.text import read_columns

PROVABLE_TOLERANCE = 1e-5  # tolerance below which a series leaves little to be proven
SOON = 0.5  # seconds of factorizations that auto makes without further ado
UNEVENNESS = 0.01  # of a step: how far the times of a motion may be from equal ones
REST_SHARE = 0.01  # of a motion's largest: where it may begin
LARGEST_NUMBER = 1e140  # number of a motion: work takes its square

MOTION = option(
    None,
    "the wall's motion, instead of a shape: a column of displacements at the times that are "
    "recorded, or two columns, times at equal distances and displacements",
    key="pulse_file", kind=FILE,
)  # fmt: skip
WALL = Asked(
    (MOTION,),
    lambda run, world, _: run.pulse_file and on_root(world, lambda: read_columns(run.pulse_file)),
    partial(numbers, "-pulse_file"),
)


@in_parallel("pulse", shares_lattice=True, lattice=medium, detectors=driven.DETECTORS)
def pulse(
    lattice: Medium,
    detectors: "ArrayLike",
    crew: Crew | None = None,
    *,
    shape: str = option(
        "burst",
        "how the wall moves: gauss, a bell; ricker, its second derivative; burst, a bell times a "
        "cosine; step, from 0 to 1",
        choices=SHAPES,
    ),
    omega: float = option(
        0.6, "burst, ricker: where its spectrum is largest", "angular", above=0
    ),
    width: float = option(
        20.0, "standard deviation of the bell; a ricker's follows from omega", "1/frequency",
        above=0,
    ),
    wall: "ArrayLike | None" = WALL,
    time: float = option(600.0, "how long signals are recorded", "1/frequency", above=0),
    points: int = option(1201, "number of times at which signals are recorded", low=2),
    method: str = option(
        "auto",
        "laplace, a factorization for each point of a line; moments, one recurrence, a product of "
        "the matrix a term, without the energy of all balls; auto, what is faster; all with bounds",
        choices=("laplace", "moments", "auto"),
    ),
    fields: bool = option(
        False, "store the displacement of all balls at four times", key="output_fields"
    ),
    error_tolerance: float = driven.STEADY["error_tolerance"],
    progress: str = PROGRESS,
) -> Signals:  # fmt: skip
    """Send a pulse through the lattice, and return the motion of balls.

    m u'' + beta C u' + K u = U f_k + U' beta f_c from rest, U the wall's motion: by the inverse
    Laplace transform of A(s) U(s) along sigma + i omega, S(s) A = f(s) (K. S. Crump, J. ACM 23, 89
    (1976)), each A(s) by a factorization or all by one recurrence.

    Examples
    --------
    >>> lattice = pgran.Lattice.random((6, 5), seed=1)
    >>> found = pgran.pulse(lattice, [(0, 2)], time=300.0, points=301)
    >>> found.displacement.shape, bool(found.error.max() < 1e-4)  # times, detectors
    ((301, 1), True)
    """
    with agreeing(crew.world):
        sent = Pulse(shape, omega, width) if wall is None else samples_of(wall, time / (points - 1))
        recording = Recording(lattice, detectors, sent, time, points, error_tolerance, fields)
        check_times(recording)
    lowest = sent.omega if sent.shape in ("ricker", "burst") else 0.0
    driven.check_driven(lattice, crew.world, lowest, in_time=True)
    if method != "laplace":
        with crew.together(lattice.size > TOGETHER):
            series = series_of(recording, method, crew)
            if series is not None:
                with series:
                    signals = carry_out(series, crew, progress)
        if series is not None:
            # weak signals may have bounds too large for them; a dry run has none
            failed = on_root(crew.world, lambda: 0 if crew.dry else signals.failures)
            if not failed or method == "moments":
                return signals
            missed = counted(failed, "signal")
            if crew.world.rank == 0:
                log.info("moments leave %s less accurate than asked: factored", missed)
    with agreeing(crew.world):
        line = PulseLine(recording)
    return carry_out(line, crew, progress)


def series_of(recording, method, crew):
    """Return the series of a recording, None where auto takes the transform. Collective."""
    if method == "auto":
        with agreeing(crew.world):
            line, medium = PulseLine(recording), recording.lattice
        seconds = len(line.omegas) * medium.elimination.seconds
        if line.keeps_energies or seconds < SOON or recording.tolerance < PROVABLE_TOLERANCE:
            return None
    from pgran.driven.recurrence import NoSeriesError
    from pgran.experiments.pulse.moments import PulseSeries

    try:
        series = PulseSeries(recording, crew.group)
    except NoSeriesError as error:
        if method == "auto":
            return None
        raise InputError(f"-pulse_method moments: no series for {error}; take laplace") from None
    if method == "moments" or series.seconds < seconds:
        return series
    series.destroy()
    return None


def check(values, given):
    """Raise where options contradict each other."""
    shape = "pulse_shape", "pulse_omega", "pulse_width"
    alternatives(("pulse_file",), shape, values, given, whole=shape[:1])
    unused = "pulse_width" if values["pulse_shape"] == "ricker" else "pulse_omega"
    shape, other = given.get("pulse_shape"), given.get(unused)
    if values["pulse_shape"] not in ("burst", None):
        if other and other.rank >= shape.rank:
            raise InputError(f"-{unused}{other.where}: no part of a {values['pulse_shape']}")
        values[unused] = None


def summary(result):
    """Return in words what a run found."""
    signals, si = result.pulse, SI.of(result)
    how = f"by moments, one recurrence of {signals.solves} terms"
    if signals.method == "laplace":
        how = f"by laplace, {signals.solves} points of the line sigma = {signals.sigma:.3g}, "
        how += counted(signals.factorizations, "factorization")
    yield f"{len(signals.time)} times {how}, {signals.solve_seconds:.2f} s"
    for d, ball in enumerate(ball_names(signals.detector)):
        yield from _summary_of_ball(signals, si, d, ball)
    front = signals.wall_arrival
    yield f"the drive's own front is at {front:.4g}{si.say('s', front)}"
    depths = result.medium.built.depths(signals.detector)
    speed = front_speed(depths, signals.arrival)
    if np.isfinite(speed.value):
        line = f"fronts run at {with_error(speed.value, speed.error)} "
        line += f"{result.medium.length} x frequency{si.say('m/s', speed.value)}, from "
        yield line + f"{depths.min():.4g} to {depths.max():.4g} {result.medium.length} deep"
    line = f"work of the drive {signals.work[-1]:.6g}"
    line += f" +- {signals.work_estimate[-1]:.1e} (an estimate)"
    if signals.energy is not None:
        line += f", of which {signals.energy[-1]:.3g} is left in balls and springs"
        missing = np.abs(signals.work - signals.energy - signals.dissipated).max()
        line += f"; work, energy and what damping took balance to {missing:.1e}"
    yield line


def _summary_of_ball(signals, si, d, ball):
    """Return in words what one detector's signal tells."""
    largest, error = np.abs(signals.displacement[:, d]).max(), signals.error[:, d].max()
    if not error <= signals.tolerance * largest:
        helps = "a smaller -error_tolerance may help"
        helps += ", or -pulse_method laplace" * (signals.method == "moments")
        yield Caution(f"{ball}: not as accurate as asked: {helps}")
    how = "at most" if signals.error_estimate is None else "an estimated"  # of older files
    line = f"{ball}: largest displacement {largest:.3g}, wrong by {how} {error:.1e}"
    front, centre, decay = signals.arrival[d], signals.centre[d], signals.decay[d]
    if np.isfinite(front):
        line += f"; front at {front:.4g}{si.say('s', front)}"
        line += f", centre at {centre:.4g}{si.say('s', centre)}"
    else:
        line += "; when its front arrives is not certain"
    if np.isfinite(decay):
        rate = with_error(decay, signals.decay_error[d])
        line += f", then decay at the rate {rate}{si.say('1/s', decay)}"
    yield line


def samples_of(values, step):
    """Return the motion that numbers make, at times `step` apart unless they say their own."""
    columns = np.atleast_2d(values.T).T
    if columns.ndim > 2 or columns.shape[1] not in (1, 2):
        raise InputError("-pulse_file: a motion is one column of numbers, or times and numbers")
    times, motion = columns[:, 0], columns[:, -1]
    if columns.shape[1] == 2:
        apart = np.diff(times)
        step = np.median(apart) if len(apart) else step  # a gap changes their mean
        uneven = np.flatnonzero(~(np.abs(apart - step) <= UNEVENNESS * step))
        if uneven.size or not step > 0:
            at = times[uneven[0] if uneven.size else 0]
            raise InputError(
                f"-pulse_file: times must increase by equal steps, and do not at {at:g}; resample"
            )
        step = apart.mean() if len(apart) else step
    largest = np.abs(motion).max(initial=0.0)
    if len(motion) < 2 or not 1 / LARGEST_NUMBER < largest < LARGEST_NUMBER:  # NaN neither
        raise InputError(
            "-pulse_file: a motion needs two finite numbers or more, not all zero, the largest of "
            f"them between {1 / LARGEST_NUMBER:g} and {LARGEST_NUMBER:g}"
        )
    if abs(motion[0]) > REST_SHARE * largest:
        raise InputError(
            f"-pulse_file: the wall is at rest at 0 before the first number, which is "
            f"{motion[0]:g}; take off a constant, or let the motion begin smoothly"
        )
    return Samples(motion, float(step))


def check_times(recording):
    """Raise where the times do not hold the pulse, or what it carries."""
    sent, time, steps = recording.sent, recording.time[-1], len(recording.time) - 1
    if time < sent.end * (1 - 1e-9):
        helps = "" if sent.shape == "file" else ", or take a shorter pulse"
        raise InputError(
            f"-pulse_time {time:g}: the pulse lasts until {sent.end:g}; listen longer{helps}"
        )
    band = min(sent.band, recording.highest)
    if math.pi * steps < band * time:
        raise InputError(
            f"-pulse_points {steps + 1}: too few for signals up to omega = {band:.3g}; record "
            f"{math.ceil(band * time / math.pi) + 1} times or more"
        )


SCENE = Scene(options_of(pulse), run_of(pulse), summary, check, shares_lattice=True, function=pulse)
