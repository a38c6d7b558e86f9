"""Small models that give an amplitude, with its bound, at any frequency of an interval.

At a frequency the system is a polynomial in omega with fixed matrices,

    S(omega) = B_0 + omega B_1 + omega^2 B_2,    B = (K, i C, -M),    f(omega) = g_0 + omega g_1,

C being all damping. X spans the moments of A (scaled derivatives along omega) at both ends of an
interval, Z those of a detector's adjoint z. The Galerkin solutions X y of S A = f and Z w of
S z = e_d have the residuals

    r = f - S X y = W c,    W = [g_0, g_1, B_0 X, B_1 X, B_2 X],    c = (1, omega, -omega^j y),

and q alike, so that two small solves and the triangle R of W = Q R give |r|_2 = |R c|_2. (From the
Gram matrix W^H W it would lose half its digits, which amplitudes above the highest mode need.) As
in `pgran.driven.accuracy`, e_d^T X y + (Z w)^T r misses A_d by q^T S^-1 r, at most |q| |r| |S^-1|.

With y' and w' that solve the derivatives of the small systems, r' = W c' and q' are small as well,
and the derivative of the corrected amplitude misses dA_d/domega by

    q'^T S^-1 r + q^T S^-1 r' - q^T S^-1 S' S^-1 r.

The reaction f^T A is (X y)^T (f + r) but for r^T S^-1 r, at most |r|^2 |S^-1|. As |X_p|_2 = 1, what
rounding moves it by is bounded through |X y| <= |y|_1.

What a model holds, with p columns in X and in each Z, system 0 that of A, then one a detector:
`own`, X^T W of each system with its own W; `cross`, Z^T W with the W of A; `triangle`, R of each;
`reading`, e_d^T X; `sizes`, |Z|^T |W| summed up at the highest frequency, and `drive_sizes`, the
same of f, by which rounding is bounded. NumPy only.
"""

import math
from dataclasses import dataclass

import numpy as np

from pgran.driven.amplitudes import Limits
from pgran.medium.base import SMALLEST_NORMAL
from pgran.store.record import attribute

# Moments of each right-hand side at each end: fewer where factorizations are cheap beside the dense
# algebra of a model, up to so many unknowns.
MOMENTS, FEWER_MOMENTS, FEW_UNKNOWNS = 8, 6, 1000
LOST = 2**10 * SMALLEST_NORMAL  # what sums of products too small for doubles may lose
LOST_NORM = 16 * math.sqrt(SMALLEST_NORMAL)  # what a norm may miss because squares are lost
SHORTEST = 4  # frequencies: NumPy rounds products of fewer complex numbers in one way or another


@dataclass(frozen=True, eq=False)
class ModelLimits(Limits):
    """What bounds the errors of all models of a lattice.

    By rounding a residual's norm misses the part `rounding` of |f| + (|K| + omega |C| + omega^2
    |M|) |x|, a sum over all balls `sum_rounding`. |e_d| is at most `receiver`: 1 unless a
    detector's ball has another mass than the unit; None in files before format version 5. Loss
    angles add `steady_stability`, lambda_min(L), to omega stability.
    """

    rounding: float = attribute("part of a residual's terms that rounding may be", "1")
    sum_rounding: float = attribute("the same of a sum over all balls", "1")
    receiver: float = attribute("bound of |e_d|", "1", since=5)
    steady_stability: float | None = attribute("lambda_min of loss angles", "k", optional=True)


def moments_of(medium):
    """Return how many moments each right-hand side has at each end of an interval."""
    return FEWER_MOMENTS if medium.size <= FEW_UNKNOWNS else MOMENTS


def point_dtype(detectors):
    """Return the dtype of what `evaluate` returns for each frequency."""
    return np.dtype(
        [
            ("omega", float),
            ("displacement", complex, (detectors,)),
            ("error_bound", float, (detectors,)),
            ("rounding", float, (detectors,)),  # of the bound, that no shorter interval reduces
            ("derivative", complex, (detectors,)),
            ("derivative_bound", float, (detectors,)),
            ("reaction", complex),
            ("reaction_bound", float),
            ("backward_error", float),
        ]
    )


