"""Scene `pulse`: the wall moves as it likes, and balls are listened to in time."""

import math

import numpy as np

from pgran.errors import InputError
from pgran.files.options import INTEGER, REAL, TEXT, Option
from pgran.machine import check_memory
from pgran.parallel.task import carry_out
from pgran.physics.lattice import detector_sites, smallest_damping_eigenvalue
from pgran.physics.pulse import SHAPES, SIGMA_PERIOD, TURN, Limits, Line, Pulse
from pgran.physics.rounding import SMALLEST_NORMAL
from pgran.results import LatticeRecord, Signals
from pgran.scenes import common
from pgran.scenes.interface import in_parallel
from pgran.scenes.scene import Scene
from pgran.scenes.sweeping import FrequencySweep

PULSE = (
    Option(
        "pulse_shape", TEXT, "burst",
        "how the wall moves: gauss, a bell; ricker, its second derivative; burst, a bell times a "
        "cosine; step, from 0 to 1",
        choices=SHAPES,
    ),
    Option(
        "pulse_omega", REAL, 0.6, "burst, ricker: the largest of its spectrum", "angular", above=0
    ),
    Option(
        "pulse_width", REAL, 20.0, "standard deviation of the bell; a ricker's follows from omega",
        "1/frequency", above=0
    ),
    Option("pulse_time", REAL, 600.0, "how long is listened", "1/frequency", above=0),
    Option("pulse_points", INTEGER, 1201, "times at which signals are recorded", low=2),
)  # fmt: skip
TOLERANCE = common.STEADY["error_tolerance"]
FRONT = 0.1  # of the largest displacement: where a front has arrived
LEFT_OUT = 1e-9  # of the tolerance: what frequencies left out may add up to


def check(values, given):
    """Raise where options contradict each other. Not collective."""
    common.check_lattice(values, given)
    unused = "pulse_width" if values["pulse_shape"] == "ricker" else "pulse_omega"
    if values["pulse_shape"] != "burst" and unused in given:
        raise InputError(f"-{unused}{given[unused].where}: no part of a {values['pulse_shape']}")


def run(options, world, crew):
    """Return the lattice and the signals, on rank 0; None on the others.

    Collective. Parameters are those of `pgran.scenes.scene.Scene`.
    """
    lattice = common.make_lattice(options, world)
    with crew(common.ranks_per_lattice(options, lattice, world)) as workers:
        signals = pulse(
            lattice,
            options.detectors,
            workers,
            shape=options.pulse_shape,
            omega=options.pulse_omega,
            width=options.pulse_width,
            time=options.pulse_time,
            points=options.pulse_points,
            error_tolerance=options.error_tolerance,
            progress=options.output_progress,
        )
    return signals and [LatticeRecord.of(lattice), signals]


def summary(result):
    """Return in words what a run found. Not collective."""
    signals = result.pulse
    yield (
        f"{len(signals.time)} times from {signals.solves} points of the line sigma = "
        f"{signals.sigma:.3g}, {signals.factorizations} factorizations, "
        f"{signals.solve_seconds:.2f} s"
    )
    for d, site in enumerate(signals.detector.tolist()):
        largest, bound = np.abs(signals.displacement[:, d]).max(), signals.error_bound[:, d].max()
        line = (
            f"ball {tuple(site)}: largest displacement {largest:.3g}, wrong by at most {bound:.1e}"
        )
        if not bound <= signals.tolerance * largest:
            line += ", which misses the accuracy asked for"
        if np.isfinite(signals.arrival[d]):
            line += f"; front at {signals.arrival[d]:.4g}, centre at {signals.centre[d]:.4g}"
        yield line


@in_parallel(shares_lattice=True)
def pulse(
    lattice,
    detectors,
    crew=None,
    *,
    shape="burst",
    omega=0.6,
    width=20.0,
    time=600.0,
    points=1201,
    error_tolerance=1e-4,
    progress="none",
):
    """Send a pulse through the lattice, and return what balls do, by the Laplace transform.

    Collective.

    Parameters
    ----------
    lattice : pgran.physics.lattice.Lattice
    detectors : array_like of int
        Ball indices, flat or one row a detector.
    crew : pgran.parallel.crew.Crew, optional
        All ranks unless given.
    shape : str
        `gauss`, `ricker`, `burst` or `step`: see `pgran.physics.pulse.Pulse`.
    omega, width : float
        Of the pulse.
    time : float
        How long is listened.
    points : int
        Equal distances of time.
    error_tolerance : float
        Asked of displacements, relative to a signal's largest.
    progress : str
        Style of `pgran.parallel.progress.Progress`.

    Returns
    -------
    pgran.results.Signals or None
        With a crew of the caller's None on all ranks but rank 0.

    Raises
    ------
    InputError
        If a detector lies outside the lattice, or a value is impossible.
    """
    common.check_values(
        PULSE, pulse_shape=shape, pulse_omega=omega, pulse_width=width, pulse_time=time,
        pulse_points=points,
    )  # fmt: skip
    TOLERANCE.check(error_tolerance)
    sent = Pulse(shape, float(omega), float(width))
    if time < sent.centre:
        raise InputError(
            f"-pulse_time {time:g}: the middle of the pulse leaves the wall at {sent.centre:g}, "
            "nine of its widths after the time 0; listen longer, or take another -pulse_width"
        )
    task = PulseLine(lattice, detectors, sent, float(time), points, error_tolerance)
    return carry_out(task, crew, progress)


