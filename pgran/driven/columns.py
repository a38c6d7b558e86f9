"""Many right-hand sides of S solved at a time, with bounds of the norms and residuals."""

import numpy as np
from mpi4py import MPI

from pgran.driven.deformation import squares
from pgran.driven.operators import SAME
from pgran.driven.owner import Owner

COLUMNS = 32  # right-hand sides solved for at once


class Columns(Owner):
    """Solves with the factorization of S, as it is, that a solver has; destroy with `destroy`.

    Collective.
    """

    owns = ("_rhs", "_found", "_residual")

    def __init__(self, solver):
        """Make the blocks of right-hand sides and solutions."""
        self.solver, self.operators = solver, solver.operators
        self.comm = self.operators.comm
        self._rhs, self._found, self._residual = (self.operators.block(COLUMNS) for _ in range(3))

    def solved(self, items, fill, size):
        """Yield some items, this rank's rows of S^-1 b for each, and bounds of norms and residuals.

        Collective. `fill(items, array)` sets this rank's rows of the right-hand sides b, one for
        each item, with |b|_2 <= size. The bounds, of |S^-1 b| as computed and of the residual, are
        the same on every rank. A KSP may make up for an inexact factorization; here its residual
        shows.
        """
        S, factor, bounds = self.operators.S, self.solver.factor, self.solver.bounds
        for start in range(0, len(items), COLUMNS):
            some = items[start : start + COLUMNS]  # the last block may be narrower
            fill(some, self._rhs.getDenseArray())
            self._rhs.assemble()
            factor.matSolve(self._rhs, self._found)
            S.matMult(self._found, self._residual)
            self._residual.axpy(-1.0, self._rhs, structure=SAME)
            solutions, missed = (
                block.getDenseArray(readonly=True)[:, : len(some)]
                for block in (self._found, self._residual)
            )
            total = np.stack([squares(solutions), squares(missed)])
            if self.comm.size > 1:
                self.comm.Allreduce(MPI.IN_PLACE, total)
            norms, residuals = 1.01 * np.sqrt(total)
            norms += bounds.lost
            residuals += bounds.unit * (size + bounds.scale * norms) + bounds.lost
            yield some, solutions, norms, residuals
