"""The program against what a user would write with SciPy, in one run: ratios and errors.

Started by jobs/benchmark.sh on 2 ranks. While one rank measures, the other waits.
"""

import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import mpi4py.MPI  # noqa: F401 (first: PETSc may have no MPI library of its own)
import petsc4py

petsc4py.init(["benchmark", "-skip_petscrc"])

import numpy as np  # noqa: E402
import scipy.sparse as sp  # noqa: E402
from mpi4py import MPI  # noqa: E402
from scipy.sparse.linalg import LinearOperator, eigsh, splu  # noqa: E402

from pgran.parallel.crew import Crew  # noqa: E402
from pgran.physics.bondlaw import BondLaw  # noqa: E402
from pgran.physics.bonds import bond_places  # noqa: E402
from pgran.physics.changes import draw_changes  # noqa: E402
from pgran.physics.lattice import Lattice  # noqa: E402
from pgran.physics.makers import random_geometric  # noqa: E402
from pgran.scenes.modes import find_modes  # noqa: E402
from pgran.scenes.relaxation import relax  # noqa: E402
from pgran.scenes.response import sweep  # noqa: E402
from pgran.solve.linear import make_ksp  # noqa: E402
from pgran.solve.operators import Operators  # noqa: E402
from pgran.solve.steady import SteadySolver  # noqa: E402

WORLD, ALONE = MPI.COMM_WORLD, MPI.COMM_SELF
REPEATS = 5
UNIFORM = BondLaw("uniform")
PAPER = np.linspace(0.01, 1.3, 1291)
# No pivoting: with it SymmetricMode fills in completely on these matrices.
PIVOTS = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0}
SPLU = PIVOTS | {"options": {"SymmetricMode": True}}


@dataclass(frozen=True)
class Row:
    """What is compared; times are divided by how many items each of both computes."""

    label: str
    peer: Callable  # of nothing
    own: Callable  # of the ranks
    difference: Callable  # of the two results
    items: tuple = (1000, 1000)  # peer's and pgran's: milliseconds an item, or seconds
    ranks: tuple = (ALONE, WORLD)
    repeats: int = REPEATS


def laplacian(stiffness):
    """Return the weighted Laplacian in SciPy, a diagonal for each kind of neighbour."""
    kx, ky = stiffness
    ball = np.arange(kx[1:].size).reshape(kx.shape[0] - 1, -1)
    main = (kx[:-1] + kx[1:] + ky[:, :-1] + ky[:, 1:]).ravel()
    triples = [(ball.ravel(), ball.ravel(), main)]
    pairs = (ball[:-1], ball[1:], kx[1:-1]), (ball[:, :-1], ball[:, 1:], ky[:, 1:-1])
    for a, b, k in pairs:
        triples += [(a.ravel(), b.ravel(), -k.ravel()), (b.ravel(), a.ravel(), -k.ravel())]
    rows, columns, values = map(np.concatenate, zip(*triples, strict=True))
    return sp.csc_matrix((values, (rows, columns)))


def scipy_sweep(lattice, omegas, site):
    """Return the amplitudes as a careful user of SciPy computes them."""
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
    return np.array(amplitudes)


def scipy_relaxation(lattice, omega, site, changes):
    """Return the amplitudes after each change, by a fresh splu a step."""
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
    return np.array(amplitudes)


def solve_only(lattice, omegas, site):
    """Return the amplitudes by one factorization and one solve each."""
    amplitudes = []
    with Operators(lattice, ALONE) as operators:
        ksp, field = make_ksp(operators, operators.S), operators.f.duplicate()
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
    return np.array(amplitudes)


def solve_with_bounds(lattice, omegas, site, comm):
    """Return the same amplitudes, computed with their bounds."""
    with Operators(lattice, comm) as operators, SteadySolver(operators, [site]) as solver:
        return np.array([solver.solve(1j * omega).displacement[0] for omega in omegas])


def by_pgran(function, *arguments, group=1, **choices):
    """Return a function of the ranks that computes a record on its first rank.

    So many ranks share a lattice, all if None.
    """

    def compute(comm):
        with Crew(comm, group or comm.size) as crew:
            return function(*arguments, crew=crew, **choices)

    return compute


def relative(reference, found):
    """Return the largest relative difference."""
    return np.max(np.abs(found - reference) / np.abs(reference))


