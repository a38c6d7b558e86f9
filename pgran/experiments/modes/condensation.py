"""How many eigenvalues of a lattice's K lie below a shift, by condensing boxes of balls.

The lattice is a box. A box is cut in two by a layer of balls, and each part again, down to small
boxes that stay whole:

      a a a a a a a          o  in the two parts, and eliminated with these
    a o o o i o o o |        i  `inner`: the layer, eliminated next, in the basis of its own modes
    a o o o i o o o |        a  `around`: balls next to the box, on sides without a wall |
    a o o o i o o o |
      a a a a a a a

What is eliminated leaves its Schur complement on the balls around, which is added to the matrix of
the box that the part was cut from. With i before a,

    [ D    C ]                             D = V diag(values) V^T,  coupled = V^T C
    [ C^T  A ]    leaves   A - C^T D^-1 C = A - coupled^T diag(1 / values) coupled

By Sylvester's law K - sigma has as many negative eigenvalues as all the D together (nested
dissection: George 1973; inertia: Haynsworth 1968). No factors are kept, boxes of one shape go
through each step together, and the modes of the smallest boxes are the same for all shifts.
"""

from dataclasses import dataclass, field
from itertools import product

import numpy as np

from pgran.medium.rounding import EPSILON

SMALLEST = {1: 12, 2: 60, 3: 80}  # balls in a box that is not cut further; measured
CHUNK = 2**19  # numbers in the matrices that are worked on together: they fit into the cache
FEW_RUNS = 12  # pieces that are added one by one


