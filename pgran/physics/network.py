"""Any network of balls and springs: who touches whom, in which direction, how stiffly.

A ball has one displacement (`scalar`, the paper's model on any graph), a vector of them (`vector`),
or these and its rotation (`rotations`). A contact of the balls i and j is a few springs, rows of B;
b u is how far each is stretched:

- along the normal n, from i to j, of the contact's stiffness: b u = n . (u_j - u_i);
- along each tangent t, of its tangential stiffness: b u = t . (u_j - u_i), with rotations less
  (R_i theta_i + R_j theta_j) . (n x t), which is zero for rolling;
- along each tangent, of the constant -F / d, if the contact bears a force F at a distance d:
  b u = t . (u_j - u_i) (pre-stress).

So K = B^T diag(k) B. Damping is beta on the relative velocity at each contact, or on its normal
part. Balls at rest and driven ones are no unknowns. All is computed in mass-weighted unknowns
sqrt(m_p / m) u_p, m the median: these have one mass m, and S stays symmetric.
"""

import dataclasses
import hashlib
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pgran.errors import InputError
from pgran.physics.lattice import AXES, check_magnitudes, own_unit
from pgran.physics.rounding import EPSILON

KINDS = ("scalar", "vector", "rotations")
FREE, AT_REST, DRIVEN = 0, 1, 2


@dataclass(frozen=True, eq=False)
class Springs:
    """The rows of B in mass-weighted unknowns, contacts' normal springs first.

    Attributes
    ----------
    columns : numpy.ndarray of int, shape (springs, w)
        Unknowns; -1 where there is none.
    values : numpy.ndarray, shape (springs, w)
        Entries of B.
    drive : numpy.ndarray, shape (springs,)
        How far the driven balls' motion, of size 1, stretches each.
    constants, damped : numpy.ndarray, shape (springs,)
        Of each its constant, and the part of beta that it has.
    """

    columns: np.ndarray
    values: np.ndarray
    drive: np.ndarray
    constants: np.ndarray
    damped: np.ndarray


