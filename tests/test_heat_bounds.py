"""Warm balls and cut bonds of which little is known: bounds that hold, and what is marked."""

import numpy as np
import pytest
from mpmath import mp
from samples import option_values, random_lattice
from sensitivity_samples import STALE, Exact, heated, missed

from pgran.driven import steady
from pgran.driven import sweep as sweeping
from pgran.driven.linear import ReusePolicy
from pgran.driven.steady import SteadySolver
from pgran.errors import InputError
from pgran.experiments.sensitivity.finite import changed_amplitudes
from pgran.medium.lattice import Lattice
from pgran.medium.network import Network
from pgran.run.petsc import holding


@pytest.mark.parametrize("solver", [STALE, ""])
def test_inexact_factors(monkeypatch, solver_options, solver):
    """A factorization of another frequency would leave warm balls unknown: none is used."""
    solver_options(solver)
    monkeypatch.setattr(sweeping, "ranges", lambda count: [range(count)])
    lattice, omegas = random_lattice((4, 3), 3), np.linspace(0.4, 0.41, 6)
    found = heated(lattice, omegas, [[1, 1]], factor=2)
    with mp.workdps(40):
        exact = Exact(lattice)
        for n in (0, 5):
            right = np.array([exact.warmed(1j * omegas[n], [4], b, factor=2) for b in found.ball]).T
            assert not missed(found.warmed[n], right, found.warmed_bound[n])[0].any()
    assert np.all(found.warmed_bound <= 1e-8 * np.abs(found.warmed))


def test_bounds_know_what_a_factorization_of_another_frequency_is_worth(monkeypatch):
    """Were one used, they would hold all the same."""
    restart = SteadySolver.restart

    def once(self):
        if not hasattr(self, "_earlier"):
            restart(self)

    monkeypatch.setattr(SteadySolver, "restart", once)
    monkeypatch.setattr(steady, "ReusePolicy", lambda _: ReusePolicy(50))
    monkeypatch.setattr(sweeping, "ranges", lambda count: [range(count)])
    lattice, omegas = random_lattice((4, 3), 3, 0.05), np.linspace(0.4, 0.404, 3)
    with holding(option_values(STALE)):
        found = heated(lattice, omegas, [[1, 1]], factor=1.2)
    assert found.factorizations == 1
    with mp.workdps(40):
        exact = Exact(lattice)
        for n, omega in enumerate(omegas):
            right = [exact.warmed(1j * omega, [4], ball, factor=1.2) for ball in found.ball]
            assert not missed(found.warmed[n], np.array(right).T, found.warmed_bound[n])[0].any()
    parts = found.warmed_bound / np.abs(found.warmed)
    assert 100 * parts[0].max() < parts[2].min() < 1


@pytest.mark.parametrize("wrong", [(1e-4, 0, 0), (0, 1e-4, 0), (0, 0, 1e-4), (1e-4, 1e-4, 1e-4)])
def test_bounds_of_finite_changes_hold(wrong):
    """Where stretches by the amplitudes, by the adjoint, or flexibilities are off, at random."""
    rng, (count, r) = np.random.default_rng(2), (200, 4)

    def draw(*shape):
        return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)

    def off(values, size, axes):
        noise = draw(*values.shape)
        return values + size * noise / np.linalg.norm(noise, axis=axes, keepdims=True)

    G, t, y, A = draw(count, r, r), draw(count, r), draw(1, count, r), draw(1)
    delta = draw(count, r) * rng.choice([0, 0.1, 1, 10], (count, r))
    P = np.eye(r) + G * delta[:, None, :]
    right = A - np.einsum("dnr,nr->dn", y * delta, np.linalg.solve(P, t[..., None])[..., 0])
    known = np.tile(np.array(wrong)[:, None], count)
    stretched = off(t, wrong[0], 1), known[0], off(y, wrong[1], 2), known[1:2]
    flexibility = off(G, wrong[2], (1, 2)), known[2]
    after, bound = changed_amplitudes((A, np.zeros(1)), stretched, flexibility, delta)
    error = np.abs(after - right)
    assert np.all(error <= bound)
    assert np.mean(np.isfinite(bound)) > 0.9
    changed = np.any(delta, axis=1)
    assert np.median(bound[:, changed] / error[:, changed]) < 100


def test_what_fails_is_marked(solver_options):
    """Resonance of the whole, of what is left after a cut, and a solver that does not converge."""
    one = Lattice((np.ones(2),), 2.0, 0.0)
    found = heated(one, [0.5, 1.0], [0], factor=2, cut=True)
    assert found.converged_reason[0] > 0 >= found.converged_reason[1]
    assert np.all(np.isnan(found.warmed[1]) & np.isinf(found.warmed_bound[1]))
    assert np.isnan(found.heard[1, 0])
    assert found.heard[0, 0] >= 0
    light = Lattice((np.ones(2),), 1.0, 0.0)  # S = 2 - 1, and 1 - 1 with a bond cut
    found = heated(light, [1.0], [0], factor=0.5, cut=True)
    assert found.converged_reason[0] > 0
    assert np.all(np.isinf(found.cut_bound))
    assert np.all(np.isinf(found.warmed_bound))
    assert not np.any(found.heard)
    solver_options("-steady_pc_type ilu")
    with pytest.raises(InputError, match="needs a factorization"):
        heated(random_lattice((6, 5), 1), [0.3], [[1, 2]], factor=2)


@pytest.mark.parametrize("damping", [0.0, 0.1])
def test_a_ball_without_its_only_contact_rests(damping):
    network = Network([[0, 1], [1, 2], [2, 3]], [1.0, 2, 3], [2, 0, 0, 0], 1.0, damping)
    found = heated(network, [0.3, 0.7], [1, 3], cut=True)
    cut, bound = found.cut[:, 1, 2], found.cut_bound[:, 1, 2]
    assert np.all(np.isinf(bound) | (np.abs(cut) <= bound))
    assert np.all(found.cut_bound[:, 0] < 1e-6)
