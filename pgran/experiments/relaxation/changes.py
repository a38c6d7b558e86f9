"""Changes of bonds: at each step one, drawn uniformly, gets a new constant from the bond law.

Both draws are a pure function of (seed, trajectory, step): the next changes are known ahead.
"""

from dataclasses import dataclass

import numpy as np

from pgran.medium.law import unit_numbers


@dataclass(frozen=True)
class Changes:
    """Which bonds change, and to what."""

    bond: np.ndarray  # numbers of bonds, axis after axis, each array in C order
    stiffness: np.ndarray  # their new constants

    def __getitem__(self, steps):
        """Return some of the changes."""
        return Changes(self.bond[steps], self.stiffness[steps])

    def __len__(self):
        """Return how many there are."""
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


class ChangingBonds:
    """All bond constants before a step of a trajectory, their operators; `draw` gives Changes."""

    def __init__(self, lattice, operators, draw):
        """Start from the lattice's bonds."""
        self.operators, self.draw = operators, draw
        self.initial = lattice.constants
        self.constants = self.initial.copy()
        self.trajectory, self.step = 0, 0

    def move_to(self, trajectory, step):
        """Set all bonds to what they are before a step; the operators anew. Collective."""
        if trajectory != self.trajectory or step < self.step:
            self.constants[:] = self.initial
            self.step = 0
        changes = self.draw(trajectory, self.step, step - self.step)
        self.constants[changes.bond] = changes.stiffness
        self.trajectory, self.step = trajectory, step
        self.operators.set_stiffness(self.constants)

    def differences(self, changes):
        """Return how far each change moves its bond, which may repeat."""
        before = self.constants[changes.bond]
        # Sorted by bond, stably: where a bond repeats, it starts from its change before.
        order = np.argsort(changes.bond, kind="stable")
        again = changes.bond[order][1:] == changes.bond[order][:-1]
        before[order[1:][again]] = changes.stiffness[order[:-1][again]]
        return changes.stiffness - before

    def apply(self, changes):
        """Carry out the changes of the next steps. Collective."""
        self.constants[changes.bond] = changes.stiffness  # of several of one bond the last holds
        self.operators.set_stiffness(self.constants, changes.bond)
        self.step += len(changes)
