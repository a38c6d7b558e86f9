"""Bounds of the errors of driven amplitudes ball by ball, where norms say too little.

Above the highest mode, and behind strong damping, amplitudes fall by many orders from ball to ball,
and a product of norms proves nothing of an amplitude of 1e-30. There the comparison matrix <S>,
|S_pp| on the diagonal and -|S_pq| beside it, is an M-matrix, and then |S^-1| <= <S>^-1 entry by
entry (Ostrowski 1937). So with a residual r = f - S A~ and any v

    v > 0 and <S> v >= |r|  prove  |A - A~| <= v,

since a matrix without positive entries beside its diagonal, which takes one positive vector to
another, is an M-matrix. A ball's neighbours belong to the other sublattice; changing the sign of
one sublattice turns S of an undamped lattice into -<S> when m omega^2 exceeds every K_pp, and so
<S> is positive definite exactly above the highest mode. (So it is below the lowest mode, where S is
its own comparison matrix.) Where it is not, v has negative entries.
"""

from functools import cached_property

import numpy as np
from mpi4py import MPI

from pgran.driven.linear import make_ksp, set_up
from pgran.driven.operators import Owner
from pgran.medium.base import SMALLEST_NORMAL
from pgran.run.petsc import PETSc

LEAST_PROVEN = 1e-290  # no bound that is proven of an amplitude's error is smaller


class Comparison(Owner):
    """Finds and verifies v for one s after the other, by a KSP `steady_comparison_`. Collective."""

    owns = ("v", "_target", "_product", "_ksp", "_matrix")

    def __init__(self, operators):
        self.operators, self.comm = operators, operators.comm
        self.v, self._target, self._product = (operators.f.duplicate() for _ in range(3))

    @cached_property
    def _matrix(self):
        """<S>. Collective when first asked for."""
        return self.operators.S.duplicate()

    @cached_property
    def _ksp(self):
        """What solves with it. Collective when first asked for."""
        return make_ksp(self.operators, self._matrix, "steady_comparison_", "preonly")

    def prepare(self):
        """Set and factor <S> for this s; return whether it may prove anything. Collective."""
        pointer, columns, values = self.operators.S.getValuesCSR()
        first, last = self.operators.S.getOwnershipRange()
        size = np.abs(values)
        on_diagonal = columns == np.repeat(np.arange(first, last), np.diff(pointer))
        size[~on_diagonal] *= -1.0
        self._matrix.setValuesCSR(pointer, columns, size.astype(complex))
        self._matrix.assemble()
        self._matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self._matrix.setOption(PETSc.Mat.Option.HERMITIAN, False)  # which MUMPS cannot factor
        if self.comm.allreduce(size.sum()) <= 0:  # 1^T <S> 1 shows at once where it is no use
            return False
        works = set_up(self._ksp, self._matrix, self.operators)
        if not works:
            self.forget("_ksp", "_matrix")
        return works

    def verified(self, residual, bounds):
        """Return a vector that no error of an amplitude exceeds, or None. Collective.

        After `prepare`; the next call overwrites it. `residual` is positive and no less than
        |f - S A~|, rounding included, ball by ball; `bounds`, an `Accuracy`, is prepared for s.
        """
        # Room for the rounding of the product below; and no v so small that it vanishes.
        self._target.setArray(4 * residual + LEAST_PROVEN * bounds.scale)
        self._ksp.solve(self._target, self.v)
        v = self.v.getArray().real
        self.v.setArray(v)
        self._matrix.mult(self.v, self._product)
        product = self._product.getArray(readonly=True).real
        rounding = bounds.unit * bounds.product_sizes(self.v) + 16 * SMALLEST_NORMAL
        proven = bool(np.all((v > 0) & (v < np.inf) & (product - rounding >= residual)))
        return self.v if self.comm.allreduce(proven, MPI.LAND) else None
