"""How far a force along one spring stretches those beside it: G = U S^-1 U^T of a few springs."""

import numpy as np

from pgran.medium.rounding import EPSILON


class Flexibility:
    """The matrices G of many small groups of springs, at any frequency.

    Each unknown at these springs is solved for once, however many groups it is in. With b_j, the
    w entries of B of spring j, and L(i, u), how far x = S^-1 e_u stretches spring i,

        G_ij = sum over the unknowns u of spring j of L(i, u) b_j(u).

    `groups`, shape (count, r), are numbers of springs; -1 fills up a row.
    """

    def __init__(self, operators, groups):
        self.operators, self.groups, layout = operators, groups, operators.layout
        self._there = groups >= 0
        # `place` (count, r) is where a spring of a group stands among all `springs`, each once;
        # `number` (count, r, w) is where an unknown of that spring stands among all `unknowns`.
        # Both lists may begin with -1, which is none.
        self.springs, place = np.unique(groups, return_inverse=True)
        self._place = place.reshape(groups.shape)
        ends = np.where(self._there[..., None], layout.ends[groups], -1)
        self._unknowns, number = np.unique(ends, return_inverse=True)
        self._number = number.reshape(ends.shape)
        self._no_spring, self._no_unknown = int(self.springs[0] < 0), int(self._unknowns[0] < 0)
        entries = layout.entries[groups if len(layout.entries) > 1 else 0 * groups]
        self._entries = np.where(ends >= 0, entries, 0.0)
        self._size = np.linalg.norm(np.linalg.norm(self._entries, axis=-1), axis=1)  # |U|
        # What G of group p needs stands in the table L, a row a spring, a column an unknown:
        #
        #                       number[p, j, u]
        #                              |
        #     place[p, i]  -  -  -  L(i, u)  =  needed[p, i, j, u]
        #
        # A few columns are solved for at a time; `order` sorts all [p, i, j, u] by columns, so that
        # those which need some columns are a slice of it.
        self._shape = (*groups.shape, *ends.shape[1:])
        rows = np.broadcast_to(self._place[:, :, None, None], self._shape).ravel()
        columns = np.broadcast_to(self._number[:, None], self._shape).ravel()
        self._order = np.argsort(columns, kind="stable")
        self._rows, self._columns = rows[self._order], columns[self._order]

    def stretched(self, fields, errors):
        """Return how far fields stretch the springs of each group, and bounds of the errors.

        Fields, this rank's rows, shape (rows, 1 + nd), are the amplitudes, with which the drive
        moves, then the adjoints; `errors`, shape (1 + nd,), bound theirs in the 2-norm. Collective.
        Returns what `changed_amplitudes` takes.
        """
        springs = self.operators.lattice.springs
        stretch = self.operators.stretch(fields, np.maximum(self.springs, 0)).T
        stretch[0] += springs.drive[self.springs]
        stretch = np.where(self._there, stretch[:, self._place], 0.0)
        lengths = np.where(self._there, springs.lengths[self.groups], 0.0)
        bounds = 1.01 * errors[:, None] * np.linalg.norm(lengths, axis=1)
        bounds += 4 * EPSILON * np.linalg.norm(stretch, axis=2)
        return stretch[0], bounds[0], stretch[1:], bounds[1:]

    def matrices(self, columns):
        """Return G for each group, and a bound of its error in Frobenius' norm.

        Collective. `columns`, a `Columns`, are of a solver with these operators, for whose S the
        bounds are prepared. G, shape (count, r, r), is zero in rows and columns that only fill up.
        """
        bounds, width = columns.solver.bounds, self._shape[-1]
        needed = np.zeros(len(self._order), dtype=complex)  # in G's order
        errors = np.zeros(len(self._unknowns))  # bounds of those of S^-1 e_u
        start = self._no_unknown
        solved = columns.solved(self._unknowns[start:], self._unit_vectors, 1.0)
        for unknowns, solutions, norms, residuals in solved:
            stop = start + len(unknowns)
            table = np.zeros((len(self.springs), len(unknowns)), dtype=complex)
            springs = self.springs[self._no_spring :]
            table[self._no_spring :] = self.operators.stretch(solutions, springs)
            here = slice(*np.searchsorted(self._columns, [start, stop]))
            needed[self._order[here]] = table[self._rows[here], self._columns[here] - start]
            errors[start:stop] = residuals * bounds.inverse_norm + (width + 2) * EPSILON * norms
            start = stop
        needed = needed.reshape(self._shape)
        G = np.einsum("pije,pje->pij", needed, self._entries)
        across = np.einsum("pje,pje->pj", np.abs(self._entries), errors[self._number])
        error = 1.01 * self._size * np.linalg.norm(across, axis=1)
        # what rounds while the parts of a column are summed up
        size = np.einsum("pije,pje->pij", np.abs(needed), np.abs(self._entries))
        error += (width + 4) * EPSILON * np.linalg.norm(size, axis=(1, 2))
        return G, error

    def _unit_vectors(self, unknowns, columns):
        """Set columns to the unit vectors of unknowns, as far as they lie in this rank's rows."""
        first, last = self.operators.first, self.operators.last
        columns[:] = 0.0
        mine = np.flatnonzero((unknowns >= first) & (unknowns < last))
        columns[unknowns[mine] - first, mine] = 1.0
