"""Sweeps over frequencies by moments: a recurrence for each source, none for each frequency."""

import math

import numpy as np

from pgran.driven.amplitudes import is_accurate
from pgran.driven.moments import Chebyshev, law_of
from pgran.driven.operators import Owner
from pgran.driven.recurrence import NoSeriesError, Rows
from pgran.errors import PgranError
from pgran.medium.base import EPSILON
from pgran.run.task import Task

MARGIN = 1e5  # by which the tail is below the tolerance, as values are below |e| |f| |S^-1|
MOST = 10**5  # terms
LARGEST = 2**30  # bytes that rank 0 keeps of all sources
SETUP = 0.1  # seconds before the first one
EVALUATION = 4e-8, 4e-9  # seconds of a term at a frequency, and of each number read there
SERIES = 3  # the reason of a frequency that a series gives


def series_of(rows, medium, s):
    """Return what gives values of a medium at some s. Collective; raises NoSeriesError."""
    if law := law_of(medium):
        return Chebyshev(rows, medium, law, s)
    from pgran.driven.ellipse import Faber

    return Faber(rows, medium, s)


def needed_moments(rates, tolerance):
    """Return how many moments frequencies take at which a series falls at some rates."""
    rates = np.maximum(rates, 1e-99)
    return np.log(MARGIN / tolerance / np.minimum(rates, 1.0)) / rates


