"""The program against what a user would write with SciPy, in one run: times and differences.

Started by jobs/benchmark.sh on 2 ranks. While one rank measures, the other waits.
"""

import dataclasses
import inspect
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

import mpi4py.MPI  # noqa: F401 (first: PETSc may have no MPI library of its own)
import petsc4py

petsc4py.init(["benchmark", "-skip_petscrc"])

import numpy as np  # noqa: E402
from mpi4py import MPI  # noqa: E402
from peers import Peer  # noqa: E402

import pgran  # noqa: E402
from pgran.__main__ import console  # noqa: E402
from pgran.driven.linear import make_ksp  # noqa: E402
from pgran.driven.moments import Chebyshev  # noqa: E402
from pgran.driven.operators import Operators  # noqa: E402
from pgran.driven.recurrence import Rows  # noqa: E402
from pgran.driven.steady import SteadySolver  # noqa: E402
from pgran.errors import InputError  # noqa: E402
from pgran.medium.crystals import random_geometric  # noqa: E402
from pgran.medium.graph import subnetwork  # noqa: E402
from pgran.medium.law import draw_changes  # noqa: E402
from pgran.medium.network_file import read_network  # noqa: E402
from pgran.medium.waves import Waves  # noqa: E402
from pgran.run.crew import Crew  # noqa: E402

WORLD, ALONE = MPI.COMM_WORLD, MPI.COMM_SELF
PACKINGS = Path(__file__).parents[1] / "options" / "packings"
UNIFORM = pgran.BondLaw("uniform")


@dataclass(frozen=True)
class Pair:
    """What is compared; times are divided by how many items the peer and pgran compute.

    The peer is a function of nothing, pgran's own is one of the ranks.
    """

    peer: Callable
    own: Callable
    difference: Callable  # of the two results
    items: tuple = (1, 1)
    unit: str = "s"
    ranks: tuple = (ALONE, WORLD)
    repeats: int = 5


def by_pgran(function, *arguments, group=1, **choices):
    """Return a function of the ranks that computes a record on its first rank.

    So many ranks share a lattice, all if None.
    """

    def compute(comm):
        with Crew(comm, group or comm.size) as crew:
            return function(*arguments, crew=crew, **choices)

    return compute


