"""What a signal depends on: small media, pgran's answers for them, and those to all digits."""

import dataclasses
import functools

import mpmath
import numpy as np
import pytest
from law_samples import with_laws
from mpi4py import MPI
from mpmath import mp, mpf
from network_samples import NetworkReference, as_network, eliminated, exactly, random_network
from samples import SOLVERS, assert_same, bond_arrays

from pgran import InputError, Lattice, Network, heat, sensitivity
from pgran.run.crew import Crew

number = np.frompyfunc(lambda x: mpmath.mpmathify(complex(x)), 1, 1)
STALE = "-steady_ksp_type bcgs -steady_pc_type cholesky"
TOUCH = [[0, 1], [1, 2], [2, 3], [3, 1], [4, 2], [3, 4], [1, 3], [2, 1], [0, 4], [2, 0], [0, 3]]


def on_ranks(function, medium, omegas, sites, comm=MPI.COMM_SELF, ranks=1, **choices):
    """What a function returns, on every rank of `comm`; so many of them share a lattice."""
    with Crew(comm, ranks) as crew:
        return comm.bcast(function(medium, omegas, sites, crew, **choices))


derived = functools.partial(on_ranks, sensitivity)
heated = functools.partial(on_ranks, heat)


def assert_same_on_ranks(world, solve, medium, omegas, sites, names, **choices):
    """Bit for bit on any number of ranks, or to rounding where these share a lattice."""
    alone = solve(medium, omegas, sites, **choices)
    assert_same(solve(medium, omegas, sites, world, **choices), alone)
    if world.size > 1 and not medium.damping and solve is heated:
        with pytest.raises(InputError, match="that ranks share"):
            solve(medium, omegas, sites, world, world.size, **choices)
        return
    shared = solve(medium, omegas, sites, world, world.size, **choices)
    assert np.all(shared.converged_reason > 0)
    for name in names:
        if (one := getattr(alone, name)) is not None:
            difference = np.abs(one - getattr(shared, name)).max()
            assert difference <= 1e-10 * np.abs(one).max(), name


def packing(displacement, d=2, unit=1.0, damping=0.02, seed=7, **others):
    """Five balls, all of which touch, two of them twice; the first is driven, the last at rest."""
    rng, contacts = np.random.default_rng(seed), len(TOUCH)
    given = {}
    if displacement != "scalar":
        given = {"position": rng.uniform(0, 2, (5, d)), "direction": rng.uniform(1, 2, d)}
        given["tangential"] = unit * rng.uniform(0.2, 1, contacts)
        given["force"] = unit * rng.uniform(0.01, 0.03, contacts)
    if displacement == "rotations":
        given["radius"] = rng.uniform(0.3, 1, 5)
    return Network(
        TOUCH, unit * rng.uniform(0.5, 1, contacts), [2, 0, 0, 0, 1], unit * rng.uniform(0.3, 3, 5),
        unit * damping, displacement, **given | others
    )  # fmt: skip


