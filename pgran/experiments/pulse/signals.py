"""What is recorded after a pulse, and what signals tell: fronts, envelopes, codas, work."""

import math

import numpy as np

from pgran.experiments.pulse.record import Signals
from pgran.medium.base import SMALLEST_NORMAL
from pgran.run.machine import check_memory
from pgran.store.estimate import Estimate

FIELDS = 4  # times at which the field is kept
FINE_STEP = 0.6  # step times frequency of what is integrated by splines: to about 1e-9
FINE_BYTES = 550, 1050  # half of what each time takes in between, of shapes and of numbers
FRONT_SHARE = 1e-3  # of the integral of v^2: what has passed when a front has arrived
BLOCKS, FEWEST_BLOCKS = 16, 6  # that a coda is cut into, and that a rate needs
DEGREE = 11  # of the splines that are integrated: an odd number


class Recording:
    """What is recorded of a pulse `sent`, to a `tolerance` relative to a signal's largest.

    Signals at `points` equal times; if `fields`, the displacement of all balls at FIELDS times,
    too. Powers are integrated on a finer grid, which begins where the wall does:

        fine   -2  -1   0   1   2   3   4   5   6  ...      before = 2, finer = 3
        time            0           1           2  ...
    """

    def __init__(self, lattice, detectors, sent, time, points, tolerance, fields):
        self.lattice, self.sent, self.tolerance, self.fields = lattice, sent, tolerance, fields
        self.sites = lattice.sites(detectors)
        self.scaled, self.unit = lattice.in_own_unit()
        self.highest = math.sqrt(self.scaled.stiffness_norm / self.scaled.mass)  # of normal modes
        step = time / (points - 1)
        self.finer = math.ceil(2 * step * sent.reach / FINE_STEP)
        self.before = math.ceil(-sent.start * self.finer / step)
        fine = points * self.finer + self.before
        drawn = sent.shape == "file"
        key = "pulse_points" if self.finer == 1 else "pulse_file" if drawn else "pulse_time"
        check_memory(key, 48 * points * len(self.sites) + FINE_BYTES[drawn] * fine)
        self.time = np.linspace(0.0, time, points)
        fine = np.linspace(0.0, time, self.finer * (points - 1) + 1)
        self.fine = np.append(-step / self.finer * np.arange(self.before, 0, -1), fine)
        self.field_time = np.linspace(sent.centre, time, FIELDS + 1)[1:] if fields else np.empty(0)

    @property
    def taken(self):
        """The wall's velocity at the times of `fine`, by which its force makes a power.

        Of a push the push itself: a power by the velocity of what is pushed.
        """
        return self.sent.moves(self.fine, 2)[int(self.scaled.push is None)]

    def coarse(self, values):
        """Return values at the times of the signals from those at the times of `fine`."""
        return values[self.before :: self.finer]

    def integral(self, power):
        """Return the integral of a power, given at the times of `fine`, until each time.

        And an estimate of its error: the largest so far of its difference from the integral by
        every second time.
        """
        work = self.coarse(integral(self.fine, power))
        rare = slice((len(self.fine) - 1) % 2, None, 2)  # the last one, too
        rougher = integral(self.fine[rare], power[rare], self.time)
        return work, np.maximum.accumulate(np.abs(work - rougher))

    def record(self, method, found, **more):
        """Return the Signals; `more` are other fields of theirs.

        `found` has by name displacement and velocity, shape (nt, nd), force and work of the wall,
        and, where they are known, energy and what the dashpots took, (nt,), each with what it may
        be wrong by, in the unit of `scaled`.
        """
        moves, speed = self.sent.moves(self.time, 2)
        if self.scaled.push is not None:  # a force that is known exactly
            found = found | {"force": (self.scaled.push_sizes.sum() * moves, 0 * self.time)}
        (displacement, error), (velocity, speed_error) = found["displacement"], found["velocity"]
        envelope, size = envelopes(displacement, velocity), self.sent.size
        decay, decay_error = codas(self.time, envelope, error)
        wall_arrival = float(arrivals(self.time, speed[:, None], 0 * speed[:, None])[0])
        errors = {"displacement": "error_bound", "velocity": "velocity_bound"}
        units = {"displacement": size, "velocity": size, "force": self.unit * size}
        for name, (values, wrong) in found.items():
            unit = units.get(name, self.unit * size**2)
            more |= {name: unit * values, errors.get(name, f"{name}_estimate"): unit * wrong}
        if self.fields:
            more["field"] = size * more["field"]
        return Signals(
            shape=self.sent.shape,
            pulse_omega=self.sent.omega,
            pulse_width=self.sent.width,
            method=method,
            tolerance=self.tolerance,
            wall_arrival=wall_arrival,
            arrival=arrivals(self.time, velocity, speed_error, wall_arrival),
            centre=centres(self.time, envelope),
            decay=decay,
            decay_error=decay_error,
            time=self.time,
            wall=size * moves,
            detector=self.sites,
            envelope=size * envelope,
            **more,
        )


