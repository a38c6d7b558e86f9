"""How the unknowns of a lattice or a network are numbered, shared out over ranks, and coupled.

PETSc numbers unknowns so that each rank has a range. A layout knows those numbers, gathers fields,
and turns constants of the springs into the nonzeros of B^T diag(k) B in this rank's rows, of one
pattern always. A DMDA shares out a lattice, ranges of a partition any other network; one rank alone
numbers unknowns in the order of elimination.
"""

import numpy as np

from pgran.driven.owner import Owner
from pgran.errors import InputError
from pgran.medium.bonds import SIGNS, bond_ends
from pgran.run.petsc import PETSc


class Layout(Owner):
    """What the layouts of lattices and of other networks have in common.

    `numbers` are PETSc's of the medium's unknowns, of which this rank has those from `first` to
    `last`; `like` is a vector of them, to duplicate. Of each spring `ends` (springs, w) are the
    unknowns in its row of B, PETSc's numbers, -1 for none, and `entries`, which may be one row for
    all, B's entries there; `drive` is how far it is stretched when what is driven moves by 1.
    `laplacian` says that a spring of positive constant has no positive entry beside the diagonal.
    """

    owns = ("like",)

    def rows(self, field):
        """Return this rank's entries of an array over all unknowns, the same on every rank."""
        values = np.empty(np.size(field), dtype=field.dtype)
        values[self.numbers] = field
        return values[self.first : self.last]

    def vector(self, field):
        """Return an array over all unknowns, the same on every rank, as a vector. Collective."""
        x = self.like.duplicate()
        x.setArray(self.rows(field))
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

    def driving(self, constants, size=lambda x: x):
        """Return this rank's rows of the drive, -B^T diag(k) of what is driven.

        `size` is applied to each spring's part before these are summed up.
        """
        springs = np.flatnonzero(self.drive)
        pull = -constants[springs] * self.drive[springs]
        total = np.zeros(self.last - self.first)
        for entries, rows, mine in self.own_entries(springs):
            forces = size(entries * pull[mine])
            total = total + np.bincount(rows, forces.real, len(total))
            if np.iscomplexobj(forces):
                total = total + 1j * np.bincount(rows, forces.imag, len(total))
        return total


class LatticeLayout(Layout):
    """The balls of a lattice on a DMDA; InputError if so many ranks cannot share it. Collective."""

    owns = ("like", "da")
    laplacian = True

    def __init__(self, lattice, comm):
        self.medium, self.comm, self.shape = lattice, comm, lattice.shape
        try:
            self.da = PETSc.DMDA().create(
                sizes=self.shape, dof=1, stencil_width=1, stencil_type="star", comm=comm
            )
        except PETSc.Error as error:
            shape = " x ".join(map(str, self.shape))
            raise InputError(
                f"-ranks_per_lattice: {shape} balls cannot be cut among {comm.size} ranks"
            ) from error
        self.like = self.da.createGlobalVec()
        self.first, self.last = self.like.getOwnershipRange()
        self.numbers = self._numbered(lattice)
        self.ends, self.entries = bond_ends(self.numbers), SIGNS[None]
        self.drive = lattice.drive
        self._find_rows()

    def _numbered(self, lattice):
        """Return PETSc's numbers of all balls: on one rank in the order of elimination."""
        if self.comm.size == 1 and lattice.elimination.numbered:
            number = np.empty(lattice.size, dtype=PETSc.IntType)
            number[lattice.order] = np.arange(lattice.size)
            return number.reshape(self.shape)
        natural = np.arange(lattice.size, dtype=PETSc.IntType).reshape(self.shape, order="F")
        return self.da.getAO().app2petsc(natural.ravel()).reshape(self.shape)

    def _find_rows(self):
        """Find the bonds of each of this rank's balls, and its row's columns: itself, the others.

        Shapes (own, 2 d) and (own, 2 d + 1). The column of a wall is -1, which PETSc ignores.
        """
        # The place 2 b + side in `ends` is that of an end of bond b; its other end is at place ^ 1.
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

    def csr(self, constants):
        """Return row pointers, columns and nonzeros of B^T diag(k) B."""
        pointer = np.append(0, np.cumsum(np.count_nonzero(self._exists, axis=1)))
        columns, values = self._columns[self._exists], self._values(constants)[self._exists]
        return pointer.astype(PETSc.IntType), columns, values

    def sizes(self, constants):
        """Return the same of the sums of all bonds' magnitudes."""
        pointer, columns, values = self.csr(np.abs(constants))
        return pointer, columns, np.abs(values)

    def change(self, matrix, bonds, constants):
        """Set in a matrix, to be assembled, the rows of all balls at some bonds.

        They are summed up anew, so that what was before leaves no rounding behind.
        """
        balls = self.ends[bonds].ravel()
        balls = balls[(balls >= self.first) & (balls < self.last)]
        if len(balls):  # petsc4py divides by zero otherwise
            rows = balls - self.first
            matrix.setValuesRCV(balls[:, None], self._columns[rows], self._values(constants, rows))


