"""The bonds of a lattice: which balls they join, how they are stretched, and what follows from it.

Bonds join nearest neighbours, and every ball at a wall to that wall: along an axis there is one
bond more than balls, and bond `i` joins the balls `i - 1` and `i`. They are numbered axis after
axis, each array in C order.
"""

import math
from functools import cached_property

import numpy as np

from pgran.medium.rounding import EPSILON, residual_rounding

AXES = "xyz"
SIGNS = np.array([-1.0, 1.0])  # in a row of B, of the ball below a bond and of that above


def bond_shape(shape, axis):
    """Return the shape of the array of bonds along an axis."""
    return tuple(n + (a == axis) for a, n in enumerate(shape))


def _bond_counts(shape):
    """Return the number of bonds along each axis."""
    return [math.prod(bond_shape(shape, axis)) for axis in range(len(shape))]


def bond_count(shape):
    """Return the number of bonds, wall bonds included."""
    return sum(_bond_counts(shape))


def bond_arrays(shape, bonds):
    """Return numbers a bond, in order, as one array for each axis."""
    parts = np.split(bonds, np.cumsum(_bond_counts(shape))[:-1])
    return tuple(part.reshape(bond_shape(shape, axis)) for axis, part in enumerate(parts))


def bond_sides(values, axis, wall):
    """Return what the balls below and above each bond along an axis hold; walls hold `wall`.

    `values`, an array over the balls, gives two arrays that are one longer along the axis. This is
    the topology of the lattice: all else follows from it.
    """
    # values         0 1 2
    # padded    wall 0 1 2 wall
    # below     wall 0 1 2
    # above          0 1 2 wall
    axis %= values.ndim
    before = (slice(None),) * axis
    padded = np.empty([n + 2 * (a == axis) for a, n in enumerate(values.shape)], values.dtype)
    padded[(*before, slice(1, -1))] = values
    padded[(*before, [0, -1])] = wall
    return padded[(*before, slice(-1))], padded[(*before, slice(1, None))]


def bond_ends(numbers):
    """Return the balls that each bond joins, -1 for a wall, shape (bonds, 2).

    `numbers` are those of the balls, an array over the lattice. The result holds the columns of B
    in each of its rows; B's entries there are `SIGNS`.
    """
    sides = [bond_sides(numbers, axis, -1) for axis in range(numbers.ndim)]
    return np.concatenate([np.stack([end.ravel() for end in pair], axis=1) for pair in sides])


def cut_sides(arrays, sides):
    """Set to 0 what arrays of bonds, one for each axis, hold at sides such as `y+`."""
    for side in sides:
        axis = AXES.index(side[0])
        np.moveaxis(arrays[axis], axis, 0)[-1 if side[1] == "+" else 0] = 0.0


def balls_above(shape):
    """Return how many balls are above each bond along the last axis, an array for each axis.

    Above a bond across that axis half of the balls beside it count, too.
    """
    shapes = [bond_shape(shape, axis) for axis in range(len(shape))]
    height = [np.indices(own)[-1] + 0.5 * (own[-1] == shape[-1]) for own in shapes]
    return [shape[-1] - above for above in height]


def stretch(fields, axes):
    """Yield B x for the bonds along each axis, the last ones of `fields`, walls at rest."""
    for axis in range(-axes, 0):
        below, above = bond_sides(fields, axis, 0.0)
        yield above - below


def spread(tensions):
    """Return B^T t, the adjoint of `stretch`: the sum, ball by ball, of what its bonds hold.

    `tensions` are arrays over the bonds, as `stretch` yields them.
    """
    total, tensions = 0.0, list(tensions)
    for axis, t in enumerate(tensions, -len(tensions)):
        total -= np.diff(t, axis=axis)  # the bond below a ball counts +, as in B
    return total


