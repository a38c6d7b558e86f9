"""What lattices and other networks have in common, whatever asks them."""

from typing import NamedTuple

import numpy as np

from pgran.arguments import shown
from pgran.errors import InputError
from pgran.medium.dissipation import Dissipation
from pgran.medium.units import einstein_frequency
from pgran.run.numbers import Distinct


class Medium(Dissipation, Distinct):
    """What vibrates: a `pgran.Lattice` or a `pgran.Network`, which answer the same questions."""

    is_grid = False  # of nearest neighbours, which can be cut into boxes

    @property
    def built(self):
        """The medium itself, which its record in a result knows by this name, too."""
        return self

    @property
    def free_balls(self):
        """How many balls are free."""
        return self.size // self.components

    @property
    def omega_mx(self):
        """The unit of frequency, angular: see `einstein_frequency`."""
        return einstein_frequency(self.axes, abs(self.kmax), self.mass)

    def reading_norms(self, sites):
        """Return |e_d| of each detector, shape (nd,)."""
        return np.linalg.norm(self.readings(sites)[1], axis=1)

    @property
    def push_sizes(self):
        """The size of the push on each ball, shape (balls,)."""
        return np.linalg.norm(self.push.reshape(-1, 1 if self.is_grid else self.axes), axis=1)

    @property
    def drive_size(self):
        """What amplitudes are compared with: 1 of a wall's motion, F / kmax of a force F."""
        return 1.0 if self.push is None else float(self.push_sizes.sum() / abs(self.kmax))

    def pull(self, s):
        """Return the force that moves what is driven by 1 while all balls stay.

        It is the sum of kappa(s) w^2 over the springs, which that stretches by w.
        """
        stiffness, damping = self.pulls
        return stiffness + s * damping


class Elimination(NamedTuple):
    """How the matrices of a medium are factored best."""

    numbered: bool  # one rank numbers the unknowns in the order of elimination
    ordering: str  # PETSc's name of the order for S
    small: bool  # PETSc factors faster than MUMPS, whose solves are dearer, too
    quick: bool  # the order that MUMPS finds quickest is as good as any
    costly: bool  # a factorization takes longer than a search for some modes
    seconds: float  # that a factorization of S takes, as measured


def medium(value):
    """Return a medium that was handed in, as a result's record, too; raise InputError if none."""
    value = getattr(value, "built", value)
    if not isinstance(value, Medium):
        raise InputError(
            f"lattice: a pgran.Lattice or a pgran.Network is needed, not {shown(value)}"
        )
    return value
