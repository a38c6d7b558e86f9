"""The sweep of the paper, end to end, against the dense reference; phases and their fit."""

import dataclasses
import re

import numpy as np
import pytest
from samples import random_lattice, reference_of, swept

from pgran.driven.amplitudes import CERTAIN_DEVIATION, FIT_BLOCKS, fit_phase
from pgran.experiments.response.scene import ResponseSweep, summary
from pgran.medium.lattice import Lattice
from pgran.medium.record import LatticeRecord
from pgran.store.estimate import counted, with_error
from pgran.store.record import Result

PAPER, LATTICE = np.linspace(0.01, 1.3, 1291), random_lattice((20, 20))


@pytest.fixture(scope="module")
def response(world):
    return swept(LATTICE, PAPER, (8, 10), world, fields=True)


def said(response, lattice=LATTICE):
    """What a run says of a response."""
    return "\n".join(summary(Result([LatticeRecord.of(lattice), response])))


def test_paper_against_the_reference(world, response):
    """Every 60th frequency: 1 part in 10000, the bound holds, down to 1e-11; the field alike."""
    assert response.failures == 0
    assert response.amplitude.min() < 1e-9
    reference = reference_of(LATTICE)
    for index in range(0, len(PAPER), 60)[world.rank :: world.size]:
        exact = reference.field(PAPER[index])
        (amplitude,), (bound,) = response.displacement[index], response.error_bound[index]
        assert abs(amplitude - exact[8, 10]) <= min(bound, 1e-4 * abs(exact[8, 10]))
        assert np.linalg.norm(response.field[index] - exact) <= 1e-4 * np.linalg.norm(exact)
    turned = response.amplitude * np.exp(1j * response.phase)
    assert np.allclose(turned, response.displacement, rtol=1e-12, atol=0)
    worst, text = (response.error_bound / response.amplitude).max(), said(response)
    slope = with_error(response.phase_slope[0], response.phase_slope_error[0])
    assert f"1291 frequencies with {response.factorizations}" in text
    assert f"phase slope {slope} rad" in text
    assert f"every amplitude at most {worst:.1e} (error_bound)" in text


def test_numbers_in_words():
    """A number ends where its error does, which has two digits."""
    for size in np.geomspace(1e-3, 1e4, 57):
        number, error = with_error(12.3456789, size).split(" +- ")
        assert float(error) == pytest.approx(size, rel=0.05)
        assert abs(float(number) - 12.3456789) <= 0.05 * size
        assert len(number.partition(".")[2]) == len(error.partition(".")[2])
        assert len(error.replace(".", "").strip("0")) <= 2
    for size, text in ((0, "0.5 +- 0"), (0.0997, "0.50 +- 0.10"), (np.nan, "0.5 +- nan")):
        assert with_error(0.5, size) == text
    assert with_error(3.104e-8, 1.2e-9) == "(3.10 +- 0.12)e-08"
    assert with_error(3.104e-8, 1.2e-9, r"\pm") == r"(3.10 \pm 0.12)\times10^{-8}"
    words = [counted(n, name) for name in ("frequency", "mode") for n in (1, 2)]
    assert words == ["1 frequency", "2 frequencies", "1 mode", "2 modes"]


def test_phase_velocity_of_the_paper(response):
    """The paper finds .03 cm x omega_mx for balls of .5 cm; the phase falls linearly."""
    slope, omega = response.phase_slope[0], response.omega
    assert -200 < slope < -130
    assert 0.025 < 0.5 * response.phase_velocity[0] < 0.045
    assert response.phase_velocity[0] == pytest.approx(12 / -slope)
    part = response.phase_slope_error / -slope
    assert 0 < part < 0.1
    assert response.phase_velocity_error == pytest.approx(part * response.phase_velocity)
    used = response.phase_used_min[0], response.phase_used_max[0]
    assert used == pytest.approx((0.3, 1.0))  # whose rounding leaves no end out
    inside = (omega >= used[0]) & (omega <= used[1])
    left = response.phase[inside, 0] - response.phase_intercept - slope * omega[inside]
    assert np.abs(left).max() < 0.1 * np.ptp(response.phase[inside])
    # a least-squares line: the integrals of what is left, and of it times x, vanish
    left[[0, -1]] /= 2
    assert abs(left.mean()) < 1e-9 > abs((left * omega[inside]).mean())


def test_without_damping_there_is_no_phase_to_follow(world):
    """The amplitude is real: its sign changes at resonances and between them, by jumps of pi."""
    lattice = random_lattice((8, 9), damping=0.0)
    found = swept(lattice, np.linspace(0.05, 1.2, 60), (3, 4), world)
    assert set(found.phase.ravel()) == {0.0, np.pi}
    assert np.array_equal(found.phase > 0, found.displacement.real < 0)
    assert np.all(np.isnan([found.phase_slope, found.phase_intercept, found.phase_velocity]))
    text = said(found, lattice)
    assert "no phase velocity: without damping" in text
    assert "-sweep_method curve" not in text  # there is none


