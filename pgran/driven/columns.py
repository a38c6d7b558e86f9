"""Many right-hand sides of S solved at a time, with their residuals and bounds of these."""

from typing import NamedTuple

import numpy as np
from mpi4py import MPI

from pgran.driven.deformation import squares
from pgran.driven.linear import LEAST_NORM
from pgran.driven.operators import SAME, Owner

COLUMNS = 32  # right-hand sides solved for at once


class Solved(NamedTuple):
    """Systems S x = b, a column each: arrays of this rank's rows (rows, n), and (n,) of all."""

    force: np.ndarray  # b
    solution: np.ndarray  # x as computed
    residual: np.ndarray  # b - S x as computed
    terms: np.ndarray  # |b| + (|K| + |s| beta |C| + |s|^2 m) |x|: what rounds in the residual
    missed: np.ndarray  # bounds of |b - S x|_2
    backward_error: np.ndarray  # |b - S x| / (|S| |x| + |b|)

    @classmethod
    def joined(cls, blocks):
        """Return the systems of several blocks as one."""
        return cls(*(np.concatenate(parts, axis=-1) for parts in zip(*blocks, strict=True)))

    def take(self, numbers):
        """Return some of the systems."""
        return Solved(*(array[..., numbers] for array in self))


class BlockSolver(Owner):
    """Solves with the factorization of S, as it is, that a solver has; destroy with `destroy`.

    Collective. Without a factorization the solver's KSP solves, column by column.
    """

    owns = ("_rhs", "_found", "_residual")

    def __init__(self, solver):
        self.solver, self.operators = solver, solver.operators
        self.comm, self._width = self.operators.comm, 0

    def solved(self, items, fill, size):
        """Yield some items, this rank's rows of S^-1 b for each, and bounds of norms and residuals.

        Collective. `fill(items, array)` sets this rank's rows of the right-hand sides b, one for
        each item, with |b|_2 <= size. The bounds are of |S^-1 b| as computed and of the residual.
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

        What rounding does not explain of a residual is solved for once more.
        """
        bounds = self.solver.bounds
        for some in self._blocks(items, fill):
            blocks = self._rhs, self._found, self._residual
            force, size, missed = self.norms(*self._arrays(len(some), *blocks))
            total = bounds.scale * size + force
            if not np.all(missed <= bounds.unit * total):  # NaN too
                self._refine()
                _, size, missed = self.norms(*self._arrays(len(some), *blocks))
                total = bounds.scale * size + force
            rhs, solution, excess = (array.copy() for array in self._arrays(len(some), *blocks))
            terms = np.abs(rhs) + self._magnitudes(len(some))
            (rounding,) = self.norms(terms)
            bound = 1.01 * (missed + bounds.unit * rounding) + bounds.lost
            backward = missed / np.maximum(total, LEAST_NORM)
            yield Solved(rhs, solution, -excess, terms, bound, backward)

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
        """Compute S x - b, in one pass over b, which b - S x would not."""
        self.operators.S.matMult(self._found, self._residual)
        self._residual.axpy(-1.0, self._rhs, structure=SAME)

    def _refine(self):
        """Take S^-1 (S x - b) off x."""
        solution = self._found.getDenseArray().copy()
        self.solver.invert(self._residual, self._found)
        corrected = self._found.getDenseArray()
        np.subtract(solution, corrected, out=corrected)
        self._found.assemble()
        self._update_residual()

    def _magnitudes(self, count):
        """Return (|K| + |s| beta |C| + |s|^2 m) |x| of so many columns; overwrite b and x."""
        self._rhs.getDenseArray()[:] = np.abs(self._found.getDenseArray(readonly=True))
        self._rhs.assemble()
        (size,) = self._arrays(count, self._rhs)

        def times_sizes(matrix):
            matrix.matMult(self._rhs, self._found)
            return self._arrays(count, self._found)[0]

        return self.solver.bounds.magnitudes(size.real.copy(), times_sizes)