class NetworkLayout(Layout):
    """The unknowns of any network on ranges of a partition; on one rank in order of elimination.

    Collective. What is said of springs is known to every rank.
    """

    def __init__(self, network, comm):
        self.medium, self.comm, self.shape = network, comm, network.shape
        springs = network.springs
        self.drive = springs.drive
        self.laplacian = network.components == 1
        if comm.size == 1:  # PETSc's factorizations take the unknowns as they are numbered
            parts, order = np.zeros(network.size, dtype=int), network.order
        else:
            parts = partition(network, comm.size)
            order = np.argsort(parts, kind="stable")
        number = np.empty(len(order) + 1, dtype=PETSc.IntType)
        number[order], number[-1] = np.arange(len(order)), -1
        self.numbers = number[:-1]
        self.like = PETSc.Vec().createMPI((np.count_nonzero(parts == comm.rank), None), comm=comm)
        self.first, self.last = self.like.getOwnershipRange()
        self.ends, self.entries = number[springs.columns], springs.values
        self._contribute()

    def _contribute(self):
        """Find the nonzeros of this rank's rows, and what each spring contributes to them.

        They are blocks (w, w) of w unknowns a ball: one for each ball, one for each two in contact.
        """
        from scipy.sparse import csc_matrix, csr_matrix

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
        places = self._number_nonzeros(blocks, width)
        blocks.data = np.arange(blocks.nnz, dtype=np.int32)  # look up which block is where
        # of no indices at all SciPy makes a sparse matrix
        found = np.asarray(blocks[rows, columns]).ravel() if len(rows) else rows
        itself, ahead_of, back_of = np.split(found, np.cumsum([len(own), len(ahead)]))
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

    def _number_nonzeros(self, blocks, width):
        """Number the nonzeros of a sparse matrix of blocks row by row: shape (blocks, w, w).

        A row of m blocks is w rows of m w nonzeros: row p holds the rows p of these blocks.
        """
        inside, counts = np.arange(width, dtype=np.int32), np.diff(blocks.indptr)
        row = np.repeat(np.arange(len(counts)), counts)
        before = blocks.indptr[row]  # so many blocks are in the rows above
        corner = before * width**2 + (np.arange(blocks.nnz) - before) * width
        step = (counts * width)[row]
        places = corner[:, None, None] + step[:, None, None] * inside[:, None] + inside
        lengths = np.repeat(counts * width, width)
        self._pointer = np.append(0, np.cumsum(lengths)).astype(PETSc.IntType)
        self._columns = np.empty(places.size, dtype=PETSc.IntType)
        self._columns[places] = (blocks.indices[:, None] * width + inside)[:, None]
        return places

    def csr(self, constants):
        """Return row pointers, columns and nonzeros of B^T diag(k) B."""
        return self._nonzeros(self._contributions, constants)

    def sizes(self, constants):
        """Return the same of the sums of all springs' magnitudes, which K's may cancel to."""
        return self._nonzeros(abs(self._contributions), np.abs(constants))

    def _nonzeros(self, contributions, constants):
        """Return row pointers, columns and what springs of these constants contribute."""
        values = contributions @ constants[self._springs]
        return self._pointer, self._columns, values[:-1].astype(PETSc.ScalarType)

    def change(self, matrix, bonds, constants):
        """Set in a matrix what all springs contribute; it is to be assembled."""
        matrix.setValuesCSR(*self.csr(constants))


def partition(network, parts):
    """Return which rank has each unknown: those of a ball together, neighbours mostly, as many.

    By bisection along the longest extent of the positions; without positions along the order of
    reverse Cuthill and McKee. The same on every rank.
    """
    balls = len(network.free)
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
    rank_of, left = np.zeros(balls, dtype=int), [(np.arange(balls), 0, parts)]
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
