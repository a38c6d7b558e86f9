"""Damped modes S(s) x = 0, S(s) = K + s C + s^2 m, proven of the matrices as they are stored.

All of them. The columns of V are (x, s x), W has the rows (x^T (C + s m), x^T m), so that W V is 1
but for errors (S is symmetric). With P = W V and F = X^T (K X + C X D + m X D^2), D = diag(s), the
linearisation of S is similar to D - P^-1 F, and Gershgorin's circles enclose its eigenvalues.

One of them. A mode s*, x* is a zero of (S(s*) x*, w v^T (x* - x)). With v = S'(s) x, its derivative
at s / w and x, J = [[S, w v], [w v^T, 0]], is complex symmetric: |J^-1| <= 1 / c by a count
(`singular`). It is Lipschitz with some L, and where eta = |S x| / c has L eta / c <= 1/2, there is
one zero within 2 eta (Kantorovich). From x^T S(s*) x* = 0 follows how far s* is from s:
(s* - s) (v + m (s* - s) x)^T x* = -(S x)^T x*.

How many are within R of zero. Let C have its eigenvalues from 0 to c, and K - R C + R^2 m be
positive definite. A mode of K + s t C + s^2 m, 0 <= t <= 1, with |s| = R is then not real, and
|K x - m R^2 x| = R t |C x - (x^H C x) x| <= R c / 2. If no eigenvalue of K is that near to m R^2,
as many modes are within R for t = 1 as for t = 0: two for each eigenvalue of K below m R^2.

How many are in a circle. In the ring |log(|z - centre| / radius)| < a let there be none, and
|(z - centre) tr(S^-1 S')| <= M. This function's mean over the circle is their number, and so is,
but for 2 M / (e^(a Q) - 1), that over Q points (L. Trefethen, J. Weideman, SIAM Review 56, 2014),
even if at each an average over an arc is taken: what the phase of det S grows by along the arc. The
ring is proven empty by counts: where |S^-1| <= 1 / c, none is within c / |S'|.
"""

import math
from functools import cache

import numpy as np

from pgran.driven.inertia import RealFactors
from pgran.driven.singular import doubled, least_estimate, proven_least
from pgran.medium.graph import SYMMETRIC
from pgran.medium.ordering import elimination_order
from pgran.medium.rounding import EPSILON

MARGIN = 1.01  # covers the rounding of the bounds themselves
STIFF = 0.01  # of its terms: a smaller x^T (2 s m + C) x does not normalise x
PARTS = (0.9, 0.5, 0.1)  # of an estimate of the smallest singular value that are tried
NEAR = 1e-8  # of |C| and |K|: how sharply eigenvalues are counted
ARCS, POINTS = 3000, 20_000  # of a circle, at most
AHEAD = 1e-5  # rad: how far along a circle the phase tells its derivative
TURN = 1.0  # rad: by how much a pivot may turn along an arc
AGREE, CHANGE = 0.5, 2.0  # rad: how far a phase may be from its trapezoid, and that may bend
OFF, WRONG = 0.1, 0.3  # how far the trapezoid rule and rounding may be from the number


def discs(K, C, m, s, X):
    """Return radii of discs around all modes of a small system; infinite where nothing is proven.

    Discs that overlap, and are apart from all others, hold as many modes as they are discs. Where
    modes do not span, as at critical damping, none is proven.

    Parameters
    ----------
    K, C : scipy.sparse matrix, shape (n, n)
        Symmetric, K possibly complex.
    m : float
    s : ndarray of complex, shape (2 n,)
    X : ndarray of complex, shape (n, 2 n)
        Approximate modes as columns, of any length.
    """
    nothing, one = np.full(len(s), np.inf), np.eye(len(s))
    with np.errstate(all="ignore"):
        forces = C @ X + 2 * m * s * X
        own, size = np.sum(X * forces, axis=0), np.sum(np.abs(X * forces), axis=0)
        X = X / np.sqrt(np.where(np.abs(own) > STIFF * size, own, size + 0j))
        CX = C @ X
        R = K @ X + CX * s + m * X * (s * s)
        P = np.concatenate([CX + m * s * X, m * X]).T @ np.concatenate([X, s * X])
        F = X.T @ R
        # what rounding does to sums along rows of |P| and |F|: part of the sums of magnitudes
        x, a, k, c = np.abs(X), np.abs(s), abs(K), abs(C)
        rows, once, twice = x.sum(axis=1), x @ a, x @ (a * a)
        few = _unit(K, C)
        unit = few + 1.5 * EPSILON * len(s)
        wrong_P = unit * ((c @ x + m * x * a).T @ rows + m * (x.T @ once))
        wrong_R = few * (k @ rows + c @ once + m * twice)
        wrong_F = x.T @ (unit * np.abs(R).sum(axis=1) + wrong_R)
        if not np.abs(P - one).sum(axis=1).max() < 0.5:  # several modes of one s
            try:
                Q = np.linalg.inv(P)
            except np.linalg.LinAlgError:
                return nothing
            wrong_P = np.abs(Q) @ (wrong_P + unit * np.abs(P).sum(axis=1))
            wrong_F = np.abs(Q) @ (wrong_F + unit * np.abs(F).sum(axis=1))
            P, F = Q @ P, Q @ F
        delta = MARGIN * (np.abs(P - one).sum(axis=1) + wrong_P).max()
        sums = np.abs(F).sum(axis=1) + wrong_F
        radii = MARGIN * (sums + delta / (1 - delta) * sums.max())
    return radii if delta < 1 and np.all(np.isfinite(radii)) else nothing


