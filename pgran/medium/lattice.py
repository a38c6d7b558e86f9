"""The lattice of balls and springs: sites, bonds, walls and detectors, along 1 to 3 axes.

Balls sit at integer sites, zero-based. The walls sit one spacing outside; all are at rest but the
one behind the last ball of the first axis, which is driven. Bonds join nearest neighbours, and
every ball at a wall to that wall: along an axis there is one bond more than balls, and bond `i`
joins the balls `i - 1` and `i`. They are numbered axis after axis, each array in C order. A side
may be free: it has no wall, and the bonds there, which keep their places in the arrays, do not
exist. Instead of a wall's motion forces on balls, a push, may drive.
"""

import dataclasses
import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from pgran.arguments import called_right, choice, shown, whole_number
from pgran.errors import InputError
from pgran.medium.base import AXES, BETA, EPSILON, Elimination, check_magnitudes, closest
from pgran.medium.bonds import (
    SIGNS,
    balls_above,
    bond_arrays,
    bond_count,
    bond_ends,
    bond_shape,
    bond_sides,
    cut_sides,
    dissected,
)
from pgran.medium.law import HERTZ, BondLaw, check_law, deeper, drawn, unit_numbers
from pgran.medium.springs import Elastic, Springs
from pgran.run.machine import check_memory
from pgran.run.numbers import number, numbers
from pgran.store.estimate import counted

# By axes, up to how many balls: one rank has the lattice; PETSc factors it faster than MUMPS; the
# order of minimum degree suits lattices better that are `ELONGATED` times as long as wide, or more.
SHARED_ABOVE = {1: 10**7, 2: 100_000, 3: 20_000}
PETSC_FACTORS = {1: 10**7, 2: 200_000, 3: 8_000}
MINIMUM_DEGREE, ELONGATED = {1: 10**7, 2: 2500, 3: 0}, 4
# Seconds of a factorization: the first times a power of the balls, that of nested dissection.
SECONDS = {1: (1.5e-6, 1.0), 2: (8e-9, 1.5), 3: (7e-10, 2.0)}


