"""Lattices to test with, given or at random, and what solves them.

Bonds come from NumPy's default generator, not from pgran's laws.
"""

import contextlib
import dataclasses
import math
import re

import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc
from reference import Reference
from scipy.integrate import solve_ivp

from pgran import BondLaw, Lattice, pulse, relax, sweep
from pgran.command import resolve
from pgran.command.resolve import SCENES
from pgran.driven.operators import Operators
from pgran.driven.steady import SteadySolver
from pgran.experiments.pulse.wall import SHAPES as PULSES
from pgran.run.crew import Crew
from pgran.store.record import Record

HAS_KLU = PETSc.Sys.hasExternalPackage("suitesparse")
needs_klu = pytest.mark.skipif(not HAS_KLU, reason="this PETSc has no KLU")


def bond_arrays(shape, draw):
    """One array of bonds for each axis, filled by `draw(size)`."""
    return tuple(
        draw(tuple(n + (a == axis) for a, n in enumerate(shape))) for axis in range(len(shape))
    )


def random_lattice(shape, seed=0, damping=0.003, mass=1.0, law="uniform"):
    """A lattice of random bonds, the same on every rank."""
    rng = np.random.default_rng(seed)
    laws = {
        "uniform": lambda size: rng.uniform(0, 0.25, size),
        "bimodal": lambda size: rng.choice([0.0, 0.25], size, p=[0.3, 0.7]),
        "wide": lambda size: 0.25 * 10 ** rng.uniform(-6, 0, size),
    }
    return Lattice(bond_arrays(shape, laws[law]), mass, damping, kmax=0.25)


def uniform_lattice(shape, stiffness=0.25, damping=0.003, mass=1.0):
    """A lattice of equal bonds."""
    return Lattice(bond_arrays(shape, lambda size: np.full(size, stiffness)), mass, damping)


