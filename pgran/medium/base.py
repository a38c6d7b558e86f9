"""What lattices and other networks have in common, whatever asks them."""

import dataclasses
import math
from typing import NamedTuple

import numpy as np

from pgran.arguments import shown
from pgran.errors import InputError
from pgran.medium.dissipation import Dissipation
from pgran.medium.units import einstein_frequency
from pgran.run.numbers import Distinct

# what the unit of stiffness, mass and damping changes
SCALED = (
    "stiffness", "mass", "masses", "damping", "force", "tangential", "push", "kmax", "median_mass",
    "damping_reference",
)  # fmt: skip


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

    def per_ball(self, squares):
        """Return sums over the components of each free ball, shape (n, balls)."""
        return squares.reshape(len(squares), self.free_balls, self.components).sum(axis=2)

    def in_own_unit(self):
        """Return the same medium with its largest constant between 1 and 2, and the unit.

        Stiffness, mass and damping lose the same factor, so amplitudes and frequencies stay as they
        are; it is a power of two, which rounds nothing but bonds 1e-308 times softer than the
        stiffest. PETSc and SLEPc take small pivots for zero by absolute thresholds, and squares of
        small numbers vanish. Raises InputError if mass or damping do not fit into doubles in that
        unit.
        """
        unit = 2.0 ** (math.frexp(self.stiffest)[1] - 1)
        for name, value in (("mass", self.mass), ("damping", self.damping)):
            if value / unit * unit != value:
                far = f"{value:g} and bond constants of about {unit:g} are too far apart"
                raise InputError(f"-lattice_{name}: {far}")
        names = [item.name for item in dataclasses.fields(self) if item.name in SCALED]
        values = {name: getattr(self, name) for name in names}
        for name, value in values.items():
            if value is not None:  # a lattice has an array of constants for each axis
                each = isinstance(value, tuple)
                values[name] = tuple(k / unit for k in value) if each else value / unit
        return dataclasses.replace(self, **values), unit

    def in_own_time(self):
        """Return the same medium with its largest constant near its mass, and the unit of s.

        For what solves for s itself: powers of s have one size then, whatever time is measured in.
        """
        unit = 2.0 ** (math.frexp(einstein_frequency(self.axes, self.stiffest, self.mass))[1] - 1)
        powers = {"mass": 2, "masses": 2, "median_mass": 2, "damping": 1, "drag": -1}
        names = [item.name for item in dataclasses.fields(self) if item.name in powers]
        there = {name: getattr(self, name) for name in names if getattr(self, name) is not None}
        values = {name: value * unit ** powers[name] for name, value in there.items()}
        return dataclasses.replace(self, **values), unit


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
