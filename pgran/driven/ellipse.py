"""Values d^T S^-1 f for any dashpots and drag from one recurrence, K semidefinite, Re s >= 0.

With y = (u, v) and the matrices K, C per mass, drag in C,

    G = [[0, 1], [-K, -C]],    (s - G) y = y_0:    S^-1 f = v / s  of y_0 = (0, f),

and a motion of a wall, whose force is f_k + s f_c, has y_0 = (f_c, f_k - C f_c), u = (v + f_c) / s.
In the energy norm |y|^2 = u K u + v v the numerical range of G lies in an ellipse: of a y of norm
1, with |v|^2 = t, v C v = c t, and K <= r C, r the largest k / dashpot of a spring,

    <G y, y> = -c t + 2 i Im(v K u),    |Im| <= 2 (min(Omega^2, r c) t (1 - t))^(1/2),

so that right of -c*/2, c* = min(|C|, Omega^2 / r), it lies in a half ellipse about -c*/2 of the
axes c*/2 and Omega, left of -|C|/2 in one about -|C|/2 of |C|/2 and Omega, and between them within
Omega of the real axis. An ellipse about c_0 of the axes a < b that holds these has the foci
c_0 +- i kappa, kappa^2 = b^2 - a^2. The polynomials P_n = i^n T_n((G - c_0) / (i kappa)) are at
most rho_0^n, rho_0 = (a + b) / kappa, as Faber's of a convex set are at most 2 (B. Beckermann,
C. R. Acad. Sci. Paris 340, 855 (2005)), and

    (s - G)^-1 = (w - X)^-1 / (i kappa),    X = (G - c_0) / (i kappa),    w = (s - c_0) / (i kappa),

in the terms of `series`, of which y_n = P_n y_0 / rho_0^n are real:
y_(n+1) = (2 / (kappa rho_0)) (G - c_0) y_n + rho_0^-2 y_(n-1).
"""

import math

import numpy as np

from pgran.driven.operators import unchanged
from pgran.driven.recurrence import NoSeriesError, Recurrence, U, compounded
from pgran.driven.series import Series, expansion, ratios

WORST = 1e9  # of what falls never


class Ellipse:
    """An ellipse about the range of G: its centre c_0, semi-axes a along the real axis, and b.

    Collective. The one of some whose series converges best at the worst s; any is a proof: Omega
    has been enclosed with more room than what rounding does to the foci takes. Raises a
    NoSeriesError where motions are overdamped, so that none has its foci beside the real axis.
    """

    def __init__(self, Omega, dashpots, rate, s, comm):
        self.Omega, self.dashpots, self.s = Omega, dashpots, s
        self.least = min(dashpots, Omega**2 / rate) * (1 - 1e-12)  # c*
        self.centre, self.a, self.b = 0.0, 0.0, Omega
        if dashpots:
            from scipy.optimize import minimize

            starts = [(p, q) for p in (-8.0, -4.0, -1.0) for q in (-1.5, 0.0, 1.5)]
            found = [minimize(self._slowest, at, method="Nelder-Mead") for at in starts]
            best = min(found, key=lambda each: each.fun).x
            # one for all ranks: a search may end elsewhere where another machine rounds differently
            self.centre, self.a, self.b = comm.bcast(self._axes(best))
        if not self.a < self.b:
            raise NoSeriesError("overdamped motions, for which no ellipse is narrow enough")
        self.kappa = math.sqrt((self.b - self.a) * (self.b + self.a))
        self.rho0 = (self.a + self.b) / self.kappa * (1 + 8 * U)

    def rates(self, s):
        """Return how fast the series falls at each s, the logarithm of a term's ratio."""
        return _rates(s, self.centre, self.a, self.b)

    def _axes(self, at):
        """Return centre and axes of an ellipse that holds the range, one for each pair of reals."""
        wider, turned = np.clip(at, -30.0, (3.0, 30.0))
        b = self.Omega * (1 + math.exp(wider))
        centre = -self.dashpots / (1 + math.exp(-turned))
        inside = (self.Omega / b) ** 2, (b - self.Omega) * (b + self.Omega) / b**2
        caps = (
            (-self.least / 2 - centre, self.least / 2),
            (self.dashpots / 2 + centre, self.dashpots / 2),
        )
        square = max(_cap(*cap, *inside) for cap in caps)
        return centre, math.sqrt(square) * (1 + 1e-12), b

    def _slowest(self, at):
        """Return minus the rate at which the series falls at the worst s."""
        centre, a, b = self._axes(at)
        return -np.min(_rates(self.s, centre, a, b)) if a < b else WORST


def _rates(s, centre, a, b):
    """Return how fast the series of an ellipse falls at each s."""
    kappa = math.sqrt((b - a) * (b + a))
    w = (s - centre) / (1j * kappa)
    rho = np.abs(np.sqrt((w + 1) / 2) + np.sqrt((w - 1) / 2))
    return 2 * np.log(np.maximum(rho, 1 / rho)) - math.log((a + b) / kappa)


def _cap(start, reach, inside, rest):
    """Return the largest (start + reach t)^2 / (rest + inside t^2), 0 <= t <= 1; rest = 1 - inside.

    That difference would cancel.
    """
    middle = reach * rest / (start * inside) if start else 1.0
    places = 0.0, 1.0, min(max(middle, 0.0), 1.0)
    return max((start + reach * t) ** 2 / (rest + inside * t * t) for t in places)


