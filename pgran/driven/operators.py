"""One system for everything: S(s) = K + s beta C + s^2 m, with K = B^T diag(k) B and C = B^T B.

B has a row for each spring: what lengthens it. Loss angles make k complex, drag adds to C's
diagonal (`pgran.medium.dissipation`). Held balls are no unknowns; the springs of those that are
driven give the drive f(s), the sum of k + s beta at their other ends, a push a constant one
(`pgran.medium.source`). All matrices share one nonzero pattern, so that S is combined anew for each
s without assembly, and factored symbolically only once.

PETSc numbers unknowns so that each rank has a range. A layout knows those numbers, and turns
constants of springs into the nonzeros of B^T diag(k) B. What owns objects of PETSc frees them.
"""

from contextlib import AbstractContextManager
from functools import cached_property

import numpy as np
from mpi4py import MPI

from pgran.errors import InputError
from pgran.medium.bonds import SIGNS, bond_ends
from pgran.run.petsc import PETSc, logged

SAME = PETSc.Mat.Structure.SAME_NONZERO_PATTERN


def unchanged(part):
    """Return a spring's part of a sum, where `abs` would take its magnitude."""
    return part


class Owner(AbstractContextManager):
    """Owns what its attributes `owns` hold: PETSc objects, other owners, or lists of them.

    `destroy` or the end of a `with` frees it on the ranks `comm`. A `cached_property` is made when
    it is first asked for, and anew after `forget`.
    """

    owns = ()

    def __exit__(self, *error):
        if error[0] is None or self.comm.size == 1:
            self.destroy()

    def destroy(self):
        """Free all PETSc objects. Collective."""
        for held in self._held(self.owns):
            held.destroy()

    def forget(self, *names):
        """Delete some attributes, and free what they hold, of use to nothing else. Collective."""
        for held in self._held(names):
            held.destroy()
        for name in names:
            vars(self).pop(name, None)

    def vectors(self):
        """Yield all vectors, those of other owners too."""
        for held in self._held(self.owns):
            if isinstance(held, Owner):
                yield from held.vectors()
            elif isinstance(held, PETSc.Vec):
                yield held

    def _held(self, names):
        """Return what some attributes hold that can be destroyed, as far as it is made."""
        values = [vars(self).get(name) for name in names]
        lists = [item if isinstance(item, list) else [item] for item in values]
        return [held for several in lists for held in several if hasattr(held, "destroy")]