def evaluate(model, omega, limits, derivatives=True):
    """Return points, of `point_dtype`, at frequencies (n,) of an interval.

    The `model` is a row or a dict of its arrays. What cannot be computed is not finite. Without
    `derivatives` these and the reactions are zero.
    """
    if len(omega) < SHORTEST:
        return evaluate(model, np.resize(omega, SHORTEST), limits, derivatives)[: len(omega)]
    points = np.zeros(len(omega), point_dtype(len(model["reading"])))
    points["omega"] = omega
    with np.errstate(all="ignore"):
        try:
            systems = SmallSystems(model, limits, omega)
            systems.amplitudes(points)
            if derivatives:
                systems.derivatives(points)
                systems.reactions(points)
        except np.linalg.LinAlgError:  # a small system is singular
            for name in points.dtype.names[1:]:
                points[name] = np.nan
    return points


class SmallSystems:
    """The small systems of an interval at n frequencies: index 0 that of A, then one a detector.

    `y` (systems, p, n) solves them: y of A, then each w. The residuals are W `c`, of the norms `r`
    (systems, n): |r|, then each |q|, at most; rounding alone may make them `rounding`. Powers of
    omega are real: their products with complex numbers round alike wherever these lie in memory.
    """

    def __init__(self, model, limits, omega):
        self.model, self.limits, self.omega = model, limits, omega
        own = model["own"]
        systems, p, _ = own.shape
        # X^T W has 2 + 3p columns: X^T g_0, X^T g_1 | X^T B_0 X | X^T B_1 X | X^T B_2 X
        self.loads, blocks = own[:, :, :2], own[:, :, 2:].reshape(systems, p, 3, p)
        self.blocks = np.ascontiguousarray(blocks.transpose(2, 0, 1, 3))
        one = np.ones_like(omega)
        self.powers = np.stack([one, omega, omega * omega])
        self.slopes = np.stack([0 * one, one, 2 * omega])  # their derivatives
        # X^T S X = sum of omega^j X^T B_j X, for all frequencies in one product
        T = self.powers.T @ self.blocks.reshape(3, -1)
        self.T = T.reshape(-1, systems, p, p)
        self.y = self._solve(self.loads @ self.powers[:2])
        self.c = self._coefficients(self.powers, _times(self.powers, self.y))
        self.size = np.sqrt(squares(self.y))  # |X y|, as X is orthonormal
        self.sizes = np.abs(self.y)
        # bounds of |S|, of |f| and each |e_d|, and of |S^-1|
        self.norm = limits.stiffness + omega * (limits.damping + omega * limits.mass)
        self.drive = np.empty_like(self.size)
        self.drive[0] = limits.drive + omega * limits.drive_damping
        if limits.receiver is None:  # R is no shorter than W, whose first columns are the e_d
            self.drive[1:] = 1.01 * np.sqrt(squares(model["triangle"][1:, :, :1]))
        else:
            self.drive[1:] = limits.receiver
        self.inverse = 1.01 / (omega * limits.stability + (limits.steady_stability or 0.0))
        self.rounding = limits.rounding * (self.drive + 1.01 * self.norm * self.size) + LOST_NORM
        self.r = self._residual(self.c) + self.rounding
        self.theory = self.inverse * self.r[0] * self.r[1:]  # |q| |r| |S^-1|
        # |Z|^T (|S| |X y| + |f|), of which rounding takes its part in Z^T r
        self.terms = model["sizes"] @ self.sizes[0] + model["drive_sizes"][:, :, None]

    def _solve(self, load):
        """Return T^-1 times a load (systems, p, n)."""
        y = np.linalg.solve(self.T, load.transpose(2, 0, 1)[..., None])[..., 0]
        return np.ascontiguousarray(y.transpose(1, 2, 0))

    def _coefficients(self, powers, products):
        """Return c, (systems, 2 + 3p, n), from powers and their products with y."""
        systems, p, n = self.y.shape
        c = np.empty((systems, 2 + 3 * p, n), complex)
        c[:, :2] = powers[:2]
        np.negative(products.reshape(systems, 3 * p, n), out=c[:, 2:])
        return c

    def _residual(self, c):
        """Return |W c|, but for rounding."""
        return 1.01 * np.sqrt(squares(self.model["triangle"] @ c))

    def amplitudes(self, points):
        """Fill in e_d^T X y + (Z w)^T r and its bounds."""
        model, limits = self.model, self.limits
        self.missed = model["cross"] @ self.c[0]  # Z^T r
        points["displacement"] = (model["reading"] @ self.y[0] + _sums(self.y[1:], self.missed)).T
        terms = np.abs(model["reading"]) @ self.sizes[0] + _sums(self.sizes[1:], self.terms)
        evaluation = limits.sum_rounding * terms + LOST
        rounding = self.inverse * self.rounding[0] * self.rounding[1:]
        points["error_bound"] = (self.theory + evaluation).T
        points["rounding"] = (rounding + evaluation).T
        points["backward_error"] = self.r[0] / (self.norm * self.size[0] + self.drive[0])

    def derivatives(self, points):
        """Fill in the derivatives of the corrected amplitudes, and their bounds."""
        model, limits, omega = self.model, self.limits, self.omega
        # T y' = X^T (f' - S' X y)
        bent = (self.blocks @ self.y * self.slopes[:, None, None]).sum(axis=0)
        y1 = self._solve(self.loads @ self.slopes[:2] - bent)
        products = _times(self.slopes, self.y) + _times(self.powers, y1)
        c1 = self._coefficients(self.slopes, products)
        missed = model["cross"] @ c1[0]  # Z^T r'
        points["derivative"] = (
            model["reading"] @ y1[0] + _sums(y1[1:], self.missed) + _sums(self.y[1:], missed)
        ).T
        slope = limits.damping + 2 * omega * limits.mass  # of |S'|
        drive = np.zeros_like(self.size)
        drive[0] = limits.drive_damping
        rounding = drive + 1.01 * (slope * self.size + self.norm * np.sqrt(squares(y1)))
        r, r1 = self.r, self._residual(c1) + limits.rounding * rounding + LOST_NORM
        theory = self.inverse * (r[0] * r1[1:] + r1[0] * r[1:] + slope * self.theory)
        # |S'| is at most 2 / omega of |K| + omega |C| + omega^2 |M|, ball by ball
        sizes = np.abs(y1)
        into = model["sizes"] @ sizes[0] + 2 / omega * self.terms
        terms = np.abs(model["reading"]) @ sizes[0]
        terms = terms + _sums(sizes[1:], self.terms) + _sums(self.sizes[1:], into)
        points["derivative_bound"] = (theory + limits.sum_rounding * terms + LOST).T

    def reactions(self, points):
        """Fill in f^T A and its bound."""
        y, own = self.y[0], self.model["own"][0]
        forces = self.loads[0] @ self.powers[:2] + own @ self.c[0]  # X^T (f + r)
        points["reaction"] = _sums(y, forces)
        size = 1.01 * self.sizes[0].sum(axis=0)  # |y|_1
        terms = size * (2 * self.drive[0] + self.norm * size)
        theory = self.inverse * self.r[0] ** 2
        points["reaction_bound"] = theory + self.limits.sum_rounding * terms + LOST


