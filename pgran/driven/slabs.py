"""A lattice in slabs, for products alone: rows from slices of its constants, whatever its size.

A DMDA shares out the balls in slabs across the first axis, the slowest of the arrays, so that its
numbers are those of the arrays. What a `LatticeLayout` knows of each bond, for factors and single
changes, would take ten times the memory.
"""

import numpy as np

from pgran.driven.operators import Layout, unchanged
from pgran.errors import InputError
from pgran.run.petsc import PETSc


class SlabLayout(Layout):
    """See `operators.Layout`, of whose methods it has those that products take."""

    owns = ("like", "da")

    def __init__(self, lattice, comm):
        shape, axes = lattice.shape, lattice.axes
        if shape[0] < comm.size:
            raise InputError(f"-ranks_per_lattice: {shape} balls make no {comm.size} slabs")
        self.da = PETSc.DMDA().create(
            sizes=shape[::-1], proc_sizes=(*[1] * (axes - 1), comm.size), dof=1, stencil_width=1,
            stencil_type="star", comm=comm,
        )  # fmt: skip
        super().__init__(lattice, comm, self.da.createGlobalVec(), np.arange(lattice.size))
        across = lattice.size // shape[0]
        self._rows = slice(self.first // across, self.last // across)

    def free_values(self, field):
        """See `Layout`."""
        return np.ravel(field)[self.first : self.last]

    def csr(self, constants, size=unchanged):
        """See `LatticeLayout`; values are real."""
        shape, rows, apart = self.medium.shape, self._rows, self.medium.size
        own = np.arange(self.first, self.last, dtype=PETSc.IntType).reshape(-1, *shape[1:])
        values = np.zeros((*own.shape, 1 + 2 * len(shape)))
        columns = np.empty(values.shape, dtype=PETSc.IntType)
        columns[..., 0] = own
        for axis, k in enumerate(self.medium.blocks(constants)):
            apart //= shape[axis]
            k = size(k[rows.start : rows.stop + (axis == 0)])
            for side in (0, 1):
                ends = slice(side, side + own.shape[axis])
                bonds, column = k[(*[slice(None)] * axis, ends)], 1 + 2 * axis + side
                values[..., column] = -bonds
                values[..., 0] += bonds
                columns[..., column] = own + (2 * side - 1) * apart
                if axis:  # walls; those of the first axis are below 0 and beyond all
                    np.moveaxis(columns, axis, 0)[-side, ..., column] = -1
        columns, values = (each.reshape(own.size, -1) for each in (columns, values))
        there = (columns >= 0) & (columns < self.medium.size)
        pointer = np.append(0, np.cumsum(there.sum(axis=1))).astype(PETSc.IntType)
        return pointer, columns[there], size(values[there])

    def wall_force(self, constants, size=unchanged):
        """See `Layout`: the wall beyond the last balls of the first axis."""
        force = np.zeros(self.last - self.first)
        if self._rows.stop == self.medium.shape[0]:
            last = self.medium.blocks(constants * self.medium.drive)[0][-1].ravel()
            force[len(force) - len(last) :] = size(last)
        return force