class ElasticBonds:
    """The bonds of a lattice as springs; `springs.Elastic` answers the same for a network."""

    def bond_places(self, bonds):
        """Return the axis of each numbered bond, and its index into that axis's array.

        The indices are an array with one axis more, of the length of `shape`.
        """
        first = np.cumsum([0, *_bond_counts(self.shape)[:-1]])
        axis = np.searchsorted(first, bonds, side="right") - 1
        index = np.empty((*bonds.shape, self.axes), dtype=np.int64)
        for a in range(self.axes):
            here = axis == a
            places = np.unravel_index(bonds[here] - first[a], bond_shape(self.shape, a))
            index[here] = np.stack(places, axis=-1)
        return axis, index

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
    def shares(self):
        """1 of each bond, 0 where there is no wall, shape (bonds,)."""
        parts = [np.ones_like(k) for k in self.stiffness]
        cut_sides(parts, self.free)
        return np.concatenate([part.ravel() for part in parts])

    @cached_property
    def damped_springs(self):
        """The part of beta that each bond has, shape (bonds,)."""
        return self.shares * self.law(self.constants) if self.damping_power else self.shares

    @property
    def losses(self):
        """eta k of all bonds, None where there is no loss angle."""
        return self.loss * self.constants if self.loss else None

    @property
    def drags(self):
        """The rate alpha of each ball, None where there is no drag."""
        return np.full(self.size, self.drag) if self.drag else None

    @cached_property
    def existing(self):
        """The numbers of the bonds that exist: all but those at free sides."""
        return np.flatnonzero(self.shares)

    @cached_property
    def moved(self):
        """How far each place of the driven wall moves, shape (ny, ...)."""
        if self.push is not None or "x+" in self.free:
            return np.zeros(self.shape[1:])
        return np.ones(self.shape[1:]) if self.wall is None else self.wall

    @cached_property
    def drive(self):
        """How far each bond is stretched when what is driven moves by 1, shape (bonds,)."""
        along = np.zeros(self.stiffness[0].shape)
        along[-1] = self.moved
        return np.pad(along.ravel(), (0, self.bonds - along.size))

    def stretched(self, fields, wall):
        """Yield how far fields (n, *shape) lengthen bonds, (n, bonds), constants, parts of beta.

        The driven wall moves by `wall`, shape (n,).
        """
        for axis, longer in enumerate(stretch(fields, self.axes)):
            if axis == 0:
                wall = wall.reshape(-1, *[1] * (self.axes - 1))
                longer[:, -1] += wall * self.moved  # above the last bond
            damped = bond_arrays(self.shape, self.damped_springs)[axis]
            yield longer.reshape(len(fields), -1), self.stiffness[axis].ravel(), damped.ravel()

    semidefinite = True  # K has no negative eigenvalues

    def restoring_forces(self, fields):
        """Return K f = B^T diag(k) B f for fields of shape (count, *shape)."""
        stretches = stretch(fields, self.axes)
        return spread(k * t for k, t in zip(self.stiffness, stretches, strict=True))

    @property
    def rows(self):
        """|b|_2 of a bond between balls, and what rounding adds to b^T x beside its own."""
        return math.sqrt(2), 0.0

    @property
    def driving(self):
        """The force of the drive at rest on each ball, an array over the lattice."""
        force = np.zeros(self.shape) if self.push is None else self.push.copy()
        force[-1] += self.stiffness[0][-1] * self.moved
        return force

    @property
    def drive_norms(self):
        """|f|_2 at rest, and of what dashpots add to it for beta = 1."""
        damped = self._wall_parts * self.moved
        return float(np.linalg.norm(self.driving)), float(np.linalg.norm(damped))

    @property
    def _wall_parts(self):
        """The parts of beta of the bonds at the driven wall, shape (ny, ...)."""
        return bond_arrays(self.shape, self.damped_springs)[0][-1]

    @property
    def pulls(self):
        """What `pull` is at s = 0, and by how much it grows with s: sum k and sum beta."""
        squares, k = self.moved**2, self.stiffness[0][-1] * (1 + 1j * self.loss if self.loss else 1)
        return np.sum(k * squares), self.damping * np.sum(self._wall_parts * squares)

    def pull_rounding(self, size):
        """Return how much rounding changes `pull(s)`, at most, for an |s|."""
        return (self.stiffness[0][-1].size + 8) * EPSILON * abs(self.pull(size))

    @property
    def dashpot_norm(self):
        """No less than |B^T diag(d) B|_2."""
        return 4 * self.axes * (self.damped_springs.max() if self.damping_power else 1)

    @property
    def relaxation_rate(self):
        """The largest k / beta of a bond, infinite without dashpots."""
        if self.loss or not self.damping:
            return math.inf  # with a loss angle no disc holds all damped modes
        if not self.damping_power:
            return self.stiffest / self.damping
        with np.errstate(all="ignore"):
            rates = self.constants / (self.damping * self.damped_springs)
        return float(np.max(rates, where=self.constants > 0, initial=0.0))

    @property
    def diagonal(self):
        """The diagonal of K, an entry a ball: the sum of its bonds."""
        diagonal = 0.0
        for axis, k in enumerate(self.stiffness):
            k = np.moveaxis(k, axis, 0)
            diagonal = diagonal + np.moveaxis(k[1:] + k[:-1], 0, axis)
        return diagonal

    @property
    def stiffness_norm(self):
        """No less than |K|_2: |K|_inf, twice its largest diagonal entry."""
        return 2 * float(np.max(self.diagonal))

    @property
    def rounding(self):
        """How much rounding moves a residual: see `residual_rounding`."""
        return residual_rounding(self.axes)
