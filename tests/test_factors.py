"""Factors that are used again."""

from pathlib import Path

import numpy as np
from scipy.sparse import identity

from pgran.balance import equilibrium
from pgran.balance.equilibrium import Factors, factored
from pgran.balance.motion import Motion
from pgran.balance.networks import balls_of, grown
from pgran.medium.network_file import read_network

SPHERES = Path(__file__).parents[1] / "options" / "packings" / "spheres.h5"


def test_factors_are_reused(monkeypatch):
    """They solve with matrices near their own, and give up where those are far or indefinite."""
    monkeypatch.setattr(equilibrium, "FEWEST", 1)
    spheres = read_network(SPHERES)
    balls, contacts = balls_of(spheres)
    start = Motion(balls, contacts)
    K, _, _ = start.matrix(start.state(np.zeros_like(balls.position), 0.0))
    right, kept = np.sin(np.arange(K.shape[0])), Factors()
    assert kept.solve(K, right) is None
    kept.keep(factored(K))
    kept.solves = 20
    near = K.copy()
    near[5, 5] *= 1.5
    near[70, 70] *= 0.97
    x = kept.solve(near, right)
    assert np.abs(near @ x - right).max() < 1e-4
    for far in (K @ K, K - K.diagonal().max() * identity(K.shape[0])):
        kept.keep(factored(K))
        assert kept.solve(far, right) is None
        assert kept.factors is None
    larger = spheres.radius.copy()
    larger[spheres.free[7]] += 0.1 * spheres.overlap.mean()
    few = grown(balls, contacts, larger)
    monkeypatch.setattr(equilibrium, "FEWEST", np.inf)
    each = grown(balls, contacts, larger)
    assert few.factorizations < each.factorizations
    assert np.abs(few.balls.position - each.balls.position).max() < 1e-12