class Operators(Owner):
    """A driven medium, the same on all ranks that share it, as distributed matrices. Collective.

    `damping` times C is all that damps in proportion to s, None where nothing damps; the vector M
    holds the masses. S and f are the driven system at the s of the last `combine`. No eigenvalue of
    K is below `softest`, None while that is unknown. Destroy with `destroy` or `with`.
    """

    owns = ("K", "C", "M", "_diagonal", "S", "f", "f_stiffness", "f_damping", "sizes", "layout")

    @logged("assembly")
    def __init__(self, lattice, comm):
        self.lattice, self.comm = lattice, comm
        self.shape, self.size = lattice.shape, lattice.size
        self.mass, self.damping, self.axes = lattice.mass, lattice.damping_unit, lattice.axes
        self.rounding = lattice.rounding
        self.layout = (LatticeLayout if lattice.is_grid else NetworkLayout)(lattice, comm)
        self.first, self.last = self.layout.first, self.layout.last
        self.f_stiffness, self.M, self._diagonal = (self.layout.like.duplicate() for _ in range(3))
        self.M.set(self.mass)
        self.constants, self.softest = lattice.moduli, None
        self.K = self._assemble(self.constants)
        # this rank's part of the push, 0 where none drives
        self._push = 0.0 if lattice.pushed is None else self.layout.free_values(lattice.pushed)
        self.f_stiffness.setArray(self.layout.wall_force(self.constants) + self._push)
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

    @logged("assembly")
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
        self._diagonal.set(self.mass * s * s)  # in this order: s^2 alone could underflow
        self.S.setDiagonal(self._diagonal, addv=PETSc.InsertMode.ADD_VALUES)  # faster than a shift
        # Complex symmetric, not Hermitian: what an LDL^T factorization needs to know.
        self.S.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self.S.setOption(PETSc.Mat.Option.HERMITIAN, False)

    @logged("assembly")
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
        self.forget("sizes", "laplacian", "doubled_diagonals", "stiffness_norm")
        if bonds is None:
            self.K.setValuesCSR(*self.layout.csr(constants))
        else:
            self.layout.change(self.K, bonds, constants)
        self.K.assemble()
        if bonds is None or self.layout.drive[bonds].any():
            self.f_stiffness.setArray(self.layout.wall_force(constants) + self._push)

    @cached_property
    def laplacian(self):
        """Whether K and C have no positive entries beside their diagonals.

        Then |K| x = 2 diag(K) x - K x, and the forces that drive a ball are all of one sign.
        """
        real = np.isrealobj(self.constants)  # else magnitudes of sums are not sums of magnitudes
        return self.layout.laplacian and real and bool(self.constants.min() >= 0)

    @cached_property
    def doubled_diagonals(self):
        """Twice this rank's diagonals of K and C, 0 for none. Collective when first asked for."""
        doubled = [0.0, 0.0]
        for number, matrix in enumerate((self.K, self.C)[: 1 + (self.C is not None)]):
            matrix.getDiagonal(self._diagonal)
            doubled[number] = 2 * self._diagonal.getArray(readonly=True).real
        return doubled

    @cached_property
    def sizes(self):
        """K, f_stiffness, C and f_damping with the magnitudes of all springs' parts summed up.

        Collective when first asked for; they say what rounding does to what is no Laplacian.
        """
        matrices = []
        for constants, size in zip(self._parts, self.drive_sizes(), strict=True):
            drive = self.f_stiffness.duplicate()
            drive.setArray(size)
            matrices += [self._assemble(constants, abs), drive]
        if self.C is not None:
            self._drag(matrices[2])
        return matrices

    @property
    def _parts(self):
        """The constants of springs in K, and of dashpots in C, if any."""
        return (self.constants, self.lattice.dashpots)[: 1 + (self.C is not None)]

    def drive_sizes(self):
        """Return this rank's f_stiffness and f_damping, of magnitudes as `sizes` are."""
        sizes = [self.layout.wall_force(constants, abs) for constants in self._parts]
        sizes[0] += abs(self._push)
        return sizes

    @cached_property
    def stiffness_norm(self):
        """No less, but for rounding, than the 2-norm of |K|. Collective when first asked for.

        The largest sum in a row; a Laplacian's |K| is 2 diag(K) - K, and K is semidefinite.
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

    def block(self, columns):
        """Return a dense matrix of so many columns, for the caller to destroy. Collective."""
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
        """Set columns to b = B^T e of some bonds in this rank's rows, others to zero."""
        columns[:] = 0.0
        for entries, rows, mine in self.layout.own_entries(bonds):
            columns[rows, mine] = entries

    def _set_damping(self):
        """Complete C by the drag, and set the drive's dashpots. Collective."""
        self._drag(self.C)
        self.f_damping.setArray(self.layout.wall_force(self.lattice.dashpots))

    def _drag(self, C):
        """Add what drag there is to a matrix like C. Collective."""
        if self.lattice.drags is not None:
            drag = np.reshape(self.lattice.dragged, self.shape)
            self._diagonal.setArray(self.layout.free_values(drag))
            C.setDiagonal(self._diagonal, addv=PETSc.InsertMode.ADD_VALUES)

    def _assemble(self, constants, size=unchanged):
        """Return the matrix B^T diag(k) B."""
        sizes, csr = self.f_stiffness.getSizes(), self.layout.csr(constants, size)
        return PETSc.Mat().createAIJ((sizes, sizes), csr=csr, comm=self.comm)