def _unit(*matrices):
    """Return how far sums of complex products along rows may be off, as part of magnitudes."""
    return EPSILON * (1.5 * max((A != 0).sum(axis=1).max() for A in matrices) + 20)


class Quadratic:
    """S(s), numbered in the order of elimination, and norms that bound it."""

    def __init__(self, K, C, m):
        """Put unknowns in order."""
        from scipy.sparse import csc_matrix, identity

        self.m, self.size = m, K.shape[0]
        self.one = identity(self.size, format="csc")
        self.order = elimination_order((abs(K) + abs(C) + self.one).tocsr())
        self.K, self.C = (csc_matrix(A)[self.order][:, self.order] for A in (K, C))
        self.sizes, self.unit = (abs(self.K), abs(self.C)), _unit(K, C)
        self.norms = [MARGIN * float(A.sum(axis=0).max()) for A in self.sizes]

    def at(self, s):
        """Return S(s)."""
        S = (self.K + s * self.C + (s * s * self.m) * self.one).tocsc()
        S.sort_indices()
        return S

    def slope(self, size):
        """Return no less than |S'| and than |S(s) - S(z)| / |s - z| where |s|, |z| <= size."""
        return self.norms[1] + 2 * self.m * size

    def rounding(self, size):
        """Return how far `at` is from S(s) at most, in the 2-norm, where |s| <= size."""
        return 8 * EPSILON * (self.norms[0] + size * self.norms[1] + size * size * self.m)


def _least(S, rounding, threshold=0.0):
    """Return what no singular value of S, known but for `rounding`, is below; 0 if uncertain.

    Factors, whose rows are moved where pivots are below a threshold, tell where to count.
    """
    from scipy.sparse.linalg import splu

    factors = splu(S, "NATURAL", **SYMMETRIC | {"diag_pivot_thresh": threshold})
    estimate = least_estimate(factors.solve, S.shape[0])
    proven = (proven_least(S, part * estimate, rounding) for part in PARTS)
    return next((least for least in proven if least > 0), 0.0)


def radii(K, C, m, s, X):
    """Return how near to each of some modes an exact one is, infinite where none is proven.

    Parameters as of `discs`, but for any number of modes.
    """
    pencil = Quadratic(K, C, m)
    X = X[pencil.order] / np.linalg.norm(X, axis=0)
    return np.array([_radius(pencil, *mode) for mode in zip(s, X.T, strict=True)])


def _radius(pencil, s, x):
    """Return how near to s a mode is; infinite if none is proven."""
    from scipy.sparse import bmat

    m, size, w = pencil.m, abs(s), abs(s) or 1.0
    (K, C), a = pencil.sizes, np.abs(x)
    r, v = pencil.K @ x + s * (pencil.C @ x) + s * s * m * x, pencil.C @ x + 2 * s * m * x
    wrong_r = pencil.unit * np.linalg.norm(K @ a + size * (C @ a) + size * size * m * a)
    wrong_v = pencil.unit * np.linalg.norm(C @ a + 2 * size * m * a)
    border = (w * v)[:, None]
    J = bmat([[pencil.at(s), border], [border.T, None]], "csc")
    J.sort_indices()
    try:  # at a mode the last pivot of S is nearly zero
        c = _least(J, pencil.rounding(size) + w * wrong_v, 1e-8)
    except RuntimeError:
        return np.inf
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
    """Return how many modes have |s| < R, proven; None where that stays open.

    It is decided where damping is weak, and K, which is real, has a gap.
    """
    if np.iscomplexobj(K):
        return None
    pencil = Quadratic(K, C, m)
    K, C, (norm_K, norm_C) = pencil.K, pencil.C, pencil.norms
    try:
        negative = max(-_floor(C, -NEAR * norm_C), 0.0)  # C may have such eigenvalues by rounding
        rest = m * R * R + _floor((K - R * C).tocsc(), -0.999 * m * R * R)
        half = MARGIN * R * (norm_C + negative) / 2
        clear = 0.1 * half + NEAR * norm_K
        ends = [RealFactors(K, m * R * R + side * (half + clear)) for side in (-1, 1)]
    except ZeroDivisionError:
        return None
    certain = rest > 2 * R * negative + pencil.rounding(R) and all(
        end.error(clear) + 4 * EPSILON * norm_K < clear for end in ends
    )
    low, high = (end.negative for end in ends)
    return 2 * low if certain and low == high else None


