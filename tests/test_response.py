"""The sweep of the paper, end to end, against the dense reference; phases and their fit."""

import dataclasses

import numpy as np
import pytest
from samples import random_lattice, reference_of, swept

from pgran.physics.lattice import Lattice
from pgran.record import Result
from pgran.results import LatticeRecord
from pgran.scenes.response import ResponseSweep, fit_phase, summary, unwrap

PAPER, LATTICE = np.linspace(0.01, 1.3, 1291), random_lattice((20, 20))


@pytest.fixture(scope="module")
def response(world):
    return swept(LATTICE, PAPER, (8, 10), world, fields=True)


def said(response, lattice=LATTICE):
    """What a run says of a response."""
    return "\n".join(summary(Result([LatticeRecord.of(lattice), response])))


def test_paper_against_the_reference(world, response):
    """Every 40th frequency: 1 part in 10000, the bound holds, down to 1e-11; the field alike."""
    assert response.failures == 0
    assert response.amplitude.min() < 1e-9
    assert np.array_equal(response.omega, PAPER)
    assert response.detector.tolist() == [[8, 10]]
    for index in range(0, len(PAPER), 40)[world.rank :: world.size]:
        exact = reference_of(LATTICE).field(PAPER[index])
        (amplitude,), (bound,) = response.displacement[index], response.error_bound[index]
        assert abs(amplitude - exact[8, 10]) <= min(bound, 1e-4 * abs(exact[8, 10]))
        assert np.linalg.norm(response.field[index] - exact) <= 1e-4 * np.linalg.norm(exact)
    turned = response.amplitude * np.exp(1j * response.phase)
    assert np.allclose(turned, response.displacement, rtol=1e-12, atol=0)
    worst = (response.error_bound / response.amplitude).max()
    text = said(response)
    assert f"1291 frequencies with {response.factorizations}" in text
    assert f"{response.phase_slope[0]:.4g} rad" in text
    assert "too coarse" not in text
    assert f"every amplitude at most {worst:.1e} (error_bound)" in text


def test_phase_velocity_of_the_paper(response):
    """The paper finds .03 cm x omega_mx for balls of .5 cm; the phase falls linearly."""
    assert -200 < response.phase_slope[0] < -130
    assert 0.025 < 0.5 * response.phase_velocity[0] < 0.045
    assert response.phase_velocity[0] == pytest.approx(12 / abs(response.phase_slope[0]))
    inside = (PAPER > 0.3) & (PAPER < 1.0)
    line = response.phase_intercept + response.phase_slope * PAPER[inside, None]
    deviation = response.phase[inside] - line
    assert np.abs(deviation).max() < 0.1 * np.ptp(response.phase[inside])
    # a least-squares line: what is left is orthogonal to constants and to x
    assert abs(deviation.mean()) < 1e-9
    assert abs((deviation[:, 0] * PAPER[inside]).mean()) < 1e-9


def test_phase_window_is_in_units_of_omega_mx(world, response):
    """K -> 4 K, beta -> 2 beta, omega -> 2 omega: the same slope and velocity."""
    stiff = Lattice(tuple(4 * k for k in LATTICE.stiffness), 1.0, 0.006, kmax=1.0)
    doubled = swept(stiff, 2 * PAPER, (8, 10), world)
    assert doubled.phase_slope == pytest.approx(response.phase_slope, rel=1e-6)
    assert doubled.phase_velocity == pytest.approx(response.phase_velocity, rel=1e-6)


def test_failures_are_counted_and_left_out_of_the_fit(world, response, solver_options):
    solver_options("-steady_ksp_type gmres -steady_pc_type none -steady_ksp_max_it 1")
    found = swept(random_lattice((8, 9)), np.linspace(0.1, 1.2, 23), (3, 4), world)
    assert found.failures == 23
    assert np.all(np.isnan(found.phase_slope))
    assert np.all(np.isnan(found.phase_velocity))
    reasons = np.array([2, 0, -3, 1])
    assert dataclasses.replace(response, converged_reason=reasons).failures == 2


def test_without_damping_there_is_no_phase_to_follow(world):
    """The amplitude is real: its sign changes at resonances and between them, by jumps of pi."""
    lattice = random_lattice((8, 9), damping=0.0)
    found = swept(lattice, np.linspace(0.05, 1.2, 60), (3, 4), world)
    assert set(found.phase.ravel()) == {0.0, np.pi}
    assert np.array_equal(found.phase > 0, found.displacement.real < 0)
    assert np.all(np.isnan([found.phase_slope, found.phase_intercept, found.phase_velocity]))
    text = said(found, lattice)
    assert "no phase velocity: without damping" in text
    assert "too coarse" not in text


@pytest.mark.parametrize("last", [0.2, np.nan])
def test_a_coarse_grid_is_seen_beside_missing_points(response, last):
    phase = np.array([[0.0], [0.1], [3.2], [last]])
    assert "too coarse" in said(dataclasses.replace(response, phase=phase))


def test_unwrap_follows_a_fall_of_many_turns():
    """And passes over missing points."""
    phase = -150 * np.linspace(0, 1, 400)[:, None] + [0.3, -1.2]
    phase[100] = np.nan
    found = unwrap(np.exp(1j * phase))
    assert np.allclose(found, phase, rtol=0, atol=1e-10, equal_nan=True)


def test_the_phase_passes_over_failed_points():
    """However wrong a finite amplitude is, later phases do not turn with it."""
    omegas = np.linspace(0.1, 1.2, 40)
    phase = -10 * omegas
    task = ResponseSweep(random_lattice((6, 5)), omegas, (3, 2), False, (0.3, 1.0), {})
    rows = np.zeros(40, task.row)
    rows["converged_reason"] = 1
    rows["converged_reason"][[19, 20, 30]] = 0, -3, -3
    rows["displacement"][:, 0] = np.exp(1j * phase)
    rows["displacement"][[19, 20, 30], 0] *= np.exp([2.0j, 4.0j, -3.0j])
    found = task.collect(rows, 0.0)
    good = rows["converged_reason"] > 0
    assert found.failures == 3
    assert np.all(np.isnan(found.phase[~good]))
    np.testing.assert_allclose(found.phase[good, 0], phase[good], rtol=1e-12)
    assert found.phase_slope == pytest.approx(-10, rel=1e-9)


@pytest.mark.filterwarnings("error")
def test_fit_of_a_line():
    """None, and no warning, of few points or of points too close for a slope but rounding's."""
    x = np.linspace(0.3, 1, 50)
    phase = np.stack([2 - 160 * x, -1 - 20 * x], axis=1)
    phase[7, 1] = np.nan
    slope, intercept = fit_phase(x, phase)
    assert slope == pytest.approx([-160, -20], rel=1e-12)
    assert intercept == pytest.approx([2, -1], rel=1e-10)
    for count in (0, 2):
        assert np.isnan(fit_phase(x[:count], phase[:count])).tolist() == [[True, True]] * 2
    x = 0.5 + np.arange(4) * 2.0**-53
    assert np.all(np.isnan(fit_phase(x, np.random.default_rng(1).random((4, 1)))))
    x = 0.5 + np.arange(4) * 2.0**-20
    assert fit_phase(x, -3 * x[:, None])[0] == pytest.approx(-3, rel=1e-8)
