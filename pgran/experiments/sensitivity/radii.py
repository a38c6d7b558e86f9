"""How amplitudes depend on the radius of every ball, while the packing finds its rest anew.

A contact of the balls i and j has the normal n, from i to j, the stiffness k, the force F, the
distance d and the overlap h, F = c h^alpha. Let A be the driven field, z the adjoint of a detector,
Delta = A_j - A_i and zeta = z_j - z_i, what is driven counted in Delta, P = 1 - n n^T. The detector
sees a contact by its spring k along n and its pre-stress -F / d across, and so changes with

    k      a_k = -(n . zeta) (n . Delta)
    F      a_F = T / d,    T = zeta . P Delta
    d      a_d = -T F / d^2
    n      a_n = -kappa P [(n . Delta) zeta + (n . zeta) Delta],  kappa = k + F / d, with s beta
           where dashpots act along n only; the scalar model knows of a_k = -zeta Delta alone.

By laws of damping k moves what the contact pulls with by more, which multiplies a_k.

Radii that grow by r press neighbours apart by w, K w = B_n^T (k ds + F dln c), with K the stiffness
of the packing, pre-stress in it, B_n w = n . (w_j - w_i), and ds = r_i + r_j. Then dh = ds - B_n w,
dF = k dh + F dln c, dk = (alpha - 1) k dh / h + k dln c, dd = B_n w, dn = P (w_j - w_i) / d. So one
static solve for each detector gives the derivatives by all radii:

    q = a_k (alpha - 1) k / h + a_F k,   G = (a_d - q) n + a_n / d,   K y = B^T G,   eta = B_n y,
    dA_d/dR_p = sum over the contacts of p of [q + k eta + (a_k k + a_F F + F eta) dln c/dR_p].

With neighbours frozen the only change is dk = (alpha - 1) k r / h of the ball's own contacts.

Where A and z are wrong by at most a and b in the 2-norm, a product zeta Delta is wrong by at most
p = |zeta| l a + |Delta| l b + l^2 a b with l the norm of the contact's rows. The residual of
K y = B^T G, and what G is wrong by, count in dA_d/dR_p as far as the packing moves when p grows,
|K^-1 B_n^T (k ds + F dln c)|: a solve a ball, and a certified bound of |K^-1|. NumPy and SciPy
only.
"""

import dataclasses

import numpy as np

from pgran.balance.equilibrium import factored
from pgran.medium.base import EPSILON
from pgran.medium.springs import DRIVEN, differences, sparse_rows, stiffness_matrix

COLUMNS = 64  # balls whose growth is solved for at a time
ROUNDED = 64 * EPSILON  # of the product of magnitudes: more than all operations of a contact


def with_vectors(network):
    """Return the network whose balls move in all directions, as those of a packing do at rest."""
    if network.displacement == "vector":
        return network
    return dataclasses.replace(
        network, displacement="vector", direction=None, component="drive", damped="all"
    )


