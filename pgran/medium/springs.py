"""Springs of a network as rows of B, and what follows from them: forces, sizes, rounding.

A contact of the balls i and j is a few springs; b u is how far each is stretched:

- along the normal n, from i to j, of the contact's stiffness: b u = n . (u_j - u_i);
- along each tangent t, of its tangential stiffness: b u = t . (u_j - u_i), with rotations less
  (R_i theta_i + R_j theta_j) . (n x t), which is zero for rolling;
- along each tangent, of the constant -F / d, if the contact bears a force F at a distance d:
  b u = t . (u_j - u_i) (pre-stress).

So K = B^T diag(k) B. Dashpots act on the relative velocity at each contact, or on its normal part
(`pgran.medium.dissipation`). Balls at rest and driven ones are no unknowns.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pgran.medium.rounding import EPSILON

FREE, AT_REST, DRIVEN = 0, 1, 2


@dataclass(frozen=True, eq=False)
class Springs:
    """The rows of B in mass-weighted unknowns: blocks of a spring for each contact."""

    unknowns: int  # how many there are
    # What each block is, the first one `normal`: `tangential`, of the tangential stiffness,
    # `pre_stress`, or `transverse`, both in one where balls do not turn.
    blocks: tuple
    # Shapes (springs, w): unknowns, -1 where there is none, and the entries of B, which may be one
    # row for all. Those of a contact's first ball are in the first half.
    columns: np.ndarray
    values: np.ndarray
    # Shapes (springs,): how far the driven balls' motion, of size 1, stretches each; the same with
    # the first ball's part turned around, as in `D`; constants; constants without pre-stress, which
    # grow with a contact's stiffness; parts of beta, before the law that depends on stiffness and
    # by it; loss angles eta.
    drive: np.ndarray
    drive_apart: np.ndarray
    constants: np.ndarray
    elastic: np.ndarray
    shares: np.ndarray
    damped: np.ndarray
    loss_angles: np.ndarray

    @cached_property
    def B(self):  # noqa: N802
        """The rows of B, sparse, shape (springs, unknowns)."""
        return sparse_rows(self.columns, self.values, self.unknowns)

    @cached_property
    def D(self):  # noqa: N802
        """B with the entries of each contact's first ball turned around, like B."""
        half = self.columns.shape[1] // 2
        turned = self.values * np.repeat([-1.0, 1.0], half)
        return sparse_rows(self.columns, turned, self.unknowns)

    @cached_property
    def lengths(self):
        """|b|_2 of each spring, shape (springs,)."""
        there = self.columns >= 0
        return np.sqrt(np.sum(there * self.values**2, axis=1))


def sparse_rows(columns, values, size):
    """Return rows of B as a sparse matrix; columns, of so many unknowns, are -1 for none."""
    from scipy.sparse import csr_matrix  # here: SciPy takes its time

    there = columns >= 0
    rows = np.repeat(np.arange(len(there)), np.count_nonzero(there, axis=1))
    entries = np.broadcast_to(values, there.shape)[there]
    return csr_matrix((entries, (rows, columns[there])), (len(there), size))


def differences(ends, axes, balls):
    """Return rows that part the two balls of each contact along each axis, sparse.

    `ends` (n, 2) are numbers of free balls, -1 for one that is held. There are n * axes rows of the
    axes * balls displacements of free balls.
    """
    ends = np.repeat(ends, axes, axis=0)
    along = np.arange(len(ends))[:, None] % axes
    columns = np.where(ends >= 0, ends * axes + along, -1)
    return sparse_rows(columns, np.array([-1.0, 1.0]), axes * balls)


def norm_of(B, constants):
    """Return no less than |B^T diag(constants) B|_2, of constants that are not negative."""
    B = abs(B)
    return 1.01 * float((B.T @ (constants * (B @ np.ones(B.shape[1])))).max())


def stiffness_matrix(medium):
    """Return K, sparse, exactly symmetric as it is stored."""
    springs = medium.springs
    K = springs.B.T @ springs.B.multiply(springs.constants[:, None])
    return (0.5 * (K + K.T)).tocsr()  # products of sparse matrices are symmetric but for rounding