class MomentSweep(Owner, Task):
    """The sources of a sweep, a recurrence each, for its frequencies; destroy with `with`.

    `choose` says, before it is carried out, for which frequencies: `chosen`, by `count` moments.
    `heard` numbers are read of each term; without any, sources are their own receivers.
    """

    items = "sources"

    def __init__(self, sweep, comm, series, sources, heard):
        self.sweep, self.comm, self.series, self.heard = sweep, comm, series, max(heard, 1)
        self.units, self.doubling = range(sources), 1 if heard else series.doubling

    def choose(self, method, world):
        """Choose frequencies, all that a series reaches or by `auto` what is quickest in all.

        Return whether there are any, alike on all groups of `world`. Collective over that.
        """
        needed = needed_moments(self.series.rates, self.sweep.choices["error_tolerance"])
        needed = world.bcast(needed)
        most = min(MOST, LARGEST // (8 * self.heard * len(self.units)))
        reached = np.sort(needed[needed <= most])
        if method == "auto":  # none, or so many of the nearest ones
            seconds = np.append(0.0, SETUP + reached * self.seconds_of_term())
            solved = len(needed) - np.arange(len(seconds))
            seconds += solved * self.sweep.scaled.elimination.seconds
            reached = reached[: np.argmin(seconds)]
        elif not reached.size:
            raise NoSeriesError(
                f"any frequency, as the nearest takes {needed.min():.2g} moments, of {most} at most"
            )
        if not reached.size:
            return False
        self.count = 2 * math.ceil(reached[-1] / 2)
        self.items = f"source{'s' * (len(self.units) > 1)} of {self.count} moments"
        self.chosen = np.flatnonzero(needed <= reached[-1])
        terms = self.count // self.doubling + self.doubling - 1
        made = "made", float, len(self.series.made)
        norms = "norms", float, (terms, self.series.parts)
        self.row = np.dtype([made, ("readings", float, (terms, self.heard)), norms])
        return True

    def blank(self, unit):
        """See `Task`."""
        rows = super().blank(unit)
        rows["made"] = self.series.made
        return rows

    def seconds_of_term(self):
        """Return about how long a term takes, of all sources, its evaluation included."""
        evaluated = EVALUATION[0] + EVALUATION[1] * self.heard * len(self.units)
        product = self.series.recurrence.seconds * len(self.units) / self.doubling
        return product + evaluated * len(self.sweep.s)

    def work(self, unit, group):
        """See `Task`."""
        row = self.blank(unit)
        row["readings"], row["norms"] = self.read(unit)
        return row

    def collect(self, rows, seconds):
        """Return rows of the sweep, of which those chosen are as if they had been solved."""
        if np.any(rows["made"] != self.series.made):
            raise PgranError(
                "moments are of machines that round differently, and do not fit together; go on "
                "where the run began, begin anew with -output_overwrite, or take another method"
            )
        points = np.zeros(len(self.sweep.s), self.sweep.row)
        terms = [self.terms(row["readings"], row["norms"]) for row in rows]
        for place in self.chosen:
            s = complex(self.sweep.s[place])
            self.series.at(s, self.count)
            self.fill(points[place], s, terms)
            points[place]["backward_error"] = math.nan  # nothing is solved
        return self.sweep.collect(points, seconds)


class PatternMoments(MomentSweep):
    """Of a `sweeps.PatternSweep`: what sources give receivers, or themselves.

    For `PatternSweep.keep` it answers what a `patterns.PatternSolver` would, of the sweep's own
    patterns.
    """

    owns = ("matrices",)

    def __init__(self, sweep, group):
        medium, self.tolerance = sweep.scaled, sweep.choices["error_tolerance"]
        self.matrices, receivers = Rows(medium, group), sweep.receivers
        series = series_of(self.matrices, medium, sweep.s)
        self.receivers = self.sizes = None
        if receivers is not None:
            from scipy.sparse import csr_matrix

            self.receivers = csr_matrix([self._own(each) for each in receivers])
            entries = self.matrices.largest(np.diff(self.receivers.indptr))
            series.read_by(entries, group)
            self.sizes = np.linalg.norm(receivers, axis=1) * (1 + medium.size * EPSILON)
        heard = 0 if receivers is None else len(receivers)
        super().__init__(sweep, group, series, len(sweep.sources), heard)

    def _own(self, pattern):
        """Return this rank's unknowns of a pattern, in PETSc's order."""
        layout = self.matrices.layout
        return layout.free_values(pattern.reshape(layout.medium.shape))

    def read(self, unit):
        """Return what is read of a source's terms, and their norms. Collective."""
        reader = None if self.receivers is None else self.receivers.__matmul__
        return self.series.read(self._own(self.sweep.sources[unit]), reader, self.count)

    def terms(self, readings, norms):
        """Return the Terms of a source."""
        return self.series.terms(readings, norms, self.sizes)

    def fill(self, point, s, terms):
        """Let the sweep put into a row what it wants of answers at an s."""
        self.s, found = s, [self.series.values(each) for each in terms]
        self._values, self._bounds = (np.transpose(each) for each in zip(*found, strict=True))
        self.sweep.keep(point, self)

    def diagonal(self, patterns):
        """Return f^T S^-1 f of each source, and bounds."""
        return self._values[0], self._bounds[0]

    def products(self, receivers, sources):
        """Return e^T S^-1 f of all receivers e and sources f, and bounds."""
        return self._values, self._bounds


class DriveMoments(MomentSweep):
    """Of a `drive.FrequencySweep`: what the medium's own drive gives its detectors."""

    owns = ("motion",)

    def __init__(self, sweep, group):
        from pgran.driven.motion import Motion

        motion = self.motion = Motion(sweep.scaled, sweep.sites, group, sweep.s)
        self.terms = motion.terms
        super().__init__(sweep, group, motion.series, 1, len(sweep.sites) + 2)

    def read(self, unit):
        """Return what is read of the drive's terms, and their norms. Collective."""
        return self.motion.read(self.count)

    def fill(self, point, s, terms):
        """Put into a row what a `SteadyState` would."""
        motion, series, (found,) = self.motion, self.series, terms
        values, bounds = series.values(found)
        slopes, wrong = series.slopes(found, (values, bounds))
        detectors = slice(len(self.sweep.sites))
        point["displacement"], point["error_bound"] = values[detectors], bounds[detectors]
        point["derivative"], point["derivative_bound"] = 1j * slopes[detectors], wrong[detectors]
        point["reaction"] = motion.reaction(s, *values[-2:])
        point["reaction_bound"] = motion.reaction(abs(s), *bounds[-2:]) * (1 + 8 * EPSILON)
        tolerance, size = self.sweep.choices["error_tolerance"], self.sweep.scaled.drive_size
        good = is_accurate(bounds[detectors], values[detectors], tolerance)
        good |= bounds[detectors] <= self.sweep.choices["error_floor"] * size
        point["converged_reason"] = SERIES if good.all() else 0
