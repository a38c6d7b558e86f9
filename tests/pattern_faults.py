"""What is false of G = e^T S^-1 f between patterns of balls of random lattices and networks."""

import dataclasses

import numpy as np
from mpi4py import MPI
from mpmath import mp
from network_samples import NetworkReference, as_network, eliminated, exactly, random_network
from samples import SOLVERS, option_values, random_lattice

from pgran.driven.operators import Operators
from pgran.driven.patterns import PatternSolver
from pgran.medium.base import Medium
from pgran.run.petsc import holding


@dataclasses.dataclass(frozen=True)
class RandomPatterns:
    """A medium, each s at which it is pushed, receivers and sources, what solves."""

    seed: int
    medium: Medium
    points: np.ndarray
    receivers: np.ndarray
    sources: np.ndarray
    solver: str


def random_patterns(seed):
    """A random network, or a lattice in and far above its band; balls and waves, some twice."""
    rng, case = np.random.default_rng([41, seed]), random_network(seed)
    medium, points, solver = case.network, case.points, case.solver
    if rng.random() < 0.4:
        shape = [(1,), (14,), (5, 4), (1, 6), (2, 3, 3)][rng.integers(5)]
        damping = 0.0 if rng.random() < 0.3 else 10 ** rng.uniform(-5, 0)
        law = ("uniform", "bimodal", "wide")[rng.integers(3)]
        medium = random_lattice(shape, seed, damping, 10 ** rng.uniform(-2, 2), law)
        points = 1j * medium.omega_mx * 10 ** rng.uniform(-1.5, 1.5, 3)
    size = medium.size
    balls, waves = np.eye(size)[rng.integers(size, size=3)], rng.standard_normal((2, size))
    return RandomPatterns(
        seed, medium, points, np.concatenate([balls, waves[:1]]),
        np.concatenate([np.eye(size)[:1], waves, balls[:1]]), solver,
    )  # fmt: skip


def pattern_faults(case, seen, comm=MPI.COMM_SELF):
    """Compare with elimination in 60 digits; a pattern's own value takes one solution."""
    medium, patterns = case.medium, (case.receivers, case.sources)
    with (
        mp.workdps(60),
        holding(option_values(SOLVERS[case.solver])),
        Operators(medium, comm) as operators,
        PatternSolver(operators) as solver,
    ):
        reference = NetworkReference(as_network(medium) if medium.is_grid else medium)
        for s in case.points:
            solver.solve(s)
            S = reference.weighted(reference.system(s))
            fields = [eliminated(S, exactly(f)) for f in case.sources]
            if any(x is None for x in fields):
                seen["singular"] += 1
                continue
            exact = exactly(case.receivers) @ np.stack(fields, axis=1)
            values, bounds = solver.products(*patterns)
            own, own_bounds = solver.diagonal(case.sources)
            right = [exactly(f) @ x for f, x in zip(case.sources, fields, strict=True)]
            values, exact = np.append(values, own), np.append(exact, right)
            for value, x, bound in zip(values, exact, np.append(bounds, own_bounds), strict=True):
                error = float(abs(mp.mpmathify(complex(value)) - x))
                seen["pairs"] += 1
                seen["good"] += bool(bound <= 1e-4 * float(abs(x)))
                if np.isfinite(bound) and not error <= bound:
                    yield f"BROKEN case {case.seed}, {s=}: error {error:.1e}, bound {bound:.1e}"
