"""Amplitudes against depth: of waves whose attenuation and delay are known, and of ensembles."""

import itertools
import math
import re
from types import SimpleNamespace

import numpy as np
import pytest
from synthetic import complex_normal, fair, gaussian_fields

import pgran
from pgran.experiments.ensemble import transport
from pgran.experiments.ensemble.profiles import Profiles, certain
from pgran.experiments.modes import levels
from pgran.store.estimate import Estimate, mean_of

DEPTH = np.array([2.0, 4.0, 4.0, 6.0, 9.0, 12.0])
LENGTH = 5.0


def waves(seed, samples, frequencies):
    """Fields exp(-x/LENGTH) times noise that neighbouring depths share, complex Gaussian."""
    noise = complex_normal(np.random.default_rng(seed), samples, frequencies, len(DEPTH) + 2)
    field = (noise[..., :-2] + noise[..., 1:-1] + noise[..., 2:]) / math.sqrt(3)
    return field * np.exp(-DEPTH / LENGTH)


def profiles_of(amplitude, depth=DEPTH):
    """Profiles of amplitudes whose derivatives do not matter."""
    return Profiles(depth, amplitude, amplitude)


def each(estimate):
    """The estimates of all frequencies, as if they were repeats."""
    return [Estimate(v, e) for v, e in zip(estimate.value, estimate.error, strict=True)]


def test_profiles_against_depth():
    found = profiles_of(waves(1, 60, 400))
    np.testing.assert_array_equal(found.depths, [2, 4, 6, 9, 12])
    # <ln I> of a complex Gaussian field is ln <I> less Euler's constant.
    fair(each(mean_of(found.levels)), -found.depths / LENGTH - np.euler_gamma / 2)
    fair(each(mean_of(found.intensities)), np.exp(-2 * found.depths / LENGTH))


def test_attenuation_length():
    """Of typical and mean amplitudes alike; and of a line every hundredth p-value is below .01."""
    found = profiles_of(waves(2, 100, 400))
    fair(each(found.attenuation()), 1 / LENGTH)
    fair(each(found.attenuation_of_intensity()), 2 / LENGTH)
    p = found.straightness()
    assert np.quantile(p, [0.25, 0.5, 0.75]) == pytest.approx([0.25, 0.5, 0.75], abs=0.08)
    assert np.mean(p < 0.01) < 0.03


def test_lines_leave_the_rims_out_and_refuse_what_is_bent():
    bent = waves(2, 100, 50)
    bent[..., DEPTH == 12] *= 3
    assert np.median(profiles_of(bent).straightness()) < 1e-3
    inside = Profiles(DEPTH, bent, bent, (2.0, 9.0))
    np.testing.assert_array_equal(
        inside.attenuation().value, profiles_of(bent[..., :-1], DEPTH[:-1]).attenuation().value
    )
    assert np.mean(inside.straightness() < 0.05) < 0.15
    assert np.isnan(profiles_of(bent[:9]).straightness()).all()  # of too few samples
    with pytest.raises(pgran.InputError, match="0 samples are too few"):
        profiles_of(bent[:0])


def test_the_coherent_field_less_its_floor():
    """A wave in waves that are not coherent, as strong as its intensity over the samples."""
    depth, k, fall, samples = np.arange(2.0, 10.0), 1.3, 0.25, 40
    noise = complex_normal(np.random.default_rng(7), samples, 400, len(depth))
    wave = np.exp(-1j * k * depth - 0.5 * fall * depth)
    found = profiles_of(wave * (1 + noise), depth).coherent()
    for measured, truth in zip(found, (k, fall), strict=True):
        fair(each(measured), truth)
    for measured in profiles_of(noise[:, :50], depth).coherent():
        assert np.mean(np.isfinite(measured.value)) < 0.05


