"""Networks made by rule: crystals and random geometric graphs, whole and diluted.

Nearest neighbours in a crystal are at the distance 1. Unless it is periodic along the first axis,
or `held` is given, the balls at that axis' lower end are at rest, and those at its upper end are
driven; the sides that are not periodic are free. Contacts of two held balls are left out.
"""

import functools
import itertools
import math

import numpy as np

from pgran.errors import InputError
from pgran.medium.graph import subnetwork, without_floating
from pgran.medium.law import drawn, unit_numbers
from pgran.medium.network import Network
from pgran.medium.packing import near_pairs
from pgran.medium.springs import AT_REST, DRIVEN, FREE

HALF, ROOT3 = 0.5, math.sqrt(3)
# The edges of a rectangular unit cell, and where its balls sit, in parts of them.
CELLS = {
    "square": ((1.0, 1.0), ((0, 0),)),
    "triangular": ((1.0, ROOT3), ((0, 0), (HALF, HALF))),
    "honeycomb": ((ROOT3, 3.0), ((HALF, 0), (0, 1 / 6), (0, HALF), (HALF, 2 / 3))),
    "cubic": ((1.0, 1.0, 1.0), ((0, 0, 0),)),
    "fcc": ((math.sqrt(2),) * 3, ((0, 0, 0), (0, HALF, HALF), (HALF, 0, HALF), (HALF, HALF, 0))),
}


def crystal(name, shape, stiffness=1.0, *, periodic=False, held=None, seed=1993, **others):
    """Return a crystal of balls, each in contact with its nearest neighbours.

    Balls are numbered cell by cell in C order, those of a cell together. The contacts of all cells
    come neighbour by neighbour, each of a ball with one at a larger x (if that is the same: y, z),
    in the order of the balls: on the square lattice along x first, then along y.

    Parameters
    ----------
    name : str
        A key of `CELLS`.
    shape : sequence of int
        Cells along each axis. A cell holds 1 ball (square, cubic), 2 (triangular, in two rows along
        x), or 4 (honeycomb; fcc, the cube).
    stiffness : float, array_like or callable
        Of every contact; of each, those of two held balls included; or a law, as of `relax`.
    periodic : bool or sequence of bool
        Whether the last balls along an axis touch the first.
    held : array_like of int, optional
        One number a ball, in any shape: see `Network`.
    seed : int
        What is drawn is a pure function of it.
    **others
        Of `Network`. Vectors are the default, and with rotations balls that touch.
    """
    edges, basis = (np.array(values) for values in CELLS[name])
    axes = len(edges)
    if len(shape) != axes or min(shape) < 1:
        raise InputError(f"{name}: the shape is {axes} positive numbers of cells")
    periodic = np.broadcast_to(periodic, (axes,))
    cells = np.indices(shape).reshape(axes, -1).T
    balls = np.arange(len(cells) * len(basis)).reshape(*shape, len(basis))
    position = ((cells[:, None] + basis) * edges).reshape(-1, axes)
    bond, normal = [], []
    for (a, start), (b, end) in itertools.product(enumerate(basis), repeat=2):
        for step in itertools.product((1, 0, -1), repeat=axes):
            away = (end + step - start) * edges
            # of the contacts that each ball has, those that lead ahead
            ahead = away[np.argmax(np.abs(away) > 1e-9)] > 0
            if not ahead or abs(away @ away - 1) > 1e-9:
                continue
            other = cells + step  # the cells that hold the second balls
            here = np.all(periodic | ((other >= 0) & (other < shape)), axis=1)
            other = tuple((other[here] % shape).T)
            bond.append(np.stack([balls[..., a].ravel()[here], balls[(*other, b)]], axis=1))
            normal.append(np.tile(away, (np.count_nonzero(here), 1)))
    bond, normal = np.concatenate(bond), np.concatenate(normal)
    if held is None:
        held = np.zeros(balls.shape, dtype=int)
        if not periodic[0]:
            held[0], held[-1] = AT_REST, DRIVEN
    geometry = {"position": position, "normal": normal, "distance": np.ones(len(bond))}
    return _made(bond, stiffness, held, seed, HALF, geometry | others)


# makers of each kind, of the parameters of `crystal` after the name
square, triangular, honeycomb, cubic, fcc = (functools.partial(crystal, name) for name in CELLS)


def random_geometric(
    count, dimension=2, contacts=6.0, *, radius=None, stiffness=1.0, periodic=False, held=None,
    seed=1993, **others
):  # fmt: skip
    """Return a random geometric graph: random points in a box, in contact with all that are near.

    Each unit of volume of the box has one of the `count` points. Balls are in contact at distances
    below `radius`, or have so many `contacts` on the mean far from the walls. What floats is left
    out. Held at the first axis' ends are the balls within the radius of them. The others are as
    those of `crystal`, of each contact in the order of the balls' numbers.
    """
    if count < 1 or dimension not in (1, 2, 3):
        raise InputError("random_geometric: points in 1 to 3 dimensions are needed")
    edge = count ** (1 / dimension)
    box = np.where(np.broadcast_to(periodic, (dimension,)), edge, np.inf)
    if radius is None:
        # a ball of this radius in d dimensions holds so many of one point a unit volume
        ball = math.pi ** (dimension / 2) / math.gamma(dimension / 2 + 1)
        radius = (contacts / ball) ** (1 / dimension)
    position = edge * unit_numbers(seed, 0, count * dimension).reshape(count, dimension)
    bond, away, distance = near_pairs(position, np.full(count, radius / 2), box, 0.0)
    if held is None:
        held = np.zeros(count, dtype=int)
        if np.isinf(box[0]):
            held[position[:, 0] < radius] = AT_REST
            held[position[:, 0] > edge - radius] = DRIVEN
    geometry = {"position": position, "normal": away / distance[:, None], "distance": distance}
    return without_floating(_made(bond, stiffness, held, seed, radius / 2, geometry | others))[0]


def diluted(network, missing, seed=1993):
    """Return a network without a part of its contacts, 0 to 1, and the balls that then float.

    With the same seed more contacts are missing if the part is larger, and none come back.
    """
    if not 0 <= missing <= 1:
        raise InputError(f"diluted: a part lies between 0 and 1, not at {missing}")
    count = len(network.bond)
    order = np.argsort(unit_numbers(seed, 0, count, generation=2), kind="stable")
    left = np.sort(order[round(missing * count) :])
    return without_floating(subnetwork(network, contacts=left))[0]


def _made(bond, stiffness, held, seed, radius, others):
    """Return a network by rule, without the contacts of two held balls, which move nothing.

    Constants are given, or drawn by a law; balls that turn have a `radius` unless others say more.
    """
    if callable(stiffness):
        stiffness = drawn(stiffness, unit_numbers(seed, 0, len(bond), generation=1))
    elif np.ndim(stiffness) == 0:
        stiffness = np.full(len(bond), stiffness)
    if others.setdefault("displacement", "vector") == "rotations":
        others.setdefault("radius", np.full(np.size(held), radius))
    network = Network(bond, stiffness, np.ravel(held), **others)
    moving = np.any(network.held[network.bond] == FREE, axis=1)
    return network if np.all(moving) else subnetwork(network, contacts=np.flatnonzero(moving))
