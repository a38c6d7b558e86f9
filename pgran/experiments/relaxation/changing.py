"""The bonds of a lattice while they change, step by step."""

import numpy as np


class ChangingBonds:
    """All bond constants as an array, and the operators that follow them.

    Parameters
    ----------
    lattice : pgran.medium.lattice.Lattice
        Before any change.
    operators : pgran.driven.operators.Operators
    draw : callable
        Takes a trajectory, the first step and how many, and returns their Changes.

    Attributes
    ----------
    constants : numpy.ndarray, shape (bonds,)
        Before step `step` of trajectory `trajectory`.
    """

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
        """Return how far each change moves its bond, which may repeat. Not collective."""
        before = self.constants[changes.bond]
        order = np.argsort(changes.bond, kind="stable")
        again = changes.bond[order][1:] == changes.bond[order][:-1]
        before[order[1:][again]] = changes.stiffness[order[:-1][again]]
        return changes.stiffness - before

    def apply(self, changes):
        """Carry out the changes of the next steps. Collective."""
        self.constants[changes.bond] = changes.stiffness  # of several of one bond the last holds
        self.operators.change_bonds(changes.bond, self.constants)
        self.step += len(changes)