@dataclass(frozen=True, eq=False)
class Network:
    """Balls, the contacts between them, and which of them are held.

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
    displacement : str
        `scalar`, `vector` or `rotations`.
    position : array_like of float, shape (N, d), optional
        For pictures, and for normals and distances that are not given.
    normal : array_like of float, shape (nb, d), optional
        Of length 1, from the first ball of a contact to the second.
    distance, force, tangential : array_like of float, shape (nb,), optional
        Of the centres, repulsive, of the tangential spring.
    radius : array_like of float, shape (N,), optional
        With rotations: of discs or spheres of uniform density.
    direction : array_like of float, shape (d,), optional
        Of the drive; along x unless given.
    damped : str
        `all` of the relative velocity at a contact, or its `normal` part.
    component : str
        What of a displacement is read: `drive`, `x`, `y` or `z`.
    kmax : float, optional
        The stiffness that sets the unit of frequency; the largest one unless given.

    Raises
    ------
    InputError
        If shapes or values are impossible.
    """

    bond: np.ndarray
    stiffness: np.ndarray
    held: np.ndarray
    masses: np.ndarray = 1.0
    damping: float = 0.003
    displacement: str = "scalar"
    position: np.ndarray | None = None
    normal: np.ndarray | None = None
    distance: np.ndarray | None = None
    force: np.ndarray | None = None
    tangential: np.ndarray | None = None
    radius: np.ndarray | None = None
    direction: np.ndarray | None = None
    damped: str = "all"
    component: str = "drive"
    kmax: float | None = None

    def __post_init__(self):
        """Check shapes and values; keep copies that nobody can change."""
        self._keep("held", int, ())
        self._keep("bond", int, (2,))
        contacts, balls = len(self.bond), len(self.held)
        if np.ndim(self.masses) == 0:
            object.__setattr__(self, "masses", np.full(balls, float(self.masses)))
        if self.displacement not in KINDS:
            raise InputError(f"network: displacement {self.displacement!r} is none of {KINDS}")
        self._keep("position", float, (None,), balls)
        if self.displacement != "scalar" and self.normal is None:
            self._find_normals()
        self._keep("normal", float, (None,), contacts)
        for name in ("stiffness", "distance", "force", "tangential"):
            self._keep(name, float, (), contacts)
        for name in ("masses", "radius"):
            self._keep(name, float, (), balls)
        self._check(contacts, balls)
        object.__setattr__(self, "direction", self._unit_direction())
        if self.kmax is None:
            object.__setattr__(self, "kmax", self.stiffest)
        check_magnitudes(self.axes, self.mass, self.damping, max(self.kmax, self.stiffest))

    def _keep(self, name, dtype, rest, count=None):
        """Keep an array, if there is one, as a copy that nobody can change."""
        value = getattr(self, name)
        if value is None:
            return
        try:
            array = np.array(value, dtype=dtype)
        except (TypeError, ValueError):
            raise InputError(f"network: {name} must be an array of numbers") from None
        wanted = (count if count is not None else len(array) if array.ndim else 0, *rest)
        if dtype is int and not np.array_equal(array, value):
            raise InputError(f"network: {name}: whole numbers are needed")
        if array.ndim != len(wanted) or any(
            n not in (None, m) for n, m in zip(wanted, array.shape, strict=True)
        ):
            raise InputError(f"network: {name}: shape {array.shape} is not {wanted}")
        if not np.all(np.isfinite(array)):
            raise InputError(f"network: {name}: every number must be finite")
        array.flags.writeable = False
        object.__setattr__(self, name, array)

    def _find_normals(self):
        """Find normals and distances by the positions."""
        if self.position is None:
            raise InputError("network: vectors need normals, or positions to find them by")
        bond = np.clip(self.bond, 0, len(self.held) - 1)
        away = self.position[bond[:, 1]] - self.position[bond[:, 0]]
        distance = np.linalg.norm(away, axis=1)
        if not np.all(distance > 0):
            at = np.argmin(distance)
            raise InputError(f"network: the balls of contact {at} are at the same place")
        object.__setattr__(self, "normal", away / distance[:, None])
        if self.distance is None:
            object.__setattr__(self, "distance", distance)

    def _check(self, contacts, balls):
        """Raise where values are impossible."""
        if contacts == 0 or balls == 0:
            raise InputError("network: it has no contacts")
        wrong = np.flatnonzero(np.any((self.bond < 0) | (self.bond >= balls), axis=1))
        if wrong.size:
            pair = tuple(self.bond[wrong[0]].tolist())
            raise InputError(f"network: contact {wrong[0]}: no balls {pair} among {balls}")
        if np.any(self.bond[:, 0] == self.bond[:, 1]):
            raise InputError("network: a ball touches itself")
        if not np.all(np.isin(self.held, (FREE, AT_REST, DRIVEN))):
            raise InputError("network: held must be 0 (free), 1 (at rest) or 2 (driven)")
        if not np.any(self.held == FREE):
            raise InputError("network: every ball is held")
        if not np.any(self.held[self.bond] == FREE):
            raise InputError("network: no free ball has a contact")
        if not np.all(self.masses[self.held == FREE] > 0):
            raise InputError("network: masses must be positive")
        if self.damped not in ("all", "normal"):
            raise InputError(f"network: damped is {self.damped!r}, not 'all' or 'normal'")
        if self.displacement != "scalar":
            if self.normal.shape[1] not in (2, 3):
                raise InputError("network: vectors have 2 or 3 components")
            if np.any(np.abs(np.linalg.norm(self.normal, axis=1) - 1) > 1e-6):
                raise InputError("network: normals must have the length 1")
        if self.force is not None and (self.distance is None or not np.all(self.distance > 0)):
            raise InputError("network: forces need positive distances")
        if self.turns and self.radius is None:
            raise InputError("network: rotations need radii")
        if self.turns and not np.all(self.radius[self.held == FREE] > 0):
            raise InputError("network: radii must be positive")
        if self.component not in ("drive", *AXES[: self.axes if self.axes > 1 else 0]):
            raise InputError(f"-detectors_component {self.component}: this network has no such one")

    def _unit_direction(self):
        """Return the direction of the drive, of length 1."""
        if self.direction is None:
            return np.eye(self.axes)[0]
        direction = np.asarray(self.direction, dtype=float)
        size = np.linalg.norm(direction)
        if direction.shape != (self.axes,) or not 0 < size < math.inf:
            raise InputError(f"network: the direction of the drive has {self.axes} components")
        return direction / size

    @property
    def axes(self):
        """How many components a translation has."""
        return 1 if self.displacement == "scalar" else self.normal.shape[1]

    @property
    def turns(self):
        """How many components a rotation has."""
        if self.displacement != "rotations":
            return 0
        return {2: 1, 3: 3}[self.axes]

    @property
    def components(self):
        """How many unknowns a free ball has."""
        return self.axes + self.turns

    @cached_property
    def free(self):
        """The numbers of the free balls."""
        return np.flatnonzero(self.held == FREE)

    @property
    def shape(self):
        """The unknowns, ball after ball: an array of one axis."""
        return (self.components * len(self.free),)

    @property
    def balls(self):
        """How many unknowns there are."""
        return self.shape[0]

    @property
    def mass(self):
        """The mass of the mass-weighted unknowns: the median."""
        return float(np.median(self.masses[self.free]))

    @property
    def constants(self):
        """The constants of all springs, those of contacts' normal springs first."""
        return self.springs.constants

    @property
    def stiffest(self):
        """The largest magnitude of a spring's constant."""
        return float(np.abs(self.springs.constants).max())

    @property
    def omega_mx(self):
        """Sqrt(2 d kmax / m), unit of frequency, as on the square lattice (paper: omxdef)."""
        return math.sqrt(2 * self.axes * abs(self.kmax) / self.mass)

    @cached_property
    def bonds_sha256(self):
        """Checksum of all that the springs follow from."""
        digest = hashlib.sha256()
        for part in (self.springs.columns.astype("<i8"), self.springs.values.astype("<f8")):
            digest.update(part.tobytes())
        digest.update(self.springs.constants.astype("<f8").tobytes())
        return digest.hexdigest()

    @cached_property
    def weights(self):
        """Displacement per mass-weighted unknown, shape (unknowns,)."""
        inertia = np.repeat(self.masses[self.free][:, None], self.components, axis=1)
        if self.turns:
            part = {2: 0.5, 3: 0.4}[self.axes]  # of m R^2, of a disc and a sphere
            inertia[:, self.axes :] *= part * self.radius[self.free][:, None] ** 2
        return np.sqrt(self.mass / inertia.ravel())

    @cached_property
    def B(self):  # noqa: N802
        """The rows of B, sparse, shape (springs, unknowns)."""
        from scipy.sparse import csr_matrix  # here: SciPy takes its time

        columns, values = self.springs.columns, self.springs.values
        there = columns >= 0
        rows = np.repeat(np.arange(len(columns)), np.count_nonzero(there, axis=1))
        return csr_matrix((values[there], (rows, columns[there])), (len(columns), self.balls))

    def stretched(self, fields, wall):
        """Yield how far fields (n, unknowns) lengthen springs, constants, parts of beta.

        Not collective. What is driven moves by `wall`, shape (n,).
        """
        springs = self.springs
        yield (
            (self.B @ fields.T).T + wall[:, None] * springs.drive,
            springs.constants,
            springs.damped,
        )

    @property
    def irregular(self):
        """Whether minimum degree orders its graph better than nested dissection: by a third."""
        return True

    @property
    def semidefinite(self):
        """Whether K has no negative eigenvalues for certain, as all constants are positive."""
        return bool(np.all(self.springs.constants >= 0))

    @property
    def largest_eigenvalue(self):
        """No less than |K|_2."""
        return self.stiffness_norm

    def restoring_forces(self, fields):
        """Return K f = B^T diag(k) B f for fields of shape (count, unknowns). Not collective."""
        return (self.B.T @ (self.springs.constants[:, None] * (self.B @ fields.T))).T

    @property
    def bonds(self):
        """How many contacts there are."""
        return len(self.bond)

    @property
    def rows(self):
        """The largest |b|_2 of a contact, and what rounding adds to b^T x, in units of |x|_2."""
        values = self.springs.values
        size = float(np.sqrt(np.sum(values[: self.bonds] ** 2, axis=1)).max())
        return size, (values.shape[1] + 1) * EPSILON * size

    def bond_places(self, bonds):
        """Return axis and index of numbered contacts, as of an array of one axis."""
        return np.zeros_like(bonds), bonds[..., None]

    @property
    def drive_norms(self):
        """|f|_2 of what the springs at driven balls do, and of their dashpots for beta = 1."""
        springs = self.springs
        return tuple(
            float(np.linalg.norm(self.B.T @ (k * springs.drive)))
            for k in (springs.constants, springs.damped)
        )

    @property
    def damping_norm(self):
        """No less than |C|_2."""
        size = abs(self.B)
        return 1.01 * float((size.T @ (self.springs.damped * (size @ np.ones(self.balls)))).max())

    @property
    def stiffness_norm(self):
        """No less than |K|_inf."""
        size = abs(self.B)
        sums = np.abs(self.springs.constants) * np.asarray(size.sum(axis=1)).ravel()
        return float((size.T @ sums).max())

    @property
    def rounding(self):
        """How much rounding moves a residual, in units of what it is summed from.

        As `pgran.physics.rounding.residual_rounding`: sums over the springs at an unknown, and over
        the unknowns that these couple it to.
        """
        met = int(np.bincount(self.B.indices).max())
        return (met * (1 + self.springs.columns.shape[1]) + 12) * EPSILON

    @cached_property
    def springs(self):
        """See `Springs`."""
        balls, components = len(self.held), self.components
        unknown = np.full((balls + 1, components), -1)
        unknown[self.free] = np.arange(self.balls).reshape(-1, components)
        i, j = self.bond.T
        columns = np.concatenate([unknown[i], unknown[j]], axis=1)
        moving = np.zeros((balls, components))
        moving[self.held == DRIVEN, : self.axes] = self.direction
        moving = np.concatenate([moving[i], moving[j]], axis=1)
        weights = np.append(self.weights, 0.0)[columns]
        rows, constants, damped = self._rows(i, j)
        values = np.concatenate(rows)
        return Springs(
            np.tile(columns, (len(rows), 1)),
            values * np.tile(weights, (len(rows), 1)),
            np.einsum("sw,sw->s", values, np.tile(moving, (len(rows), 1))),
            np.concatenate(constants),
            np.repeat(damped, len(i)),
        )

    def _rows(self, i, j):
        """Return blocks of rows over the components of both balls, constants, parts of beta."""
        still = np.zeros((len(i), self.turns))

        def row(t, first=still, second=still):
            return np.concatenate([-t, first, t, second], axis=1)

        if self.displacement == "scalar":
            return [row(np.ones((len(i), 1)))], [self.stiffness], [1.0]
        rows, constants, damped = [row(self.normal)], [self.stiffness], [1.0]
        nothing = np.zeros(len(i))
        pre_stress = nothing if self.force is None else -self.force / self.distance
        shear = nothing if self.tangential is None else self.tangential
        part = float(self.damped == "all")
        for t in tangents(self.normal):
            if not self.turns:
                found = [(row(t), shear + pre_stress, part)]
            else:
                lever = _cross(self.normal, t)
                turned = [-self.radius[end][:, None] * lever for end in (i, j)]
                found = [(row(t, *turned), shear, part), (row(t), pre_stress, 0.0)]
            for block, k, of_beta in found:
                if of_beta or np.any(k):
                    rows.append(block)
                    constants.append(k)
                    damped.append(of_beta)
        return rows, constants, damped

    def check_driven(self):
        """Raise InputError if nothing is driven, or balls float that no drive can bound."""
        if not np.any(self.held == DRIVEN):
            raise InputError("network: no ball is driven; /network/held has 2 for those that are")
        floating = np.flatnonzero(~_anchored(self.bond, self.held))
        if len(floating):
            raise InputError(
                f"network: {len(floating)} balls float, ball {floating[0]} first: no path of "
                "contacts leads to a held one; pgran import leaves them out, and "
                "pgran.physics.network.without_floating"
            )

    def sites(self, detectors):
        """Return ball numbers as an array (nd, 1); raise InputError unless these balls are free."""
        sites = np.asarray(detectors, dtype=np.int64).reshape(-1, 1)
        for ball in sites[:, 0]:
            if not 0 <= ball < len(self.held):
                raise InputError(f"detectors: no ball {ball} among {len(self.held)}, from 0")
            if self.held[ball] != FREE:
                raise InputError(f"detectors: ball {ball} is held")
        if not len(sites):
            raise InputError("detectors: one ball at least is needed")
        return sites

    def readings(self, sites):
        """Return the unknowns that detectors read, and their weights, shape (nd, axes)."""
        first = np.searchsorted(self.free, np.asarray(sites)[:, 0]) * self.components
        unknowns = first[:, None] + np.arange(self.axes)
        along = self.direction
        if self.component != "drive":
            along = np.eye(self.axes)[AXES.index(self.component)]
        return unknowns, along * self.weights[unknowns]

    def depths(self, sites):
        """Return how far balls are from the nearest driven one, NaN if unknown, shape (nd,)."""
        driven = np.flatnonzero(self.held == DRIVEN)
        if self.position is None or not len(driven):
            return np.full(len(sites), np.nan)
        away = self.position[sites[:, 0]][:, None] - self.position[driven]
        return np.sqrt(np.sum(away**2, axis=2)).min(axis=1)

    def displacements(self, field):
        """Return mass-weighted unknowns as displacements, shape (..., unknowns)."""
        return self.weights * field

    def per_ball(self, squares):
        """Return sums over the components of each free ball, shape (n, free balls)."""
        return squares.reshape(len(squares), -1, self.components).sum(axis=2)

    def in_own_unit(self):
        """Return the same network with its largest constant between 1 and 2, and the unit.

        Not collective. As `pgran.physics.lattice.Lattice.in_own_unit`.
        """
        unit = own_unit(self.stiffest, self.mass, self.damping)
        scaled = {
            name: getattr(self, name) / unit
            for name in ("stiffness", "masses", "damping", "force", "tangential", "kmax")
            if getattr(self, name) is not None
        }
        return dataclasses.replace(self, **scaled), unit


