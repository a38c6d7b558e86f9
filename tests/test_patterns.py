"""What patterns of balls pass on to one another, against dense inverses and many digits."""

import logging

import numpy as np
import pytest
from network_samples import NetworkReference, random_network
from petsc4py import PETSc
from samples import SOLVERS, random_lattice, reference_of

from pgran.driven.operators import Operators
from pgran.driven.patterns import PatternSolver


def inverse(lattice, omega):
    """S^-1 in double precision."""
    return np.linalg.inv(reference_of(lattice).system(omega)[0].astype(complex))


@pytest.mark.parametrize(("omega", "damping"), [(0.4, 0.003), (0.4, 0.0), (3.0, 0.01)])
def test_patterns_of_a_lattice(comm, omega, damping):
    """On any number of ranks; more columns than a block has; far balls are known relatively."""
    lattice, rng = random_lattice((8, 5), 3, damping), np.random.default_rng(4)
    balls, waves = np.eye(40), rng.standard_normal((3, 40))
    with Operators(lattice, comm) as operators, PatternSolver(operators) as solver:
        assert solver.solve(1j * omega)
        G, bound = solver.products(np.concatenate([waves, balls[:7]]), balls)
        assert solver.backward_error < 1e-15
        own, own_bound = solver.diagonal(np.concatenate([balls, waves]))
    exact = inverse(lattice, omega)
    assert np.allclose(G, np.concatenate([waves @ exact, exact[:7]]), rtol=1e-11, atol=0)
    assert np.allclose(own[:40], np.diag(exact), rtol=1e-11, atol=0)
    assert np.allclose(own[40:], np.diag(waves @ exact @ waves.T), rtol=1e-11, atol=0)
    known = damping > 0 or comm.size == 1  # eigenvalues are counted by one rank alone
    assert np.isfinite([*bound.ravel(), *own_bound]).all() == known
    assert not known or (bound <= 1e-7 * np.abs(G)).all()
    assert not known or (own_bound <= 1e-9 * np.abs(own)).all()


@pytest.mark.parametrize("solver", ["ilu", "preonly, ilu", "gmres, jacobi", "mumps"])
def test_any_solver(comm, solver, solver_options):
    """Column by column without a factorization; what a poor one leaves is refined, or bounded."""
    if comm.size > 1 and "ilu" in solver:
        pytest.skip("PETSc has no such preconditioner of matrices that ranks share")
    solver_options(SOLVERS[solver])
    lattice, balls = random_lattice((4, 5), 3, 0.05), np.eye(20)
    with Operators(lattice, comm) as operators, PatternSolver(operators) as opened:
        assert opened.solve(0.9j)
        G, bound = opened.products(balls, balls[4:9])
    error = np.abs(G - inverse(lattice, 0.9)[:, 4:9])
    assert (error <= bound + 1e-14).all()
    assert solver == "preonly, ilu" or (bound < 1e-9).all()


def test_a_failure_inside_petsc_is_marked(alone, monkeypatch, caplog):
    """Nothing is known of its frequency; it is said why, and the next one is solved."""
    lattice, balls = random_lattice((4, 5), 3), np.eye(20)

    def fail(*_):
        raise PETSc.Error(77)

    with Operators(lattice, alone) as operators, PatternSolver(operators) as solver:
        assert solver.solve(0.5j)
        with monkeypatch.context() as patched, caplog.at_level(logging.WARNING, "pgran"):
            patched.setattr(PatternSolver, "invert", fail)
            values, bounds = solver.diagonal(balls)
        assert "omega = 0.5 is marked" in caplog.text
        assert np.isnan(values).all()
        assert np.isinf(bounds).all()
        assert np.isnan(solver.products(balls, balls[:2])[0]).all()
        assert solver.solve(0.6j)
        assert np.allclose(solver.diagonal(balls)[0], np.diag(inverse(lattice, 0.6)), rtol=1e-11)


def test_balls_that_float_have_no_bound(comm):
    """Values are right, residuals say so."""
    network = random_network(3).network  # of a seed with damping
    network = network.__class__(network.bond, network.stiffness, 0 * network.held, damping=0.1)
    with Operators(network, comm) as operators, PatternSolver(operators) as solver:
        assert solver.solve(0.7j)
        G, bound = solver.products(np.eye(network.size), np.eye(network.size))
        assert solver.backward_error < 1e-14
    exact = np.linalg.inv(NetworkReference(network).system(0.7j).astype(complex))
    assert np.allclose(G, exact, rtol=1e-9)
    assert np.isinf(bound).all()