class Layout(Owner):
    """How the unknowns of a medium are numbered, shared out over ranks, and coupled. Collective.

    A DMDA shares out a lattice, a `partition` any other network; one rank alone numbers unknowns in
    the order of elimination. `numbers` are PETSc's of the medium's unknowns, of which this rank has
    those from `first` to `last`; `like` is a vector of them, to duplicate. Of each spring `ends`
    (springs, w) are the unknowns in its row of B, PETSc's numbers, -1 for none, and `entries`,
    which may be one row for all, B's entries there; `drive` is how far it is stretched when what is
    driven moves by 1. `laplacian` says that a spring of positive constant has no positive entry
    beside the diagonal.
    """

    owns = ("like",)

    def __init__(self, medium, comm, like, numbers):
        self.medium, self.comm, self.like = medium, comm, like
        self.numbers = numbers.reshape(medium.shape)
        self.first, self.last = like.getOwnershipRange()

    def free_values(self, field):
        """Return this rank's entries of an array over all unknowns, the same on every rank."""
        values = np.empty(np.size(field), dtype=field.dtype)
        values[self.numbers] = field
        return values[self.first : self.last]

    def vector(self, field):
        """Return an array over all unknowns, the same on every rank, as a vector. Collective."""
        x = self.like.duplicate()
        x.setArray(self.free_values(field))
        return x

    def field(self, x):
        """Return a vector as an array over all unknowns on rank 0, else None. Collective."""
        scatter, gathered = PETSc.Scatter.toZero(x)
        scatter.scatter(x, gathered)
        field = gathered.getArray()[self.numbers] if self.comm.rank == 0 else None
        scatter.destroy()
        gathered.destroy()
        return field

    def fields(self, rows):
        """Return rows over all unknowns, of one rank alone, as the medium numbers them."""
        return rows[:, self.numbers]

    def gathered(self, vectors):
        """Return vectors as arrays, one after the other, on rank 0, None on others. Collective."""
        if self.comm.size == 1:
            return self.fields(np.stack([x.getArray(readonly=True) for x in vectors]))
        fields = [self.field(x) for x in vectors]
        return None if fields[0] is None else np.stack(fields)

    def readings(self, sites):
        """Return the unknowns that detectors read, and their weights, shape (nd, axes)."""
        unknowns, weights = self.medium.readings(sites)
        return self.numbers.ravel()[unknowns], weights

    def own_entries(self, springs):
        """Yield, side by side, B's entries, this rank's rows that they are in, of which springs."""
        for entries, unknowns in zip(self.entries.T, self.ends[springs].T, strict=True):
            mine = np.flatnonzero((unknowns >= self.first) & (unknowns < self.last))
            entries = entries[springs[mine]] if len(entries) > 1 else entries
            yield entries, unknowns[mine] - self.first, mine

    def wall_force(self, constants, size=unchanged):
        """Return this rank's rows of the drive, -B^T diag(k) of what is driven.

        `size` is applied to each spring's part before these are summed up, here and in `csr`.
        """
        drive = self.drive if size is unchanged else self.drive_sizes
        springs = np.flatnonzero(drive)
        pull = -constants[springs] * drive[springs]
        total = np.zeros(self.last - self.first)
        for entries, rows, mine in self.own_entries(springs):
            forces = size(entries * pull[mine])
            total = total + np.bincount(rows, forces.real, len(total))
            if np.iscomplexobj(forces):
                total = total + 1j * np.bincount(rows, forces.imag, len(total))
        return total