def lattice_of(side, damping=0.003):
    """Return a square lattice at the paper's parameters, and a detector inside."""
    lattice = Lattice.random((side, side), damping=damping)
    return lattice, (side * 2 // 5, side // 2)


def sweeps():
    """Yield sweeps against a splu a frequency."""
    high = {20: PAPER, 60: np.linspace(0.01, 1.0, 128), 200: np.linspace(0.05, 0.5, 16)}
    for side, omegas in high.items():
        lattice, site = lattice_of(side)
        yield Row(
            f"sweep {side} x {side}, {len(omegas)} frequencies",
            partial(scipy_sweep, lattice, omegas, site),
            by_pgran(sweep, lattice, omegas, site, method="points"),
            lambda peer, own: relative(peer, own.displacement[:, 0]),
        )


def curves():
    """Yield curves, by models of intervals, against pgran's own points."""
    plan = (
        # side, frequencies, how many the points are timed at, resolved, repeats
        (20, PAPER, 1, None, 5),
        (20, np.linspace(0.01, 1.3, 10**5), 40, 0, 3),
        (60, np.linspace(0.01, 1.1, 5000), 8, 0, 3),
        (60, np.linspace(0.01, 1.1, 10**5), 160, 0, 1),
        (200, np.linspace(0.3, 0.6, 1376), 16, 0, 1),  # as close as 5000 from .01 to 1.1
    )
    for side, omegas, part, resolve, repeats in plan:
        lattice, site = lattice_of(side)[0], (side - 12, side // 2)
        # stretches of neighbours, which may share factorizations
        timed = omegas.reshape(-1, 8)[::part].ravel() if part > 1 else omegas
        yield Row(
            f"curve {side} x {side}, {len(omegas)} frequencies" + ", resolved" * (resolve is None),
            partial(by_pgran(sweep, lattice, timed, site, method="points"), ALONE),
            by_pgran(sweep, lattice, omegas, site, method="curve", resolve=resolve),
            at_the_same,
            (1000 * len(timed) / len(omegas), 1000),
            repeats=repeats,
        )


def at_the_same(points, curve):
    """Return the largest relative difference at the frequencies that both have."""
    _, first, second = np.intersect1d(points.omega, curve.omega, return_indices=True)
    return relative(points.displacement[first], curve.displacement[second])


def bounds():
    """Yield what adjoints, residuals and bounds add to factoring and solving."""
    for side, omegas in ((20, PAPER[::4]), (200, np.linspace(0.05, 0.5, 4))):
        lattice, site = lattice_of(side)
        yield Row(
            f"bounds {side} x {side}, ms a frequency",
            partial(solve_only, lattice, omegas, site),
            partial(solve_with_bounds, lattice, omegas, site),
            relative,
            (len(omegas), len(omegas)),
            (ALONE,),
        )


def modes():
    """Yield all modes against NumPy's eigh, and an interval against eigsh around its middle."""
    for side in (20, 40):
        lattice, _ = lattice_of(side, damping=0.0)
        yield Row(
            f"all modes of {side} x {side} (eigh)",
            partial(np.linalg.eigh, laplacian(lattice.stiffness).toarray()),
            by_pgran(find_modes, lattice, shapes=True),
            lambda peer, own: np.max(np.abs(own.omega - np.sqrt(peer[0]))),
        )
    lattice, interval = lattice_of(100, damping=0.0)[0], (0.5, 0.518)
    own = by_pgran(find_modes, lattice, interval=interval)
    count, sigma = len(own(ALONE).omega), 0.5 * np.dot(interval, interval)

    def difference(peer, own):
        return max(np.min(np.abs(np.sqrt(peer[0]) - omega)) for omega in own.omega[10:-10])

    peer = partial(eigsh, laplacian(lattice.stiffness), k=count, sigma=sigma)
    yield Row(f"{count} modes of 100 x 100 (eigsh)", peer, own, difference)


def relaxations():
    """Yield relaxations by each method against a splu a step."""
    for side, window, others, steps in (
        (20, 20000, 2000, 500),
        (60, 4096, 200, 60),
        (200, 512, 16, 8),
    ):
        lattice, site = lattice_of(side, damping=0.01)
        changes = draw_changes(UNIFORM, lattice.shape, 1, 0, 0, steps)
        for method in ("window", "krylov", "direct"):
            taken = window if method == "window" else others
            yield Row(
                f"{method}, {side} x {side}, ms a step",
                partial(scipy_relaxation, lattice, 0.6, site, changes),
                by_pgran(relax, lattice, UNIFORM, 0.6, site, steps=taken, method=method),
                lambda peer, own: relative(peer, own.displacement[0, 1 : len(peer) + 1, 0]),
                (steps, taken),
                (ALONE,),
            )


def networks():
    """Yield steady states and modes of random networks, against SciPy on the same matrix."""
    for balls, axes, displacement in (
        (200_000, 2, "scalar"),
        (50_000, 2, "vector"),
        (30_000, 3, "scalar"),
        (10_000, 3, "vector"),
    ):
        network = random_geometric(balls, axes, displacement=displacement)
        depths, label = network.depths(network.free[:, None]), f"{balls} {displacement}, {axes}D"
        ball = int(network.free[np.argmin(np.abs(depths - 3))])
        omega = 0.3 * network.omega_mx
        yield Row(
            f"one steady state, {label}",
            partial(scipy_network_sweep, network, [omega], ball),
            by_pgran(sweep, network, [omega], ball, group=None),
            lambda peer, own: relative(peer, own.displacement[:, 0]),
            repeats=3,
        )
        omegas = omega * np.linspace(1, 1.05, 8)
        yield Row(
            f"eight steady states, {label}",
            partial(scipy_network_sweep, network, omegas, ball),
            by_pgran(sweep, network, omegas, ball),
            lambda peer, own: relative(peer, own.displacement[:, 0]),
            repeats=1,
        )
        target = 0.2 * network.omega_mx
        yield Row(
            f"20 modes, {label}",
            partial(scipy_network_modes, network, target, 20),
            by_pgran(find_modes, network, targets=[target], count=20),
            partial(nearest_relative, network.mass),
            repeats=1,
        )


def scipy_network_sweep(network, omegas, ball):
    """Return the amplitudes at a ball of a network, by a splu a frequency."""
    springs, B = network.springs, network.B
    K, C = (
        (B.T @ sp.diags(k) @ B).tocsc()
        for k in (springs.constants, network.damping * springs.damped)
    )
    identity = sp.identity(network.balls, format="csc")
    (unknowns,), (weights,) = network.readings([[ball]])
    amplitudes = []
    for omega in omegas:
        constants = springs.constants + 1j * omega * network.damping * springs.damped
        factor = splu(K + 1j * omega * C - network.mass * omega**2 * identity, **SPLU)
        field = factor.solve(-(B.T @ (constants * springs.drive)))
        amplitudes.append(weights @ field[unknowns])
    return np.array(amplitudes)


def scipy_network_modes(network, omega, count):
    """Return m omega^2 of the modes of a network nearest to a frequency, by eigsh on a splu."""
    B = network.B
    K = (B.T @ sp.diags(network.constants) @ B).tocsc()
    sigma = network.mass * omega**2
    factor = splu(K - sigma * sp.identity(network.balls, format="csc"), **SPLU)
    inverse = LinearOperator(K.shape, factor.solve)
    return np.sort(eigsh(K, k=count, sigma=sigma, OPinv=inverse)[0])


def nearest_relative(mass, peer, own):
    """Return how far SciPy's m omega^2 are from the nearest of pgran's, relatively."""
    return max(np.min(np.abs(mass * own.omega**2 - value)) / abs(value) for value in peer)


def measure(row):
    """Print a row of the table: medians of times that are taken in turns."""
    works = [(ALONE, row.peer), *((comm, partial(row.own, comm)) for comm in row.ranks)]
    found, seconds = [None] * len(works), [[] for _ in works]
    for _ in range(row.repeats):
        for number, (comm, work) in enumerate(works):
            WORLD.Barrier()
            if comm is WORLD or WORLD.rank == 0:
                started = time.perf_counter()
                found[number] = work()
                seconds[number].append(time.perf_counter() - started)
    if WORLD.rank > 0:
        return
    items = row.items[0], *[row.items[1]] * len(row.ranks)
    peer, *own = (1e3 * statistics.median(s) / n for s, n in zip(seconds, items, strict=True))
    times = "".join(f"{value:10.4g}" for value in own)
    ratios = "".join(f"{peer / value:8.2f}" for value in own)
    failures = getattr(found[1], "failures", 0)
    error = row.difference(*found[:2])
    say(f"{row.label:36}{peer:10.4g}{times:20}{ratios:16}   {error:.1e} {failures}")


def say(text):
    """Print a line on rank 0."""
    if WORLD.rank == 0:
        print(text, flush=True)


def main():
    """Print the table."""
    ranks = f"{WORLD.size} ranks"
    say(f"medians of up to {REPEATS} interleaved repeats; seconds, where nothing else is said")
    titles = f"{'peer':>10}{'1 rank':>10}{ranks:>10}{'peer/1':>8}{'peer/all':>8}"
    say(f"{'':36}{titles}   difference, failures")
    chosen = [globals()[name] for name in sys.argv[1:]]
    for rows in chosen or (sweeps, curves, bounds, modes, relaxations, networks):
        for row in rows():
            measure(row)


if __name__ == "__main__":
    sys.exit(main())