class Exact(NetworkReference):
    """Driven states to all digits, and what changes when K, C or M of some balls do."""

    def __init__(self, medium):
        """Take a lattice as the network that it is."""
        super().__init__(as_network(medium) if isinstance(medium, Lattice) else medium)
        self.ends, self.beta = self.network.bond, mpf(float(self.network.damping))
        K, self.lossy, L = self.whole
        self.elastic = K if self.network.loss is None else K + mpmath.mpc(0, 1) * L
        shape = len(self.network.held), self.axes + self.turns
        self.inertia, self.dragged = (np.full(shape, mpf(0)) for _ in range(2))
        self.inertia.ravel()[self.free] = self.M
        self.dragged.ravel()[self.free] = self.drag

    def states(self, s, sites, changes=()):
        """The amplitudes A, and each detector's adjoint, of all balls; None if S is singular.

        `changes` are pairs of a place and what is added to S there.
        """
        s = mpmath.mpmathify(complex(s))
        S = self.elastic + s * self.beta * self.lossy
        S[np.diag_indices_from(S)] += (s * s + s * self.dragged.ravel()) * self.inertia.ravel()
        for here, added in changes:
            S[here] += added
        reading = np.full((len(sites), *self.inertia.shape), mpf(0))
        for row, site in zip(reading, sites, strict=True):
            row[site, : self.axes] = self.read
        reading = reading.reshape(len(sites), -1).T
        fixed = ~self.free
        force = -S[np.ix_(self.free, fixed)] @ self.motion[fixed] + s * 0
        right, least = np.column_stack([force, reading[self.free]]), mpf(10) ** (5 - mp.dps)
        found = eliminated(S[np.ix_(self.free, self.free)], right, least)
        if found is None:
            return None
        A, z = self.motion.copy() + s * 0, reading * 0
        A[self.free], z[self.free] = found[:, 0], found[:, 1:]
        return A, z.T, reading.T @ A

    def derivatives(self, s, A, z):
        """Derivatives of what detectors read, by name, exact because S is linear in everything."""
        s, width = mpmath.mpmathify(complex(s)), self.axes + self.turns
        found = {name: [] for name in ("stiffness", "tangential", "force", "damping", "mass")}
        for n, (here, along, slip, bent) in enumerate(self.contacts):
            at, (k, kt) = here[1].ravel(), self.stiffnesses(n)
            parts = along * self.slope(n, k, 0, s), slip * self.slope(n, kt, 1, s), bent
            for name, part in zip(found, [*parts, s * self.contact(n)[2]], strict=False):
                found[name].append(-(z[:, at] @ part @ A[at]))
        found = {name: np.array(rows).T for name, rows in found.items() if rows}
        found["damping"] = found["damping"].sum(axis=1)
        products = -(s * s + s * self.dragged.ravel()) * z * A
        inertia = self.inertia.ravel() / np.repeat(exactly(self.network.masses), width)
        found["mass"] = (products * inertia).reshape(len(z), -1, width).sum(axis=2)
        found["mass"] = found["mass"][:, self.network.held == 0]
        return found

    def slope(self, contact, k, tangent, s):
        """d kappa / d k of a spring."""
        if not (k and self.network.damping_power):
            return mpmath.mpc(1, 0 if self.network.loss is None else self.network.loss[contact])
        return mpmath.diff(lambda k: self.kappa(contact, k, tangent, s), k)

    def grown(self, contact, s, factor=None, overlap=None, hertz=None):
        """What heating a contact adds to S: Hertz's law, as it stands in the paper."""
        here, along, slip, *_ = self.contacts[contact]
        net = self.network
        k = mpf(float(net.stiffness[contact]))
        if factor is None and k:
            h = (2 * k / (3 * mpf(hertz))) ** 2
            if net.force is not None:
                h = mpf(3) / 2 * mpf(float(net.force[contact])) / k
            factor = mp.sqrt((h + mpf(overlap)) / h) if h + overlap > 0 and h else mpf(not h)
        elif factor is None:
            grown = mpf(3) / 2 * hertz * mp.sqrt(overlap)
            added = self.kappa(contact, grown, 0, s) - self.kappa(contact, mpf(0), 0, s)
            return here, added * along
        changes = [
            self.kappa(contact, mpf(factor) * k, tangent, s) - self.kappa(contact, k, tangent, s)
            for tangent, k in enumerate(self.stiffnesses(contact))
        ]
        return here, changes[0] * along + changes[1] * slip

    def warmed(self, s, sites, ball, **by):
        """The amplitudes with a ball warm; None if S is singular."""
        warm, s = np.flatnonzero(np.any(self.ends == ball, axis=1)), mpmath.mpmathify(complex(s))
        found = self.states(s, sites, [self.grown(contact, s, **by) for contact in warm])
        return found and found[2]

    def cut(self, s, sites, contact):
        """The amplitudes without a contact; None if S is singular."""
        here, elastic, lossy = self.contact(contact)
        added = -elastic - mpmath.mpmathify(complex(s)) * self.beta * lossy
        if self.network.loss is not None:
            added = added - mpmath.mpc(0, 1) * self.loss(contact)
        found = self.states(s, sites, [(here, added)])
        return found and found[2]


def assert_exact(found, medium, sites, **by):
    """Amplitudes after each change are those of elimination with 40 digits; return the errors."""
    if isinstance(medium, Lattice):
        sites = np.ravel_multi_index(np.transpose(sites), medium.shape)
    with mp.workdps(40):
        exact, kinds, errors = Exact(medium), {}, {}
        if found.warmed is not None:
            kinds["warmed"] = found.ball, lambda s, ball: exact.warmed(s, sites, ball, **by)
        if found.cut is not None:
            kinds["cut"] = range(medium.bonds), lambda s, contact: exact.cut(s, sites, contact)
        for name, (changes, solve) in kinds.items():
            right = [np.array([solve(1j * w, change) for change in changes]).T for w in found.omega]
            after, bound = getattr(found, name), getattr(found, f"{name}_bound")
            broken, errors[name] = missed(after, np.array(right), bound)
            assert not broken.any(), name
    return errors


