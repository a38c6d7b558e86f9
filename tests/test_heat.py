"""Warm balls and cut bonds: as if all were solved anew, bounds that hold, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from packing_samples import cells
from samples import option_values, random_lattice
from sensitivity_samples import (
    STALE,
    TOUCH,
    assert_exact,
    assert_same_on_ranks,
    heated,
    packing,
)

from pgran import InputError, Lattice, Network
from pgran.driven import drive, steady
from pgran.driven.linear import ReusePolicy
from pgran.driven.steady import SteadySolver
from pgran.experiments.sensitivity.finite import changed_amplitudes
from pgran.run.petsc import holding

NETWORK = packing("vector")
OMEGAS = np.array([0.15, 0.6, 1.0])
MEDIA = {
    "1d": (random_lattice((6,), 1, 0.02), [[2], [5]]),
    "2d": (random_lattice((4, 3), 2, 0.0), [[0, 1], [3, 2]]),
    "3d": (random_lattice((2, 2, 3), 3), [[0, 0, 0], [1, 1, 2]]),
    "scalar": (packing("scalar", unit=1e6), [1, 2]),
    "vector": (packing("vector", unit=1e-6), [3]),
    "rotations": (packing("rotations", 3, damping=0.0), [1, 2]),
}


@pytest.mark.parametrize("name", MEDIA)
@pytest.mark.parametrize(
    "by",
    [
        {"factor": 1.7, "cut": True}, {"overlap": 0.03, "hertz": 0.4},
        {"overlap": -1e-3, "hertz": 1e-3},
    ],
)  # fmt: skip
def test_changes_are_as_if_all_were_solved_anew(name, by):
    """Each ball warm, by Hertz's law or a factor, and each bond cut, its dashpot, too."""
    medium, sites = MEDIA[name]
    found = heated(medium, [0.6], sites, **by)
    assert np.all(found.converged_reason > 0)
    assert len(found.ball) == len(medium.ball_numbers)
    by = {name: value for name, value in by.items() if name != "cut"}
    for kind, errors in assert_exact(found, medium, sites, **by).items():
        assert np.mean(np.isfinite(getattr(found, f"{kind}_bound"))) > 0.5
        assert np.all(errors <= 1e-10 * np.abs(getattr(found, kind)).max())


def test_some_balls_are_those_of_all():
    for medium, sites in (MEDIA["2d"], MEDIA["rotations"]):
        every = heated(medium, OMEGAS, sites, factor=2)
        balls = every.ball[[2, 0, 2]]
        if isinstance(medium, Lattice):
            balls = np.stack(np.unravel_index(balls, medium.shape), axis=1)
        some = heated(medium, OMEGAS, sites, factor=2, balls=balls)
        assert some.ball.tolist() == every.ball[[0, 2]].tolist()
        np.testing.assert_allclose(some.warmed, every.warmed[..., [0, 2]], rtol=1e-13)
    drawn, fewer = (heated(medium, OMEGAS, sites, factor=2, samples=n) for n in (2, 1))
    assert set(fewer.ball) < set(drawn.ball) < set(every.ball)
    assert np.all(np.isin(drawn.warmed[0, 0].round(12), every.warmed[0, 0].round(12)))
    assert not np.any(heated(medium, OMEGAS, sites, factor=1).heard)
    change = np.abs(every.warmed / every.displacement[..., None] - 1)
    assert 0 < every.heard.mean() < 1
    assert np.array_equal(every.heard, np.mean(change >= 0.25, axis=-1))


@pytest.mark.parametrize("name", ["2d", "1d", "rotations"])
def test_any_number_of_ranks(world, name):
    """Without damping, ranks that share a lattice refuse."""
    medium, sites = MEDIA[name]
    names = "warmed", "cut", "displacement"
    assert_same_on_ranks(world, heated, medium, OMEGAS, sites, names, factor=1.3, cut=True)


def test_contacts_of_no_normal_stiffness_are_warmed():
    """Their tangential springs, by the factor."""
    stiffness = NETWORK.stiffness * (np.arange(len(TOUCH)) != 1)
    network = replace(NETWORK, stiffness=stiffness)
    assert_exact(heated(network, [0.6], [1], factor=3), network, [1], factor=3)


# Bounds


@pytest.mark.parametrize("solver", [STALE, ""])
def test_inexact_factors(monkeypatch, solver_options, solver):
    """A factorization of another frequency would leave warm balls unknown: none is used."""
    solver_options(solver)
    monkeypatch.setattr(drive, "ranges", lambda count: [range(count)])
    lattice, omegas = random_lattice((4, 3), 3), np.linspace(0.4, 0.41, 3)
    found = heated(lattice, omegas, [[1, 1]], factor=2)
    assert_exact(found, lattice, [[1, 1]], factor=2)
    assert np.all(found.warmed_bound <= 1e-8 * np.abs(found.warmed))