def quadratic(medium):
    """Return K, C and m of S(s) = K + s C + s^2 m, sparse, all damping in C.

    K is complex where springs lose energy by themselves, K (1 + i eta).
    """
    from scipy.sparse import diags

    springs, K = medium.springs, stiffness_matrix(medium)
    C = springs.B.T @ springs.B.multiply(medium.damping * springs.damped[:, None])
    if medium.drags is not None:
        C = C + diags(medium.mass * medium.drags)
    if medium.losses is not None:
        L = springs.B.T @ springs.B.multiply(medium.losses[:, None])
        K = K + 0.5j * (L + L.T)
    return K.tocsr(), (0.5 * (C + C.T)).tocsr(), medium.mass


class Elastic:
    """The springs of a network; `bonds.ElasticBonds` answers the same for a lattice."""

    def stretched(self, fields, wall):
        """Yield how far fields (n, unknowns) lengthen springs, constants, parts of beta.

        What is driven moves by `wall`, shape (n,).
        """
        longer = (self.springs.B @ fields.T).T + wall[:, None] * self.springs.drive
        yield longer, self.springs.constants, self.springs.damped

    @property
    def damped_springs(self):
        """The parts of beta of all springs."""
        return self.springs.damped

    @cached_property
    def losses(self):
        """eta k of all springs, None where there is no loss angle."""
        return None if self.loss is None else self.springs.loss_angles * self.springs.elastic

    @cached_property
    def semidefinite(self):
        """Whether K has no negative eigenvalues for certain, as all constants are positive."""
        return bool(np.all(self.springs.constants >= 0))

    def restoring_forces(self, fields):
        """Return K f = B^T diag(k) B f for fields of shape (count, unknowns)."""
        B, constants = self.springs.B, self.springs.constants
        return (B.T @ (constants[:, None] * (B @ fields.T))).T

    @property
    def rows(self):
        """The largest |b|_2 of a contact, and what rounding adds to b^T x, in units of |x|_2."""
        values = self.springs.values
        size = float(np.sqrt(np.sum(values[: self.bonds] ** 2, axis=1)).max())
        return size, (values.shape[1] + 1) * EPSILON * size

    @property
    def driving(self):
        """The force of the drive at rest on each unknown."""
        force = -(self.springs.B.T @ (self.springs.constants * self.springs.drive))
        return force if self.pushed is None else force + self.pushed

    @cached_property
    def drive_norms(self):
        """|f|_2 at rest, and of what dashpots add to it for beta = 1."""
        damped = self.springs.B.T @ (self.springs.damped * self.springs.drive)
        return float(np.linalg.norm(self.driving)), float(np.linalg.norm(damped))

    @cached_property
    def _pulls(self):
        """Sums of k w^2, of d w^2 and of |k| w^2 over the springs that the drive stretches by w."""
        springs = self.springs
        squares = springs.drive**2
        parts = self.moduli, springs.damped, np.abs(self.moduli)
        return [(part @ squares).item() for part in parts]

    @property
    def pulls(self):
        """What `pull` is at s = 0, and by how much it grows with s."""
        stiffness, damped, _ = self._pulls
        return stiffness, self.damping * damped

    def pull_rounding(self, size):
        """Return how much rounding changes `pull(s)`, at most, for an |s|."""
        _, damped, stiffness = self._pulls
        stretched = np.count_nonzero(self.springs.drive)
        return (stretched + 8) * EPSILON * (stiffness + size * (self.damping * damped))

    @cached_property
    def dashpot_norm(self):
        """No less than |B^T diag(d) B|_2."""
        return norm_of(self.springs.B, self.springs.damped)

    @cached_property
    def relaxation_rate(self):
        """The largest k / beta of a spring that pulls back, infinite if one has no dashpot."""
        if self.losses is not None:
            return np.inf  # no disc holds all damped modes then
        pulls = self.springs.constants > 0
        with np.errstate(divide="ignore", over="ignore"):
            rates = self.springs.constants[pulls] / (self.damping * self.springs.damped[pulls])
        return float(rates.max(initial=0.0))

    @cached_property
    def stiffness_norm(self):
        """No less than |K|_2: the largest sum of magnitudes in a row."""
        B = abs(self.springs.B)
        sums = np.abs(self.springs.constants) * np.asarray(B.sum(axis=1)).ravel()
        return float((B.T @ sums).max())

    @cached_property
    def rounding(self):
        """How much rounding moves a residual, in units of the magnitudes that it is summed from.

        As `residual_rounding`: sums over the springs at an unknown, and over the unknowns that
        these couple it to.
        """
        met = int(np.bincount(self.springs.B.indices).max())
        return (met * (1 + self.springs.columns.shape[1]) + 12) * EPSILON


