"""How many eigenvalues of a lattice's K lie below a shift, by condensing boxes of balls.

The lattice is cut in two by a layer of balls, and each part again, down to small boxes. A box acts
on the balls around it by its Schur complement; a layer is eliminated once both of its parts are, in
the basis of its own modes. By Sylvester's law K - sigma has as many negative eigenvalues as all the
blocks eliminated have together (nested dissection: George 1973; inertia: Haynsworth 1968). No
factors are kept, boxes of one shape go through each step together, and the modes of the smallest
boxes are the same for all shifts.
"""

from dataclasses import dataclass, field

import numpy as np

from pgran.medium.rounding import EPSILON

SMALLEST = {1: 12, 2: 60, 3: 80}  # balls in a box that is not cut further; measured
CHUNK = 2**19  # numbers in the matrices that are worked on together: they fit into the cache


@dataclass(eq=False)
class Boxes:
    """Boxes of one shape: what to eliminate in each, and the balls around it.

    Coordinates are those of a box's own first ball. `around` has the balls next to it on each side
    on which there is no wall; `inner` those to be eliminated: a layer, or all if it is not cut.
    """

    inner: np.ndarray
    around: np.ndarray
    cut: tuple  # pairs (offset, key) of the parts
    origins: list = field(default_factory=list)
    parts: list = field(default_factory=list)  # (boxes, where in them the first one's part is)


