"""Balls that repel where they overlap: contact laws, who is near whom, who holds whom.

Two balls whose overlap h = R_i + R_j - |x_j - x_i| is positive repel with F = c h^alpha; alpha = 1
is harmonic, 3/2 Hertz. c belongs to the material and, where alpha > 1, to the curvature of both:
c = C (R_i R_j / (R_i + R_j))^(alpha - 1), which for Hertz is 4/3 E* sqrt(R*). NumPy and SciPy only.
"""

from dataclasses import dataclass

import numpy as np

from pgran.errors import InputError
from pgran.medium.packing import nearest_images


@dataclass(frozen=True)
class ContactLaw:
    """F = c h^power, with c = modulus (R_i R_j / (R_i + R_j))^(power - 1)."""

    power: float
    modulus: float = 1.0

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


def near_pairs(position, radius, box, reach):
    """Return the pairs (n, 2) of balls nearer than `reach` to touching, and the vectors between.

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
    near = np.linalg.norm(away, axis=1) < radius[pairs].sum(axis=1) + reach
    return pairs[near], away[near]


def pair_numbers(pairs, balls):
    """Return a number of each pair (n, 2), the same in whichever order its two balls are."""
    return np.sort(pairs, axis=1) @ [balls, 1]
