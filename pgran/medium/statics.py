"""Long waves by statics: how stiffly a medium resists a uniform deformation, and their speeds.

A long wave of the polarisation e along q^ moves two balls that are d apart by e (q^ . d) against
each other. That stretches a spring b, whose row of B has the entries t at its second ball, by
w_b = (t . e) (q^ . d_b). Balls then go where forces balance, and what is left of the energy says
how fast the wave is,

    rho c^2 = [sum k w^2 - (B^T k w)^T K^+ (B^T k w)] / V;

without the second term, of balls that stay where the uniform deformation takes them, it is the
affine speed. Springs of pre-stress belong to both, and so the gradient e q^ is not symmetrised.
"""

import itertools
from typing import NamedTuple

import numpy as np

from pgran.arguments import called_right
from pgran.errors import InputError, PgranError
from pgran.medium import base
from pgran.medium.bonds import AXES, dissected
from pgran.medium.graph import without_rattlers
from pgran.medium.packing import nearest_images
from pgran.medium.springs import FREE, SYMMETRIC

SMALLEST_PIVOT = 1e-14  # of K's largest entry: a smaller pivot is rounding
LARGEST_IMBALANCE = 1e-8  # of the largest force: what a solution may leave


class Waves(NamedTuple):
    """Speeds of long waves of one polarisation, in units of length times frequency.

    `speed` and `affine` are roots of the means of c^2 over all directions; `slowest` and `fastest`
    are relaxed ones of single directions, along axes and diagonals or in between. Where c^2 < 0, as
    of a small packing that shear would rearrange, `slowest` is -sqrt(-c^2).
    """

    speed: float
    affine: float
    slowest: float
    fastest: float


class Sound(NamedTuple):
    """Speeds of long waves, and the medium that they are of.

    Scalar displacements have one kind of waves, `longitudinal`; `transverse` is None then.
    """

    longitudinal: Waves
    transverse: Waves | None
    dimension: int  # along how many axes waves run
    balls: int  # that take part
    rattlers: int  # that were left out
    volume: float
    density: float  # mass per volume

    @property
    def shear(self):
        """The shear modulus G = rho c_T^2, relaxed; of scalars rho c^2, their only one."""
        waves = self.transverse or self.longitudinal
        return self.density * waves.speed**2

    @property
    def bulk(self):
        """The bulk modulus rho c_L^2 - 2 (d - 1) / d G of an isotropic medium; NaN of scalars."""
        if self.transverse is None:
            return np.nan
        d = self.dimension
        return self.density * self.longitudinal.speed**2 - 2 * (d - 1) / d * self.shear

    def debye(self, omega):
        """Return Debye's density of modes of long waves, per ball and unit of omega.

        V / N S omega^(d-1) / (2 pi)^d (1 / c_L^d + (d - 1) / c_T^d), S the surface 2, 2 pi or 4 pi
        of the unit ball in d dimensions.
        """
        d, slowness = self.dimension, self.longitudinal.speed**-self.dimension
        if self.transverse is not None:
            slowness += (d - 1) * self.transverse.speed**-d
        surface = {1: 2.0, 2: 2 * np.pi, 3: 4 * np.pi}[d]
        return self.volume / self.balls * surface / (2 * np.pi) ** d * slowness * omega ** (d - 1)


@called_right
def sound(medium: base.Medium) -> Sound:
    """Return the speeds of long waves and the elastic moduli of a medium, by statics.

    Rattlers of a network are left out. A lattice is pulled between walls with its sides free, along
    the axes that have two walls. Not parallel: each rank that calls it computes the same.

    Parameters
    ----------
    medium : pgran.Lattice or pgran.Network
        A network has periods along all axes, and none of its balls in contact is held.

    Returns
    -------
    Sound
        `longitudinal` and `transverse` waves, `density`, the moduli `bulk` and `shear`, and `debye`
        of a frequency, Debye's density of modes. Speeds are accurate to rounding.

    Raises
    ------
    InputError
        If a network does not know its box or has walls, balls float, or no long waves run.

    Examples
    --------
    >>> import pgran
    >>> lattice = pgran.Lattice.random((6, 5), law="constant")
    >>> found = pgran.sound(lattice).longitudinal
    >>> round(found.speed, 3), round(found.affine, 3)
    (0.5, 0.5)
    """
    medium = base.medium(medium)
    return _of_lattice(medium) if medium.is_grid else _of_network(medium)


def _of_lattice(lattice):
    """Return the sound of a lattice; along an axis its walls are one more apart than its balls."""
    springs, axes = lattice.springs, np.arange(lattice.axes)
    pulled = [axis for axis in axes if AXES[axis] not in "".join(lattice.free)]
    if not pulled:
        raise InputError("sound: no axis of the lattice has two walls to be pulled between")
    axis, _ = lattice.bond_places(np.arange(lattice.bonds))
    at_wall, rows = np.any(springs.columns < 0, axis=1), springs.B[:, dissected(lattice.shape)]
    squares = []  # of affine and relaxed speeds along each axis
    for along in pulled:
        constants = np.where(at_wall & (axis != along), 0.0, springs.constants)
        stretches = np.where(axis == along, 1.0, 0.0)[:, None]
        energies = _energies(rows, constants, stretches)
        mass = lattice.mass * np.prod(lattice.shape + (axes == along))
        squares.append([energy.item() / mass for energy in energies])
    affine, relaxed = np.transpose(squares)
    waves = _waves(relaxed.mean(), affine.mean(), relaxed)
    return Sound(waves, None, lattice.axes, lattice.size, 0, float(lattice.size), lattice.mass)