def missed(found, exact, bound):
    """Where a finite bound is broken, and the errors, as arrays."""
    with np.errstate(all="ignore"):
        errors = abs(number(found) - exact)
        finite, wrong = np.isfinite(bound), np.zeros(np.shape(found), dtype=bool)
        known = zip(errors[finite], bound[finite], strict=True)
        wrong[finite] = [not e <= mpf(float(b)) for e, b in known]
        return wrong, errors.astype(float)


@dataclasses.dataclass(frozen=True)
class SensitivityCase:
    """What is driven, where and how, how it is solved, and how it is heated."""

    seed: int
    medium: object
    omegas: np.ndarray
    sites: np.ndarray
    solver: str
    tolerance: float
    by: dict


def lawful_sensitivity(seed):
    """The same with laws of damping."""
    case, rng = random_sensitivity(seed), np.random.default_rng([29, seed])
    if isinstance(case.medium, Network):
        return dataclasses.replace(case, medium=with_laws(case.medium, seed))
    laws = {"damping_power": rng.choice([-0.5, 0.5, 1.0, 2.0])} if rng.random() < 0.6 else {}
    laws["drag"] = case.medium.omega_mx * rng.choice([0.0, 0.001, 0.1])
    laws["loss"] = rng.choice([0.0, 0.001, 0.1])
    return dataclasses.replace(case, medium=dataclasses.replace(case.medium, **laws))


def random_sensitivity(seed):
    """A lattice or a network in units of 1e-6 to 1e6, with any damping or none, also resonant."""
    rng = np.random.default_rng([23, seed])
    shapes = (1,), (2,), (7,), (1, 4), (4, 1), (3, 4), (2, 2, 2), (1, 2, 3)
    unit = 10 ** rng.uniform(-6, 6)
    if rng.random() < 0.5:
        shape, law = shapes[rng.integers(len(shapes))], rng.integers(4)
        draw = [
            lambda size: rng.uniform(0, 1, size), lambda size: 10 ** rng.uniform(-6, 0, size),
            lambda size: rng.choice([0.0, 1.0], size, p=[0.3, 0.7]), np.ones
        ][law]  # fmt: skip
        stiffness = bond_arrays(shape, lambda size: unit * draw(size))
        if not any(k.any() for k in stiffness):
            stiffness[0].fill(unit)
        damping = 0.0 if rng.random() < 0.3 else unit * 10 ** rng.uniform(-6, 1)
        medium = Lattice(stiffness, unit * 10 ** rng.uniform(-2, 2), damping, kmax=unit)
        omegas = list(medium.omega_mx * 10 ** rng.uniform(-2, 0.4, 2))
        sites = np.stack([rng.integers(0, n, 2) for n in shape], axis=1)
        if rng.random() < 0.3:
            squares = Exact(medium).eigenvalues() / medium.mass
            omegas += [np.sqrt(x) for x in rng.choice(squares, 1) if x > 0]
    else:
        case = random_network(1000 + seed, balls=7)
        medium, sites = case.network, case.sites
        names = "stiffness", "masses", "damping", "force", "tangential", "kmax"
        scaled = {n: unit * getattr(medium, n) for n in names if getattr(medium, n) is not None}
        if rng.random() < 0.1 and "force" in scaled:
            scaled["force"] = 0 * scaled["force"]
        if rng.random() < 0.1 and "tangential" in scaled:
            scaled["tangential"] = 0 * scaled["tangential"]
        medium = dataclasses.replace(medium, **scaled)
        omegas = [s.imag for s in case.points if s.real == 0 and s.imag > 0][:3]
    by = {"factor": rng.choice([0.0, 1e-3, 1.1, 2.0, 1e3])}
    force, constants = getattr(medium, "force", None), medium.springs.elastic[: medium.bonds]
    possible = np.all(constants >= 0) and (force is None or np.all((force > 0) | (constants == 0)))
    if possible and rng.random() < 0.5:
        by = {"overlap": 10 ** rng.uniform(-6, 0), "hertz": unit * 10 ** rng.uniform(-1, 1)}
    solver = "default" if rng.random() < 0.4 else list(SOLVERS)[rng.integers(len(SOLVERS))]
    tolerance = 10 ** rng.uniform(-10, -1)
    return SensitivityCase(seed, medium, np.unique(omegas), sites, solver, tolerance, by)