def springs_of(network):
    """Return the springs of a `network.Network`."""
    balls, components = len(network.held), network.components
    unknown = np.full((balls + 1, components), -1)
    unknown[network.free] = np.arange(network.size).reshape(-1, components)
    i, j = network.bond.T
    columns = np.concatenate([unknown[i], unknown[j]], axis=1)
    moving = np.zeros((balls, components))
    moving[network.held == DRIVEN, : network.axes] = network.direction
    first, second = moving[i], moving[j]
    weights = np.append(network.weights, 0.0)[columns]
    blocks, rows, constants, elastic, shares = zip(*_rows(network, i, j), strict=True)
    values, elastic = np.concatenate(rows), np.concatenate(elastic)
    shares = np.concatenate([np.broadcast_to(share, len(i)) for share in shares])
    angles = np.zeros(len(i)) if network.loss is None else network.loss

    def stretched(*moving):
        moving = np.concatenate(moving, axis=1)
        return np.einsum("sw,sw->s", values, np.tile(moving, (len(rows), 1)))

    return Springs(
        network.size,
        blocks,
        np.tile(columns, (len(rows), 1)),
        values * np.tile(weights, (len(rows), 1)),
        stretched(first, second),
        stretched(-first, second),
        np.concatenate(constants),
        elastic,
        shares,
        shares * network.law(elastic),
        np.tile(angles, len(blocks)),
    )


def _rows(network, i, j):
    """Return blocks: name, rows of B, constants, those without pre-stress, shares of beta."""
    # A row of a contact: -t (of u_i), the first ball's rotation, t (of u_j), the second's.
    still = np.zeros((len(i), network.turns))

    def row(t, first=still, second=still):
        return np.concatenate([-t, first, t, second], axis=1)

    share = 1.0 if network.dashpot is None else network.dashpot
    if network.displacement == "scalar":
        return [("normal", row(np.ones((len(i), 1))), network.stiffness, network.stiffness, share)]
    blocks = [("normal", row(network.normal), network.stiffness, network.stiffness, share)]
    nothing = np.zeros(len(i))
    pre_stress = nothing if network.force is None else -network.force / network.distance
    shear = nothing if network.tangential is None else network.tangential
    damped = share * float(network.damped == "all")
    if network.tangential_dashpot is not None:
        damped = network.tangential_dashpot
    # constants that are given, zeros too: amplitudes have derivatives by them
    bent, sheared = network.force is not None, network.tangential is not None or np.any(damped)
    across = tangents(network.normal)
    # n x t: of two tangents each is the other's, exactly
    levers = [np.ones((len(i), 1))] if len(across) == 1 else [across[1], -across[0]]
    for t, lever in zip(across, levers, strict=True):
        if not network.turns:
            kinds = [("transverse", row(t), shear + pre_stress, shear, damped)]
            wanted = [bent or sheared]
        else:
            # (R theta) . (n x t): what a ball's rotation adds to the slip along t
            turned = [-network.radius[end][:, None] * lever for end in (i, j)]
            kinds = [
                ("tangential", row(t, *turned), shear, shear, damped),
                ("pre_stress", row(t), pre_stress, nothing, 0.0),
            ]
            wanted = [sheared, bent]
        blocks += [kind for kind, there in zip(kinds, wanted, strict=True) if there]
    return blocks


def tangents(normal):
    """Return the directions across normals, an array like them for each."""
    if normal.shape[1] == 2:
        return [np.stack([-normal[:, 1], normal[:, 0]], axis=1)]
    axis = np.eye(3)[np.argmin(np.abs(normal), axis=1)]
    first = np.cross(normal, axis)
    first /= np.linalg.norm(first, axis=1)[:, None]
    return [first, np.cross(normal, first)]