def lattice_of(side, damping=0.003):
    """Return a square lattice at the paper's parameters, and a detector inside."""
    return pgran.Lattice.random((side, side), damping=damping), (side * 2 // 5, side // 2)


def apart(reference, found):
    """Return the largest relative difference."""
    return np.max(np.abs(found - reference) / np.abs(reference))


def of_amplitudes(peer, own):
    """Return the same of a response or of a relaxation, whose first step changes nothing."""
    if own.displacement.ndim == 3:
        return apart(peer, own.displacement[0, 1 : len(peer) + 1, 0])
    return apart(peer, own.displacement[:, 0])


def of_curves(points, curve, name="displacement"):
    """Return the same of what has a name, at the frequencies that both have."""
    _, first, second = np.intersect1d(points.omega, curve.omega, return_indices=True)
    return apart(getattr(points, name)[first], getattr(curve, name)[second])


def of_modes(peer, own):
    """Return the same of frequencies of modes, each of the peer's against pgran's nearest."""
    return max(np.min(np.abs(own.omega - omega)) / omega for omega in peer)


def of_spectra(peer, own):
    """Return the difference of all omega^2, some of which may be 0, relative to the largest."""
    return np.max(np.abs(np.sign(own.omega) * own.omega**2 - peer)) / peer[-1]


def of_near_modes(peer, own):
    """Return the same of the nearer half: of the others the peer may have found other ones."""
    return of_modes(peer[: len(peer) // 2], own)


def of_damped_modes(peer, own):
    """Return the largest relative distance of a mode from the other's nearest one.

    The peer has all modes, or some, of which the nearer half are compared.
    """
    if len(peer) > len(own.eigenvalue):
        return max(np.min(np.abs(peer - s)) / abs(s) for s in own.eigenvalue)
    return max(np.min(np.abs(own.eigenvalue - s)) / abs(s) for s in peer[: len(peer) // 2])


def of_largest(reference, found):
    """Return the largest difference relative to the largest number."""
    return np.max(np.abs(found - reference)) / np.max(np.abs(reference))


def sweep(side, low, high, count):
    """Compare a sweep with a splu a frequency."""
    (lattice, site), omegas = lattice_of(side), np.linspace(low, high, count)
    return Pair(
        lambda: Peer(lattice, site).sweep(omegas),
        by_pgran(pgran.sweep, lattice, omegas, site, method="points"),
        of_amplitudes,
    )


def curve(side, low, high, count, part, resolve=0, repeats=1):
    """Compare a curve by models of intervals with pgran's own points, timed at one `part`."""
    lattice, omegas = lattice_of(side)[0], np.linspace(low, high, count)
    site = side - min(12, side // 2), side // 2
    # stretches of neighbours, which may share factorizations
    timed = omegas.reshape(-1, 8)[::part].ravel() if part > 1 else omegas
    return Pair(
        partial(by_pgran(pgran.sweep, lattice, timed, site, method="points"), ALONE),
        by_pgran(pgran.sweep, lattice, omegas, site, method="curve", resolve=resolve),
        of_curves,
        (len(timed) / count, 1),
        repeats=repeats,
    )


def bound(side, low, high, count):
    """Compare amplitudes and their bounds with one factorization and one solve each."""
    (lattice, site), omegas = lattice_of(side), np.linspace(low, high, count)

    def without():
        amplitudes = []
        with Operators(lattice, ALONE) as operators:
            ksp, field = make_ksp(operators, operators.S), operators.f.duplicate()
            ksp.setType("preonly")
            ksp.setInitialGuessKnoll(False)
            (number,), _ = operators.layout.readings([site])
            for omega in omegas:
                operators.combine(1j * omega)
                ksp.setOperators(operators.S)
                ksp.solve(operators.f, field)
                amplitudes.extend(field.getArray(readonly=True)[number])
            ksp.destroy()
            field.destroy()
        return np.array(amplitudes)

    def own(comm):
        with Operators(lattice, comm) as operators, SteadySolver(operators, [site]) as solver:
            return np.array([solver.solve(1j * omega).displacement[0] for omega in omegas])

    return Pair(without, own, apart, 2 * (count / 1000,), "ms", (ALONE,))


def whole_spectrum(medium, site, method):
    """Compare all modes and their shapes with NumPy's eigh."""
    own = by_pgran(pgran.find_modes, medium, shapes=True, method=method)
    return Pair(lambda: Peer(medium, site).all_modes(), own, of_spectra)


def all_modes(side, method):
    """Compare all modes of a lattice."""
    return whole_spectrum(*lattice_of(side), method)


def packing_modes(name, turning, balls=None):
    """Compare all modes of a packing that comes with pgran, or of its first free balls."""
    network = read_network(PACKINGS / f"{name}.h5")
    if turning:
        shear = 0.8 * network.stiffness
        network = dataclasses.replace(network, displacement="rotations", tangential=shear)
    if balls:
        network = subnetwork(network, network.free[:balls])
    return whole_spectrum(network, (int(network.free[0]),), "dense")


def random_modes(balls):
    """Compare all modes of random spheres with vectors."""
    return whole_spectrum(*network_of(balls, 3, "vector"), "dense")


def modes(side, interval):
    """Compare the modes of an interval with eigsh around its middle."""
    lattice, site = lattice_of(side)
    own = by_pgran(pgran.find_modes, lattice, interval=interval)
    count, middle = len(own(ALONE).omega), np.linalg.norm(interval) / np.sqrt(2)
    return Pair(lambda: Peer(lattice, site).modes_near(middle, count), own, of_near_modes)


def damped_modes(balls, axes, displacement, count=None):
    """Compare all damped modes of a network, or some near a frequency, with SciPy's."""
    network, site = network_of(balls, axes, displacement)
    near = {} if count is None else {"targets": [0.2 * network.omega_mx], "count": count}
    if count is None:
        peer = Peer(network, site).all_damped_modes
    else:
        peer = partial(Peer(network, site).damped_modes_near, near["targets"][0], count)
    own = by_pgran(pgran.find_modes, network, damped=True, **near)
    return Pair(peer, own, of_damped_modes, repeats=3)


def relaxation(side, method, taken, steps):
    """Compare a relaxation with a splu a step, of which the peer takes fewer.

    The ball is where the wall is heard: where |A| is 1e-14 no window reaches beyond a step.
    """
    lattice, site = lattice_of(side, damping=0.01)[0], (side * 4 // 5, side // 2)
    changes = draw_changes(UNIFORM, lattice.bonds, 1, 0, 0, steps)
    return Pair(
        lambda: Peer(lattice, site).relaxation(0.6, changes),
        by_pgran(pgran.relax, lattice, UNIFORM, 0.6, site, steps=taken, method=method),
        of_amplitudes,
        (steps / 1000, taken / 1000),
        "ms",
        (ALONE,),
    )


@cache
def network_of(balls, axes, displacement):
    """Return a random network, and a ball near the driven end."""
    network = random_geometric(balls, axes, displacement=displacement)
    depths = network.depths(network.free[:, None])
    return network, (int(network.free[np.argmin(np.abs(depths - 3))]),)


def network_states(balls, axes, displacement, count):
    """Compare steady states of a network: one that all ranks share, or several."""
    network, site = network_of(balls, axes, displacement)
    omegas = 0.3 * network.omega_mx * np.linspace(1, 1.05, count)
    return Pair(
        lambda: Peer(network, site).sweep(omegas),
        by_pgran(pgran.sweep, network, omegas, site, group=None if count == 1 else 1),
        of_amplitudes,
        repeats=3 if count == 1 else 1,
    )


def network_modes(balls, axes, displacement, count=20):
    """Compare modes of a network near a frequency with eigsh."""
    network, site = network_of(balls, axes, displacement)
    target = 0.2 * network.omega_mx
    return Pair(
        lambda: Peer(network, site).modes_near(target, count),
        by_pgran(pgran.find_modes, network, targets=[target], count=count),
        of_near_modes,
        repeats=1,
    )


def bulk(balls, axes, displacement, damping=0.0):
    """Return a lattice of about so many balls, or a network of the bulk where there are vectors."""
    if displacement == "scalar":
        return pgran.Lattice.random((round(balls ** (1 / axes)),) * axes, damping=damping)
    chosen = {"displacement": displacement, "damping": damping}
    periodic = [False, *[True] * (axes - 1)]
    return random_geometric(balls, axes, 4.0 + 2 * axes, periodic=periodic, **chosen)


def waves(medium, count=120):
    """Return frequencies up to near the last modes, and what else `structure` is told."""
    omegas = medium.omega_mx * (1.2 if medium.is_grid else 2.0) * np.arange(1, count + 1) / count
    return omegas, {"direction": "x", "width": 2 * omegas[0]}


def structure(balls, axes, displacement, timed, damping=0.0, repeats=3):
    """Compare structure factors by moments with pgran's own factorizations, of some `timed`."""
    medium = bulk(balls, axes, displacement, damping)
    omegas, chosen = waves(medium)
    some = omegas[len(omegas) // (2 * timed) :: len(omegas) // timed]
    return Pair(
        partial(by_pgran(pgran.structure, medium, 2, some, method="factor", **chosen), ALONE),
        by_pgran(pgran.structure, medium, 2, omegas, method="moments", **chosen),
        partial(of_curves, name="structure_factor"),
        (len(some) / len(omegas), 1),
        repeats=repeats,
    )


def highest(medium):
    """Return what pgran encloses the eigenvalues of K by."""
    scaled, unit = medium.undamped().in_own_unit()
    with Rows(scaled, ALONE) as rows:
        return 4 * unit / Chebyshev(rows, scaled, (0.0, 0.0, 0.0), ()).a


def kernels(balls, axes, displacement):
    """Compare the same with a peer's kernel polynomials, as many, who knows where K ends."""
    medium = bulk(balls, axes, displacement)
    (omegas, chosen), standing, top = waves(medium), Waves(medium), highest(medium)
    own = by_pgran(pgran.structure, medium, 2, omegas, method="moments", **chosen)
    (patterns, places), count = standing.patterns(standing.first(2, "x")), own(ALONE).moments

    def peer():
        found = Peer(medium).spectra(patterns, chosen["width"] + 1j * omegas, count, top)
        return np.array([np.bincount(places, each) for each in found.T])

    return Pair(peer, own, lambda p, o: apart(p, o.structure_factor.reshape(p.shape)))


def density(balls, axes, vectors, bins=60):
    """Compare a density of modes with a peer's kernel polynomials of the same random vectors."""
    medium = bulk(balls, axes, "scalar")
    omegas, top = medium.omega_mx * np.linspace(0, 1.4, bins + 1), highest(medium)
    count = 8 * bins
    chosen = {"method": "moments", "vectors": vectors, "moments": count}
    unit = medium.omega_mx / medium.free_balls
    return Pair(
        lambda: unit * Peer(medium).density(omegas, vectors, count, top),
        by_pgran(pgran.count_modes, medium, omegas, group=None, **chosen),
        lambda p, o: of_largest(p, o.density),
        repeats=3,
    )


def pulses(side, time):
    """Compare a pulse by moments with pgran's own by Laplace transforms."""
    site = side - min(12, side // 2), side // 2
    own = partial(by_pgran, pgran.pulse, lattice_of(side)[0], site, time=time)
    return Pair(
        partial(own(method="laplace"), ALONE),
        own(method="moments", group=None),
        lambda p, o: of_largest(p.displacement, o.displacement),
        repeats=1,
    )


def wall(balls, axes, damping, low, high, count, timed):
    """Compare all frequencies of a driven wall by moments with some by factorizations."""
    lattice = bulk(balls, axes, "scalar", damping)
    site = lattice.shape[0] - 3, *[n // 2 for n in lattice.shape[1:]]
    omegas = np.linspace(low, high, count)
    some = omegas[:: (count - 1) // (timed - 1)]
    return Pair(
        partial(by_pgran(pgran.sweep, lattice, some, site, method="points"), ALONE),
        by_pgran(pgran.sweep, lattice, omegas, site, method="moments"),
        of_curves,
        repeats=1,
    )


def loud(balls, integrated=False):
    """Compare the motion that opens 1 % of contacts with that in time, or with the linear one."""
    shape = (2, 1, 1) if balls < 200 else None
    chosen = {"law": "hertz", "pressure": 1e-4, "walls": "x", "seed": 1, "sizes": 0.1}
    network = pgran.pack(balls, dimension=3, shape=shape, **chosen)
    omega, site = 0.2 * network.omega_mx, (int(network.free[len(network.free) // 2]),)
    damping = float(network.stiffness.mean() / (10 * omega))
    chosen = {"damping": damping, "damping_power": 1.0, "damped": "normal"}
    network = dataclasses.replace(network, **chosen)
    linear = by_pgran(pgran.sweep, network, [omega], site, method="points")
    amplitude = float(linear(ALONE).opening_part[0, 1])
    chosen = {"stability": False, "reach": 0.0, "error_tolerance": LOUD}
    own = by_pgran(pgran.loud, network, [omega], site, [amplitude], group=None, **chosen)
    if not integrated:  # the linear motion is another: what pgran says of its own error
        return Pair(partial(linear, ALONE), own, lambda _, o: o.harmonic_error.max() / amplitude)
    settled = partial(Peer(network, site).settled, omega, amplitude, LOUD)
    return Pair(settled, own, lambda p, o: apart(p, o.harmonic[0, 0, 0, 1]), repeats=3)


PAPER = 0.01, 1.3, 1291
LOUD = 1e-4  # accuracy of motions that open contacts
VECTORS = 10_000, 3, "vector"
FACTORED = "(peer: pgran by factors)"
ONE_BY_ONE = "(peer: pgran, one by one)"
ROWS = {  # named as in README.md
    "20 x 20, the paper's 1291 frequencies, with bounds": (sweep, 20, *PAPER),
    "60 x 60, 128 frequencies, with bounds": (sweep, 60, 0.01, 1.0, 128),
    "200 x 200, 16 frequencies, with bounds": (sweep, 200, 0.05, 0.5, 16),
    f"20 x 20, a curve through the paper's {ONE_BY_ONE}": (curve, 20, *PAPER, 1, None, 5),
    f"20 x 20, a curve at 10^5 frequencies {ONE_BY_ONE}": (curve, 20, 0.01, 1.3, 10**5, 40, 0, 3),
    f"60 x 60, a curve at 5000 frequencies {ONE_BY_ONE}": (curve, 60, 0.01, 1.1, 5000, 8, 0, 3),
    f"60 x 60, a curve at 10^5 frequencies {ONE_BY_ONE}": (curve, 60, 0.01, 1.1, 10**5, 160),
    f"200 x 200, a curve from .3 to .6 {ONE_BY_ONE}": (curve, 200, 0.3, 0.6, 1376, 16),
    "20 x 20, a frequency with its bound (peer: pgran without)": (bound, 20, 0.01, 1.3, 323),
    "200 x 200, a frequency with its bound (peer: pgran without)": (bound, 200, 0.05, 0.5, 4),
    "all modes of 20 x 20, certified": (all_modes, 20, "eps"),
    "all modes of 40 x 40, certified": (all_modes, 40, "eps"),
    "all modes of 20 x 20, proven": (all_modes, 20, "dense"),
    "all modes of 40 x 40, proven": (all_modes, 40, "dense"),
    "all modes of 343 discs, 686 unknowns, proven": (packing_modes, "discs", False),
    "all modes of 252 spheres, 756 unknowns, proven": (packing_modes, "spheres", False),
    "all modes of 252 spheres that turn, 1512 unknowns, proven": (packing_modes, "spheres", True),
    "all modes of 1000 spheres, 2370 unknowns, proven": (random_modes, 1000),
    "210 modes of 100 x 100, certified": (modes, 100, (0.5, 0.518)),
    "all damped modes of 500 spheres, proven": (damped_modes, 500, 3, "scalar"),
    "network of 10,000 spheres with vectors, 25 damped modes": (damped_modes, *VECTORS, 25),
    "relaxation, 20 x 20, a step": (relaxation, 20, "window", 20_000, 500),
    "relaxation, 20 x 20, a step by krylov": (relaxation, 20, "krylov", 2000, 500),
    "relaxation, 20 x 20, a step by direct": (relaxation, 20, "direct", 2000, 500),
    "relaxation, 60 x 60, a step": (relaxation, 60, "window", 4096, 60),
    "relaxation, 60 x 60, a step by krylov": (relaxation, 60, "krylov", 200, 60),
    "relaxation, 60 x 60, a step by direct": (relaxation, 60, "direct", 200, 60),
    "relaxation, 200 x 200, a step": (relaxation, 200, "window", 512, 8),
    "relaxation, 200 x 200, a step by krylov": (relaxation, 200, "krylov", 16, 8),
    "relaxation, 200 x 200, a step by direct": (relaxation, 200, "direct", 16, 8),
}
BULK = {  # about as many unknowns each, of vectors fewer
    "316 x 316": (316**2, 2, "scalar", 4),
    "46 x 46 x 46": (46**3, 3, "scalar", 2),
    "39,000 unknowns, vectors in 2D": (20_000, 2, "vector", 4),
    "36,000 unknowns, vectors in 3D": (13_500, 3, "vector", 4),
}
for name, sizes in BULK.items():
    ROWS |= {
        f"structure of {name} {FACTORED}": (structure, *sizes),
        f"structure of {name} (peer: kernel polynomials)": (kernels, *sizes[:3]),
    }
ROWS |= {
    f"structure of 100 x 100, beta .003 {FACTORED}": (structure, 100**2, 2, "scalar", 4, 0.003),
    f"structure of 46 x 46 x 46, beta .003 {FACTORED}": (
        structure, 46**3, 3, "scalar", 2, 0.003, 1,
    ),
    "pulse of 200 x 200 (peer: pgran by laplace)": (pulses, 200, 600.0),
    "wall of 46 x 46 x 46, beta .03, 200 frequencies (peer: pgran, 4 of them)": (
        wall, 46**3, 3, 0.03, 0.3, 1.0, 200, 4,
    ),
    "density of modes of 1000 x 1000 (peer: kernel polynomials)": (density, 1000**2, 2, 2),
    "60 spheres, 1 % of contacts open (peer: DOP853 until it stands)": (loud, 60, True),
    "1000 spheres, 1 % of contacts open (peer: pgran, linear)": (loud, 1000),
    "3000 spheres, 1 % of contacts open (peer: pgran, linear)": (loud, 3000),
}  # fmt: skip
for balls, axes, displacement, kind in (
    (200_000, 2, "scalar", "discs"),
    (50_000, 2, "vector", "discs with vectors"),
    (30_000, 3, "scalar", "spheres"),
    (*VECTORS, "spheres with vectors"),
):
    network = f"network of {balls:,} {kind}"
    ROWS |= {
        f"{network}, one steady state": (network_states, balls, axes, displacement, 1),
        f"{network}, eight steady states": (network_states, balls, axes, displacement, 8),
        f"{network}, 20 modes": (network_modes, balls, axes, displacement),
    }
SMALL = {  # what makes each row a trial of itself
    sweep: {"side": 6, "count": 6},
    curve: {"side": 6, "low": 0.3, "high": 0.4, "count": 40, "part": 1},
    bound: {"side": 6, "count": 6},
    all_modes: {"side": 6},
    packing_modes: {"balls": 100},
    random_modes: {"balls": 100},
    modes: {"side": 10, "interval": (0.4, 0.8)},
    damped_modes: {"balls": 100},
    structure: {"balls": 100},
    kernels: {"balls": 100},
    density: {"balls": 100, "bins": 10},
    pulses: {"side": 6, "time": 250.0},
    loud: {"balls": 60},
    wall: {"balls": 100, "damping": 0.1, "low": 0.5, "count": 10},
    relaxation: {"side": 6, "taken": 8, "steps": 4},
    network_states: {"balls": 100},
    network_modes: {"balls": 100, "count": 8},
}


def measure(pair, repeats):
    """Return the figures of a row: medians of times that are taken in turns. Collective."""
    works = [(ALONE, pair.peer), *((comm, partial(pair.own, comm)) for comm in pair.ranks)]
    found, seconds = [None] * len(works), [[] for _ in works]
    for _ in range(repeats):
        for number, (comm, work) in enumerate(works):
            WORLD.Barrier()
            if comm is WORLD or WORLD.rank == 0:
                started = time.perf_counter()
                found[number] = work()
                seconds[number].append(time.perf_counter() - started)
    if WORLD.rank > 0:
        return []
    items = pair.items[0], *[pair.items[1]] * len(pair.ranks)
    peer, *own = (statistics.median(s) / n for s, n in zip(seconds, items, strict=True))
    none = [""] * (2 - len(own))
    times = [f"{digits(value)} {pair.unit}" for value in (peer, *own)]
    ratios = [digits(peer / value) for value in own]
    difference, failures = pair.difference(*found[:2]), getattr(found[1], "failures", 0)
    return [*times, *none, *ratios, *none, f"{difference:.0e}", str(np.sum(failures))]


def digits(value):
    """Return a number with two digits, as the manual writes it: .53, 1.2, 480."""
    return f"{float(f'{value:.2g}'):g}".removeprefix("0")


def say(*cells):
    """Print a line of the table on rank 0."""
    if WORLD.rank == 0:
        print("|", " | ".join(cells), "|", flush=True)


def main(words):
    """Print the table, or the rows whose names hold one of some words; `--small` tries rows out."""
    small, words = "--small" in words, [word for word in words if word != "--small"]
    names = [name for name in ROWS if not words or any(word in name for word in words)]
    if not names:
        raise InputError(f"no row's name holds {' or '.join(words)}; they are {'; '.join(ROWS)}")
    ranks = f"{WORLD.size} ranks"
    say("workload", "peer", "1 rank", ranks, "peer / 1 rank", f"peer / {ranks}", "difference",
        "failures")  # fmt: skip
    say(*8 * ["---"])
    for name in names:
        function, *sizes = ROWS[name]
        sizes = inspect.signature(function).bind(*sizes).arguments
        pair = function(**sizes | (SMALL[function] if small else {}))
        say(name, *measure(pair, 1 if small else pair.repeats))


if __name__ == "__main__":
    console(main)  # what goes wrong on one rank ends both
