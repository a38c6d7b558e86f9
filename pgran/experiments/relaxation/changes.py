"""The bonds of a relaxation while they change, and their operators."""

import numpy as np


class ChangingBonds:
    """All bond constants before a step of a trajectory, their operators; `draw` gives Changes."""

    def __init__(self, lattice, operators, draw):
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

    def differences(self, changes, s):
        """Return how far each change moves kappa of its bond, which may repeat, at s."""
        before = self.constants[changes.bond]
        # Sorted by bond, stably: where a bond repeats, it starts from its change before.
        order = np.argsort(changes.bond, kind="stable")
        again = changes.bond[order][1:] == changes.bond[order][:-1]
        before[order[1:][again]] = changes.stiffness[order[:-1][again]]
        growth, lattice = changes.stiffness - before, self.operators.lattice
        return lattice.stiffer(growth, s, changes.bond, before)

    def apply(self, changes):
        """Carry out the changes of the next steps. Collective."""
        self.constants[changes.bond] = changes.stiffness  # of several of one bond the last holds
        self.operators.set_stiffness(self.constants, changes.bond)
        self.step += len(changes)