def test_errors_know_that_weights_and_choices_are_of_the_same_samples():
    """Where half of a wave comes back lines are bent, so that other weights make other numbers."""
    rng, depth = np.random.default_rng(11), np.arange(2.0, 12.0)
    wave = np.exp(-0.5j * depth) + 0.5 * np.exp(0.5j * depth)
    few, many = (
        profiles_of(wave + 0.5 * complex_normal(rng, *shape, 10), depth)
        for shape in ((20, 400), (4000, 9))
    )
    for measure in (
        lambda found: found.attenuation(),
        lambda found: found.attenuation_of_intensity(),
        lambda found: found.coherent()[0],
        lambda found: found.coherent()[1],
    ):
        found = measure(few)
        z = (found.value - measure(many).value.mean()) / found.error
        assert np.sqrt(np.mean(z**2)) == pytest.approx(1, abs=0.15)
        assert abs(z.mean()) < 0.15


def test_weights_favour_depths_that_are_certain():
    """The deepest detector, far below noise, hardly changes the line."""
    amplitude = waves(3, 100, 200)
    wild = amplitude.copy()
    wild[..., -1] *= np.exp(10 * np.random.default_rng(33).standard_normal((100, 200)))
    without = profiles_of(amplitude[..., :-1], DEPTH[:-1]).attenuation()
    assert np.mean(profiles_of(wild).attenuation().error) < 1.02 * np.mean(without.error)


def test_no_length_where_nothing_falls():
    rate = profiles_of(complex_normal(np.random.default_rng(4), 50, 20, 6)).attenuation()
    withheld = np.isnan(certain(rate).value)
    assert np.count_nonzero(withheld) >= 18
    assert np.all(np.isfinite(rate.value))
    np.testing.assert_array_equal(withheld, rate.value <= 2 * rate.error)


def test_delay_against_depth():
    """1/Gamma of overlapping modes, and the delay of a front, X/c, that grows with depth alone."""
    rng, gamma, speed = np.random.default_rng(5), 0.02, np.array([0.1, 0.2])
    depth, banded, growth, single = np.array([1.0, 3.0, 4.0]), [], [], []
    bands = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 1 / 3, 1 / 3, 1 / 3]])
    slow = speed[[0, 1, 1, 1]]
    for _ in range(200):
        omega, A, dA = (x for x in gaussian_fields(rng, 120, 4, gamma, gamma / 40))
        A, dA = (x.reshape(40, 3, 4).swapaxes(1, 2) for x in (A, dA))
        late = depth / slow[:, None]
        front = np.exp(-1j * omega[:, None] * late)
        profiles = Profiles(depth, A * front, (dA - 1j * late * A) * front)
        banded.append(profiles.delay(bands))
        growth.append(profiles.delay_growth(bands))
        single.append(profiles.delay())
    t = (np.arange(8) + 0.5) * 2 * np.pi / (8 * gamma / 40)  # those that the fields are made of
    rings = np.average(t, weights=np.exp(-gamma * t))
    fair(banded, rings + depth / speed[:, None])
    fair(growth, 1 / speed)
    fair(single, rings + depth / slow[:, None])


GOOD = waves(6, 10, 3)
ONE = np.zeros(GOOD.shape, dtype=bool)
ONE[4, 1, 2] = True
NAN = np.where(ONE, np.nan, GOOD)


@pytest.mark.parametrize(("amplitude", "derivative"), [(NAN, GOOD), (GOOD, NAN)])
def test_samples_that_are_not_finite_are_left_out_aloud(caplog, amplitude, derivative):
    found = Profiles(DEPTH, amplitude, derivative)
    assert "1 of 10 samples are left out" in caplog.text
    assert "sample 4 first" in caplog.text
    others = profiles_of(np.delete(GOOD, 4, axis=0))
    for name in ("levels", "intensities"):
        np.testing.assert_array_equal(getattr(found, name), getattr(others, name))
    np.testing.assert_array_equal(found.delay().value, others.delay().value)