class Radii:
    """The derivatives of amplitudes by the radii of all free balls of a packing.

    `least` is a number below all eigenvalues of the packing's stiffness, 0 if none is certain;
    without `relax` neighbours stay where they are.
    """

    def __init__(self, network, relax=True, least=0.0):
        self.network, self.relax = network, relax
        packing = with_vectors(network)
        self.normal, self.distance = packing.normal, packing.distance
        i, j = network.bond.T
        one, other = network.radius[i], network.radius[j]
        # d ln c by the radius of the first ball of each contact, and by that of the second
        self.curvature = (network.power - 1) * np.stack([other / one, one / other]) / (one + other)
        moving = np.zeros((len(network.held), network.axes))
        moving[network.held == DRIVEN] = network.direction
        self.drive = moving[j] - moving[i]
        self.apart = _differences(network)
        squares = np.asarray(self.apart.power(2).sum(axis=1)).ravel()
        self.lengths = np.sqrt(squares[:: network.axes])
        ends = [sparse_rows(end[:, None], np.ones(1), len(network.held)).T for end in (i, j)]
        self.ends = [end.tocsr()[network.free] for end in ends]
        self.terms = 8 + int(np.bincount(network.bond.ravel()).max())  # of a sum at a ball
        if relax:
            pushes = [network.stiffness + network.force * x for x in self.curvature]
            pairs = zip(self.ends, pushes, strict=True)
            self.static = Static(packing, least, sum(end.multiply(x) for end, x in pairs))

    def parted(self, fields):
        """Return how far amplitudes, then adjoints, part the balls of each contact.

        Shape (1 + nd, contacts, axes), for fields (1 + nd, unknowns).
        """
        parted = (self.apart @ fields.T).T.reshape(len(fields), -1, self.network.axes)
        parted[0] += self.drive
        return parted

    def derivatives(self, s, fields, errors):
        """Return dA/dR at one s, complex (nd, free balls), and bounds of its error.

        `fields` (1 + nd, unknowns) are the amplitudes of all unknowns, then the adjoints, `errors`
        (1 + nd,) bound their errors in the 2-norm. NaN where the packing can move freely; infinite
        bounds where it is not known for certain to be stable.
        """
        delta, *zetas = self.parted(fields)
        delta_error, *zeta_errors = errors + 4 * EPSILON * np.linalg.norm(fields, axis=1)
        pairs = [
            self._by_one_detector(s, delta, zeta, delta_error, error)
            for zeta, error in zip(zetas, zeta_errors, strict=True)
        ]
        values, bounds = (np.array(part) for part in zip(*pairs, strict=True))
        return values, np.where(np.isnan(bounds), np.inf, bounds)

    def _by_one_detector(self, s, delta, zeta, delta_error, zeta_error):
        """Return the derivatives of the amplitude at one detector, and their bounds."""
        net, n, d = self.network, self.normal, self.distance
        k, F, hardening = net.stiffness, net.force, (net.power - 1) * net.stiffness / net.overlap
        a_k, a_F, a_d, a_n = self._slopes(s, delta, zeta)
        # p, what all of them are wrong by at most
        size, zeta_size = np.linalg.norm(delta, axis=1), np.linalg.norm(zeta, axis=1)
        a, b = self.lengths * delta_error, self.lengths * zeta_error
        p = 1.01 * (zeta_size * a + size * b + a * b) + ROUNDED * size * zeta_size
        if net.has_law:  # of kappa, which the stiffness moves
            slope = net.slope(s)[: net.bonds]
            a_k, p = a_k * slope, p * np.maximum(1.01 * np.abs(slope), 1.0)
        if not self.relax:
            return self._summed(a_k * hardening), self._summed(np.abs(p * hardening))
        # the static solve: where the packing goes moves q, forces and normals
        across = float(net.displacement == "vector")
        q, q_error = a_k * hardening + a_F * k, p * (hardening + across * k / d)
        G = (a_d - q)[:, None] * n + a_n / d[:, None]
        G_error = q_error + across * p * (F / d**2 + 2 * np.abs(self._turning(s)) / d)
        eta, eta_error, bound = self.static.solved(G, G_error)
        # the sums over the contacts of each ball, and what they are wrong by
        curved, curved_error = a_k * k + a_F * F + F * eta, p * (k + across * F / d) + F * eta_error
        value = self._summed(q + k * eta, curved)
        bound = bound + self._summed(q_error + k * eta_error, curved_error)
        total = self._summed(np.abs(q) + k * np.abs(eta), np.abs(curved))
        return value, 1.01 * (bound + self.terms * EPSILON * total)

    def _slopes(self, s, delta, zeta):
        """Return a_k, a_F, a_d (contacts,) and a_n (contacts, axes)."""
        n, d, F = self.normal, self.distance, self.network.force
        if self.network.displacement == "scalar":
            return -(zeta * delta)[:, 0], 0.0 * d, 0.0 * d, 0.0 * n
        along, across = np.sum(n * delta, axis=1), np.sum(n * zeta, axis=1)
        T = np.sum(zeta * delta, axis=1) - across * along
        turned = along[:, None] * zeta + across[:, None] * delta
        turned -= 2 * (along * across)[:, None] * n
        return -across * along, T / d, -T * F / d**2, -self._turning(s)[:, None] * turned

    def _turning(self, s):
        """Return kappa of all contacts."""
        net = self.network
        if net.has_law:
            kappa = net.kappa(s).reshape(-1, net.bonds)
            return kappa[0] - kappa[-1]  # that of a tangent bears the pre-stress, -F / d
        dashpots = s * net.damping if net.damped == "normal" else 0.0
        return net.stiffness + net.force / net.distance + dashpots

    def _summed(self, own, curved=None):
        """Return sums over the contacts of each free ball; `curved` counts by dln c/dR."""
        return sum(
            end @ (own if curved is None else own + curved * curvature)
            for end, curvature in zip(self.ends, self.curvature, strict=True)
        )


