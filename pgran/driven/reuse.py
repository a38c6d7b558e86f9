"""When a fresh factorization pays: decided by iteration counts and prices, never by clocks.

So a run repeats exactly.
"""

import math

from pgran.run.petsc import PETSc

FACTORIZATIONS = ("lu", "cholesky")
# What a factorization costs in Krylov iterations, for each entry of the factor and ball; measured.
FACTOR_PRICE = {"petsc": 0.4, "mumps": 0.075}


class ReusePolicy:
    """Decides before each frequency whether to factor anew.

    A cycle is a factorization and the frequencies it serves. It ends when the next frequency is
    expected to take more than the cycle's price for each frequency so far. What to expect: what the
    last one took, or, right after factoring, what the first reuse took in an earlier cycle. With a
    limit it ends when the last frequency took more iterations than that.
    """

    def __init__(self, limit=0):
        """Start without a factorization."""
        self.limit, self.price = limit, 0.0
        self.restart()

    def restart(self):
        """Forget the past: the next frequency gets a fresh factorization."""
        self._served, self._spent, self._last, self._first = 0, 0, math.inf, None

    def due(self, guess=0.0):
        """Return whether to factor before the next frequency.

        `guess` is what to expect of a first reuse while there is no experience.
        """
        if self._served == 0:
            return True
        if self.limit:
            return self._last > self.limit
        expected = self._last
        if self._served == 1:
            expected = guess if self._first is None else self._first
        return expected * self._served >= self.price + self._spent

    def patience(self):
        """Return after how many iterations a reused factorization is given up."""
        return None if self.limit or not self.price else max(4, math.ceil(2 * self.price))

    def count(self, fresh, iterations):
        """Note how many iterations a frequency took."""
        if fresh:
            self._served = self._spent = 0
        self._served += 1
        self._spent += iterations
        self._last = iterations
        if self._served == 2:
            self._first = iterations

    def count_failure(self):
        """Note that reusing the factorization did not work."""
        if self._served == 1:
            self._first = math.inf


def expected_iterations(before, s, axes, mass, damping):
    """Return the iterations that a solve at s takes with the factorization made at `before`.

    A resonance of the lattice is about |s| (2 d beta + sigma m) wide in m s^2, 2 d the mean
    eigenvalue of C. Each application of the old factorization reduces the residual by the part of
    that width which m s^2 has moved.
    """
    width = 2 * axes * abs(s) * damping + abs(s) * s.real * mass
    moved = mass * abs(s * s - before * before)
    if moved == 0:
        return 1.0
    if moved >= width:
        return math.inf
    return math.log(1e-6) / (2 * math.log(moved / width))


def factor_price(pc, balls):
    """Return what a factorization costs in Krylov iterations, from its size. Collective."""
    if pc.getType() not in FACTORIZATIONS:
        return 0.0
    info = pc.getFactorMatrix().getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)
    return FACTOR_PRICE.get(pc.getFactorSolverType(), 0.2) * info["nz_used"] / balls
