"""The program against what a user would write with SciPy, in one run: ratios and errors.

Started by jobs/benchmark.sh on 2 ranks. While one rank measures, the other waits.
"""

import statistics
import time
from functools import partial

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
SPLU = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}


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


def sweep_systems(lattice, omegas):
    """Yield S and f at each frequency, K and C being summed up once."""
    K, C = laplacian(lattice.stiffness), laplacian([np.ones_like(k) for k in lattice.stiffness])
    identity = sp.identity(lattice.balls, format="csc")
    for omega in omegas:
        S = K + (1j * omega * lattice.damping) * C - (lattice.mass * omega**2) * identity
        yield S, drive(lattice, lattice.stiffness, omega)


def relaxation_systems(lattice, omega, changes):
    """Yield S and f after each change of a bond."""
    stiffness = [k.copy() for k in lattice.stiffness]
    constant = (1j * omega * lattice.damping) * laplacian([np.ones_like(k) for k in stiffness])
    constant -= (lattice.mass * omega**2) * sp.identity(lattice.balls, format="csc")
    axes, places = bond_places(lattice.shape, changes.bond)
    for axis, place, value in zip(axes, places, changes.stiffness, strict=True):
        stiffness[axis][tuple(place)] = value
        yield (laplacian(stiffness) + constant).tocsc(), drive(lattice, stiffness, omega)


def drive(lattice, stiffness, omega):
    """Return f, which acts on the balls next to the driven wall."""
    wall = np.zeros(lattice.shape, dtype=complex)
    wall[-1] = stiffness[0][-1] + 1j * omega * lattice.damping
    return wall.ravel()


def by_scipy(lattice, site, systems):
    """Return the amplitudes as a careful user of SciPy computes them, by a splu a system."""
    detector = np.ravel_multi_index(site, lattice.shape)
    return np.array([splu(S, **SPLU).solve(f)[detector] for S, f in systems])


def by_pgran(scene, *arguments, ranks=MPI.COMM_SELF, **choices):
    """Return the record that a scene computes, on rank 0 of `ranks`."""
    with Crew(ranks, 1) as crew:
        return scene(*arguments, crew=crew, **choices)


def solve_only(operators, omegas, site):
    """Return the amplitudes by one factorization and one solve each."""
    ksp, field, amplitudes = make_ksp(operators, operators.S), operators.f.duplicate(), []
    ksp.setType("preonly")
    ksp.setInitialGuessKnoll(False)
    number = operators.numbers([site])[0]
    for omega in omegas:
        operators.combine(1j * omega)
        ksp.setOperators(operators.S)
        ksp.solve(operators.f, field)
        amplitudes.append(field.getArray(readonly=True)[number])
    ksp.destroy()
    field.destroy()
    return amplitudes


def solve_with_bounds(operators, omegas, site):
    """Return the same amplitudes with their bounds."""
    with SteadySolver(operators, [site]) as solver:
        return [solver.solve(1j * omega) for omega in omegas]


def in_turns(work, repeats=REPEATS):
    """Do each kind of work in turns; what is labelled "all" on all ranks, the rest on rank 0.

    Parameters
    ----------
    work : dict
        Functions without arguments.
    repeats : int

    Returns
    -------
    results, seconds : dict
        What each has returned last, and its median seconds.
    """
    seconds, results = {label: [] for label in work}, {}
    for _ in range(repeats):
        for label, function in work.items():
            WORLD.Barrier()
            if label == "all" or WORLD.rank == 0:
                started = time.perf_counter()
                results[label] = function()
                seconds[label].append(time.perf_counter() - started)
    WORLD.Barrier()
    return results, {label: statistics.median(took) for label, took in seconds.items() if took}


def say(text):
    """Print a line on rank 0."""
    if WORLD.rank == 0:
        print(text, flush=True)


