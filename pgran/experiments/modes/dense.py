"""Whole spectra by LAPACK, complete by proof: each eigenvalue is there once, within a radius.

Theorem. Let K be symmetric, X square, W = diag(w), R = K X - X W and |X^T X - 1|_2 <= delta < 1.
Then, both sorted, |lambda_j(K) - w_j| <= |R|_2 / sqrt(1 - delta) for every j.

Proof. With the singular value decomposition X = U S V^T, A = U^T K U and D = V^T W V,

    A S - S D = U^T R V.

Let x be a unit eigenvector of A - D whose eigenvalue mu is the largest in magnitude. The symmetric
part of A S - S D is ((A - D) S + S (A - D)) / 2, so that |R|_2 >= |x^T (A S - S D) x| =
|mu| x^T S x >= |mu| sqrt(1 - delta), and |lambda_j(A) - lambda_j(D)| <= |A - D|_2 = |mu| by Weyl.

So no mode is missing, and none is twice, whatever LAPACK has done; what it returns is only checked.
"""

import math
from typing import NamedTuple

import numpy as np

from pgran.medium.rounding import EPSILON

LOOSE = 0.02  # |X^T X - 1|: with more than that LAPACK has failed
BLOCK = 256  # columns that are checked at a time
MARGIN = 1.01  # covers the rounding of the bounds themselves


class Spectrum(NamedTuple):
    """All eigenvalues of K, ascending, shape (n,), with eigenvectors as columns, shape (n, n).

    The j-th eigenvalue lies within `radius` of the j-th value; infinite where nothing is proven.
    """

    values: np.ndarray
    vectors: np.ndarray
    residuals: np.ndarray  # |K x - w x|_2 of each
    radius: float


def stiffness_matrix(medium):
    """Return K, sparse, exactly symmetric as it is stored."""
    springs = medium.springs
    K = springs.B.T @ springs.B.multiply(springs.constants[:, None])
    return (0.5 * (K + K.T)).tocsr()  # products of sparse matrices are symmetric but for rounding


def whole_spectrum(K):
    """Return all eigenvalues and eigenvectors of a symmetric sparse matrix as a `Spectrum`."""
    import scipy.linalg  # here: SciPy takes its time

    dense = K.toarray(order="F")
    values, vectors = scipy.linalg.eigh(dense, driver="evd", overwrite_a=True, check_finite=False)
    return Spectrum(values, vectors, *enclosure(K, values, vectors))


def enclosure(K, values, vectors):
    """Return |K x - w x|_2 of each column, and the radius of the theorem.

    Norms are bounded by Frobenius norms. A product of m terms is wrong by at most m u times that of
    the magnitudes (u the unit roundoff): with |X|_F = sqrt(n) to a percent, R gains
    (m + 3) u (|K| + max |w|) |X|_F, m the most nonzeros of a row, and X^T X gains
    (n + 2) u |X|_F^2.
    """
    n, unit = len(values), EPSILON / 2
    residuals, gram = np.empty(n), 0.0
    for start in range(0, n, BLOCK):
        own = slice(start, start + BLOCK)
        x = vectors[:, own]
        residuals[own] = np.linalg.norm(K @ x - values[own] * x, axis=0)
        # The columns up to these: of the symmetric X^T X - 1 the part above its diagonal blocks
        # counts twice, the blocks themselves once.
        product = vectors[:, : start + x.shape[1]].T @ x
        above, diagonal = product[:start], product[start:]
        gram += 2 * np.vdot(above, above) + np.linalg.norm(diagonal - np.eye(len(diagonal))) ** 2
    size = MARGIN * math.sqrt(n)
    delta = MARGIN * (math.sqrt(gram) + (n + 2) * unit * size**2)
    if not delta < LOOSE:  # NaN too
        return residuals, math.inf
    largest = float(abs(K).sum(axis=1).max()) + float(np.abs(values).max(initial=0.0))
    terms = int(np.diff(K.indptr).max(initial=0)) + 3
    rest = MARGIN * (np.linalg.norm(residuals) + terms * unit * largest * size)
    return residuals, float(MARGIN * rest / math.sqrt(1 - delta))
