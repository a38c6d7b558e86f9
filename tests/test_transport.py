"""Amplitudes against depth, on waves whose attenuation and delay are known."""

import math

import numpy as np
import pytest
from synthetic import complex_normal, fair, gaussian_fields

from pgran.errors import InputError
from pgran.physics import transport
from pgran.physics.estimate import Estimate

DEPTH = np.array([2.0, 4.0, 4.0, 6.0, 9.0, 12.0])
LENGTH = 5.0


def waves(rng, samples, frequencies):
    """Fields exp(-x/LENGTH) times noise that neighbouring depths share, complex Gaussian."""
    noise = complex_normal(rng, samples, frequencies, len(DEPTH) + 2)
    field = (noise[..., :-2] + noise[..., 1:-1] + noise[..., 2:]) / math.sqrt(3)
    return field * np.exp(-DEPTH / LENGTH)


def each(estimate):
    """The estimates of all frequencies, as if they were repeats."""
    return [Estimate(v, e) for v, e in zip(estimate.value, estimate.error, strict=True)]


def test_profiles_against_depth():
    amplitude = waves(np.random.default_rng(1), 60, 400)
    found = transport.log_amplitude_profile(DEPTH, amplitude)
    np.testing.assert_array_equal(found.depth, [2, 4, 6, 9, 12])
    # <ln I> of a complex Gaussian field is ln <I> less Euler's constant.
    fair(each(found.mean), -found.depth / LENGTH - np.euler_gamma / 2)
    found = transport.intensity_profile(DEPTH, amplitude)
    fair(each(found.mean), np.exp(-2 * found.depth / LENGTH))


def test_attenuation_length():
    found = transport.attenuation(DEPTH, waves(np.random.default_rng(2), 100, 400))
    fair(each(found.rate), 1 / LENGTH)
    assert found.length.value == pytest.approx(1 / found.rate.value)
    fair(each(found.length), LENGTH + LENGTH**3 * np.mean(found.rate.error**2))


def test_weights_favour_depths_that_are_certain():
    """The deepest detector, far below noise, hardly changes the line."""
    rng = np.random.default_rng(3)
    amplitude = waves(rng, 100, 200)
    wild = amplitude.copy()
    wild[..., -1] *= np.exp(10 * rng.standard_normal((100, 200)))
    error = np.mean(transport.attenuation(DEPTH[:-1], amplitude[..., :-1]).rate.error)
    assert np.mean(transport.attenuation(DEPTH, wild).rate.error) < 1.02 * error


def test_no_length_where_nothing_falls():
    flat = transport.attenuation(DEPTH, complex_normal(np.random.default_rng(4), 50, 20, 6))
    withheld = np.isnan(flat.length.value)
    assert np.count_nonzero(withheld) >= 18
    assert np.all(np.isfinite(flat.rate.value))
    np.testing.assert_array_equal(withheld, np.isnan(flat.length.error))
    np.testing.assert_array_equal(withheld, flat.rate.value <= 2 * flat.rate.error)


def test_delay_against_depth():
    """1/Gamma of overlapping modes, and the delay of a front: X/c."""
    rng, gamma, speed = np.random.default_rng(5), 0.02, 0.1
    depth, found = np.array([1.0, 3.0]), []
    for _ in range(200):
        omega, A, dA = (x for x in gaussian_fields(rng, 80, 3, gamma, gamma / 40))
        A, dA = (x.reshape(40, 2, 3).swapaxes(1, 2) for x in (A, dA))
        front = np.exp(-1j * omega[:, None] * depth / speed)
        dA = (dA - 1j * depth / speed * A) * front
        found.append(transport.delay_profile(depth, A * front, dA).mean)
    t = (np.arange(6) + 0.5) * 2 * np.pi / (6 * gamma / 40)  # those that the fields are made of
    fair(found, np.average(t, weights=np.exp(-gamma * t)) + depth / speed)


GOOD = waves(np.random.default_rng(6), 10, 3)
ONE = np.zeros(GOOD.shape, dtype=bool)
ONE[4, 1, 2] = True


def test_samples_that_are_not_finite_are_left_out_aloud(caplog):
    bad = np.where(ONE, np.nan, GOOD)
    others = np.delete(GOOD, 4, axis=0)
    for measure in (transport.log_amplitude_profile, transport.intensity_profile):
        caplog.clear()
        np.testing.assert_array_equal(
            measure(DEPTH, bad).mean.value, measure(DEPTH, others).mean.value
        )
        assert "1 of 10 samples are left out" in caplog.text
        assert "sample 4 is the first" in caplog.text
    caplog.clear()
    found = transport.delay_profile(DEPTH, GOOD, bad)
    assert "1 of 10 samples are left out" in caplog.text
    np.testing.assert_array_equal(
        found.mean.value, transport.delay_profile(DEPTH, others, others).mean.value
    )


@pytest.mark.parametrize(
    ("measure", "arguments", "message"),
    [
        (transport.log_amplitude_profile, (DEPTH[1:], GOOD), "^amplitude: shape"),
        (transport.intensity_profile, (DEPTH, GOOD[0]), "^amplitude: shape"),
        (transport.intensity_profile, (DEPTH, GOOD[:7]), "^amplitude: 7 samples .* 8 are needed"),
        (transport.intensity_profile, (DEPTH * np.nan, GOOD), "^depth: .* finite"),
        (
            transport.log_amplitude_profile,
            (DEPTH, np.where(ONE, 0, GOOD)),
            "^amplitude: that of sample 4, frequency 1, detector 2 vanishes",
        ),
        (transport.attenuation, (DEPTH[1:4], GOOD[..., 1:4]), "^depth: 2 depths"),
        (transport.delay_profile, (DEPTH, GOOD, GOOD[1:]), "^derivative: shape"),
        (transport.delay_profile, (DEPTH, 0 * GOOD, GOOD), "^amplitude: it vanishes"),
        (transport.delay_profile, (DEPTH, GOOD[0], GOOD[0]), "^amplitude: shape"),
    ],
)
def test_what_has_no_profile(measure, arguments, message):
    with pytest.raises(InputError, match=message):
        measure(*arguments)
