"""The graph of a network's contacts: what hangs together, the order of elimination, the damping.

Its Laplacian L has a row for each free ball; held balls are walls. Where damping is beta on the
whole relative velocity of a contact and balls do not turn, C is L for each component of the
displacements. One sparse factorization of L tells the order of elimination and bounds L from below.
"""

import numpy as np

from pgran.medium.rounding import EPSILON, SMALLEST_NORMAL

STEPS = 30  # of inverse iteration at most
ENOUGH = 0.9  # of the smallest eigenvalue: a bound that is as close as that is not improved
SYMMETRIC = {"diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}


class Graph:
    """The graph of a network's free balls.

    Attributes
    ----------
    laplacian : scipy.sparse.csc_matrix, shape (free, free)
        Of constants 1, in mass-weighted unknowns.
    order : numpy.ndarray of int, shape (free,)
        The free balls in the order of minimum degree, which fills factors little.
    work, entries, nonzeros : float
        How many multiplications the factorization of a matrix over all unknowns takes, how many
        entries its factor has, and the matrix.
    smallest : float
        A number that no eigenvalue of L is below, 0 if none is certain; mostly close to it.
    """

    def __init__(self, network):
        """Sum L up and factor it; the factors are not kept."""
        from scipy.sparse import csr_matrix

        number = np.full(len(network.held), -1)
        number[network.free] = np.arange(len(network.free))
        ends = number[network.bond]
        there = ends >= 0
        weights = network.weights[:: network.components]
        entries = np.array([-1.0, 1.0]) * weights[ends]
        rows = np.repeat(np.arange(len(ends)), np.count_nonzero(there, axis=1))
        shape = len(ends), len(network.free)
        b = csr_matrix((entries[there], (rows, ends[there])), shape)
        self.laplacian = (b.T @ b).tocsc()
        factors = self._factored()
        self.order = np.argsort(factors.perm_c)
        lengths = np.diff(factors.L.indptr).astype(float)
        each = network.components
        self.work, self.entries = float(lengths @ lengths) * each**3, lengths.sum() * each**2
        self.nonzeros = float(self.laplacian.nnz) * each**2
        met = int(np.bincount(ends[there]).max())  # contacts of a ball: terms of its diagonal
        self.smallest = self._bound(factors, (met + 8) * EPSILON)

    def _factored(self):
        """Return the factors of L, the diagonal raised where parts of the network float."""
        from scipy.sparse import identity
        from scipy.sparse.linalg import splu

        scale = self.laplacian.diagonal().max()
        for raised in (0.0, scale):
            matrix = self.laplacian + raised * identity(self.laplacian.shape[0], format="csc")
            try:
                return splu(matrix, permc_spec="MMD_AT_PLUS_A", **SYMMETRIC)
            except RuntimeError:  # singular
                continue
        raise AssertionError("a matrix of a dominant diagonal is not singular")

    def _bound(self, factors, rounding):
        """Return `smallest`; rounding moves (L x)_i by at most `rounding` of its magnitudes' sum.

        For x > 0 none is below the smallest of (L x)_i / x_i: by Gershgorin's circles of X^-1 L X,
        as L has no positive entries beside its diagonal. Inverse iteration finds an x.
        """
        L, best = self.laplacian, 0.0
        x = np.ones(L.shape[0])
        for _ in range(STEPS):
            x = factors.solve(x)
            x /= np.abs(x).max() or 1.0
            if not np.all(x > SMALLEST_NORMAL / EPSILON):  # NaN too
                break
            product = L @ x
            best = max(best, float(np.min((product - rounding * (abs(L) @ x)) / x)))
            if best > ENOUGH * (x @ product) / (x @ x):
                break
        return best
