"""Measures of noisy curves on fields whose laws are known, and whether their errors are right."""

import math

import numpy as np
import pytest
from scipy.stats import norm
from synthetic import fair, gaussian_fields, lorentzian, lorentzians, mean_intensity

from pgran.errors import InputError
from pgran.experiments.ensemble import intensity
from pgran.experiments.ensemble.noise import MAXIMA_SPACING, NoisyCurves

REPEATS, SAMPLES, POINTS = 120, 80, 3000
FEWER = {"correlation": 60, "half_width": 60}  # which take longest; campaigns/estimates.py
GAMMA = 0.02
SHIFTS = np.array([0.5, 2.0]) * GAMMA
EDGES = np.array([0.0, 0.3, 1.0, 2.0, 4.0])
MEASURES = {
    "mean_intensity": (mean_intensity, 1.0),
    "contrast": (intensity.contrast, intensity.GAUSSIAN_CONTRAST),
    "spread": (intensity.spread, intensity.GAUSSIAN_SPREAD),
    "half_width": (intensity.half_width, GAMMA),
    "maxima_spacing": (intensity.maxima_spacing, MAXIMA_SPACING * GAMMA),
    "correlation": (
        lambda curves: intensity.correlation(curves, SHIFTS),
        lorentzian(SHIFTS, GAMMA),
    ),
}


def beta_law(points):
    """Densities of I/<I> in EDGES, where <I> is the mean of so many independent points."""
    return np.diff(1 - (1 - EDGES / points) ** (points - 1)) / np.diff(EDGES)


def fields(seed, samples, points, step=GAMMA / 5):
    """Frequencies and Gaussian fields of some samples."""
    return gaussian_fields(np.random.default_rng(seed), samples, points, GAMMA, step)[:2]


def repeated(seed, repeats, points):
    """Frequencies and single fields, again and again."""
    rng = np.random.default_rng(seed)
    for _ in range(repeats):
        omega, A, _ = gaussian_fields(rng, 1, points, GAMMA, GAMMA / 5)
        yield NoisyCurves(omega, A[0])


@pytest.fixture(scope="module")
def ensembles():
    """Many samples in a narrow window, with a coherent part that is as strong as they are."""
    rng = np.random.default_rng(1)
    made = []
    for _ in range(REPEATS):
        omega, A, _ = gaussian_fields(rng, SAMPLES, 49, GAMMA, GAMMA / 5)
        made.append(NoisyCurves(omega, A + np.exp(30j * omega), incoherent=True))
    return made


@pytest.fixture(scope="module")
def single():
    """One sample in a wide window."""
    return list(repeated(2, REPEATS, POINTS))


def test_histograms(ensembles, single):
    """Without the coherent part n fields are n - 1 independent ones."""
    many = [intensity.histogram(curves, EDGES) for curves in ensembles[:60]]
    fair(many, beta_law(SAMPLES - 1))
    points = (POINTS - 1) / 5 / math.pi  # the integral of the correlation is pi Gamma
    fair([intensity.histogram(curves, EDGES) for curves in single[:80]], beta_law(points))


@pytest.mark.parametrize("name", MEASURES)
def test_measures_of_gaussian_fields(ensembles, single, name):
    """Of many samples and of one, whose half width takes longer curves."""
    (measure, truth), count = MEASURES[name], FEWER.get(name)
    fair([measure(curves) for curves in ensembles[:count]], truth)
    long = repeated(12, count, 5000) if name == "half_width" else single[:count]
    fair([measure(curves) for curves in long], truth)


def test_sparse_modes_are_no_gaussian_field():
    """Sums of modes of one width at an overlap of M: <I^2>/<I>^2 = 2 + 2/(pi M)."""
    rng, omega, overlap = np.random.default_rng(3), GAMMA * np.arange(9), 2.0
    made = [
        NoisyCurves(omega, lorentzians(rng, 100, omega, GAMMA, overlap), incoherent=True)
        for _ in range(100)
    ]
    fair([intensity.contrast(c) for c in made], 2 + 2 / (np.pi * overlap))


def test_overlapping_modes_have_the_correlation_of_a_gaussian_field():
    rng, omega = np.random.default_rng(4), GAMMA / 5 * np.arange(61)
    curves = NoisyCurves(omega, lorentzians(rng, 200, omega, GAMMA, 20.0))
    for name, (measure, truth) in MEASURES.items():
        if name != "mean_intensity":
            found = measure(curves)
            assert np.all(np.abs(found.value - truth) < 3 * found.error), name


def test_spacing_of_maxima_by_kac_and_rice():
    """The rate of zeros of I' where I'' < 0, for <|g(t)|^2> = exp(-t), t less its mean.

    With A = r and A' = i y, Re A'' = -r + 2 y + xi, <xi^2> = 2, <y^2> = 1/2; p(Re A' = 0) =
    1/sqrt(pi).
    """
    r, width = np.linspace(0, 7, 2801, retstep=True)
    y, weight = np.polynomial.hermite.hermgauss(120)
    mean, sigma = 2 * r[:, None] ** 2 - (y + r[:, None]) ** 2, np.sqrt(2) * r[:, None] + 1e-9
    positive = mean * norm.cdf(mean / sigma) + sigma * norm.pdf(mean / sigma)
    rate = 2 / np.pi * np.sum(np.exp(-(r**2)) * (positive @ weight)) * width
    assert 1 / rate == pytest.approx(MAXIMA_SPACING, rel=1e-6)
    assert np.pi / np.sqrt(3) == pytest.approx(1 / rate, rel=0.02)  # Schroeder's shorter formula


