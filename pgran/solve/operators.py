"""One system for everything: S(s) = K + s beta C + s^2 M, with K = B^T diag(k) B and C = B^T B.

B has a row for each bond: what lengthens it. Walls are no unknowns; the driven one's bonds give the
drive f(s), the sum of k + s beta at their balls. All matrices share one nonzero pattern, so that S
is combined anew for each s without assembly, and factored symbolically only once.

A PETSc DMDA numbers the balls, shares them out over the ranks and gathers fields; nothing else here
knows that they form a lattice: K is assembled from the table of bonds' ends.
"""

from functools import cached_property

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from pgran.errors import InputError
from pgran.physics.lattice import SIGNS, bond_ends, driven_bonds

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
        The same with every constant 1; damping is beta C. None for an undamped lattice.
    M : petsc4py.PETSc.Vec
        The masses.
    S, f : petsc4py.PETSc.Mat, petsc4py.PETSc.Vec
        The driven system at the s of the last `combine`.
    ends : numpy.ndarray of int, shape (bonds, 2)
        The balls that each bond joins: PETSc's numbers, -1 for a wall. Bonds are numbered axis
        after axis, each array in C order; the end below comes first.
    driven : numpy.ndarray of bool, shape (bonds,)
        Which bonds end at the driven wall.
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
        self.f_stiffness = self.da.createGlobalVec()
        self.first, self.last = self.f_stiffness.getOwnershipRange()
        numbers = self.numbers(np.indices(self.shape).reshape(len(self.shape), -1).T)
        self.ends, self.driven = bond_ends(numbers.reshape(self.shape)), driven_bonds(self.shape)
        self._make_pattern()
        constants = lattice.constants
        self.K = self._assemble(constants)
        self.f_stiffness.setArray(self._drive(constants))
        self.C = self.f_damping = None
        if self.damping > 0:
            ones = np.ones(len(constants))
            self.C, self.f_damping = self._assemble(ones), self.f_stiffness.duplicate()
            self.f_damping.setArray(self._drive(ones))
        self.M, self._inertia = self.f_stiffness.duplicate(), self.f_stiffness.duplicate()
        self.M.set(self.mass)

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
        for name in ("K", "C", "S", "f", "f_stiffness", "f_damping", "M", "_inertia", "da"):
            if made.get(name) is not None:
                made[name].destroy()

    def forget(self, name):
        """Free S or f, after an error that PETSc would keep; `combine` makes it anew. Collective.

        Nothing may hold on to it.
        """
        if name in vars(self):
            getattr(self, name).destroy()
            delattr(self, name)

    def combine(self, s):
        """Set S(s) = K + s beta C + s^2 M and the drive f(s) (paper: ampeq, s = i omega).

        Collective.

        Parameters
        ----------
        s : complex
            sigma + i omega, sigma >= 0.

        Raises
        ------
        ValueError
            If sigma is negative: what bounds the error holds on the other half of the plane.
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
        for _ in range(2):
            self._inertia.scale(s)  # s^2 alone could underflow
        self.S.setDiagonal(self._inertia, addv=True)
        # Complex symmetric, not Hermitian: what an LDL^T factorization needs to know.
        self.S.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self.S.setOption(PETSc.Mat.Option.HERMITIAN, False)

    def stretch(self, columns, bonds):
        """Return b^T x for some bonds and each column x, walls at rest: shape (n, columns).

        Collective; the same on every rank.

        Parameters
        ----------
        columns : numpy.ndarray, shape (own, columns)
            This rank's rows.
        bonds : numpy.ndarray of int, shape (n,)
        """
        found = np.zeros((len(bonds), columns.shape[1]), dtype=complex)
        for sign, balls, mine in self._own_ends(bonds):
            found[mine] += sign * columns[balls]
        if self.comm.size > 1:
            self.comm.Allreduce(MPI.IN_PLACE, found)
        return found

    def spread(self, bonds, columns):
        """Set each column to b = B^T e of a bond, as far as it lies in this rank's rows.

        Not collective.

        Parameters
        ----------
        bonds : numpy.ndarray of int, shape (n,)
        columns : numpy.ndarray, shape (own, n or more)
            Columns beyond n become zero.
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
        self.K.setValuesCSR(self._pointer, self._columns, self._values(constants))
        self.K.assemble()
        self.f_stiffness.setArray(self._drive(constants))

    def change_bonds(self, bonds, constants):
        """Set some bond constants anew, in K and in the drive; S waits for `combine`.

        Collective. What K was before leaves no rounding behind: an entry is summed up anew from all
        its bonds.

        Parameters
        ----------
        bonds : numpy.ndarray of int, shape (n,)
            Numbers of the bonds that change.
        constants : numpy.ndarray, shape (bonds,)
            The constants of all bonds after the change.
        """
        if self.comm.size > 1:
            mine = bonds[self._is_own(self.ends[bonds]).any(axis=1)]
            bonds_here = np.searchsorted(self._bonds, mine)
        else:
            bonds_here = bonds
        entries = self._place[bonds_here].ravel()
        entries = entries[entries < len(self._columns)]
        if len(entries):  # petsc4py divides by zero otherwise
            rows, summed, signs = self._terms
            values = (constants[summed[entries]] * signs[entries]).cumsum(axis=1)[:, -1:]
            self.K.setValuesRCV(
                rows[entries, None], self._columns[entries, None], values.astype(PETSc.ScalarType)
            )
        self.K.assemble()
        if self.driven[bonds].any():
            self.f_stiffness.setArray(self._drive(constants))

    @cached_property
    def _terms(self):
        """What each nonzero is summed of: its row, the bonds in their order, and the signs.

        Bonds and signs have a row for each nonzero, with signs of 0 where there is no bond more.
        """
        count, signs = len(self._columns), np.outer(SIGNS, SIGNS).ravel()
        places = self._place.ravel()
        order = np.argsort(places, kind="stable")[: np.count_nonzero(places < count)]
        places, sizes = places[order], np.bincount(places, minlength=count)[:count]
        column = np.arange(len(order)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
        summed = np.zeros((count, sizes.max()), dtype=PETSc.IntType)
        summed[places, column] = self._bonds[order // len(signs)]
        weights = np.zeros(summed.shape, dtype=np.int8)
        weights[places, column] = signs[order % len(signs)]
        rows = np.repeat(np.arange(self.first, self.last), np.diff(self._pointer))
        return rows.astype(PETSc.IntType), summed, weights

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

    def _make_pattern(self):
        """Lay down this rank's nonzeros, and where in them each bond's contributions go.

        A bond adds k times the product of B's entries at two of its ends to the row of one and the
        column of the other. `_place` says which nonzero that is, shape (bonds of this rank, 2, 2);
        what belongs to a wall or to another rank goes to one place more at the end.
        """
        self._bonds = np.flatnonzero(self._is_own(self.ends).any(axis=1))
        ends, own = self.ends[self._bonds].astype(np.int64), self.last - self.first
        rows, columns = ends[:, :, None], ends[:, None, :]
        keys = (rows - self.first) * self.balls + columns
        keys[~(self._is_own(rows) & (columns >= 0))] = own * self.balls
        order = np.argsort(keys, axis=None, kind="stable")  # much quicker than the default
        sorted_keys = keys.ravel()[order]
        another = np.append(False, sorted_keys[1:] > sorted_keys[:-1])
        self._place = np.empty(keys.shape, dtype=np.int64)
        self._place.ravel()[order] = np.cumsum(another)
        another[0] = True
        rows, columns = np.divmod(sorted_keys[another], self.balls)
        self._columns = columns[rows < own].astype(PETSc.IntType)
        sizes = np.bincount(rows, minlength=own)[:own]
        self._pointer = np.append(0, np.cumsum(sizes)).astype(PETSc.IntType)

    def _values(self, constants):
        """Return the nonzeros of B^T diag(k) B, each summed up bond after bond."""
        products = constants[self._bonds, None, None] * np.outer(SIGNS, SIGNS)
        count = len(self._columns)
        sums = np.bincount(self._place.ravel(), products.ravel(), count + 1)
        return sums[:count].astype(PETSc.ScalarType)

    def _drive(self, constants):
        """Return this rank's rows of the drive: the constants of the driven wall's bonds."""
        (bonds,) = np.nonzero(self.driven & self._is_own(self.ends[:, 0]))
        balls = self.ends[bonds, 0] - self.first
        return np.bincount(balls, constants[bonds], self.last - self.first)

    def _assemble(self, constants):
        """Return the matrix B^T diag(k) B."""
        csr = self._pointer, self._columns, self._values(constants)
        size = self.f_stiffness.getSizes()
        return PETSc.Mat().createAIJ((size, size), csr=csr, comm=self.comm)
