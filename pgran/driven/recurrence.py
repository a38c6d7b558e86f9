"""Real three-term recurrences of a medium's matrices, a product a term, over all ranks.

    y_1 = H y_0 / 2,    y_(n+1) = H y_n + back y_(n-1)

With H = 2 X and back = -1 these are Chebyshev's T_n(X) y_0. What a term needs is one product of
a real sparse matrix: PETSc's complex one would take twice the time and memory. So each rank has
its rows as a matrix of SciPy's, whose columns are its own unknowns, then those of others, ghosts,
which a star forest of PETSc's brings. Sums are the same on any ranks but for rounding.
"""

import math

import numpy as np
from mpi4py import MPI

from pgran.driven.operators import NetworkLayout, Owner, unchanged
from pgran.driven.slabs import SlabLayout
from pgran.medium.base import EPSILON
from pgran.run.petsc import PETSc

CHUNK = 2**15  # entries summed up at once
U = EPSILON / 2  # of one rounding
POWERS = 20  # steps of a power iteration that sharpen an enclosure
NANOSECONDS = 1.0, 0.45, 2e4  # that a term takes an unknown, a nonzero of its row, and at least
LEAST = 1e-3  # of the largest entry of its vector


class NoSeriesError(ValueError):
    """Says why there is no series for a medium or its frequencies."""


def compounded(n):
    """Return what n roundings do to a product or sum at most: n u / (1 - n u)."""
    return n * U / (1 - n * U)


class Rows(Owner):
    """This rank's rows of matrices B^T diag(k) B; destroy with `destroy` or `with`. Collective.

    Raises a NoSeriesError where no spring is stiff.
    """

    owns = ("_forest", "layout")

    def __init__(self, medium, comm):
        if not medium.constants.any():
            raise NoSeriesError("a medium without stiff springs")
        self.comm = comm
        layout = self.layout = (SlabLayout if medium.is_grid else NetworkLayout)(medium, comm)
        first, last = layout.first, layout.last
        self.own = last - first
        self._pointer, columns, _ = layout.csr(medium.constants)
        outside = (columns < first) | (columns >= last)
        ghosts = np.unique(columns[outside])
        self.width = self.own + len(ghosts)
        self._columns = columns - columns.dtype.type(first)
        self._columns[outside] = self.own + np.searchsorted(ghosts, columns[outside])
        starts = np.array([*self.comm.allgather(first), medium.size])
        owner = np.searchsorted(starts, ghosts, side="right") - 1
        remote = np.stack([owner, ghosts - starts[owner]], axis=1).astype(PETSc.IntType)
        self._forest = PETSc.SF().create(self.comm)
        self._forest.setGraph(self.own, None, remote.ravel())

    def matrix(self, constants, size=unchanged):
        """Return B^T diag(k) B; `size` is that of `Layout.csr`."""
        from scipy.sparse import csr_matrix

        _, _, values = self.layout.csr(constants, size)
        # a copy, as SciPy may sort what it is given, in place, beside the values of one matrix
        found = np.ascontiguousarray(values.real), self._columns.copy(), self._pointer
        return csr_matrix(found, (self.own, self.width))

    def filled(self, x):
        """Return vectors (fields, width) with their ghosts as their owners have them."""
        if self.comm.size > 1:
            for field in x:
                ends = field[: self.own], field[self.own :]
                self._forest.bcastBegin(MPI.DOUBLE, *ends, MPI.REPLACE)
                self._forest.bcastEnd(MPI.DOUBLE, *ends, MPI.REPLACE)
        return x

    def padded(self, x):
        """Return a vector with its ghosts, from this rank's part of it. Collective."""
        whole = np.zeros((1, self.width))
        whole[0, : self.own] = x
        return self.filled(whole)[0]

    def total(self, parts):
        """Return the sum over the ranks of arrays, each alike on all."""
        return self.comm.allreduce(parts) if self.comm.size > 1 else parts

    def largest(self, values):
        """Return the largest number of all ranks."""
        return self.comm.allreduce(float(np.max(np.asarray(values), initial=0.0)), MPI.MAX)

    def enclosed(self, sizes, rounding):
        """Return no less than the 2-norm of a symmetric matrix no larger than `sizes` anywhere.

        That is the spectral radius of N = `sizes`, at most the largest (N v)_i / v_i of any
        positive v (Collatz and Wielandt); entries of N are as computed, up to `rounding`.
        """
        vector, least = np.ones(self.own), math.inf
        for _ in range(POWERS):
            product = sizes @ self.padded(vector)
            least, largest = min(least, self.largest(product / vector)), self.largest(product)
            if not largest > 0:
                return 0.0
            vector = np.maximum(product / largest, LEAST)
        # to six digits: what ranks round differently must not decide the number of terms
        digit = 10.0 ** (math.floor(math.log10(least)) - 5)
        return math.ceil(least * (1 + 2 * rounding + 64 * U) / digit) * digit


class Recurrence:
    """The terms of y_0 under H (fields * own, fields * width), as each rank has them."""

    def __init__(self, rows, H, back=-1.0):
        self.rows, self.H, self.back = rows, H, back

    @property
    def seconds(self):
        """About how long a term takes one rank that has all rows. Collective."""
        unknowns, nonzeros = self.rows.total(np.array([self.H.shape[0], self.H.nnz]))
        return 1e-9 * (NANOSECONDS[0] * unknowns + NANOSECONDS[1] * nonzeros + NANOSECONDS[2])

    def terms(self, start, count):
        """Yield this rank's y_n, n < count, (fields, own), each to be read before the next but one.

        Collective.
        """
        own, fields = self.rows.own, len(start)
        before, now = np.zeros((2, fields, self.rows.width))
        now[:, :own] = start
        for n in range(count):
            yield now[:, :own]
            if n + 1 < count:
                product = (self.H @ self.rows.filled(now).ravel()).reshape(fields, own)
                if n == 0:
                    product /= 2
                following = before[:, :own]
                following *= self.back
                following += product
                before, now = now, before

    def read(self, start, read, count):
        """Return what is read of each y_n, n < count, and the norms of its fields. Collective.

        `read(field)` returns this rank's part of the numbers read of the last field.
        """
        readings, squares = [], np.empty((count, len(start)))
        for n, now in enumerate(self.terms(start, count)):
            squares[n] = [dot(field, field) for field in now]
            readings.append(read(now[-1]))
        return self.rows.total(np.array(readings)), np.sqrt(self.rows.total(squares))


def dot(x, y):
    """Return x . y of this rank's entries, wrong by compounded(CHUNK + 2) |x| |y| at most."""
    pieces = range(0, len(x), CHUNK)
    return math.fsum(float(x[i : i + CHUNK] @ y[i : i + CHUNK]) for i in pieces)
