"""Packings: laws of contacts, periodic boxes, parts that can vibrate, balance of forces."""

import logging
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pgran.arguments import meant, nearest
from pgran.errors import InputError
from pgran.medium.checks import checked_array
from pgran.medium.graph import anchored
from pgran.medium.springs import FREE
from pgran.run.numbers import number

log = logging.getLogger("pgran")

SMALLEST, LARGEST = 1e-100, 1e100  # of lengths whose squares can be told apart
DEEP = 0.4  # of two radii together: an overlap that no packing has
POWERS = {"harmonic": 1.0, "hertz": 1.5}  # of the overlap: F = c h^power, k = power F / h


@dataclass(frozen=True)
class ContactLaw:
    """F = c h^power, with c = modulus (R_i R_j / (R_i + R_j))^(power - 1)."""

    power: float
    modulus: float = 1.0

    @classmethod
    def named(cls, name, law, modulus=1.0):
        """Return the law harmonic, hertz, or of a power; raise an InputError that has a `name`."""
        power = POWERS.get(law, 0) if isinstance(law, str) else number(f"{name}: law", law)
        if not 1 <= power <= 4:
            hint = f"a power from 1 to 4{meant(nearest(str(law), POWERS))}"
            raise InputError(f"{name}: law: {law} is not harmonic, hertz or {hint}")
        return cls(power, number(f"{name}: modulus", modulus))

    def constants(self, first, second):
        """Return c of contacts between balls of these radii."""
        return self.modulus * (first * second / (first + second)) ** (self.power - 1)

    def force(self, constants, overlap):
        """Return F; none where balls do not overlap."""
        return constants * np.maximum(overlap, 0.0) ** self.power

    def stiffness(self, constants, overlap):
        """Return dF/dh; none where balls do not overlap."""
        touching = overlap > 0
        height = np.where(touching, overlap, 1.0)
        return np.where(touching, self.power * constants * height ** (self.power - 1), 0.0)

    def fields(self, pairs, away, overlap, constants):
        """Return contacts that bear forces by the law, as `Network` takes them, by name."""
        distance = np.linalg.norm(away, axis=1)
        force, stiffness = self.force(constants, overlap), self.stiffness(constants, overlap)
        contacts = {"bond": pairs, "normal": away / distance[:, None], "distance": distance}
        return contacts | {"force": force, "stiffness": stiffness, "power": self.power}


def nearest_images(away, periods):
    """Return vectors (n, d) between balls' nearest images, and through which ends they lead.

    `away` are those in the box; `periods` (d,) are infinite where there is none.
    """
    finite = np.isfinite(periods)
    turns = np.rint(away / periods)  # 0 where the period is infinite
    return away - turns * np.where(finite, periods, 0.0), turns != 0


def near_pairs(position, radius, box, reach):
    """Return the pairs (n, 2) of balls nearer than `reach` to touching, vectors, distances.

    `box` are the periods along each axis, infinite where there is none. Raises InputError where
    the box is so small that a ball could touch two images of another.
    """
    from scipy.spatial import cKDTree  # here: SciPy takes its time

    cutoff, periodic = 2 * radius.max() + reach, np.isfinite(box)
    if np.any(box[periodic] < 2 * cutoff):
        raise InputError(
            f"the box is {box[periodic].min():.4g} wide, less than {2 * cutoff:.4g}: "
            "balls could touch two images of another; more balls are needed"
        )
    inside = position - position.min(axis=0)
    inside[:, periodic] = position[:, periodic] % box[periodic]
    inside[:, periodic] *= inside[:, periodic] < box[periodic]  # rounded up to the period
    tree = cKDTree(inside, boxsize=np.where(periodic, box, 0.0))
    pairs = tree.query_pairs(cutoff, output_type="ndarray")
    pairs = pairs[np.lexsort(pairs.T[::-1])]
    away, _ = nearest_images(position[pairs[:, 1]] - position[pairs[:, 0]], box)
    distance = np.linalg.norm(away, axis=1)
    near = distance < radius[pairs].sum(axis=1) + reach
    return pairs[near], away[near], distance[near]