def _times(powers, y):
    """Return powers (3, n) times solutions (systems, p, n), shape (systems, 3, p, n)."""
    return powers[:, None] * y[:, None]


def _sums(a, b):
    """Return the sums of products along the last axis but one."""
    return np.einsum("...in,...in->...n", a, b)


def poles(own, low, high):
    """Return the frequencies above which the poles of small systems lie, NaN outside the interval.

    `own` is a model's, (systems, p, 2 + 3p); what is returned has the shape (systems, 2p). Around
    the interval's middle m, where a system can be solved, its polynomial in d = omega - m is

        (T + d T' + d^2 B_2) x = 0,    so that    (1 / d) (x, d x) = L (x, d x),

    and 1 / (pole - m) are the eigenvalues of its companion matrix L = [-T^-1 T', -T^-1 B_2; 1, 0].
    """
    middle, p = 0.5 * (low + high), own.shape[1]
    b = own[:, :, 2:].reshape(-1, p, 3, p).transpose(2, 0, 1, 3)
    steps = np.concatenate([b[1] + 2 * middle * b[2], b[2]], axis=-1)
    companion = np.zeros((len(own), 2 * p, 2 * p), complex)
    companion[:, p:, :p] = np.eye(p)
    try:
        companion[:, :p] = -np.linalg.solve(b[0] + middle * (b[1] + middle * b[2]), steps)
        inverse = np.linalg.eigvals(companion)
    except np.linalg.LinAlgError:
        return np.full((len(own), 2 * p), np.nan)
    with np.errstate(all="ignore"):
        above = middle + (1 / inverse).real
    return np.where((low < above) & (above < high), above, np.nan)


def squares(columns):
    """Return the sums of squares of the magnitudes down the columns, the last axis but one."""
    numbers = np.ascontiguousarray(columns).view(float)
    both = np.einsum("...in,...in->...n", numbers, numbers)
    return both[..., ::2] + both[..., 1::2]
