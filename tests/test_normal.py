"""Normal modes by either method: dense linear algebra, closed forms, what is missed or spoilt."""

import dataclasses
import functools
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from mode_faults import faults_near
from mpi4py import MPI
from network_samples import NetworkReference, as_network, unstable_network
from petsc4py import PETSc
from reference import Reference, uniform_frequencies
from samples import islands, random_lattice, uniform_lattice

from pgran import InputError, Lattice, Network
from pgran.driven.counting import ModeCounter
from pgran.driven.operators import Operators
from pgran.experiments.modes import normal, slices
from pgran.experiments.modes.normal import ModeSolver
from pgran.experiments.modes.scene import certificate, find_modes
from pgran.medium import crystals
from pgran.medium.base import Elimination
from pgran.run.crew import Crew

SOLVERS = Path(__file__).parents[1] / "options" / "solvers"
MEDIA = {
    "chain": lambda: random_lattice((30,), 5, mass=1.7),
    "ball": lambda: random_lattice((1, 1), 5, mass=1.7),
    "one unknown": lambda: dataclasses.replace(as_network(random_lattice((1,))), damping=0.0),
    "bimodal": lambda: random_lattice((6, 7), 5, law="bimodal"),
    "wide": lambda: random_lattice((13, 9), 5, law="wide"),
    "equal": lambda: uniform_lattice((5, 5, 5), mass=0.8),
    "loose": lambda: islands((9, 8), 5),
    "vectors": lambda: crystals.random_geometric(40, 2, displacement="vector"),
    "unstable": lambda: unstable_network(5).network,
}


@pytest.fixture
def crew(world):
    with Crew(world, 1) as crew:
        yield crew


@pytest.fixture
def narrow(monkeypatch):
    """Make small lattices go through many slices."""
    monkeypatch.setattr(slices, "SLICE", 6)


def modes_of(medium, crew, **which):
    """The modes and their shapes, on every rank."""
    return crew.world.bcast(find_modes(medium, crew, **{"shapes": True} | which))


@functools.cache
def stiffness(medium):
    """K over the unknowns, weighted by masses."""
    if medium.is_grid:
        return Reference(medium.stiffness).K.astype(float)
    reference = NetworkReference(medium)
    return reference.weighted(reference.K).astype(float)


def roots(values, medium):
    """The frequency of each eigenvalue of K, negative if unstable."""
    return np.sign(values) * np.sqrt(np.abs(values) / medium.mass)


def wanted(values, medium, interval=None, targets=None, count=None):
    """The eigenvalues that are asked for."""
    omegas, edge = roots(values, medium), 1e-13 * np.abs(values).max()
    if targets is not None:
        return values[sorted({i for t in targets for i in np.argsort(abs(omegas - t))[:count]})]
    low, high = (medium.mass * omega**2 for omega in interval or (0.0, np.inf))
    return values[((values >= low - edge) | (low == 0)) & (values <= high + edge)]


def check(medium, modes, **which):
    """Assert that `modes` are all those that are asked for, by dense linear algebra."""
    K = stiffness(medium)
    values = np.linalg.eigvalsh(K)
    scale, values = np.abs(values).max(), wanted(values, medium, **which)
    assert modes.count_expected == len(values) == len(modes.omega)
    assert modes.count_certified
    F = modes.vector.reshape(-1, medium.size)
    assert F.dtype == float
    squares = medium.mass * modes.omega * np.abs(modes.omega)
    np.testing.assert_allclose(squares, values, rtol=0, atol=2e-13 * scale)
    residual = np.linalg.norm(K @ F.T - squares * F.T, axis=0)
    assert residual.max(initial=0) <= 1e-12 * scale
    assert np.all(residual <= (modes.residual + 1e-14) * 2 * scale)
    assert np.abs(F @ F.T - np.eye(len(F))).max(initial=0) <= 1e-10
    assert np.all(F[np.arange(len(F)), np.argmax(np.abs(F), axis=1)] > 0)
    if medium.is_grid:
        np.testing.assert_allclose(modes.participation, 1 / np.sum(F**4, axis=1), rtol=1e-12)


def selections(omegas):
    """Intervals, some empty, some from one mode to another, and targets, alone and together."""
    rng, top = np.random.default_rng(len(omegas)), omegas[-1]
    yield {}
    for part in ((0.3, 0.6), (0.0, 0.4), (1.2, 1.3), (0.0, 1e-4)):
        yield {"interval": tuple(np.multiply(part, top))}
    for _ in range(2):
        low, high = np.sort(np.abs(rng.choice(omegas, 2)))
        yield {"interval": (low, high + 1e-9 * top)}
    for targets, count in (([0.0], 7), ([0.43], 1), ([0.1], 1000), ([0.3, 0.31, 0.8, 0.305], 9)):
        yield {"targets": np.multiply(targets, top).tolist(), "count": count}


