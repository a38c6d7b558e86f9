"""Up to which amplitude of the drive contacts stay closed, by the linear field, with bounds.

A drive of the amplitude a stretches contact b by a |E_b|, E = B A + w with w what is driven adds.
It opens at a_b = h_b / |E_b|, h_b its overlap. Of a field A~ with the residual r

    |E_b - E~_b| = |b^T (A - A~)| <= |b|_2 |S^-1| |r|,

and so 1 / a_b is known up to |b|_2 |S^-1| |r| / h_b. What is the n-th of these bounds by size
bounds the n-th of all 1 / a_b.
"""

import math

import numpy as np
from mpi4py import MPI

from pgran.medium.base import EPSILON, SMALLEST_NORMAL

PART = 0.01  # of the contacts
NOTHING, LEAST = 1e-200, 1e-100  # an overlap of 0, so that it divides; less than any length


class Openings:
    """What opens the contacts of a driven medium, of which `overlaps` tell; the same on all ranks.

    `operators` are the medium's; `part` is how many contacts are not only the first.
    """

    def __init__(self, operators, overlaps, part=PART):
        layout, self.contact, self._comm = operators.layout, overlaps.contact, operators.comm
        self._count = math.ceil(part * len(self.contact))
        # shapes (w, contacts); what another rank has, or nobody, stands for a 0 behind all rows
        ends, entries, rows = layout.ends[self.contact].T, layout.entries, operators.last
        self._entries = (entries[self.contact] if len(entries) > 1 else entries).T.copy()
        mine = (ends >= operators.first) & (ends < operators.last)
        self._rows = np.where(mine, ends, rows) - operators.first
        self._values = np.zeros(rows - operators.first + 1, complex)
        # 1 / h, and in units of h: |b|_2, and how far rounding moves E beside b^T A
        self._drive = layout.drive[self.contact]
        self._inverse = 1 / np.maximum(overlaps.overlap, NOTHING)
        lengths = np.sqrt(np.sum((ends >= 0) * self._entries**2, axis=0))
        self._lengths = self._inverse * np.maximum(lengths, SMALLEST_NORMAL)  # as error may be inf
        self._rounded = self._inverse * (4 * EPSILON * np.abs(self._drive) + SMALLEST_NORMAL)
        self._rounding = (len(ends) + 4) * EPSILON  # of b^T A, in units of |b|_2 |A|_2

    def at(self, field, error):
        """Return bounds of what opens the first contact, and the part of all, and which is first.

        Collective. The `field`, a vector, is wrong by at most `error` in the 2-norm. Bounds are
        two numbers, the upper one infinite where the error is too large; the field says which
        contact is first.
        """
        self._values[:-1] = field.getArray(readonly=True)
        stretch = np.zeros(len(self.contact), complex)
        for entries, rows in zip(self._entries, self._rows, strict=True):
            stretch += entries * self._values.take(rows)
        if self._comm.size > 1:
            self._comm.Allreduce(MPI.IN_PLACE, stretch)
        inverse = np.abs(stretch + self._drive) * self._inverse  # 1 / a
        doubt = self._lengths * (error + self._rounding * field.norm()) + self._rounded
        first, part = [], []
        for bound, side in (_below, inverse + doubt), (_above, inverse - doubt):
            side.partition(-self._count)
            largest = side[-self._count :]
            first.append(bound(largest.max()))
            part.append(bound(largest[0]))
        return first, part, self.contact[inverse.argmax()]


# Overlaps and quotients are rounded, too.


def _below(inverse):
    """Return an amplitude below 1 over a number, which is positive."""
    amplitude = (1 - 8 * EPSILON) / inverse
    return amplitude if amplitude > LEAST else 0.0


def _above(inverse):
    """Return an amplitude above 1 over a number, infinite unless that is positive."""
    return (1 + 8 * EPSILON) / inverse if inverse > 0 else math.inf
