"""Modes nearest to a frequency by one search, proven by one factorization at each end."""

import dataclasses

import numpy as np
import pytest
import scipy.sparse as sp
from mpi4py import MPI

from pgran.driven.counting import real_matrix
from pgran.driven.factors import RealFactors
from pgran.driven.operators import Operators
from pgran.experiments.modes import normal, slices
from pgran.experiments.modes.normal import ModeSolver
from pgran.experiments.modes.scene import find_modes
from pgran.medium import crystals as makers
from pgran.medium.base import Elimination
from pgran.medium.network import Network
from pgran.run.crew import Crew


def random_matrix(rng):
    """A random sparse symmetric matrix, and a shift that is sometimes next to a pivot."""
    size = int(rng.integers(2, 60))
    half = sp.random(size, size, 0.1, random_state=int(rng.integers(10**6)))
    K = (half + half.T + sp.diags(rng.standard_normal(size))).tocsc()
    K.sort_indices()
    near = K[0, 0] + rng.choice([1e-12, -1e-9, 1e-6, 1e-3])
    return K, near if rng.random() < 0.5 else rng.normal()


def exact_error(K, shift, factors):
    """|K - shift - L D L^T|_2 by extended precision, unknowns in the order of the factors."""
    L, U = (F.toarray().astype(np.longdouble) for F in (factors._factors.L, factors._factors.U))
    place = np.argsort(factors._factors.perm_c)
    shifted = K.toarray().astype(np.longdouble)[np.ix_(place, place)]
    shifted -= np.longdouble(shift) * np.eye(len(L), dtype=np.longdouble)
    return np.linalg.norm((shifted - (L * U.diagonal()) @ L.T).astype(float), 2)


def test_errors_of_factors_are_bounded_and_counts_within_them():
    rng, refused, close = np.random.default_rng(0), 0, 0
    for _ in range(200):
        K, shift = random_matrix(rng)
        factors, norm = RealFactors(K, shift), abs(K).sum(axis=0).max()
        if factors.negative is None:
            refused += 1
            assert factors.error() == np.inf
            continue
        exact, error = exact_error(K, shift, factors), factors.error()
        assert exact <= error <= factors.error(np.inf)
        values, rounding = np.linalg.eigvalsh(K.toarray()), 1e-14 * norm
        edge = error + rounding
        low, high = (np.count_nonzero(values < shift + side * edge) for side in (-1, 1))
        assert low <= factors.negative <= high
        close += error < 1e-10 * norm
    assert refused < 10
    assert close > 90


def test_moved_and_missing_pivots_tell_nothing():
    swapped = sp.csc_matrix([[0.0, 1.0], [1.0, 0.0]])
    factors = RealFactors(swapped, 0.0)
    assert factors.negative is None
    assert factors.error() == np.inf
    np.testing.assert_allclose(factors.solve(np.array([2.0, 3.0])), [3.0, 2.0])
    with pytest.raises(ZeroDivisionError, match="singular"):
        RealFactors(sp.csc_matrix(np.ones((2, 2))), 0.0)