class Condensation:
    """Counts the eigenvalues of a lattice's K below a shift.

    Not collective.

    Parameters
    ----------
    lattice : pgran.medium.lattice.Lattice

    Attributes
    ----------
    norm : float
        |K|_inf, which no eigenvalue exceeds; 1 if K is zero.
    order : int
        How many eigenvalues there are.
    semidefinite : bool
        No eigenvalue is negative: always true.
    """

    semidefinite = True

    def __init__(self, lattice):
        """Cut the lattice, and find the modes of the smallest boxes."""
        self.shape, self.order = lattice.shape, lattice.balls
        self.norm = lattice.stiffness_norm or 1.0
        self._bonds = [k.ravel() for k in lattice.stiffness]
        self._strides = [_strides(k.shape) for k in lattice.stiffness]
        sums = 0.0
        for axis, k in enumerate(lattice.stiffness):
            k = np.moveaxis(k, axis, 0)
            sums = sums + np.moveaxis(k[1:] + k[:-1], 0, axis)
        self._diagonal = sums.ravel()
        self._levels = self._dissect()
        for level in self._levels:
            for boxes in level.values():
                self._prepare(boxes)

    def below(self, shift, clearance):
        """Return how many eigenvalues lie below a shift, or None where that is uncertain.

        Not collective. The count at shift - clearance is at most the one wanted, that at shift +
        clearance at least, if both are exact for matrices that miss K by no more than clearance
        (Weyl). So it is certain where both agree; the bound of what is missed rests on the backward
        stability of LAPACK's eigenvalues.
        """
        counts = set()
        for side in (-1, 1):
            count, missed = self.inertia(shift + side * clearance)
            if not missed <= clearance:
                return None
            counts.add(count)
        return counts.pop() if len(counts) == 1 else None

    def inertia(self, shift):
        """Return how many negative eigenvalues a matrix near K - shift has, and how near it is.

        Not collective. The distance is a bound of |E|_2 for K - shift + E. A ball lies in one box
        of a level, or in a layer between two: so many of their errors overlap at most.
        """
        negative, missed, done = 0, 0.0, {}
        scale = self.norm + abs(shift)
        with np.errstate(all="ignore"):
            for level in reversed(self._levels):
                found, worst = {}, 0.0
                for boxes in level.values():
                    found[id(boxes)], count, error = self._condense(boxes, shift, scale, done)
                    negative += count
                    worst = max(worst, error)
                missed += 2 * worst
                done = found
        return negative, missed

    def _dissect(self):
        """Return the boxes of each level by shape and sides, from the whole to the smallest."""
        axes = len(self.shape)
        whole = (self.shape, ((False, False),) * axes)
        levels = [{whole: _boxes(*whole)}]
        levels[0][whole].origins.append(np.zeros((1, axes), dtype=int))
        while any(boxes.cut for boxes in levels[-1].values()):
            following = {}
            for boxes in levels[-1].values():
                boxes.origins = np.concatenate(boxes.origins)
                for offset, key in boxes.cut:
                    part = following.setdefault(key, None) or _boxes(*key)
                    following[key] = part
                    boxes.parts.append((part, sum(map(len, part.origins)), offset))
                    part.origins.append(boxes.origins + offset)
            levels.append(following)
        for boxes in levels[-1].values():
            boxes.origins = np.concatenate(boxes.origins)
        return levels

    def _prepare(self, boxes):
        """Find where numbers go in the matrices of boxes, and modes of those that stay whole."""
        nodes = np.concatenate([boxes.inner, boxes.around])
        extent = nodes.max(axis=0) + 3
        strides, inner = _strides(extent), len(boxes.inner)
        keys = (nodes + 1) @ strides
        by_key = np.argsort(keys)

        def places(wanted):
            at = np.searchsorted(keys[by_key], wanted)
            at = by_key[np.minimum(at, len(keys) - 1)]
            return at, keys[at] == wanted

        boxes.springs = []
        for axis, stride in enumerate(strides):
            step = np.arange(len(strides)) == axis
            for sign in (1, -1):
                at, there = places(keys[:inner] + sign * stride)
                there &= (sign > 0) | (at >= inner)  # each bond once
                first, second = np.flatnonzero(there), at[there]
                upper = boxes.inner[there] + step * (sign > 0)
                boxes.springs.append((axis, first, second, upper @ self._strides[axis]))
        boxes.ball = boxes.inner @ _strides(self.shape)
        boxes.scatter = []
        for part, _, offset in boxes.parts:
            at, _ = places((part.around + offset + 1) @ strides)
            boxes.scatter.append(_runs(at))
        boxes.chunk = max(1, CHUNK // len(nodes) ** 2)
        if not boxes.cut:
            values, coupled = [], []
            for start in range(0, len(boxes.origins), boxes.chunk):
                matrix = self._assemble(boxes, slice(start, start + boxes.chunk))
                value, vectors = np.linalg.eigh(matrix[:, :inner, :inner])
                values.append(value)
                coupled.append(vectors.transpose(0, 2, 1) @ matrix[:, :inner, inner:])
            boxes.values, boxes.coupled = np.concatenate(values), np.concatenate(coupled)
            boxes.squares = np.einsum("bij,bij->bi", boxes.coupled, boxes.coupled)

    def _assemble(self, boxes, some):
        """Return the rows of K of what is eliminated in some boxes, each a matrix."""
        origins, inner = boxes.origins[some], len(boxes.inner)
        size = inner + len(boxes.around)
        matrix = np.zeros((len(origins), size, size))
        diagonal = np.arange(inner)
        first = origins @ _strides(self.shape)
        matrix[:, diagonal, diagonal] = self._diagonal[first[:, None] + boxes.ball]
        for axis, one, other, places in boxes.springs:
            springs = self._bonds[axis][(origins @ self._strides[axis])[:, None] + places]
            matrix[:, one, other] = -springs
            ours = other < inner
            matrix[:, other[ours], one[ours]] = -springs[:, ours]
        return matrix

    def _condense(self, boxes, shift, scale, done):
        """Return the Schur complements of boxes, negative values eliminated, and a bound of errors.

        Errors of one box: those of its modes' values and couplings, of the sums over its modes,
        and of what is stored.
        """
        inner, around = len(boxes.inner), len(boxes.around)
        schur = np.empty((len(boxes.origins), around, around))
        negative, worst = 0, 0.0
        for start in range(0, len(schur), boxes.chunk):
            some = slice(start, min(start + boxes.chunk, len(schur)))
            if boxes.cut:
                matrix = self._assemble(boxes, some)
                diagonal = np.arange(inner)
                matrix[:, diagonal, diagonal] -= shift
                for (part, first, _), runs in zip(boxes.parts, boxes.scatter, strict=True):
                    added = done[id(part)][first + some.start : first + some.stop]
                    _add(matrix, runs, added)
                if not np.isfinite(matrix[:, :inner, :inner]).all():
                    return schur, 0, np.inf
                values, vectors = np.linalg.eigh(matrix[:, :inner, :inner])
                coupled = vectors.transpose(0, 2, 1) @ matrix[:, :inner, inner:]
                squares = np.einsum("bij,bij->bi", coupled, coupled)
                stays = matrix[:, inner:, inner:]
            else:
                values, coupled = boxes.values[some] - shift, boxes.coupled[some]
                squares, stays = boxes.squares[some], 0.0
            inverse = 1.0 / values
            found = coupled.transpose(0, 2, 1) @ (inverse[:, :, None] * coupled)
            np.subtract(stays, found, out=schur[some])
            negative += np.count_nonzero(values < 0)
            size = np.sqrt(np.einsum("bij,bij->b", schur[some], schur[some]))
            size += 4 * inner * (np.abs(values).max(axis=1) + np.sqrt(squares.sum(axis=1)) + scale)
            size += (0.5 * inner + 2) * (squares * np.abs(inverse)).sum(axis=1)
            worst = max(worst, size.max()) if np.isfinite(size).all() else np.inf
        return schur, negative, EPSILON * worst


def _boxes(shape, sides):
    """Return boxes of a shape, with balls around them on some sides of each axis."""
    axes, around, cut = len(shape), [], ()
    span = [np.arange(n) for n in shape]
    for axis, (low, high) in enumerate(sides):
        for there, at in ((low, -1), (high, shape[axis])):
            if there:
                around.append(_grid([*span[:axis], np.array([at]), *span[axis + 1 :]]))
    longest = int(np.argmax(shape))
    if np.prod(shape) > SMALLEST[axes] and shape[longest] > 2:
        middle = shape[longest] // 2
        for first, size, side in (
            (0, middle, (sides[longest][0], True)),
            (middle + 1, shape[longest] - middle - 1, (True, sides[longest][1])),
        ):
            part = tuple(size if a == longest else n for a, n in enumerate(shape))
            its = tuple(side if a == longest else s for a, s in enumerate(sides))
            cut = (*cut, (first * (np.arange(axes) == longest), (part, its)))
        span[longest] = np.array([middle])
    nothing = np.zeros((0, axes), dtype=int)
    return Boxes(_grid(span), np.concatenate([nothing, *around]), cut)


def _grid(span):
    """Return all sites of a box, (balls, axes), from the coordinates along each axis."""
    return np.stack(np.meshgrid(*span, indexing="ij"), axis=-1).reshape(-1, len(span))


def _strides(shape):
    """Return by how much the number of a site grows along each axis."""
    return np.append(np.cumprod(np.asarray(shape)[:0:-1])[::-1], 1).astype(int)


def _runs(places):
    """Return slices (of the places, of what goes there) that follow each other; or the places."""
    if not len(places):
        return []
    ends = np.flatnonzero(np.diff(places) != 1) + 1
    pieces = np.split(np.arange(len(places)), ends)
    if len(pieces) > 12:
        return places
    return [(slice(places[p[0]], places[p[-1]] + 1), slice(p[0], p[-1] + 1)) for p in pieces]


def _add(matrix, runs, added):
    """Add matrices to parts of others."""
    if isinstance(runs, np.ndarray):
        matrix[:, runs[:, None], runs] += added
        return
    for rows, own_rows in runs:
        for columns, own_columns in runs:
            matrix[:, rows, columns] += added[:, own_rows, own_columns]