class Static:
    """The stiffness K of a packing under its forces, factored; `least` as in `Radii`.

    `pushes`, sparse (free balls, contacts), are the forces in contacts as balls grow where they
    are: `reach` bounds how far that moves the packing, in the 2-norm.
    """

    def __init__(self, packing, least, pushes):
        springs = packing.springs
        self.normal, self.least = packing.normal, least
        self.B, self.constants = springs.B, springs.constants
        self.lengths, self.rounding = springs.lengths[: packing.bonds], packing.rounding
        self.apart = _differences(packing)
        self.K = stiffness_matrix(packing).tocsc()
        self.factors = factored(self.K)  # None where some ball moves freely
        self.reach = np.full(pushes.shape[0], np.inf)
        if self.factors is not None and least > 0:
            loads = (pushes @ self.B[: packing.bonds]).tocsr()
            for first in range(0, len(self.reach), COLUMNS):
                some = slice(first, first + COLUMNS)
                self.reach[some] = self._reaches(loads[some].toarray().T)

    def _reaches(self, loads):
        """Return bounds of |K^-1 b|_2 for the columns b."""
        moved = self.factors.solve(loads)
        left = np.linalg.norm(loads - self.K @ moved, axis=0)
        left += self.rounding * np.linalg.norm(self._sizes(np.abs(moved)), axis=0)
        return 1.01 * (np.linalg.norm(moved, axis=0) + left / self.least)

    def _sizes(self, y):
        """Return |K| y for positive columns y, all summed up by magnitudes."""
        B = abs(self.B)
        return B.T @ (np.abs(self.constants)[:, None] * (B @ y))

    def solved(self, G, G_error):
        """Return eta = B_n y, K y = B^T G, its rounding, and what y is wrong by in sums over balls.

        G, complex (contacts, axes), is wrong by at most `G_error` (contacts,).
        """
        if self.factors is None:
            return np.full(len(G), np.nan), 0.0, np.inf
        pulls = self.apart.T @ G.ravel()
        force = np.stack([pulls.real, pulls.imag], axis=1)
        y = self.factors.solve(force)
        y += self.factors.solve(force - self.K @ y)
        left = np.linalg.norm(force - self.K @ y)
        sides, apart = np.repeat(np.linalg.norm(G, axis=1), G.shape[1]), abs(self.apart)
        rounded = np.linalg.norm(self._sizes(np.abs(y))) + 2 * np.linalg.norm(apart.T @ sides)
        left += self.rounding * rounded
        left += np.linalg.norm(apart.T @ np.repeat(G_error, G.shape[1]))
        y = y[:, 0] + 1j * y[:, 1]
        eta = np.sum(self.normal * (self.apart @ y).reshape(G.shape), axis=1)
        rounding = 8 * EPSILON * np.linalg.norm(y) * self.lengths
        return eta, rounding, 1.01 * left * self.reach


def _differences(network):
    """Return rows that part the balls of each contact along each axis, of weighted unknowns."""
    from scipy.sparse import diags  # here: SciPy takes its time

    number = np.full(len(network.held), -1)
    number[network.free] = np.arange(len(network.free))
    parted = differences(number[network.bond], network.axes, len(network.free))
    return (parted @ diags(network.weights)).tocsr()
