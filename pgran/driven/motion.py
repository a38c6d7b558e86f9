"""A medium's own drive in the terms of `ellipse`: where it starts, and what is heard of it."""

import numpy as np

from pgran.driven.ellipse import Faber
from pgran.driven.operators import Owner, unchanged
from pgran.driven.recurrence import Rows, compounded


class Motion(Owner):
    """The series of what a wall, or a push, does to detectors. Collective when made.

    `start` is this rank's y_0 = (f_c, f_k - C f_c), whose norm is no more than `size`, and which is
    `astray` by rounding at most, what is read of it included; `heard` reads the detectors'
    unknowns, f_k and f_c off this rank's rows, `at_start` is what it reads of f_c, `sizes` are no
    less than |d| of each. Raises a NoSeriesError where there is none.
    """

    owns = ("rows",)

    def __init__(self, medium, sites, group, s):
        self.medium, self.comm = medium, group
        self.rows = rows = Rows(medium, group)
        series = self.series = Faber(rows, medium, s)
        self.layout = rows.layout
        stiff, damped = drive = self._drive(unchanged)
        self.start = np.stack([damped, stiff - series.dashpot @ rows.padded(damped)])
        self.size = series.size_of(self._norms(self.start))
        self.heard = self._receivers(sites, drive)
        self.at_start = rows.total(self.heard @ damped)
        # sums may be less than what they are rounded from
        stiff, damped = self._norms(self._drive(np.abs))
        self.sizes = np.sqrt(rows.total(self.heard.power(2).sum(axis=1).A1)) * (1 + 1e-12)
        self.sizes[-2:] = stiff, damped
        entries = rows.largest(np.diff(self.heard.indptr))
        series.read_by(entries, group)
        series.dot += series.known
        start = damped, stiff + 2 * series.dashpots * damped
        self.astray = series.known * series.size_of(start)
        self.astray += (series.known + compounded(entries + 8 + group.size)) * series.Omega * damped

    def _drive(self, size):
        """Return this rank's f_k and f_c, per mass, `size` taken of what they are summed from."""
        medium, force = self.medium, self.layout.wall_force
        pushed = 0.0 if medium.pushed is None else size(self.layout.free_values(medium.pushed))
        damped = medium.damping * force(medium.damped_springs, size)
        return np.stack([force(medium.constants, size) + pushed, damped]) / medium.mass

    def _norms(self, fields):
        """Return no less than the norms of fields, this rank's rows of each. Collective."""
        return np.sqrt(self.rows.total(np.sum(fields**2, axis=1))) * (1 + 1e-12)

    def _receivers(self, sites, drive):
        """Return what reads detectors and the two parts of the drive off this rank's rows."""
        from scipy.sparse import csr_matrix, vstack

        unknowns, weights = self.layout.readings(sites)
        places = np.repeat(np.arange(len(unknowns)), unknowns.shape[1]), unknowns.ravel()
        detectors = csr_matrix((weights.ravel(), places), (len(unknowns), self.medium.size))
        own = slice(self.layout.first, self.layout.last)
        return vstack([detectors[:, own], csr_matrix(drive)]).tocsr()

    def read(self, count, read=None):
        """Return what is heard of terms n < count, or by `read`, and their norms. Collective."""
        return self.series.recurrence.read(self.start, read or self.heard.__matmul__, count)

    def terms(self, readings, norms):
        """Return the Terms of these."""
        return self.series.terms(readings, norms, self.sizes, self.at_start, self.astray)

    def reaction(self, s, stiff, damped):
        """Return f^T A from what f_k and f_c read, or no less than |f| |.| from sizes of these."""
        return self.medium.mass * (stiff + s * damped)