def islands(shape, seed):
    """A lattice half of whose bonds are missing, and two balls are loose."""
    rng = np.random.default_rng(seed)
    stiffness = bond_arrays(shape, lambda size: rng.choice([0.0, 0.25], size))
    for axis, k in enumerate(stiffness):
        for ball in ((1,) * len(shape), tuple(n // 2 for n in shape)):
            k[ball] = 0
            k[tuple(i + (a == axis) for a, i in enumerate(ball))] = 0
    return Lattice(stiffness, 1.0, 0.003, kmax=0.25)


def reference_of(lattice):
    """The dense reference of a lattice."""
    return Reference(lattice.stiffness, lattice.mass, lattice.damping)


def option_values(text):
    """The PETSc options of a text, `-key value -flag ...`, as a dictionary."""
    words = re.split(r"(?:^|\s)-(?=[a-z])", text)[1:]
    return {key: value.strip() for key, _, value in (word.partition(" ") for word in words)}


def run_scene(options, world, journal=None):
    """Run the scene of some options; return its records on rank 0, None on the others."""
    scene = SCENES[options.scene]
    return resolve.run_scene(
        scene, options, world, lambda ranks, _=None: Crew(world, ranks, journal)
    )


@contextlib.contextmanager
def steady(lattice, sites, comm=MPI.COMM_SELF, tolerance=1e-4, **choices):
    """Yield the operators of a lattice, and the solver of its driven states."""
    sites = np.reshape(sites, (-1, len(lattice.shape))).astype(int)
    with (
        Operators(lattice, comm) as operators,
        SteadySolver(operators, sites, tolerance, **choices) as solver,
    ):
        yield operators, solver


def solve(lattice, omegas, sites, comm=MPI.COMM_SELF, tolerance=1e-4, **choices):
    """The driven states at some frequencies, and the whole fields on rank 0 of `comm`."""
    states, fields = [], []
    with steady(lattice, sites, comm, tolerance, **choices) as (operators, solver):
        for omega in np.atleast_1d(omegas):
            states.append(solver.solve(1j * omega))
            fields.append(operators.layout.field(solver.field))
    return states, fields


def swept(lattice, omegas, sites, comm=MPI.COMM_SELF, ranks=1, **choices):
    """The response, on every rank of `comm`; so many of them share a lattice."""
    with Crew(comm, ranks) as crew:
        choices = {"method": "points"} | choices
        return comm.bcast(sweep(lattice, np.asarray(omegas), sites, crew, **choices))


WIDTH, TIME, POINTS = 8.0, 200.0, 161  # of pulses, unless a test chooses others


def listened(lattice, sites, comm, ranks=1, **choices):
    """The signals after a pulse, on every rank of `comm`; so many of them share a lattice."""
    choices = {"width": WIDTH, "time": TIME, "points": POINTS, "method": "laplace"} | choices
    with Crew(comm, ranks) as crew:
        return comm.bcast(pulse(lattice, sites, crew, **choices))


UNIFORM = BondLaw("uniform")


def relaxed(lattice, sites, comm=MPI.COMM_SELF, ranks=1, law=UNIFORM, omega=0.5, **choices):
    """A relaxation, on every rank of `comm`; so many of them share a lattice."""
    with Crew(comm, ranks) as crew:
        return comm.bcast(relax(lattice, law, omega, sites, crew, **choices))


def assert_same(found, expected, but=("solve_seconds",)):
    """Records of one kind hold the same, parts and types included; a NaN is one and the same."""
    assert type(found) is type(expected)
    for item in dataclasses.fields(expected):
        one, other = (getattr(record, item.name) for record in (found, expected))
        if isinstance(other, Record):
            assert_same(one, other, but)
        elif item.name not in but:
            assert type(one) is type(other), item.name
            one, other = np.asarray(one), np.asarray(other)
            assert one.dtype == other.dtype, item.name
            assert np.array_equal(one, other, equal_nan=other.dtype.kind in "fc"), item.name


class Naive:
    """A lattice after a pulse by DOP853 on dense matrices, and the work that its dashpots take."""

    def __init__(self, lattice, sent, times):
        """Integrate."""
        reference = self.reference = reference_of(lattice)
        K, C = (matrix.astype(float) for matrix in (reference.K, lattice.damping * reference.C))
        drive, damped = reference.drive_K.astype(float), lattice.damping * reference.drive_C
        damped, count, walls = damped.astype(float), len(K), float(damped.sum())
        self.sent, self.times = sent, times

        def slope(t, y):
            u, v = y[:count], y[count:-1]
            U, speed = sent.moves(t, 2)
            taken = v @ C @ v - 2 * speed * (damped @ v) + walls * speed**2
            return np.concatenate([v, (drive * U + damped * speed - K @ u - C @ v) / lattice.mass,
                                   [taken]])  # fmt: skip

        span = min(sent.begin, 0.0), times[-1]
        start = np.zeros(2 * count + 1)
        y = solve_ivp(slope, span, start, "DOP853", times, rtol=1e-12, atol=1e-14, max_step=2.0).y
        shape = (-1, *reference.shape)
        self.u, self.v = y[:count].T.reshape(shape), y[count:-1].T.reshape(shape)
        self.dissipated = y[-1]

    def energy(self, lattice):
        """Bond by bond: walls are balls that move as they are told."""
        energy = 0.5 * lattice.mass * np.sum(self.v.reshape(len(self.v), -1) ** 2, axis=1)
        U = self.sent.moves(self.times)[0].reshape(-1, *[1] * len(lattice.shape))
        for axis, k in enumerate(lattice.stiffness):
            ends = np.zeros_like(np.take(self.u, [0], axis + 1))
            above = ends + U if axis == 0 else ends
            stretched = np.diff(np.concatenate([ends, self.u, above], axis + 1), axis=axis + 1)
            energy += 0.5 * np.sum((k * stretched**2).reshape(len(energy), -1), axis=1)
        return energy


# Lattices of many kinds, and how they are driven and solved

SHAPES = [
    *[(1,), (2,), (17,), (60,), (90,), (1, 6), (6, 1), (3, 1), (4, 5), (7, 8), (20, 2)],
    *[(2, 2, 2), (2, 3, 2), (4, 3, 5)],
]
LAWS = ("uniform", "loguniform", "bimodal", "with zeros", "constant")
FEW = "-steady_ksp_max_it 200"
SOLVERS = {
    "default": "",
    "ilu": f"-steady_pc_type ilu {FEW}",
    "icc": f"-steady_pc_type icc {FEW}",
    "preonly, ilu": "-steady_ksp_type preonly -steady_pc_type ilu",
    "preonly, lu": "-steady_ksp_type preonly -steady_pc_type lu",
    "mumps": "-steady_pc_factor_mat_solver_type mumps",
    "superlu_dist": "-steady_pc_type lu -steady_pc_factor_mat_solver_type superlu_dist",
    "gmres, jacobi": f"-steady_ksp_type gmres -steady_pc_type jacobi -steady_ksp_rtol 1e-3 {FEW}",
    # solves with the conjugate matrix
    "preonly, klu": "-steady_ksp_type preonly -steady_pc_type lu "
    "-steady_pc_factor_mat_solver_type klu",
}
if not HAS_KLU:
    del SOLVERS["preonly, klu"]


@dataclasses.dataclass(frozen=True)
class Case:
    """A lattice, how it is driven and solved, and with how many digits it is eliminated."""

    seed: int
    lattice: Lattice
    omegas: np.ndarray
    sites: np.ndarray
    solver: str
    tolerance: float
    floor: float
    digits: int


def random_case(seed):
    """Constants over up to 300 orders of magnitude, any damping or none, also on eigenvalues."""
    rng = np.random.default_rng([11, seed])
    shape = SHAPES[rng.integers(len(SHAPES))]
    orders = rng.uniform(0, 300) if rng.random() < 0.4 else rng.uniform(0, 14)
    unit = 10 ** rng.uniform(-200, 200) if rng.random() < 0.2 else 0.25
    law = LAWS[rng.integers(len(LAWS))]
    draw = {
        "uniform": lambda size: rng.uniform(0, 1, size),
        "loguniform": lambda size: 10 ** -(orders * rng.uniform(0, 1, size)),
        "bimodal": lambda size: rng.choice([10**-orders, 1.0], size, p=[0.4, 0.6]),
        "with zeros": lambda size: rng.choice([0.0, 1.0], size, p=[0.3, 0.7]),
        "constant": lambda size: np.ones(size),
    }[law]
    stiffness = bond_arrays(shape, draw)
    mass = 10 ** rng.uniform(-3, 3)
    damping = 0.0 if rng.random() < 0.4 else math.sqrt(mass) * 10 ** rng.uniform(-10, 1)
    einstein = math.sqrt(2 * len(shape) / mass)
    omegas = list(einstein * 10 ** rng.uniform(-3, 0.7, rng.integers(1, 5)))
    if rng.random() < 0.3:
        eigenvalues = Reference(stiffness).eigenvalues()
        chosen = rng.choice(eigenvalues, min(2, len(eigenvalues)), replace=False)
        omegas += list(np.sqrt(np.maximum(chosen, 1e-300) / mass))
    if law == "constant":  # where every diagonal entry of S vanishes: often an eigenvalue exactly
        omegas.append(einstein)
    return Case(
        seed,
        Lattice(tuple(unit * k for k in stiffness), unit * mass, unit * damping, kmax=unit),
        np.unique(omegas),
        np.array([[rng.integers(n) for n in shape] for _ in range(rng.integers(1, 3))]),
        list(SOLVERS)[rng.integers(len(SOLVERS))],
        10 ** rng.uniform(-12, -1),
        (1e-20, 0.0)[rng.integers(2)],
        60 + math.ceil(1.1 * orders),
    )


@dataclasses.dataclass(frozen=True)
class Run:
    """A lattice, its detectors, how a pulse is sent, a curve or a relaxation computed.

    `count` are the frequencies or steps to look at, `steps` those of a relaxation, `omegas` what a
    curve is asked for.
    """

    seed: int
    lattice: Lattice
    sites: np.ndarray
    choices: dict
    count: int = 0
    steps: int = 0
    omegas: np.ndarray | None = None


CURVE_LAWS = {
    "uniform": lambda rng, size: rng.uniform(0, 1, size),
    "zeros": lambda rng, size: rng.choice([0.0, 1.0], size, p=[0.15, 0.85]),
    "wide": lambda rng, size: 10 ** rng.uniform(-3, 0, size),
    "constant": lambda rng, size: np.ones(size),
    "weak": lambda rng, size: rng.uniform(0.8, 1, size),
}


def random_curve(seed, points=False):
    """The curve of a lattice of 20 to 400 balls along 1 to 3 axes, beta from 1e-4 to 1."""
    rng = np.random.default_rng([29, seed])
    fewest, least = (2, -9) if points else (20, -4)
    axes, balls = rng.integers(1, 4), fewest * (400 / fewest) ** rng.uniform()
    stretch = np.exp(rng.uniform(-0.3, 0.3, axes))
    shape = tuple(np.ceil(stretch * balls ** (1 / axes)).astype(int).tolist())
    law = list(CURVE_LAWS.values())[rng.integers(len(CURVE_LAWS))]
    bonds = bond_arrays(shape, lambda size: law(rng, size))
    lattice = Lattice(bonds, 1.0, 10 ** rng.uniform(least, 0), kmax=1.0)
    sites = np.array([rng.integers(shape) for _ in range(rng.integers(1, 4))])
    asked = rng.integers(40, 2000) if points else 40
    omegas = np.sort(lattice.omega_mx * rng.uniform(0.02, 1.5, asked))
    choices = {"method": "curve", "resolve": 1e-2, "keep_models": True}
    choices = {"method": "points"} if points else choices
    return Run(seed, lattice, sites, choices, 2000, omegas=omegas)


def random_points(seed):
    """Frequencies solved one by one, of 2 to 400 balls, beta down to 1e-9: are lines straight?"""
    return random_curve(seed, points=True)


RELAXATION_LAWS = (
    UNIFORM,
    BondLaw("bimodal", kmin=0.0, fraction=0.7),
    BondLaw("loguniform", kmin=1e-6),
)


def random_relaxation(seed):
    """A short relaxation of a lattice along 1 to 3 axes, beta from 1e-6 to 1, by any method."""
    rng = np.random.default_rng([33, seed])
    shape = [(30,), (1,), (5, 6), (1, 5), (6, 1), (3, 4, 3)][rng.integers(6)]
    laws = ("uniform", "bimodal", "wide")
    lattice = random_lattice(shape, seed, 10 ** rng.uniform(-6, 0), law=laws[rng.integers(3)])
    sites = np.stack([rng.integers(0, n, 2) for n in shape], axis=1)
    choices = {
        "law": RELAXATION_LAWS[rng.integers(3)], "omega": 10 ** rng.uniform(-1, 0.2),
        "method": ("window", "direct", "krylov")[rng.integers(3)], "seed": int(rng.integers(99)),
        "window": int(rng.integers(2, 50)), "error_tolerance": 10 ** rng.uniform(-10, -1),
    }  # fmt: skip
    return Run(seed, lattice, sites, choices, 8, int(rng.integers(1, 120)))


def long_relaxation(seed):
    """One of 18 relaxations of 10^5 steps, of three lattices, three beta and two laws."""
    place, damping, law = np.unravel_index(seed, (3, 3, 2))
    shape, site = (((30,), [14]), ((7, 6), [3, 2]), ((4, 3, 4), [1, 1, 2]))[place]
    law = RELAXATION_LAWS[law]
    lattice = Lattice.random(shape, 5, law, damping=(1e-4, 1e-2, 1.0)[damping])
    return Run(seed, lattice, np.array([site]), {"law": law, "omega": 0.6}, 200, 100_000)


def random_pulse(seed):
    """A pulse of any shape along 1 to 3 axes, with any damping or none."""
    rng = np.random.default_rng([32, seed])
    shape = [(6, 5), (12,), (3, 2, 3), (4, 4), (1, 3)][rng.integers(5)]
    damping = 0.0 if rng.random() < 0.3 else 10 ** rng.uniform(-3, 0)
    lattice = random_lattice(shape, seed, damping)
    sites = np.array([[rng.integers(n) for n in shape]])
    return Run(seed, lattice, sites, {"shape": PULSES[seed % len(PULSES)]})
