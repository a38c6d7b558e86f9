"""When a fresh factorization pays: decided by iteration counts and prices, never by clocks.

So a run repeats exactly.
"""

import math

from petsc4py import PETSc

# What a factorization costs in Krylov iterations, for each entry of the factor and ball; measured.
FACTOR_PRICE = {"petsc": 0.4, "mumps": 0.075}


class ReusePolicy:
    """Decides before each frequency whether to factor anew.

    A cycle is a factorization and the frequencies it serves. It ends when the next frequency is
    expected to take more than the cycle's price for each frequency so far. What to expect: what the
    last one took, or, right after factoring, what the first reuse took in an earlier cycle.

    Parameters
    ----------
    limit : int
        Refresh when the last frequency took more iterations than this; 0 decides by price.
    """

    def __init__(self, limit=0):
        """Start without a factorization."""
        self.limit = limit
        self.price = 0.0
        self.restart()

    def restart(self):
        """Forget the past: the next frequency gets a fresh factorization."""
        self._served, self._spent, self._last, self._first = 0, 0, math.inf, 0

    def due(self):
        """Return whether to factor before the next frequency."""
        if self._served == 0:
            return True
        if self.limit:
            return self._last > self.limit
        expected = self._first if self._served == 1 else self._last
        return expected * self._served >= self.price + self._spent

    def count(self, fresh, iterations):
        """Note what a frequency took."""
        if fresh:
            self._served, self._spent, self._last = 1, iterations, iterations
            return
        self._served += 1
        self._spent += iterations
        self._last = iterations
        if self._served == 2:
            self._first = iterations


def factor_price(pc, balls):
    """Return what a factorization costs in Krylov iterations, from the size of the factor."""
    if pc.getType() not in ("lu", "cholesky"):
        return 0.0
    info = pc.getFactorMatrix().getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)
    return FACTOR_PRICE.get(pc.getFactorSolverType(), 0.2) * info["nz_used"] / balls
