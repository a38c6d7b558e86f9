"""Bonds redrawn: at each step one, drawn uniformly, gets a new constant from the bond law.

Both draws are a pure function of (seed, trajectory, step): the next changes are known ahead.
"""

import dataclasses
import logging
from dataclasses import dataclass
from functools import partial

import numpy as np

from pgran.arguments import called_right
from pgran.medium.base import medium as medium_of
from pgran.medium.bonds import bond_arrays
from pgran.medium.law import check_law, drawn, unit_numbers
from pgran.run.options import INTEGER, Option

log = logging.getLogger("pgran")

REDRAWN = (
    Option(
        "bonds_redrawn", INTEGER, 0,
        "how many steps of a relaxation come before: each redraws a bond by the law, or a contact "
        "of a network from all of its constants", low=0, high=10**7
    ),
    Option(
        "bonds_redrawn_seed", INTEGER, 1, "seed of these changes, like -relax_seed",
        low=0, high=2**63 - 1
    ),
)  # fmt: skip
STEPS, SEED = REDRAWN


@dataclass(frozen=True)
class Changes:
    """Which bonds change, and to what."""

    bond: np.ndarray  # numbers of bonds, axis after axis, each array in C order
    stiffness: np.ndarray  # their new constants

    def __getitem__(self, steps):
        return Changes(self.bond[steps], self.stiffness[steps])

    def __len__(self):
        return len(self.bond)

    def extended(self, count):
        """Return at least `count` changes, the last one repeated, which changes nothing more."""
        return self[np.minimum(np.arange(max(count, len(self))), len(self) - 1)]


def draw_changes(law, bonds, seed, trajectory, first, count, unit=1.0):
    """Return the changes of `count` steps from step `first` on, counted from 0, in a unit.

    Trajectories of one seed are independent. `law` turns numbers uniform on [0, 1) into constants.
    """
    # two numbers a step: u[0] u[1] | u[2] u[3] | ...  say  bond, constant | bond, constant | ...
    u = unit_numbers(seed, 2 * first, 2 * count, generation=1 + trajectory)
    return Changes(np.minimum((u[::2] * bonds).astype(np.int64), bonds - 1), law(u[1::2]) / unit)


class Redraw:
    """The changes of a medium's bonds, by a law; None draws from the constants that it has."""

    def __init__(self, medium, law, seed):
        self.bonds, self.seed = medium.existing, seed
        constants = medium.constants[self.bonds]

        def own(u):
            return constants[(u * len(constants)).astype(np.int64)]

        self.law = own if law is None else partial(drawn, law)

    def __call__(self, trajectory, first, count, unit=1.0):
        """Return the changes of some steps, constants in a unit; see `draw_changes`."""
        drawn = draw_changes(self.law, len(self.bonds), self.seed, trajectory, first, count, unit)
        return dataclasses.replace(drawn, bond=self.bonds[drawn.bond])


@called_right
def redrawn(medium, steps, seed=1, law=None):
    """Return a medium after so many steps of the first trajectory of `relax`.

    Parameters
    ----------
    medium : pgran.Lattice or pgran.Network
    steps : int
        Each redraws one bond; other bonds, and omega_mx, stay.
    seed : int
        Seed of the changes, as of `relax`.
    law : callable, optional
        As of `relax`: None draws from the constants that the medium has.

    Returns
    -------
    pgran.Lattice or pgran.Network

    Raises
    ------
    InputError
        If the steps or the law are impossible.
    """
    medium = medium_of(medium)
    changes = Redraw(medium, check_law(law), SEED.check(seed))(0, 0, STEPS.check(steps))
    constants = medium.constants.copy()
    constants[changes.bond] = changes.stiffness  # of several of one bond the last holds
    if len(changes) and np.array_equal(constants, medium.constants):
        log.warning("-bonds_redrawn %d: each bond has its old constant again", len(changes))
    return with_constants(medium, constants)


def with_constants(medium, constants):
    """Return a medium of other constants; the tangential springs of a network stay."""
    if medium.is_grid:
        return dataclasses.replace(medium, stiffness=bond_arrays(medium.shape, constants))
    changed = dataclasses.replace(medium, stiffness=constants[: medium.bonds])
    vars(changed)["graph"] = medium.graph  # who touches whom is the same
    return changed
