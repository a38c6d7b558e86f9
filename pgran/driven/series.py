"""Values e^T S(s)^-1 f at any s from the terms of one recurrence, with bounds of their errors.

With w = (rho + 1 / rho) / 2, |rho| > 1, and T_n, U_n Chebyshev's polynomials of both kinds,

    (w - X)^-1 = sum of C rho^-n T_n(X)  (half of that at n = 0),
    rho = (p + q)^2,    C = 1 / (p q),    p, q = ((w +- 1) / 2)^(1/2).

S^-1 is that times a weight, for an X and a w(s) that `moments` and `ellipse` have. There, too, is
why |T_n(X)| <= rho_0^n and |U_n(X)| <= (n + 1) rho_0^n, so that with ratio = rho_0 / |rho| < 1 what
is left out after N terms is at most |C| ratio^N / (1 - ratio) |f|.

Computed terms t_n, which stand for T_n(X) f / rho_0^n, obey

    t_(n+1) = (2 / rho_0) X t_n - rho_0^-2 t_(n-1) + e_n,    |e_n| <= eps_n,

a sum of norms that are known. So they are wrong by sum over j < n of (n - j) eps_j at most. In the
sum of the series e_j has the factor

    sum over n > j of C rho_0^(j+1) rho^-n U_(n-1-j)(X) = C rho_0 (rho_0 / rho)^j (w - X)^-1 / 2

but for its terms from N on, |C| ratio^N ((N - j) / (1 - ratio) + ratio / (1 - ratio)^2) at most:
of both bounds the smaller one holds. There are also the rounding of what is read, that of the sum,
and that of X - w, which a series adds.
"""

import math
from typing import NamedTuple

import numpy as np

from pgran.driven.recurrence import CHUNK, U, compounded, dot


class Terms(NamedTuple):
    """What is known of the terms of a source, for any s."""

    readings: np.ndarray  # (count, receivers)
    eps: np.ndarray | None  # (count,); None where receivers are the source: `lost` alone counts
    lost: np.ndarray  # how wrong each term is
    missed: np.ndarray  # how wrong each reading is beside that, |e| = 1
    size: float  # no less than |f|
    astray: float  # how far f is from what is meant
    sizes: np.ndarray  # no less than |e| of each receiver
    at: np.ndarray  # what is read of a motion's start


class Series:
    """The terms of sources and, at the s of the last `at`, the values that these sum up to.

    Of a class that has the `recurrence`, its `start(force)` and `losses(norms)`, eps_n, and calls
    `expand` in `at(s, count)`. Parts of series that `made` alike fit together; `rates` are
    -ln(ratio) at all s.
    """

    doubling = 1  # moments of a product, where the receiver is the source
    parts = 1  # norms of a term
    centred = 0.0  # ln rho_0, and, of coefficients of real terms, how far one is turned
    known = 0.0  # how exactly a start is known, relative
    shifted = spread = held = 0.0  # what `at` adds: by rounding of X - w, of a start; 1 / s

    def read_by(self, entries, comm):
        """Let readings be sums of so many entries on each rank."""
        self.dot = compounded(max(CHUNK, entries) + 8 + comm.size)

    def read(self, force, read, count):
        """Return what is read of terms n < count, and norms of these. Collective.

        `read(field)` returns this rank's part; without it the receiver is the source.
        """
        read = read or (lambda v: np.array([dot(force, v)]))
        return self.recurrence.read(self.start(force), read, count)

    def terms(self, readings, norms, sizes, at=0.0, astray=None):
        """Return the Terms of what was read, `sizes` None where the receiver is the source."""
        norms = norms * (1 + self.dot)
        eps, size = self.losses(norms), self.size_of(norms[0])
        astray = self.known * size if astray is None else astray
        lost = np.concatenate([[0.0], np.cumsum(np.cumsum(eps))[:-1]])
        sizes = self.mass * norms[0, -1:] if sizes is None else sizes
        return Terms(readings, eps, lost, self.dot * norms[:, -1], size, astray, sizes, at)

    def expand(self, ends, weight, inverse, count):
        """Set the coefficients c_n of terms, from w + 1 and w - 1, and |(w - X)^-1|, where known.

        It is at most the sum of the series, too.
        """
        n, (self.logarithm, self.C) = np.arange(count), expansion(*ends)
        self.c = weight * self.C * np.exp(-n * (self.logarithm - self.centred))
        self.c[0] /= 2
        ratio = self.ratio = float(ratios(self.logarithm, self.centred))
        self.largest, self.magnitudes = abs(weight * self.C) * (1 + 64 * U), np.abs(self.c)
        converges = ratio < 1
        self.left = self.largest * ratio**count / (1 - ratio) if converges else math.inf
        proven = (1.001 * self.magnitudes.sum() + self.left) / abs(weight)
        self.inverse = min(inverse, proven)
        self.sharp = np.full(count, math.inf)
        if converges:
            whole = self.largest * math.exp(self.centred.real) * self.inverse / 2 * ratio**n
            self.sharp = whole + self.left * (count - n + ratio / (1 - ratio))
        rounded = 64 + n * (16 + 8 * abs(self.logarithm))
        self.rounded = (rounded * U + compounded(count + 4)) * self.magnitudes

    def summed(self, readings, at=0.0):
        """Return the sum of the terms that were read, and what rounding does to it."""
        lost = self.rounded @ np.abs(readings) + 4 * U * np.abs(at * self.held)
        return self.c @ readings + at * self.held, lost

    def values(self, terms):
        """Return what receivers read of S^-1 f, or of a motion, and bounds of the errors."""
        value, rounded = self.summed(terms.readings, terms.at)
        wrong = self.magnitudes @ terms.lost
        if terms.eps is not None:
            wrong = min(wrong, self.sharp @ terms.eps)
        wrong = 1.001 * (wrong + self.magnitudes @ terms.missed)
        wrong += (self.left + self.shifted) * terms.size + self.spread * terms.astray
        bound = wrong * terms.sizes + rounded
        return value, (1 + 16 * U) * bound + 16 * U * np.abs(value)


def expansion(above, below):
    """Return ln rho and C of a w, from w + 1 and w - 1."""
    p, q = np.sqrt(np.stack([above, below]) / 2 + 0j)
    q = np.where(np.abs(p + q) < 1, -q, q)
    with np.errstate(all="ignore"):
        return 2 * np.log(p + q), 1 / (p * q)


def ratios(logarithm, centred):
    """Return no less than rho_0 / |rho|."""
    return np.exp(centred.real - logarithm.real * (1 - 64 * U) + 64 * U)
