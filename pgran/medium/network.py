"""Any network of balls and springs: who touches whom, in which direction, how stiffly.

A ball has one displacement (`scalar`, the paper's model on any graph), a vector of them (`vector`),
or these and its rotation (`rotations`). `springs` says what springs a contact is. All
is computed in mass-weighted unknowns sqrt(m_p / m) u_p, m the median of all balls: these have one
mass m, and S stays symmetric.
"""

import hashlib
import logging
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pgran.arguments import called_right
from pgran.errors import InputError
from pgran.medium.base import Medium
from pgran.medium.bonds import AXES
from pgran.medium.checks import check_network, checked_values, unit_direction
from pgran.medium.graph import Connected
from pgran.medium.source import nearest
from pgran.medium.springs import AT_REST, DRIVEN, FREE, Elastic, springs_of
from pgran.medium.units import BETA, check_magnitudes
from pgran.run.numbers import number, numbers

log = logging.getLogger("pgran")


@called_right
@dataclass(frozen=True, eq=False)
class Network(Elastic, Connected, Medium):
    """Balls, the contacts between them, and which of them are held.

    Networks are equal if all of their numbers are.

    Parameters
    ----------
    bond : array_like of int, shape (nb, 2)
        The balls of each contact, counted from 0; more than one contact may join the same two.
    stiffness : array_like of float, shape (nb,)
        Of its normal spring; may be negative.
    held : array_like of int, shape (N,)
        0: free; 1: at rest; 2: driven, along `direction`.
    masses : array_like of float, shape (N,), or float
    damping : float
        beta of each contact.
    dashpot, tangential_dashpot : array_like of float, shape (nb,), optional
        Multiples of beta, along normals and tangents; by default 1, for tangents as `damped` says.
    damping_power, damping_reference : float, optional
        p of dashpots beta (k / k_ref)^p, and k_ref, by default the mean stiffness.
    drag : array_like of float, shape (N,), or float, optional
        alpha of each ball.
    loss : array_like of float, shape (nb,), or float, optional
        eta of each contact: see `pgran.medium.dissipation`.
    displacement : str
        `scalar`, `vector` or `rotations`.
    position : array_like of float, shape (N, d), optional
        For figures, and for normals and distances that are not given.
    normal : array_like of float, shape (nb, d), optional
        Of length 1, from the first ball of a contact to the second.
    distance, force, tangential : array_like of float, shape (nb,), optional
        Distance of the centres, repulsive force, stiffness of the tangential spring.
    radius : array_like of float, shape (N,), optional
        Radii of discs or spheres of uniform density, which rotations need.
    direction : array_like of float, shape (d,), optional
        Direction of the drive; by default along x.
    damped : str
        `all` of the relative velocity at a contact, or its `normal` part.
    power : float, optional
        Of the contact law F = c h^power of the overlap h: 1 harmonic, 3/2 Hertz. With forces it
        says how far balls overlap, h = power F / k.
    box : array_like of float, shape (d,), optional
        Periods along each axis, 0 where there is none.
    gravity : array_like of float, shape (d,), optional
        The acceleration that the contacts' forces balance, if there is one.
    push : array_like of float, shape (N, axes), optional
        A force on each free ball, which drives instead of held balls.
    component : str
        Which component of a displacement is read: `drive`, `x`, `y` or `z`.
    kmax : float, optional
        The stiffness in omega_mx; by default the largest one.
    median_mass : float, optional
        The mass in omega_mx; by default the median of all balls, free or held. It may be that of a
        whole packing, of which this network is a part.

    Raises
    ------
    InputError
        If shapes or values are impossible.
    """

    bond: np.ndarray
    stiffness: np.ndarray
    held: np.ndarray
    masses: np.ndarray = 1.0
    damping: float = BETA
    displacement: str = "scalar"
    position: np.ndarray | None = None
    normal: np.ndarray | None = None
    distance: np.ndarray | None = None
    force: np.ndarray | None = None
    tangential: np.ndarray | None = None
    radius: np.ndarray | None = None
    direction: np.ndarray | None = None
    damped: str = "all"
    power: float | None = None
    box: np.ndarray | None = None
    gravity: np.ndarray | None = None
    push: np.ndarray | None = None
    component: str = "drive"
    kmax: float | None = None
    median_mass: float | None = None
    dashpot: np.ndarray | None = None
    tangential_dashpot: np.ndarray | None = None
    damping_power: float = 0.0
    damping_reference: float | None = None
    drag: np.ndarray | None = None
    loss: np.ndarray | None = None

    def __post_init__(self):
        for name, value in checked_values(self).items():
            object.__setattr__(self, name, value)
        check_network(self)
        object.__setattr__(self, "direction", unit_direction(self.direction, self.axes))
        if self.median_mass is None:
            median = float(np.median(self.masses[self.masses > 0]))  # walls may be given none
        else:
            median = number("network: median_mass", self.median_mass)
        object.__setattr__(self, "median_mass", median)
        self._check_dissipation(self.stiffness, self.tangential)
        kmax = self.stiffest if self.kmax is None else number("network: kmax", self.kmax)
        object.__setattr__(self, "kmax", kmax)
        check_magnitudes(self.axes, self.mass, self.damping, self.stiffest, kmax)

    def __repr__(self):
        plane = "" if self.displacement == "scalar" else f" in {self.axes} dimensions"
        return (
            f"Network({len(self.held)} balls, {len(self.free)} of them free, {self.bonds} "
            f"contacts, {self.displacement}{plane}, {self.law_in_words}, "
            f"omega_mx={self.omega_mx:.6g})"
        )

    @property
    def axes(self):
        """How many components a translation has."""
        return 1 if self.displacement == "scalar" else self.normal.shape[1]

    @property
    def turns(self):
        """How many components a rotation has."""
        return {2: 1, 3: 3}[self.axes] if self.displacement == "rotations" else 0

    @property
    def components(self):
        """How many unknowns a free ball has."""
        return self.axes + self.turns

    @property
    def overlap(self):
        """How far the balls of each contact overlap under its force, by its law; None if unknown.

        By F and k: positions, large numbers beside it, cannot hold it.
        """
        if self.power is None or self.force is None:
            return None
        return self.power * self.force / self.stiffness

    @cached_property
    def free(self):
        """The numbers of the free balls."""
        return np.flatnonzero(self.held == FREE)

    @property
    def shape(self):
        """The unknowns, ball after ball: an array of one axis."""
        return (self.components * len(self.free),)

    @property
    def size(self):
        """How many unknowns there are."""
        return self.shape[0]

    @property
    def mass(self):
        """The mass of the mass-weighted unknowns."""
        return self.median_mass

    @property
    def constants(self):
        """The constants of all springs, those of contacts' normal springs first."""
        return self.springs.constants

    @cached_property
    def stiffest(self):
        """The largest magnitude of a spring's constant."""
        return float(np.abs(self.springs.constants).max())

    @cached_property
    def bonds_sha256(self):
        """Checksum of all that the springs follow from."""
        digest = hashlib.sha256()
        for array in (self.springs.columns.astype("<i8"), self.springs.values.astype("<f8")):
            digest.update(array.tobytes())
        digest.update(self.springs.constants.astype("<f8").tobytes())
        return digest.hexdigest()

    @cached_property
    def weights(self):
        """Displacement per mass-weighted unknown, shape (unknowns,)."""
        inertia = np.repeat(self.masses[self.free][:, None], self.components, axis=1)
        if self.turns:
            factor = {2: 0.5, 3: 0.4}[self.axes]  # of m R^2, of a disc and a sphere
            inertia[:, self.axes :] *= factor * self.radius[self.free][:, None] ** 2
        return np.sqrt(self.mass / inertia.ravel())

    @property
    def bonds(self):
        """How many contacts there are."""
        return len(self.bond)

    @property
    def existing(self):
        """The numbers of the contacts: all."""
        return np.arange(self.bonds)

    def bond_places(self, bonds):
        """Return axis, which is 0, and index of numbered contacts."""
        return np.zeros_like(bonds), bonds[..., None]

    @cached_property
    def springs(self):
        """See `springs.Springs`."""
        return springs_of(self)

    @property
    def isotropic(self):
        """Whether dashpots act on each component alike: C is the graph's Laplacian for each."""
        alike = self.dashpot is self.tangential_dashpot is None and not self.damping_power
        all_ways = self.displacement == "scalar" or (self.damped == "all" and not self.turns)
        return alike and all_ways

    @cached_property
    def drags(self):
        """The rate alpha of each unknown, None where there is no drag."""
        return None if self.drag is None else np.repeat(self.drag[self.free], self.components)

    def sites(self, detectors, name="-detectors"):
        """Return ball numbers as an array (nd, 1).

        Raises InputError, which calls them by their `name`, unless these balls are free.
        """
        balls = numbers(name, detectors, whole=True)
        if balls.ndim > 1 and balls.shape[1:] != (1,):
            raise InputError(f"{name}: a ball of a network has one number, from 0 on")
        sites = balls.reshape(-1, 1)
        for ball in sites[:, 0]:
            if not 0 <= ball < len(self.held):
                raise InputError(f"{name}: no ball {ball}; the last is {len(self.held) - 1}")
            if self.held[ball] != FREE:
                raise InputError(f"{name}: ball {ball} is held; name free balls")
        if not len(sites):
            raise InputError(f"{name}: one ball at least is needed")
        return sites

    def nearest_free(self, places):
        """Return the free balls nearest to places, x,y,x,y ..., as an array (nd, 1)."""
        if self.position is None:
            raise InputError("-detectors_at: this network has no positions; name balls, -detectors")
        axes = self.position.shape[1]
        if len(places) % axes:
            raise InputError(f"-detectors_at: a place has {axes} coordinates here")
        away = np.reshape(places, (-1, 1, axes)) - self.position[self.free]
        away = np.linalg.norm(away, axis=2)
        balls = self.free[away.argmin(axis=1)]
        contact = np.linalg.norm(np.diff(self.position[self.bond], axis=1), axis=2).max()
        for ball, far in zip(balls, away.min(axis=1), strict=True):
            if far > contact:
                log.warning("-detectors_at: the nearest free ball, %d, is %.3g away", ball, far)
        if len(set(balls.tolist())) < len(balls):
            raise InputError(f"-detectors_at: two places have the same nearest ball, of {balls}")
        return balls[:, None]

    def readings(self, sites):
        """Return unknowns that detectors read and their weights, (nd, axes)."""
        first = np.searchsorted(self.free, np.asarray(sites)[:, 0]) * self.components
        unknowns = first[:, None] + np.arange(self.axes)
        along = self.direction
        if self.component != "drive":
            along = np.eye(self.axes)[AXES.index(self.component)]
        return unknowns, along * self.weights[unknowns]

    def depths(self, sites):
        """Return distances from the nearest ball that drives, NaN if unknown."""
        driven = np.flatnonzero(self.held == DRIVEN if self.push is None else self.push_sizes)
        if self.position is None or not len(driven):
            return np.full(len(sites), np.nan)
        return nearest(self.position[sites[:, 0]], self.position[driven])

    def displacements(self, field):
        """Return mass-weighted unknowns (..., unknowns) as displacements."""
        return self.weights * field

    @property
    def ball_numbers(self):
        """The numbers of all balls that are unknown."""
        return self.free

    def numbers_of(self, sites):
        """Return places among the free balls, of numbers (count, 1)."""
        return np.searchsorted(self.free, sites[:, 0])

    @property
    def inertia_ratio(self):
        """The unit of mass over the mass of each free ball, shape (free balls,)."""
        return self.mass / self.masses[self.free]

    @cached_property
    def pushed(self):
        """The push as a force on each unknown, None unless one drives."""
        if self.push is None:
            return None
        forces = np.zeros((self.free_balls, self.components))
        forces[:, : self.axes] = self.push[self.free]
        return self.weights * forces.ravel()

    def pushed_by(self, forces):
        """Return as changes what a push on each free ball, along the drive, makes of it."""
        push = np.zeros((len(self.held), self.axes))
        push[self.free] = forces[:, None] * self.direction
        return {"push": push, "held": np.where(self.held == FREE, FREE, AT_REST)}
