"""Signals by the polynomials of one recurrence, and what bounds their errors.

A ball's motion after a pulse U of the wall is (u, v)' = G (u, v) + U y_0, y_0 = (f_c, f_k - C f_c),
in the terms of `driven.ellipse` a sum of c_n P_n(G) y_0 at each s, and in time

    e^(tG) = e^(c_0 t) [J_0(kappa t) + 2 sum of J_n(kappa t) P_n(G)]:

beyond kappa t its terms fall faster than any power, so that some kappa T of them are all there is.
Their sum over the line of the Laplace transform (see `laplace`) is cheap, and its points are:
sigma T is small, the period long.

What is cut off is 2 rho_0^n |J_n| a term, which Siegel's bound of J_n adds up (NIST Handbook of
Mathematical Functions, 10.14.8). Rounding e_j of term j reaches v(t) by kappa rho_0^(j + 1)
J_j(kappa x), then by e^(tG), a contraction; with Cauchy and Schwarz and

    sum over all n of rho_0^(2 n) J_n(x)^2 = I_0(x (rho_0 - 1 / rho_0)),
    kappa (rho_0 - 1 / rho_0) = 2 a,

a velocity is wrong by int |U| kappa rho_0 |eps|_2 int_0^t e^(c_0 x) I_0(2 a x)^(1/2) dx at most,
a displacement by t times that.
"""

import contextlib
import math

import numpy as np

from pgran.driven.motion import Motion
from pgran.driven.operators import Owner
from pgran.driven.recurrence import compounded
from pgran.experiments.pulse.laplace import Line, work_of
from pgran.run.task import Task

DAMPED, TURN = 8.0, 8.0  # sigma T, and the period in T
CUT = 1e-4  # of the tolerance: what terms cut off may add
FITTED = 1e-6  # of the largest |U|: at which s the ellipse is fitted
EVALUATION = 1e-7  # seconds that a term takes at a point of the line
SAMPLE = 40  # terms that a dry run tries


