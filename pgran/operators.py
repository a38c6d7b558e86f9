"""The matrices of a lattice on a PETSc DMDA: K, C, S(omega) and the drive f(omega).

K = B^T diag(k) B and C = B^T B are sums over all bonds, wall bonds included, B the incidence matrix
of bonds and balls. Both and S = K + i omega beta C - m omega^2 share one nonzero pattern, so that S
is combined anew for each frequency without assembly, and factored symbolically only once.
"""

import numpy as np
from petsc4py import PETSc

SAME = PETSc.Mat.Structure.SAME_NONZERO_PATTERN


class Operators:
    """The driven lattice as distributed matrices and vectors; destroy with `destroy` or `with`.

    Collective.

    Parameters
    ----------
    lattice : pgran.lattice.Lattice
        The same on every rank.
    comm : mpi4py.MPI.Comm
        The ranks that share this lattice.

    Attributes
    ----------
    K : petsc4py.PETSc.Mat
        Stiffness: the graph Laplacian weighted by the bond constants.
    C : petsc4py.PETSc.Mat or None
        Damping: the same with every constant 1. None for an undamped lattice.
    S, f : petsc4py.PETSc.Mat, petsc4py.PETSc.Vec
        The driven system at the frequency of the last `combine`.
    """

    def __init__(self, lattice, comm):
        """Assemble K, and C where there is damping."""
        self.shape, self.balls, self.comm = lattice.shape, lattice.balls, comm
        self.mass, self.damping = lattice.mass, lattice.damping
        self.da = PETSc.DMDA().create(
            sizes=self.shape, dof=1, stencil_width=1, stencil_type="star", comm=comm
        )
        self.K, self.f_stiffness = self._assemble(lattice.stiffness)
        self.C = self.f_damping = None
        if self.damping > 0:
            ones = [np.broadcast_to(1.0, k.shape) for k in lattice.stiffness]
            self.C, self.f_damping = self._assemble(ones)
        self.S, self.f = self.K.duplicate(), self.f_stiffness.duplicate()
        # Complex symmetric, not Hermitian: what an LDL^T factorization needs to know.
        self.S.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self.S.setOption(PETSc.Mat.Option.HERMITIAN, False)

    def destroy(self):
        """Free all PETSc objects. Collective."""
        for held in (self.K, self.C, self.S, self.f, self.f_stiffness, self.f_damping, self.da):
            if held is not None:
                held.destroy()

    def __enter__(self):
        """Return the operators."""
        return self

    def __exit__(self, *error):
        """Destroy them."""
        self.destroy()

    def combine(self, omega):
        """Set S = K + i omega beta C - m omega^2 and the drive f (paper: ampeq).

        Collective.
        """
        self.K.copy(self.S, structure=SAME)
        self.f_stiffness.copy(self.f)
        if self.C is not None:
            self.S.axpy(1j * omega * self.damping, self.C, structure=SAME)
            self.f.axpy(1j * omega * self.damping, self.f_damping)
        self.S.shift(-self.mass * omega**2)

    def change_bond(self, axis, bond, change):
        """Add `change` to one bond constant, in K and in the drive; S waits for `combine`.

        Collective.

        Parameters
        ----------
        axis : int
        bond : sequence of int
            Index into `stiffness[axis]`.
        change : float
        """
        ends = np.array([bond, bond])
        ends[0, axis] -= 1
        inside = (ends[:, axis] >= 0) & (ends[:, axis] < self.shape[axis])
        balls = self.numbers(ends[inside])
        signs = np.array([1.0, -1.0])[inside]
        first, last = self.K.getOwnershipRange()
        mine = (balls >= first) & (balls < last)
        self.K.setValues(
            balls[mine], balls, change * np.outer(signs[mine], signs), addv=PETSc.InsertMode.ADD
        )
        self.K.assemble()
        if axis == 0 and bond[0] == self.shape[0]:
            self.f_stiffness.setValues(
                balls[mine], np.full(mine.sum(), change), addv=PETSc.InsertMode.ADD
            )
            self.f_stiffness.assemble()

    def numbers(self, sites):
        """Return PETSc's global numbers of balls given by their indices, shape (count, dim).

        Collective.
        """
        natural = np.ravel_multi_index(np.asarray(sites).T, self.shape, order="F")
        return self.da.getAO().app2petsc(np.array(natural, dtype=PETSc.IntType))

    def field(self, x):
        """Return a vector as an array over the lattice on rank 0, None on the others.

        Collective.
        """
        natural = self.da.createNaturalVec()
        self.da.globalToNatural(x, natural)
        scatter, gathered = PETSc.Scatter.toZero(natural)
        scatter.scatter(natural, gathered)
        values = (
            gathered.getArray().reshape(self.shape, order="F").copy()
            if self.comm.rank == 0
            else None
        )
        for held in (scatter, gathered, natural):
            held.destroy()
        return values

    def _assemble(self, stiffness):
        """Return the Laplacian weighted by `stiffness`, and its drive: the driven wall's bonds."""
        axes = len(self.shape)
        own, ghosted = self.da.getRanges(), self.da.getGhostRanges()
        here = [np.arange(start, stop) for start, stop in own]
        size = tuple(map(len, here))
        number = self.da.getLGMap().getIndices()
        number = number.reshape([stop - start for start, stop in ghosted], order="F")
        local = [balls - start for balls, (start, _) in zip(here, ghosted, strict=True)]

        # Slots of a row: the neighbours below, the ball itself, the neighbours above.
        row = (*size, 2 * axes + 1)
        columns = np.empty(row, dtype=PETSc.IntType)
        values = np.zeros(row)
        exists = np.ones(row, dtype=bool)
        columns[..., axes] = number[np.ix_(*local)]
        for axis, k in enumerate(stiffness):
            for slot, step in ((axes - 1 - axis, 0), (axes + 1 + axis, 1)):
                bond = _replaced(here, axis, here[axis] + step)
                constants = k[np.ix_(*bond)]
                values[..., axes] += constants
                values[..., slot] = -constants
                ball = here[axis] + 2 * step - 1
                inside = (ball >= 0) & (ball < self.shape[axis])
                exists[..., slot] = inside.reshape(_replaced([1] * axes, axis, -1))
                ball = np.where(inside, ball - ghosted[axis][0], 0)
                columns[..., slot] = number[np.ix_(*_replaced(local, axis, ball))]

        # PETSc numbers a rank's balls with the first axis fastest.
        order = (*reversed(range(axes)), axes)
        columns, values, exists = (
            a.transpose(order).reshape(-1, 2 * axes + 1) for a in (columns, values, exists)
        )
        pointer = np.zeros(len(exists) + 1, dtype=PETSc.IntType)
        np.cumsum(exists.sum(axis=1), out=pointer[1:])
        drive = self.da.createGlobalVec()
        matrix = PETSc.Mat().createAIJ(
            (drive.getSizes(), drive.getSizes()),
            csr=(pointer, columns[exists], values[exists].astype(PETSc.ScalarType)),
            comm=self.comm,
        )
        force = np.zeros(size)
        if own[0][1] == self.shape[0]:
            force[-1] = stiffness[0][np.ix_([self.shape[0]], *here[1:])][0]
        drive.setArray(force.ravel(order="F"))
        return matrix, drive


def _replaced(sequence, position, item):
    """Return a copy of a sequence with one item replaced."""
    copy = list(sequence)
    copy[position] = item
    return copy
