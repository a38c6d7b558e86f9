"""Any network of balls and springs: who touches whom, in which direction, how stiffly.

A ball has one displacement (`scalar`, the paper's model on any graph), a vector of them (`vector`),
or these and its rotation (`rotations`). `contacts` says what springs a contact is. All is computed
in mass-weighted unknowns sqrt(m_p / m) u_p, m the median of all balls: these have one mass m, and S
stays symmetric.
"""

import dataclasses
import hashlib
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from pgran.arguments import called_right
from pgran.errors import InputError, log
from pgran.medium.base import AXES, BETA, EPSILON, check_magnitudes, closest, unit_vector
from pgran.medium.checks import check_network, checked_values
from pgran.medium.contacts import springs_of
from pgran.medium.graph import Connected, rattlers
from pgran.medium.springs import AT_REST, DRIVEN, FREE, Elastic, norm_of
from pgran.run.numbers import number, numbers
from pgran.store.record import Record, array, attribute, attribute_array


@dataclass(frozen=True, eq=False, repr=False)
class NetworkRecord(Record):
    """The network a result belongs to: N balls, nb contacts, laid out like a network's own file.

    Arrays of `balls` in other records have the components of its free balls one after the other.
    """

    group = "network"
    displacement: str = attribute("scalar, vector, or rotations as well")
    damped: str = attribute("what dashpots act on: all of a relative velocity, or its normal part")
    component: str = attribute("which component detectors read")
    damping: float = attribute("beta, of every bond's dashpot", "sqrt(k m)")
    kmax: float = attribute("the stiffness in omega_mx", "k")
    median_mass: float = attribute("the mass in omega_mx", "m", since=5)
    omega_mx: float = attribute("sqrt(2 d kmax / m)", "sqrt(k/m)")
    unknowns: int = attribute("displacements of all free balls, and rotations", "1")
    bonds_sha256: str = attribute("checksum of the network", of_run=True)
    direction: np.ndarray = attribute_array("that of the drive", "1", "drive_coordinate")
    bond: np.ndarray = array("balls of the contacts", "1", "contact", "end", dtype=int)
    stiffness: np.ndarray = array("constants of the contacts", "k", "contact")
    held: np.ndarray = array("0: free, 1: at rest, 2: driven", "1", "ball", dtype=int)
    mass: np.ndarray = array("masses of the balls", "m", "ball")
    position: np.ndarray | None = array(
        "positions of the balls", "1", "ball", "coordinate", optional=True
    )
    radius: np.ndarray | None = array("radii of the balls", "1", "ball", optional=True)
    normal: np.ndarray | None = array(
        "from the first ball of a contact to the second, of length 1",
        "1", "contact", "coordinate", optional=True,
    )  # fmt: skip
    distance: np.ndarray | None = array("distance of the centres", "1", "contact", optional=True)
    force: np.ndarray | None = array("force that repels", "k", "contact", optional=True)
    tangential: np.ndarray | None = array(
        "constants of tangential springs", "k", "contact", optional=True
    )
    push: np.ndarray | None = array(
        "force on each ball, which drives instead of held balls", "k", "ball", "drive_coordinate",
        optional=True,
    )  # fmt: skip
    dashpot: np.ndarray | None = array("multiple of damping", "1", "contact", optional=True)
    tangential_dashpot: np.ndarray | None = array(
        "multiple of damping along tangents", "1", "contact", optional=True
    )
    drag: np.ndarray | None = array("alpha of -alpha m v", "sqrt(k/m)", "ball", optional=True)
    loss: np.ndarray | None = array("eta of k (1 + i eta)", "1", "contact", optional=True)
    damping_power: float | None = attribute("p of dashpots beta (k / k_ref)^p", "1", optional=True)
    damping_reference: float | None = attribute("k_ref of that law", "k", optional=True)
    power: float | None = attribute("alpha of the contact law F = c h^alpha", "1", optional=True)
    box: np.ndarray | None = attribute_array("periods, or 0", "length", "coordinate", optional=True)
    gravity: np.ndarray | None = attribute_array("gravity", "force/m", "coordinate", optional=True)

    length = "lengths"

    @property
    def has_places(self):
        """Whether its balls have positions, to be drawn at."""
        return self.position is not None

    @property
    def axes(self):
        """How long the axes of its unknowns are, by name."""
        return {"axis": 1, "x": self.unknowns}

    @property
    def shape(self):
        """The unknowns, as those of a `Network`."""
        return (self.unknowns,)

    @property
    def free_balls(self):
        """How many balls move freely."""
        return int(np.count_nonzero(self.held == FREE))

    @cached_property
    def built(self):
        """The network itself."""
        same = [item.name for item in fields(self) if item.name in Network.__dataclass_fields__]
        values = {name: getattr(self, name) for name in same}
        if self.median_mass is None:  # of an older file: the median of the free balls
            values["median_mass"] = float(np.median(self.mass[self.held == FREE]))
        return Network(masses=self.mass, **values)

    @classmethod
    def of(cls, network):
        """Return the record of a network."""
        same = [item.name for item in fields(cls) if item.name not in ("mass", "unknowns")]
        values = {name: getattr(network, name) for name in same}
        values["damping_power"] = network.damping_power or None
        return cls(mass=network.masses, unknowns=network.size, **values)


