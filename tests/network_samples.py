"""Networks to test with, and a naive reference: energies summed contact by contact.

Nothing in the reference comes from pgran but what a network is made of. Its unknowns are
displacements and angles as they are, not mass-weighted; numbers have the digits that mpmath works
with.
"""

import dataclasses

import mpmath
import numpy as np
from mpmath import mp, mpf
from samples import SOLVERS

from pgran.medium.bonds import bond_ends
from pgran.medium.dissipation import FIELDS
from pgran.medium.network import Network
from pgran.medium.springs import AT_REST, DRIVEN

exactly = np.frompyfunc(lambda x: mpf(float(x)), 1, 1)


class NetworkReference:
    """K, L, C / beta, drag and M of all balls, dense arrays of mpmath's numbers.

    S = K + i L + s beta C + (s^2 + s drag) M, drag a number an unknown.
    """

    def __init__(self, network):
        """Sum over the contacts."""
        self.network = network
        self.axes = d = 1 if network.displacement == "scalar" else network.normal.shape[1]
        self.turns = {2: 1, 3: 3}[d] if network.displacement == "rotations" else 0
        size = len(network.held) * (d + self.turns)
        self.K, self.C, self.L = (np.full((size, size), mpf(0)) for _ in range(3))
        self.contacts = [self._contact(number, bond) for number, bond in enumerate(network.bond)]
        for number in range(len(self.contacts)):
            here, elastic, lossy = self.contact(number)
            self.K[here] += elastic
            self.C[here] += lossy
            self.L[here] += self.loss(number)
        inertia = np.repeat(exactly(network.masses)[:, None], d + self.turns, axis=1)
        if self.turns:
            part = mpf(1) / 2 if d == 2 else mpf(2) / 5
            inertia[:, d:] *= part * exactly(network.radius)[:, None] ** 2
        free = np.repeat(network.held == 0, d + self.turns)
        motion = np.full((len(network.held), d + self.turns), mpf(0))
        along = exactly(network.direction)
        motion[network.held == 2, :d] = along
        matrices = self.whole = self.K, self.C, self.L
        self.free, self.motion = free, motion.ravel()
        self.drive_K, self.drive_C, self.drive_L = (-(X @ motion.ravel())[free] for X in matrices)
        if network.push is not None:
            push = np.pad(network.push, ((0, 0), (0, self.turns)))
            self.drive_K = self.drive_K + exactly(push.ravel()[free])
        self.K, self.C, self.L = (X[np.ix_(free, free)] for X in matrices)
        drag = np.zeros(len(network.held)) if network.drag is None else network.drag
        self.drag = np.repeat(exactly(drag), d + self.turns)[free]
        self.M = inertia.ravel()[free]
        self.read = along if network.component == "drive" else None
        if self.read is None:
            self.read = exactly(np.eye(d)["xyz".index(network.component)])

    def contact(self, number):
        """Where a contact stands, and what it adds to K and to C / beta."""
        (here, along, slip, bent), net = self.contacts[number], self.network
        k, kt = self.stiffnesses(number)
        elastic = k * along + kt * slip
        if net.displacement != "scalar" and net.force is not None:
            elastic = elastic + mpf(float(net.force[number])) * bent
        shares = self.shares(number)
        return here, elastic, shares[0] * self.law(k) * along + shares[1] * self.law(kt) * slip

    def shares(self, number):
        """The parts of beta of a contact, along its normal and its tangents, before the law."""
        net = self.network
        share = across = 1.0 if net.dashpot is None else net.dashpot[number]
        if net.tangential_dashpot is not None:
            across = net.tangential_dashpot[number]
        return mpf(float(share)), mpf(float(across if net.damped == "all" else 0.0))

    def stiffnesses(self, number):
        """The stiffness of a contact, and along its tangents."""
        net, k = self.network, mpf(float(self.network.stiffness[number]))
        if net.displacement == "scalar" or net.tangential is None:
            return k, mpf(0)
        return k, mpf(float(net.tangential[number]))

    def kappa(self, number, k, tangent, s):
        """What a spring of a contact pulls with at s, if its stiffness was k."""
        eta = mpf(0) if self.network.loss is None else mpf(float(self.network.loss[number]))
        beta = mpf(float(self.network.damping)) * self.shares(number)[tangent]
        return k * mpmath.mpc(1, eta) + s * beta * self.law(k)

    def law(self, k):
        """(|k| / k_ref)^p."""
        power = self.network.damping_power
        if not power:
            return mpf(1)
        return (abs(k) / mpf(self.network.damping_reference)) ** mpf(power) if k else mpf(0)

    def loss(self, number):
        """What a contact adds to L."""
        if self.network.loss is None:
            return mpf(0)
        (_, along, slip, _), (k, kt) = self.contacts[number], self.stiffnesses(number)
        return mpf(float(self.network.loss[number])) * (k * along + kt * slip)

    def _contact(self, contact, bond):
        """Where it stands; K's parts for a constant, a tangential one, a force of 1."""
        net, d, width = self.network, self.axes, self.axes + self.turns
        n = exactly(net.normal[contact] if net.displacement != "scalar" else np.ones(1))
        n = n / mp.sqrt(n @ n)
        moved = np.concatenate([-np.eye(d, width), np.eye(d, width)], axis=1)
        moved = exactly(moved)
        along = np.multiply.outer(n, n)
        across, slip = exactly(np.eye(d)) - along, moved.copy()
        if self.turns:
            for end, ball in enumerate(bond):
                for axis in range(self.turns):  # R theta x n
                    theta = np.eye(3)[2 if d == 2 else axis]
                    turned = np.cross(theta, [*map(float, net.normal[contact]), 0.0][:3])[:d]
                    lever = mpf(float(net.radius[ball])) / mp.sqrt(
                        sum(exactly(net.normal[contact]) ** 2)
                    )
                    slip[:, end * width + d + axis] -= lever * exactly(turned)
        places = np.concatenate([np.arange(ball * width, (ball + 1) * width) for ball in bond])
        sliding = slip.T @ across @ slip
        bent = 0 * sliding
        if net.force is not None:
            bent = -(moved.T @ across @ moved) / mpf(float(net.distance[contact]))
        return np.ix_(places, places), moved.T @ along @ moved, sliding, bent

    def system(self, s):
        """S."""
        s = mpmath.mpmathify(s)
        S = self.K + s * mpf(float(self.network.damping)) * self.C
        if self.network.loss is not None:
            S = S + mpmath.mpc(0, 1) * self.L
        S[np.diag_indices_from(S)] += (s * s + s * self.drag) * self.M
        return S

    def amplitudes(self, s, sites):
        """What detectors read, by Gaussian elimination; infinite where S is singular."""
        S, s = self.system(s), mpmath.mpmathify(s)
        beta = mpf(float(self.network.damping))
        force = self.drive_K + s * beta * self.drive_C
        if self.network.loss is not None:
            force = force + mpmath.mpc(0, 1) * self.drive_L
        u = eliminated(S, force)
        if u is None:
            return [mp.inf] * len(sites)
        u, free = u.reshape(-1, self.axes + self.turns), np.flatnonzero(self.network.held == 0)
        return [self.read @ u[np.searchsorted(free, site), : self.axes] for site in sites]

    def eigenvalues(self):
        """Those of K f = lambda M f, times the median mass, in double precision of |M^-1/2 K|."""
        return np.linalg.eigvalsh(self.weighted(self.K).astype(float))

    def weighted(self, matrix):
        """A matrix in mass-weighted unknowns."""
        scale = np.array([mp.sqrt(mpf(float(self.median)) / m) for m in self.M])
        return scale[:, None] * matrix * scale

    @property
    def median(self):
        """The median mass of all balls."""
        return np.median(self.network.masses)

    def damping_exceeds(self, least):
        """Whether C, drag in it, - least M / median is positive definite, by Cholesky."""
        A = self.C + np.diag(self.M * self.drag) / mpf(float(self.network.damping))
        A = A - np.diag(self.M) * (mpf(float(least)) / mpf(float(self.median)))
        for n in range(len(A)):
            if not A[n, n] > 0:
                return False
            A[n + 1 :, n + 1 :] -= np.multiply.outer(A[n + 1 :, n], A[n, n + 1 :]) / A[n, n]
        return True


