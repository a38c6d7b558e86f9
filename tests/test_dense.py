"""Whole spectra by LAPACK: proven radii against many digits, planted faults prove nothing."""

import logging

import mpmath
import numpy as np
import pytest
import scipy.linalg
from mpi4py import MPI
from network_samples import random_network, unstable_network
from samples import random_lattice, uniform_lattice
from scipy.sparse import csr_matrix

import pgran
from pgran.experiments.modes import dense, scene
from pgran.experiments.modes.dense import whole_spectrum
from pgran.experiments.modes.scene import certificate
from pgran.medium.crystals import random_geometric
from pgran.run import machine
from pgran.run.crew import Crew


def exact_eigenvalues(K, digits=60):
    """All eigenvalues of a matrix as it is stored, ascending."""
    with mpmath.workdps(digits):
        return sorted(mpmath.eigsy(mpmath.matrix(K.toarray().tolist()), eigvals_only=True))


def stored(matrix):
    return csr_matrix(0.5 * (matrix + matrix.T))


def random_matrices(count):
    """Degenerate, zero and unstable modes, contrasts of 1e12, masses over 16 decades."""
    rng = np.random.default_rng(27)
    for number in range(count):
        n = rng.integers(2, 12)
        constants = 10 ** rng.uniform(-12 * (number % 2), 0, 2 * n)
        constants *= rng.choice([1, 0, -1], 2 * n, p=[0.8, 0.1, 0.1])
        B = rng.choice([-1.0, 0.0, 1.0], (2 * n, n)) * 10 ** rng.uniform(
            -8 * (number % 3 == 0), 0, n
        )
        yield stored(B.T @ np.diag(constants) @ B)
    yield stored(np.eye(7))
    yield stored(np.zeros((5, 5)))
    yield stored(np.kron(np.eye(3), [[2.0, -1.0], [-1.0, 2.0]]))


def test_each_eigenvalue_lies_within_the_radius():
    for K in random_matrices(60):
        (values, _, _, radius), exact = whole_spectrum(K), exact_eigenvalues(K)
        errors = [abs(mpmath.mpf(w) - x) for w, x in zip(values, exact, strict=True)]
        assert max(errors) <= radius
        assert radius <= 1e-11 * max(abs(K).sum(axis=1).max(), 1e-300)


def exact_omega(medium):
    """sqrt(lambda / m) with the sign of lambda, of K = B^T diag(k) B, to 60 digits."""
    with mpmath.workdps(60):
        B = mpmath.matrix(medium.springs.B.toarray().tolist())
        K = B.T * mpmath.diag(medium.constants.tolist()) * B
        values = sorted(mpmath.eigsy(K, eigvals_only=True))
        return [mpmath.sign(x) * mpmath.sqrt(abs(x) / mpmath.mpf(medium.mass)) for x in values]


MEDIA = {
    "lattice": lambda: random_lattice((6, 5), 3, mass=1.7),
    "degenerate": lambda: uniform_lattice((3, 3, 2)),
    "islands": lambda: random_lattice((5, 4), 2, law="bimodal"),
    "wide": lambda: random_lattice((13,), 5, law="wide"),
    **{f"network {seed}": lambda seed=seed: random_network(seed).network for seed in range(2, 6)},
    **{f"unstable {seed}": lambda seed=seed: unstable_network(seed).network for seed in range(3)},
}


@pytest.mark.parametrize("name", MEDIA)
def test_each_omega_lies_within_its_bound(name):
    """Those of zero and unstable modes, too; the bounds are close."""
    medium = MEDIA[name]()
    with Crew(MPI.COMM_SELF, 1) as crew:
        modes = pgran.find_modes(medium, crew, method="dense", shapes=True)
    exact = exact_omega(medium)
    assert modes.count_certified
    for omega, bound, true in zip(modes.omega, modes.omega_bound, exact, strict=True):
        assert abs(mpmath.mpf(omega) - true) <= bound
    top = float(max(map(abs, exact)))
    loose = np.abs(modes.omega) > 1e-3 * top
    assert np.all(modes.omega_bound[loose] * np.abs(modes.omega[loose]) <= 1e-11 * top**2)
    vectors = modes.vector.reshape(medium.size, -1)
    assert np.abs(vectors @ vectors.T - np.eye(medium.size)).max() <= 1e-12


