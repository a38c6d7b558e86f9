"""Damped modes S(s) x = 0, S(s) = K + s C + s^2 m, proven of the matrices as they are stored.

All of them. S is symmetric: with V of the columns (x, s x), W of the rows (x^T (C + s m), x^T m),
P = W V, F = X^T (K X + C X D + m X D^2) and D = diag(s), the linearisation of S is similar to
D - P^-1 F, whose eigenvalues Gershgorin's circles enclose.

One of them. A mode s*, x* is a zero of (S(s*) x*, w v^T (x* - x)). With v = S'(s) x, its derivative
at s / w and x, J = [[S, w v], [w v^T, 0]], is complex symmetric: |J^-1| <= 1 / c by a count
(`singular`). It is Lipschitz with some L, and where eta = |S x| / c has L eta / c <= 1/2, there is
one zero within 2 eta (Kantorovich), and (s* - s) (v + m (s* - s) x)^T x* = -(S x)^T x*.

Those within R of zero. Let C have its eigenvalues from 0 to c, and K - R C + R^2 m be positive
definite. A mode of K + s t C + s^2 m, 0 <= t <= 1, with |s| = R is then not real, and
|K x - m R^2 x| = R t |C x - (x^H C x) x| <= R c / 2. If no eigenvalue of K is that near to m R^2,
as many modes are within R for t = 1 as for t = 0: two for each eigenvalue of K below m R^2.

Those in a circle. Around it, the phase of det S grows by 2 pi for each, at any place by no more
than |tr(S^-1 S')|, so than |S'| times the sum of 1 / sigma over all singular values of S: counts
tell how many are below a level, and none changes faster than S. Where that leaves less than pi from
point to point, phases tell the growth.
"""

import contextlib
import itertools
import math

import numpy as np

from pgran.driven.factors import RealFactors, doubled, least_estimate, proven_least
from pgran.medium.base import EPSILON
from pgran.medium.graph import elimination_order
from pgran.medium.springs import SYMMETRIC

MARGIN = 1.01  # covers the rounding of the bounds themselves
NEAR = 1e-8  # of |C| and |K|: how sharply eigenvalues are counted
AHEAD = 1e-5  # rad: how far the phase tells its derivative; no arc is shorter
LEVELS = 12  # at which singular values are counted, each four times the last one
MOST = 10_000  # points of a circle at which S is factored
AGREE, CHANGE = 0.5, 2.0  # how far log det S may be from its trapezoid, and that may bend


def discs(K, C, m, s, X):
    """Return radii of discs around all modes of a small system; infinite where nothing is proven.

    As many modes as discs are in each part that overlapping discs cover. Where modes do not span,
    as at critical damping, none is proven. K and C are sparse and symmetric, K may be complex;
    s (2 n,) and X (n, 2 n) are approximate, columns of X of any length.
    """
    from scipy.sparse import diags

    pencil, a = Quadratic(K, C, m), np.abs(s)
    long = pencil.unit + 1.5 * EPSILON * len(s)  # of sums over all modes
    with np.errstate(all="ignore"):
        X = X[pencil.order] / np.linalg.norm(X, axis=0)
        CX = pencil.C @ X
        R = pencil.K @ X + CX * s + m * X * (s * s)
        P = np.concatenate([CX + m * s * X, m * X]).T @ np.concatenate([X, s * X])
        F = X.T @ R
        # what rounding adds to sums along rows of |P| and |F|, by sums of magnitudes
        (K, C), x = pencil.sizes, np.abs(X)
        rows, once, twice = x.sum(axis=1), x @ a, x @ (a * a)
        wrong_P = long * ((C @ x + m * x * a).T @ rows + m * (x.T @ once))
        wrong_R = pencil.unit * (K @ rows + C @ once + m * twice)
        wrong_F = x.T @ (long * np.abs(R).sum(axis=1) + wrong_R)
        # P^-1 F = (Q P)^-1 Q F for any Q; several modes of one s are mixed in P
        Q, one = diags(1 / P.diagonal()), np.eye(len(s))
        if not np.abs(Q @ P - one).sum(axis=1).max() < 0.5:
            with contextlib.suppress(np.linalg.LinAlgError):
                Q = np.linalg.inv(P)
        apart = np.abs(Q @ P - one).sum(axis=1)
        apart += abs(Q) @ (wrong_P + long * np.abs(P).sum(axis=1))
        sums = np.abs(Q @ F).sum(axis=1) + abs(Q) @ (wrong_F + long * np.abs(F).sum(axis=1))
        delta = MARGIN * apart.max()
        radii = MARGIN * (sums + delta / (1 - delta) * sums.max())
    return radii if delta < 1 and np.all(np.isfinite(radii)) else np.full(len(s), np.inf)


