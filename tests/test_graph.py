"""The graph of a network: order of elimination, what that costs, and what is certain by it."""

import dataclasses
import functools
import pickle

import numpy as np
import pytest
import scipy.sparse as sp
from mpi4py import MPI
from samples import steady
from scipy.sparse.linalg import splu

from pgran import Network, find_modes
from pgran.driven import counting
from pgran.driven.counting import ModeCounter, smallest_damping
from pgran.driven.linear import factor_package
from pgran.driven.operators import Operators
from pgran.medium import crystals as makers
from pgran.medium import graph as graphs
from pgran.medium.springs import SYMMETRIC
from pgran.run.petsc import PETSc


def samples():
    """Networks of all kinds: crystals, random ones, masses over six decades, double contacts."""
    for name, shape in (("square", (8, 7)), ("honeycomb", (5, 5)), ("fcc", (3, 3, 4))):
        for displacement in ("scalar", "vector"):
            yield makers.crystal(name, shape, displacement=displacement)
    for seed in range(6):
        rng, axes = np.random.default_rng(seed), 2 + seed % 2
        kind = ("scalar", "vector")[seed // 2 % 2]
        masses = 10 ** rng.uniform(-3, 3, 60) if seed < 4 else 1.0
        network = makers.random_geometric(60, axes, 6.0, displacement=kind, masses=masses)
        yield network
        again = rng.integers(0, len(network.bond), (2, 30))
        parts = {
            name: np.concatenate([getattr(network, name), *getattr(network, name)[again]])
            for name in ("bond", "stiffness", "normal", "distance")
            if getattr(network, name) is not None
        }
        yield dataclasses.replace(network, **parts)


def floating():
    """Networks of which something floats."""
    for name in ("square", "fcc"):
        yield makers.crystal(name, (4, 4, 4)[: 2 + (name == "fcc")], periodic=True)
    yield Network([[0, 1]], [1.0], [0, 2, 0])  # a ball without a contact
    yield Network([[0, 1], [1, 2], [3, 4], [4, 5], [6, 7]], np.ones(5), [0, 0, 2] + 5 * [0])
    for seed in range(8):  # so many contacts that rounding leaves an eigenvalue above zero
        masses = 10 ** np.random.default_rng(seed).uniform(-3, 3, 4)
        yield Network([[0, 1]] * 10**4 + [[2, 3]], np.ones(10**4 + 1), [0, 0, 0, 2], masses)


def damping_matrix(network):
    """C / beta by the springs, dense."""
    springs, stretch = network.springs, network.springs.B.toarray()
    return stretch.T @ (springs.damped[:, None] * stretch)


def eigenvalues(network):
    """Those of K, dense."""
    return np.linalg.eigvalsh(network.restoring_forces(np.eye(network.size)))


def fill(matrix, order):
    """The sum of squared column counts of the Cholesky factor of a pattern, numbered anew."""
    there, total = matrix[np.ix_(order, order)] != 0, 0
    for column in range(len(there)):
        below = column + 1 + np.flatnonzero(there[column + 1 :, column])
        there[np.ix_(below, below)] = True
        total += (1 + len(below)) ** 2
    return total


@functools.cache
def costly():
    """Networks whose factors fill, of one kind each."""
    periodic = makers.crystal("fcc", (3, 3, 3), periodic=True)  # of equal eigenvalues
    random = makers.random_geometric(200, 3, 9.0, displacement="vector", periodic=True, seed=1)
    rng = np.random.default_rng(1)
    signs = rng.choice([-1, 1, 1, 1, 1], len(random.bond)) * rng.uniform(0.5, 1, len(random.bond))
    unstable = dataclasses.replace(random, stiffness=signs)
    heavy = dataclasses.replace(random, masses=10 ** rng.uniform(-3, 3, len(random.held)))
    return {"fcc": periodic, "random": random, "unstable": unstable, "masses": heavy}


def test_no_eigenvalue_is_below_the_smallest():
    """A proven bound, and a close one."""
    for network in samples():
        exact = np.linalg.eigvalsh(network.graph.laplacian.toarray())
        rounding = 1e-14 * exact[-1]
        assert 0.85 * exact[0] - rounding <= network.graph.smallest <= exact[0] + rounding
        assert network.graph.smallest > 0
    for network in floating():
        assert network.graph.smallest == 0 == smallest_damping(network)


def test_normals_may_miss_their_length():
    """They are accepted if that is 1 but for a millionth, so C may be below the Laplacian."""
    for length in (1 - 9e-7, 1 + 9e-7):
        network = Network([[0, 1]], [1.0], [0, 2], displacement="vector", normal=[[length, 0.0]])
        assert 0.99 < smallest_damping(network) <= np.linalg.eigvalsh(damping_matrix(network))[0]


def test_isotropic_damping_is_the_laplacian():
    """For each component alike; with rotations, or along normals, it is not."""
    for network in samples():
        expected = np.kron(network.graph.laplacian.toarray(), np.eye(network.components))
        assert network.isotropic
        assert np.allclose(
            damping_matrix(network), expected, rtol=1e-13, atol=1e-13 * expected.max()
        )
    rolling = makers.crystal("square", (5, 5), displacement="rotations")
    for network in (rolling, makers.crystal("square", (5, 5), damped="normal")):
        assert not network.isotropic
        expected = np.kron(network.graph.laplacian.toarray(), np.eye(network.components))
        assert not np.allclose(damping_matrix(network), expected)
        if network.damped == "normal":
            least = np.linalg.eigvalsh(damping_matrix(network))[0]
            assert smallest_damping(network) <= max(least, 0.0)


def not_isotropic():
    """Networks whose C is no Laplacian and has no zero eigenvalue: normal parts, rotations."""
    for name, shape in (("triangular", (7, 5)), ("fcc", (4, 4, 3))):
        for kind in ({"damped": "normal"}, {"displacement": "rotations"}):
            count = len(makers.crystal(name, shape).held)
            masses = 10 ** np.random.default_rng(2).uniform(-2, 2, count)
            yield makers.crystal(name, shape, **kind)
            yield makers.crystal(name, shape, masses=masses, **kind)


def test_damping_that_is_no_laplacian():
    """A proven bound from the factors of C less a shift, half of the eigenvalue or closer."""
    for network in not_isotropic():
        exact = np.linalg.eigvalsh(damping_matrix(network))
        assert exact[0] > 1e-10 * exact[-1]
        assert 0.45 * exact[0] <= smallest_damping(network) <= exact[0] * (1 + 1e-10)


@pytest.mark.parametrize("quotient", [0.7, 1.0, 1.2, 30.0])
def test_an_estimate_that_is_far_off_proves_nothing_wrong(quotient, monkeypatch):
    """However soon inverse iteration stops."""
    network = makers.crystal("triangular", (7, 5), damped="normal")
    exact = np.linalg.eigvalsh(damping_matrix(network))[0]
    monkeypatch.setattr(counting, "_estimate", lambda C, factors: quotient * exact)
    assert 0.1 * exact < smallest_damping(network) <= exact * (1 + 1e-10)


def test_order_of_elimination():
    """Its work is that of the symbolic elimination, and less than as balls are numbered."""
    for network in [*samples(), *floating()]:
        graph, laplacian = network.graph, network.graph.laplacian.toarray()
        assert sorted(graph.order) == list(range(len(network.free)))
        in_order = fill(laplacian, graph.order)
        assert graph.work == in_order * network.components**3
        if len(network.free) > 20:
            assert in_order < fill(laplacian, np.arange(len(laplacian)))


def test_a_network_can_be_copied_after_use():
    network = makers.crystal("square", (4, 4))
    assert network.graph.work == pickle.loads(pickle.dumps(network)).graph.work


@pytest.mark.parametrize("name", costly())
@pytest.mark.parametrize("options", ["", "-normal_count_pc_type cholesky"])
def test_counts_are_right_or_none(name, options, solver_options):
    """By SuperLU where factors fill, by PETSc if options choose it."""
    solver_options(options)
    network, sure = costly()[name], 0
    values, rng = eigenvalues(network), np.random.default_rng(2)
    with (
        Operators(network, MPI.COMM_SELF) as operators,
        ModeCounter(operators.K, network) as counter,
    ):
        assert counter.costly
        assert (counter._factor == counter._by_petsc) == bool(options)
        pivots = operators.K.getDiagonal().getArray().real[:3]  # the first of them is zero there
        near = [0.0, 1e-15, -1e-13, 1e-11, -1e-9, 1e-6]
        beside = [x + part * counter.norm for x in rng.choice(values, 3) for part in near]
        for shift in [*rng.uniform(values[0], values[-1], 10), *pivots, 0.0, *beside]:
            for clearance in (1e-12 * counter.norm, 1e-9 * counter.norm):
                count, edge = counter.below(shift, clearance), clearance + 1e-14 * counter.norm
                low, high = (np.count_nonzero(values < shift + side * edge) for side in (-1, 1))
                assert count is None or low <= count <= high
                sure += count is not None
    assert sure >= 21


@pytest.mark.parametrize("name", costly())
def test_modes_where_factors_fill(name):
    """Those nearest to targets are certified, equal ones and unstable ones included."""
    network = costly()[name]
    assert factor_package(network, 1) == "mumps"
    values = eigenvalues(network)
    omega = np.sign(values) * np.sqrt(np.abs(values) / network.mass)
    targets = [0.0, *np.quantile(np.abs(omega), [0.1, 0.9]), 2 * omega[-1]]
    modes = find_modes(network, targets=targets, count=9, method="eps")
    assert modes.count_certified
    found = np.sign(modes.omega) * modes.omega**2 * network.mass
    assert np.abs(found[:, None] - values).min(axis=1).max() < 1e-12 * values[-1]
    for target in targets:
        apart, expected = (np.sort(np.abs(x - target))[:9] for x in (modes.omega, omega))
        assert np.allclose(apart, expected, rtol=0, atol=1e-6 * omega[-1])


@pytest.mark.parametrize("decades", [0, 6])
def test_factors_of_both_packages_agree(decades, solver_options):
    """Within what each proves of itself."""
    masses = 10 ** np.random.default_rng(1).uniform(-decades / 2, decades / 2, 400)
    network, states = makers.fcc((5, 5, 4), masses=masses, damping=0.1), {}
    assert factor_package(network, 1) == "mumps"
    for package in ("mumps", "petsc"):
        if package == "petsc":
            solver_options("-steady_pc_factor_mat_solver_type petsc")
        with steady(network, network.free[[0, -1]], tolerance=1e-6) as (_, solver):
            assert solver._krylov.pc.getFactorSolverType() == package
            states[package] = [solver.solve(s) for s in (0.05j, 0.4j, 0.3 + 1j, 3j)]
    for one, other in zip(*states.values(), strict=True):
        assert one.converged_reason > 0 < other.converged_reason
        apart = np.abs(one.displacement - other.displacement)
        assert np.all(apart <= one.error_bound + other.error_bound)
        assert np.all(apart <= 1e-6 * np.abs(one.displacement))


@pytest.mark.parametrize(
    ("work", "options", "expected"),
    [
        (np.inf, "", 2),
        (0, "", None),
        (np.inf, "-steady_mat_mumps_icntl_7 0", 0),
        (0, "-steady_mat_mumps_icntl_7 0", 0),
    ],
)
def test_the_order_that_mumps_takes(world, work, options, expected, monkeypatch, solver_options):
    """AMF where another one saves less than it costs, on any number of ranks; options win."""
    monkeypatch.setattr(graphs, "QUICK_WORK", work)
    solver_options(f"-steady_pc_factor_mat_solver_type mumps {options}")
    network = makers.fcc((4, 4, 4))
    with steady(network, network.free[:1], world) as (_, solver):
        assert solver.solve(0.3j).converged_reason > 0
        if expected is None:
            assert solver.factor.getMumpsIcntl(7) == 7  # MUMPS chooses
        else:
            assert solver.factor.getMumpsInfog(7) == expected
        solver.solve(0.4j)
        assert PETSc.Options("steady_").hasName("mat_mumps_icntl_7") == bool(options)


# The order of elimination


def patterns():
    """Sparse patterns with a diagonal: of one unknown, of parts apart, random and dense ones."""
    yield sp.identity(1, format="csr")
    yield sp.identity(7, format="csr")
    yield sp.csr_matrix(np.ones((9, 9)))
    for seed in range(24):
        rng = np.random.default_rng(seed)
        size = int(rng.integers(2, 300))
        i, j = rng.integers(0, size, (2, rng.integers(0, 4 * size)))
        half = sp.coo_matrix((np.ones(len(i)), (i, j)), (size, size)).tocsr()
        yield (half + half.T + sp.identity(size)).tocsr()


def superlu(pattern, order, method):
    """SuperLU's factors of a definite matrix of a pattern, numbered anew."""
    matrix = pattern[order][:, order].tocsc()
    matrix.data[:] = -1.0
    matrix.setdiag(1.0 + matrix.shape[0])
    matrix.sort_indices()
    return splu(matrix, method, **SYMMETRIC)


@pytest.mark.parametrize("has_amd", [True, False])
def test_postordered_and_as_sparse_as_minimum_degree(has_amd, monkeypatch):
    """Where PETSc knows the order and where it does not."""
    if not has_amd:
        monkeypatch.setattr(graphs, "MINIMUM_DEGREE", "none_such")
    filled, expected = 0, 0
    for pattern in patterns():
        order = graphs.elimination_order(pattern)
        numbers = np.arange(pattern.shape[0])
        assert sorted(order) == numbers.tolist()
        own = superlu(pattern, order, "NATURAL")
        np.testing.assert_array_equal(own.perm_c, numbers)
        filled += own.L.nnz
        expected += superlu(pattern, numbers, "MMD_AT_PLUS_A").L.nnz
    assert filled <= 1.1 * expected