@pytest.mark.parametrize("error", [0.02, np.inf, np.nan])
def test_where_the_curve_is_not_resolved_is_said(response, error):
    """Between which neighbours first, in how many places, and what helps."""
    line_error = np.full(response.line_error.shape, 0.0099)
    response = dataclasses.replace(response, line_error=line_error)
    assert "not resolved" not in said(response)
    line_error[40] = error
    place = f"the curve is not resolved between {PAPER[39]:.6g} and {PAPER[40]:.6g}"
    assert f"{place}; -sweep_method curve resolves it\n" in said(response)
    line_error[50] = error
    curve = said(dataclasses.replace(response, method="curve", resolve=0.01))
    assert f"{place}, and in 1 more place\n" in curve
    asked = said(dataclasses.replace(response, resolve=0.1))
    assert ("not resolved" in asked) == (not error <= 0.1)


def test_a_phase_that_is_certain_turns_as_on_a_finer_grid(world, response):
    """And where it is not, on a coarse one, it turns otherwise somewhere."""
    missed = []
    for step in (2, 4, 8, 16):
        coarse = swept(LATTICE, PAPER[::step], (8, 10), world)
        turned = np.diff(coarse.phase[:, 0])
        wrong = np.abs(turned - np.diff(response.phase[::step, 0])) > 1e-6
        certain = coarse.line_error[1:, 0] <= CERTAIN_DEVIATION
        assert certain.any()
        assert not np.any(wrong & certain)
        missed.append(np.count_nonzero(wrong))
    assert missed[-1] > 0


@pytest.mark.parametrize("within", [False, True])
def test_the_phase_passes_over_failed_points(within):
    """However wrong a finite amplitude is, later phases do not turn with it; no line passes one."""
    omegas, bad = np.linspace(0.1, 1.2, 40), [2, 3, 20 if within else 38]
    lattice, phase = random_lattice((6, 5), damping=1.0), -10 * omegas  # no narrow resonances
    task = ResponseSweep(lattice, omegas, (3, 2), False, {"error_tolerance": 1e-4})
    rows = np.zeros(40, task.row)
    rows["omega"], rows["converged_reason"] = omegas, 1
    rows["converged_reason"][bad] = 0, -3, -3
    rows["displacement"][:, 0] = np.exp(1j * phase)
    rows["derivative"] = -10j * rows["displacement"]
    rows["displacement"][bad, 0] *= np.exp([2.0j, 4.0j, -3.0j])
    found = task.response(rows, "points", 0.0, (0.3, 1.0), 0.0)
    good = rows["converged_reason"] > 0
    assert found.failures == 3
    assert np.all(np.isnan(found.phase[~good]))
    np.testing.assert_allclose(found.phase[good, 0], phase[good], rtol=1e-12)
    np.testing.assert_allclose(found.delay[good], 10, rtol=1e-12)
    assert ("no phase velocity: the phase is not certain" in said(found, lattice)) == within
    slope = found.phase_slope
    assert np.isnan(slope) if within else slope == pytest.approx(-10, rel=1e-9)


# The straight line through a phase

X = np.linspace(0.25, 1.1, 86)
SURE = np.zeros(86)


def wavy(x):
    """A phase that no line fits: a resonance a unit of 0.05."""
    return 2 - 160 * x + 3 * np.sin(2 * np.pi * x / 0.05) * x


@pytest.mark.filterwarnings("error")
def test_a_line_is_found_as_it_is():
    """Its error vanishes but for rounding; what is uncertain outside of the window is nothing."""
    phase, line_error = 2 - 160 * X, SURE.copy()
    phase[[0, -1]], line_error[[0, 3, -1]] = np.nan, (0.0, np.inf, 9.0)
    line = fit_phase(X, phase, line_error, 0.3, 1.0)
    assert (line.slope, line.intercept) == pytest.approx((-160, 2), rel=1e-11)
    assert 0 <= line.slope_error < 1e-10
    assert (line.low, line.high) == pytest.approx((0.3, 1.0), rel=1e-12)
    assert line.why_not == ""
    x = 0.5 + np.arange(12) * 2.0**-53  # too close for a slope but roundings
    assert "12 frequencies" in fit_phase(x, SURE[:12], 0 * x, x[0], x[-1]).why_not
    x = 0.5 + np.arange(12) * 2.0**-20
    assert fit_phase(x, -3 * x, 0 * x, x[0], x[-1]).slope == pytest.approx(-3, rel=1e-8)


