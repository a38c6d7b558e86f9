"""Packings: laws of contacts, periodic boxes, parts that can vibrate, balance of forces."""

from typing import NamedTuple

import numpy as np

from pgran.medium.graph import anchored
from pgran.medium.springs import FREE

POWERS = {"harmonic": 1.0, "hertz": 1.5}  # of the overlap: F = c h^power, k = power F / h


def nearest_images(away, periods):
    """Return vectors (n, d) between balls' nearest images, and through which ends they lead.

    `away` are those in the box; `periods` (d,) are infinite where there is none.
    """
    finite = np.isfinite(periods)
    turns = np.rint(away / periods)  # 0 where the period is infinite
    return away - turns * np.where(finite, periods, 0.0), turns != 0


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