def test_unequal_distances_change_no_measure():
    """Averages are integrals along omega, correlations resampled: not by number of points."""
    omega, A = fields(5, 1, 20400, GAMMA / 22)
    kept = np.cumsum(np.tile([1, 1, 2, 3, 3, 2], 1700)) - 1  # steps along omega, 0 to 20399
    for measure, _ in MEASURES.values():
        even = measure(NoisyCurves(omega, A))
        uneven = measure(NoisyCurves(omega[kept], A[0, kept]))
        assert np.all(np.abs(uneven.value - even.value) < 0.3 * even.error)  # of a maximum: .27


def test_windows_and_weak_frequencies():
    """<I> may fall along omega, for many samples; a window keeps what lies in it."""
    omega, A = fields(6, 100, 60)
    steep = NoisyCurves(omega, A * np.exp(-40 * omega))
    for name in set(MEASURES) - {"mean_intensity", "maxima_spacing"}:
        measure = MEASURES[name][0]
        np.testing.assert_allclose(measure(steep).value, measure(NoisyCurves(omega, A)).value)
    half = NoisyCurves(omega, A, (omega[10], omega[40]))
    cut = NoisyCurves(omega[10:41], A[:, 10:41])
    assert intensity.contrast(half).value == intensity.contrast(cut).value


FEWEST = {
    "contrast": ("<I^2>/<I>^2", 0.4),
    "spread": ("spread in dB", 0.3),
    "half_width": ("half width", 0.5),
}


@pytest.mark.parametrize("name", FEWEST)
def test_measures_are_withheld_below_the_samples_that_make_their_errors_right(name):
    """From there on they miss the truth by their errors: no bias, and no surprises."""
    rng, (measure, truth), (said, bias) = np.random.default_rng(10), MEASURES[name], FEWEST[name]
    needed, misses = intensity.SAMPLES_FOR[said], []
    for _ in range(60):
        omega, A, _ = gaussian_fields(rng, needed, 51, GAMMA, GAMMA / 5)
        found = measure(NoisyCurves(omega, A))
        misses.append((found.value - truth) / found.error)
    assert abs(np.mean(misses)) < bias + 2 / math.sqrt(60)
    assert np.std(misses) < 1.3 + 2 / math.sqrt(120)
    with pytest.raises(InputError, match=f"{needed - 1} samples are too few .* {needed} are"):
        measure(NoisyCurves(omega, A[:-1]))


def test_a_bin_that_few_samples_reach_has_no_error():
    omega, A = fields(7, 20, 30)
    found = intensity.histogram(NoisyCurves(omega, A), [0, 1, 50, 60])
    assert np.all(found.error[:2] > 0)
    assert np.isnan(found.error[2])
    assert found.value[2] == 0


def test_what_is_not_finite_is_left_out_aloud(caplog):
    omega, A = fields(8, 12, 600)
    A[3, 7] = np.nan
    assert NoisyCurves(omega, A).samples == 11
    assert "1 of 12 samples are left out" in caplog.text
    assert "sample 3 first" in caplog.text
    caplog.clear()
    assert len(NoisyCurves(omega, A[3]).omega) == 599
    assert "1 of 600 points are left out" in caplog.text
    caplog.clear()
    assert NoisyCurves(omega, A, (omega[8], omega[-1])).samples == 12
    assert not caplog.text


OMEGA, FIELDS = fields(9, 10, 600, GAMMA / 4)
SMOOTH = np.exp((2j - 1) * OMEGA)  # without maxima
MANY = fields(9, 80, 600, GAMMA / 4)[1]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((OMEGA, FIELDS, (1.0001, 1.0002)), "^window: .* holds 0"),
        ((OMEGA, FIELDS[:7]), "^amplitude: means .* need 8, not 7, or one curve at a time"),
        ((OMEGA, FIELDS[0], None, True), "^amplitude: means over samples need 8, not 1$"),
        ((OMEGA, np.where(np.arange(10)[:, None] < 4, np.nan, FIELDS)), "^amplitude: .* not 6"),
        ((OMEGA, 0 * FIELDS), "^amplitude: it vanishes"),
        ((OMEGA, 1e-200 * FIELDS), "^amplitude: it vanishes"),
        ((OMEGA, np.where(OMEGA < 1, 0, FIELDS)), "^amplitude: it vanishes"),
    ],
)
def test_curves_that_cannot_be_measured(arguments, message):
    with pytest.raises(InputError, match=message):
        NoisyCurves(*arguments)


@pytest.mark.parametrize(
    ("measure", "arguments", "message"),
    [
        (mean_intensity, (OMEGA, FIELDS[0], (0.5, 0.9)), "half widths .* 40 are needed"),
        (mean_intensity, (OMEGA, SMOOTH), "^window: .* maxima of .* 10 are needed"),
        (intensity.maxima_spacing, (OMEGA[:5], FIELDS[:, :5]), "^window: .* maxima"),
        (intensity.maxima_spacing, (OMEGA[::5], FIELDS[:, ::5]), "^omega: .* points to a maximum"),
        (intensity.half_width, (OMEGA, FIELDS[0]), "^window: .* half widths .* 800 are needed"),
        (intensity.half_width, (OMEGA[::5], MANY[:, ::5]), "^omega: .* not resolved"),
        (intensity.half_width, (OMEGA[:6], MANY[:, :6]), "^window: .* does not fall"),
        (intensity.half_width, (OMEGA, np.tile(SMOOTH, (80, 1))), "^amplitude: .* the same"),
        (
            intensity.spread,
            (OMEGA, MANY * (np.arange(600) > 0) ** np.eye(80)[0][:, None]),
            "^amplitude: one vanishes",
        ),
    ],
)
def test_measures_that_there_are_not(measure, arguments, message):
    curves = NoisyCurves(*arguments)
    with pytest.raises(InputError, match=message):
        measure(curves)