@pytest.mark.parametrize("method", ["eps", "dense"])
@pytest.mark.parametrize("name", MEDIA)
def test_modes_are_those_of_dense_algebra(name, method, crew, narrow):
    """None is missing or too many, on any ranks; `dense` has bounds."""
    medium = MEDIA[name]()
    omegas = roots(np.linalg.eigvalsh(stiffness(medium)), medium)
    for which in selections(omegas):
        modes = modes_of(medium, crew, method=method, **which)
        check(medium, modes, **which)
        assert (modes.omega_bound is None) == (method == "eps")
        with Crew(MPI.COMM_SELF, 1) as single:
            alone = find_modes(medium, single, method=method, shapes=True, **which)
        np.testing.assert_array_equal(modes.omega, alone.omega)
        np.testing.assert_array_equal(modes.vector, alone.vector)
    if name == "equal":
        exact = uniform_frequencies(medium.shape, 0.25, medium.mass)
        np.testing.assert_allclose(omegas, exact, rtol=1e-12)


@pytest.mark.parametrize("name", ["dense", "slicing", "shift_invert", "ciss"])
def test_solver_files(name, crew, solver_options):
    """Units change nothing: stiffness 4^33 = 7e19 times as large or small, the same digits."""
    lines = (SOLVERS / f"modes_{name}.opts").read_text().splitlines()
    solver_options(" ".join(line for line in lines if not line.startswith("#")))
    lattice = random_lattice((6, 5), seed=8)
    check(lattice, modes_of(lattice, crew))
    part = modes_of(lattice, crew, interval=(0.3, 0.6))
    check(lattice, part, interval=(0.3, 0.6))
    for unit in (2.0**33, 2.0**-33):
        scaled = Lattice(tuple(unit**2 * k for k in lattice.stiffness), 1.0)
        others = modes_of(scaled, crew, interval=(0.3 * unit, 0.6 * unit))
        assert others.count_certified
        np.testing.assert_array_equal(unit * part.omega, others.omega)


@pytest.mark.filterwarnings("error")
def test_frequencies_too_high_to_compute_with(crew):
    for which in ({"interval": (0.0, 1e300)}, {"targets": [1e300], "count": 3}):
        with pytest.raises(InputError, match="too large"):
            find_modes(random_lattice((4, 3)), crew, **which)


def test_errors_of_petsc_are_not_hidden():
    """A slepc4py from PyPI raises a SystemError, PETSc's own error being its cause."""
    with pytest.raises(PETSc.Error, match="71"), normal.plain_errors():
        raise SystemError("returned a result with an exception set") from PETSc.Error(71)
    with pytest.raises(SystemError, match="another"), normal.plain_errors():
        raise SystemError("another") from ValueError("cause")


def test_a_search_that_failed_is_repeated_elsewhere(crew, monkeypatch, narrow):
    """Degenerate modes, so that failed searches had deflated some."""
    search, calls = ModeSolver._search, []

    def spoilt(*arguments):
        calls.append(1)
        found = search(*arguments)
        return found[:-1] if len(calls) % 3 else found

    monkeypatch.setattr(ModeSolver, "_search", spoilt)
    lattice = uniform_lattice((8, 8))
    check(lattice, modes_of(lattice, crew))


@pytest.mark.parametrize("fault", ["missing", "twice", "inaccurate"])
def test_wrong_modes_are_never_certified(fault, crew, monkeypatch, caplog, narrow):
    """One found twice makes up for none that is missing in another slice."""
    solve, search = ModeSolver.solve, ModeSolver._search

    def spoilt(self, low, high, count, search):
        values, vectors, residuals = solve(self, low, high, count, search)
        chosen = np.arange(len(values))
        if fault == "inaccurate":
            residuals = residuals + 2e-12
        elif fault == "twice" and low < 0:  # the lowest slice
            chosen = chosen[1:]
        elif fault == "twice" and high > self.norm:  # the highest
            chosen = np.append(chosen, count - 1)
        return values[chosen], vectors[chosen], residuals[chosen]

    monkeypatch.setattr(ModeSolver, "solve", spoilt)
    if fault == "missing":
        monkeypatch.setattr(ModeSolver, "_search", lambda *given: search(*given)[:-1])
    modes = modes_of(random_lattice((7, 7)), crew)
    assert not modes.count_certified
    assert modes.failures > 0
    assert (len(modes.omega) < modes.count_expected) == (fault == "missing")
    assert {"missing": "NOT ALL"}.get(fault, "NOT CERTIFIED") in certificate(modes)
    warned = crew.world.allreduce("modes found for omega^2 m from" in caplog.text, MPI.LOR)
    assert warned or fault != "missing"


