"""Small models that give an amplitude, with its bound, at any frequency of an interval.

At a frequency the system is a polynomial in omega with fixed matrices,

    S(omega) = B_0 + omega B_1 + omega^2 B_2,    B = (K, i C, -M),    f(omega) = g_0 + omega g_1,

C being all damping. X spans the moments of A (scaled derivatives along omega) at both ends of an
interval, Z those of a detector's adjoint z. The Galerkin solutions X y of S A = f and Z w of
S z = e_d have the residuals

    r = f - S X y = W c,    W = [g_0, g_1, B_0 X, B_1 X, B_2 X],    c = (1, omega, -omega^j y),

and q alike, so that two small solves and the triangle R of W = Q R give |r|_2 = |R c|_2. (From the
Gram matrix W^H W it would lose half its digits, which amplitudes above the highest mode need.) As
in `pgran.driven.bounds`, e_d^T X y + (Z w)^T r misses A_d by q^T S^-1 r, at most |q| |r| |S^-1|.

With y' and w' that solve the derivatives of the small systems, r' = W c' and q' are small as well,
and the derivative of the corrected amplitude misses dA_d/domega by

    q'^T S^-1 r + q^T S^-1 r' - q^T S^-1 S' S^-1 r.

The reaction f^T A is (X y)^T (f + r) but for r^T S^-1 r, at most |r|^2 |S^-1|. As |X_p|_2 = 1, what
rounding moves it by is bounded through |X y| <= |y|_1.

What a model holds, with p columns in X and in each Z, system 0 that of A, then one a detector:
`own`, X^T W of each system with its own W; `cross`, Z^T W with the W of A; `triangle`, R of each;
`reading`, e_d^T X; `sizes`, |Z|^T |W| summed up at the highest frequency, and `drive_sizes`, the
same of f, by which rounding is bounded; `poles`, the frequencies above the poles of system 0.
NumPy only.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from pgran.driven.accurate import Limits
from pgran.medium.rounding import SMALLEST_NORMAL

MOMENTS = 8  # of each right-hand side at each end
LOST = 2**10 * SMALLEST_NORMAL  # what sums of products too small for doubles may lose
SHORTEST = 4  # frequencies: NumPy rounds products of fewer complex numbers in one way or another
LOST_NORM = 16 * math.sqrt(SMALLEST_NORMAL)  # what a norm may miss because squares are lost


# The arrays of a model, and what a curve tells of a point.
ARRAYS = ("low", "high", "own", "cross", "triangle", "reading", "sizes", "drive_sizes")
POINT = ("omega", "displacement", "error_bound", "derivative", "derivative_bound")


def model_dtype(columns, detectors, balls):
    """Return the dtype of a model. Not collective.

    Parameters
    ----------
    columns : int
        p, those of X and of each Z.
    detectors, balls : int
    """
    systems, width = 1 + detectors, 2 + 3 * columns
    return np.dtype(
        [
            ("low", float),
            ("high", float),
            ("proven", np.int8),
            ("factorizations", np.int64),
            ("poles", float, (2 * columns,)),
            ("own", complex, (systems, columns, width)),
            ("cross", complex, (detectors, columns, width)),
            ("triangle", complex, (systems, columns + min(2 + 2 * columns, balls), width)),
            ("reading", complex, (detectors, columns)),
            ("sizes", float, (detectors, columns, columns)),
            ("drive_sizes", float, (detectors, columns)),
        ]
    )


@dataclass(frozen=True, eq=False)
class ModelLimits(Limits):
    """What bounds the errors of all models of a lattice.

    Attributes
    ----------
    rounding : float
        What a residual's norm misses, relative to |f| + (|K| + omega |C| + omega^2 |M|) |x|.
    sum_rounding : float
        The same of a sum over all balls.
    receiver : float
        |e_d| is at most this: 1 unless a detector's ball has another mass than the unit. None in
        files before format version 5.
    """

    rounding: float
    sum_rounding: float
    receiver: float = field(metadata={"since": 5})


def point_dtype(detectors):
    """Return the dtype of what `evaluate` returns for each frequency. Not collective."""
    return np.dtype(
        [
            ("omega", float),
            ("displacement", complex, (detectors,)),
            ("error_bound", float, (detectors,)),
            ("rounding", float, (detectors,)),
            ("derivative", complex, (detectors,)),
            ("derivative_bound", float, (detectors,)),
            ("reaction", complex),
            ("reaction_bound", float),
            ("backward_error", float),
        ]
    )


def evaluate(model, omega, limits, derivatives=True):
    """Return amplitudes at some frequencies of an interval, derivatives, reactions, all bounds.

    Not collective.

    Parameters
    ----------
    model : numpy.void of `model_dtype`, or dict of its arrays
    omega : numpy.ndarray, shape (n,)
    limits : ModelLimits
    derivatives : bool
        Whether they are wanted, and reactions; else they are zero.

    Returns
    -------
    numpy.ndarray of `point_dtype`, shape (n,)
        What cannot be computed is not finite; `rounding` is the part of a bound that a shorter
        interval would not reduce.
    """
    if len(omega) < SHORTEST:
        return evaluate(model, np.resize(omega, SHORTEST), limits, derivatives)[: len(omega)]
    found = np.zeros(len(omega), point_dtype(len(model["reading"])))
    found["omega"] = omega
    with np.errstate(all="ignore"):
        try:
            solved = _Solved(model, limits, omega)
            solved.amplitudes(found)
            if derivatives:
                solved.derivatives(found)
                solved.reactions(found)
        except np.linalg.LinAlgError:  # a small system is singular
            for name in found.dtype.names[1:]:
                found[name] = np.nan
    return found


def evaluate_all(models, omega):
    """Return what models say at some frequencies: those, amplitudes, bounds, derivatives, bounds.

    Not collective. NaN, with infinite bounds, where no model is proven.

    Parameters
    ----------
    models : pgran.results.Models
    omega : numpy.ndarray, shape (n,)
    """
    found = np.zeros(omega.shape, point_dtype(models.reading.shape[1]))
    found["omega"] = omega
    for value, bound in (POINT[1:3], POINT[3:]):
        found[value], found[bound] = np.nan, np.inf
    place = np.searchsorted(models.low, omega, side="right") - 1
    inside = omega <= np.append(models.high, -np.inf)[place]  # the last is that of place -1
    for interval in np.unique(place[inside]):
        here = inside & (place == interval)
        model = {name: getattr(models, name)[interval] for name in ARRAYS}
        found[here] = evaluate(model, omega[here], models)
    return tuple(found[name] for name in POINT)


class _Solved:
    """The small systems of an interval solved at n frequencies.

    `y` (systems, p, n) holds the solutions, `c` (systems, 2 + 3p, n) what W is multiplied by, `r`
    (systems, n) bounds of the residuals; `y1`, `c1`, `r1` belong to the derivatives. Powers of
    omega are real: their products with complex numbers round alike wherever these lie in memory.
    """

    def __init__(self, model, limits, omega):
        """Solve for y and w."""
        self.model, self.limits, self.omega = model, limits, omega
        own = model["own"]
        systems, p, _ = own.shape
        self.loads, blocks = own[:, :, :2], own[:, :, 2:].reshape(systems, p, 3, p)
        self.blocks = np.ascontiguousarray(blocks.transpose(2, 0, 1, 3))
        one = np.ones_like(omega)
        self.powers = np.stack([one, omega, omega * omega])
        self.slopes = np.stack([0 * one, one, 2 * omega])
        T = self.powers.T @ self.blocks.reshape(3, -1)
        self.T = T.reshape(-1, systems, p, p)
        self.y = self._solved(self.loads @ self.powers[:2])
        self.c = self._combined(self.powers, _times(self.powers, self.y))
        self.size = _norms(self.y)
        # of |S|, and of |f| or |e_d|
        self.norm = limits.stiffness + omega * (limits.damping + omega * limits.mass)
        drive = self.drive = np.empty_like(self.size)
        drive[0] = limits.drive + omega * limits.drive_damping
        if limits.receiver is None:  # R is no shorter than W, whose first columns are the e_d
            drive[1:] = 1.01 * _norms(model["triangle"][1:, :, :1])
        else:
            drive[1:] = limits.receiver
        self.known = limits.rounding * (drive + 1.01 * self.norm * self.size) + LOST_NORM
        self.r = self._residual(self.c) + self.known
        self.backward_error = self.r[0] / (self.norm * self.size[0] + drive[0])
        self.bound = 1.01 / (omega * limits.stability)  # of |S^-1|
        self.theory = self.bound * self.r[0] * self.r[1:]
        # of each ball's terms in Z^T r
        self.sizes = np.abs(self.y)
        self.into = self._into(self.sizes[0]) + model["drive_sizes"][:, :, None]

    def _solved(self, load):
        """Return T^-1 times a load (systems, p, n)."""
        found = np.linalg.solve(self.T, load.transpose(2, 0, 1)[..., None])[..., 0]
        return np.ascontiguousarray(found.transpose(1, 2, 0))

    def _combined(self, powers, products):
        """Return c from powers and their products with y."""
        systems, p, n = self.y.shape
        c = np.empty((systems, 2 + 3 * p, n), complex)
        c[:, :2] = powers[:2]
        np.negative(products.reshape(systems, 3 * p, n), out=c[:, 2:])
        return c

    def _residual(self, c):
        """Return |W c|, but for rounding."""
        return 1.01 * _norms(self.model["triangle"] @ c)

    def _into(self, sizes):
        """Return |Z|^T |S| |X| times sizes."""
        return self.model["sizes"] @ sizes

    def amplitudes(self, found):
        """Fill in the corrected amplitudes and their bounds."""
        model, limits = self.model, self.limits
        self.missed = model["cross"] @ self.c[0]  # Z^T r
        found["displacement"] = (model["reading"] @ self.y[0] + _sums(self.y[1:], self.missed)).T
        terms = np.abs(model["reading"]) @ self.sizes[0] + _sums(self.sizes[1:], self.into)
        evaluation = limits.sum_rounding * terms + LOST
        found["error_bound"] = (self.theory + evaluation).T
        found["rounding"] = (self.bound * self.known[0] * self.known[1:] + evaluation).T
        found["backward_error"] = self.backward_error

    def derivatives(self, found):
        """Fill in their derivatives and the bounds of these."""
        model, limits, omega = self.model, self.limits, self.omega
        bent = (self.blocks @ self.y * self.slopes[:, None, None]).sum(axis=0)  # X^T S' X y
        y1 = self._solved(self.loads @ self.slopes[:2] - bent)
        c1 = self._combined(self.slopes, _times(self.slopes, self.y) + _times(self.powers, y1))
        missed = model["cross"] @ c1[0]
        found["derivative"] = (
            model["reading"] @ y1[0] + _sums(y1[1:], self.missed) + _sums(self.y[1:], missed)
        ).T
        slope = limits.damping + 2 * omega * limits.mass  # of |S'|
        drive = np.zeros_like(self.size)
        drive[0] = limits.drive_damping
        rounding = drive + 1.01 * (slope * self.size + self.norm * _norms(y1))
        r, r1 = self.r, self._residual(c1) + limits.rounding * rounding + LOST_NORM
        theory = self.bound * (r[0] * r1[1:] + r1[0] * r[1:] + slope * self.theory)
        # |S'| is at most 2 / omega of |K| + omega |C| + omega^2 |M|, ball by ball
        sizes = np.abs(y1)
        into = self._into(sizes[0]) + 2 / omega * self.into
        terms = np.abs(model["reading"]) @ sizes[0]
        terms = terms + _sums(sizes[1:], self.into) + _sums(self.sizes[1:], into)
        found["derivative_bound"] = (theory + limits.sum_rounding * terms + LOST).T

    def reactions(self, found):
        """Fill in f^T A and its bound."""
        y, own = self.y[0], self.model["own"][0]
        forces = self.loads[0] @ self.powers[:2] + own @ self.c[0]  # X^T (f + r)
        found["reaction"] = _sums(y, forces)
        size = 1.01 * self.sizes[0].sum(axis=0)
        terms = size * (2 * self.drive[0] + self.norm * size)
        theory = self.bound * self.r[0] ** 2
        found["reaction_bound"] = theory + self.limits.sum_rounding * terms + LOST


def _times(powers, y):
    """Return powers (3, n) times solutions (systems, p, n), shape (systems, 3, p, n)."""
    return powers[:, None] * y[:, None]


def _sums(a, b):
    """Return the sums of products along the last axis but one."""
    return np.einsum("...in,...in->...n", a, b)


def _norms(vectors):
    """Return the 2-norms along the last axis but one."""
    numbers = np.ascontiguousarray(vectors).view(float)
    both = _sums(numbers, numbers)
    return np.sqrt(both[..., ::2] + both[..., 1::2])


def poles(own, low, high):
    """Return the frequencies above which the poles of small systems lie, (systems, 2p).

    Not collective. NaN outside the interval. Each system is expanded around the interval's middle,
    where it can be solved; 1 / (pole - middle) are the eigenvalues of its companion matrix.

    Parameters
    ----------
    own : numpy.ndarray, shape (systems, p, 2 + 3p)
        As in a model.
    low, high : float
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
        found = middle + (1 / inverse).real
    return np.where((low < found) & (found < high), found, np.nan)
