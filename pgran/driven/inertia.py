"""Factors of K - shift, how many eigenvalues they tell to lie below it, and how sure that is.

SuperLU eliminates without moving rows, as long as no pivot is zero: K - shift = L U. Rounding keeps
U from being D L^T, D its diagonal, so that

    K - shift - L D L^T = E,   |E| <= g |L| |U| + |L| |U - D L^T|,   g = w u / (1 - w u),

entry by entry, u the unit of rounding, w as many roundings as an entry of L U takes (N. Higham,
Accuracy and Stability of Numerical Algorithms, theorem 9.3; SuperLU multiplies by the reciprocal of
a pivot, which is one more). By Sylvester's law D has as many negative entries as K - E has
eigenvalues below the shift, so their number lies between those of K below shift - |E|_2 and below
shift + |E|_2. All this holds unless numbers underflow.
"""

from functools import cached_property

import numpy as np

from pgran.medium.base import EPSILON

PASSES = 4  # of a power iteration, each of which sharpens a bound
ROUNDED = 1.01  # covers the rounding of the bound itself


class RealFactors:
    """Factors of K - shift, K real and symmetric: `solve(b)`, and its negative pivots.

    Of a complex symmetric K they are as good, but for these.

    Parameters
    ----------
    K : scipy.sparse.csc_matrix, shape (n, n)
        Its unknowns are numbered in the order of their elimination.
    shift : float

    Raises
    ------
    ZeroDivisionError
        If a pivot is zero.
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
        for _ in range(PASSES):
            product = weight * (lower @ (upper @ vector)) + lower @ (apart @ vector)
            bound = ROUNDED * float(np.max(product / vector)) + EPSILON * self._largest
            if bound <= enough:
                break
            vector = product / product.max()
        return bound if np.isfinite(bound) else np.inf


def real_matrix(K):
    """Return the real part of a symmetric PETSc.Mat of this rank alone, sparse by columns."""
    return complex_matrix(K).real.copy()  # which SuperLU needs in one piece


def complex_matrix(S):
    """Return a symmetric PETSc.Mat of this rank alone as a scipy.sparse.csc_matrix."""
    from scipy.sparse import csc_matrix

    pointer, columns, values = S.getValuesCSR()  # symmetric: rows are columns
    return csc_matrix((values, columns, pointer), S.getSize())