def eliminated(S, f, least=0):
    """The solutions of S x = f, a column each, with row pivoting; None where S is singular.

    So it is where a pivot is no larger than the part `least` of its row.
    """
    A, order = np.column_stack([S, f]), len(S)
    for n in range(order):
        pivot = n + int(np.argmax([abs(x) for x in A[n:, n]]))
        A[[n, pivot]] = A[[pivot, n]]
        if not abs(A[n, n]) > least * max(map(abs, S[n])):
            return None
        A[n, n:] /= A[n, n]
        rows = [p for p in range(order) if p != n and A[p, n]]
        A[rows, n:] -= np.multiply.outer(A[rows, n], A[n, n:])
    return A[:, order:].reshape(np.shape(f))


def as_network(lattice, **others):
    """A lattice as a network of its bonds in the same order, and two balls for its walls."""
    balls, there = lattice.size, lattice.existing
    ends = bond_ends(np.arange(balls).reshape(lattice.shape))
    ends[lattice.drive == 1, 1] = balls + 1
    ends[ends < 0] = balls
    held = np.zeros(balls + 2, int)
    held[balls:] = AT_REST, DRIVEN if lattice.push is None else AT_REST
    same = {name: getattr(lattice, name) for name in FIELDS}
    same |= {"masses": lattice.mass, "kmax": lattice.kmax}
    if lattice.push is not None:
        same["push"] = np.append(lattice.push, [0.0, 0.0])[:, None]
    return Network(ends[there], lattice.constants[there], held, **same | others)