@pytest.mark.parametrize(
    ("measure", "arguments", "message"),
    [
        ("delay", (DEPTH, GOOD[:7], GOOD[:7]), "^amplitude: 7 samples .* 8 are needed"),
        ("delay", (DEPTH * np.nan, GOOD, GOOD), "^depth: .* finite"),
        ("delay", (DEPTH, 0 * GOOD, GOOD), "^amplitude: it vanishes"),
        (
            "attenuation",
            (DEPTH, np.where(ONE, 0, GOOD), GOOD),
            "^amplitude: that of sample 4, frequency 1, detector 2 vanishes",
        ),
        ("attenuation", (DEPTH[1:4], *[GOOD[..., 1:4]] * 2), "^depth: .* there are 2"),
        ("delay_growth", (DEPTH[1:4], *[GOOD[..., 1:4]] * 2), "^depth: .* there are 2"),
    ],
)
def test_what_has_no_profile(measure, arguments, message):
    with pytest.raises(pgran.InputError, match=message):
        getattr(Profiles(*arguments), measure)()


LINE = [(i, 4) for i in range(2, 10)]


def shaken(lattice, omegas, samples=8, line=LINE, keep="curves"):
    """The first lattice, and responses of samples along a line."""
    choices = {"omegas": omegas, "detectors": line, "keep": keep}
    ensemble = pgran.ensemble("response", samples, lattice=lattice, **choices)
    return pgran.Lattice.random(**lattice), ensemble


def test_profiles_are_means_over_the_samples():
    omegas, line = np.linspace(0.3, 1.6, 14), [(4, 1), (3, 1), (2, 1), (0, 1)]
    lattice, ensemble = shaken({"shape": (6, 3), "damping": 0.1}, omegas, 10, line)
    found = pgran.transport(lattice, ensemble)
    assert found.depth.tolist() == [2, 3, 4, 6]
    size = np.abs(ensemble.displacement)
    assert found.ln_amplitude == pytest.approx(np.log(size).mean(axis=0))
    error = np.log(size).std(axis=0, ddof=1) / np.sqrt(10)
    assert found.ln_amplitude_error == pytest.approx(error)
    assert found.intensity == pytest.approx(np.mean(size**2, axis=0))


def test_above_all_modes_amplitudes_fall_as_bonds_say():
    """Far above them a ball moves as k / (m omega^2) of the one before it."""
    omegas, chain = [40.0, 50.0], {"shape": (8, 1), "damping": 0.0, "law": "constant"}
    line = pgran.transport(*shaken(chain, omegas, 8, [(6, 0), (5, 0), (4, 0)]))
    # of equal samples the line has no error; the balls' own springs correct m omega^2
    exact = [np.log((w * w - 4 * 0.25) / 0.25) for w in omegas]
    assert line.rate == pytest.approx(exact, rel=1e-3)


@pytest.mark.parametrize(
    ("bonds", "omegas"),
    [({"law": "constant"}, [0.4, 0.5]), ({"law": "uniform", "kmin": 0.1}, [0.25, 0.3, 0.35])],
)
def test_coherent_waves_run_in_the_effective_medium(bonds, omegas):
    """m omega^2 = c (2 - 2 cos q), c = k + i omega beta: of bonds in 2D <c> - var(k) / (2 <c>)."""
    lattice = {"shape": (28, 8), "damping": 0.3, "free": "y-,y+", **bonds}
    grid = [(i, j) for i in range(15, 26) for j in range(0, 8, 2)]
    first, responses = shaken(lattice, omegas, 16, grid)
    found = pgran.transport(first, responses, depths=(4, 12))
    width = 0.25 - bonds.get("kmin", 0.25)
    mean = 0.25 - width / 2 + 0.3j * found.omega
    q, plain = (
        np.arccos(1 - found.omega**2 / (2 * c)) for c in (mean - width**2 / (24 * mean), mean)
    )
    fall, error = 1 / found.scattering_length, found.scattering_length_error
    error = np.maximum(3 * error * fall**2, 1e-3 * fall)  # the wall at rest sends a little back
    assert found.wave_number == pytest.approx(
        q.real, abs=max(3e-4, 3 * found.wave_number_error.max())
    )
    assert np.all(np.abs(fall - np.abs(2 * q.imag)) < error)
    assert not width or np.all(np.abs(fall - np.abs(2 * plain.imag)) > error)