def test_points_added_here_and_there_do_not_change_the_line():
    """A plain fit would follow them."""
    even = np.linspace(0.3, 1.0, 1401)
    uneven = np.unique(np.concatenate([even, np.linspace(0.31, 0.32, 3000), even[700:705] + 1e-7]))
    before, after = (fit_phase(x, wavy(x), 0 * x, 0.3, 1.0) for x in (even, uneven))
    moved = np.polyfit(uneven, wavy(uneven), 1)[0] - before.slope
    assert before.slope == pytest.approx(np.polyfit(even, wavy(even), 1)[0], abs=1e-2)
    assert abs(after.slope - before.slope) < 1e-2 < 1 < abs(moved)
    assert after.slope_error == pytest.approx(before.slope_error, rel=1e-2)


def test_the_standard_error_is_that_of_correlated_points():
    """Over many draws of noise as wide as a resonance the slopes scatter as their errors say."""
    rng, x = np.random.default_rng(2), np.linspace(0.3, 1.0, 701)
    noise = rng.normal(size=(400, 730))
    noise = np.apply_along_axis(np.convolve, 1, noise, np.ones(30) / 30, "valid")
    lines = [fit_phase(x, -160 * x + row, 0 * x, 0.3, 1.0) for row in noise]
    scatter = np.sqrt(np.mean([(line.slope + 160) ** 2 for line in lines]))
    told = np.sqrt(np.mean([line.slope_error**2 for line in lines]))
    assert told == pytest.approx(scatter, rel=0.2)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("points", "uncertain", "unknown", "reason"),
    [
        (X, {40: 0.26}, [], f"not certain between {X[39]:.6g} and {X[40]:.6g} omega_mx"),
        (X, {40: np.inf, 50: np.nan}, [], f"and {X[40]:.6g} omega_mx, and in 1 more place"),
        (X, {}, [40], f"between {X[39]:.6g} and {X[40]:.6g} omega_mx, and in 1 more"),
        (np.delete(X, 5), {5: 1.0}, [], f"not certain between {X[4]:.6g} and {X[6]:.6g} omega_mx$"),
        (np.delete(X, 75), {75: 1.0}, [], f"not certain between {X[74]:.6g} and {X[76]:.6g} om"),
        (X[X < 0.9], {}, [], "does not cover the window of the fit, 0.3 to 1 omega_mx"),
        (X[X > 0.4], {}, [], "does not cover the window of the fit, 0.3 to 1 omega_mx"),
        (X[:0], {}, [], "does not cover the window"),
        (np.linspace(0.3, 1.0, FIT_BLOCKS - 1), {}, [], f"9 frequencies, and {FIT_BLOCKS} apart"),
    ],
)
def test_no_line_and_why(points, uncertain, unknown, reason):
    """Where the phase may have turned unseen anywhere in the window, or nothing tells a slope."""
    line_error, phase = 0 * points, wavy(points)
    line_error[list(uncertain)], phase[unknown] = list(uncertain.values()), np.nan
    *numbers, why_not = dataclasses.astuple(fit_phase(points, phase, line_error, 0.3, 1.0))
    assert re.search(reason, why_not)
    assert np.all(np.isnan(numbers))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("bend", "is_line"), [(1.3, True), (-1.3, True), (1.4, False), (-5, False)]
)
def test_a_phase_that_bends_is_no_line(bend, is_line):
    """The slopes of a parabola's halves differ by its second derivative times half the window."""
    slopes = -20 + np.array([-0.5, 0.5]) * 0.5 * 20 * bend
    phase = -20 * X + 20 * bend / (2 * 0.7) * (X - 0.65) ** 2
    twice = np.insert(X, 40, X[40] - 1e-9), np.insert(phase, 40, phase[40])
    for x, values in ((X, phase), twice):
        line = fit_phase(x, values, 0 * x, 0.3, 1.0)
        assert np.isfinite(line.slope) == is_line
        if not is_line:
            told = [float(n) for n in re.findall(r"-?[\d.]+(?= in the)", line.why_not)]
            assert told == pytest.approx(slopes, abs=0.1)


def test_the_slope_falls_like_one_over_the_root_of_damping(alone):
    """Absorbing diffusion, and no wave at a speed of its own: that would not mind the damping."""
    damping, slopes = np.array([0.002, 0.03]), []
    for beta in damping:
        lattice = Lattice.random((20, 20), damping=beta)
        found = swept(lattice, np.linspace(0.29, 1.01, 300), (8, 10), alone, method="curve")
        assert found.phase_slope_error[0] < 0.1 * abs(found.phase_slope[0])
        slopes.append(abs(found.phase_slope[0]))
    exponent, _ = np.polyfit(np.log(damping), np.log(slopes), 1)
    assert -0.65 < exponent < -0.45
