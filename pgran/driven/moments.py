"""What patterns pass on, e^T S^-1 f at any s, from one recurrence of K for each f.

Where all damping is a function of K, loss angles eta, dashpots of tau times each constant, one
drag alpha,

    S(s) = kappa (K - m z),    kappa = 1 + i eta + s tau,    z = -(s^2 + s alpha) / kappa.

With low <= K <= high for certain, X = (a K - b) / 2 has its eigenvalues between -1 and 1, and

    K - m z = (2 / a) (X - w),    w = (a m z - b) / 2,    S^-1 = -(a / 2 kappa) (w - X)^-1:

every s takes the same moments e^T T_n(X) f, a product of K each, in the sum of `series`, where
rho_0 = 1. If e is f, a product gives two moments: m_2n = 2 t_n . t_n - m_0 and m_2n+1 =
2 t_n . t_(n+1) - m_1. Dense in frequencies, this is the kernel polynomial method (A. Weisse et al.,
Reviews of Modern Physics 78, 275 (2006)) without its kernel, as all s with a real part or damping
converge.
"""

import math

import numpy as np

from pgran.driven.recurrence import Recurrence, U, compounded, dot
from pgran.driven.series import Series, Terms, expansion, ratios

PROPORTIONAL = 1e-14  # relative: how exactly dashpots are in proportion to constants


class Chebyshev(Series):
    """The series of a medium whose damping is a function of K. Collective when made.

    `law` is what `law_of` says of it, `s` are all that values will be asked for.
    """

    doubling = 2
    known = 16 * U  # forces and what reads them, as both are rounded

    def __init__(self, rows, medium, law, s):
        self.eta, self.tau, self.alpha = law
        self.mass, constants, rounding = medium.mass, medium.constants, medium.rounding
        K, sizes = rows.matrix(constants), rows.matrix(constants, np.abs)
        high, low = rows.enclosed(sizes, rounding), 0.0
        if constants.min() < 0:
            low = -rows.enclosed(rows.matrix(np.minimum(constants, 0.0), np.abs), rounding)
        a = self.a = 4 * (1 - 8 * U) / (high - low)
        b = self.b = a * (high + low) / 2 if low else 2.0
        self.high, self.made = high, (a, b)
        K.data *= a
        K.setdiag(K.diagonal() - b)
        self.recurrence = Recurrence(rows, K)
        self.read_by(0, rows.comm)
        # |e_n| <= mu1 |t_n| + mu0 |t_(n-1)|, as constants are known to `rounding`
        width = rows.largest(np.diff(K.indptr))
        norm = rows.largest(abs(K).sum(axis=1)) * (1 + 2 * width * U)
        self.mu0 = compounded(width + 4)
        self.mu1 = rounding * a * high + 4 * U * (a * high + abs(b)) + self.mu0 * norm
        logarithm, _ = expansion(*self._ends(np.asarray(s)))
        self.rates = -np.log(ratios(logarithm, self.centred))

    def start(self, force):
        """Return y_0 of a force."""
        return force[None]

    def size_of(self, norms):
        """Return no less than |y_0|, from the norms of its fields."""
        return norms[0]

    def losses(self, norms):
        """Return eps_n, (count,), of terms of these norms, (count, 1)."""
        eps = self.mu1 * norms[:, 0]
        eps[1:] += self.mu0 * norms[:-1, 0]
        eps[0] /= 2
        return eps

    def read(self, force, read, count):
        """See `Series`; of the source itself t_(n-1) . t_n are read, n <= count / 2."""
        if read is not None:
            return super().read(force, read, count)
        before = [force]

        def crossed(now):
            before.append(now)
            return np.array([dot(before.pop(0), now)])

        return self.recurrence.read(force[None], crossed, count // 2 + 1)

    def terms(self, readings, norms, sizes, **more):
        """See `Series`."""
        if sizes is not None:
            return super().terms(readings, norms, sizes, **more)
        lost, crossed = super().terms(readings, norms, 1.0).lost, readings[1:, 0]
        n0, n1, e0, e1 = norms[:-1, 0], norms[1:, 0], lost[:-1], lost[1:]
        # products are wrong by `dot` of these norms, and by what their terms are
        first, square = self.dot * n0[0] * n1[0] + n0[0] * e1[0], n0[0] ** 2
        moments, errors = np.empty((2, 2 * len(crossed)))
        moments[0::2] = 2 * n0**2 - square
        moments[1::2] = 2 * crossed - crossed[0]
        errors[0::2] = 4 * n0 * e0 + 2 * e0**2 + self.dot * (2 * n0**2 + square)
        errors[1::2] = 2 * (n1 * e0 + n0 * e1 + e0 * e1) + 2 * self.dot * n0 * n1 + first
        errors += 4 * U * np.abs(moments)
        moments[:2], errors[:2] = (square, crossed[0]), (self.dot * square, first)
        astray, none = self.known * square, np.zeros(len(moments))
        return Terms(moments[:, None], None, errors, none, square, astray, np.ones(1), 0.0)

    def at(self, s, count):
        """Let values be at an s, by so many moments."""
        kappa, (above, below) = 1 + 1j * self.eta + s * self.tau, self._ends(s)
        # of w from [-1, 1], each end as it is computed
        gap = abs(above) if above.real < 0 else abs(below) if below.real > 0 else abs(above.imag)
        gap *= 1 - 64 * U
        weight, inverse = -self.a / (2 * kappa), 1 / gap if gap else math.inf
        self.expand((above, below), weight, inverse, count)
        self.spread = abs(weight) * self.inverse
        # a m z is wrong by 15 U at most, of itself, so w - 1 and w + 1 by half of that, which is
        # little of them at the lower end, where b = 2; K by what dashpots miss of their proportion,
        # as rounding lets them
        lost = 1.1 * PROPORTIONAL * (abs(s) * self.tau + self.eta) * self.high / abs(kappa)
        wrong = self.a * lost / 2 + 16 * U * (abs(above) + abs(self.b - 2))
        safe = gap > wrong
        self.shifted = abs(weight) * wrong / (gap * (gap - wrong)) if safe else math.inf

    def _ends(self, s):
        """Return w + 1 and w - 1, each from z, as their difference would cancel."""
        z = -(s * s + s * self.alpha) / (1 + 1j * self.eta + s * self.tau)
        ends = self.a * self.mass * z - (self.b - 2), self.a * self.mass * z - (self.b + 2)
        return ends[0] / 2, ends[1] / 2


def law_of(medium):
    """Return eta, tau, alpha of a medium whose damping is a function of K, else None."""
    k, laws = medium.constants, []
    damped = medium.damping * medium.damped_springs if medium.damping else None
    for dashpots in (medium.losses, damped):
        share = 0.0 if dashpots is None else float(dashpots @ k / (k @ k))
        if dashpots is not None:
            apart = np.abs(dashpots - share * k)  # all of it, where springs of no stiffness damp
            if share < 0 or np.any(apart > PROPORTIONAL * np.abs(share * k)):
                return None
        laws.append(share)
    drags = medium.drags
    if drags is not None and np.ptp(drags):
        return None
    return *laws, 0.0 if drags is None else float(np.ravel(drags)[0])
