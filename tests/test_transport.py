"""Amplitudes against depth, on waves whose attenuation and delay are known."""

import itertools
import math
from types import SimpleNamespace

import numpy as np
import pytest
from synthetic import complex_normal, fair, gaussian_fields

import pgran
from pgran.errors import InputError
from pgran.experiments.ensemble import localization as transport
from pgran.experiments.ensemble import transport as scene
from pgran.experiments.modes import levels
from pgran.store.estimate import Estimate

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
    """1/Gamma of overlapping modes, and the delay of a front, X/c, that grows with depth alone."""
    rng, gamma, speed = np.random.default_rng(5), 0.02, np.array([0.1, 0.2])
    depth, found, growth, each_frequency = np.array([1.0, 3.0, 4.0]), [], [], []
    bands = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 1 / 3, 1 / 3, 1 / 3]])
    slow = speed[[0, 1, 1, 1]]
    for _ in range(200):
        omega, A, dA = (x for x in gaussian_fields(rng, 120, 4, gamma, gamma / 40))
        A, dA = (x.reshape(40, 3, 4).swapaxes(1, 2) for x in (A, dA))
        late = depth / slow[:, None]
        front = np.exp(-1j * omega[:, None] * late)
        dA = (dA - 1j * late * A) * front
        arguments = depth, A * front, dA
        found.append(transport.delay_profile(*arguments, bands).mean)
        growth.append(transport.delay_per_depth(*arguments, bands))
        each_frequency.append(transport.delay_profile(*arguments).mean)
    t = (np.arange(8) + 0.5) * 2 * np.pi / (8 * gamma / 40)  # those that the fields are made of
    rings = np.average(t, weights=np.exp(-gamma * t))
    fair(found, rings + depth / speed[:, None])
    fair(growth, 1 / speed)
    fair(each_frequency, rings + depth / slow[:, None])


def shaken(lattice, omegas, samples):
    """Responses of samples at all depths."""
    line = [(i, 4) for i in range(2, 10)]
    given = {"lattice": lattice, "omegas": omegas, "detectors": line, "keep": "curves"}
    return pgran.Lattice.random(**lattice), pgran.ensemble("response", samples, **given)


def test_lengths_are_withheld_below_the_first_mode():
    """There two walls W apart make them, W/pi, whatever the damping is."""
    omegas = np.linspace(0.01, 1.0, 100)
    for damping in (1e-6, 3e-3):
        lattice = {"shape": (12, 9), "damping": damping, "law": "uniform", "kmin": 0.2}
        first, responses = shaken(lattice, omegas, 8)
        found, lowest = pgran.transport(first, responses), pgran.find_modes(first).omega[0]
        assert found.first_mode == pytest.approx(lowest, rel=1e-9)
        below = omegas < lowest
        assert np.count_nonzero(below) > 5
        assert 1 / found.rate[0] == pytest.approx(10 / np.pi, rel=0.1)
        assert np.isnan(found.length[below]).all()
        assert np.isnan(found.length_error[below]).all()
        assert np.isfinite(found.length[~below]).any()
    first, responses = shaken(lattice, omegas[:5], 8)
    with pytest.raises(InputError, match=r"all frequencies lie below the first mode, at 0\.1"):
        pgran.transport(first, responses)


@pytest.mark.parametrize(
    ("omegas", "ends"),
    [
        (np.linspace(0.2, 1.2, 51), [0.2, 0.3, 1.0, 1.2]),
        (np.linspace(0.05, 0.9, 51), ["first", 0.3, 0.9]),
        ([0.5], [0.5, 0.5]),
    ],
)
def test_delays_are_told_by_frequency_and_in_bands(omegas, ends):
    first, responses = shaken({"shape": (12, 9)}, omegas, 8)
    found = pgran.transport(first, responses)
    ends = [found.first_mode if end == "first" else end for end in ends]
    assert found.edge == pytest.approx(ends)
    assert found.group_delay.shape == (len(omegas), 8)
    for band, (low, high) in enumerate(itertools.pairwise(ends)):
        inside = (np.asarray(omegas) >= low) & (np.asarray(omegas) < high)
        inside |= (np.asarray(omegas) == high) & (band == len(ends) - 2)
        mean = found.group_delay[inside].mean(axis=0)
        assert found.band_delay[band] == pytest.approx(mean, rel=1e-9)
        slope = np.polyfit(found.depth, mean, 1)[0]
        assert found.delay_growth[band] == pytest.approx(slope, rel=1e-6, abs=1e-6)
    result = SimpleNamespace(transport=found, medium=first)
    lines = list(scene.summary(result))
    assert len(lines) == len(ends)
    assert "the group delay grows by" in lines[-1]


def test_the_lowest_mode_of_what_may_be_loose():
    assert levels.first_mode(pgran.Lattice.random((1, 2))) == pytest.approx(
        pgran.find_modes(pgran.Lattice.random((1, 2))).omega[0]
    )
    loose = pgran.Network([[0, 1], [2, 3], [3, 4], [4, 2]], [1.0] * 4, [0, 1, 0, 0, 0])
    assert levels.first_mode(loose) == 0


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
        (transport.delay_per_depth, (DEPTH[1:4], GOOD[..., 1:4], GOOD[..., 1:4]), "2 depths"),
        (transport.delay_profile, (DEPTH, GOOD, GOOD[1:]), "^derivative: shape"),
        (transport.delay_profile, (DEPTH, 0 * GOOD, GOOD), "^amplitude: it vanishes"),
        (transport.delay_profile, (DEPTH, GOOD[0], GOOD[0]), "^amplitude: shape"),
    ],
)
def test_what_has_no_profile(measure, arguments, message):
    with pytest.raises(InputError, match=message):
        measure(*arguments)