def without_floating(network):
    """Return a network without what floats, and the numbers of the balls that are kept.

    Not collective. A free ball floats if no path of contacts leads from it to a held ball: its
    motion is no answer to the drive, and K and C are singular. Where no ball is held, all parts but
    the largest float.

    Returns
    -------
    network : Network
        Its unit of frequency, `kmax`, is the same as before.
    kept : numpy.ndarray of int, shape (balls kept,)
        Ascending.

    Raises
    ------
    InputError
        If nothing free is left.
    """
    kept = np.flatnonzero(_anchored(network.bond, network.held))
    return part(network, kept), kept


def _anchored(bond, held):
    """Return which balls do not float, shape (balls,)."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    balls = len(held)
    graph = coo_matrix((np.ones(len(bond)), tuple(bond.T)), (balls, balls))
    count, label = connected_components(graph, directed=False)
    if not np.any(held):
        return label == np.argmax(np.bincount(label))
    anchors = np.zeros(count, dtype=bool)
    anchors[label[held != FREE]] = True
    return anchors[label]


def part(network, balls=None, contacts=None):
    """Return the network of some balls, and of those contacts that join two of them.

    Not collective.

    Parameters
    ----------
    network : Network
    balls, contacts : array_like of int, optional
        Numbers of those that are kept, ascending; all unless given.

    Raises
    ------
    InputError
        If nothing free is left.
    """
    balls = np.arange(len(network.held)) if balls is None else np.asarray(balls)
    contacts = np.arange(len(network.bond)) if contacts is None else np.asarray(contacts)
    number = np.full(len(network.held), -1)
    number[balls] = np.arange(len(balls))
    bond = number[network.bond[contacts]]
    whole = np.all(bond >= 0, axis=1)
    kept = {"bond": bond[whole]}
    for names, which in (
        (("held", "masses", "position", "radius"), balls),
        (("stiffness", "normal", "distance", "force", "tangential"), contacts[whole]),
    ):
        values = {name: getattr(network, name) for name in names}
        kept |= {name: value[which] for name, value in values.items() if value is not None}
    return dataclasses.replace(network, **kept)


def tangents(normal):
    """Return the directions across normals, an array like them for each. Not collective."""
    if normal.shape[1] == 2:
        return [np.stack([-normal[:, 1], normal[:, 0]], axis=1)]
    axis = np.eye(3)[np.argmin(np.abs(normal), axis=1)]
    first = np.cross(normal, axis)
    first /= np.linalg.norm(first, axis=1)[:, None]
    return [first, np.cross(normal, first)]


def _cross(a, b):
    """Return a x b, in two dimensions its component along z, shape (n, 1 or 3)."""
    if a.shape[1] == 3:
        return np.cross(a, b)
    return (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])[:, None]
