"""The power spectrum and its exponent, against processes whose spectra are known exactly."""

import logging
import math

import numpy as np
import pytest
from scipy.signal import welch

from pgran.errors import InputError
from pgran.physics.spectrum import check_window, fewest_steps, power_spectrum, segment_length


def power_law_noise(psi, trajectories, steps, seed):
    """Gaussian noise with S = 2 / (2 sin(pi f))^psi: sums of noise of |psi| < 2 made by FFT."""
    sums = int(psi // 2)
    f = np.fft.rfftfreq(4 * steps)[1:]
    gain = np.append(0, (2 * np.sin(np.pi * f)) ** (sums - psi / 2))
    white = np.random.default_rng(seed).standard_normal((trajectories, 4 * steps))
    noise = np.fft.irfft(np.fft.rfft(white) * gain)[:, :steps]
    for _ in range(sums):
        noise = np.cumsum(noise, axis=1)
    return noise


def telegraph(corner, trajectories, steps, seed):
    """A signal of +1 and -1 that flips with probability pi * corner at each step.

    Its correlation is (1 - 2p)^t = exp(-2 pi corner t) for small p.
    """
    flips = np.random.default_rng(seed).random((trajectories, steps)) < np.pi * corner
    return 1 - 2.0 * (np.cumsum(flips, axis=1) % 2)


def spread_in_errors(results, truth):
    """Mean squared deviation from the truth, in units of the error bars."""
    z = [(result.exponent - truth) / result.exponent_error for result in results]
    return np.mean(np.square(z))


@pytest.mark.parametrize("corner", [1e-4, 3e-4, 1e-3])
def test_telegraph_has_slope_two_above_its_corner(corner):
    for series in telegraph(corner, 5, 100_000, seed=1):
        result = power_spectrum(series)
        assert result.exponent == pytest.approx(2, abs=0.05)
        assert result.exponent_error < 0.025


def test_telegraph_power_is_its_lorentzian():
    p = np.pi * 1e-3
    result = power_spectrum(telegraph(1e-3, 20, 50_000, seed=2))
    rho = 1 - 2 * p
    f = result.frequency
    exact = 2 * (1 - rho**2) / (1 - 2 * rho * np.cos(2 * np.pi * f) + rho**2)
    window = f > 0.005
    assert np.mean(result.power[window] / exact[window]) == pytest.approx(1, abs=0.02)


@pytest.mark.parametrize("psi", [0, 1, 1.5, 2, 2.5, 3, 4, 5])
def test_exponent_of_power_law_noise(psi):
    result = power_spectrum(power_law_noise(psi, 20, 20_000, seed=3))
    assert 0.003 < result.exponent_error < 0.02
    assert result.exponent == pytest.approx(psi, abs=3 * result.exponent_error + 0.01)


def test_law_and_prefactor_of_a_random_walk():
    result = power_spectrum(3 * power_law_noise(2, 20, 20_000, seed=4))
    f = np.array([0.01, 0.1, 0.3])
    np.testing.assert_allclose(result.power_law(f), 2 * 9 / (2 * np.sin(np.pi * f)) ** 2, rtol=0.1)
    near = np.searchsorted(result.frequency, 0.1) + np.arange(-20, 20)
    np.testing.assert_allclose(result.power[near].mean(), result.power_law(0.1), rtol=0.1)


def test_plain_exponent_sees_the_aliases():
    walk = power_law_noise(2, 20, 20_000, seed=5)
    result = power_spectrum(walk)
    # Means of log f and log sin(pi f) in bins of log f differ little from integrals over log f.
    x = np.log(np.geomspace(0.01, 0.3, 1501))
    expected = -np.polyfit(x, -2 * np.log(np.sin(np.pi * np.exp(x))), 1)[0]
    assert 1.93 < expected < 1.96
    assert result.exponent_plain - result.exponent == pytest.approx(expected - 2, abs=0.005)
    near = power_spectrum(walk, 0.01, 0.1)
    assert abs(near.exponent_plain - near.exponent) < 0.02


def test_power_integrates_to_the_variance():
    series = 5 + 2 * np.random.default_rng(6).standard_normal((4, 50_000))
    result = power_spectrum(series)
    width = result.frequency[1] - result.frequency[0]
    assert width == pytest.approx(1 / result.segment)
    assert result.power.sum() * width == pytest.approx(4, rel=0.02)
    assert result.power.mean() == pytest.approx(8, rel=0.02)  # 4 spread over 1/2


def test_power_of_a_sine_is_half_its_amplitude_squared():
    segment = segment_length(1, 40_000)
    f = 80 / segment
    result = power_spectrum(3 * np.sin(2 * np.pi * f * np.arange(40_000)))
    assert result.frequency[np.argmax(result.power)] == pytest.approx(f)
    assert result.power.sum() / result.segment == pytest.approx(4.5, rel=1e-3)


def test_scale_and_offset_leave_the_exponent():
    walk = power_law_noise(2, 1, 20_000, seed=7)
    one, other = power_spectrum(walk), power_spectrum(100 - 1e-3 * walk)
    assert other.exponent == pytest.approx(one.exponent, abs=1e-6)
    np.testing.assert_allclose(other.power, 1e-6 * one.power, rtol=1e-4)


def test_power_is_the_average_over_trajectories():
    walks = power_law_noise(2, 3, 40_000, seed=8)
    together = power_spectrum(walks)
    apart = [power_spectrum(walk) for walk in walks]
    np.testing.assert_allclose(together.power, np.mean([one.power for one in apart], axis=0))
    np.testing.assert_array_equal(power_spectrum(walks[0]).power, power_spectrum(walks[:1]).power)


def test_power_is_welchs():
    walk = power_law_noise(2, 1, 30_000, seed=21)
    result = power_spectrum(walk)
    f, power = welch(walk[0], window="hann", nperseg=result.segment, detrend="linear")
    np.testing.assert_allclose(result.frequency, f[1:-1], rtol=1e-12)
    np.testing.assert_allclose(result.power, power[1:-1], rtol=1e-10)


def test_error_falls_like_the_root_of_the_number_of_trajectories():
    walks = power_law_noise(2, 64, 10_000, seed=9)
    eight = np.mean([power_spectrum(part).exponent_error for part in np.split(walks, 8)])
    assert eight / power_spectrum(walks).exponent_error == pytest.approx(math.sqrt(8), rel=0.3)


@pytest.mark.parametrize(
    ("trajectories", "steps"), [(1, 40_000), (1, 10_000), (3, 10_000), (25, 1600)]
)
@pytest.mark.parametrize("psi", [0, 2])
def test_error_bar_covers_the_spread_between_seeds(psi, trajectories, steps):
    noise = power_law_noise(psi, 40 * trajectories, steps, seed=10).reshape(40, trajectories, -1)
    # Of chi square with 40 degrees over 40: standard deviation sqrt(2/40) = .22.
    assert 0.4 < spread_in_errors([power_spectrum(series) for series in noise], psi) < 1.9


def test_error_bar_covers_the_spread_of_a_telegraph():
    results = [power_spectrum(series) for series in telegraph(3e-4, 40, 40_000, seed=11)]
    assert 0.4 < spread_in_errors(results, 2) < 1.9


def test_error_bar_knows_that_trajectories_differ():
    # Walks of their own loudness in common noise: each trajectory alone is far more regular than
    # they are among themselves, and the louder ones count for more.
    rng, shape = np.random.default_rng(12), (40, 25, 2000)
    loudness = np.exp(0.5 * rng.standard_normal((40, 25, 1)))
    walks = 0.3 * loudness * power_law_noise(2, 1000, 2000, seed=13).reshape(shape)
    results = [power_spectrum(series) for series in walks + rng.standard_normal(shape)]
    mean = np.mean([result.exponent for result in results])
    assert 1 < mean < 1.9
    assert 0.4 < spread_in_errors(results, mean) < 1.9


def test_segments_resolve_the_low_end_or_leave_enough_of_them():
    assert segment_length(1, 100_000) == 1600
    assert segment_length(1, 100_000, fit_min=0.02) == 800
    assert segment_length(1, 2000) == 800
    assert segment_length(50, 3000) == 1600
    for steps in range(2000, 40_000, 997):
        segment = segment_length(1, steps)
        assert segment % 2 == 0
        assert 800 <= segment <= 1600


@pytest.mark.parametrize(
    ("arguments", "option"),
    [
        ((0, 0.3), "spectrum_fit_min"),
        ((-0.1, 0.3), "spectrum_fit_min"),
        ((0.6, 0.7), "spectrum_fit_min"),
        ((math.nan, 0.3), "spectrum_fit_min"),
        ((0.01, 0.6), "spectrum_fit_max"),
        ((0.01, math.nan), "spectrum_fit_max"),
        ((0.1, 0.15), "spectrum_fit_max"),
        ((0.3, 0.01), "spectrum_fit_max"),
        ((1e-4, 0.3), "relax_steps"),
    ],
)
def test_impossible_windows_name_their_option(arguments, option):
    with pytest.raises(InputError, match=f"^{option}: "):
        power_spectrum(power_law_noise(2, 1, 4000, seed=14), *arguments)


@pytest.mark.parametrize("fit_min", [0.0, 1e-310, 0.5, math.nan])
def test_a_window_is_checked_without_a_series(fit_min):
    with pytest.raises(InputError, match=r"^spectrum_fit_min: "):
        check_window(fit_min, 0.5)


@pytest.mark.parametrize(("trajectories", "steps"), [(1, 2000), (2, 1200), (4, 800), (9, 800)])
def test_too_few_steps(trajectories, steps):
    walks = power_law_noise(2, trajectories, steps, seed=15)
    result = power_spectrum(walks)
    assert np.isfinite(result.exponent_error)
    assert fewest_steps(trajectories) == steps
    with pytest.raises(InputError, match=f"^relax_steps: .* at least {steps} are needed"):
        power_spectrum(walks[:, 1:])


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_values_that_are_not_finite(bad):
    series = power_law_noise(2, 2, 4000, seed=16)
    series[1, 7] = bad
    with pytest.raises(InputError, match="step 7 of trajectory 1"):
        power_spectrum(series)


@pytest.mark.parametrize(
    ("series", "message"),
    [
        (np.full(4000, 0.1), "never changes"),
        (np.zeros((2, 4000)), "never changes"),
        (np.ones(4000, dtype=complex), "real"),
        (np.empty((0, 4000)), "shape"),
        (np.ones((2, 2, 4000)), "shape"),
        (np.where(np.arange(20_000) < 200, 0.0, 1.0), "relax_steps: .* one part"),
    ],
)
def test_series_without_a_spectrum(series, message):
    with pytest.raises(InputError, match=message):
        power_spectrum(series)


def test_a_good_window_is_not_warned_about(caplog):
    power_spectrum(telegraph(1 / (2 * np.pi * 840), 2, 100_000, seed=17), memory=840)
    power_spectrum(power_law_noise(0, 2, 20_000, seed=18))
    assert not caplog.records


def test_warning_of_the_flat_low_end(caplog):
    signal = telegraph(0.01, 4, 40_000, seed=19)
    above = power_spectrum(signal, 0.06, 0.3, memory=1 / (2 * np.pi * 0.01))
    assert above.exponent == pytest.approx(2, abs=0.1)
    assert not caplog.records
    # With the memory given it is told from that, and without it from the spectrum's own bend.
    below = power_spectrum(signal, 0.01, 0.3, memory=1 / (2 * np.pi * 0.01))
    assert below.exponent < 1.9
    assert ["corner" in record.message for record in caplog.records] == [True, False]
    caplog.clear()
    power_spectrum(signal, 0.01, 0.3)
    (record,) = caplog.records
    assert record.levelno == logging.WARNING
    assert record.name == "pgran.physics.spectrum"
    assert record.message.startswith("spectrum_fit_min: ")


def test_warning_of_the_aliased_end(caplog):
    power_spectrum(power_law_noise(2, 2, 20_000, seed=20), fit_max=0.45)
    (record,) = caplog.records
    assert record.levelno == logging.WARNING
    assert record.message.startswith("spectrum_fit_max: ")
