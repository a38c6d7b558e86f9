"""One system for everything: S(s) = K + s beta C + s^2 m, with K = B^T diag(k) B and C = B^T B.

B has a row for each bond: what lengthens it. Loss angles make k complex, drag adds to C's diagonal
(`pgran.medium.dissipation`). Walls are no unknowns; the driven one's bonds give the drive f(s), the
sum of k + s beta at their balls, a push a constant one (`pgran.medium.source`). All
matrices share one nonzero pattern, so that S is combined anew for each s without assembly, and
factored symbolically only once. How unknowns are numbered and shared out, and which of them a bond
joins, a layout knows (`layout`).
"""

from functools import cached_property

import numpy as np
from mpi4py import MPI

from pgran.driven.layout import LatticeLayout, NetworkLayout
from pgran.driven.owner import Owner
from pgran.run.petsc import PETSc

SAME = PETSc.Mat.Structure.SAME_NONZERO_PATTERN


class Operators(Owner):
    """A driven medium, the same on all ranks that share it, as distributed matrices. Collective.

    K is the graph Laplacian weighted by the constants, `damping` times C all that damps in
    proportion to s, None where nothing damps; the vector M holds the masses. S and f are the driven
    system at the s of the last `combine`. No eigenvalue of K is below `softest`, which is None
    while that is unknown. `layout` numbers the unknowns. Destroy with `destroy` or `with`.
    """

    owns = ("K", "C", "M", "_inertia", "S", "f", "f_stiffness", "f_damping", "sizes", "layout")

    def __init__(self, lattice, comm):
        self.lattice, self.comm = lattice, comm
        self.shape, self.size = lattice.shape, lattice.size
        self.mass, self.damping, self.axes = lattice.mass, lattice.damping_unit, lattice.axes
        self.rounding = lattice.rounding
        self.layout = (LatticeLayout if lattice.is_grid else NetworkLayout)(lattice, comm)
        self.first, self.last = self.layout.first, self.layout.last
        self.f_stiffness, self.M, self._inertia = (self.layout.like.duplicate() for _ in range(3))
        self.M.set(self.mass)
        self.constants, self.softest = lattice.moduli, None
        self.K = self._assemble(self.constants)
        # this rank's rows of the push, 0 where none drives
        self._push = 0.0 if lattice.pushed is None else self.layout.rows(lattice.pushed)
        self.f_stiffness.setArray(self.layout.driving(self.constants) + self._push)
        self.C = self.f_damping = None
        if self.damping > 0:
            self.C, self.f_damping = self._assemble(lattice.dashpots), self.f_stiffness.duplicate()
            self._set_damping()

    @cached_property
    def S(self):  # noqa: N802
        """The matrix of the driven system. Collective when first asked for."""
        return self.K.duplicate()

    @cached_property
    def f(self):
        """The drive. Collective when first asked for."""
        return self.f_stiffness.duplicate()

    @cached_property
    def laplacian(self):
        """Whether K and C have no positive entries beside their diagonals.

        Then |K| x = 2 diag(K) x - K x, and the forces that drive a ball are all of one sign.
        """
        real = np.isrealobj(self.constants)  # else magnitudes of sums are not sums of magnitudes
        return self.layout.laplacian and real and bool(self.constants.min() >= 0)

    @cached_property
    def doubled_diagonals(self):
        """Twice this rank's diagonals of K and of C, 0 where there is none.

        Collective when first asked for.
        """
        doubled = [0.0, 0.0]
        for number, matrix in enumerate((self.K, self.C)[: 1 + (self.C is not None)]):
            diagonal = matrix.getDiagonal()
            doubled[number] = 2 * diagonal.getArray(readonly=True).real
            diagonal.destroy()
        return doubled

    @cached_property
    def stiffness_norm(self):
        """No less, but for rounding, than the 2-norm of |K|. Collective when first asked for.

        It is the largest sum in a row. A Laplacian's |K| is 2 diag(K) less K, which has no negative
        eigenvalues.
        """
        if self.laplacian:
            sums = self.doubled_diagonals[0]
        else:
            ones, product = self.M.duplicate(), self.M.duplicate()
            ones.set(1.0)
            self.sizes[0].mult(ones, product)
            sums = product.getArray().real.copy()
            ones.destroy()
            product.destroy()
        return self.comm.allreduce(float(sums.max(initial=0.0)), MPI.MAX)

    @cached_property
    def sizes(self):
        """K, f_stiffness, C and f_damping with the magnitudes of all springs' parts summed up.

        Collective when first asked for; they say what rounding does to what is no Laplacian.
        """
        matrices = []
        parts = (self.constants, self._push), (self.lattice.dashpots, 0.0)
        for constants, push in parts[: 1 + (self.C is not None)]:
            drive = self.f_stiffness.duplicate()
            drive.setArray(self.layout.driving(constants, np.abs) + np.abs(push))
            matrices += [self._assemble(constants, self.layout.sizes), drive]
        if self.C is not None:
            self._drag(matrices[2])
        return matrices

    def combine(self, s):
        """Set S(s) = K + s beta C + s^2 M and the drive f(s) (paper: ampeq, s = i omega).

        Collective. Raises ValueError if the real part of s is negative: no error is bounded there.
        """
        s = complex(s)
        if not s.real >= 0:
            raise ValueError(f"the real part of s must be 0 or more, not {s.real}")
        self.s = s
        self.K.copy(self.S, structure=SAME)
        self.f_stiffness.copy(self.f)
        if self.C is not None:
            self.S.axpy(s * self.damping, self.C, structure=SAME)
            self.f.axpy(s * self.damping, self.f_damping)
        self._inertia.set(self.mass * s * s)  # in this order: s^2 alone could underflow
        self.S.setDiagonal(self._inertia, addv=PETSc.InsertMode.ADD_VALUES)  # faster than a shift
        # Complex symmetric, not Hermitian: what an LDL^T factorization needs to know.
        self.S.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self.S.setOption(PETSc.Mat.Option.HERMITIAN, False)

    def block(self, columns):
        """Return a dense matrix of so many columns of unknowns, which the caller destroys.

        Collective.
        """
        shape = self.f_stiffness.getSizes(), (None, columns)
        block = PETSc.Mat().createDense(shape, comm=self.comm)
        block.setUp()
        block.assemble()
        return block

    def stretch(self, columns, bonds):
        """Return b^T x for some bonds and each column x, walls at rest: shape (bonds, columns).

        Collective; `columns` holds this rank's rows, the result is the same on every rank.
        """
        stretches = np.zeros((len(bonds), columns.shape[1]), dtype=complex)
        for entries, rows, mine in self.layout.own_entries(bonds):
            stretches[mine] += entries[:, None] * columns[rows]
        if self.comm.size > 1:
            self.comm.Allreduce(MPI.IN_PLACE, stretches)
        return stretches

    def spread(self, bonds, columns):
        """Set columns to b = B^T e of some bonds, as far as it lies in this rank's rows.

        Columns beyond those of the bonds become zero.
        """
        columns[:] = 0.0
        for entries, rows, mine in self.layout.own_entries(bonds):
            columns[rows, mine] = entries

    def set_stiffness(self, constants, bonds=None):
        """Set all constants in K and in the drive; only some `bonds` differ, if these are given.

        Collective. S waits for `combine`; what follows from K is computed anew. Where dashpots or
        losses depend on the constants, they change with them.
        """
        if self.lattice.has_law:
            self.lattice, bonds = self.lattice.with_constants(constants), None
            constants = self.lattice.moduli
            if self.C is not None:
                self.C.setValuesCSR(*self.layout.csr(self.lattice.dashpots))
                self.C.assemble()
                self._set_damping()
        self.constants, self.softest = constants, None
        self.forget("sizes")
        for name in ("laplacian", "doubled_diagonals", "stiffness_norm"):
            vars(self).pop(name, None)
        if bonds is None:
            self.K.setValuesCSR(*self.layout.csr(constants))
        else:
            self.layout.change(self.K, bonds, constants)
        self.K.assemble()
        if bonds is None or self.layout.drive[bonds].any():
            self.f_stiffness.setArray(self.layout.driving(constants) + self._push)

    def _set_damping(self):
        """Complete C by the drag, and set the drive's dashpots. Collective."""
        self._drag(self.C)
        self.f_damping.setArray(self.layout.driving(self.lattice.dashpots))

    def _drag(self, C):
        """Add what drag there is to a matrix like C. Collective."""
        if self.lattice.drags is None:
            return
        drag = self.layout.vector(np.reshape(self.lattice.dragged, self.shape))
        C.setDiagonal(drag, addv=PETSc.InsertMode.ADD_VALUES)
        drag.destroy()

    def _assemble(self, constants, csr=None):
        """Return the matrix B^T diag(k) B."""
        size, csr = self.f_stiffness.getSizes(), (csr or self.layout.csr)(constants)
        return PETSc.Mat().createAIJ((size, size), csr=csr, comm=self.comm)
