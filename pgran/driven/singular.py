"""The smallest singular value of a complex symmetric matrix, proven by one count.

S = S^T, as S(s) is for any law of damping and any s, makes

    T = [[Re S, Im S], [Im S, -Re S]]

real and symmetric with the eigenvalues +-sigma_i of S (Takagi): T (Re x, Im x) is S conj(x). So no
sigma_i is below c exactly where T - c has as many negative pivots as S has rows.
"""

import numpy as np

from pgran.driven.inertia import RealFactors

SHARP = 0.05  # of c: how sharp the bound of the factors' error need be


def proven_least(S, c, rounding=0.0):
    """Return a number that no singular value of S is below, near c; 0 if that is not certain.

    `S` is a scipy.sparse matrix, complex and symmetric, numbered in the order of elimination, and
    known up to a matrix of the 2-norm `rounding`.
    """
    if not c > 2 * rounding:  # NaN too
        return 0.0
    try:
        factors = RealFactors(doubled(S), c)
    except ZeroDivisionError:
        return 0.0
    if factors.negative != S.shape[0]:
        return 0.0
    # the factors are those of a matrix as near to T as their error: so are its eigenvalues
    return max(0.99 * (c - factors.error(SHARP * c) - rounding), 0.0)


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

    Inverse iteration of S conj(S): y becomes S^-1 conj(S^-1 conj(y)). It ends where the value is
    below what would be `enough`.
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
