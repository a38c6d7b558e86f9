"""The lattice of balls and springs: sites, bonds, walls and detectors, along 1 to 3 axes.

Balls sit at integer sites, zero-based. The walls sit one spacing outside; all are at rest but the
one behind the last ball of the first axis, which is driven. Bonds join nearest neighbours, and
every ball at a wall to that wall: `stiffness[axis]` is one longer than the lattice along `axis`,
and its entry `i` joins the balls `i - 1` and `i`. A side may be free: it has no wall, and the bonds
there, which keep their places in the arrays, do not exist. Instead of a wall's motion forces on
balls, a push, may drive.
"""

import hashlib
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pgran.arguments import called_right, shown, whole_number
from pgran.errors import InputError
from pgran.medium.base import Elimination, Medium
from pgran.medium.bonds import (
    AXES,
    SIGNS,
    ElasticBonds,
    balls_above,
    bond_arrays,
    bond_count,
    bond_ends,
    bond_shape,
    cut_sides,
)
from pgran.medium.dissection import dissected
from pgran.medium.law import BondLaw, unit_numbers
from pgran.medium.source import checked_drive, checked_sides, nearest
from pgran.medium.springs import Springs
from pgran.medium.units import BETA, check_magnitudes
from pgran.run.machine import check_memory
from pgran.run.numbers import number, numbers
from pgran.store.estimate import counted

# By axes, up to how many balls: one rank has the lattice; PETSc factors it faster than MUMPS; the
# order of minimum degree suits lattices better that are `LONG` times as long as wide, or more.
LARGE = {1: 10**7, 2: 100_000, 3: 20_000}
PETSC_FACTORS = {1: 10**7, 2: 200_000, 3: 8_000}
MINIMUM_DEGREE, LONG = {1: 10**7, 2: 2500, 3: 0}, 4
# Seconds of a factorization: the first times a power of the balls, that of nested dissection.
SECONDS = {1: (1.5e-6, 1.0), 2: (2.4e-8, 1.5), 3: (2.7e-9, 2.0)}