def touching(position, radius, box, law):
    """Return the balls and contacts of `Network.of_balls`, as `Network` takes them, by name."""
    position = checked_array("position", position, float, [None, None])
    count, axes = position.shape
    radius = radius if np.ndim(radius) else np.full(count, radius)
    radius = checked_array("radius", radius, float, [count])
    box = checked_array("box", np.zeros(axes) if box is None else box, float, [axes])
    sizes = np.concatenate([radius, np.abs(position).ravel()])
    if not (count and radius.min() > SMALLEST and sizes.max() < LARGEST):
        raise InputError("network: balls need positive radii, and lengths of 1e-100 to 1e100")
    pairs, away, distance = near_pairs(position, radius, np.where(box > 0, box, np.inf), 0.0)
    if not len(pairs):
        raise InputError(
            "no two balls overlap, and what only touches bears nothing: are positions, radii and "
            "box in one unit? Radii a little larger, as 1.001 R, let those overlap that touch"
        )
    if not np.all(distance):
        raise InputError(f"balls {pairs[distance.argmin()].tolist()} (rows) are at the same place")
    together = radius[pairs].sum(axis=1)
    overlap = together - distance
    if np.max(overlap / together) > DEEP:
        log.warning("balls overlap nearly to their centres: are the radii diameters?")
    balls = {"position": position, "radius": radius, "box": box, "held": np.zeros(count, int)}
    return balls | law.fields(pairs, away, overlap, law.constants(*radius[pairs].T))


class Kept(NamedTuple):
    """What of a packing can vibrate, and how many balls and contacts cannot, and why."""

    balls: np.ndarray  # which are kept
    contacts: np.ndarray
    rattlers: int  # free balls without contacts
    torn_off: int  # free balls without contacts since some were cut
    floating: int  # free balls without a path to a held one
    idle: int  # held balls that touch no free ball that is kept
    inert: int  # contacts of two held balls


def keep(bond, held, cut):
    """Return what of a packing is `Kept` where some contacts are `cut`."""
    free, count = held == FREE, len(held)
    whole = bond[~cut]
    touched = np.isin(np.arange(count), bond)
    still_touched = np.isin(np.arange(count), whole)
    # where no ball is held, parts may float
    fixed = np.ones(count, dtype=bool) if np.all(free) else anchored(whole, held)
    moving = free & still_touched & fixed
    contacts = ~cut & np.any(moving[bond], axis=1)
    balls = np.isin(np.arange(count), bond[contacts])
    return Kept(
        balls,
        contacts,
        rattlers=np.count_nonzero(free & ~touched),
        torn_off=np.count_nonzero(free & touched & ~still_touched),
        floating=np.count_nonzero(free & still_touched & ~fixed),
        idle=np.count_nonzero(~free & ~balls),
        inert=np.count_nonzero(~cut & ~np.any(free[bond], axis=1)),
    )


def total_forces(pairs, vectors, balls):
    """Return the sum over contacts at each ball: -vector at the first one, + at the second."""
    total = np.empty((balls, vectors.shape[1]))
    for axis, along in enumerate(vectors.T):
        total[:, axis] = np.bincount(pairs[:, 1], along, balls)
        total[:, axis] -= np.bincount(pairs[:, 0], along, balls)
    return total


def unbalanced(bond, normal, force, free):
    """Return the largest total force on a free ball, in units of the mean contact force.

    Forces (nb,) repel along the normals (nb, d), from the first ball of a contact to the second.
    """
    total = total_forces(bond, force[:, None] * normal, len(free))
    mean = np.abs(force).mean()
    return float(np.linalg.norm(total[free], axis=1).max() / mean) if mean > 0 else 0.0
