"""Many right-hand sides of S solved at a time, with their residuals and bounds of these."""

from typing import NamedTuple

import numpy as np
from mpi4py import MPI

from pgran.driven.deformation import squares
from pgran.driven.operators import SAME
from pgran.driven.owner import Owner

COLUMNS = 32  # right-hand sides solved for at once
PASSES = 4  # of iterative refinement, if each halves a residual


class Solved(NamedTuple):
    """Systems S x = b, a column each of this rank's rows: arrays (rows, n)."""

    force: np.ndarray  # b
    solution: np.ndarray  # x as computed
    residual: np.ndarray  # b - S x as computed
    terms: np.ndarray  # |b| + (|K| + |s| beta |C| + |s|^2 m) |x|: what rounds in the residual


class Columns(Owner):
    """Solves with the factorization of S, as it is, that a solver has; destroy with `destroy`.

    Collective. Without a factorization the solver's KSP solves, column by column.
    """

    owns = ("_rhs", "_found", "_residual")

    def __init__(self, solver):
        """Wait for right-hand sides, whose number says how wide blocks are."""
        self.solver, self.operators = solver, solver.operators
        self.comm, self._width = self.operators.comm, 0

    def solved(self, items, fill, size):
        """Yield some items, this rank's rows of S^-1 b for each, and bounds of norms and residuals.

        Collective. `fill(items, array)` sets this rank's rows of the right-hand sides b, one for
        each item, with |b|_2 <= size. The bounds, of |S^-1 b| as computed and of the residual, are
        the same on every rank. A KSP may make up for an inexact factorization; here its residual
        shows.
        """
        bounds = self.solver.bounds
        for some in self._blocks(items, fill):
            solutions, missed = self._arrays(len(some), self._found, self._residual)
            norms, residuals = 1.01 * self.norms(solutions, missed)
            norms += bounds.lost
            residuals += bounds.unit * (size + bounds.scale * norms) + bounds.lost
            yield some, solutions, norms, residuals

    def refined(self, items, fill):
        """Yield a `Solved` of some items after the other; `fill` is that of `solved`. Collective.

        Where residuals are larger than rounding makes them anyway, they are refined.
        """
        for some in self._blocks(items, fill):
            self._refine(len(some))
            force, solution, residual = (
                block.copy()
                for block in self._arrays(len(some), self._rhs, self._found, self._residual)
            )
            terms = np.abs(force) + self._magnitudes(len(some))
            yield Solved(force, solution, residual, terms)

    def norms(self, *arrays):
        """Return the 2-norm of each column of some arrays, the same on every rank. Collective."""
        total = np.stack([squares(array) for array in arrays])
        if self.comm.size > 1:
            self.comm.Allreduce(MPI.IN_PLACE, total)
        return np.sqrt(total)

    def _arrays(self, count, *blocks):
        """Return this rank's rows of the first columns of some blocks."""
        return [block.getDenseArray(readonly=True)[:, :count] for block in blocks]

    def _blocks(self, items, fill):
        """Yield some items after the other once their systems are solved, in blocks as wide."""
        blocks = max(1, -(-len(items) // COLUMNS))
        width = max(1, -(-len(items) // blocks))  # of which the last one may be narrower
        if width != self._width:
            self.forget(*self.owns)
            self._rhs, self._found, self._residual = (self.operators.block(width) for _ in range(3))
            self._width = width
        for start in range(0, len(items), width):
            some = items[start : start + width]
            fill(some, self._rhs.getDenseArray())
            self._rhs.assemble()
            self.solver.invert(self._rhs, self._found)
            self._update_residual()
            yield some

    def _update_residual(self):
        """Compute b - S x."""
        self.operators.S.matMult(self._found, self._residual)
        self._residual.aypx(-1.0, self._rhs, structure=SAME)

    def _refine(self, count):
        """Add S^-1 (b - S x) to x, for so many columns, while that halves a residual."""
        bounds = self.solver.bounds
        arrays = self._arrays(count, self._rhs, self._found, self._residual)
        force, size, before = self.norms(*arrays)
        for _ in range(PASSES):
            if np.all(before <= bounds.unit * (force + bounds.scale * size)):
                return
            solution = self._found.getDenseArray().copy()
            self.solver.invert(self._residual, self._found)
            corrected = self._found.getDenseArray()
            corrected += solution
            self._found.assemble()
            self._update_residual()
            size, after = self.norms(*self._arrays(count, self._found, self._residual))
            if not np.all(after <= before):  # NaN too: these were better as they were
                worse = ~(after <= before)
                self._found.getDenseArray()[:, :count][:, worse] = solution[:, :count][:, worse]
                self._found.assemble()
                self._update_residual()
            if not np.any(after < 0.5 * before):
                return
            before = np.fmin(after, before)

    def _magnitudes(self, count):
        """Return (|K| + |s| beta |C| + |s|^2 m) |x| of so many columns; overwrite b and x."""
        self._rhs.getDenseArray()[:] = np.abs(self._found.getDenseArray(readonly=True))
        self._rhs.assemble()
        (size,) = self._arrays(count, self._rhs)

        def times_sizes(matrix):
            matrix.matMult(self._rhs, self._found)
            return self._arrays(count, self._found)[0]

        return self.solver.bounds.magnitudes(size.real.copy(), times_sizes)
