"""Springs as rows of B, with their forces, sizes and rounding.

b u is how far a spring of the row b is lengthened, so K = B^T diag(k) B. Dashpots act likewise
(`pgran.medium.dissipation`). Balls at rest and driven ones are no unknowns; what is driven
lengthens springs beside b u.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pgran.medium.base import EPSILON
from pgran.medium.dissipation import Damped

FREE, AT_REST, DRIVEN = 0, 1, 2
# How SuperLU factors matrices that are symmetric, in the order that they have.
SYMMETRIC = {"diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}


@dataclass(frozen=True, eq=False)
class Springs:
    """The rows of B in mass-weighted unknowns: blocks of a spring for each contact.

    The blocks are called `normal`, the first one; `tangential`, of the tangential stiffness;
    `pre_stress`; or `transverse`, both in one where balls do not turn.
    """

    unknowns: int  # how many there are
    blocks: tuple
    # Shapes (springs, w): unknowns, -1 where there is none, and the entries of B, which may be one
    # row for all. Those of a contact's first ball are in the first half.
    columns: np.ndarray
    values: np.ndarray
    # Shapes (springs,). How far each is lengthened by the driven balls' motion of size 1, as by B,
    # with magnitudes of what may cancel, and as by `D`; its constant k, and that without
    # pre-stress, which grows with the contact's stiffness; its part of beta, before the law that
    # depends on stiffness and by it; eta.
    drive: np.ndarray
    drive_sizes: np.ndarray
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
    """Return sparse rows (n * axes, axes * balls) that part the balls of contacts along each axis.

    `ends` (n, 2) are numbers of free balls, -1 for one that is held.
    """
    ends = np.repeat(ends, axes, axis=0)
    along = np.arange(len(ends))[:, None] % axes
    columns = np.where(ends >= 0, ends * axes + along, -1)
    return sparse_rows(columns, np.array([-1.0, 1.0]), axes * balls)


def norm_of(B, constants):
    """Return no less than |B^T diag(constants) B|_2, of constants that are not negative."""
    B = abs(B)
    return 1.01 * float((B.T @ (constants * (B @ np.ones(B.shape[1])))).max())


def _symmetric(B, constants):
    """Return B^T diag(constants) B, sparse, exactly symmetric as it is stored."""
    product = B.T @ B.multiply(constants[:, None])
    return 0.5 * (product + product.T)  # products of sparse matrices are symmetric but for rounding


def stiffness_matrix(medium):
    """Return K, sparse, exactly symmetric as it is stored."""
    return _symmetric(medium.springs.B, medium.springs.constants).tocsr()


def quadratic(medium, scale=1.0):
    """Return K, C and m of S(s) = K + s C + s^2 m, sparse, all damping in C.

    K is complex where springs lose energy, K (1 + i eta). Unknowns are the medium's over a scale.
    """
    from scipy.sparse import diags

    B, m = medium.springs.B.multiply(scale), medium.mass * scale**2
    K, C = (_symmetric(B, k) for k in (medium.moduli, medium.damping * medium.springs.damped))
    if medium.drags is not None:
        C = C + diags(m * medium.drags)
    return K.tocsr(), C.tocsr(), m


def drive_of(medium):
    """Return both parts of the drive f(s) = f + s f', over the unknowns."""
    springs = medium.springs
    parts = medium.moduli, medium.damping * springs.damped
    rest, dashpots = (-springs.B.T @ (part * springs.drive) for part in parts)
    return rest + (0.0 if medium.pushed is None else np.ravel(medium.pushed)), dashpots


class Elastic(Damped):
    """What follows from the springs of a medium.

    Each of lattice and network has arrays over all springs, `constants`, `damped_springs`, `losses`
    and `drive`, how far what is driven lengthens them when it moves by 1; and as quick as it can
    `stretch`, which is B, and its adjoint `spread`. These hold springs in blocks (n, ...), those of
    each axis of a lattice in their own; `blocks` splits an array over all springs likewise.
    """

    @cached_property
    def semidefinite(self):
        """Whether K has no negative eigenvalues for certain, as all constants are positive."""
        return bool(np.all(self.constants >= 0))

    def restoring_forces(self, fields):
        """Return K f = B^T diag(k) B f for fields of shape (n, *shape)."""
        blocks = zip(self.blocks(self.constants), self.stretch(fields), strict=True)
        return self.spread(k * longer for k, longer in blocks)

    def stretched(self, fields, wall):
        """Yield how far fields (n, *shape) lengthen springs, (n, springs), their constants and d.

        What is driven moves by `wall`, shape (n,).
        """
        of_springs = map(self.blocks, (self.drive, self.constants, self.damped_springs))
        for longer, *values in zip(self.stretch(fields), *of_springs, strict=True):
            longer = longer.reshape(len(fields), -1)
            drive, constants, damped = (value.ravel() for value in values)
            driven = np.flatnonzero(drive)
            longer[:, driven] += wall[:, None] * drive[driven]
            yield longer, constants, damped

    def _force_of_drive(self, constants):
        """Return the force of the drive, moved by 1, through springs of some constants."""
        return -self.spread(block[None] for block in self.blocks(constants * self.drive))[0]

    @property
    def driving(self):
        """The force of the drive at rest on each unknown."""
        force = self._force_of_drive(self.constants)
        return force if self.pushed is None else force + self.pushed

    @property
    def drive_norms(self):
        """|f|_2 at rest, and that of the dashpots' part for beta = 1."""
        damped = self._force_of_drive(self.damped_springs)
        return float(np.linalg.norm(self.driving)), float(np.linalg.norm(damped))

    def pull(self, s):
        """Return sum kappa(s) w^2, the force that moves what is driven by 1 while balls stay."""
        stiffness, damping = self.pulls
        return stiffness + s * damping

    @cached_property
    def pulls(self):
        """What `pull` is at s = 0, and by how much it grows with s."""
        driven = np.flatnonzero(self.drive)
        squares = self.drive[driven] ** 2
        damped = np.sum(self.damped_springs[driven] * squares)
        return np.sum(self.moduli[driven] * squares), self.damping * damped

    def pull_rounding(self, size):
        """Return how much rounding changes `pull(s)`, at most, for an |s|."""
        sizes = self.springs.drive_sizes
        driven = np.flatnonzero(sizes)
        squares = sizes[driven] ** 2
        stiff = np.sum(np.abs(self.moduli[driven]) * squares)
        damped = self.damping * np.sum(self.damped_springs[driven] * squares)
        return (len(driven) + 8) * EPSILON * (stiff + size * damped)

    @cached_property
    def relaxation_rate(self):
        """The largest k / beta of a spring that pulls back, infinite if one has no dashpot."""
        if self.losses is not None or not self.damping:
            return np.inf  # with a loss angle no disc holds all damped modes
        pulls = self.constants > 0
        with np.errstate(all="ignore"):
            rates = self.constants[pulls] / (self.damping * self.damped_springs[pulls])
        return float(rates.max(initial=0.0))
