"""The program against what a user would write with SciPy, in one run: ratios and errors.

Started by jobs/benchmark.sh on 2 ranks. While one rank measures, the other waits.
"""

import statistics
import sys
import time

import mpi4py.MPI  # noqa: F401 (first: PETSc may have no MPI library of its own)
import petsc4py

petsc4py.init(["benchmark", "-skip_petscrc"])

import numpy as np  # noqa: E402
import scipy.sparse as sp  # noqa: E402
from mpi4py import MPI  # noqa: E402
from scipy.sparse.linalg import eigsh, splu  # noqa: E402

from pgran.parallel.crew import Crew  # noqa: E402
from pgran.physics.bondlaw import BondLaw  # noqa: E402
from pgran.physics.changes import draw_changes  # noqa: E402
from pgran.physics.lattice import Lattice, bond_places  # noqa: E402
from pgran.scenes.modes import find_modes  # noqa: E402
from pgran.scenes.relaxation import relax  # noqa: E402
from pgran.scenes.response import sweep  # noqa: E402
from pgran.solve.linear import make_ksp  # noqa: E402
from pgran.solve.operators import Operators  # noqa: E402
from pgran.solve.steady import SteadySolver  # noqa: E402

WORLD = MPI.COMM_WORLD
REPEATS = 5
UNIFORM = BondLaw("uniform")
# No pivoting: with it SymmetricMode fills in completely on these matrices.
SPLU = {
    "permc_spec": "MMD_AT_PLUS_A",
    "diag_pivot_thresh": 0.0,
    "options": {"SymmetricMode": True},
}


def laplacian(stiffness):
    """Return the weighted Laplacian in SciPy, a diagonal for each kind of neighbour."""
    kx, ky = stiffness
    ball = np.arange(kx[1:].size).reshape(kx.shape[0] - 1, -1)
    main = (kx[:-1] + kx[1:] + ky[:, :-1] + ky[:, 1:]).ravel()
    triples = [(ball.ravel(), ball.ravel(), main)]
    for a, b, k in (
        (ball[:-1], ball[1:], kx[1:-1]),
        (ball[:, :-1], ball[:, 1:], ky[:, 1:-1]),
    ):
        triples += [(a.ravel(), b.ravel(), -k.ravel()), (b.ravel(), a.ravel(), -k.ravel())]
    rows, columns, values = map(np.concatenate, zip(*triples, strict=True))
    return sp.csc_matrix((values, (rows, columns)))


def scipy_sweep(lattice, omegas, site):
    """Return the amplitudes as a careful user of SciPy computes them, and the seconds it took."""
    started = time.perf_counter()
    K, C = laplacian(lattice.stiffness), laplacian([np.ones_like(k) for k in lattice.stiffness])
    identity = sp.identity(lattice.balls, format="csc")
    wall = np.zeros(lattice.shape, dtype=complex)
    detector = np.ravel_multi_index(site, lattice.shape)
    amplitudes = []
    for omega in omegas:
        S = K + (1j * omega * lattice.damping) * C - (lattice.mass * omega**2) * identity
        wall[-1] = lattice.stiffness[0][-1] + 1j * omega * lattice.damping
        factor = splu(S, **SPLU)
        amplitudes.append(factor.solve(wall.ravel())[detector])
    return np.array(amplitudes), time.perf_counter() - started


def pgran_sweep(lattice, omegas, site, comm):
    """Return the response and the seconds it took, on rank 0 of `comm`."""
    with Crew(comm, 1) as crew:
        started = time.perf_counter()
        response = sweep(lattice, omegas, site, crew)
        return response, time.perf_counter() - started


def scipy_relaxation(lattice, omega, site, changes):
    """Return the amplitudes after each change, a fresh splu a step, and the seconds it took."""
    started = time.perf_counter()
    stiffness = [k.copy() for k in lattice.stiffness]
    C = laplacian([np.ones_like(k) for k in stiffness])
    constant = (1j * omega * lattice.damping) * C
    constant -= (lattice.mass * omega**2) * sp.identity(lattice.balls, format="csc")
    wall = np.zeros(lattice.shape, dtype=complex)
    detector = np.ravel_multi_index(site, lattice.shape)
    axes, places = bond_places(lattice.shape, changes.bond)
    amplitudes = []
    for axis, place, value in zip(axes, places, changes.stiffness, strict=True):
        stiffness[axis][tuple(place)] = value
        wall[-1] = stiffness[0][-1] + 1j * omega * lattice.damping
        factor = splu((laplacian(stiffness) + constant).tocsc(), **SPLU)
        amplitudes.append(factor.solve(wall.ravel())[detector])
    return np.array(amplitudes), time.perf_counter() - started


def pgran_relaxation(lattice, omega, site, comm, **choices):
    """Return the relaxation and the seconds it took, on rank 0 of `comm`."""
    with Crew(comm, 1) as crew:
        started = time.perf_counter()
        found = relax(lattice, UNIFORM, omega, site, crew, **choices)
        return found, time.perf_counter() - started