@called_right
@dataclass(frozen=True, eq=False)
class Lattice(Elastic):
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
    hertz : float, optional
        c of Hertz's law F = c h^(3/2), which says how far contacts overlap.
    kmax : float, optional
        The stiffness in omega_mx; by default the largest one.
    wall : array_like of float, shape (ny, ...), optional
        How far each place of the driven wall moves; by default 1.
    push : array_like of float, shape (nx, ny, ...), optional
        A force on each ball, which drives instead of the wall; the wall is then at rest.
    free : sequence of str
        Sides without a wall, such as `("y+",)`: the constants of bonds there become 0.

    Attributes
    ----------
    shape, axes, size, bonds
        Balls along each axis, how many axes, balls and bonds, wall bonds included, there are.
    constants, exists : numpy.ndarray, shape (bonds,)
        Constants of all bonds, axis after axis, each array in C order; 1, or 0 at free sides.
    wall_motion : numpy.ndarray, shape (ny, ...)
        How far each place of the driven wall moves.

    Raises
    ------
    InputError
        If shapes or values are impossible.

    Examples
    --------
    >>> import pgran
    >>> lattice = pgran.Lattice.random((6, 5), seed=1)
    >>> [k.shape for k in lattice.stiffness]
    [(7, 5), (6, 6)]
    >>> pgran.Lattice(lattice.stiffness, kmax=lattice.kmax) == lattice
    True
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
    hertz: float | None = None

    is_grid = True
    components = 1  # unknowns of a ball
    inertia_ratio = 1.0  # the unit of mass over that of each ball
    row_norms = math.sqrt(2), 0.0  # |b|_2 of a bond, what rounding adds to a difference

    def __post_init__(self):
        own = vars(self)  # which is not frozen
        arrays = _checked_arrays(self.stiffness)
        own["axes"], own["shape"] = len(arrays), (len(arrays[0]) - 1, *arrays[0].shape[1:])
        own["size"], own["bonds"] = math.prod(self.shape), bond_count(self.shape)
        own["free"] = _checked_sides(self.free, self.axes)
        own["exists"] = np.ones(self.bonds)
        cut_sides(self.blocks(self.exists), self.free)
        own["constants"] = self.exists * np.concatenate([k.ravel() for k in arrays])
        self.exists.flags.writeable = self.constants.flags.writeable = False
        own["stiffness"], own["stiffest"] = self.blocks(self.constants), float(self.constants.max())
        for name in ("mass", "damping", "drag", "loss"):
            own[name] = number(f"lattice_{name}", getattr(self, name))
        own["kmax"] = number("-bonds_kmax", self.stiffest if self.kmax is None else self.kmax)
        own["hertz"] = None if self.hertz is None else HERTZ.check(self.hertz)

        own["wall"] = _checked_drive("wall", self.wall, self.shape[1:])
        own["push"] = own["pushed"] = _checked_drive("push", self.push, self.shape)
        if self.wall is not None and self.push is not None:
            raise InputError("lattice: either a wall moves or a push drives, not both")
        wall = np.ones(self.shape[1:]) if self.wall is None else self.wall
        at_rest = self.push is not None or "x+" in self.free
        own["wall_motion"] = 0.0 * wall if at_rest else wall
        own["drive"] = np.zeros(self.bonds)
        self.blocks(self.drive)[0][-1] = self.wall_motion

        check_magnitudes(self)
        self._check_dissipation(self.constants[self.existing])
        own["damped_springs"] = self.exists
        if self.damping_power:
            own["damped_springs"] = self.exists * self.dashpot_law(self.constants)
        own["losses"] = self.loss * self.constants if self.loss else None
        own["drags"] = np.full(self.size, self.drag) if self.drag else None

    def __repr__(self):
        return (
            f"Lattice({' x '.join(map(str, self.shape))}, mass={self.mass:g}, "
            f"{self.law_in_words}, omega_mx={self.omega_mx:.6g})"
        )

    @classmethod
    @called_right
    def random(
        cls, shape: "ArrayLike", seed: int = 1993, law: str | Callable = "uniform", *,
        mass: float = 1.0, damping: float = BETA, free: tuple = (), gravity: float = 0.0,
        damping_power: float = 0.0, drag: float = 0.0, loss: float = 0.0,
        hertz: float | None = None, **parameters: float,
    ) -> "Lattice":  # fmt: skip
        """Return the lattice that the options of a run describe, the same on every rank.

        Parameters
        ----------
        shape : sequence of int
            Balls along each of 1 to 3 axes.
        seed : int
            Seed of the bond constants, 0 to 2^64 - 1.
        law : str or callable
            A name, a `BondLaw`, or as `relax` takes it; its `kmax`, if any, is the lattice's.
        mass, damping, damping_power, drag, loss : float
            m of a ball, beta of every bond, p, alpha and eta.
        free : sequence of str
            Sides without a wall.
        gravity : float
            Of the law hertz: by how much the mean force of contacts grows with each ball above,
            along the last axis.
        hertz : float, optional
            c of F = c h^(3/2), of the law hertz or of contacts by any other.
        **parameters : float
            Of a law given by its name: kmin, kmax, fraction, force.

        Raises
        ------
        InputError
            If a value is impossible.

        Examples
        --------
        >>> import pgran
        >>> pgran.Lattice.random((6, 5), law="bimodal", fraction=0.8)
        Lattice(6 x 5, mass=1, beta 0.003, omega_mx=1)
        """
        if not callable(law):
            own = {"hertz": hertz} if law == "hertz" else {}
            law = BondLaw(law, **parameters | own)
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
        bonds = bond_arrays(shape, drawn(check_law(law), unit_numbers(seed, 0, bond_count(shape))))
        if gravity:
            above = balls_above(shape)
            bonds = tuple(k * deeper(law, gravity, n) for k, n in zip(bonds, above, strict=True))
        if isinstance(law, BondLaw):
            hertz = law.parameters.get("hertz", hertz)
        facts = {"damping_power": damping_power, "drag": drag, "loss": loss, "hertz": hertz}
        return cls(bonds, mass, damping, getattr(law, "kmax", None), free=free, **facts)

    @cached_property
    def bonds_sha256(self):
        """Checksum of all bond constants, as little-endian doubles, axis after axis."""
        return hashlib.sha256(self.constants.astype("<f8", copy=False)).hexdigest()

    def with_constants(self, constants):
        """Return the lattice with other constants of all bonds."""
        return dataclasses.replace(self, stiffness=bond_arrays(self.shape, constants))

    # What damps.

    @property
    def isotropic(self):
        """Whether the dashpots make the graph's Laplacian."""
        return not self.damping_power

    @cached_property
    def least_damping(self):
        """The smallest eigenvalue of C, the Laplacian of the uniform lattice with its walls.

        Along an axis of n balls the lowest mode is a half wave between walls n + 1 apart, a quarter
        of one where a side is free, and a constant where both are.
        """
        total = 0.0
        for axis, n in enumerate(self.shape):
            walls = 2 - sum(side[0] == AXES[axis] for side in self.free)
            length = {2: n + 1, 1: 2 * n + 1}.get(walls)
            total += 4 * math.sin(math.pi / (2 * length)) ** 2 if length else 0.0
        return total

    @cached_property
    def existing(self):
        """The numbers of the bonds that exist: all but those at free sides."""
        return np.flatnonzero(self.exists)

    # What drives.

    def pushed_by(self, forces):
        """Return the fields of the lattice under a push on each ball, shape (balls,)."""
        return {"push": forces.reshape(self.shape), "wall": None}

    def check_driven(self):
        """Raise InputError if nothing is driven, or if no side has a wall."""
        if self.least_damping == 0 and not self.drag:
            raise InputError("-lattice_free: without any wall the lattice floats; leave one")
        if self.push is None and not np.any(self.wall_motion):
            raise InputError(
                "-lattice_free: x+ is the wall that drives; keep it, or let -drive_balls drive"
            )

    # B and its adjoint, which `Elastic` asks for, and how large sums over springs are.

    def blocks(self, values):
        """Return numbers of all bonds as one array for each axis."""
        return bond_arrays(self.shape, values)

    def stretch(self, fields):
        """Yield B x for the bonds along each axis, walls at rest."""
        for axis in range(-self.axes, 0):
            below, above = bond_sides(fields, axis, 0.0)
            yield above - below

    def spread(self, tensions):
        """Return B^T t, the sum of the tensions of each ball's bonds, arrays as of `stretch`."""
        total = 0.0
        for axis, t in enumerate(tensions, -self.axes):
            total -= np.diff(t, axis=axis)  # the bond below a ball counts +, as in B
        return total

    @cached_property
    def springs(self):
        """See `springs.Springs`."""
        ends = bond_ends(np.arange(self.size).reshape(self.shape))
        ends[self.exists == 0] = -1
        constants = self.constants
        return Springs(
            self.size, ("normal",), ends, SIGNS[None], self.drive, self.drive, self.drive,
            constants, constants, self.exists, self.damped_springs, np.full(self.bonds, self.loss),
        )  # fmt: skip

    @property
    def dashpot_norm(self):
        """No less than |B^T diag(d) B|_2."""
        return 4 * self.axes * (self.damped_springs.max() if self.damping_power else 1)

    @property
    def stiffness_norm(self):
        """No less than |K|_2: |K|_inf, twice its largest diagonal entry, the sum of its bonds."""
        diagonal = 0.0
        for axis, k in enumerate(self.stiffness):
            diagonal = diagonal + (np.delete(k, 0, axis) + np.delete(k, -1, axis))
        return 2 * float(np.max(diagonal))

    @property
    def rounding(self):
        """The u for which rounding moves a ball's residual by at most u (|f| + |S| |x|).

        Each operation adds at most h = EPSILON / 2 of the sum of all magnitudes, a product of
        complex numbers sqrt(5) h (Brent, Percival, Zimmermann 2007). From the constants to f - S x

        - 2d - 1 sums of bonds make K_pp, two more add s C and s^2 m, or a product (s beta), one
          with C_pp and two sums, or two products (m s^2) and a sum: 2d + 3 hold all three;
        - a complex product, 2d sums in the row and the difference from f: less than 2d + 4.

        So 4d + 7, and one more for what is of second order and for evaluating the bound. A residual
        K x - lambda x, stretch by stretch, has fewer: two differences, three products and d sums.
        """
        return (2 * self.axes + 4) * EPSILON

    # How it is eliminated.

    @property
    def is_large(self):
        """Whether all ranks should share it."""
        return self.size > SHARED_ABOVE[self.axes]

    @cached_property
    def elimination(self):
        """See `Elimination`."""
        is_long = self.axes == 1 or max(self.shape) > ELONGATED * min(self.shape)
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

    # Where balls and bonds are.

    def sites(self, detectors, name="-detectors"):
        """Return ball indices, flat (`8, 10, 3, 4`) or one row a detector, as an array (nd, dim).

        Raises InputError, which calls them by their `name`, unless all are in the lattice.
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
            driving = np.insert(np.argwhere(self.wall_motion), 0, self.shape[0], axis=1)
        return closest(sites, driving)

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

    def bond_places(self, bonds):
        """Return the axis of each numbered bond, and its index (..., dim) in that axis's array."""
        shapes = [bond_shape(self.shape, axis) for axis in range(self.axes)]
        axis = np.repeat(np.arange(self.axes), [math.prod(shape) for shape in shapes])
        index = [np.indices(shape).reshape(self.axes, -1).T for shape in shapes]
        return axis[bonds], np.concatenate(index)[bonds]