def random_network(seed, balls=9):
    """A network of any kind, each s at which it is driven, detectors and tolerance.

    Parts may dangle or float, contacts may be double; masses over six decades, constants over as
    many, some of them negative, any damping or none.
    """
    rng = np.random.default_rng([17, seed])
    displacement = rng.choice(["scalar", "vector", "rotations"])
    d = int(rng.integers(2, 4))
    count = int(rng.integers(2, balls if displacement == "scalar" or d == 2 else balls - 3))
    if displacement == "scalar":
        count *= 2
    floating = rng.random() < 0.15
    first = np.arange(1, count)
    reach = 1 if rng.random() < 0.2 else count  # a chain, along which amplitudes fall
    tree = [(int(rng.integers(max(0, i - reach), i)), int(i)) for i in first]
    tree = [bond for bond in tree if not floating or rng.random() < 0.8]
    more = rng.integers(0, count, (int(rng.integers(0, 3 * count)) if reach > 1 else 0, 2))
    bond = np.array([*tree, *more[more[:, 0] != more[:, 1]].tolist()]).reshape(-1, 2)
    if not len(bond):
        bond = np.array([[0, 1]])
    if rng.random() < 0.3:
        bond = np.concatenate([bond, bond[rng.integers(0, len(bond), 2)]])
    held = np.zeros(count, dtype=int)
    held[0] = 2
    if count > 3:
        held[rng.integers(1, count)] = rng.integers(1, 3)
    contacts = len(bond)

    def wide(size, decades=6):
        return 10 ** (-decades * rng.random(size))

    narrow = rng.random() < 0.5
    stiffness = rng.uniform(0.5, 1, contacts) if narrow else wide(contacts)
    if rng.random() < 0.15:
        stiffness[rng.integers(contacts)] *= -1
    masses = 1e3 * wide(count) if rng.random() < 0.5 else np.ones(count)
    damping = 0.0 if rng.random() < 0.25 else 10 ** rng.uniform(-4, 1)
    others = {}
    if displacement != "scalar":
        others["position"] = rng.uniform(0, 2, (count, d))
        others["direction"] = rng.standard_normal(d) if rng.random() < 0.6 else None
        others["component"] = str(rng.choice(["drive", *"xyz"[:d]]))
        isotropic = rng.random() < 0.2  # components alike, so that their errors are, too
        if isotropic:
            others["direction"], others["component"] = rng.choice([-1.0, 1.0], d), "drive"
        others["damped"] = "normal" if rng.random() < 0.25 else "all"
        if rng.random() < 0.3:
            others["force"] = stiffness * rng.uniform(0, 0.2, contacts)
        if displacement == "rotations" or rng.random() < 0.4:
            others["tangential"] = wide(contacts) if rng.random() < 0.5 else 0.7 * np.abs(stiffness)
        if isotropic:
            others |= {"tangential": stiffness, "damped": "all", "force": None}
        if displacement == "rotations":
            others["radius"] = 10 ** rng.uniform(-1, 0.5, count)
    network = Network(bond, stiffness, held, masses, damping, str(displacement), **others)
    free = np.flatnonzero(held == 0)
    eigenvalues = NetworkReference(network).eigenvalues()
    top = np.sqrt(np.abs(eigenvalues).max() / network.mass)
    omegas = list(top * 10 ** rng.uniform(-3, 0.3, 2))
    if rng.random() < 0.2:
        omegas.append(float(np.sqrt(abs(rng.choice(eigenvalues)) / network.mass)) or top)
    if rng.random() < 0.3:
        omegas.append(top * 10 ** rng.uniform(0.3, 1.5))
    points = [1j * omega for omega in omegas]
    points.append(top * 10 ** rng.uniform(-3, 0) * np.exp(1j * rng.uniform(-1.5, 1.5)))
    if eigenvalues[0] < 0:  # where an unstable network's S is nearly singular
        points.append(complex(1.0001 * np.sqrt(-eigenvalues[0] / network.mass)))
    sites = rng.choice(free, min(2, len(free)), replace=False)
    solver = "default" if rng.random() < 0.4 else list(SOLVERS)[rng.integers(len(SOLVERS))]
    tolerance = 10 ** rng.uniform(-10, -1)
    return RandomNetwork(seed, network, np.array(points), sites, solver, tolerance)


