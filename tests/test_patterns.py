"""Solves for patterns of balls that fail, or have no bound; test_guarantees.py has random ones."""

import dataclasses
import logging

import numpy as np
from network_samples import NetworkReference, random_network
from petsc4py import PETSc
from samples import random_lattice, reference_of

from pgran.driven.operators import Operators
from pgran.driven.patterns import PatternSolver


def test_a_failure_inside_petsc_is_marked(alone, monkeypatch, caplog):
    """Nothing is known of its frequency; it is said why, and the next one is solved."""
    lattice, balls = random_lattice((20,), 3), np.eye(20)

    def fail(*_):
        raise PETSc.Error(77)

    with Operators(lattice, alone) as operators, PatternSolver(operators) as solver:
        assert solver.solve(2j)  # where far balls are compared, whose solver holds vectors, too
        assert np.isfinite(solver.products(balls[:1], balls[-1:])[1])
        assert solver.solve(0.5j)
        with monkeypatch.context() as patched, caplog.at_level(logging.WARNING, "pgran"):
            patched.setattr(PatternSolver, "invert", fail)
            values, bounds = solver.diagonal(balls)
        assert "omega = 0.5 is marked" in caplog.text
        assert np.isnan(values).all()
        assert np.isinf(bounds).all()
        assert np.isnan(solver.products(balls, balls[:2])[0]).all()
        assert solver.solve(0.6j)
        exact = np.linalg.inv(reference_of(lattice).system(0.6)[0].astype(complex))
        assert np.allclose(solver.diagonal(balls)[0], np.diag(exact), rtol=1e-11)


def test_balls_that_float_have_bounds_by_a_count(comm):
    """Where ranks share them none is known, however good the values."""
    network = random_network(3).network
    network = dataclasses.replace(network, held=0 * network.held, damping=0.1, damped="all")
    with Operators(network, comm) as operators, PatternSolver(operators) as solver:
        assert solver.solve(0.7j)
        G, bound = solver.products(np.eye(network.size), np.eye(network.size))
    reference = NetworkReference(network)
    exact = np.linalg.inv(reference.weighted(reference.system(0.7j)).astype(complex))
    assert np.allclose(G, exact, rtol=1e-9)
    assert np.isinf(bound).all() if comm.size > 1 else np.all(np.abs(G - exact) <= bound)
    assert comm.size > 1 or np.isfinite(bound).all()