def _checked_arrays(stiffness):
    """Return constants as an array for each axis; raise InputError unless they fit a lattice."""
    stiffness = stiffness if isinstance(stiffness, (list, tuple)) else ()
    arrays = [numbers("stiffness", k) for k in stiffness]
    if not 1 <= len(arrays) <= 3 or any(k.ndim != len(arrays) for k in arrays):
        raise InputError("stiffness: one array for each of 1 to 3 axes is needed")
    shape = (len(arrays[0]) - 1, *arrays[0].shape[1:])
    for axis, k in enumerate(arrays):
        name = f"stiffness_{AXES[axis]}"
        if k.shape != bond_shape(shape, axis) or min(shape) < 1:
            raise InputError(f"{name}: shape {k.shape} does not fit a lattice of {shape}")
        if not np.all(np.isfinite(k)) or np.any(k < 0):
            raise InputError(f"{name}: every bond constant must be finite and not negative")
    return arrays


def _checked_sides(sides, axes):
    """Return sides such as `y+`, in order; raise InputError if a lattice has none of that name."""
    sides = tuple(sides.split(",")) if isinstance(sides, str) else tuple(sides)
    possible = [f"{axis}{end}" for axis in AXES[:axes] for end in "-+"]
    for side in sides:
        choice("-lattice_free", side, possible)
    return tuple(side for side in possible if side in sides)


def _checked_drive(name, value, shape):
    """Return motions or forces that drive, as a copy that nobody can change, or None."""
    if value is None:
        return None
    array = np.array(numbers(f"lattice: {name}", value))
    if array.shape != shape or not np.all(np.isfinite(array)) or not np.any(array):
        raise InputError(
            f"lattice: {name}: finite numbers of the shape {shape} are needed, not all zero"
        )
    array.flags.writeable = False
    return array