class LatticeLayout(Layout):
    """The balls of a lattice on a DMDA: each has as many bonds, to a neighbour or a wall."""

    owns = ("like", "da")
    laplacian = True

    def __init__(self, lattice, comm):
        try:
            self.da = PETSc.DMDA().create(
                sizes=lattice.shape, dof=1, stencil_width=1, stencil_type="star", comm=comm
            )
        except PETSc.Error as error:
            shape = " x ".join(map(str, lattice.shape))
            why = f"{shape} balls cannot be cut among {comm.size} ranks"
            raise InputError(f"-ranks_per_lattice: {why}") from error
        if comm.size == 1 and lattice.elimination.numbered:
            numbers = in_order(lattice.order)
        else:
            natural = np.arange(lattice.size, dtype=PETSc.IntType)
            natural = natural.reshape(lattice.shape, order="F")  # the first axis runs fastest
            numbers = self.da.getAO().app2petsc(natural.ravel())
        super().__init__(lattice, comm, self.da.createGlobalVec(), numbers)
        self.ends, self.entries = bond_ends(self.numbers), SIGNS[None]
        self.drive = self.drive_sizes = lattice.drive
        # The place 2 b + side in `ends` is that of an end of bond b; its other end is at place ^ 1.
        # So each of this rank's balls has 2 d bonds, and in its row of a matrix 2 d + 1 columns:
        # itself and the others, -1 for a wall, which PETSc ignores.
        ends = self.ends.ravel()
        order = np.argsort(ends, kind="stable")  # much quicker than the default
        order = order[np.count_nonzero(ends < self.first) : np.count_nonzero(ends < self.last)]
        order = order.reshape(self.last - self.first, -1)
        own = np.arange(self.first, self.last, dtype=PETSc.IntType)
        self._bonds, self._columns = order // 2, np.column_stack([own, ends[order ^ 1]])
        self._exists = self._columns >= 0

    def csr(self, constants, size=unchanged):
        """Return row pointers, columns and nonzeros of B^T diag(k) B."""
        pointer = np.append(0, np.cumsum(np.count_nonzero(self._exists, axis=1)))
        values = size(self._values(size(constants))[self._exists])
        return pointer.astype(PETSc.IntType), self._columns[self._exists], values

    def change(self, matrix, bonds, constants):
        """Set the rows of all balls at some bonds, summed up anew, in a matrix to be assembled."""
        balls = self.ends[bonds].ravel()
        balls = balls[(balls >= self.first) & (balls < self.last)]
        if len(balls):  # petsc4py divides by zero otherwise
            rows = balls - self.first
            matrix.setValuesRCV(balls[:, None], self._columns[rows], self._values(constants, rows))

    def _values(self, constants, rows=...):
        """Return what belongs into the columns of some rows of B^T diag(k) B."""
        k = constants[self._bonds[rows]]
        return np.column_stack([k.sum(axis=1), -k]).astype(PETSc.ScalarType)


