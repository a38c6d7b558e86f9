"""Factors of symmetric matrices, how many eigenvalues they tell to lie below a shift, and how sure.

SuperLU eliminates without moving rows, as long as no pivot is zero: K - shift = L U. Rounding keeps
U from being D L^T, D its diagonal, so that

    K - shift - L D L^T = E,   |E| <= g |L| |U| + |L| |U - D L^T|,   g = w u / (1 - w u),

entry by entry, u the unit of rounding, w as many roundings as an entry of L U takes (N. Higham,
Accuracy and Stability of Numerical Algorithms, theorem 9.3; SuperLU multiplies by the reciprocal of
a pivot, which is one more). By Sylvester's law D has as many negative entries as K - E has
eigenvalues below the shift, so their number lies between those of K below shift - |E|_2 and below
shift + |E|_2. All this holds unless numbers underflow.

The same gives singular values: S = S^T, as S(s) is for any law of damping and any s, makes

    T = [[Re S, Im S], [Im S, -Re S]]

real and symmetric with the eigenvalues +-sigma_i of S (Takagi): T (Re x, Im x) is S conj(x). So no
sigma_i is below c exactly where T - c has as many negative pivots as S has rows.
"""

from functools import cached_property

import numpy as np

from pgran.medium.base import EPSILON

BOUND_PASSES = 4  # of a power iteration, each of which sharpens a bound
BOUND_ROUNDING = 1.01  # covers the rounding of the bound itself
BOUND_SHARPNESS = 0.05  # of a shift: how sharp the bound of the factors' error need be


class RealFactors:
    """Factors of K - shift, K real and symmetric: `solve(b)`, and its negative pivots.

    Of a complex symmetric K they are as good, but for these. K, sparse by columns, has its unknowns
    in the order of their elimination. Raises ZeroDivisionError if a pivot is zero.
    """

    def __init__(self, K, shift):
        from scipy.sparse import identity
        from scipy.sparse.linalg import splu

        from pgran.medium.springs import SYMMETRIC

        self.size = K.shape[0]
        shifted = (K - shift * identity(self.size, format="csc")).tocsc() if shift else K
        self._largest = float(np.abs(shifted.diagonal()).max(initial=0.0))
        try:
            self._factors = splu(shifted, "NATURAL", **SYMMETRIC)
        except RuntimeError as error:  # so SuperLU says that the matrix is singular
            raise ZeroDivisionError(str(error)) from error
        self.solve = self._factors.solve

    @cached_property
    def negative(self):
        """How many pivots are negative; None where that tells nothing."""
        return None if self.pivots is None else int(np.count_nonzero(self.pivots < 0))

    @cached_property
    def pivots(self):
        """The diagonal of D; None where rows were moved, or one is zero or no number."""
        pivots = self._factors.U.diagonal()
        moved = not np.array_equal(self._factors.perm_r, self._factors.perm_c)
        if moved or not np.all(np.isfinite(pivots)) or np.any(pivots == 0):
            return None
        return pivots

    def error(self, enough=0.0):
        """Return a bound of |E|_2, infinite where none is known, as sharp as `enough` if possible.

        Small pivots make it large: in three dimensions 1e-6 of |K| is usual.
        """
        if self.pivots is None:
            return np.inf
        from scipy.sparse import csc_matrix, csr_matrix

        L, U = self._factors.L, self._factors.U
        # The columns of L are the rows of L^T.
        scaled = L.data * np.repeat(self.pivots, np.diff(L.indptr))
        apart = U.tocsr() - csr_matrix((scaled, L.indices, L.indptr), L.shape)
        # abs() of a matrix would sort it first.
        lower, upper = (csc_matrix((np.abs(F.data), F.indices, F.indptr), F.shape) for F in (L, U))
        apart.data = np.abs(apart.data)
        # An entry of L U in row i is summed from no more terms than that row of L has entries; an
        # operation with complex numbers is as good as four with real ones.
        rounded = EPSILON / 2 * (4 if np.iscomplexobj(self.pivots) else 1)
        unit = (np.bincount(L.indices, minlength=self.size) + 8) * rounded
        weight = unit / (1 - unit)
        # Where F bounds |E| entry by entry, |E|_2 is no more than F's spectral radius, and that no
        # more than the largest (F v)_i / v_i of any positive v (Collatz and Wielandt).
        vector, bound = np.ones(self.size), np.inf
        for _ in range(BOUND_PASSES):
            product = weight * (lower @ (upper @ vector)) + lower @ (apart @ vector)
            bound = BOUND_ROUNDING * float(np.max(product / vector)) + EPSILON * self._largest
            if bound <= enough:
                break
            vector = product / product.max()
        return bound if np.isfinite(bound) else np.inf


def proven_gap(K, shift, count, rounding=0.0):
    """Return a positive number near a shift for which just `count` eigenvalues are smaller.

    0 where that is not certain. `K` is a real matrix for `RealFactors`, known up to one of the
    2-norm `rounding`.
    """
    if not shift > 2 * rounding:  # NaN too
        return 0.0
    try:
        factors = RealFactors(K, shift)
    except ZeroDivisionError:
        return 0.0
    if factors.negative != count:
        return 0.0
    # the factors are those of a matrix as near to K as their error: so are its eigenvalues
    return max(0.99 * (shift - factors.error(BOUND_SHARPNESS * shift) - rounding), 0.0)


def proven_least(S, c, rounding=0.0):
    """Return a number near c that no singular value of S is below; 0 if that is not certain."""
    return proven_gap(doubled(S), c, S.shape[0], rounding)


def doubled(S):
    """Return T, sparse by columns: the real and imaginary part of an unknown side by side."""
    from scipy.sparse import csc_matrix, kron

    real, imaginary = csc_matrix(S.real), csc_matrix(S.imag)
    apart, crossed = np.diag([1.0, -1.0]), np.array([[0.0, 1.0], [1.0, 0.0]])
    T = (kron(real, apart) + kron(imaginary, crossed)).tocsc()
    T.sort_indices()
    return T


def least_estimate(solve, size, enough=0.0, steps=8):
    """Return an estimate of the smallest singular value of S from above; `solve` is by S.

    Inverse iteration of S conj(S): y becomes S^-1 conj(S^-1 conj(y)), until less than `enough`.
    """
    y = np.random.Generator(np.random.Philox(1)).standard_normal(size) + 0j
    y /= np.linalg.norm(y)
    length = 1.0
    for _ in range(steps):
        x = solve(y.conj())
        length = np.linalg.norm(x)
        if not length * enough < 1:
            break
        y = solve(x.conj())
        y /= np.linalg.norm(y)
    return 1.0 / length