@pytest.mark.parametrize("lattice", [random_lattice((8, 9), seed=3), uniform_lattice((4, 5, 3))])
def test_counts_equal_dense_ones_but_next_to_a_mode(lattice):
    """With spoilt factors, too: at 2, between 1 and 3, the first pivot of two balls is tiny."""
    values = Reference(lattice.stiffness).eigenvalues()
    with (
        Operators(lattice, MPI.COMM_SELF) as operators,
        ModeCounter(operators.K, lattice) as counter,
    ):
        for shift in np.random.default_rng(0).uniform(-0.1, 1.5, 100):
            assert counter.below(shift, 1e-9) == np.count_nonzero(values < shift)
        for value in values:
            for off in (0.0, 0.4e-6, -0.9e-6):
                assert counter.below(value + off, 1e-6) is None
    pair = uniform_lattice((2,), 1.0)
    with Operators(pair, MPI.COMM_SELF) as operators, ModeCounter(operators.K, pair) as counter:
        assert counter.below(1.8, 1e-11) == 1
        assert counter.below(2.0, 1e-11) is None


def networks():
    """Random networks of all kinds, some unstable or floating, and crystals of equal modes."""
    for seed in range(16):
        rng, axes = np.random.default_rng([7, seed]), 2 + seed % 2
        network = crystals.random_geometric(
            int(rng.integers(60, 160)), axes, 6.0, seed=seed, periodic=seed % 3 == 0,
            displacement=("scalar", "vector", "rotations")[seed // 2 % 3],
            masses=10 ** rng.uniform(-3, 3) if seed % 5 else 1.0,
        )  # fmt: skip
        if seed % 4 == 1:
            signs = rng.choice([-1, 1, 1, 1], len(network.bond))
            network = dataclasses.replace(network, stiffness=signs * network.stiffness)
        yield network
    yield crystals.crystal("square", (9, 9))
    yield crystals.crystal("fcc", (3, 3, 3), periodic=True, displacement="vector")


@pytest.fixture(params=["superlu", "petsc"])
def factors(request, monkeypatch):
    """Search by both kinds of factors, whatever would be faster."""
    costly = request.param == "superlu"
    chosen = Elimination(True, "natural", not costly, True, costly, 1.0)
    monkeypatch.setattr(Network, "elimination", property(lambda network: chosen))


def test_proven_modes_are_all_there_and_the_nearest(factors):
    seen = Counter()
    for network in networks():
        values = np.linalg.eigvalsh(network.restoring_forces(np.eye(network.size)))
        top = roots(values, network)[-1]
        asked = [(part * top, count) for part in (0.0, 0.1, 0.35, 0.8, 1.1) for count in (1, 6)]
        assert not list(faults_near(network, values, asked, seen))
    assert seen["proven"] > 0.7 * seen["targets"]


def test_a_mode_that_a_search_misses_is_found_after_all(factors, monkeypatch):
    """The counts say more than was found."""
    network, near = crystals.random_geometric(50, 3, 8.0, displacement="vector", seed=3), []
    searched, wanted = ModeSolver._near, {"targets": [0.3 * network.omega_mx], "count": 9}

    def spoilt(self, search):
        near.append(search)
        modes = searched(self, search)
        there = np.argsort(np.abs(modes.values - search.value)) != 3
        return normal.Modes(*(part[there] for part in modes))

    monkeypatch.setattr(ModeSolver, "_near", spoilt)
    with Operators(network, MPI.COMM_SELF) as operators, ModeSolver(operators) as solver:
        assert slices.proven(solver, *wanted["targets"], wanted["count"]) is None
    check(network, find_modes(network, shapes=True, method="eps", **wanted), **wanted)
    assert len(near) >= 2


def test_options_of_an_eps_have_their_meaning(solver_options, monkeypatch):
    """Whoever sets one gets counts first, and searches as the options say."""
    network, near = crystals.random_geometric(100, 2, 5.0, seed=5), []
    searched, wanted = ModeSolver._near, {"targets": [0.37 * network.omega_mx], "count": 4}
    monkeypatch.setattr(ModeSolver, "_near", lambda *given: near.append(1) or searched(*given))
    for keys in ("", "-normal_eps_tol 1e-12"):
        near.clear()
        solver_options(keys)
        check(network, find_modes(network, shapes=True, method="eps", **wanted), **wanted)
        assert bool(near) == (not keys)


def test_factors_that_fail_mark_modes_and_keys_of_factors_take_petscs(monkeypatch, caplog):
    """Of lattices of three axes, whose factors are SuperLU's unless a key asks for PETSc's."""

    def broken(*given):
        raise ZeroDivisionError("no pivot")

    lattice = Lattice.random((4, 4, 4), seed=1)
    monkeypatch.setattr(normal, "RealFactors", broken)
    found = find_modes(lattice, interval=(0.3, 0.5))
    assert (found.count_found, found.count_certified) == (0, False)
    assert "0 of 3 modes found" in caplog.text
    keys = {"normal_st_pc_factor_shift_type": "nonzero"}
    found = find_modes(lattice, interval=(0.3, 0.5), solver=keys)
    assert found.count_found == found.count_expected > 0
