"""The matrices of a lattice on a PETSc DMDA: K, C, S(omega) and the drive f(omega).

K = B^T diag(k) B and C = B^T B are sums over all bonds, wall bonds included, B the incidence matrix
of bonds and balls. Both and S = K + i omega beta C - m omega^2 share one nonzero pattern, so that S
is combined anew for each frequency without assembly, and factored symbolically only once.
"""

from functools import cached_property

import numpy as np
from petsc4py import PETSc

from pgran.errors import InputError
from pgran.physics.lattice import bond_count, bond_shape

SAME = PETSc.Mat.Structure.SAME_NONZERO_PATTERN


class Owner:
    """Owns PETSc objects on the ranks `comm`: `destroy` or the end of a `with` frees them."""

    def __enter__(self):
        """Return the owner."""
        return self

    def __exit__(self, *error):
        """Destroy, but with an error on its way only alone: other ranks may not share it."""
        if error[0] is None or self.comm.size == 1:
            self.destroy()


class Operators(Owner):
    """The driven lattice as distributed matrices and vectors; destroy with `destroy` or `with`.

    Collective.

    Parameters
    ----------
    lattice : pgran.physics.lattice.Lattice
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
        try:
            self.da = PETSc.DMDA().create(
                sizes=self.shape, dof=1, stencil_width=1, stencil_type="star", comm=comm
            )
        except PETSc.Error as error:
            shape = " x ".join(map(str, self.shape))
            raise InputError(
                f"-ranks_per_lattice: {shape} balls cannot be cut among {comm.size} ranks"
            ) from error
        pattern = self._pattern()
        self.K, self.f_stiffness = self._assemble(lattice.stiffness, pattern)
        self.C = self.f_damping = None
        if self.damping > 0:
            ones = [np.broadcast_to(1.0, k.shape) for k in lattice.stiffness]
            self.C, self.f_damping = self._assemble(ones, pattern)

    @cached_property
    def S(self):  # noqa: N802
        """The matrix of the driven system. Collective when first asked for."""
        return self.K.duplicate()

    @cached_property
    def f(self):
        """The drive. Collective when first asked for."""
        return self.f_stiffness.duplicate()

    def destroy(self):
        """Free all PETSc objects. Collective."""
        made = vars(self)  # S and f only where they were asked for
        for name in ("K", "C", "S", "f", "f_stiffness", "f_damping", "da"):
            if made.get(name) is not None:
                made[name].destroy()

    def forget(self, name):
        """Free S or f, after an error that PETSc would keep; `combine` makes it anew. Collective.

        Nothing may hold on to it.
        """
        if name in vars(self):
            getattr(self, name).destroy()
            delattr(self, name)

    def combine(self, omega):
        """Set S = K + i omega beta C - m omega^2 and the drive f (paper: ampeq).

        Collective.
        """
        self.K.copy(self.S, structure=SAME)
        self.f_stiffness.copy(self.f)
        if self.C is not None:
            self.S.axpy(1j * omega * self.damping, self.C, structure=SAME)
            self.f.axpy(1j * omega * self.damping, self.f_damping)
        self.S.shift(-self.mass * omega * omega)  # omega^2 alone could underflow
        # Complex symmetric, not Hermitian: what an LDL^T factorization needs to know.
        self.S.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self.S.setOption(PETSc.Mat.Option.HERMITIAN, False)

    @cached_property
    def bond_ends(self):
        """The balls that each bond joins: PETSc's numbers, -1 for a wall, shape (bonds, 2).

        Collective when first asked for. Bonds are numbered axis after axis, each array in C order;
        the end below comes first.
        """
        below, above = [], []
        for axis in range(len(self.shape)):
            sites = np.indices(bond_shape(self.shape, axis)).reshape(len(self.shape), -1)
            for ends, step in ((below, -1), (above, 0)):
                ball = sites.copy()
                ball[axis] += step
                inside = (ball[axis] >= 0) & (ball[axis] < self.shape[axis])
                number = np.full(ball.shape[1], -1, dtype=PETSc.IntType)
                number[inside] = self.numbers(ball[:, inside].T)
                ends.append(number)
        return np.stack([np.concatenate(below), np.concatenate(above)], axis=1)

    @cached_property
    def driven_bonds(self):
        """Which bonds end at the driven wall, shape (bonds,). Not collective."""
        along = np.zeros(bond_shape(self.shape, 0), dtype=bool)
        along[-1] = True
        return np.pad(along.ravel(), (0, bond_count(self.shape) - along.size))

    @cached_property
    def _bonds_of_balls(self):
        """The bonds of each ball, in PETSc's numbering, shape (balls, 2 dim)."""
        ends = self.bond_ends.ravel()
        order = np.argsort(ends, kind="stable")[np.count_nonzero(ends < 0) :]
        return (order // 2).reshape(self.balls, -1)

    def change_bonds(self, bonds, constants):
        """Set some bond constants anew, in K and in the drive; S waits for `combine`.

        Collective. What K was before leaves no rounding behind.

        Parameters
        ----------
        bonds : numpy.ndarray of int, shape (n,)
            Numbers of the bonds that change.
        constants : numpy.ndarray, shape (bonds,)
            The constants of all bonds after the change.
        """
        first, last = self.K.getOwnershipRange()
        ends = self.bond_ends[bonds]
        rows, columns = ends.ravel(), ends[:, ::-1].ravel()
        joined = (rows >= first) & (rows < last) & (columns >= 0)
        self._insert(rows[joined], columns[joined], -np.repeat(constants[bonds], 2)[joined])
        balls = np.unique(rows[(rows >= first) & (rows < last)])
        self._insert(balls, balls, constants[self._bonds_of_balls[balls]].sum(axis=1))
        self.K.assemble()
        driven = bonds[self.driven_bonds[bonds]]
        if len(driven):
            balls = self.bond_ends[driven, 0]
            mine = (balls >= first) & (balls < last)
            self.f_stiffness.setValues(balls[mine], constants[driven[mine]])
            self.f_stiffness.assemble()

    def _insert(self, rows, columns, values):
        """Insert single entries of K, all of this rank's rows."""
        if len(rows):  # petsc4py divides by zero otherwise
            self.K.setValuesRCV(rows[:, None], columns[:, None], values[:, None].astype(complex))

    def set_stiffness(self, stiffness):
        """Replace all bond constants, in K and in the drive; S waits for `combine`. Collective."""
        pattern = self._pattern()
        values, drive = self._values(stiffness, pattern)
        self.K.setValuesCSR(*pattern[:2], values)
        self.K.assemble()
        self.f_stiffness.setArray(drive)

    def numbers(self, sites):
        """Return PETSc's global numbers of balls given by their indices, shape (count, dim).

        Collective.
        """
        natural = np.ravel_multi_index(np.asarray(sites).T, self.shape, order="F")
        return self.da.getAO().app2petsc(np.array(natural, dtype=PETSc.IntType))

    def vector(self, field):
        """Return an array over the lattice, the same on every rank, as a vector. Collective."""
        x = self.da.createGlobalVec()
        own = tuple(slice(start, stop) for start, stop in self.da.getRanges())
        x.setArray(field[own].ravel(order="F"))
        return x

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

    def _pattern(self):
        """Return the row pointers, the columns, and which slots of a row exist.

        The slots of a ball's row are its neighbours below along each axis, itself, and its
        neighbours above. PETSc numbers a rank's balls with the first axis fastest.
        """
        axes = len(self.shape)
        own, ghosted = self.da.getRanges(), self.da.getGhostRanges()
        number = self.da.getLGMap().getIndices()
        number = number.reshape([stop - start for start, stop in ghosted], order="F")
        local = [
            np.arange(start - ghosts[0], stop - ghosts[0])
            for (start, stop), ghosts in zip(own, ghosted, strict=True)
        ]
        columns = np.empty((*map(len, local), 2 * axes + 1), dtype=PETSc.IntType)
        exists = np.ones(columns.shape, dtype=bool)
        columns[..., axes] = number[np.ix_(*local)]
        for axis in range(axes):
            for slot, step in ((axes - 1 - axis, -1), (axes + 1 + axis, 1)):
                ball = local[axis] + step
                inside = (ball >= 0) & (ball < number.shape[axis])
                exists[..., slot] = inside.reshape(_replaced([1] * axes, axis, -1))
                ball = np.where(inside, ball, 0)
                columns[..., slot] = number[np.ix_(*_replaced(local, axis, ball))]
        columns, exists = _rows(columns), _rows(exists)
        pointer = np.zeros(len(exists) + 1, dtype=PETSc.IntType)
        np.cumsum(exists.sum(axis=1), out=pointer[1:])
        return pointer, columns[exists], exists

    def _values(self, stiffness, pattern):
        """Return the nonzeros of the Laplacian weighted by `stiffness`, and its drive."""
        axes = len(self.shape)
        here = [np.arange(start, stop) for start, stop in self.da.getRanges()]
        values = np.zeros((*map(len, here), 2 * axes + 1))
        for axis, k in enumerate(stiffness):
            for slot, step in ((axes - 1 - axis, 0), (axes + 1 + axis, 1)):
                constants = k[np.ix_(*_replaced(here, axis, here[axis] + step))]
                values[..., slot] = -constants
                values[..., axes] += constants
        drive = np.zeros(values.shape[:-1])
        if here[0][-1] == self.shape[0] - 1:
            drive[-1] = stiffness[0][np.ix_([self.shape[0]], *here[1:])][0]
        exists = pattern[2]
        return _rows(values)[exists].astype(PETSc.ScalarType), drive.ravel(order="F")

    def _assemble(self, stiffness, pattern):
        """Return the Laplacian weighted by `stiffness`, and its drive: the driven wall's bonds."""
        values, forces = self._values(stiffness, pattern)
        drive = self.da.createGlobalVec()
        drive.setArray(forces)
        matrix = PETSc.Mat().createAIJ(
            (drive.getSizes(), drive.getSizes()), csr=(*pattern[:2], values), comm=self.comm
        )
        return matrix, drive


def _rows(slots):
    """Return an array over balls and slots with a row a ball, the first axis fastest."""
    axes = slots.ndim - 1
    return slots.transpose(*reversed(range(axes)), axes).reshape(-1, slots.shape[-1])


def _replaced(sequence, position, item):
    """Return a copy of a sequence with one item replaced."""
    copy = list(sequence)
    copy[position] = item
    return copy
