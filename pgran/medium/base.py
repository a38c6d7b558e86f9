"""The interface of a vibrating medium, which solvers, records and figures ask.

And beneath it what all rooms share: the rounding of doubles, the unit of frequency, and checks that
numbers fit into doubles.
"""

import contextlib
import dataclasses
import math
from typing import NamedTuple

import numpy as np

from pgran.arguments import shown
from pgran.catalogue import record_kind
from pgran.errors import InputError, log
from pgran.run.numbers import Distinct, numbers
from pgran.store.estimate import counted
from pgran.store.record import Result, Shown

AXES = "xyz"
EPSILON = float(np.finfo(float).eps)
SMALLEST_NORMAL = float(np.finfo(float).tiny)  # a result below it may be lost
BETA = 0.003  # the paper's beta, of a lattice whose m and omega_mx are 1
# The powers of the units of force and of time that each number is in; a length has none.
DIMENSIONS = dict.fromkeys(
    ("stiffness", "tangential", "force", "push", "kmax", "damping_reference", "hertz"), (1, 0)
)
DIMENSIONS |= dict.fromkeys(("mass", "masses", "median_mass"), (1, 2))
DIMENSIONS |= {"damping": (1, 1), "drag": (0, -1)}
ALONG = "the direction in the file (drive), x, y, z, or components as 1,0,1"


class Elimination(NamedTuple):
    """How the matrices of a medium are factored best."""

    numbered: bool  # one rank numbers the unknowns in the order of elimination
    ordering: str  # PETSc's name of the order for S
    small: bool  # PETSc factors faster than MUMPS, whose solves are dearer, too
    quick: bool  # the order that MUMPS finds quickest is as good as any
    costly: bool  # a factorization takes longer than a search for some modes
    seconds: float  # that a factorization of S takes, as measured


class Medium(Shown, Distinct):
    """What vibrates: a `pgran.Lattice` or a `pgran.Network`, which answer the same questions."""

    is_grid = False  # of nearest neighbours, which can be cut into boxes

    @property
    def built(self):
        """The medium itself, which its record in a result knows by this name, too."""
        return self

    def as_result(self):
        """Return the medium as a result by itself."""
        record = record_of(self)
        return Result([record], scene=record.group)

    @property
    def has_overlaps(self):
        """Whether it knows how far contacts overlap: see `pgran.medium.overlaps`."""
        return (self.hertz if self.is_grid else self.overlap) is not None

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

    def drive_in_words(self):
        """Yield words for a drive other than a whole wall, and for missing walls."""
        if self.push is not None:
            yield f"driven by a force on {counted(np.count_nonzero(self.push_sizes), 'ball')}"
        elif self.is_grid and self.wall is not None:
            yield f"driven at {np.count_nonzero(self.wall)} of {self.wall.size} places of a wall"
        if self.is_grid and self.free:
            yield f"no wall at {', '.join(self.free)}"

    def along(self, direction, name):
        """Return a direction of length 1, that of the drive for `drive`; raise as `unit_vector`."""
        own = getattr(self, "direction", np.ones(1))
        if is_drive(direction):
            return own
        if len(own) == 1:
            raise InputError(f"-{name}: balls of this medium have one displacement")
        return unit_vector(f"-{name}", direction, len(own), "drive, ")

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
        return self._in_units(unit, 1.0), unit

    def in_own_time(self):
        """Return the same medium with its largest constant near its mass, and the unit of s.

        So powers of s have one size, where s itself is solved for, in any unit of time.
        """
        unit = 2.0 ** (math.frexp(einstein_frequency(self.axes, self.stiffest, self.mass))[1] - 1)
        return self._in_units(1.0, unit), unit

    def _in_units(self, force, frequency):
        """Return the same medium in units of force and frequency, powers of two."""
        values = {}
        for name in DIMENSIONS.keys() & {item.name for item in dataclasses.fields(self)}:
            value, (by_force, by_time) = getattr(self, name), DIMENSIONS[name]
            if isinstance(value, tuple):  # the constants of a lattice, an array for each axis
                values[name] = tuple(k / force for k in value)
            elif value is not None:
                values[name] = value / force**by_force * frequency**by_time
        return dataclasses.replace(self, **values)