class Quadratic:
    """S(s), numbered in the order of elimination, and norms that bound it."""

    def __init__(self, K, C, m):
        from scipy.sparse import csc_matrix, identity

        self.m, self.size = m, K.shape[0]
        self.one = identity(self.size, format="csc")
        self.order = elimination_order((abs(K) + abs(C) + self.one).tocsr())
        self.K, self.C = (csc_matrix(A)[self.order][:, self.order] for A in (K, C))
        self.sizes = abs(self.K), abs(self.C)
        # sums of complex products along rows are wrong by this part of their magnitudes
        self.unit = EPSILON * (1.5 * max(np.diff(A.indptr).max() for A in self.sizes) + 20)
        self.norms = [MARGIN * float(A.sum(axis=0).max()) for A in self.sizes]

    def at(self, s):
        """Return S(s), complex."""
        s = complex(s)
        S = (self.K + s * self.C + (s * s * self.m) * self.one).tocsc()
        S.sort_indices()
        return S

    def slope(self, size):
        """Return no less than |S'| and than |S(s) - S(z)| / |s - z| where |s|, |z| <= size."""
        return self.norms[1] + 2 * self.m * size

    def rounding(self, size):
        """Return how far `at` is from S(s) at most, in the 2-norm, where |s| <= size."""
        return 8 * EPSILON * (self.norms[0] + size * self.norms[1] + size * size * self.m)


def radii(K, C, m, s, X):
    """Return how near to each of some modes one is for certain; infinite where none is proven."""
    pencil, X = Quadratic(K, C, m), X / np.linalg.norm(X, axis=0)
    return np.array([_radius(pencil, *mode) for mode in zip(s, X[pencil.order].T, strict=True)])


def _radius(pencil, s, x):
    """Return how near to s a mode is; infinite if none is proven."""
    from scipy.sparse import bmat
    from scipy.sparse.linalg import splu

    m, size, w = pencil.m, abs(s), abs(s) or 1.0
    (K, C), a = pencil.sizes, np.abs(x)
    r, v = pencil.K @ x + s * (pencil.C @ x) + s * s * m * x, pencil.C @ x + 2 * s * m * x
    wrong_r = pencil.unit * np.linalg.norm(K @ a + size * (C @ a) + size * size * m * a)
    wrong_v = pencil.unit * np.linalg.norm(C @ a + 2 * size * m * a)
    border = (w * v)[:, None]
    J = bmat([[pencil.at(s), border], [border.T, None]], "csc")
    J.sort_indices()
    try:  # at a mode the last pivot of S is nearly zero: its row is moved
        factors = splu(J, "NATURAL", **SYMMETRIC | {"diag_pivot_thresh": 1e-8})
    except RuntimeError:  # as SuperLU says of what is singular
        return np.inf
    estimate = least_estimate(factors.solve, len(x) + 1)
    c = proven_least(J, 0.5 * estimate, pencil.rounding(size) + w * wrong_v)
    norm_r = MARGIN * (np.linalg.norm(r) + wrong_r)
    eta = norm_r / c if c > 0 else np.inf
    dx, ds = 2 * eta, 2 * w * eta
    lipschitz = w * pencil.slope(size + ds) + 2 * m * w * w * (MARGIN + dx)
    if not (dx < 0.5 and MARGIN * lipschitz * eta <= 0.5 * c):
        return np.inf
    # |x| <= MARGIN, |x*| < 2, and the products of vectors are off by this part of their norms
    off = (2 * len(x) + 4) * EPSILON
    above = abs(r @ x) + wrong_r + (dx + off) * norm_r
    below = abs(v @ x) - off * np.linalg.norm(v) - 2 * wrong_v - 3 * m * ds
    return MARGIN**2 * (min(ds, above / below) if below > 0 else ds)


def number_below(K, C, m, R):
    """Return how many modes have |s| < R, proven; None where K, which is real, has no gap there."""
    if np.iscomplexobj(K):
        return None
    pencil = Quadratic(K, C, m)
    norm_K, norm_C = pencil.norms
    clear = 0.05 * R * norm_C + NEAR * norm_K
    half = 0.5 * MARGIN * R * norm_C + clear
    try:
        damping = RealFactors(pencil.C, -NEAR * norm_C)
        real = RealFactors((pencil.K - R * pencil.C).tocsc(), clear - m * R * R)
        low, high = (RealFactors(pencil.K, m * R * R + side) for side in (-half, half))
    except ZeroDivisionError:
        return None
    wrong = max(each.error(clear / 4) for each in (real, low, high)) + pencil.rounding(R)
    certain = damping.error() < NEAR * norm_C and wrong < clear / 2
    empty = damping.negative == real.negative == 0 and low.negative == high.negative
    return 2 * low.negative if certain and empty else None


