"""The sweep of the paper, end to end, against the dense reference; phases and their fit."""

import dataclasses

import numpy as np
import pytest
from reference import Reference, uniform_field
from samples import paper_lattice, random_lattice, uniform_lattice

from pgran.errors import InputError
from pgran.parallel.crew import Crew
from pgran.results import LatticeRecord
from pgran.scenes.response import fit_phase, summary, sweep, unwrap

PAPER = np.linspace(0.01, 1.3, 1291)


def run(world, lattice, omegas, detectors, **more):
    """The response on all ranks."""
    with Crew(world, 1) as crew:
        return world.bcast(sweep(lattice, omegas, detectors, crew, **more))


@pytest.fixture(scope="module")
def response(world):
    return run(world, paper_lattice(), PAPER, (8, 10))


def test_paper_against_the_reference(world, response):
    """Every 20th frequency: 1 part in 10000, the bound holds, down to 1e-11."""
    reference = Reference(paper_lattice().stiffness)
    assert np.all(response.converged_reason > 0)
    assert response.amplitude.min() < 1e-9
    for index in range(0, len(PAPER), 20)[world.rank :: world.size]:
        exact = reference.amplitudes(PAPER[index], [(8, 10)])
        error = np.abs(response.displacement[index] - exact)
        assert np.all(error <= response.error_bound[index])
        assert np.all(error <= 1e-4 * np.abs(exact))


def test_shapes_and_consistency(response):
    nw = len(PAPER)
    assert response.displacement.shape == response.error_bound.shape == (nw, 1)
    assert np.array_equal(response.omega, PAPER)
    assert response.detector.tolist() == [[8, 10]]
    assert np.allclose(response.amplitude, np.abs(response.displacement), rtol=1e-15, atol=0)
    assert response.failures == 0
    assert 0 < response.factorizations <= nw
    turned = response.amplitude * np.exp(1j * response.phase)
    assert np.allclose(turned, response.displacement, rtol=1e-12, atol=0)
    assert response.field is None
    assert np.all(response.backward_error >= 0)
    assert response.solve_seconds > 0


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_phase_velocity_of_the_paper(world, response, seed):
    """The paper finds .03 cm x omega_mx for balls of .5 cm; the phase falls linearly."""
    if seed:
        response = run(world, paper_lattice(seed), PAPER, (8, 10))
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
    lattice = paper_lattice()
    stiff = type(lattice)(tuple(4 * k for k in lattice.stiffness), 1.0, 0.006, kmax=1.0)
    assert stiff.omega_mx == 2.0
    doubled = run(world, stiff, 2 * PAPER, (8, 10))
    assert doubled.phase_slope == pytest.approx(response.phase_slope, rel=1e-6)
    assert doubled.phase_velocity == pytest.approx(response.phase_velocity, rel=1e-6)


def test_fields(world, solver_options):
    """Also in the 2-norm as accurate as asked, and the detectors' values agree.

    By a poor solver, which makes errors away from the detectors, on units of two frequencies.
    """
    solver_options("-steady_pc_type jacobi")
    lattice = random_lattice((6, 9), 2)
    omegas = np.linspace(0.1, 1.2, 128)
    found = run(world, lattice, omegas, (5, 4, 5, 8), fields=True, error_tolerance=1e-9)
    reference = Reference(lattice.stiffness)
    assert found.field.shape == (128, 6, 9)
    assert np.all(found.converged_reason > 0)
    for omega, field, displacement in zip(omegas, found.field, found.displacement, strict=True):
        exact = reference.field(omega)
        assert np.linalg.norm(field - exact) <= 1e-9 * np.linalg.norm(exact)
        assert np.abs(displacement - exact[[5, 5], [4, 8]]).max() <= 1e-9 * np.abs(exact).max()