@called_right
@dataclass(frozen=True, eq=False)
class Lattice(ElasticBonds, Medium):
    """Balls of one mass, springs of individual stiffness, one damping constant.

    Lattices are equal if all of their numbers are.

    Parameters
    ----------
    stiffness : tuple of numpy.ndarray
        For each axis the bond constants, one longer than the lattice along that axis:
        (nx+1, ny) and (nx, ny+1) in two dimensions. Finite, not negative.
    mass : float
        m of a ball, positive.
    damping : float
        beta of every bond, not negative.
    damping_power : float
        p of dashpots beta (k / k_ref)^p.
    damping_reference : float, optional
        k_ref; by default the mean of all bonds.
    drag, loss : float
        alpha of each ball, eta of each bond: see `pgran.medium.dissipation`.
    kmax : float, optional
        The stiffness in omega_mx; by default the largest one.
    wall : array_like of float, shape (ny, ...), optional
        How far each place of the driven wall moves; by default 1.
    push : array_like of float, shape (nx, ny, ...), optional
        A force on each ball, which drives instead of the wall; the wall is then at rest.
    free : sequence of str
        Sides without a wall, such as `("y+",)`: the constants of bonds there become 0.

    Raises
    ------
    InputError
        If shapes or values are impossible.
    """

    stiffness: tuple
    mass: float = 1.0
    damping: float = BETA
    kmax: float | None = None
    wall: np.ndarray | None = None
    push: np.ndarray | None = None
    free: tuple = ()
    damping_power: float = 0.0
    damping_reference: float | None = None
    drag: float = 0.0
    loss: float = 0.0

    def __post_init__(self):
        stiffness = self.stiffness if isinstance(self.stiffness, (list, tuple)) else ()
        arrays = tuple(np.array(numbers("stiffness", k), order="C") for k in stiffness)
        if not 1 <= len(arrays) <= 3 or any(k.ndim != len(arrays) for k in arrays):
            raise InputError("stiffness: one array for each of 1 to 3 axes is needed")
        for name in ("mass", "damping", "drag", "loss"):
            object.__setattr__(self, name, number(f"lattice_{name}", getattr(self, name)))
        shape = tuple(n - (axis == 0) for axis, n in enumerate(arrays[0].shape))
        for axis, k in enumerate(arrays):
            name = f"stiffness_{AXES[axis]}"
            if k.shape != bond_shape(shape, axis) or min(shape) < 1:
                raise InputError(f"{name}: shape {k.shape} does not fit a lattice of {shape}")
            if not np.all(np.isfinite(k)) or np.any(k < 0):
                raise InputError(f"{name}: every bond constant must be finite and not negative")
        object.__setattr__(self, "free", checked_sides(self.free, len(arrays)))
        cut_sides(arrays, self.free)
        for k in arrays:
            k.flags.writeable = False
        object.__setattr__(self, "stiffness", arrays)
        for name, wanted in (("wall", shape[1:]), ("push", shape)):
            object.__setattr__(self, name, checked_drive(name, getattr(self, name), wanted))
        if self.wall is not None and self.push is not None:
            raise InputError("lattice: either a wall moves or a push drives, not both")
        kmax = self.stiffest if self.kmax is None else number("-bonds_kmax", self.kmax)
        object.__setattr__(self, "kmax", kmax)
        check_magnitudes(self.axes, self.mass, self.damping, self.stiffest, kmax)
        self._check_dissipation(self.constants[self.existing])

    def __repr__(self):
        return (
            f"Lattice({' x '.join(map(str, self.shape))}, mass={self.mass:g}, "
            f"{self.law_in_words}, omega_mx={self.omega_mx:.6g})"
        )

    @classmethod
    @called_right
    def random(
        cls, shape, seed=1993, law="uniform", *, mass=1.0, damping=BETA, free=(), gravity=0.0,
        damping_power=0.0, drag=0.0, loss=0.0, **parameters,
    ):  # fmt: skip
        """Return the lattice that the options of a run describe, the same on every rank.

        Parameters
        ----------
        shape : sequence of int
            Balls along each of 1 to 3 axes.
        seed : int
            Seed of the bond constants, 0 to 2^64 - 1.
        law : str or BondLaw
            The law of the bond constants; its kmax, where it has one, is the lattice's.
        mass, damping, damping_power, drag, loss : float
            m of a ball, beta of every bond, p, alpha and eta.
        free : sequence of str
            Sides without a wall.
        gravity : float
            Of the law hertz: by how much the mean force of contacts grows with each ball above,
            along the last axis.
        **parameters : float
            Of a law given by its name: kmin, kmax, fraction, force, hertz.

        Raises
        ------
        InputError
            If a value is impossible.
        """
        if not isinstance(law, BondLaw):
            law = BondLaw(law, **parameters)
        elif parameters:
            raise InputError(f"-bonds_law: this law has its parameters, and takes no {parameters}")
        shape = numbers("-lattice_shape", shape, whole=True)
        seed = whole_number("-bonds_seed", seed)
        if shape.ndim != 1 or not 1 <= len(shape) <= 3 or min(shape) < 1:
            raise InputError(f"-lattice_shape: 1 to 3 positive numbers are needed, not {shape}")
        shape = tuple(shape.tolist())
        if not 0 <= seed < 2**64:
            raise InputError(f"-bonds_seed: must lie between 0 and 2^64 - 1, not {shown(seed)}")
        check_memory("lattice_shape", 150 * bond_count(shape))  # with the least of matrices
        bonds = bond_arrays(shape, law(unit_numbers(seed, 0, bond_count(shape))))
        if gravity:
            above = balls_above(shape)
            bonds = tuple(k * law.deeper(gravity, n) for k, n in zip(bonds, above, strict=True))
        dissipation = {"damping_power": damping_power, "drag": drag, "loss": loss}
        return cls(bonds, mass, damping, law.kmax, free=free, **dissipation)

    @property
    def shape(self):
        """Balls along each axis."""
        first = self.stiffness[0].shape
        return (first[0] - 1, *first[1:])

    @property
    def axes(self):
        """How many axes the lattice has."""
        return len(self.stiffness)

    @property
    def size(self):
        """How many balls there are."""
        return math.prod(self.shape)

    is_grid = True
    components = 1  # unknowns of a ball
    inertia_ratio = 1.0  # the unit of mass over that of each ball

    @property
    def isotropic(self):
        """Whether the dashpots make the graph's Laplacian."""
        return not self.damping_power

    @property
    def is_large(self):
        """Whether all ranks should share it."""
        return self.size > LARGE[self.axes]

    @cached_property
    def elimination(self):
        """See `Elimination`."""
        is_long = self.axes == 1 or max(self.shape) > LONG * min(self.shape)
        by_degree = is_long and self.size <= MINIMUM_DEGREE[self.axes]
        constant, power = SECONDS[self.axes]
        seconds = 3e-4 + constant * self.size**power
        small = self.size <= PETSC_FACTORS[self.axes]
        ordering = "qmd" if by_degree else "natural"
        return Elimination(not by_degree, ordering, small, False, False, seconds)

    @property
    def order(self):
        """The balls in the order of elimination."""
        return dissected(self.shape)

    @property
    def nonzeros(self):
        """How many nonzeros a row for each ball has in all, walls counted."""
        return (2 * self.axes + 1) * self.size

    @property
    def pushed(self):
        """The push as a force on each unknown, None unless one drives."""
        return self.push

    def pushed_by(self, forces):
        """Return as a change what a push on each ball, shape (balls,), makes of the lattice."""
        return {"push": forces.reshape(self.shape), "wall": None}

    @property
    def constants(self):
        """The constants of all bonds, axis after axis, each array in C order."""
        return np.concatenate([k.ravel() for k in self.stiffness])

    @cached_property
    def springs(self):
        """See `springs.Springs`."""
        ends = bond_ends(np.arange(self.size).reshape(self.shape))
        ends[self.shares == 0] = -1
        constants = self.constants
        return Springs(
            self.size, ("normal",), ends, SIGNS[None], self.drive, self.drive, constants,
            constants, self.shares, self.damped_springs, np.full(self.bonds, self.loss),
        )  # fmt: skip

    @property
    def stiffest(self):
        """The largest bond constant."""
        return max(float(k.max()) for k in self.stiffness)

    @property
    def bonds(self):
        """How many bonds there are, wall bonds included."""
        return bond_count(self.shape)

    def check_driven(self):
        """Raise InputError if nothing is driven, or if no side has a wall."""
        if self.least_damping == 0 and not self.drag:
            raise InputError("-lattice_free: without any wall the lattice floats; leave one")
        if self.push is None and not np.any(self.moved):
            raise InputError(
                "-lattice_free: x+ is the wall that drives; keep it, or let -drive_balls drive"
            )

    def sites(self, detectors, name="-detectors"):
        """Return ball indices, flat (`8, 10, 3, 4`) or one row a detector, as an array (nd, dim).

        Raises InputError, which calls them by their `name`, if an index is missing or a ball lies
        outside.
        """
        shape, axes = self.shape, self.axes
        indices = numbers(name, detectors, whole=True)
        misshapen = indices.ndim > 1 and indices.shape[1:] != (axes,)
        if indices.size == 0 or indices.size % axes or misshapen:
            rows = f" in {len(indices)} rows" if indices.ndim > 1 else ""
            there = counted(indices.size, "number") + rows
            each = f"{axes} {'index' if axes == 1 else 'indices'}"
            raise InputError(f"{name}: needs {each} for each ball of this lattice, not {there}")
        sites = indices.reshape(-1, axes)
        outside = sites[np.any((sites < 0) | (sites >= shape), axis=1)]
        if len(outside):
            raise InputError(
                f"{name}: ball {tuple(outside[0].tolist())} is outside the lattice of "
                f"{' x '.join(map(str, shape))} balls (indices count from 0)"
            )
        return sites

    def readings(self, sites):
        """Return unknowns that detectors read and their weights, (nd, 1)."""
        return self.numbers_of(np.asarray(sites))[:, None], np.ones((len(sites), 1))

    def depths(self, sites):
        """Return distances of balls from the nearest that drives, in spacings, (nd,)."""
        if self.wall is None and self.push is None:
            return self.shape[0] - sites[:, 0]
        if self.push is not None:
            driving = np.argwhere(self.push)
        else:
            driving = np.insert(np.argwhere(self.moved), 0, self.shape[0], axis=1)
        return nearest(sites, driving)

    def displacements(self, field):
        """Return an array of unknowns as displacements, which they are here."""
        return field

    @property
    def ball_numbers(self):
        """The numbers of all balls, in C order."""
        return np.arange(self.size)

    def numbers_of(self, sites):
        """Return the numbers of balls given by their indices, (count, dim)."""
        return np.ravel_multi_index(sites.T, self.shape)

    @cached_property
    def bonds_sha256(self):
        """Checksum of all bond constants, as little-endian doubles, axis after axis."""
        return hashlib.sha256(self.constants.astype("<f8", copy=False)).hexdigest()
