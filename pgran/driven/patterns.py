"""What patterns of balls pass on to one another, e^T S^-1 f, at one s after the other, with bounds.

A pattern is a real force on all unknowns, and reads an amplitude of each: S is symmetric, so that
the adjoint of a receiver is the field of a source there. Take x of S x = f and z of S z = e as
computed, with residuals r and q. Then

    e^T S^-1 f - (e^T x + z^T r) = q^T S^-1 r,

and so the sum in parentheses is wrong by |q|_2 |r|_2 |S^-1| at most, and by what rounding does to
it. That is bounded ball by ball, by |z|^T (|f| + |S| |x|) in units of roundoff, because amplitudes
fall by many orders across a medium; so is |q|^T |S^-1 r| where norms say too little (`comparison`).
A pattern is its own adjoint: f^T S^-1 f takes one solution.
"""

from functools import cached_property, partial

import numpy as np
from mpi4py import MPI

from pgran.driven.amplitudes import is_accurate
from pgran.driven.columns import BlockSolver, Solved
from pgran.driven.steady import SteadySolver
from pgran.medium.base import EPSILON, SMALLEST_NORMAL
from pgran.run.petsc import PETSc


class PatternSolver(SteadySolver):
    """Solves for many patterns at one s after the other; destroy with `destroy` or `with`.

    Collective. Patterns are real arrays (m, unknowns), in the medium's order of its mass-weighted
    unknowns: a force F on balls is the pattern w F, and a displacement is read by the same, w the
    displacement per unknown. Where no bound of |S^-1| is known, those of errors are infinite;
    `backward_error` is the largest |f - S x| / (|S| |x| + |f|) of the last patterns. `choices` are
    keywords of `SteadySolver`.
    """

    owns = (*SteadySolver.owns, "_blocks")

    def __init__(self, operators, **choices):
        super().__init__(operators, np.empty((0, len(operators.shape)), dtype=int), **choices)
        self.backward_error = np.nan

    def solve(self, s):
        """Factor S(s) and bound the norm of its inverse; return whether that worked. Collective.

        Each S has its own factors: results do not depend on what was solved before.
        """
        self.restart()
        self.backward_error = np.nan
        return super().solve(s).converged_reason > 0

    @property
    def s(self):
        """The present s."""
        return self.operators.s

    def diagonal(self, patterns):
        """Return f^T S^-1 f of each pattern f, (m,), and bounds; NaN if that fails. Collective."""
        return self._carried_out(self._diagonal, (len(patterns),), patterns)

    def products(self, receivers, sources):
        """Return e^T S^-1 f of all receivers e and sources f, shape (ne, nf), and bounds.

        Collective. Patterns that occur several times are solved for once. See `diagonal`.
        """
        shape = len(receivers), len(sources)
        return self._carried_out(self._products, shape, receivers, sources)

    @cached_property
    def _blocks(self):
        """What solves for blocks of right-hand sides."""
        return BlockSolver(self)

    def _carried_out(self, compute, shape, *patterns):
        """Return what is computed of patterns, or nothing known if this s, or PETSc, has failed."""
        if not self._spoilt:
            try:
                with np.errstate(all="ignore"):  # what is not finite has no bound
                    return compute(*(np.asarray(some, dtype=float) for some in patterns))
            except PETSc.Error as error:
                self._tell(self.operators.s, error)
            self._renew()
            self._spoilt = True
        self.backward_error = np.nan
        return np.full(shape, np.nan + 0j), np.full(shape, np.inf)

    def _diagonal(self, patterns):
        """See `diagonal`."""
        by_column = partial(np.einsum, "ij,ij->j")
        found = [self._paired(fields, fields, by_column) for fields in self._fields(patterns)]
        return tuple(map(np.concatenate, zip(*found, strict=True)))

    def _products(self, receivers, sources):
        """See `products`."""
        several, first_of = np.concatenate([receivers, sources]), {}
        number = [first_of.setdefault(pattern.tobytes(), len(first_of)) for pattern in several]
        once = several[np.unique(number, return_index=True)[1]]
        fields = Solved.joined(self._fields(once))
        read, pushed = np.split(np.array(number), [len(receivers)])
        return self._paired(fields.take(read), fields.take(pushed), lambda a, b: a.T @ b)

    def _fields(self, patterns):
        """Yield the fields of some patterns after the other."""
        operators, self.backward_error = self.operators, 0.0
        unknowns = np.arange(operators.size).reshape(operators.shape)
        rows = patterns[:, operators.layout.free_values(unknowns)]

        def fill(some, columns):
            columns[:, : len(some)] = rows[some].T

        for fields in self._blocks.refined(range(len(rows)), fill):
            # of which a NaN stays
            self.backward_error = np.maximum(self.backward_error, fields.backward_error.max())
            yield fields

    def _paired(self, receivers, sources, pair):
        """Return corrected values of pairs, receivers e and sources f, and bounds of their errors.

        `pair(a, b)` sums products over the rows, for each pair of columns of a and b.
        """
        (e, z), (x, r, terms) = receivers[:2], sources[1:4]
        size, rows = self.operators.size, np.flatnonzero(e.any(axis=1))  # balls are few of them
        e, read = e[rows].real, x[rows]
        values = self._total(pair(e, read) + pair(z, r))
        # An e may be rounded as well as f, and its entries' products are summed up.
        entries = self._total(len(rows)) + 8
        rounding = entries * EPSILON * self._total(pair(np.abs(e), np.abs(read)))
        terms = (self.bounds.unit + 8 * EPSILON) * terms + (size + 2) * EPSILON * np.abs(r)
        rounding += self._total(pair(np.abs(z), terms + 64 * SMALLEST_NORMAL))
        rounding += 4 * EPSILON * np.abs(values) + 16 * size * SMALLEST_NORMAL
        theory = pair(receivers.missed[None], sources.missed[None]) * self.bounds.inverse_norm
        bounds = 1.01 * (theory + rounding)
        if not is_accurate(bounds, values, self.tolerance).all():
            errors = self._errors(sources)
            if errors is not None:
                theory = self._total(pair(self._missed(receivers), errors))
                bounds = np.fmin(bounds, 1.01 * (theory + rounding))
        return values, np.where(np.isfinite(values) & np.isfinite(bounds), bounds, np.inf)

    def _missed(self, fields):
        """Return bounds of |f - S x| at each of this rank's unknowns, shape (rows, n)."""
        return self.bounds.at_each_ball(np.abs(fields.residual), fields.terms)

    def _errors(self, fields):
        """Return bounds of the fields' errors, unknown by unknown, or None: see `comparison`."""
        comparison = self.bounds.comparison
        if not comparison.prepare():
            return None
        errors = np.empty(fields.solution.shape)
        for error, missed in zip(errors.T, self._missed(fields).T, strict=True):
            found = comparison.verified(missed, self.bounds)
            if found is None:
                return None
            error[:] = found.getArray(readonly=True).real
        return errors

    def _total(self, parts):
        """Return the sum over the ranks of what each has of an array."""
        parts = np.ascontiguousarray(parts)
        if self.comm.size > 1:
            self.comm.Allreduce(MPI.IN_PLACE, parts)
        return parts