def lattice_of(side, damping=0.003):
    """Return a square lattice at the paper's parameters, and a detector inside."""
    lattice = Lattice.random((side, side), damping=damping)
    return lattice, (side * 2 // 5, side // 2)


def row(label, peer, error_of, scene, *arguments, **choices):
    """Measure a scene against its peer, alone and on all ranks, and print a row of the table.

    Parameters
    ----------
    label : str
    peer : callable
        Takes no arguments.
    error_of : callable
        Takes what the peer returns, and the record.
    scene : callable
        Called with the further arguments.
    """
    alone = partial(by_pgran, scene, *arguments, **choices)
    results, seconds = in_turns({"peer": peer, "alone": alone, "all": partial(alone, ranks=WORLD)})
    if WORLD.rank == 0:
        first, one, shared = seconds.values()
        error = error_of(results["peer"], results["alone"])
        say(
            f"{label:36} {first:8.3f} {one:8.3f} {shared:8.3f}   {first / one:6.2f} "
            f"{first / shared:7.2f} {one / shared:6.2f}   {error:.1e} {results['alone'].failures}"
        )


def compare_sweeps(label, side, omegas):
    """Measure a sweep against a splu a frequency."""
    lattice, site = lattice_of(side)

    def error_of(peer, found):
        return np.max(np.abs(found.displacement[:, 0] - peer) / np.abs(peer))

    def peer():
        return by_scipy(lattice, site, sweep_systems(lattice, omegas))

    row(label, peer, error_of, sweep, lattice, omegas, site)


def compare_all_modes(side):
    """Measure all modes against NumPy's real eigh."""
    lattice, _ = lattice_of(side, damping=0.0)
    dense = laplacian(lattice.stiffness).toarray()

    def error_of(peer, found):
        return np.max(np.abs(found.omega - np.sqrt(peer[0])))

    label = f"all modes of {side} x {side} (peer: eigh)"
    row(label, lambda: np.linalg.eigh(dense), error_of, find_modes, lattice, shapes=True)


def compare_interval(side, low, high):
    """Measure the modes of an interval against SciPy's eigsh with sigma in its middle."""
    lattice, _ = lattice_of(side, damping=0.0)
    K, sigma, interval = laplacian(lattice.stiffness), 0.5 * (low**2 + high**2), (low, high)
    count = len(by_pgran(find_modes, lattice, interval=interval).omega)

    def error_of(peer, found):
        values = np.sqrt(peer[0])
        return max(np.min(np.abs(values - omega)) for omega in found.omega[10:-10])

    label, peer = f"{count} modes of {side} x {side} (peer: eigsh)", partial(eigsh, K, count)
    row(label, partial(peer, sigma=sigma), error_of, find_modes, lattice, interval=interval)


def compare_bounds(side, omegas, repeats):
    """Measure what adjoint, residuals and bound add to factoring and solving."""
    lattice, site = lattice_of(side)
    with Operators(lattice, MPI.COMM_SELF) as operators:
        functions = {"alone": solve_only, "bound": solve_with_bounds}
        work = {label: partial(f, operators, omegas, site) for label, f in functions.items()}
        results, seconds = in_turns(work, repeats)
    if WORLD.rank == 0:
        plain, bound = (1e3 * took / len(omegas) for took in seconds.values())
        proven = max(s.error_bound[0] / abs(s.displacement[0]) for s in results["bound"])
        say(
            f"{side} x {side}: {plain:.3f} ms a frequency alone, {bound:.3f} with a bound, "
            f"{100 * (bound / plain - 1):.0f} % more; relative bounds up to {proven:.1e}"
        )


def compare_relaxations(side, steps, peer_steps, repeats):
    """Measure the price of a step by each method on one rank against a splu a step."""
    lattice, (x, y) = lattice_of(side, damping=0.01)
    site = (x if side == 20 else side - 10, y)
    changes = draw_changes(UNIFORM, lattice.shape, 1, 0, 0, peer_steps)
    work = {"splu": lambda: by_scipy(lattice, site, relaxation_systems(lattice, 0.6, changes))}
    for method, many in steps.items():
        choices = {"steps": many, "method": method}
        work[method] = partial(by_pgran, relax, lattice, UNIFORM, 0.6, site, **choices)
    results, seconds = in_turns(work, repeats)
    for method, many in steps.items() if WORLD.rank == 0 else ():
        peer, price = seconds["splu"] / peer_steps, seconds[method] / many
        found = results[method].displacement[0, 1 : peer_steps + 1, 0]
        reference = results["splu"][: len(found)]
        error = np.max(np.abs(found - reference) / np.abs(reference))
        say(
            f"{side} x {side}, {method:8} {1e3 * peer:10.3f} {1e3 * price:10.4f}   "
            f"{peer / price:7.1f}   {error:.1e}"
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
    compare_sweeps("sweep 20 x 20, the paper's 1291", 20, paper)
    compare_sweeps("sweep 60 x 60, 128 frequencies", 60, np.linspace(0.01, 1.0, 128))
    compare_sweeps("sweep 200 x 200, 16 frequencies", 200, np.linspace(0.05, 0.5, 16))
    compare_all_modes(20)
    compare_all_modes(40)
    compare_interval(100, 0.5, 0.518)
    say("\nwhat error bounds cost, one rank")
    compare_bounds(20, paper[::4], 2 * REPEATS)
    compare_bounds(200, np.linspace(0.05, 0.5, 4), REPEATS)
    say(f"\nrelaxation, ms a step on one rank\n{'':18} {'splu':>12} {'pgran':>10}   ratio")
    compare_relaxations(20, {"window": 20000, "krylov": 2000, "direct": 2000}, 500, REPEATS)
    compare_relaxations(60, {"window": 4096, "krylov": 200, "direct": 200}, 60, 3)
    compare_relaxations(200, {"window": 512, "krylov": 16, "direct": 16}, 8, 3)


if __name__ == "__main__":
    main()