@dataclass(eq=False)
class Boxes:
    """Boxes of one shape and with walls on the same sides, and where their balls and parts are.

    `inner` and `around` are coordinates from a box's own first ball, shape (balls, axes), `origins`
    those of the first balls in the lattice, shape (boxes, axes).
    """

    inner: np.ndarray
    around: np.ndarray
    cut: tuple  # pairs (offset, (shape, sides)) of the two parts; none if the box stays whole
    origins: list = field(default_factory=list)
    # Of each of the two parts: its boxes, which of these is the first box's, offset.
    parts: list = field(default_factory=list)
    # Where numbers go, by `_prepare`; a matrix has rows and columns for `inner`, then for `around`.
    springs: list = field(default_factory=list)  # (axis, rows, columns, bonds) of what meets inner
    scatter: list = field(default_factory=list)  # of each part the rows of the balls around it
    modes: list = field(default_factory=list)  # what `_modes` returns, if the boxes stay whole

    def chunks(self):
        """Yield slices of the boxes whose matrices are worked on together."""
        at_once = max(1, CHUNK // (len(self.inner) + len(self.around)) ** 2)
        for start in range(0, len(self.origins), at_once):
            yield slice(start, min(start + at_once, len(self.origins)))


class Condensation:
    """Counts the eigenvalues of a lattice's K below a shift.

    There are `order` of them; none is negative, or exceeds the `norm` |K|_inf, 1 if K is zero.
    """

    semidefinite = True

    def __init__(self, lattice):
        """Cut the lattice, and find the modes of the smallest boxes."""
        self.shape, self.order = lattice.shape, lattice.size
        self.norm = lattice.stiffness_norm or 1.0
        self._bonds = [k.ravel() for k in lattice.stiffness]
        self._strides = [_strides(k.shape) for k in lattice.stiffness]
        self._diagonal = lattice.diagonal.ravel()
        self._levels = self._dissect()
        for level in self._levels:
            for boxes in level:
                self._prepare(boxes)

    def below(self, shift, clearance):
        """Return how many eigenvalues lie below a shift, or None where that is uncertain.

        The count at shift - clearance is at most the one wanted, that at shift + clearance at
        least, if both are exact for matrices that miss K by no more than clearance (Weyl). So it is
        certain where both agree; the bound of what is missed rests on the backward stability of
        LAPACK's eigenvalues.
        """
        counts = set()
        for side in (-1, 1):
            count, distance = self.inertia(shift + side * clearance)
            if not distance <= clearance:  # NaN, too
                return None
            counts.add(count)
        return counts.pop() if len(counts) == 1 else None

    def inertia(self, shift):
        """Return how many negative eigenvalues a matrix near K - shift has, and how near it is.

        The distance is a bound of |E|_2 for K - shift + E. A ball lies in one box of a level, or in
        a layer between two: so many of their errors overlap at most.
        """
        negative, distance, complements = 0, 0.0, {}
        scale = self.norm + abs(shift)
        with np.errstate(all="ignore"):
            for level in reversed(self._levels):
                of_parts, complements, worst = complements, {}, 0.0
                for boxes in level:
                    complements[boxes], count, error = self._condense(boxes, shift, scale, of_parts)
                    negative += count
                    worst = max(worst, error)
                distance += 2 * worst
        return negative, distance

    def _dissect(self):
        """Return the boxes of each level, from the whole lattice to the smallest ones."""
        axes = len(self.shape)
        whole = _boxes(self.shape, ((False, False),) * axes)
        whole.origins = np.zeros((1, axes), dtype=int)
        levels = [[whole]]
        while any(boxes.cut for boxes in levels[-1]):
            following = {}
            for boxes in levels[-1]:
                for offset, kind in boxes.cut:
                    part = following[kind] = following.get(kind) or _boxes(*kind)
                    boxes.parts.append((part, sum(map(len, part.origins)), offset))
                    part.origins.append(boxes.origins + offset)
            for part in following.values():
                part.origins = np.concatenate(part.origins)
            levels.append(list(following.values()))
        return levels

    def _prepare(self, boxes):
        """Find where numbers go in the matrices of boxes, and modes of those that stay whole."""
        nodes = np.concatenate([boxes.inner, boxes.around])
        inner, extent = len(boxes.inner), nodes.max(axis=0) + 3
        # Sites are numbered in a grid wider by one on each side: the neighbour along an axis is a
        # stride away, and has the row -1 where nothing of the box is.
        strides = _strides(extent)
        site = (nodes + 1) @ strides
        row_of = np.full(np.prod(extent), -1)
        row_of[site] = np.arange(len(nodes))
        for axis, stride in enumerate(strides):
            upward = np.arange(len(strides)) == axis
            for sign in (1, -1):
                neighbour = row_of[site[:inner] + sign * stride]
                # Bonds between two inner balls are met from below only, so that each comes once.
                first = np.flatnonzero(neighbour >= (0 if sign > 0 else inner))
                # The bond below a ball has the ball's coordinates, that above has one more.
                bond = boxes.inner[first] + (upward if sign > 0 else 0)
                boxes.springs.append((axis, first, neighbour[first], bond @ self._strides[axis]))
        around = [part.around + offset + 1 for part, _, offset in boxes.parts]
        boxes.scatter = [_runs(row_of[nodes @ strides]) for nodes in around]
        if not boxes.cut:
            modes = [_modes(self._assemble(boxes, some), inner) for some in boxes.chunks()]
            boxes.modes = [np.concatenate(arrays) for arrays in zip(*modes, strict=True)]

    def _assemble(self, boxes, some):
        """Return the rows of K of what is eliminated in some boxes, each a matrix."""
        origins, inner = boxes.origins[some], len(boxes.inner)
        size = inner + len(boxes.around)
        matrix = np.zeros((len(origins), size, size))
        diagonal = np.arange(inner)
        # a ball's number is that of its box's first ball, and what it is farther
        ball = (origins @ _strides(self.shape))[:, None] + boxes.inner @ _strides(self.shape)
        matrix[:, diagonal, diagonal] = self._diagonal[ball]
        for axis, rows, columns, bond in boxes.springs:
            springs = self._bonds[axis][(origins @ self._strides[axis])[:, None] + bond]
            matrix[:, rows, columns] = -springs
            both = columns < inner
            matrix[:, columns[both], rows[both]] = -springs[:, both]
        return matrix

    def _condense(self, boxes, shift, scale, of_parts):
        """Return Schur complements of boxes, how many values are negative, a bound of errors."""
        inner, around = len(boxes.inner), len(boxes.around)
        schur = np.empty((len(boxes.origins), around, around))
        negative, worst = 0, 0.0
        for some in boxes.chunks():
            if boxes.cut:
                matrix = self._assemble(boxes, some)
                diagonal = np.arange(inner)
                matrix[:, diagonal, diagonal] -= shift
                for (part, first, _), runs in zip(boxes.parts, boxes.scatter, strict=True):
                    _add(matrix, runs, of_parts[part][first + some.start : first + some.stop])
                if not np.isfinite(matrix[:, :inner, :inner]).all():
                    return schur, 0, np.inf
                values, coupled, squares = _modes(matrix, inner)
                outer = matrix[:, inner:, inner:]
            else:
                values, coupled, squares = (array[some] for array in boxes.modes)
                values, outer = values - shift, 0.0
            inverse = 1.0 / values
            through = coupled.transpose(0, 2, 1) @ (inverse[:, :, None] * coupled)
            np.subtract(outer, through, out=schur[some])
            negative += np.count_nonzero(values < 0)
            # of what is stored; of the modes' values and couplings; of the sums over modes
            error = np.sqrt(np.einsum("bij,bij->b", schur[some], schur[some]))
            error += 4 * inner * (np.abs(values).max(axis=1) + np.sqrt(squares.sum(axis=1)) + scale)
            error += (0.5 * inner + 2) * (squares * np.abs(inverse)).sum(axis=1)
            worst = max(worst, error.max()) if np.isfinite(error).all() else np.inf
        return schur, negative, EPSILON * worst


def _modes(matrix, inner):
    """Return the values of D, V^T C and the squares of its rows' norms, of each matrix."""
    values, vectors = np.linalg.eigh(matrix[:, :inner, :inner])
    coupled = vectors.transpose(0, 2, 1) @ matrix[:, :inner, inner:]
    return values, coupled, np.einsum("bij,bij->bi", coupled, coupled)


def _boxes(shape, sides):
    """Return boxes of a shape; `sides` tells of both sides of each axis if there are balls."""
    axes, around, cut = len(shape), [], ()
    span = [np.arange(n) for n in shape]
    for axis, its_sides in enumerate(sides):
        for at in np.array([-1, shape[axis]])[list(its_sides)]:
            around.append(_grid([*span[:axis], [at], *span[axis + 1 :]]))
    longest = int(np.argmax(shape))
    if np.prod(shape) > SMALLEST[axes] and shape[longest] > 2:
        middle = shape[longest] // 2
        low, high = sides[longest]
        for first, size, ends in (
            (0, middle, (low, True)),  # the layer is next to both parts
            (middle + 1, shape[longest] - middle - 1, (True, high)),
        ):
            part = (*shape[:longest], size, *shape[longest + 1 :])
            its_sides = (*sides[:longest], ends, *sides[longest + 1 :])
            cut = (*cut, (first * (np.arange(axes) == longest), (part, its_sides)))
        span[longest] = [middle]
    nothing = np.zeros((0, axes), dtype=int)
    return Boxes(_grid(span), np.concatenate([nothing, *around]), cut)


def _grid(span):
    """Return all sites of a box, (balls, axes), from the coordinates along each axis."""
    return np.stack(np.meshgrid(*span, indexing="ij"), axis=-1).reshape(-1, len(span))


def _strides(shape):
    """Return by how much the number of a site grows along each axis."""
    return np.append(np.cumprod(np.asarray(shape)[:0:-1])[::-1], 1).astype(int)


def _runs(places):
    """Return the slices of following places, and of what goes there; the places if these are many.

    Places 3 4 5 9 10: [(3:6, 0:3), (9:11, 3:5)]. Blocks are added much faster than single entries.
    """
    if not len(places):
        return []
    ends = np.flatnonzero(np.diff(places) != 1) + 1
    pieces = np.split(np.arange(len(places)), ends)
    if len(pieces) > FEW_RUNS:
        return places
    return [(slice(places[p[0]], places[p[-1]] + 1), slice(p[0], p[-1] + 1)) for p in pieces]


def _add(matrix, runs, added):
    """Add matrices to the rows and columns of others that `runs` are."""
    if isinstance(runs, np.ndarray):
        matrix[:, runs[:, None], runs] += added
        return
    for (rows, own_rows), (columns, own_columns) in product(runs, repeat=2):
        matrix[:, rows, columns] += added[:, own_rows, own_columns]