class PulseSeries(Owner, Task):
    """The terms of a Recording's series, and its Signals. Collective when made.

    Raises a NoSeriesError where there is none.
    """

    items, owns = "terms", ("motion",)

    def __init__(self, recording, group):
        self.recording, self.comm, medium = recording, group, recording.scaled
        sent, time = recording.sent, float(recording.time[-1])
        sigma, turn = DAMPED / time, max(TURN, 1.0 - sent.begin / time)
        s = sigma + 2j * np.pi / time * np.arange(math.ceil(sent.highest * time / (2 * math.pi)))
        strength = np.abs(sent.transform(s))
        fitted = s[strength >= FITTED * strength.max()]
        self.motion = motion = Motion(medium, recording.sites, group, fitted)
        self.series, self.size = motion.series, motion.size
        readings = medium.reading_norms(recording.sites)
        tolerance = recording.tolerance * medium.drive_size / readings.max(initial=1.0)
        moved = float(np.ravel(sent.sizes(np.array([time]))[0])[0])
        cut, self.count = CUT * tolerance / (self.size * moved * time), 2
        self.count += math.ceil(self.series.ellipse.kappa * time)
        while not self._left(time)[0] <= cut:
            self.count += 10
        line = DAMPED, turn, self._largest, self._speed
        self.line = Line(sent, recording.time, *line, tolerance, readings)
        self.units = [self.count]
        row = [
            ("readings", float, (self.count, len(motion.sizes))),
            ("norms", float, (self.count, 2)),
            ("fields", float, (len(recording.field_time), *medium.shape)),
        ]
        self.row = np.dtype(row)

    @property
    def seconds(self):
        """About how long one rank takes."""
        return self.count * (self.series.recurrence.seconds + EVALUATION * len(self.line.s))

    def _left(self, time):
        """Return what terms of e^(tG) that are left out add up to, and how fast they fall."""
        z = self.series.ellipse.kappa * time / self.count
        root = math.sqrt(max(1 - z * z, 0.0))
        ratio = z / (1 + root) * self.series.ellipse.rho0
        if z >= 1 or ratio >= 1:
            return math.inf, 1.0
        return 2.01 * math.exp(self.count * (root + math.log(ratio))) / (1 - ratio), ratio

    def _grown(self, time):
        """Return e^(c_0 t) I_0(2 a t)^(1/2), to which terms of e^(tG) sum up in squares."""
        from scipy.special import i0e

        ellipse = self.series.ellipse
        growth = np.exp((ellipse.centre + ellipse.a) * time)
        return growth * np.sqrt(i0e(2 * ellipse.a * time))

    def _largest(self, s):
        """Return no less than |A(s)| of the series at any s on the line."""
        summed = self.series.summed_sizes(s)
        return 1.01 * (summed + 1 / self.series.Omega) * self.size / np.abs(s)

    def _speed(self, t):
        """Return no less than any velocity of the series up to some times."""
        moved = self.recording.sent.sizes(t)[0]
        terms = 2 * math.sqrt(self.count) * np.maximum(self._grown(t), 1.0)
        return 1.01 * (moved * terms + 2 / self.series.Omega) * self.size

    def _lost(self, terms):
        """Return how wrong velocities are at the times, beside what the sum over the line misses.

        By rounding of terms and of what is read of them, of a few entries each, by terms left out,
        with what rounding puts into these, and by the start.
        """
        time, ellipse = self.recording.time, self.series.ellipse
        grown = self._grown(time)  # of which the logarithm is convex
        area = np.cumsum(np.diff(time) * np.maximum(grown[1:], grown[:-1]))
        rounding = 1.01 * ellipse.kappa * ellipse.rho0 * np.linalg.norm(terms.eps)
        reading = compounded(16) / self.series.dot * np.linalg.norm(terms.missed)
        left, ratio = self._left(float(time[-1]))
        added = 1.01 * (terms.lost[-1] + terms.eps.sum() * (1 + 1 / (1 - ratio)))
        lost = rounding * np.append(0.0, area) + 2.01 * reading * np.maximum(grown, 1.0)
        lost += left * (terms.size + added) + terms.astray
        return self.recording.sent.sizes(time)[0] * lost

    @contextlib.contextmanager
    def open(self, group):
        """See `Task`."""
        motion = self.motion
        weights, at_start = self._weights_of_fields()

        def work(count):
            row, fields = self.blank(count), np.outer(at_start, motion.start[0])
            number = iter(range(count))

            def read(v):
                if len(fields):
                    fields[:] += np.outer(weights[:, next(number)], v)
                return motion.heard @ v

            row["readings"][0, :count], row["norms"][0, :count] = motion.read(count, read)
            for place, field in enumerate(fields):
                x = motion.layout.like.duplicate()
                x.setArray(field)
                whole = motion.layout.field(x)
                x.destroy()
                if whole is not None:
                    row["fields"][0, place] = whole.real
            return row

        yield work

    def length(self, unit):
        """See `Task`: terms."""
        return unit

    def blank(self, unit):
        """See `Task`."""
        return np.zeros(1, self.row)

    def sample(self, unit):
        """See `Task`."""
        return min(unit, SAMPLE)

    def _weights_of_fields(self):
        """Return how much of each v_n, and of f_c, is in the field at its times."""
        line, times = self.line, self.recording.field_time
        weights, shares = np.zeros((len(times), self.count)), line.turning(times) * line.transform
        for share, s in zip(shares.T if len(times) else (), line.s, strict=False):
            self.series.at(s, self.count)
            weights += np.outer(share, self.series.c).real
        return weights, (shares / line.s).sum(axis=1).real

    def collect(self, rows, seconds):
        """See `Task`."""
        recording, line, medium = self.recording, self.line, self.recording.scaled
        terms = self.motion.terms(rows["readings"][0], rows["norms"][0])
        values, bounds = np.empty((2, len(line.s), len(terms.sizes)), dtype=complex)
        for place, s in enumerate(line.s):
            self.series.at(s, self.count)
            values[place], bounds[place] = self.series.summed(terms.readings, terms.at)
        detectors, bounds = len(recording.sites), bounds.real
        found = line.signals(values[:, :detectors], bounds[:, :detectors])
        lost, longer = self._lost(terms), recording.time + 1 / self.series.Omega
        for name, wrong in (("velocity", lost), ("displacement", longer * lost)):
            value, bound = found[name]
            found[name] = value, bound + wrong[:, None] * line.readings
        reaction = self.motion.reaction(line.s, *values[:, detectors:].T)
        wrong = self.motion.reaction(abs(line.s), *bounds[:, detectors:].T)
        if medium.push is None:
            force, sizes = medium.pull(line.s) - reaction, medium.drive_norms
        else:
            force, wrong, sizes = line.s * reaction, abs(line.s) * wrong, medium.drive_norms[::-1]
        own = lost * (sizes[0] * longer + sizes[1] * medium.damping)
        found |= work_of(recording, line, force, wrong, own)
        kept = {}
        if recording.fields:
            field = medium.displacements(rows["fields"][0])
            kept = {"field_time": recording.field_time, "field": field}
        return recording.record(
            "moments", found, sigma=line.sigma, period=line.period, solves=self.count,
            factorizations=0, solve_seconds=seconds, **kept,
        )  # fmt: skip
