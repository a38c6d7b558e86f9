"""What patterns of balls pass on to one another, e^T S^-1 f, at one s after the other, with bounds.

A pattern is a real force on all unknowns, and reads an amplitude of each: S is symmetric, so that
the adjoint of a receiver is the field of a source there. Take x of S x = f and z of S z = e as
computed, with residuals r and q. Then

    e^T S^-1 f - (e^T x + z^T r) = q^T S^-1 r,

and so the sum in parentheses is wrong by |q|_2 |r|_2 |S^-1| at most, and by what rounding does to
it. That is bounded ball by ball, by |z|^T (|f| + |S| |x|) in units of roundoff, because amplitudes
fall by many orders across a medium. A pattern is its own adjoint: f^T S^-1 f takes one solution.
"""

from functools import cached_property
from typing import NamedTuple

import numpy as np
from mpi4py import MPI
from scipy.sparse import csc_matrix

from pgran.driven.columns import Columns, Solved
from pgran.driven.linear import LEAST_NORM
from pgran.driven.steady import SteadySolver
from pgran.medium.rounding import EPSILON, SMALLEST_NORMAL
from pgran.run.petsc import PETSc


class Fields(NamedTuple):
    """The fields of some patterns: their systems, and facts of each pattern, shape (n,)."""

    systems: Solved
    residual: np.ndarray  # bounds of |f - S x|_2
    size: np.ndarray  # of |x|_2
    entries: np.ndarray  # how many of f are not zero

    def take(self, numbers):
        """Return the fields of some of the patterns."""
        systems = Solved(*(array[:, numbers] for array in self.systems))
        return Fields(systems, *(facts[numbers] for facts in self[1:]))