def number_within(K, C, m, centre, radius, proven=False):
    """Return how many modes are in a circle; None where that stays open, as with one at the rim.

    They are counted by the phase of det S and its derivative; or proven, which takes some counts
    and a thousand factorizations and more, the nearer modes are to the rim.
    """
    ring = (ProvenRing if proven else Ring)(Quadratic(K, C, m), centre, radius)
    try:
        parts = [_grown(ring, k * math.pi / 8, (k + 1) * math.pi / 8) for k in range(16)]
        return round(sum(parts) / (2 * math.pi))
    except ArithmeticError:
        return None


def _grown(ring, start, end):
    """Return the growth of the phase along an arc, summed over halves where it is None."""
    if (grown := ring.growth(start, end)) is not None:
        return grown
    if end - start < AHEAD:
        raise ArithmeticError("a mode at the rim")
    middle = (start + end) / 2
    return _grown(ring, start, middle) + _grown(ring, middle, end)


class Ring:
    """The phase of det S on a circle, told by its derivative: where a trapezoid fits, none is lost.

    A mode within half the arc of it would bend the logarithm's derivative by more than CHANGE.
    """

    def __init__(self, pencil, centre, radius):
        self.pencil, self.centre, self.radius = pencil, centre, radius
        self._points, self._known = itertools.count(), {}

    def factors(self, angle):
        """Return the factors of S at an angle."""
        return RealFactors(self.matrix(angle), 0.0)

    def matrix(self, angle):
        """Return S at an angle."""
        if next(self._points) == MOST:
            raise ArithmeticError("too many points")
        return self.pencil.at(self.centre + self.radius * np.exp(1j * angle))

    def logarithm(self, angle):
        """Return log det S at an angle, and its derivative along the circle."""
        if angle not in self._known:
            here, ahead = (_logarithm(self.factors(a)) for a in (angle, angle + AHEAD))
            self._known[angle] = here, _wrapped(ahead - here) / AHEAD
        return self._known[angle]

    def growth(self, start, end):
        """Return by how much the phase grows along an arc, None where that is too long to tell."""
        (first, slope), (last, slope_last) = self.logarithm(start), self.logarithm(end)
        trapezoid = (end - start) * (slope + slope_last) / 2
        off = _wrapped(last - first - trapezoid)
        coarse = abs(off) > AGREE or (end - start) * abs(slope - slope_last) > CHANGE
        return None if coarse else (trapezoid + off).imag


class ProvenRing(Ring):
    """The same, proven: between two points the phase cannot turn by pi."""

    def __init__(self, pencil, centre, radius):
        super().__init__(pencil, centre, radius)
        size = abs(centre) + radius
        self.slope = radius * pencil.slope(size)  # for each rad
        self.blur = pencil.rounding(size) + 32 * EPSILON * size * pencil.slope(size)

    def growth(self, start, end):
        """Return by how much the phase grows along an arc, None where that is too long to tell."""
        apart = self.slope * (end - start) / 2  # of S along the arc from S in its middle
        most = self._inverses(self.matrix((start + end) / 2), apart)
        if most is None:
            return None
        # so many points that the phase turns by less than 2 rad from one to the next
        phases = []
        for angle in np.linspace(start, end, 2 + int(apart * most)):
            factors = self.factors(angle)
            wrong = factors.error(0.1 / most) + self.blur
            if not 2 * most * wrong + 100 * EPSILON * self.pencil.size < 0.5:
                raise ArithmeticError("inaccurate factors")
            phases.append(_logarithm(factors).imag)
        return sum(math.remainder(step, 2 * math.pi) for step in np.diff(phases))

    def _inverses(self, S, apart):
        """Return what no sum of 1 / sigma, so near to S, is above; None if it may be infinite.

        Singular values between two levels count as if they were at the lower one, each level
        lowered by what it may be wrong; those above the last level as if they were there.
        """
        size, total, counted, clear = self.pencil.size, 0.0, 0, np.inf
        for level in 2 * apart * 4.0 ** np.arange(LEVELS):
            factors = RealFactors(doubled(S), level)
            last, clear = clear, level - factors.error(0.1 * level) - self.blur - apart
            if not clear > 0:
                return None
            below = factors.negative - size
            if last == np.inf and below > 0:
                return None
            total += (below - counted) / last
            counted = below
            if size - counted < clear * total:  # those left add less than is there
                break
        return MARGIN * (total + (size - counted) / clear)


def _logarithm(factors):
    """Return the logarithm of a determinant."""
    if factors.pivots is None:
        raise ArithmeticError("rows were moved")
    return complex(np.log(factors.pivots).sum())


def _wrapped(step):
    """Return a step of a logarithm, its phase between -pi and pi."""
    return complex(step.real, math.remainder(step.imag, 2 * math.pi))