@pytest.mark.parametrize("shape", [(12,), (5, 4, 6), (1, 1), (3, 1, 2)])
def test_other_dimensions(world, shape):
    lattice = random_lattice(shape, 3)
    sites = [tuple(n - 1 for n in shape), (0,) * len(shape), tuple(n // 2 for n in shape)]
    omegas = np.linspace(0.02, 1.5, 41)
    found = run(world, lattice, omegas, sites)
    reference = Reference(lattice.stiffness)
    assert np.all(found.converged_reason > 0)
    for omega, displacement, bound in zip(
        omegas, found.displacement, found.error_bound, strict=True
    ):
        exact = reference.amplitudes(omega, sites)
        assert np.all(np.abs(displacement - exact) <= bound)
        assert np.all(np.abs(displacement - exact) <= 1e-4 * np.abs(exact))


def test_uniform_lattice(world):
    found = run(world, uniform_lattice((10, 12)), PAPER[::60], (4, 7), error_tolerance=1e-12)
    for omega, displacement in zip(found.omega, found.displacement[:, 0], strict=True):
        exact = uniform_field((10, 12), 0.25, 1.0, 0.003, omega)[4, 7]
        assert abs(displacement - exact) <= 1e-12 * max(1.0, abs(exact))


def test_failures_are_counted_and_left_out_of_the_fit(world, solver_options):
    solver_options("-steady_ksp_type gmres -steady_pc_type none -steady_ksp_max_it 1")
    found = run(world, random_lattice((8, 9)), np.linspace(0.1, 1.2, 23), (3, 4))
    assert found.failures == 23
    assert np.all(np.isnan(found.phase_slope))
    assert np.all(np.isnan(found.phase_velocity))


def test_a_reason_of_zero_is_a_failure(response):
    reasons = np.array([2, 0, -3, 1])
    assert dataclasses.replace(response, converged_reason=reasons).failures == 2


def test_detector_outside(world):
    with pytest.raises(InputError, match="outside the lattice"):
        run(world, random_lattice((8, 9)), PAPER[:3], (8, 4))


def test_one_frequency(world):
    found = run(world, random_lattice((8, 9)), np.array([0.5]), (3, 4))
    assert found.displacement.shape == (1, 1)
    assert np.isnan(found.phase_slope[0])


def test_summary_names_what_was_found(response):
    text = "\n".join(summary([LatticeRecord.of(paper_lattice()), response]))
    assert "1291 frequencies" in text
    assert f"{response.phase_slope[0]:.4g} rad" in text
    assert "too coarse" not in text
    worst = (response.error_bound / response.amplitude).max()
    assert f"every amplitude at most {worst:.1e} (error_bound)" in text


def test_summary_warns_of_a_coarse_grid(world):
    coarse = run(world, paper_lattice(), PAPER[::100], (8, 10))
    text = "\n".join(summary([LatticeRecord.of(paper_lattice()), coarse]))
    assert "too coarse" in text


def test_without_damping_there_is_no_phase_to_follow(world):
    """The amplitude is real: its sign changes at resonances and between them, by jumps of pi."""
    lattice = random_lattice((8, 9), damping=0.0)
    found = run(world, lattice, np.linspace(0.05, 1.2, 60), (3, 4))
    assert set(found.phase.ravel()) == {0.0, np.pi}
    assert np.array_equal(found.phase > 0, found.displacement.real < 0)
    for name in ("slope", "intercept", "velocity"):
        assert np.all(np.isnan(getattr(found, f"phase_{name}")))
    text = "\n".join(summary([LatticeRecord.of(lattice), found]))
    assert text.count("no phase velocity: without damping") == 1
    assert "too coarse" not in text
    assert "phase slope" not in text


@pytest.mark.parametrize("missing", [False, True])
def test_a_coarse_grid_is_seen_beside_missing_points(response, missing):
    phase = np.array([[0.0], [0.1], [3.2], [0.2]])
    phase[-1] = np.nan if missing else 0.2
    shown = dataclasses.replace(response, phase=phase)
    assert "too coarse" in "\n".join(summary([LatticeRecord.of(paper_lattice()), shown]))


# Phases


def test_unwrap_follows_a_fall_of_many_turns():
    x = np.linspace(0, 1, 400)
    phase = -150 * x[:, None] + [0.3, -1.2]
    displacement = np.exp(1j * phase) * (1 + x[:, None])
    found = unwrap(displacement)
    assert np.allclose(found - found[0], phase - phase[0], atol=1e-10)
    assert np.all(np.abs(found[0]) <= np.pi)


def test_unwrap_passes_over_missing_points():
    x = np.linspace(0, 1, 400)
    displacement = np.exp(-150j * x)[:, None]
    displacement[100] = np.nan
    found = unwrap(displacement)
    assert np.isnan(found[100, 0])
    assert np.allclose(np.delete(found, 100) + 150 * np.delete(x, 100), 0, atol=1e-10)


def test_fit_of_a_line():
    x = np.linspace(0.3, 1, 50)
    phase = np.stack([2 - 160 * x, -1 - 20 * x], axis=1)
    phase[7, 1] = np.nan
    slope, intercept = fit_phase(x, phase)
    assert slope == pytest.approx([-160, -20], rel=1e-12)
    assert intercept == pytest.approx([2, -1], rel=1e-10)


@pytest.mark.filterwarnings("error")
def test_points_too_close_for_a_line():
    """Without a warning, either: the slope would be that of rounding."""
    x = 0.5 + np.arange(4) * 2.0**-53
    assert np.all(np.isnan(fit_phase(x, np.random.default_rng(1).random((4, 1)))))
    x = 0.5 + np.arange(4) * 2.0**-20
    assert fit_phase(x, -3 * x[:, None])[0] == pytest.approx(-3, rel=1e-8)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_fit_of_too_few_points(count):
    slope, intercept = fit_phase(np.linspace(0, 1, count), np.zeros((count, 2)))
    assert slope.shape == intercept.shape == (2,)
    assert np.all(np.isnan(slope))
