"""Factors that are used again, for matrices near the one that they are of. NumPy and SciPy only."""

import numpy as np

SOLVE = 20  # multiplications of a factorization that take as long as an entry of a solve
FEWEST = 20  # solves that a factorization must cost, or it is not kept
INEXACT = 1e-6  # the part of a step that conjugate gradients leave out


class Factors:
    """Factors of the last matrix that was factored, which solve with others near it, too.

    Where a step opens or closes a few contacts, seven or so solves do. In three dimensions the time
    of a factorization grows like N^2: of 5000 spheres it is that of 50 solves. Where it is that of
    `FEWEST` or less, factors are not kept.
    """

    def __init__(self):
        self.factors, self.solves = None, 0

    def keep(self, factors):
        """Keep factors, if they are worth it."""
        lengths = np.diff(factors.L.indptr).astype(float)
        self.solves = int(lengths @ lengths / (SOLVE * lengths.sum()))
        self.factors = factors if self.solves >= FEWEST else None

    def solve(self, K, right):
        """Return x of K x = right by conjugate gradients, None where factoring K is cheaper.

        None, too, where K is seen not to be positive definite. In any case x leads downhill.
        """
        if self.factors is None:
            return None
        x, residual = np.zeros_like(right), right.copy()
        along = near = self.factors.solve(residual)
        size = first = residual @ near
        for _ in range(self.solves):
            product = K @ along
            curvature = along @ product
            if not curvature > 0:
                break
            x += size / curvature * along
            residual -= size / curvature * product
            near = self.factors.solve(residual)
            before, size = size, residual @ near
            if size <= INEXACT**2 * first:
                return x
            along = near + size / before * along
        self.factors = None
        return None