# The arrays that a network is made of, by its own names.
ARRAYS = {
    "masses" if item.name == "mass" else item.name: item.metadata
    for item in fields(NetworkRecord)
    if "axes" in item.metadata
}


@called_right
@dataclass(frozen=True, eq=False)
class Network(Connected, Elastic):
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
    direction : array_like of float, shape (d,), or str, optional
        Direction of the drive, also as `x`, `y` or `z`; by default along x.
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

    Attributes
    ----------
    axes, turns, components
        How many components a translation, a rotation and both of a free ball have.
    free, bonds, size, shape
        The numbers of the free balls; how many contacts and unknowns there are; (size,).
    mass
        That of the mass-weighted unknowns, `median_mass`.
    springs, constants : Springs, numpy.ndarray
        All springs, those of contacts along their normals first; their constants.

    Raises
    ------
    InputError
        If shapes or values are impossible.

    Examples
    --------
    >>> import pgran
    >>> pgran.Network(bond=[[0, 1], [1, 2]], stiffness=[1.0, 2.0], held=[2, 0, 1])
    Network(3 balls, 1 of them free, 2 contacts, scalar, beta 0.003, omega_mx=2)
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
        own = vars(self)  # which is not frozen
        own.update(checked_values(self, ARRAYS))
        own["axes"] = 1 if self.displacement == "scalar" else self.normal.shape[1]
        check_network(self)
        own["turns"] = {2: 1, 3: 3}[self.axes] if self.displacement == "rotations" else 0
        own["components"] = self.axes + self.turns
        own["free"] = np.flatnonzero(self.held == FREE)
        own["bonds"], own["size"] = len(self.bond), self.components * len(self.free)
        own["shape"] = (self.size,)
        mass = self.median_mass
        if mass is None:
            mass = float(np.median(self.masses[self.masses > 0]))  # walls may be given none
        own["mass"] = own["median_mass"] = number("network: median_mass", mass)
        name = "network: the direction of the drive"
        own["direction"] = unit_vector(name, self.direction, self.axes)
        self._check_dissipation(self.stiffness, () if self.tangential is None else self.tangential)
        own["springs"] = springs = springs_of(self)
        own["constants"], own["damped_springs"] = springs.constants, springs.damped
        own["drive"], own["stiffest"] = springs.drive, float(np.abs(springs.constants).max())
        own["losses"] = None if self.loss is None else springs.loss_angles * springs.elastic
        drag = self.drag
        own["drags"] = None if drag is None else np.repeat(drag[self.free], self.components)
        kmax = self.stiffest if self.kmax is None else self.kmax
        own["kmax"] = number("network: kmax", kmax)
        check_magnitudes(self)

    @classmethod
    @called_right
    def of_balls(
        cls, position: np.ndarray, radius: np.ndarray, box: np.ndarray | None = None,
        law: str | float = "harmonic", modulus: float = 1.0, **others: object,
    ) -> "Network":  # fmt: skip
        """Return the network of balls that are in contact where they overlap.

        A contact of the overlap h = R_i + R_j - distance bears F = c h^alpha as pre-stress, with
        c = C (R_i R_j / (R_i + R_j))^(alpha - 1), and has the stiffness alpha F / h. Rattlers stay,
        with a warning. Raises InputError where nothing overlaps, a box is too small to tell images
        apart, or a value is impossible.

        Parameters
        ----------
        position, radius : array_like of float, shapes (N, d), and (N,) or one for all
        box : array_like of float, shape (d,), optional
            Periods along each axis, 0 where there is none.
        law, modulus : str or float, float
            `harmonic`, `hertz`, or alpha; C, a spring constant, or 4/3 E* of Hertz's law.
        **others
            Of `Network`: `held`, `masses` (1 unless given) ...; `force=None`: no pre-stress.

        Examples
        --------
        >>> row = pgran.Network.of_balls([[0, 0], [0.75, 0], [1.5, 0]], 0.5, held=[2, 0, 1])
        >>> row.bond.tolist(), row.force.tolist()
        ([[0, 1], [1, 2]], [0.25, 0.25])
        """
        from pgran.medium.packing import ContactLaw, touching

        values = touching(position, radius, box, ContactLaw.named("network", law, modulus))
        network = cls(**values | {"displacement": "vector"} | others)
        if loose := np.count_nonzero(rattlers(network)):
            why = "touch too few others, or none: pgran.without_rattlers leaves them out"
            log.warning("%d of %d balls are rattlers, which %s", loose, len(network.held), why)
        return network

    def __repr__(self):
        plane = "" if self.displacement == "scalar" else f" in {self.axes} dimensions"
        return (
            f"Network({len(self.held)} balls, {len(self.free)} of them free, {self.bonds} "
            f"contacts, {self.displacement}{plane}, {self.law_in_words}, "
            f"omega_mx={self.omega_mx:.6g})"
        )

    def arrays_of(self, axis):
        """Return the arrays there are of each `ball` or of each `contact`, by name."""
        values = {name: getattr(self, name) for name in ARRAYS if ARRAYS[name]["axes"][0] == axis}
        return {name: value for name, value in values.items() if value is not None}

    @property
    def overlap(self):
        """How far balls of each contact overlap under its force, by its law; None if unknown."""
        # by F and k: positions, large numbers beside it, cannot hold it
        if self.power is None or self.force is None:
            return None
        return self.power * self.force / self.stiffness

    @cached_property
    def bonds_sha256(self):
        """Checksum of all that the springs follow from."""
        springs, digest = self.springs, hashlib.sha256(self.springs.columns.astype("<i8").tobytes())
        for values in (springs.values, springs.constants):
            digest.update(values.astype("<f8").tobytes())
        return digest.hexdigest()

    @cached_property
    def weights(self):
        """Displacement per mass-weighted unknown, shape (unknowns,)."""
        inertia = np.repeat(self.masses[self.free][:, None], self.components, axis=1)
        if self.turns:
            factor = {2: 0.5, 3: 0.4}[self.axes]  # of m R^2, of a disc and a sphere
            inertia[:, self.axes :] *= factor * self.radius[self.free][:, None] ** 2
        return np.sqrt(self.mass / inertia.ravel())

    def with_constants(self, constants):
        """Return the network with other normal springs; the tangential ones stay."""
        changed = dataclasses.replace(self, stiffness=constants[: self.bonds])
        vars(changed)["graph"] = self.graph  # who touches whom is the same
        return changed

    # B and its adjoint, which `Elastic` asks for, and how large sums over springs are.

    def blocks(self, values):
        """Return numbers of all springs as they are, in one block."""
        return (values,)

    def stretch(self, fields):
        """Yield B x for fields (n, unknowns)."""
        yield (self.springs.B @ fields.T).T

    def spread(self, tensions):
        """Return B^T t for one block of tensions (n, springs)."""
        (t,) = tensions
        return (self.springs.B.T @ t.T).T

    @property
    def row_norms(self):
        """The largest |b|_2 of a contact, and the rounding of b^T x in units of |x|_2."""
        values = self.springs.values
        size = float(np.sqrt(np.sum(values[: self.bonds] ** 2, axis=1)).max())
        return size, (values.shape[1] + 1) * EPSILON * size

    @cached_property
    def dashpot_norm(self):
        """No less than |B^T diag(d) B|_2."""
        return norm_of(self.springs.B, self.springs.damped)

    @cached_property
    def stiffness_norm(self):
        """No less than |K|_2: the largest sum of magnitudes in a row."""
        B = abs(self.springs.B)
        sums = np.abs(self.constants) * np.asarray(B.sum(axis=1)).ravel()
        return float((B.T @ sums).max())

    @cached_property
    def rounding(self):
        """How much rounding moves a residual, in units of the magnitudes that it is summed from."""
        # as of a lattice: sums over an unknown's springs, and over what these couple it to
        met = int(np.bincount(self.springs.B.indices).max())
        return (met * (1 + self.springs.columns.shape[1]) + 12) * EPSILON

    # What damps, and what drives.

    @property
    def isotropic(self):
        """Whether dashpots act on each component alike: C is the graph's Laplacian for each."""
        alike = self.dashpot is self.tangential_dashpot is None and not self.damping_power
        all_ways = self.displacement == "scalar" or (self.damped == "all" and not self.turns)
        return alike and all_ways

    @cached_property
    def pushed(self):
        """The push as a force on each unknown, None unless one drives."""
        if self.push is None:
            return None
        forces = np.zeros((self.free_balls, self.components))
        forces[:, : self.axes] = self.push[self.free]
        return self.weights * forces.ravel()

    def pushed_by(self, forces):
        """Return the fields of the network under a push on each free ball, along the drive."""
        push = np.zeros((len(self.held), self.axes))
        push[self.free] = forces[:, None] * self.direction
        return {"push": push, "held": np.where(self.held == FREE, FREE, AT_REST)}

    # Where balls and contacts are.

    def sites(self, detectors, name="-detectors"):
        """Return numbers of free balls (nd, 1); raise InputError, which has their `name`."""
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
        return closest(self.position[sites[:, 0]], self.position[driven])

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

    @property
    def existing(self):
        """The numbers of the contacts: all."""
        return np.arange(self.bonds)

    def bond_places(self, bonds):
        """Return axis, which is 0, and index of numbered contacts."""
        return np.zeros_like(bonds), bonds[..., None]