class NetworkLayout(Layout):
    """The unknowns of any network, on ranges of a partition."""

    def __init__(self, network, comm):
        order, own = network.order, network.size
        if comm.size > 1:
            parts = partition(network, comm.size)
            order, own = np.argsort(parts, kind="stable"), np.count_nonzero(parts == comm.rank)
        like = PETSc.Vec().createMPI((own, None), comm=comm)
        super().__init__(network, comm, like, in_order(order))
        springs, none = network.springs, np.array(-1, PETSc.IntType)
        self.ends, self.entries = np.append(self.numbers, none)[springs.columns], springs.values
        self.drive, self.drive_sizes = springs.drive, springs.drive_sizes
        self.laplacian = network.components == 1
        self._contribute()

    def _contribute(self):
        """Find the nonzeros of this rank's rows, and what each spring contributes to them.

        They are blocks (w, w) of w unknowns a ball: one for each ball, one for each two in contact.
        """
        from scipy.sparse import bsr_matrix, csc_matrix, csr_matrix

        width, contacts = self.medium.components, self.medium.bonds
        first, last = self.first // width, self.last // width
        balls = self.ends[:contacts, ::width] // width  # -1 stays
        mine = (balls >= first) & (balls < last)
        here = np.flatnonzero(np.any(mine, axis=1))
        balls, mine, both = balls[here], mine[here], np.all(balls[here] >= 0, axis=1)
        own = np.arange(first, last)
        ahead, back = (np.flatnonzero(both & mine[:, end]) for end in (0, 1))
        rows = np.concatenate([own, balls[ahead, 0], balls[back, 1]]) - first
        columns = np.concatenate([own, balls[ahead, 1], balls[back, 0]])
        shape = len(own), self.medium.free_balls
        blocks = csr_matrix((np.ones(len(rows), dtype=bool), (rows, columns)), shape)
        blocks.data = np.arange(blocks.nnz, dtype=np.int32)  # look up which block is where
        # of no indices at all SciPy makes a sparse matrix
        found = np.asarray(blocks[rows, columns]).ravel() if len(rows) else rows
        itself, ahead_of, back_of = np.split(found, np.cumsum([len(own), len(ahead)]))
        # `places` of each block: its nonzeros' numbers, counted row by row of the whole matrix
        places = np.arange(blocks.nnz * width**2, dtype=np.int32).reshape(-1, width, width)
        nonzeros = bsr_matrix((places, blocks.indices, blocks.indptr), np.multiply(shape, width))
        nonzeros = nonzeros.tocsr()
        places.ravel()[nonzeros.data] = np.arange(places.size)
        self._pointer, self._columns = (
            x.astype(PETSc.IntType) for x in (nonzeros.indptr, nonzeros.indices)
        )
        # A spring at the unknowns p, q contributes B[s, p] B[s, q] k[s] to the nonzero (p, q). As a
        # matrix that is times the constants, a column for each spring: all springs of a contact
        # have their entries in the same rows. The last row is for what is not this rank's.
        target = np.full((len(here), 2, width, 2, width), places.size, dtype=np.int32)
        for end in (0, 1):
            at = np.flatnonzero(mine[:, end])
            target[at, end, :, end] = places[itself[balls[at, end] - first]]
        target[ahead, 0, :, 1] = places[ahead_of]
        target[back, 1, :, 0] = places[back_of]
        kinds = len(self.ends) // contacts
        self._springs = (here + contacts * np.arange(kinds)[:, None]).ravel()
        entries = np.broadcast_to(self.entries, self.ends.shape)[self._springs]
        products = entries[:, :, None] * entries[:, None]
        pointer = (2 * width) ** 2 * np.arange(len(self._springs) + 1)
        matrix = products.ravel(), np.tile(target.ravel(), kinds), pointer
        self._contributions = csc_matrix(matrix, (places.size + 1, len(self._springs)))

    def csr(self, constants, size=unchanged):
        """Return row pointers, columns and nonzeros of B^T diag(k) B."""
        values = size(self._contributions) @ size(constants[self._springs])
        return self._pointer, self._columns, values[:-1].astype(PETSc.ScalarType)

    def change(self, matrix, bonds, constants):
        """Set in a matrix what all springs contribute; it is to be assembled."""
        matrix.setValuesCSR(*self.csr(constants))


def in_order(order):
    """Return the number of each unknown, where these come in an order."""
    numbers = np.empty(len(order), dtype=PETSc.IntType)
    numbers[order] = np.arange(len(order))
    return numbers


def partition(network, parts):
    """Return which rank has each unknown: those of a ball together, neighbours mostly, as many.

    By bisection along the longest extent of the positions, or along the order of Cuthill and McKee.
    """
    if network.position is not None:
        where = network.position[network.free]
    else:
        from scipy.sparse import coo_matrix
        from scipy.sparse.csgraph import reverse_cuthill_mckee

        total = len(network.held)
        ones, (i, j) = np.ones(len(network.bond)), network.bond.T
        order = reverse_cuthill_mckee(coo_matrix((ones, (i, j)), (total, total)).tocsr())
        rank = np.empty(total)
        rank[order] = np.arange(total)
        where = rank[network.free][:, None]
    rank_of, left = np.zeros(len(where), dtype=int), [(np.arange(len(where)), 0, parts)]
    while left:  # cut the balls `here`, which are for `count` ranks from `first` on
        here, first, count = left.pop()
        if count == 1:
            rank_of[here] = first
            continue
        axis = np.argmax(np.ptp(where[here], axis=0)) if len(here) else 0
        order = here[np.argsort(where[here, axis], kind="stable")]
        half = count // 2
        split = len(here) * half // count
        left += [(order[:split], first, half), (order[split:], first + half, count - half)]
    return np.repeat(rank_of, network.components)