def in_turns(work, repeats):
    """Return the last result and the median seconds of each kind of work, measured in turns.

    `work` maps labels to pairs: on all ranks or on rank 0 alone, and what returns a result and its
    seconds.
    """
    seconds, results = {label: [] for label in work}, {}
    for _ in range(repeats):
        for label, (together, measure) in work.items():
            WORLD.Barrier()
            if together or WORLD.rank == 0:
                results[label], took = measure()
                seconds[label].append(took)
    WORLD.Barrier()
    return results, {k: statistics.median(v) for k, v in seconds.items() if v}


def say(*words):
    """Print a line on rank 0."""
    if WORLD.rank == 0:
        print(*words, flush=True)


def lattice_of(side, damping=0.003):
    """Return a square lattice at the paper's parameters, and a detector inside."""
    lattice = Lattice.random((side, side), damping=damping)
    return lattice, (side * 2 // 5, side // 2)


def compare_sweeps(label, side, omegas, repeats):
    """Measure one sweep in turns: SciPy, one rank, all ranks."""
    lattice, site = lattice_of(side)
    work = {
        "scipy": (False, lambda: scipy_sweep(lattice, omegas, site)),
        "alone": (False, lambda: pgran_sweep(lattice, omegas, site, MPI.COMM_SELF)),
        "all": (True, lambda: pgran_sweep(lattice, omegas, site, WORLD)),
    }
    results, seconds = in_turns(work, repeats)
    if WORLD.rank == 0:
        reference, response = results["scipy"], results["alone"]
        error = np.max(np.abs(response.displacement[:, 0] - reference) / np.abs(reference))
        row(label, seconds["scipy"], seconds["alone"], seconds["all"], error, response.failures)


def solve_only(lattice, omegas, site):
    """Return the amplitudes by one factorization and one solve each, and the seconds it took."""
    with Operators(lattice, MPI.COMM_SELF) as operators:
        ksp, field, amplitudes = make_ksp(operators, operators.S), operators.f.duplicate(), []
        ksp.setType("preonly")
        ksp.setInitialGuessKnoll(False)
        number = operators.numbers([site])[0]
        started = time.perf_counter()
        for omega in omegas:
            operators.combine(1j * omega)
            ksp.setOperators(operators.S)
            ksp.solve(operators.f, field)
            amplitudes.append(field.getArray(readonly=True)[number])
        seconds = time.perf_counter() - started
        ksp.destroy()
        field.destroy()
    return np.array(amplitudes), seconds


def solve_with_bounds(lattice, omegas, site):
    """Return the same amplitudes with their bounds, and the seconds it took."""
    with (
        Operators(lattice, MPI.COMM_SELF) as operators,
        SteadySolver(operators, [site]) as solver,
    ):
        started = time.perf_counter()
        states = [solver.solve(1j * omega) for omega in omegas]
        return states, time.perf_counter() - started


def compare_bounds(side, omegas, repeats):
    """Measure what adjoint, residuals and bound add to factoring and solving."""
    lattice, site = lattice_of(side)
    work = {
        "solve": (False, lambda: solve_only(lattice, omegas, site)),
        "bound": (False, lambda: solve_with_bounds(lattice, omegas, site)),
    }
    results, seconds = in_turns(work, repeats)
    if WORLD.rank == 0:
        plain, bound = (1e3 * seconds[label] / len(omegas) for label in work)
        proven = max(s.error_bound[0] / abs(s.displacement[0]) for s in results["bound"])
        say(
            f"{side} x {side}: {plain:.3f} ms a frequency alone, {bound:.3f} with a bound, "
            f"{100 * (bound / plain - 1):.0f} % more; relative bounds up to {proven:.1e}"
        )


def compare_all_modes(side, repeats):
    """Measure all modes against NumPy's real eigh."""
    lattice, _ = lattice_of(side, damping=0.0)
    dense = laplacian(lattice.stiffness).toarray()
    work = {
        "numpy": (False, lambda: timed(np.linalg.eigh, dense)),
        "alone": (False, lambda: pgran_modes(lattice, MPI.COMM_SELF, shapes=True)),
        "all": (True, lambda: pgran_modes(lattice, WORLD, shapes=True)),
    }
    results, seconds = in_turns(work, repeats)
    if WORLD.rank == 0:
        values, modes = results["numpy"][0], results["alone"]
        error = np.max(np.abs(modes.omega - np.sqrt(values)))
        label = f"all modes of {side} x {side} (peer: eigh)"
        row(label, seconds["numpy"], seconds["alone"], seconds["all"], error, modes.failures)


def compare_interval(side, low, high, repeats):
    """Measure the modes of an interval against SciPy's eigsh with sigma in its middle."""
    lattice, _ = lattice_of(side, damping=0.0)
    K = laplacian(lattice.stiffness)
    count = WORLD.bcast(len(pgran_modes(lattice, MPI.COMM_SELF, interval=(low, high))[0].omega))
    sigma = 0.5 * (low**2 + high**2)
    work = {
        "scipy": (False, lambda: timed(eigsh, K, k=count, sigma=sigma)),
        "alone": (False, lambda: pgran_modes(lattice, MPI.COMM_SELF, interval=(low, high))),
        "all": (True, lambda: pgran_modes(lattice, WORLD, interval=(low, high))),
    }
    results, seconds = in_turns(work, repeats)
    if WORLD.rank == 0:
        values, modes = np.sqrt(results["scipy"][0]), results["alone"]
        common = [np.min(np.abs(values - omega)) for omega in modes.omega[10:-10]]
        label = f"{count} modes of {side} x {side} (peer: eigsh)"
        row(label, seconds["scipy"], seconds["alone"], seconds["all"], max(common), modes.failures)


def compare_relaxations(side, steps, peer_steps, methods, repeats):
    """Measure the price of a step by each method against a splu a step."""
    lattice, site = lattice_of(side, damping=0.01)
    if side > 20:
        site = (side - 10, side // 2)
    omega = 0.6
    changes = draw_changes(UNIFORM, lattice.shape, 1, 0, 0, peer_steps)
    work = {"scipy": (False, lambda: scipy_relaxation(lattice, omega, site, changes))}
    for method in methods:
        choices = {"steps": steps[method], "method": method}
        work[method] = (
            False,
            lambda choices=choices: pgran_relaxation(
                lattice, omega, site, MPI.COMM_SELF, **choices
            ),
        )
    results, seconds = in_turns(work, repeats)
    if WORLD.rank == 0:
        peer = seconds["scipy"] / peer_steps
        for method in methods:
            price = seconds[method] / steps[method]
            found = results[method].displacement[0, 1 : peer_steps + 1, 0]
            reference = results["scipy"][: len(found)]
            error = np.max(np.abs(found - reference) / np.abs(reference))
            print(
                f"{side} x {side}, {method:8} {1e3 * peer:10.3f} {1e3 * price:10.4f}   "
                f"{peer / price:7.1f}   {error:.1e}",
                flush=True,
            )


def compare_trajectories(repeats):
    """Measure four trajectories on one rank and on all."""
    lattice, site = lattice_of(20, damping=0.01)
    choices = {"steps": 5000, "trajectories": 4}
    work = {
        "alone": (False, lambda: pgran_relaxation(lattice, 0.6, site, MPI.COMM_SELF, **choices)),
        "all": (True, lambda: pgran_relaxation(lattice, 0.6, site, WORLD, **choices)),
    }
    _, seconds = in_turns(work, repeats)
    if WORLD.rank == 0:
        ratio = seconds["alone"] / seconds["all"]
        say(f"4 trajectories of 5000 steps: {WORLD.size} ranks {ratio:.2f} times faster than 1")


def pgran_modes(lattice, comm, **choices):
    """Return the modes and the seconds they took, on rank 0 of `comm`."""
    with Crew(comm, 1) as crew:
        return timed(find_modes, lattice, crew, **choices)


def timed(function, *arguments, **choices):
    """Return what a function returns, and the seconds it took."""
    started = time.perf_counter()
    found = function(*arguments, **choices)
    return found, time.perf_counter() - started


def row(label, peer, alone, shared, error, failures):
    """Print a row of the table."""
    print(
        f"{label:36} {peer:8.3f} {alone:8.3f} {shared:8.3f}   {peer / alone:6.2f} "
        f"{peer / shared:7.2f} {alone / shared:6.2f}   {error:.1e} {failures}",
        flush=True,
    )


def main():
    """Print the tables."""
    ranks = f"{WORLD.size} ranks"
    say(f"medians of {REPEATS} interleaved repeats, seconds")
    say(
        f"{'':36} {'peer':>8} {'1 rank':>8} {ranks:>8}   {'peer/1':>6} {'peer/all':>7} "
        f"{'1/all':>6}   largest difference, failures"
    )
    paper = np.linspace(0.01, 1.3, 1291)
    compare_sweeps("sweep 20 x 20, the paper's 1291", 20, paper, REPEATS)
    compare_sweeps("sweep 60 x 60, 128 frequencies", 60, np.linspace(0.01, 1.0, 128), REPEATS)
    compare_sweeps("sweep 200 x 200, 16 frequencies", 200, np.linspace(0.05, 0.5, 16), REPEATS)
    say("\nwhat error bounds cost, one rank")
    compare_bounds(20, paper[::4], 2 * REPEATS)
    compare_bounds(200, np.linspace(0.05, 0.5, 4), REPEATS)
    say("")
    compare_all_modes(20, REPEATS)
    compare_all_modes(40, REPEATS)
    compare_interval(100, 0.5, 0.518, REPEATS)
    say("\nrelaxation, ms a step on one rank\n" + f"{'':18} {'splu':>12} {'pgran':>10}   ratio")
    steps = {"window": 20000, "krylov": 2000, "direct": 2000}
    compare_relaxations(20, steps, 500, list(steps), REPEATS)
    steps = {"window": 4096, "krylov": 200, "direct": 200}
    compare_relaxations(60, steps, 60, list(steps), 3)
    steps = {"window": 512, "krylov": 16, "direct": 16}
    compare_relaxations(200, steps, 8, list(steps), 3)
    compare_trajectories(REPEATS)


if __name__ == "__main__":
    sys.exit(main())