def test_bounds_know_what_a_factorization_of_another_frequency_is_worth(monkeypatch):
    """Were one used, they would hold all the same."""
    restart = SteadySolver.restart

    def once(self):
        if not hasattr(self, "_earlier"):
            restart(self)

    monkeypatch.setattr(SteadySolver, "restart", once)
    monkeypatch.setattr(steady, "ReusePolicy", lambda _: ReusePolicy(50))
    monkeypatch.setattr(drive, "ranges", lambda count: [range(count)])
    lattice, omegas = random_lattice((4, 3), 3, 0.05), np.linspace(0.4, 0.404, 3)
    with holding(option_values(STALE)):
        found = heated(lattice, omegas, [[1, 1]], factor=1.2)
    assert found.factorizations == 1
    assert_exact(found, lattice, [[1, 1]], factor=1.2)
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
        noise *= size / np.linalg.norm(noise, axis=axes, keepdims=True)
        return values + noise, np.full(np.delete(values.shape, axes), size)

    G, t, y, A = draw(count, r, r), draw(count, r), draw(1, count, r), draw(1)
    delta = draw(count, r) * rng.choice([0, 0.1, 1, 10], (count, r))
    P = np.eye(r) + G * delta[:, None, :]
    right = A - np.einsum("dnr,nr->dn", y * delta, np.linalg.solve(P, t[..., None])[..., 0])
    stretched = *off(t, wrong[0], (1,)), *off(y, wrong[1], (2,))
    flexibility = off(G, wrong[2], (1, 2))
    after, bound = changed_amplitudes((A, np.zeros(1)), stretched, flexibility, delta)
    error, changed = np.abs(after - right), np.any(delta, axis=1)
    assert np.all(error <= bound)
    assert np.mean(np.isfinite(bound)) > 0.9
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
    assert np.isinf([*found.cut_bound.flat, *found.warmed_bound.flat]).all()
    assert not np.any(found.heard)
    solver_options("-steady_pc_type ilu")
    with pytest.raises(InputError, match="needs a factorization"):
        heated(one, [0.3], [0], factor=2)


@pytest.mark.parametrize("damping", [0.0, 0.1])
def test_a_ball_without_its_only_contact_rests(damping):
    network = Network([[0, 1], [1, 2], [2, 3]], [1.0, 2, 3], [2, 0, 0, 0], 1.0, damping)
    found = heated(network, [0.3, 0.7], [1, 3], cut=True)
    cut, bound = found.cut[:, 1, 2], found.cut_bound[:, 1, 2]
    assert np.all(np.isinf(bound) | (np.abs(cut) <= bound))
    assert np.all(found.cut_bound[:, 0] < 1e-6)


# What is refused

LATTICE, CELL = MEDIA["2d"][0], cells(0.01)
BEADS, GROWS = packing("vector", radius=np.ones(5)), {"radius": 0.01, "relax": True}
NEGATIVE = NETWORK.stiffness * np.where(np.arange(len(TOUCH)) == 3, -0.01, 1)
REFUSED = [
    (LATTICE, {}, "give a factor or an overlap, or cut=True"),
    (LATTICE, {"factor": -1}, "-heat_factor -1"),
    (LATTICE, {"factor": 2, "overlap": 1}, "one of these ways"),
    (LATTICE, {"cut": True, "balls": [[0, 0]]}, "-heat_balls: say by how much"),
    (LATTICE, {"cut": True, "samples": 2}, "-heat_samples: say by how much"),
    (LATTICE, {"factor": 2, "samples": 13}, "-heat_samples 13: there are only 12 balls"),
    (LATTICE, {"factor": 2, "samples": 2, "balls": [[0, 0]]}, "or how many to draw"),
    (LATTICE, {"factor": 2, "balls": [[4, 0]]}, r"-heat_balls: ball \(4, 0\) is outside"),
    (LATTICE, {"factor": 2, "balls": [1, 1, 1]}, "-heat_balls: needs 2 indices"),
    (LATTICE, {"overlap": 1, "hertz": -1.0}, "-bonds_hertz -1"),
    (LATTICE, {"radius": 0.1}, "only for a network"),
    (NETWORK, {"factor": 2, "balls": [4]}, "-heat_balls: ball 4 is held"),
    (NETWORK, {"factor": 2, "balls": [5]}, "-heat_balls: no ball 5; the last is 4"),
    (NETWORK, {"factor": 2, "relax": True}, "only for balls that grow"),
    (NETWORK, {"kelvin": 1.0}, "-heat_kelvin: .* not known"),
    (NETWORK, GROWS, "does not know its contact law"),
    (BEADS, {"radius": -1.0}, "no radius left"),
    (replace(BEADS, power=1.0), GROWS, "friction"),
    (packing("rotations", power=1.0), GROWS, "balls that turn .* -heat_relax false"),
    (replace(NETWORK, force=0 * NETWORK.force), {"overlap": 0.1}, "contact 0 .* no contact law"),
    (replace(NETWORK, stiffness=NEGATIVE), {"overlap": 0.1}, "contact 3 .* no contact law"),
    (replace(CELL, force=[0.01, -0.01, 0.01]), GROWS, "contact 1 bears no repulsive force"),
    (replace(CELL, force=[0.01, 0.0, 0.01]), GROWS, "contact 1 bears no repulsive force"),
]


@pytest.mark.parametrize(("medium", "choices", "said"), REFUSED)
def test_what_is_refused(medium, choices, said):
    detectors = [[0, 0]] if medium is LATTICE else medium.free[:1]
    with pytest.raises(InputError, match=said) as caught:
        heated(medium, OMEGAS, detectors, **choices)
    assert "\n" not in str(caught.value)