def arrivals(time, velocity, error, earliest=0.0):
    """Return when FRONT_SHARE of each signal's energy, int v^2 dt, has passed, shape (nd,).

    NaN where errors hide it, nothing moves, or it would be before the `earliest`, the driven wall's
    own: of a motion whose early part alone passes, shares of the whole tell no front.
    """
    from scipy.integrate import cumulative_trapezoid  # here: SciPy takes its time

    fronts = np.full(velocity.shape[1], np.nan)
    passed = [cumulative_trapezoid(x**2, time, axis=0, initial=0.0).T for x in (velocity, error)]
    for d, (energy, missed) in enumerate(zip(*passed, strict=True)):
        level = FRONT_SHARE * energy[-1]
        first = np.argmax(energy > level)
        if missed[first] < 0.01 * level:  # a tenth of the velocity
            share = (level - energy[first - 1]) / (energy[first] - energy[first - 1])
            fronts[d] = time[first - 1] + share * (time[first] - time[first - 1])
    return np.where(fronts >= earliest, fronts, np.nan)


def front_speed(depth, arrival):
    """Return the speed of fronts, an Estimate, from their arrivals at detectors of some depths.

    Of the straight line through arrivals against depths; NaN unless three depths or more are known,
    and fronts arrive the later, the deeper. The error is by how far arrivals are from the line.
    """
    from scipy.stats import linregress

    known = np.isfinite(depth) & np.isfinite(arrival)
    if len(np.unique(depth[known])) >= 3:
        line = linregress(depth[known], arrival[known])
        if line.slope > 0:
            return Estimate(float(1 / line.slope), float(line.stderr / line.slope**2))
    return Estimate(math.nan, math.nan)


def envelopes(displacement, velocity):
    """Return sqrt(u^2 + (v / omega)^2), omega^2 the mean of v^2 over that of u^2, shape (nt, nd).

    It begins with the signal, unlike those by Hilbert's transform or a smoothing.
    """
    u, v = np.sum(displacement**2, axis=0), np.sum(velocity**2, axis=0)
    slowness = np.sqrt(u / np.maximum(v, SMALLEST_NORMAL))
    return np.hypot(displacement, slowness * velocity)


def centres(time, envelope):
    """Return the mean time of each envelope, weighted by its square."""
    weights = envelope**2
    return time @ weights / np.maximum(weights.sum(axis=0), SMALLEST_NORMAL)


def codas(time, envelope, error):
    """Return the rates at which envelopes decay after their centres, and their standard errors.

    A straight line goes through the logarithm of the mean square of each of BLOCKS blocks, as far
    as errors of the displacement are below a tenth of it; NaN where too few are left, or nothing
    decays.
    """
    from scipy.stats import linregress

    rates = np.full((2, envelope.shape[1]), np.nan)
    for d, centre in enumerate(centres(time, envelope)):
        after = np.flatnonzero(time > centre)
        if len(after) < 4 * BLOCKS:
            continue
        blocks = np.array_split(after, BLOCKS)
        level = np.array([np.mean(envelope[block, d] ** 2) for block in blocks])
        certain = np.array([error[block, d].max() for block in blocks]) ** 2 < 0.01 * level
        count = BLOCKS if certain.all() else np.argmin(certain)
        if count >= FEWEST_BLOCKS:
            middle = [time[block].mean() for block in blocks[:count]]
            line = linregress(middle, np.log(level[:count]))
            if line.slope < 0:  # of the square, which decays twice as fast
                rates[:, d] = -line.slope / 2, line.stderr / 2
    return rates


def integral(time, values, at=None):
    """Return the integral until each time of a smooth function at equal ones, by a spline."""
    from scipy.integrate import cumulative_trapezoid
    from scipy.interpolate import make_interp_spline

    degree, at = min(DEGREE, (len(time) - 1) // 2 * 2 - 1), time if at is None else at
    if degree < 1:
        return np.interp(at, time, cumulative_trapezoid(values, time, initial=0.0))
    return make_interp_spline(time, values, degree).antiderivative()(at)