class PulseLine(FrequencySweep):
    """The amplitudes at the detectors along the line of the inverse Laplace transform.

    Parameters
    ----------
    lattice, detectors, time, points, error_tolerance
        As in `pulse`.
    sent : pgran.physics.pulse.Pulse
    """

    def __init__(self, lattice, detectors, sent, time, points, error_tolerance):
        """Choose the points of the line."""
        sites = detector_sites(lattice.shape, detectors)
        check_memory("pulse_points", 48 * points * len(sites))
        self.sent, self.tolerance = sent, error_tolerance
        self.time = np.linspace(0.0, time, points)
        scaled, _ = lattice.in_own_unit()
        self.line = Line(sent, time, limits_of(scaled), LEFT_OUT * error_tolerance)
        growth = math.exp(SIGMA_PERIOD / TURN)
        kept = [
            ("displacement", complex, (len(sites),)),
            ("error_bound", float, (len(sites),)),
            ("converged_reason", np.int64),
        ]
        # errors grow by as much; below the floor an amplitude matters no more
        choices = {"error_tolerance": 1e-2 * error_tolerance / growth, "error_floor": 1e-20}
        super().__init__(lattice, self.line.s.imag, sites, kept, choices, self.line.sigma)

    def collect(self, rows, seconds):
        """See `Task`; what failed has an infinite bound."""
        bound = np.where(np.isnan(rows["error_bound"]), np.inf, rows["error_bound"])
        amplitude = np.nan_to_num(rows["displacement"])
        found = self.line.signals(self.time, amplitude, bound)
        displacement, error_bound, velocity, velocity_bound = found
        weights = displacement**2
        return Signals(
            shape=self.sent.shape,
            pulse_omega=self.sent.omega,
            pulse_width=self.sent.width,
            method="laplace",
            sigma=self.line.sigma,
            period=self.line.period,
            solves=len(rows),
            factorizations=int(rows["factorizations"].sum()),
            solve_seconds=seconds,
            tolerance=self.tolerance,
            arrival=arrivals(self.time, displacement, error_bound),
            centre=self.time @ weights / np.maximum(weights.sum(axis=0), SMALLEST_NORMAL),
            time=self.time,
            wall=self.sent.wall(self.time),
            detector=self.sites,
            displacement=displacement,
            error_bound=error_bound,
            velocity=velocity,
            velocity_bound=velocity_bound,
        )


def limits_of(lattice):
    """Return what bounds the motion of a lattice. Not collective."""
    axes, beta = len(lattice.shape), lattice.damping
    driven = lattice.stiffness[0][-1]
    return Limits(
        mass=lattice.mass,
        stability=beta * smallest_damping_eigenvalue(lattice.shape),
        stiffness=4 * axes * lattice.stiffest,
        damping=4 * axes * beta,
        drive=1.01 * math.sqrt(np.sum(driven**2)),
        drive_damping=1.01 * beta * math.sqrt(driven.size),
    )


def arrivals(time, displacement, error_bound):
    """Return when each displacement first exceeds FRONT of its largest, NaN where bounds hide it.

    Not collective.

    Parameters
    ----------
    time : numpy.ndarray, shape (nt,)
    displacement, error_bound : numpy.ndarray, shape (nt, nd)
    """
    found = []
    for signal, bound in zip(np.abs(displacement).T, error_bound.T, strict=True):
        level = FRONT * signal.max(initial=0.0)
        first = np.argmax(signal > level)
        if first == 0 or not bound[: first + 1].max() < 0.1 * level:
            found.append(np.nan)
            continue
        part = (level - signal[first - 1]) / (signal[first] - signal[first - 1])
        found.append(time[first - 1] + part * (time[first] - time[first - 1]))
    return np.array(found)


SCENE = Scene(
    options=(*common.LATTICE, *common.DETECTORS, *PULSE, TOLERANCE),
    run=run,
    summary=summary,
    check=check,
    shares_lattice=True,
)