def _of_network(network):
    """Return the sound of a network in a periodic box."""
    before = network.free_balls
    network, _ = without_rattlers(network)
    reaches, springs, axes = _reaches(network), network.springs, network.axes
    second = slice(network.components, network.components + axes)
    entries = springs.values[:, second] / network.weights[springs.columns[:, second]]
    distances = np.tile(reaches, (len(springs.blocks), 1))
    stretches = (entries[:, :, None] * distances[:, None, :]).reshape(len(entries), -1)
    # the first ball in this order stays: nothing else holds the box where it is
    free = springs.B[:, network.order[axes:]]
    mass, shape = network.masses[network.held == FREE].sum(), 2 * (axes, reaches.shape[1])
    affine, relaxed = (
        energies.reshape(shape) / mass for energies in _energies(free, springs.constants, stretches)
    )
    each = _of_directions(relaxed)  # the fastest is longitudinal
    kinds = [each[:, -1:], each[:, :-1]][:axes]
    waves = [_waves(*each) for each in zip(_means(relaxed), _means(affine), kinds, strict=True)]
    balls, volume = network.free_balls, float(network.box.prod())
    facts = len(network.box), balls, before - balls, volume, float(mass) / volume
    return Sound(*[*waves, None][:2], *facts)


def _reaches(network):
    """Return how far each contact reaches, (nb, d); raise InputError unless the box is periodic."""
    held = np.any(network.held[np.unique(network.bond)] != FREE)
    if network.box is None or not np.all(network.box) or held:
        raise InputError(
            "sound: long waves need a box that is periodic along all axes, and no ball that is "
            "held: pgran pack without --walls, or pgran import without --cut, --rest and --drive"
        )
    if network.normal is not None and network.distance is not None:
        return network.normal * network.distance[:, None]
    i, j = network.bond.T
    return nearest_images(network.position[j] - network.position[i], network.box)[0]


def _energies(rows, constants, stretches):
    """Return twice the energies of deformations, affine and relaxed: matrices, two by two.

    `stretches`, shape (springs, m), are how far m deformations lengthen springs. `rows` are those
    of B, sparse, without the unknowns that rest, the others in the order of elimination.
    """
    from scipy.sparse import diags
    from scipy.sparse.linalg import splu

    pulls = constants[:, None] * stretches
    affine = stretches.T @ pulls
    K, forces = rows.T @ rows.multiply(constants[:, None]), rows.T @ pulls
    size = np.abs(K.diagonal()).max()
    idle = (K.diagonal() == 0) & ~np.any(forces, axis=1)  # no spring acts there
    K = (K + diags(size * idle)).tocsc()
    loose = InputError(
        "sound: parts of the medium are loose, or its pre-stress makes it unstable: no deformation "
        "is in balance; scene modes says its modes at rest and the unstable ones"
    )
    try:
        factors = splu(K, "NATURAL", **SYMMETRIC)
    except RuntimeError:  # singular
        raise loose from None
    if not np.all(factors.U.diagonal() > SMALLEST_PIVOT * size):
        raise loose
    moved = factors.solve(forces)
    moved += factors.solve(forces - K @ moved)
    left = np.abs(forces - K @ moved).max()
    if not left <= LARGEST_IMBALANCE * np.abs(forces).max():
        raise PgranError(f"sound: forces balance to {left:.1e} only: its springs are too unlike")
    return affine, affine - forces.T @ moved


def _means(moduli):
    """Return the means over directions of c^2 along the displacement, and across it.

    The `moduli` C, per mass, are those of gradients e q^, shape (e, q, e, q): c^2 of a wave is
    sum C_ijkl e_i q_j e_k q_l, and the mean of q_i q_j q_k q_l is (d_ij d_kl + d_ik d_jl +
    d_il d_jk) / (d (d + 2)), d_ij = 1 where i = j.
    """
    axes, d = moduli.shape[:2]
    same = np.einsum("ijij", moduli)
    if axes == 1:
        return [same / d]
    along = (same + np.einsum("iijj", moduli) + np.einsum("ijji", moduli)) / (d * (d + 2))
    return [along, (same / d - along) / (d - 1)]


def _of_directions(moduli):
    """Return c^2 of the waves of each of many directions, ascending, shape (directions, axes)."""
    steps = np.array([*itertools.product(range(-2, 3), repeat=moduli.shape[1])], dtype=float)
    steps = steps[np.any(steps != 0, axis=1)]
    q = steps / np.linalg.norm(steps, axis=1)[:, None]
    return np.linalg.eigvalsh(np.einsum("ijkl,nj,nl->nik", moduli, q, q))


def _waves(relaxed, affine, of_directions):
    """Return the speeds by their squares; raise InputError where there is none in the mean."""
    squares = np.array([relaxed, affine, np.min(of_directions), np.max(of_directions)])
    if not np.all(squares[:2] > 0):  # NaN too
        raise InputError(
            f"sound: c^2 = {min(squares[:2]):.3g} in the mean over directions: the medium does not "
            "resist these waves; a larger packing, or a higher pressure, may"
        )
    return Waves(*(np.sign(squares) * np.sqrt(np.abs(squares))).tolist())