def record_of(medium):
    """Return the record of a lattice or of another network."""
    return record_kind("lattice" if medium.is_grid else "network").of(medium)


def medium(value):
    """Return a medium that was handed in, as a result's record, too; raise InputError if none."""
    value = getattr(value, "built", value)
    if not isinstance(value, Medium):
        raise InputError(
            f"lattice: a pgran.Lattice or a pgran.Network is needed, not {shown(value)}"
        )
    return value


def closest(places, others):
    """Return the distance of each place (n, d) from the closest of others (m, d)."""
    away = np.asarray(places)[:, None] - others
    return np.sqrt(np.sum(away**2, axis=2)).min(axis=1)


def unit_vector(name, direction, axes, others=""):
    """Return a direction of length 1, given as an axis, components, a text of these; x for None.

    Raises InputError, which calls it by its `name` and says what `others` are possible, too.
    """
    if direction is None:
        return np.eye(axes)[0]
    if isinstance(direction, str):
        components = [float(direction == axis) for axis in AXES[:axes]]
        with contextlib.suppress(ValueError):
            components = [float(word) for word in direction.split(",")]
        if not any(components[axes:]):  # of a plane packing that its file has in space
            components = components[:axes]
    else:
        components = numbers(name, direction)
    size = np.linalg.norm(components)
    if np.shape(components) != (axes,) or not 0 < size < np.inf:
        possible = f"{others}{', '.join(AXES[:axes])}, or {axes} components"
        raise InputError(f"{name}: choose {possible}, not {shown(direction)}")
    return np.asarray(components) / size


def is_drive(direction):
    """Return whether a direction is that of the drive."""
    return isinstance(direction, str) and direction == "drive"


def einstein_frequency(axes, stiffness, mass):
    """Return sqrt(2 d k / m) of a ball that springs hold along d axes (paper: omxdef)."""
    return math.sqrt(2 * axes * stiffness / mass)


def check_size(name, value, positive=False):
    """Raise InputError unless a number is finite, and positive or not negative."""
    if not math.isfinite(value) or value < 0 or (positive and value == 0):
        least = "positive" if positive else "0 or more"
        raise InputError(f"{name}: must be {least} and finite, not {value}")


def check_magnitudes(medium):
    """Raise InputError where mass, damping and stiffness make no vibrations."""
    check_size("-bonds_kmax", medium.kmax)
    check_size("-lattice_mass", medium.mass, positive=True)
    check_size("-lattice_damping", medium.damping)
    if not math.isfinite(4 * medium.axes * max(medium.kmax, medium.stiffest) / medium.mass):
        raise InputError(
            "-lattice_mass, -bonds_kmax: frequencies are too large to compute with; use other units"
        )


def check_frequency(medium, omega):
    """Raise InputError unless the driven medium's numbers and their squares fit into doubles."""
    omega = float(omega)
    # no entry of S exceeds 4 d (k + omega beta) + m omega^2 up to the frequency
    springs = 4 * medium.axes * (medium.stiffest + omega * medium.damping)
    largest = springs + medium.mass * omega * omega
    if not math.isfinite(largest * largest):
        raise InputError(
            f"the frequency {omega:g} is too large to compute with; use a lower one, or other units"
        )


def warn_above_modes(medium, world, lowest):
    """Warn on rank 0 where no mode is above the lowest frequency, which is then often in Hz."""
    if world.rank == 0 and lowest > math.sqrt(medium.stiffness_norm / medium.mass):
        log.warning(
            "omega = %.6g, the lowest asked for, is above all modes (omega_mx is %.6g); "
            "frequencies are angular, omega = 2 pi f, but for sweeps with -sweep_unit Hz",
            lowest, medium.omega_mx,
        )  # fmt: skip