def test_projections_and_ensembles_by_whole_spectra(world):
    lattice = random_lattice((7, 6), 1)
    whole, sliced = (pgran.project(lattice, [0.3, 0.8], method=m) for m in ("dense", "eps"))
    np.testing.assert_allclose(whole.coefficient, sliced.coefficient, rtol=1e-8, atol=1e-11)
    assert np.all(whole.mode_omega_bound < 1e-11)
    assert sliced.mode_omega_bound is None
    assert "proven by their residuals" in certificate(whole)
    assert "certified by their count" in certificate(sliced)
    choices = {"lattice": {"shape": (6, 5)}, "keep": "curves"}
    found = [pgran.ensemble("modes", 4, method=m, **choices) for m in ("dense", "eps")]
    np.testing.assert_allclose(*(each.mode_omega for each in found), rtol=1e-11)
    assert np.all(found[0].good)


def auto(medium, **which):
    """What `auto` chooses for some modes of a medium."""
    return scene.route("auto", medium, scene.Wanted(**which), damped=False)


def test_what_auto_takes(solver_options):
    """On lattices and with keys of an EPS always slices; on networks what is cheaper."""
    small, wide = (random_geometric(balls, 2) for balls in (200, 4000))
    filled = random_geometric(700, 3, displacement="vector")
    assert auto(random_lattice((6, 5))) == "eps"
    assert auto(small) == "dense"
    assert "graph" not in vars(small)  # whole spectra are cheaper however little factors fill
    assert auto(filled) == "dense"
    assert auto(small, targets=[0.3], count=50) == "dense"
    assert auto(small, interval=(0.1, 2.0)) == "dense"
    assert auto(wide) == "eps"
    assert auto(filled, targets=[0.3], count=20) == "eps"
    assert auto(filled, interval=(0.3, 0.31)) == "eps"
    solver_options("-normal_eps_tol 1e-10")
    assert auto(small) == "eps"
    assert scene.route("dense", small, scene.Wanted(), damped=False) == "dense"


def test_whole_spectra_fit_into_memory(monkeypatch):
    network = random_geometric(100, 2)
    monkeypatch.setattr(dense, "total_memory", lambda: dense.memory(network.size))
    assert auto(network) == "eps"
    monkeypatch.setattr(machine, "total_memory", lambda: dense.memory(network.size))
    with pytest.raises(pgran.InputError, match="-modes_method: too much"):
        pgran.find_modes(network, method="dense")
    monkeypatch.setattr(dense, "LARGEST", 50)
    assert auto(network) == "eps"
    with pytest.raises(pgran.InputError, match=r"up to 50 unknowns.*-modes_method eps"):
        pgran.find_modes(network, method="dense")


def test_keys_of_an_eps_go_unused_beside_dense(caplog, world):
    with caplog.at_level(logging.WARNING, "pgran"):
        pgran.find_modes(random_lattice((4, 3)), method="dense", solver={"normal_eps_tol": 1e-9})
    assert world.bcast("-normal_eps_tol was not used" in caplog.text)


@pytest.mark.parametrize("error", [np.linalg.LinAlgError("no convergence"), MemoryError()])
def test_what_lapack_meets_is_raised_on_all_ranks(error, monkeypatch, world):
    def fails(*arguments, **choices):
        raise error

    monkeypatch.setattr(scipy.linalg, "eigh", fails)
    with pytest.raises(pgran.PgranError, match=r"LAPACK computes no spectrum.*-modes_method eps"):
        pgran.find_modes(random_lattice((5, 4)), method="dense")


@pytest.mark.parametrize("fault", ["missing", "turned", "misplaced", "not finite"])
def test_wrong_spectra_are_not_certified(fault, monkeypatch, world):
    """Nothing is proven, or the bound grows beyond what is wrong."""
    eigh = scipy.linalg.eigh

    def spoilt(*arguments, **choices):
        values, vectors = eigh(*arguments, **choices)
        if fault == "missing":  # another one stands in its place
            values[3], vectors[:, 3] = values[4], vectors[:, 4]
        elif fault == "turned":
            vectors[:, 3] = np.cos(0.02) * vectors[:, 3] + np.sin(0.02) * vectors[:, 7]
        elif fault == "misplaced":
            values[3] += 1e-8
        else:
            vectors[2, 3] = np.nan
        return values, vectors

    monkeypatch.setattr(scipy.linalg, "eigh", spoilt)
    modes = pgran.find_modes(random_lattice((5, 4)), method="dense")
    assert not modes.count_certified
    assert modes.failures > 0
    assert "NOT CERTIFIED" in certificate(modes)
    assert np.all(modes.omega_bound > 1e-10)
    assert np.isinf(modes.omega_bound).all() == (fault != "misplaced")