def test_lengths_are_told_where_sound_propagates():
    """Below the first mode two walls W apart make them, W/pi, whatever the damping is."""
    omegas = np.linspace(0.01, 1.0, 100)
    lattice = {"shape": (12, 9), "damping": 3e-3, "law": "uniform", "kmin": 0.0}
    first, responses = shaken(lattice, omegas)
    found, lowest = pgran.transport(first, responses), pgran.find_modes(first).omega[0]
    assert found.first_mode == pytest.approx(lowest, rel=1e-9)
    assert np.count_nonzero(omegas < lowest) > 5
    assert 1 / found.rate[0] == pytest.approx(10 / np.pi, rel=0.1)
    assert (found.depth_low, found.depth_high) == pytest.approx((13 / 7, 13 * 6 / 7))
    waves = np.zeros(100, dtype=bool)
    for (low, high), grows in zip(itertools.pairwise(found.edge), found.propagates, strict=True):
        waves |= (omegas >= low) & (omegas <= high) & grows
    for name in ("length", "intensity_length", "wave_number", "scattering_length"):
        value, error = getattr(found, name), getattr(found, f"{name}_error")
        assert np.isnan(value[~waves]).all()
        np.testing.assert_array_equal(np.isnan(value), np.isnan(error))
    known = np.isfinite(found.length)
    assert known[waves].any()
    rate, error = found.rate[known], found.rate_error[known]
    assert np.all(rate > 4 * error)
    assert found.length_error[known] == pytest.approx(1 / (rate - error) - 1 / rate)
    assert not waves[omegas < 0.2].any()
    said = " ".join(transport.summary(SimpleNamespace(transport=found, medium=first)))
    assert re.search(r"sound propagates at omega from .* no lengths .* attenuation length", said)
    with pytest.raises(pgran.InputError, match=r"all frequencies lie below the first mode, at 0\."):
        pgran.transport(*shaken(lattice, omegas[:5]))


@pytest.mark.parametrize(
    ("omegas", "ends"),
    [
        (np.linspace(0.2, 1.2, 51), np.linspace(0.2, 1.2, 11)),
        (np.linspace(0.05, 0.9, 51), None),  # from the first mode on
        ([0.5], [0.5, 0.5]),
        ([0.5, 0.52, 1.5], [0.5, 1.0, 1.5]),
    ],
)
def test_delays_are_told_by_frequency_and_in_bands(omegas, ends):
    first, responses = shaken({"shape": (12, 9)}, omegas)
    found = pgran.transport(first, responses)
    ends = np.linspace(found.first_mode, 0.9, 9) if ends is None else ends
    assert found.edge == pytest.approx(ends)
    assert found.group_delay.shape == (len(omegas), 8)
    lines = (found.depth_low <= found.depth) & (found.depth <= found.depth_high)
    for band, (low, high) in enumerate(itertools.pairwise(ends)):
        inside = (np.asarray(omegas) >= low) & (np.asarray(omegas) < high - 1e-9)
        inside |= (np.asarray(omegas) == high) & (band == len(ends) - 2)
        mean = found.group_delay[inside].mean(axis=0)
        assert found.band_delay[band] == pytest.approx(mean, rel=1e-9)
        slope = np.polyfit(found.depth[lines], mean[lines], 1)[0]
        assert found.delay_growth[band] == pytest.approx(slope, rel=1e-6, abs=1e-6)


def test_where_there_is_no_transport():
    lattice, bare = shaken({"shape": (12, 9)}, [0.5], keep="measures")
    assert transport.is_line(lattice, lattice.sites(LINE[:3]))
    assert not transport.is_line(lattice, lattice.sites(LINE[:2]))
    with pytest.raises(pgran.InputError, match="no curves"):
        pgran.transport(lattice, bare)
    with pytest.raises(pgran.InputError, match="3 samples are too few"):
        pgran.transport(*shaken({"shape": (12, 9)}, [0.5], 3))


def test_the_lowest_mode_of_what_may_be_loose():
    pair = pgran.Lattice.random((1, 2))
    assert levels.first_mode(pair) == pytest.approx(pgran.find_modes(pair).omega[0])
    loose = pgran.Network([[0, 1], [2, 3], [3, 4], [4, 2]], [1.0] * 4, [0, 1, 0, 0, 0])
    assert levels.first_mode(loose) == 0