class PatternSolver(SteadySolver):
    """Solves for many patterns at one s after the other; destroy with `destroy` or `with`.

    Collective. Patterns are real arrays (m, unknowns), in the medium's order of its mass-weighted
    unknowns: a force F on balls is the pattern w F, and a displacement is read by the same, w the
    displacement per unknown. Where no bound of |S^-1| is known, those of errors are infinite, and
    `backward_error`, the largest |f - S x| / (|S| |x| + |f|) of the last patterns, says how good
    solutions are. `choices` are keywords of `SteadySolver`.
    """

    owns = (*SteadySolver.owns, "_columns")

    def __init__(self, operators, **choices):
        """Make the solver; it reads no balls."""
        super().__init__(operators, np.empty((0, len(operators.shape)), dtype=int), **choices)
        self.backward_error = np.nan

    def solve(self, s):
        """Factor S(s) and bound the norm of its inverse; return whether that worked. Collective.

        Each S has its own factorization, so that results do not depend on what was solved before.
        """
        self.restart()
        self.backward_error = np.nan
        return super().solve(s).converged_reason > 0

    def diagonal(self, patterns):
        """Return f^T S^-1 f of each pattern f, shape (m,), and bounds of the errors.

        Collective. After a failure values are NaN, and bounds infinite.
        """
        with np.errstate(all="ignore"):  # what is not finite has no bound
            return self._carried_out(self._diagonal, (len(patterns),), patterns)

    def products(self, receivers, sources):
        """Return e^T S^-1 f of all receivers e and sources f, shape (ne, nf), and bounds.

        Collective. Patterns that occur several times are solved for once. See `diagonal`.
        """
        with np.errstate(all="ignore"):
            shape = len(receivers), len(sources)
            return self._carried_out(self._products, shape, receivers, sources)

    @cached_property
    def _columns(self):
        """Blocks of right-hand sides."""
        return Columns(self)

    @cached_property
    def _places(self):
        """Which of the medium's unknowns this rank's rows are. Collective when first asked for."""
        numbers = self.operators.layout.vector(
            np.arange(self.operators.size).reshape(self.operators.shape)
        )
        places = numbers.getArray().real.astype(int)
        numbers.destroy()
        return places

    def _carried_out(self, compute, shape, *patterns):
        """Return what is computed of patterns, or nothing known if this s, or PETSc, has failed."""
        if not self._spoilt:
            try:
                return compute(*(np.asarray(some, dtype=float) for some in patterns))
            except PETSc.Error as error:
                self._tell(self.operators.s, error)
            self._renew()
            self._spoilt = True
        self.backward_error = np.nan
        return np.full(shape, np.nan + 0j), np.full(shape, np.inf)

    def _diagonal(self, patterns):
        """See `diagonal`."""

        def by_column(a, b):
            return np.einsum("ij,ij->j", a, b)

        found = [self._paired(fields, fields, by_column) for fields in self._fields(patterns)]
        values, bounds = map(np.concatenate, zip(*found, strict=True))
        return values, bounds

    def _products(self, receivers, sources):
        """See `products`."""
        several, first_of = np.concatenate([receivers, sources]), {}
        number = [first_of.setdefault(pattern.tobytes(), len(first_of)) for pattern in several]
        once = several[np.unique(number, return_index=True)[1]]
        systems, *facts = zip(*self._fields(once), strict=True)
        systems = Solved(*map(np.hstack, zip(*systems, strict=True)))
        fields = Fields(systems, *map(np.concatenate, facts))
        read, pushed = np.split(np.array(number), [len(receivers)])
        read, pushed = fields.take(read), fields.take(pushed)
        # a ball has few of the unknowns
        pattern = csc_matrix(read.systems.force.real)
        read = read._replace(systems=read.systems._replace(force=pattern))
        return self._paired(read, pushed, lambda a, b: a.T @ b)

    def _fields(self, patterns):
        """Yield the `Fields` of some patterns after the other."""
        bounds, worst, rows = self.bounds, 0.0, patterns[:, self._places]

        def fill(some, columns):
            columns[:, : len(some)] = rows[some].T

        for systems in self._columns.refined(range(len(rows)), fill):
            force, size, missed, rounding = self._columns.norms(*systems)
            total = np.maximum(bounds.scale * size + force, LEAST_NORM)
            worst = np.maximum(worst, np.max(missed / total))  # NaN stays
            residual = 1.01 * (missed + bounds.unit * rounding) + bounds.lost
            entries = self._total(np.count_nonzero(systems.force, axis=0))
            yield Fields(systems, residual, 1.01 * size + bounds.lost, entries)
        self.backward_error = float(worst)

    def _paired(self, receivers, sources, pair):
        """Return corrected values of pairs, receivers e and sources f, and bounds of their errors.

        `pair(a, b)` sums products over the rows, for each pair of columns of a and b.
        """
        (e, z, *_), (_, x, r, terms) = receivers.systems, sources.systems
        values = self._total(pair(e, x) + pair(z, r))
        # An e may be rounded as well as f, and its entries' products are summed up.
        reading = EPSILON * self._total(pair(abs(e), np.abs(x)))
        reading = ((receivers.entries + 8.0) * reading.T).T
        sums = (self.bounds.unit + 8 * EPSILON) * self._total(pair(np.abs(z), terms))
        size = self.operators.size
        missed, z_size, r_size = (
            receivers.residual[None],
            receivers.size[None],
            sources.residual[None],
        )
        theory = pair(missed, r_size) * self.bounds.inverse_norm
        product = (size + 2) * EPSILON * pair(z_size, r_size)
        bounds = 1.01 * (theory + reading + sums + product) + 4 * EPSILON * np.abs(values)
        bounds += 16 * size * SMALLEST_NORMAL  # what products lose
        return values, np.where(np.isfinite(values) & np.isfinite(bounds), bounds, np.inf)

    def _total(self, parts):
        """Return the sum over the ranks of what each has of an array."""
        parts = np.ascontiguousarray(parts)
        if self.comm.size > 1:
            self.comm.Allreduce(MPI.IN_PLACE, parts)
        return parts