def networks():
    """Random networks of all kinds, some unstable or floating, and crystals of equal modes."""
    for seed in range(16):
        rng, axes = np.random.default_rng([7, seed]), 2 + seed % 2
        network = makers.random_geometric(
            int(rng.integers(60, 160)), axes, 6.0, seed=seed, periodic=seed % 3 == 0,
            displacement=("scalar", "vector", "rotations")[seed // 2 % 3],
            masses=10 ** rng.uniform(-3, 3) if seed % 5 else 1.0,
        )  # fmt: skip
        if seed % 4 == 1:
            signs = rng.choice([-1, 1, 1, 1], len(network.bond))
            network = dataclasses.replace(network, stiffness=signs * network.stiffness)
        yield network
    yield makers.crystal("square", (9, 9))
    yield makers.crystal("fcc", (3, 3, 3), periodic=True, displacement="vector")


def frequencies(network):
    """All of them, by dense algebra, ascending, unstable ones negative; and |K|."""
    values = np.linalg.eigvalsh(network.restoring_forces(np.eye(network.size)))
    return np.sign(values) * np.sqrt(np.abs(values) / network.mass), np.abs(values).max()


@pytest.fixture(params=["superlu", "petsc"])
def factors(request, monkeypatch):
    """Search by both kinds of factors, whatever would be faster."""
    costly = request.param == "superlu"
    chosen = Elimination(True, "natural", not costly, True, costly, 1.0)
    monkeypatch.setattr(Network, "elimination", property(lambda network: chosen))


def test_what_is_proven_is_right(factors):
    """No mode of an interval is missing, and none outside is nearer than those wanted."""
    proven = tried = 0
    for network in networks():
        omegas, norm = frequencies(network)
        with Operators(network, MPI.COMM_SELF) as operators, ModeSolver(operators) as solver:
            for part in (0.0, 0.1, 0.35, 0.8, 1.1):
                for count in (1, 6):
                    omega, tried = part * omegas[-1], tried + 1
                    found = slices.proven(solver, omega, count)
                    if found is None:
                        continue
                    low, high, search = found
                    values = network.mass * omegas * np.abs(omegas)
                    inside = (values > low.shift) & (values < high.shift)
                    size = high.below - low.below
                    modes = solver.solve(low.shift, high.shift, size, search)
                    assert size == np.count_nonzero(inside) == len(modes[0])
                    np.testing.assert_allclose(modes[0], values[inside], rtol=0, atol=2e-13 * norm)
                    assert modes[2].max() < 1e-12
                    apart = np.abs(omegas - omega)
                    assert np.sort(apart[inside])[count - 1] <= np.sort(apart)[count - 1] + 1e-9
                    proven += 1
    assert proven > 0.7 * tried


def test_a_missing_mode_is_noticed(factors, monkeypatch):
    """The counts say more than a search has found; other searches find it after all."""
    network = makers.random_geometric(150, 3, 8.0, displacement="vector", seed=3)
    omegas, _ = frequencies(network)
    target, near, dropped = 0.3 * omegas[-1], ModeSolver.near, []

    def spoilt(self, search):
        modes = near(self, search)
        there = np.argsort(np.abs(modes.values - search.value)) != 3
        dropped.append(search)
        return normal.Modes(*(part[there] for part in modes))

    monkeypatch.setattr(ModeSolver, "near", spoilt)
    with Operators(network, MPI.COMM_SELF) as operators, ModeSolver(operators) as solver:
        assert slices.proven(solver, target, 9) is None
    modes = find_modes(network, targets=[target], count=9, method="eps")
    assert dropped
    assert modes.count_certified
    closest = np.sort(omegas[np.argsort(np.abs(omegas - target))[:9]])
    np.testing.assert_allclose(modes.omega, closest, rtol=1e-9)


def test_modes_depend_on_no_rank(factors, world):
    """Targets apart, overlapping ones, the same one twice."""
    network = makers.random_geometric(150, 2, 5.0, displacement="vector", seed=5)
    top = frequencies(network)[0][-1]
    targets = [0.1 * top, 0.5 * top, 0.52 * top, 0.5 * top, 0.9 * top]
    with Crew(world, 1) as crew:
        shared = find_modes(network, crew, targets=targets, count=5, shapes=True, method="eps")
    shared = world.bcast(shared)
    alone = find_modes(network, targets=targets, count=5, shapes=True, method="eps")
    assert shared.count_certified
    for name in ("omega", "residual", "vector"):
        np.testing.assert_array_equal(getattr(shared, name), getattr(alone, name))


def test_options_of_an_eps_have_their_meaning(solver_options, monkeypatch):
    """Whoever sets one gets counts first, and searches as the options say."""
    network, near, searched = makers.random_geometric(100, 2, 5.0, seed=5), ModeSolver.near, []
    monkeypatch.setattr(ModeSolver, "near", lambda *given: searched.append(1) or near(*given))
    which = {"targets": [0.37 * network.omega_mx], "count": 4, "method": "eps"}
    first = find_modes(network, **which)
    assert searched
    searched.clear()
    solver_options("-normal_eps_tol 1e-12")
    np.testing.assert_allclose(find_modes(network, **which).omega, first.omega, rtol=1e-10)
    assert not searched


def test_stiffness_is_stored_symmetric():
    """The proofs are of a symmetric matrix."""
    for network in networks():
        with Operators(network, MPI.COMM_SELF) as operators:
            K = real_matrix(operators.K)
            assert (K != K.T).nnz == 0
