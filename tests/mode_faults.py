"""What is false of modes and of their numbers, of random networks."""

import numpy as np
from mpi4py import MPI
from mpmath import mp
from network_samples import NetworkReference

from pgran import count_modes, find_modes
from pgran.driven.operators import Operators
from pgran.experiments.modes.normal import ModeSolver
from pgran.experiments.modes.slices import proven
from pgran.run.crew import Crew

ROUNDING = 1e-13  # of |K|: how well dense eigenvalues are known


def mode_faults(case, seen):
    """Modes that are missing or elsewhere, without being said to be."""
    with mp.workdps(50):
        eigenvalues = NetworkReference(case.network).eigenvalues()
    norm = np.abs(eigenvalues).max()
    unstable = bool(np.any(eigenvalues < -1e-9 * norm))
    for method in ("eps", "dense"):
        with Crew(MPI.COMM_SELF, 1) as crew:
            modes = find_modes(case.network, crew, method=method)
        seen["networks"] += 1
        seen["unstable"] += unstable
        seen["certified"] += modes.count_certified
        where = f"case {case.seed} by {method}"
        if modes.count_certified and len(modes.omega) != len(eigenvalues):
            yield f"MODES {where}: {len(modes.omega)} of {len(eigenvalues)}, {unstable=}"
        elif modes.count_certified:
            found = case.network.mass * np.sign(modes.omega) * modes.omega**2
            if not np.allclose(found, eigenvalues, rtol=0, atol=1e-11 * norm):
                yield f"MODES {where}: elsewhere by {np.abs(found - eigenvalues).max():.1e}"
        else:
            yield f"NOT CERTIFIED {where}: {len(modes.omega)} of {modes.count_expected}"


def nearest_modes(solver, omega, count):
    """The ends of an interval around omega that is proven to be complete, its modes; or None."""
    found = proven(solver, omega, count)
    if found is None:
        return None
    low, high, search = found
    values, *_ = solver.solve(low.shift, high.shift, high.below - low.below, search)
    return low.shift, high.shift, values


def nearest_faults(case, seen):
    """Yield modes nearest to a frequency that are proven and wrong; count what was `seen`.

    At 0, at random, and on and next to modes.
    """
    network, rng = case.network, np.random.default_rng([20, case.seed])
    with mp.workdps(50):
        eigenvalues = NetworkReference(network).eigenvalues()
    omegas = np.sqrt(np.abs(eigenvalues) / network.mass)
    near = rng.choice(omegas, 2) * (1 + rng.choice([0, 1e-12, -1e-9, 1e-6], 2))
    asked = [0.0, *rng.uniform(0, 1.1 * omegas.max(), 3), *near]
    asked = [(omega, int(rng.integers(1, 4))) for omega in asked]
    for fault in faults_near(network, eigenvalues, asked, seen):
        yield f"NEAREST case {case.seed}, {fault}"


def faults_near(network, eigenvalues, asked, seen):
    """Yield what is false of modes near frequencies, so many each, by all eigenvalues of K."""
    norm, mass = np.abs(eigenvalues).max(), network.mass
    omegas = np.sign(eigenvalues) * np.sqrt(np.abs(eigenvalues) / mass)
    with Operators(network, MPI.COMM_SELF) as operators, ModeSolver(operators) as solver:
        for omega, count in asked:
            found = nearest_modes(solver, omega, count)
            seen["targets"] += 1
            if found is None:
                continue
            seen["proven"] += 1
            low, high, values = found
            inside = (eigenvalues > low) & (eigenvalues < high)
            apart, where = np.abs(omegas - omega), f"{omega=:.6g}"
            if len(values) != np.count_nonzero(inside):
                yield f"{where}: {len(values)} of {np.count_nonzero(inside)}"
            elif not np.allclose(values, eigenvalues[inside], rtol=0, atol=2e-13 * norm):
                yield f"{where}: elsewhere"
            farthest = np.sort(apart[inside])[count - 1] if len(values) >= count else np.inf
            if farthest > np.sort(apart)[count - 1] + 1e-9 * np.sqrt(norm / mass):
                yield f"{where}: others are nearer"


def count_faults(case, seen):
    """Yield certified counts of modes that are wrong; count what was `seen`.

    At 0, at random, and on and next to modes; at every other network not at 0.
    """
    network, rng = case.network, np.random.default_rng([19, case.seed])
    with mp.workdps(50):
        eigenvalues = NetworkReference(network).eigenvalues()
    norm = np.abs(eigenvalues).max()
    top, rounding = np.sqrt(norm / network.mass), ROUNDING * norm
    if eigenvalues[0] > -10 * rounding:
        return
    near = np.sqrt(np.abs(rng.choice(eigenvalues, 2)) / network.mass)
    near *= 1 + rng.choice([0, 1e-12, -1e-9, 1e-6], 2)
    omegas = np.concatenate([top * 10 ** rng.uniform(-6, 0.1, 3), near])
    omegas = np.unique(np.append(omegas, 0.0))[case.seed % 2 :]
    with Crew(MPI.COMM_SELF, 1) as crew:
        found = count_modes(network, omegas, crew)
    limits = found.omega - found.margin
    limits *= network.mass * np.abs(limits)
    seen["networks"] += 1
    for omega, limit, count, sure in zip(omegas, limits, found.count, found.certified, strict=True):
        low, high = (np.count_nonzero(eigenvalues < limit + x) for x in (-rounding, rounding))
        seen["counts"] += 1
        seen["certified"] += sure
        seen["moved"] += bool(limit < network.mass * omega**2 - rounding)
        if sure and not low <= count <= high:
            yield f"WRONG case {case.seed}, {omega=:.6g}: {count} modes, not {low} to {high}"
    low, high = (np.count_nonzero(eigenvalues < x) for x in (-1e-5 * norm, rounding))
    if not low <= found.unstable <= high:
        yield f"UNSTABLE case {case.seed}: {found.unstable} modes, not {low} to {high}"
