"""One bond a step: which bond changes, and to what, and the network while it does.

At each step one bond, drawn uniformly, gets a new constant from the bond law. Both draws are a pure
function of (seed, trajectory, step), so the changes of the next steps are known ahead.
"""

from dataclasses import dataclass

import numpy as np

from pgran.physics.bondlaw import unit_numbers
from pgran.physics.lattice import bond_arrays, bond_count


@dataclass(frozen=True)
class Changes:
    """Which bonds change, and to what.

    Attributes
    ----------
    bond : numpy.ndarray of int, shape (n,)
        Numbers of bonds, axis after axis, each array in C order.
    stiffness : numpy.ndarray, shape (n,)
        Their new constants.
    """

    bond: np.ndarray
    stiffness: np.ndarray

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
        if len(self) >= count:
            return self
        more = (0, count - len(self))
        return Changes(
            *(np.pad(values, more, mode="edge") for values in (self.bond, self.stiffness))
        )


def draw_changes(law, shape, seed, trajectory, first, count, unit=1.0):
    """Return the changes of `count` steps from step `first` on, counted from 0.

    Not collective; the same on every rank.

    Parameters
    ----------
    law : callable
        Turns numbers uniform on [0, 1) into bond constants (`pgran.physics.bondlaw.BondLaw`).
    shape : sequence of int
        Balls along each axis.
    seed, trajectory, first, count : int
        Trajectories of one seed are independent.
    unit : float
        Of the constants returned.
    """
    u = unit_numbers(seed, 2 * first, 2 * count, generation=1 + trajectory)
    bonds = bond_count(shape)
    return Changes(np.minimum((u[::2] * bonds).astype(np.int64), bonds - 1), law(u[1::2]) / unit)


class Network:
    """The bonds of a lattice while they change, in an array and in its operators.

    Collective.

    Parameters
    ----------
    lattice : pgran.physics.lattice.Lattice
        Before any change.
    operators : pgran.solve.operators.Operators
    draw : callable
        Takes a trajectory, the first step and how many, and returns their Changes.
    """

    def __init__(self, lattice, operators, draw):
        """Start from the lattice's bonds."""
        self.shape, self.operators, self.draw = lattice.shape, operators, draw
        self.initial = np.concatenate([k.ravel() for k in lattice.stiffness])
        self.bonds = self.initial.copy()
        self.trajectory, self.step = 0, 0

    def move_to(self, trajectory, step):
        """Set all bonds to what they are before a step; the operators anew. Collective."""
        if trajectory != self.trajectory or step < self.step:
            self.bonds[:] = self.initial
            self.step = 0
        changes = self.draw(trajectory, self.step, step - self.step)
        self.bonds[changes.bond] = changes.stiffness
        self.trajectory, self.step = trajectory, step
        self.operators.set_stiffness(bond_arrays(self.shape, self.bonds))

    def differences(self, changes):
        """Return by how much each change moves its bond, repeated bonds included.

        Not collective.
        """
        before = self.bonds[changes.bond]
        order = np.argsort(changes.bond, kind="stable")
        again = changes.bond[order][1:] == changes.bond[order][:-1]
        before[order[1:][again]] = changes.stiffness[order[:-1][again]]
        return changes.stiffness - before

    def apply(self, changes):
        """Carry out the changes of the next steps. Collective."""
        self.bonds[changes.bond] = changes.stiffness  # of several of one bond the last holds
        self.operators.change_bonds(np.unique(changes.bond), self.bonds)
        self.step += len(changes)
