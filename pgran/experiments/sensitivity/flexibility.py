"""How far a force along one spring stretches those beside it: G = U S^-1 U^T of a few springs."""

import numpy as np

from pgran.medium.rounding import EPSILON


class Flexibility:
    """The matrices G of many small groups of springs, at any frequency.

    Not collective. Each unknown at these springs is solved for once, however many groups it is in.

    Parameters
    ----------
    operators : pgran.driven.operators.Operators
    groups : numpy.ndarray of int, shape (count, r)
        Springs; -1 fills up a row.

    Attributes
    ----------
    springs : numpy.ndarray of int
        All springs of the groups, each once; -1 too, if it is there.
    place : numpy.ndarray of int, shape (count, r)
        Where among these each spring of a group is.
    """

    def __init__(self, operators, groups):
        """Find the unknowns to solve for, and where what they give belongs."""
        self.operators, layout, self._shape = operators, operators.layout, groups.shape
        self.springs, place = np.unique(groups, return_inverse=True)
        self.place = place = place.reshape(groups.shape)
        there = groups >= 0
        ends = np.where(there[..., None], layout.ends[groups], -1)  # (count, r, w)
        entries = layout.entries[groups if len(layout.entries) > 1 else 0 * groups]
        self._entries = np.where(ends >= 0, entries, 0.0)
        self._lengths = np.linalg.norm(self._entries, axis=-1)
        self._unknowns, self._number = np.unique(ends, return_inverse=True)
        self._number = self._number.reshape(ends.shape)
        # G_ij takes from the column of an unknown at spring j what it stretches spring i by
        count, r, width = ends.shape
        shape = (count, r, r, width)
        rows = np.broadcast_to(place[:, :, None, None], shape).ravel()
        columns = np.broadcast_to(self._number[:, None], shape).ravel()
        self._order = np.argsort(columns, kind="stable")
        self._rows, self._at = rows[self._order], columns[self._order]
        self._void = int(self._unknowns[0] < 0), int(self.springs[0] < 0)

    def matrices(self, columns):
        """Return G for each group, and a bound of its error in Frobenius' norm.

        Collective. S is factored and the bounds are prepared for it.

        Parameters
        ----------
        columns : pgran.driven.columns.Columns
            Of a solver with these operators.

        Returns
        -------
        G : numpy.ndarray, shape (count, r, r)
            Zero in rows and columns that only fill up.
        error : numpy.ndarray, shape (count,)
        """
        bounds, layout = columns.solver.bounds, self.operators.layout
        springs = self.springs[self._void[1] :]
        taken = np.zeros(len(self._order), dtype=complex)
        wrong = np.zeros(len(self._unknowns))
        start = self._void[0]
        solved = columns.solved(self._unknowns[start:], self._units, 1.0)
        for part, found, norms, residuals in solved:
            longer = np.zeros((len(self.springs), len(part)), dtype=complex)
            longer[self._void[1] :] = self.operators.stretch(found, springs)
            stop = start + len(part)
            here = slice(*np.searchsorted(self._at, [start, stop]))
            taken[here] = longer[self._rows[here], self._at[here] - start]
            rounding = (layout.ends.shape[1] + 2) * EPSILON * norms
            wrong[start:stop] = residuals * bounds.inverse_norm + rounding
            start = stop
        count, r = self._shape
        T = np.empty_like(taken)
        T[self._order] = taken
        T = T.reshape(count, r, r, -1)
        G = np.einsum("pije,pje->pij", T, self._entries)
        across = np.einsum("pje,pje->pj", np.abs(self._entries), wrong[self._number])
        error = 1.01 * np.linalg.norm(self._lengths, axis=1) * np.linalg.norm(across, axis=1)
        # what rounds while the parts of a column are summed up
        size = np.einsum("pije,pje->pij", np.abs(T), np.abs(self._entries))
        error += (T.shape[-1] + 4) * EPSILON * np.linalg.norm(size, axis=(1, 2))
        return G, error

    def _units(self, unknowns, columns):
        """Set columns to the unit vectors of unknowns, as far as they lie in this rank's rows."""
        columns[:] = 0.0
        mine = np.flatnonzero((unknowns >= self.operators.first) & (unknowns < self.operators.last))
        columns[unknowns[mine] - self.operators.first, mine] = 1.0
