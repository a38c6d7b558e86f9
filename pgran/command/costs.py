"""What a factorization, a solve and a slice of modes cost: entries, operations, bytes, time.

Formulas in the shape of a lattice. Their constants were measured with PETSc 3.18 and MUMPS 5.5;
times matter only relative to each other: `pgran.command.trials` measures the machine at hand.
"""

import dataclasses
import math
from dataclasses import dataclass

from pgran.physics.lattice import bond_count

# Of the entries that nested dissection predicts, a factor has this part: 1.2 of them for a chain,
# .9 to .66 for 20 x 20 to 500 x 500, .73 to .61 for 6^3 to 15^3, .8 for 20^3.
FILLED = 0.75
# Bytes for each entry of the factor: a complex number and its column; MUMPS keeps room to work in.
ENTRY_BYTES = {"petsc": 20, "mumps": 28}
# Bytes for each ball and nonzero of its row (K, C, S and what assembles them), for each vector, and
# the vectors beside those of the systems: of the KSP and the error bounds.
SLOT_BYTES, SCALAR_BYTES, OTHER_VECTORS = 90, 16, 17
# Bytes for each ball of what finds a slice of modes: measured for 100 x 100 and 200 x 200.
SLICE_BYTES = 9000
# Shared by r ranks, each holds 1.3/r of a lattice; r ranks are r^.6 times as fast as one: measured
# for 500 x 500 balls on 2 ranks.
UNEVEN, SPEED_UP = 1.3, 0.6
# HDF5 itself: names, attributes, tables of datasets; which datasets are complex, or a byte each.
FILE_BYTES = 20_000
COMPLEX = ("displacement", "coefficient", "field")
FLAGS = ("at_floor",)


@dataclass(frozen=True)
class Price:
    """Nanoseconds: of a factorization for each ball, entry and operation; of a solve likewise."""

    factor: tuple
    solve: tuple


PRICES = {
    "petsc": Price((0.0, 25.0, 0.6), (250.0, 3.5)),
    "mumps": Price((1100.0, 55.0, 0.05), (600.0, 5.0)),
}
# A slice of about 60 modes: orthogonalization and Rayleigh-Ritz for each ball (ns), and solves.
SLICE_BALL, SLICE_SOLVES = 28_000.0, 150


def dissection(shape):
    """Return the entries of the factor L by nested dissection, and the operations to compute it.

    Not collective. A box is cut in two across its longest axis by a layer of m balls, which is
    eliminated after both halves: it then couples to itself and to the b balls of the layers around
    the box, m (m/2 + b) entries. All boxes of one level are alike, so one box a level is counted.
    Like n for a chain, n^(4/3) for a cube of n balls; for a square of N x N the leading terms are
    George's (1973), 31/4 N^2 log2 N entries and 829/84 N^3 multiplications with their additions.

    Parameters
    ----------
    shape : sequence of int

    Returns
    -------
    entries, operations : float
    """
    box, cuts, boxes = [float(n) for n in shape], [0.0] * len(shape), 1.0
    entries = operations = 0.0
    while True:
        balls = math.prod(box)
        around = sum(c * balls / side for c, side in zip(cuts, box, strict=True))
        axis = max(range(len(box)), key=box.__getitem__)
        whole = balls <= 1
        layer = balls if whole else balls / box[axis]
        entries += boxes * layer * (layer / 2 + around)
        operations += boxes * layer * (layer**2 / 3 + layer * around + around**2)
        if whole:
            return FILLED * entries, operations
        # of the two faces across an axis, `cuts` are layers on the average, the others walls
        box[axis], cuts[axis], boxes = (box[axis] - 1) / 2, cuts[axis] / 2 + 1, 2 * boxes


@dataclass(frozen=True)
class Costs:
    """A lattice's matrices with a factorization, `fill` times what dissection predicts."""

    shape: tuple
    package: str
    fill: float = 1.0

    @property
    def balls(self):
        """How many unknowns."""
        return math.prod(self.shape)

    @property
    def entries(self):
        """Entries of the factor."""
        return self.fill * dissection(self.shape)[0]

    @property
    def factoring(self):
        """Nanoseconds of a numeric factorization."""
        entries, operations = (self.fill * count for count in dissection(self.shape))
        price = PRICES.get(self.package, PRICES["mumps"]).factor
        return price[0] * self.balls + price[1] * entries + price[2] * operations

    @property
    def solving(self):
        """Nanoseconds of a solve with the factor, and of the vector operations around it."""
        price = PRICES.get(self.package, PRICES["mumps"]).solve
        return price[0] * self.balls + price[1] * self.entries

    @property
    def slicing(self):
        """Nanoseconds to find a slice of modes."""
        return SLICE_BALL * self.balls + self.factoring + SLICE_SOLVES * self.solving

    @property
    def factor_bytes(self):
        """Memory of the factor."""
        return self.entries * ENTRY_BYTES.get(self.package, ENTRY_BYTES["mumps"])

    def bytes(self, detectors, ranks=1, columns=0):
        """Return the memory of a rank: bonds, matrices, vectors, factor, and blocks of columns."""
        bonds = 3 * 8 * bond_count(self.shape)
        slots = 2 * len(self.shape) + 1
        vectors = 3 * (1 + detectors) + OTHER_VECTORS + columns
        shared = self.balls * (SLOT_BYTES * slots + SCALAR_BYTES * vectors) + self.factor_bytes
        return bonds + shared * (1 if ranks == 1 else UNEVEN / ranks)


def stored_bytes(record, lengths, without=()):
    """Return the size of the datasets that a class of `pgran.results` declares.

    Not collective.

    Parameters
    ----------
    record : type
    lengths : dict
        How long each axis is, under the name of its coordinate; what has no axes of its own,
        under its own name.
    without : sequence of str
        Optional arrays that are not stored.
    """
    items = [
        item
        for item in dataclasses.fields(record)
        if "axes" in item.metadata and item.name not in without
    ]
    total = 0
    for item in items:
        size = math.prod(lengths[axis] for axis in item.metadata["axes"] or (item.name,))
        total += size * (SCALAR_BYTES if item.name in COMPLEX else 1 if item.name in FLAGS else 8)
    indices = {a for item in items for a in item.metadata["axes"]} - {item.name for item in items}
    return total + 8 * sum(lengths[axis] for axis in indices)
