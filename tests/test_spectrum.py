"""The power spectrum and its exponent, against processes whose spectra are known exactly."""

import math

import numpy as np
import pytest
from figure_reading import draw
from scipy.integrate import trapezoid
from scipy.signal import welch

from pgran.errors import InputError
from pgran.experiments.relaxation import figures as relaxation
from pgran.experiments.relaxation.fluctuations import power_spectrum


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


@pytest.mark.parametrize("psi", [0, 1.5, 4])
def test_exponent_of_power_law_noise(psi):
    result = power_spectrum(power_law_noise(psi, 20, 8000, seed=3))
    assert 0.003 < result.exponent_error < 0.02
    assert result.exponent == pytest.approx(psi, abs=3 * result.exponent_error + 0.01)


def test_law_prefactor_and_plain_exponent_of_a_random_walk():
    result = power_spectrum(3 * power_law_noise(2, 20, 20_000, seed=4))
    f = np.array([0.01, 0.1, 0.3])
    np.testing.assert_allclose(result.power_law(f), 2 * 9 / (2 * np.sin(np.pi * f)) ** 2, rtol=0.1)
    # Means of log f and log sin(pi f) in bins of log f differ little from integrals over log f.
    x = np.log(np.geomspace(0.01, 0.3, 1501))
    expected = -np.polyfit(x, -2 * np.log(np.sin(np.pi * np.exp(x))), 1)[0]
    assert result.exponent_plain - result.exponent == pytest.approx(expected - 2, abs=0.005)


def test_power_is_welchs_averaged_over_trajectories():
    series = 5 + 2 * np.random.default_rng(6).standard_normal((3, 20_000))
    result = power_spectrum(series)
    f, power = welch(series, window="hann", nperseg=result.segment, detrend="linear")
    np.testing.assert_allclose(result.frequency, f[1:-1], rtol=1e-12)
    np.testing.assert_allclose(result.power, power.mean(axis=0)[1:-1], rtol=1e-10)
    assert result.power.sum() / result.segment == pytest.approx(4, rel=0.02)  # the variance


def test_error_bar_covers_the_spread_between_seeds():
    """Mean squared deviation from the truth, in units of the error bars: 1 +- .22 for 40.

    Also of walks of their own loudness in common noise: each trajectory alone is far more regular
    than they are among themselves, and the louder ones count for more.
    """
    rng, shape = np.random.default_rng(12), (25, 20, 1000)
    loudness = 0.3 * np.exp(0.5 * rng.standard_normal((25, 20, 1)))
    walks = loudness * power_law_noise(2, 500, 1000, seed=13).reshape(shape)
    white = power_law_noise(0, 40, 10_000, seed=10)
    for noise, low, high in ((white, 0, 0), (walks + rng.standard_normal(shape), 1, 1.9)):
        results = [power_spectrum(series) for series in noise]
        truth = np.mean([result.exponent for result in results]) if high else 0.0
        assert low <= truth <= high
        deviations = [(result.exponent - truth) / result.exponent_error for result in results]
        assert 0.4 < np.mean(np.square(deviations)) < 1.9


@pytest.mark.parametrize(("trajectories", "steps"), [(1, 2000), (9, 800)])
def test_too_few_steps(trajectories, steps):
    walks = power_law_noise(2, trajectories, steps, seed=15)
    assert np.isfinite(power_spectrum(walks).exponent_error)
    with pytest.raises(InputError, match=f"^-relax_steps: .* at least {steps} are needed"):
        power_spectrum(walks[:, 1:])


STEPS = np.arange(8000)


@pytest.mark.parametrize(
    ("series", "window", "message"),
    [
        (np.full((2, 4000), 0.1), (), "never changes"),
        (np.where(STEPS < 200, 0.0, 1.0), (), "relax_steps: .* one part"),
        (STEPS, (1e-4, 0.3), "^-relax_steps: "),
        *((STEPS, (low, 0.7), "^-spectrum_fit_min: ") for low in (0, 1e-310, 0.5, math.nan)),
        *((STEPS, (0.01, high), "^-spectrum_fit_max: ") for high in (0.019, 0.6, math.nan)),
    ],
)
def test_series_and_windows_without_a_spectrum(series, window, message):
    with pytest.raises(InputError, match=message):
        power_spectrum(series, *window)


def test_an_exponent_is_withheld_of_a_series_shorter_than_its_memories(caplog):
    """A few memories have seen too few states for its error, as the memory's own."""
    signal = telegraph(1 / (2 * np.pi * 840), 2, 8_500, seed=17)
    short = power_spectrum(signal[:, :4100], memory=840)
    assert np.isnan([short.exponent, short.exponent_plain, short.exponent_error]).all()
    assert np.all(short.power > 0)
    assert "8200 steps (trajectories: 2) are too few" in caplog.text
    assert "take 8400" in caplog.text
    assert np.isfinite(power_spectrum(signal[:, :4200], memory=840).exponent)
    assert "withheld" in relaxation.exponent(short)
    ax = draw(relaxation.spectrum, short)
    assert np.isfinite(ax.get_lines()[-1].get_ydata()).all()  # slope -2


def test_a_spectrum_in_hertz():
    """Of steps of 5 s: its integral, the variance, stays, and so does what its corner is of."""
    found = power_spectrum(telegraph(0.05, 1, 5000, seed=3), 0.02)
    steps, hertz = (draw(relaxation.spectrum, found, step=step) for step in (None, 5.0))
    integrals = [trapezoid(*ax.get_lines()[0].get_data()[::-1]) for ax in (steps, hertz)]
    assert integrals[0] == pytest.approx(integrals[1])
    assert hertz.get_lines()[1].get_xdata()[-1] == pytest.approx(0.3 / 5)
    assert (hertz.get_xlabel(), hertz.get_ylabel()[-6:]) == ("frequency $f$ (Hz)", "(1/Hz)")


def test_warnings_of_a_window_that_reaches_too_far(caplog):
    """The flat low end is told from the memory, where it is given, or from the slope's bend."""
    power_spectrum(telegraph(1 / (2 * np.pi * 840), 2, 50_000, seed=17), memory=840)
    power_spectrum(power_law_noise(0, 2, 20_000, seed=18))
    signal, memory = telegraph(0.01, 4, 40_000, seed=19), 1 / (2 * np.pi * 0.01)
    above = power_spectrum(signal, 0.06, 0.3, memory=memory)
    assert above.exponent == pytest.approx(2, abs=0.1)
    assert not caplog.records
    assert power_spectrum(signal, 0.01, 0.3, memory=memory).exponent < 1.9
    assert ["corner" in record.message for record in caplog.records] == [True, False]
    power_spectrum(signal, 0.01, 0.3)
    power_spectrum(power_law_noise(2, 2, 20_000, seed=20), fit_max=0.45)
    keys = [record.message.split(":")[0] for record in caplog.records]
    assert keys == ["-spectrum_fit_min"] * 3 + ["-spectrum_fit_max"]
