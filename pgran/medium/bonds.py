"""The grid of a lattice: which balls its bonds join, and the order in which balls are eliminated.

Bonds join nearest neighbours, and every ball at a wall to that wall: along an axis there is one
bond more than balls, and bond `i` joins the balls `i - 1` and `i`. They are numbered axis after
axis, each array in C order.

Balls are eliminated by nested dissection. A separator is a set of balls without which those on its
two sides do not touch. Along an axis of a square lattice it needs a ball for each row that it
crosses; along a diagonal too, and there it is longer by the square root of two:

    o o | o o        o o o x
    o o | o o        o o x o        A ball of the diagonal i + j = c touches balls of c - 1 and
    o o | o o        o x o o        c + 1 only, never another of its own.
    o o | o o        x o o o

So pieces are cut where the separator is shortest for the size of what it cuts, along axes or
diagonals, again and again, and each separator is eliminated after its two sides. Of 60 x 60 balls
and more that takes a quarter fewer multiplications than PETSc's dissection, as of any graph.
"""

import math
from functools import lru_cache
from itertools import product

import numpy as np

from pgran.medium.base import AXES

SIGNS = np.array([-1.0, 1.0])  # in a row of B, of the ball below a bond and of that above
UNCUT = 2  # balls of a piece that is not cut


def bond_ends(numbers):
    """Return the balls that each bond joins, -1 for a wall, shape (bonds, 2).

    `numbers` are those of the balls, an array over the lattice. So a row holds the columns of B in
    its row; B's entries there are `SIGNS`.
    """
    sides = [bond_sides(numbers, axis, -1) for axis in range(numbers.ndim)]
    return np.concatenate([np.stack([end.ravel() for end in pair], axis=1) for pair in sides])


def bond_sides(values, axis, wall):
    """Return the values of the balls below and above each bond along an axis; walls have `wall`.

    `values`, an array over the balls, gives two arrays that are one longer along the axis. This is
    the topology of the lattice: all else follows from it.
    """
    # values         0 1 2
    # padded    wall 0 1 2 wall
    # below     wall 0 1 2
    # above          0 1 2 wall
    axis %= values.ndim
    before = (slice(None),) * axis
    padded = np.empty([n + 2 * (a == axis) for a, n in enumerate(values.shape)], values.dtype)
    padded[(*before, slice(1, -1))] = values
    padded[(*before, [0, -1])] = wall
    return padded[(*before, slice(-1))], padded[(*before, slice(1, None))]


def bond_shape(shape, axis):
    """Return the shape of the array of bonds along an axis."""
    return tuple(n + (a == axis) for a, n in enumerate(shape))


def bond_count(shape):
    """Return the number of bonds, wall bonds included."""
    return sum(math.prod(bond_shape(shape, axis)) for axis in range(len(shape)))


def bond_arrays(shape, bonds):
    """Return numbers of all bonds, in order, as one array for each axis, which share them."""
    shapes = [bond_shape(shape, axis) for axis in range(len(shape))]
    parts = np.split(bonds, np.cumsum([math.prod(each) for each in shapes])[:-1])
    return tuple(part.reshape(each) for part, each in zip(parts, shapes, strict=True))


def cut_sides(arrays, sides):
    """Set the bonds at sides, `y+` and so on, to 0 in arrays for each axis."""
    for side in sides:
        axis = AXES.index(side[0])
        np.moveaxis(arrays[axis], axis, 0)[-1 if side[1] == "+" else 0] = 0.0


def balls_above(shape):
    """Return how many balls are above each bond along the last axis, an array for each axis."""
    # above a bond across that axis half of the balls beside it count, too
    shapes = [bond_shape(shape, axis) for axis in range(len(shape))]
    height = [np.indices(own)[-1] + 0.5 * (own[-1] == shape[-1]) for own in shapes]
    return [shape[-1] - above for above in height]


@lru_cache(maxsize=16)
def dissected(shape):
    """Return the numbers (balls,) of a lattice's balls in the order of elimination, read-only."""
    places = _directions(len(shape)) @ np.indices(shape).reshape(len(shape), -1)
    order = np.empty(places.shape[1], dtype=int)
    # Pieces lie one after the other in `balls`; the first of piece p is the `begin[p]`th that is
    # eliminated: first its lower side, then its upper side, then the separator.
    balls, begin, length = np.arange(len(order)), np.zeros(1, dtype=int), np.array([len(order)])
    while len(balls):
        piece = np.repeat(np.arange(len(length)), length)
        along, cut = _shortest(places[:, balls], piece, length)
        side = np.sign(places[along[piece], balls] - cut[piece])
        side[(along < 0)[piece]] = 0  # what is not cut is done
        # of each piece the lower side, the upper side, and what is done
        count = np.stack([np.bincount(piece[side == s], minlength=len(length)) for s in (-1, 1, 0)])
        first = begin + np.cumsum(count, axis=0) - count
        done, before = side == 0, np.cumsum(count[2]) - count[2]
        places_done = np.repeat(first[2] - before, count[2]) + np.arange(count[2].sum())
        order[places_done] = balls[done]
        half = (2 * piece + (side > 0))[~done]
        balls = balls[~done][np.argsort(half, kind="stable")]
        begin, length = first[:2].T.ravel(), count[:2].T.ravel()
        begin, length = begin[length > 0], length[length > 0]
    order.flags.writeable = False
    return order


def _directions(axes):
    """Return the directions across which pieces are cut: along the axes, then diagonals."""
    steps = np.array(list(product((0, 1, -1), repeat=axes)))
    leading = np.array([step[np.flatnonzero(step)[0]] if step.any() else 0 for step in steps])
    steps = steps[leading > 0]
    return steps[np.argsort(np.abs(steps).sum(axis=1), kind="stable")]


def _shortest(places, piece, length):
    """Return along which direction each piece is cut, -1 if it is not, and at which place.

    The separator is short for the sizes of the sides: its balls times 1 / lower + 1 / upper.
    """
    start = np.cumsum(length) - length
    best, along, cut = np.full(len(length), np.inf), np.full(len(length), -1), 0 * length
    for direction, place in enumerate(places):
        least = np.minimum.reduceat(place, start)
        widths = np.maximum.reduceat(place, start) - least + 1
        at = np.cumsum(widths) - widths
        balls = np.bincount(place + (at - least)[piece])
        below = np.cumsum(balls) - balls
        lower = below - np.repeat(below[at], widths)
        upper = np.repeat(length, widths) - lower - balls
        with np.errstate(divide="ignore"):
            price = balls * (1 / lower + 1 / upper)
        price[lower == 0] = np.inf
        price[upper == 0] = np.inf
        cheapest = np.minimum.reduceat(price, at)
        better = (cheapest < best) & (length > UNCUT)
        here = np.flatnonzero(price == np.repeat(cheapest, widths))
        here = here[np.searchsorted(here, at)]  # the first of each piece
        best[better], along[better] = cheapest[better], direction
        cut[better] = (here - at + least)[better]
    return along, cut
