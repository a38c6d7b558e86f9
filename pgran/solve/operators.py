"""One system for everything: S(s) = K + s beta C + s^2 m, with K = B^T diag(k) B and C = B^T B.

B has a row for each bond: what lengthens it. Walls are no unknowns; the driven one's bonds give the
drive f(s), the sum of k + s beta at their balls. All matrices share one nonzero pattern, so that S
is combined anew for each s without assembly, and factored symbolically only once.

A PETSc DMDA numbers the balls, shares them out over the ranks and gathers fields. K is assembled
from the table of bonds' ends; all that it knows of the lattice is that each ball has 2 d bonds.
"""

from functools import cached_property

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from pgran.errors import InputError
from pgran.physics.lattice import SIGNS, bond_ends, driven_bonds

SAME = PETSc.Mat.Structure.SAME_NONZERO_PATTERN


class Owner:
    """Owns what its attributes `owns` hold: PETSc objects, other owners, or lists of them.

    `destroy` or the end of a `with` frees it on the ranks `comm`. An attribute that is a
    `cached_property` is made when it is first asked for, and anew after `forget`.
    """

    owns = ()

    def __enter__(self):
        """Return the owner."""
        return self

    def __exit__(self, *error):
        """Destroy, but with an error on its way only alone: other ranks may not share it."""
        if error[0] is None or self.comm.size == 1:
            self.destroy()

    def destroy(self):
        """Free all PETSc objects. Collective."""
        for held in self._held(self.owns):
            held.destroy()

    def forget(self, *names):
        """Free what some attributes hold, which nothing else may use any more. Collective."""
        for held in self._held(names):
            held.destroy()
        for name in names:
            vars(self).pop(name, None)

    def vectors(self):
        """Yield all vectors, those of other owners too. Not collective."""
        for held in self._held(self.owns):
            if isinstance(held, Owner):
                yield from held.vectors()
            elif isinstance(held, PETSc.Vec):
                yield held

    def _held(self, names):
        """Return what some attributes hold, as far as it is made."""
        found = [vars(self).get(name) for name in names]
        lists = [item if isinstance(item, list) else [item] for item in found]
        return [held for several in lists for held in several if held is not None]


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
        The same with every constant 1; damping is beta C. None for an undamped lattice.
    M : petsc4py.PETSc.Vec
        The masses, a diagonal.
    S, f : petsc4py.PETSc.Mat, petsc4py.PETSc.Vec
        The driven system at the s of the last `combine`.
    ends : numpy.ndarray of int, shape (bonds, 2)
        The balls that each bond joins: PETSc's numbers, -1 for a wall. Bonds are numbered axis
        after axis, each array in C order; the end below comes first.
    driven : numpy.ndarray of bool, shape (bonds,)
        Which bonds end at the driven wall.
    """

    owns = ("K", "C", "M", "_inertia", "S", "f", "f_stiffness", "f_damping", "da")

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
        self.f_stiffness = self.da.createGlobalVec()
        self.first, self.last = self.f_stiffness.getOwnershipRange()
        self.M, self._inertia = self.f_stiffness.duplicate(), self.f_stiffness.duplicate()
        self.M.set(self.mass)
        numbers = self.numbers(np.indices(self.shape).reshape(len(self.shape), -1).T)
        self.ends, self.driven = bond_ends(numbers.reshape(self.shape)), driven_bonds(self.shape)
        self._find_rows()
        constants = lattice.constants
        self.K = self._assemble(constants)
        self.f_stiffness.setArray(self._drive(constants))
        self.C = self.f_damping = None
        if self.damping > 0:
            ones = np.ones(len(constants))
            self.C, self.f_damping = self._assemble(ones), self.f_stiffness.duplicate()
            self.f_damping.setArray(self._drive(ones))

    @cached_property
    def S(self):  # noqa: N802
        """The matrix of the driven system. Collective when first asked for."""
        return self.K.duplicate()

    @cached_property
    def f(self):
        """The drive. Collective when first asked for."""
        return self.f_stiffness.duplicate()

    def combine(self, s):
        """Set S(s) = K + s beta C + s^2 M and the drive f(s) (paper: ampeq, s = i omega).

        Collective.

        Raises
        ------
        ValueError
            If the real part of s is negative: no error is bounded there.
        """
        s = complex(s)
        if not s.real >= 0:
            raise ValueError(f"the real part of s must be 0 or more, not {s.real}")
        self.K.copy(self.S, structure=SAME)
        self.f_stiffness.copy(self.f)
        if self.C is not None:
            self.S.axpy(s * self.damping, self.C, structure=SAME)
            self.f.axpy(s * self.damping, self.f_damping)
        self.M.copy(self._inertia)
        for _ in range(2):  # s^2 alone could underflow
            self._inertia.scale(s)
        self.S.setDiagonal(self._inertia, addv=PETSc.InsertMode.ADD_VALUES)  # faster than a shift
        # Complex symmetric, not Hermitian: what an LDL^T factorization needs to know.
        self.S.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self.S.setOption(PETSc.Mat.Option.HERMITIAN, False)

    def stretch(self, columns, bonds):
        """Return b^T x for some bonds and each column x, walls at rest: shape (bonds, columns).

        Collective; `columns` holds this rank's rows, the result is the same on every rank.
        """
        found = np.zeros((len(bonds), columns.shape[1]), dtype=complex)
        for sign, balls, mine in self._own_ends(bonds):
            found[mine] += sign * columns[balls]
        if self.comm.size > 1:
            self.comm.Allreduce(MPI.IN_PLACE, found)
        return found

    def spread(self, bonds, columns):
        """Set columns to b = B^T e of some bonds, as far as it lies in this rank's rows.

        Not collective. Columns beyond those of the bonds become zero.
        """
        columns[:] = 0.0
        for sign, balls, mine in self._own_ends(bonds):
            columns[balls, mine] = sign

    def _own_ends(self, bonds):
        """Yield, side by side, B's entry, this rank's rows it is in, and which bonds those are."""
        for sign, balls in zip(SIGNS, self.ends[bonds].T, strict=True):
            mine = np.flatnonzero(self._is_own(balls))
            yield sign, balls[mine] - self.first, mine

    def _is_own(self, balls):
        """Return which balls are rows of this rank."""
        return (balls >= self.first) & (balls < self.last)

    def set_stiffness(self, constants):
        """Replace all bond constants, in K and in the drive; S waits for `combine`.

        Collective; `constants` has the shape (bonds,).
        """
        self.K.setValuesCSR(*self._csr(constants))
        self.K.assemble()
        self.f_stiffness.setArray(self._drive(constants))

    def change_bonds(self, bonds, constants):
        """Set some bond constants anew, in K and in the drive; S waits for `combine`.

        Collective; `constants` are those of all bonds after the change. What K was before leaves no
        rounding behind: the rows of all balls at these bonds are summed up anew.
        """
        balls = self.ends[bonds].ravel()
        balls = balls[self._is_own(balls)]
        if len(balls):  # petsc4py divides by zero otherwise
            rows = balls - self.first
            self.K.setValuesRCV(balls[:, None], self._columns[rows], self._values(constants, rows))
        self.K.assemble()
        if self.driven[bonds].any():
            self.f_stiffness.setArray(self._drive(constants))

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
        """Return a vector as an array over the lattice on rank 0, else None. Collective."""
        natural = self.da.createNaturalVec()
        self.da.globalToNatural(x, natural)
        scatter, gathered = PETSc.Scatter.toZero(natural)
        scatter.scatter(natural, gathered)
        values = gathered.getArray().copy()
        for held in (scatter, gathered, natural):
            held.destroy()
        return values.reshape(self.shape, order="F") if self.comm.rank == 0 else None

    def _find_rows(self):
        """Find the bonds of each of this rank's balls, and its row's columns: itself, the others.

        Shapes (own, 2 d) and (own, 2 d + 1). The column of a wall is -1, which PETSc ignores.
        """
        ends = self.ends.ravel()
        order = np.argsort(ends, kind="stable")  # much quicker than the default
        order = order[np.count_nonzero(ends < self.first) : np.count_nonzero(ends < self.last)]
        order = order.reshape(self.last - self.first, -1)
        own = np.arange(self.first, self.last, dtype=PETSc.IntType)
        self._bonds, self._columns = order // 2, np.column_stack([own, ends[order ^ 1]])
        self._exists = self._columns >= 0

    def _values(self, constants, rows=...):
        """Return what belongs into the columns of some rows of B^T diag(k) B."""
        k = constants[self._bonds[rows]]
        return np.column_stack([k.sum(axis=1), -k]).astype(PETSc.ScalarType)

    def _csr(self, constants):
        """Return row pointers, columns and nonzeros of B^T diag(k) B."""
        pointer = np.append(0, np.cumsum(np.count_nonzero(self._exists, axis=1)))
        columns, values = self._columns[self._exists], self._values(constants)[self._exists]
        return pointer.astype(PETSc.IntType), columns, values

    def _assemble(self, constants):
        """Return the matrix B^T diag(k) B."""
        size = self.f_stiffness.getSizes()
        return PETSc.Mat().createAIJ((size, size), csr=self._csr(constants), comm=self.comm)

    def _drive(self, constants):
        """Return this rank's rows of the drive: the constants of the driven wall's bonds."""
        bonds = np.flatnonzero(self.driven & self._is_own(self.ends[:, 0]))
        balls = self.ends[bonds, 0] - self.first
        return np.bincount(balls, constants[bonds], self.last - self.first)
