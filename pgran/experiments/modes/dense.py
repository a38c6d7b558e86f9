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

import numpy as np

from pgran.errors import InputError, PgranError
from pgran.experiments.modes.shapes import with_fixed_sign
from pgran.medium.base import EPSILON
from pgran.medium.springs import stiffness_matrix
from pgran.run.machine import check_memory, total_memory

LARGEST = 30_000  # unknowns: more, and LAPACK counts its numbers beyond 2^31
DOUBLES = 4  # n^2 of them are held at a time; LAPACK's divide and conquer takes 3
# Seconds of the whole spectrum, n^3 times WHOLE; of an EPS for each mode, n times EACH and entries
# of the factor times SOLVED, and for its counts multiplications of a factorization times COUNTED.
# Measured on networks in two and three dimensions, with rotations too: a ratio alone matters.
WHOLE, EACH, SOLVED, COUNTED = 4.8e-10, 5e-7, 7e-8, 2.5e-8
LOOSE = 0.02  # |X^T X - 1|: with more than that LAPACK has failed
BLOCK = 256  # columns that are checked at a time
MARGIN = 1.01  # covers the rounding of the bounds themselves


def is_faster(network, modes):
    """Return whether a whole spectrum fits, and comes faster than so many modes by an EPS."""
    n = network.size
    if n > LARGEST or 2 * memory(n) > total_memory():
        return False
    whole, eps = WHOLE * n**3, EACH * modes * n
    if whole <= eps:  # however little the factors fill
        return True
    return whole <= eps + SOLVED * modes * network.graph.entries + COUNTED * network.graph.work


def memory(size):
    """Return how many bytes a whole spectrum of so many unknowns takes."""
    return 8 * DOUBLES * size**2


class DenseSolver:
    """Finds all modes of a medium at once, and proves that they are all.

    Each eigenvalue of the last ones is known to within the `radius`, rounding of K's entries
    included. Raises an InputError where there are too many for LAPACK, or for the memory.
    """

    radius = math.inf

    def __init__(self, lattice):
        if lattice.size > LARGEST:
            raise InputError(
                f"-modes_method dense: LAPACK computes spectra of up to {LARGEST} unknowns, not of "
                f"{lattice.size}; take -modes_method eps"
            )
        check_memory("modes_method", memory(lattice.size))
        import scipy.linalg  # noqa: F401 (here: a dry run times what comes later)

        self.lattice = lattice

    def solve(self, count):
        """Return the modes of the first unknowns as `normal.ModeSolver` does.

        Raises PgranError if LAPACK fails.
        """
        K = stiffness_matrix(self.lattice)[:count, :count]
        try:
            values, vectors, residuals, radius = whole_spectrum(K)
        except (np.linalg.LinAlgError, MemoryError) as error:
            reason = str(error) or type(error).__name__
            raise PgranError(f"LAPACK computes no spectrum: {reason}; -modes_method eps") from error
        self.radius = radius + self.lattice.rounding * self.lattice.stiffness_norm
        shapes = np.pad(vectors.T, ((0, 0), (0, self.lattice.size - count)))
        shapes = with_fixed_sign(shapes.reshape(count, *self.lattice.shape))
        return values, shapes, residuals / (abs(K).sum(axis=1).max() or 1.0)


def whole_spectrum(K):
    """Return values w, ascending, vectors x as columns, |K x - w x|_2 of each, and a radius.

    K is symmetric and sparse. Its j-th eigenvalue lies within the radius of the j-th value.
    """
    import scipy.linalg  # here: SciPy takes its time

    dense = K.toarray(order="F")
    driver = "evd" if len(dense) > 1 else "evr"  # SciPy 1.10 gives evd too little room for one
    values, vectors = scipy.linalg.eigh(dense, driver=driver, overwrite_a=True, check_finite=False)
    return values, vectors, *enclosure(K, values, vectors)


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
