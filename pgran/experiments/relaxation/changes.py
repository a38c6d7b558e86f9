"""One bond a step: which bond changes, and to what.

At each step one bond, drawn uniformly, gets a new constant from the bond law. Both draws are a pure
function of (seed, trajectory, step), so the changes of the next steps are known ahead.
"""

from dataclasses import dataclass

import numpy as np

from pgran.medium.law import unit_numbers


@dataclass(frozen=True)
class Changes:
    """Which bonds change, and to what."""

    bond: np.ndarray  # numbers of bonds, axis after axis, each array in C order
    stiffness: np.ndarray  # their new constants

    def __getitem__(self, part):
        """Return some of the changes."""
        return Changes(self.bond[part], self.stiffness[part])

    def __len__(self):
        """Return how many there are."""
        return len(self.bond)

    def extended(self, count):
        """Return at least `count` changes, the last one repeated, which changes nothing more.

        Not collective.
        """
        return self[np.minimum(np.arange(max(count, len(self))), len(self) - 1)]


def draw_changes(law, bonds, seed, trajectory, first, count, unit=1.0):
    """Return the changes of `count` steps from step `first` on, counted from 0.

    Not collective; the same on every rank.

    Parameters
    ----------
    law : callable
        Turns numbers uniform on [0, 1) into bond constants (`pgran.medium.law.BondLaw`).
    bonds : int
        How many there are.
    seed, trajectory, first, count : int
        Trajectories of one seed are independent.
    unit : float
        Of the constants returned.
    """
    u = unit_numbers(seed, 2 * first, 2 * count, generation=1 + trajectory)
    return Changes(np.minimum((u[::2] * bonds).astype(np.int64), bonds - 1), law(u[1::2]) / unit)