def _floor(A, shift):
    """Return what no eigenvalue of A is below, next to a shift; -inf if one may be."""
    factors = RealFactors(A, shift)
    return shift - factors.error() if factors.negative == 0 else -np.inf


def number_within(K, C, m, centre, radius, proven=False):
    """Return how many modes are in a circle; None where that stays open, as with one at the rim.

    They are counted by the phase of det S and its derivative, or proven by counts and thousands of
    factorizations, which is open where these are too inaccurate for so many unknowns.
    """
    try:
        return (_proven if proven else _counted)(Quadratic(K, C, m), centre, radius)
    except (RuntimeError, ArithmeticError):  # SuperLU's, of a singular matrix, and those below
        return None


def _wrapped(phase):
    """Return a phase between -pi and pi."""
    return math.remainder(phase, 2 * math.pi)


def _factors(pencil, circle, angle):
    """Return factors of S at an angle of a circle, and the phase of its determinant."""
    factors = RealFactors(pencil.at(circle[0] + circle[1] * np.exp(1j * angle)), 0.0)
    if factors.pivots is None:
        raise ArithmeticError("rows were moved")
    return factors, float(np.angle(factors.pivots).sum())


def _arcs(fine):
    """Return arcs of a circle, start and end, halved until `fine(start, end)`."""
    arcs, done = [(k * math.pi / 8, (k + 1) * math.pi / 8) for k in range(16)], []
    while arcs:
        start, end = arcs.pop()
        if fine(start, end):
            done.append((start, end))
        elif len(arcs) + len(done) < ARCS:
            arcs += [(start, (start + end) / 2), ((start + end) / 2, end)]
        else:
            raise ArithmeticError("too many arcs")
    return done


def _counted(pencil, *circle):
    """Return the number of modes in a circle by phases at the ends of arcs."""

    @cache
    def phase(angle):
        (factors, here), (_, ahead) = (_factors(pencil, circle, a) for a in (angle, angle + AHEAD))
        return factors.pivots, here, _wrapped(ahead - here) / AHEAD

    def grown(start, end):
        (_, first, slope), (_, last, slope_last) = phase(start), phase(end)
        trapezoid, bent = (end - start) / 2 * np.array([slope + slope_last, slope - slope_last])
        return trapezoid, _wrapped(last - first - trapezoid), bent

    def fine(start, end):
        _, off, bent = grown(start, end)
        # two modes near one angle turn the sum by 2 pi, which no phase tells, but pivots by less
        turned = np.abs(np.angle(phase(end)[0] / phase(start)[0])).max()
        return abs(off) <= AGREE and abs(bent) <= CHANGE and turned <= TURN

    return round(sum(sum(grown(*arc)[:2]) for arc in _arcs(fine)) / (2 * math.pi))


def _proven(pencil, centre, radius):
    """Return the number of modes in a circle by the trapezoid rule, in a ring proven empty."""
    size = abs(centre) + 2 * radius
    slope = pencil.slope(size)
    blur = pencil.rounding(size) + 16 * EPSILON * size * slope  # of S at a point of the circle

    @cache
    def clear(angle):
        """So near to the circle's point no singular value is below that times the slope."""
        least = _least(pencil.at(centre + radius * np.exp(1j * angle)), blur)
        if not least > 0:
            raise ArithmeticError("a mode at the rim")
        return min(0.5 * least / slope, radius)

    arcs = _arcs(lambda *arc: radius * (arc[1] - arc[0]) <= 0.5 * sum(map(clear, arc)))
    width = 0.5 * min(clear(angle) for arc in arcs for angle in arc)
    # In the ring no singular value is below `lowest`, and all but `few` are above `high`.
    lowest, far = 2 * slope * width, 3 * slope * radius
    factors = RealFactors(doubled(pencil.at(centre)), far)
    high = far - factors.error(0.1 * far) - blur - slope * (radius + width)
    few = factors.negative - pencil.size if high > lowest else pencil.size
    inverses = MARGIN * (few / lowest + (pencil.size - few) / max(high, lowest))  # of them all
    most = (radius + width) * slope * inverses
    points = math.ceil(math.log1p(2 * most / OFF) * (radius + width) / width)
    aside, total = min(1 / most, math.pi / points), 0.0
    for angle in 2 * math.pi / points * np.arange(min(points, POINTS)):
        ends = [_factors(pencil, (centre, radius), angle + side) for side in (-aside, aside)]
        error = max(factors.error() for factors, _ in ends) + blur
        wrong = 1.2 * error * inverses + 100 * EPSILON * pencil.size  # of a phase
        if points > POINTS or not (error < 0.1 * lowest and wrong < WRONG * aside):
            raise ArithmeticError("too many points or too inaccurate factors")
        total += _wrapped(ends[1][1] - ends[0][1])
    number = total / (2 * aside * points)
    return round(number) if abs(number - round(number)) < 0.5 - OFF - WRONG else None