class Faber(Series):
    """The series of a medium with any dashpots. Collective when made.

    `s` are those that are asked for, which the ellipse is fitted to. Raises a NoSeriesError where
    there is none. A norm has two parts, of u and of v, which is read.
    """

    parts = 2

    def __init__(self, rows, medium, s):
        from scipy.sparse import bmat, diags, eye

        if medium.losses is not None or not medium.semidefinite:
            what = "pre-stress" if medium.losses is None else "loss angles"
            raise NoSeriesError(f"{what} beside other damping, or under a drive")
        self.mass, rounding = medium.mass, medium.rounding
        one = eye(rows.own, rows.width, format="csr")
        K, sizes = (rows.matrix(medium.constants, size) / self.mass for size in (unchanged, np.abs))
        self.Omega, self.dashpots, C = math.sqrt(rows.enclosed(sizes, rounding)), 0.0, 0.0 * one
        if medium.dissipates:
            unit = medium.damping_unit / self.mass
            dragged = np.broadcast_to(medium.dragged, medium.size).reshape(medium.shape)
            drag = diags(rows.layout.free_values(dragged), shape=one.shape)
            C, sizes = (
                unit * (rows.matrix(medium.dashpots, size) + drag) for size in (unchanged, np.abs)
            )
            self.dashpots = rows.enclosed(sizes, rounding)
        rate = medium.relaxation_rate or math.inf
        self.ellipse = ellipse = Ellipse(self.Omega, self.dashpots, rate, s, rows.comm)
        self.made = ellipse.centre, ellipse.a, ellipse.b
        self.centred = complex(math.log(ellipse.rho0), -math.pi / 2)
        self.step = step = 2 / (ellipse.kappa * ellipse.rho0)
        c0 = ellipse.centre
        H = bmat([[-c0 * one, one], [-K, -(C + c0 * one)]], format="csr") * step
        self.dashpot, self.recurrence = C, Recurrence(rows, H, ellipse.rho0**-2)
        self.known = rounding + compounded(rows.largest(np.diff(H.indptr)) + 8)
        self.read_by(0, rows.comm)
        logarithm, _ = expansion(*self._ends(s))
        self.rates = -np.log(ratios(logarithm, self.centred))

    def start(self, force):
        """Return y_0 of a force."""
        return np.stack([0.0 * force, force / self.mass])

    def size_of(self, norms):
        """Return no less than |y_0|, from the norms of its parts."""
        return self.Omega * norms[0] + norms[1]

    def losses(self, norms):
        """Return eps_n, (count,), of terms of these norms, (count, 2), in the energy norm."""
        (u, v), before = norms.T, np.concatenate([[[0.0, 0.0]], norms[:-1]]).T
        c0 = abs(self.ellipse.centre)
        du = self.step * 10 * U * (v + c0 * u) + 5 * U * before[0]
        pulled = self.known * (self.Omega**2 * u + self.dashpots * v) + 10 * U * c0 * v
        return self.Omega * du + self.step * pulled + 5 * U * before[1]

    def at(self, s, count):
        """Let values be at an s, by so many terms."""
        kappa, self.s = self.ellipse.kappa, s
        inverse = kappa / s.real if s.real > 0 else math.inf
        self.expand(self._ends(s), 1 / (1j * kappa * s), inverse, count)
        self.held, inverse = 1 / s, self.inverse / kappa
        shifts = abs(s) + abs(self.ellipse.centre) + kappa
        self.shifted = 8 * U * shifts * inverse**2 / abs(s)
        self.spread = (inverse + 1 / self.Omega) / abs(s)

    def slopes(self, terms, found):
        """Return derivatives by s of what `values` has `found`, and bounds of their errors.

        With dw/ds = 1 / (i kappa), d ln rho / dw = C / 2 and dC / dw = -w C^3 / 4.
        """
        n, q, kappa = np.arange(len(self.c)), self.ratio, self.ellipse.kappa
        by_size = (self.s - self.ellipse.centre) / (1j * kappa) * self.C**2 / 4
        slope = -self.c * (by_size + n * self.C / 2) / (1j * kappa) @ terms.readings
        by_size, by_power = abs(by_size) / kappa, abs(self.C) / (2 * kappa)
        steeper = (by_size + n * by_power) * (1 + 64 * U)
        left = self.left * (by_size + by_power * (len(n) + q / (1 - q))) if q < 1 else math.inf
        bound = 1.001 * (self.magnitudes * steeper) @ (terms.lost + terms.missed)
        bound += left * terms.size
        # that of (s - G)^-1 is -(s - G)^-2
        bound += 4 * self.inverse / kappa * (self.shifted * terms.size + self.spread * terms.astray)
        rounded = ((self.rounded + 64 * U * self.magnitudes) * steeper) @ np.abs(terms.readings)
        value, wrong = found
        bound = bound * terms.sizes + rounded + wrong / abs(self.s)
        slope = slope - value / self.s
        return slope, (1 + 16 * U) * bound + 8 * U * (np.abs(slope) + np.abs(value / self.s))

    def _ends(self, s):
        """Return w + 1 and w - 1."""
        w = (s - self.ellipse.centre) / (1j * self.ellipse.kappa)
        return w + 1, w - 1

    def summed_sizes(self, s):
        """Return no less than |(s - G)^-1|, and any of its sums, at some s."""
        logarithm, C = expansion(*self._ends(s))
        ratio = ratios(logarithm, self.centred)
        with np.errstate(divide="ignore"):
            return np.where(ratio < 1, np.abs(C) / self.ellipse.kappa / (1 - ratio), np.inf)