@dataclasses.dataclass(frozen=True)
class RandomNetwork:
    """A network, how it is driven, where it is read, how it is solved, and how accurately."""

    seed: int
    network: Network
    points: np.ndarray
    sites: np.ndarray
    solver: str
    tolerance: float


def small_network(seed):
    """A random network of fewer balls."""
    return random_network(seed, balls=7)


def unstable_network(seed):
    """Return a random network with springs of negative constants, over twelve decades."""
    case, rng = random_network(seed), np.random.default_rng([18, seed])
    stiffness = np.abs(case.network.stiffness)
    weak = rng.integers(0, len(stiffness), rng.integers(1, 3))
    stiffness[weak] *= -(10 ** rng.uniform(-12, 0, len(weak)))
    network = dataclasses.replace(case.network, stiffness=stiffness, damping=0.0, kmax=None)
    return dataclasses.replace(case, network=network)


def exact_network_force(network, s):
    """The force on the driven balls, along their motion, of S with no ball left out."""
    whole = NetworkReference(dataclasses.replace(network, held=0 * network.held))
    width, s = whole.axes + whole.turns, mpmath.mpmathify(complex(s))
    spring = whole.K + s * mpf(network.damping) * whole.C
    if network.loss is not None:
        spring = spring + mpmath.mpc(0, 1) * whole.L
    motion = np.full((len(network.held), width), mpf(0))
    motion[network.held == 2, : whole.axes] = [mpf(float(x)) for x in network.direction]
    motion, free = motion.ravel(), np.repeat(network.held == 0, width)
    S = spring[np.ix_(free, free)].astype(object)
    drag = 0.0 if network.drag is None else exactly(network.drag)
    drag = np.repeat(drag * np.ones(len(network.held)), width)[free]
    S[np.diag_indices_from(S)] += (s * s + s * drag) * whole.M[free]
    u = eliminated(S, -(spring @ motion)[free])
    moved = motion + 0
    moved[free] = u
    return motion @ spring @ moved
