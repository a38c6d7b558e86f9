"""The noise of an ensemble's responses: fields of known law, honest errors, and what is none."""

import dataclasses
import math

import numpy as np
import pytest
from samples import assert_same
from scipy.stats import norm
from synthetic import fair, gaussian_fields, lorentzian, lorentzians, mean_intensity

import pgran
from pgran.experiments.ensemble import statistics as noise
from pgran.experiments.ensemble.record import Ensemble
from pgran.experiments.ensemble.statistics import NoisyCurves

REPEATS, SAMPLES = 120, 80
FEWER = {"correlation": 60, "half_width": 60}  # which take longest; campaigns/estimates.py
GAMMA = 0.02
SHIFTS = np.array([0.5, 2.0]) * GAMMA
EDGES = np.array([0.0, 0.3, 1.0, 2.0, 4.0])
MEASURES = {
    "mean_intensity": (mean_intensity, 1.0),
    "contrast": (noise.contrast, noise.GAUSSIAN_CONTRAST),
    "spread": (noise.spread, noise.GAUSSIAN_SPREAD),
    "half_width": (noise.half_width, GAMMA),
    "maxima_spacing": (noise.maxima_spacing, noise.MAXIMA_SPACING * GAMMA),
    "correlation": (
        lambda curves: noise.correlation(curves, SHIFTS), lorentzian(SHIFTS, GAMMA)
    ),
    # of n independent points, here one less without the coherent part
    "histogram": (
        lambda curves: noise.histogram(curves, EDGES),
        np.diff(1 - (1 - EDGES / (SAMPLES - 1)) ** (SAMPLES - 2)) / np.diff(EDGES),
    ),
}  # fmt: skip


def fields(seed, samples, points, step=GAMMA / 5):
    """Frequencies and Gaussian fields of some samples."""
    return gaussian_fields(np.random.default_rng(seed), samples, points, GAMMA, step)[:2]


@pytest.fixture(scope="module")
def ensembles():
    """Many samples in a narrow window, with a coherent part that is as strong as they are."""
    rng, made = np.random.default_rng(1), []
    for _ in range(REPEATS):
        omega, A, _ = gaussian_fields(rng, SAMPLES, 49, GAMMA, GAMMA / 5)
        made.append(NoisyCurves(omega, A + np.exp(30j * omega), incoherent=True))
    return made


@pytest.mark.parametrize("name", MEASURES)
def test_measures_of_gaussian_fields(ensembles, name):
    measure, truth = MEASURES[name]
    fair([measure(curves) for curves in ensembles[: FEWER.get(name)]], truth)


def test_sparse_modes_are_no_gaussian_field():
    """Sums of modes of one width at an overlap of M: <I^2>/<I>^2 = 2 + 2/(pi M)."""
    rng, omega, overlap = np.random.default_rng(3), GAMMA * np.arange(9), 2.0
    made = [
        NoisyCurves(omega, lorentzians(rng, 100, omega, GAMMA, overlap), incoherent=True)
        for _ in range(100)
    ]
    fair([noise.contrast(c) for c in made], 2 + 2 / (np.pi * overlap))


def test_overlapping_modes_have_the_correlation_of_a_gaussian_field():
    rng, omega = np.random.default_rng(4), GAMMA / 5 * np.arange(61)
    curves = NoisyCurves(omega, lorentzians(rng, 200, omega, GAMMA, 20.0))
    for name in MEASURES.keys() - {"mean_intensity", "histogram"}:
        measure, truth = MEASURES[name]
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
    assert 1 / rate == pytest.approx(noise.MAXIMA_SPACING, rel=1e-6)
    assert np.pi / np.sqrt(3) == pytest.approx(1 / rate, rel=0.02)  # Schroeder's shorter formula


def test_unequal_distances_change_no_measure():
    """Averages are integrals along omega, correlations resampled: not by number of points."""
    omega, A = fields(5, 100, 2400, GAMMA / 40)
    kept = np.cumsum(np.tile([1, 1, 2, 3, 3, 2], 200)) - 1  # steps along omega, 0 to 2399
    for measure, _ in MEASURES.values():
        even, uneven = measure(NoisyCurves(omega, A)), measure(NoisyCurves(omega[kept], A[:, kept]))
        assert np.all(np.abs(uneven.value - even.value) < 0.3 * even.error)


def test_windows_and_weak_frequencies():
    """<I> may fall along omega; a window keeps what lies in it."""
    omega, A = fields(6, 100, 60)
    steep = NoisyCurves(omega, A * np.exp(-40 * omega))
    for name in MEASURES.keys() - {"mean_intensity", "maxima_spacing", "histogram"}:
        measure = MEASURES[name][0]
        np.testing.assert_allclose(measure(steep).value, measure(NoisyCurves(omega, A)).value)
    half = NoisyCurves(omega, A, (omega[10], omega[40]))
    cut = NoisyCurves(omega[10:41], A[:, 10:41])
    assert noise.contrast(half).value == noise.contrast(cut).value


FEWEST = {
    "contrast": ("<I^2>/<I>^2", 0.4),
    "spread": ("spread in dB", 0.3),
    "half_width": ("half width", 0.5),
}


@pytest.mark.parametrize("name", FEWEST)
def test_measures_are_withheld_below_the_samples_that_make_their_errors_right(name):
    """From there on they miss the truth by their errors: no bias, and no surprises."""
    rng, (measure, truth), (said, bias) = np.random.default_rng(10), MEASURES[name], FEWEST[name]
    needed, misses = noise.SAMPLES_FOR[said], []
    for _ in range(60):
        omega, A, _ = gaussian_fields(rng, needed, 51, GAMMA, GAMMA / 5)
        found = measure(NoisyCurves(omega, A))
        misses.append((found.value - truth) / found.error)
    assert abs(np.mean(misses)) < bias + 2 / math.sqrt(60)
    assert np.std(misses) < 1.3 + 2 / math.sqrt(120)
    with pytest.raises(pgran.InputError, match=f"{needed - 1} samples are too few .* {needed} are"):
        measure(NoisyCurves(omega, A[:-1]))


def test_a_bin_that_few_samples_reach_has_no_error():
    found = noise.histogram(NoisyCurves(*fields(7, 20, 30)), [0, 1, 50, 60])
    assert np.all(found.error[:2] > 0)
    assert np.isnan(found.error[2])
    assert found.value[2] == 0


def test_what_is_not_finite_is_left_out_aloud(caplog):
    omega, A = fields(8, 12, 600)
    A[3, 7] = np.nan
    assert NoisyCurves(omega, A, (omega[8], omega[-1])).samples == 12
    assert not caplog.text
    assert NoisyCurves(omega, A).samples == 11
    assert "1 of 12 samples are left out" in caplog.text
    assert "sample 3 first" in caplog.text


OMEGA, FIELDS = fields(9, 80, 600, GAMMA / 4)
TEN = FIELDS[:10]
SMOOTH = np.tile(np.exp((2j - 1) * OMEGA), (80, 1))  # without maxima
ONE_ZERO = FIELDS * (np.arange(600) > 0) ** np.eye(80)[0][:, None]


@pytest.mark.parametrize(
    ("measure", "arguments", "message"),
    [
        (None, (OMEGA, TEN, (1.0001, 1.0002)), "^window: .* holds 0"),
        (None, (OMEGA, TEN[:7]), "^amplitude: means .* need 8, not 7"),
        (None, (OMEGA, np.where(np.arange(10)[:, None] < 4, np.nan, TEN)), "^amplitude: .* not 6"),
        (None, (OMEGA, 0 * TEN), "^amplitude: it vanishes"),
        (None, (OMEGA, 1e-200 * TEN), "^amplitude: it vanishes"),
        (None, (OMEGA, np.where(OMEGA < 1, 0, TEN)), "^amplitude: it vanishes"),
        (noise.maxima_spacing, (OMEGA, SMOOTH), "^window: .* maxima of .* 10 are needed"),
        (noise.maxima_spacing, (OMEGA[:5], TEN[:, :5]), "^window: .* maxima"),
        (noise.maxima_spacing, (OMEGA[::5], TEN[:, ::5]), "^omega: .* points to a maximum"),
        (noise.half_width, (OMEGA[::5], FIELDS[:, ::5]), "^omega: .* not resolved"),
        (noise.half_width, (OMEGA[:6], FIELDS[:, :6]), "^window: .* does not fall"),
        (noise.half_width, (OMEGA, SMOOTH), "^amplitude: .* the same"),
        (noise.spread, (OMEGA, ONE_ZERO), "^amplitude: one vanishes"),
    ],
)  # fmt: skip
def test_what_cannot_be_measured(measure, arguments, message):
    with pytest.raises(pgran.InputError, match=message):
        (measure or (lambda curves: None))(NoisyCurves(*arguments))


def ensemble_of(omega, A, good=None):
    """An ensemble of given curves, shape (samples, nw, nd)."""
    good = np.ones(len(A), np.int8) if good is None else good
    return Ensemble(
        of="response", solve_seconds=0.0, left_out=int(np.sum(good == 0)), good=good,
        seed=np.arange(len(A)), omega=omega, displacement=A,
        detector=np.array([[n, 0] for n in range(A.shape[2])]),
    )  # fmt: skip


@pytest.fixture(scope="module")
def gaussian():
    """Fields of which a third of the intensity of the second detector is coherent."""
    omega, A = fields(8, 150, 101)
    omega = omega - omega[0] + 0.5
    A = A / np.sqrt(np.mean(np.abs(A) ** 2))
    return ensemble_of(omega, np.stack([A, A + np.sqrt(0.5)], axis=2))


def test_each_place_holds_the_measures_of_its_curves(gaussian):
    windows = [(0.5, 0.7), (0.6, 0.9)]
    found = pgran.statistics(gaussian, windows)
    assert found.samples == len(gaussian.seed)
    assert np.array_equal(np.transpose([found.low, found.high]), windows)

    def same(name, place, estimate, known=...):
        for n, expected in ((name, estimate.value), (f"{name}_error", estimate.error)):
            np.testing.assert_array_equal(getattr(found, n)[place][known], expected)

    for w, d, p in np.ndindex(2, 2, 2):
        A = gaussian.displacement[:, :, d]
        curves = NoisyCurves(gaussian.omega, A, windows[w], incoherent=p == 1)
        for name in noise.NUMBERS:
            same(name, (w, d, p), getattr(noise, name)(curves))
        same("density", (w, d, p), noise.histogram(curves, found.edge))
        known = found.shift[w] < 0.5 * np.ptp(windows[w]) - 0.01 * GAMMA
        assert np.array_equal(np.isfinite(found.correlation[w, d, p]), known)
        correlation = noise.correlation(curves, found.shift[w][known])
        same("correlation", (w, d, p), correlation, known)
    # a coherent part of a third makes the whole field's spread of I smaller: 2 - r^2
    assert np.all(np.abs(found.coherent_part - [0, 1 / 3]) < 4 * found.coherent_part_error)
    away = found.contrast[:, 1, 0] - (2 - 1 / 9)
    assert np.all(np.abs(away) < 4 * found.contrast_error[:, 1, 0])


def test_only_good_samples_count(gaussian):
    wrong, good = gaussian.displacement.copy(), np.ones(150, np.int8)
    wrong[[3, 50]] = np.nan
    wrong[7] = 1e6
    good[[3, 7, 50]] = 0
    kept, window = gaussian.displacement[good > 0], [(0.5, 0.7)]
    found = pgran.statistics(ensemble_of(gaussian.omega, wrong, good), window)
    assert_same(found, pgran.statistics(ensemble_of(gaussian.omega, kept), window))


def test_what_cannot_be_measured_is_nan_aloud(gaussian, caplog):
    """In a narrow window a correlation does not fall, and points too far apart miss maxima."""
    found = pgran.statistics(gaussian, [(0.5, 0.512)])
    assert np.isnan(found.half_width).all()
    assert np.isfinite(found.contrast).all()
    assert "no half width in 0.5 to 0.512, detector 0" in caplog.text
    caplog.clear()
    coarse = ensemble_of(gaussian.omega[::5], gaussian.displacement[:, ::5])
    found = pgran.statistics(coarse, [(0.5, 0.7)])
    assert np.isnan(found.maxima_spacing).all()
    assert "no maxima spacing" in caplog.text
    lines = "\n".join(noise.summary(found))
    for said in ("half width of the correlation unknown, spacing of maxima unknown",
                 "(Gaussian: 2)", "ball (0, 0), 0.5 to 0.7: "):  # fmt: skip
        assert said in lines
    number = dataclasses.replace(found, detector=found.detector[:, :1])
    assert "ball 0, 0.5 to 0.7: " in "\n".join(noise.summary(number))
    assert "nan" not in lines


@pytest.mark.parametrize(
    ("changes", "windows", "said"),
    [
        ({}, [0.5, 0.6, 0.7], "numbers given: 3"),
        ({}, [], "numbers given: 0"),
        ({}, [(0.6, 0.5)], "0.6 is not below 0.5"),
        ({}, [(0.4, 0.6)], "0.4 to 0.6 is not within"),
        ({"displacement": None}, [(0.5, 0.7)], "no curves; -ensemble_keep curves"),
        ({"good": (np.arange(150) < 5).astype(np.int8)}, [(0.5, 0.7)], "need 8, not 5"),
    ],
)
def test_what_is_refused(gaussian, changes, windows, said):
    with pytest.raises(pgran.InputError, match=said):
        pgran.statistics(dataclasses.replace(gaussian, **changes), windows)


def test_a_run_stores_what_python_measures(call, shared_path, world):
    """On any number of ranks, and from the file too."""
    words = "-scene ensemble -lattice_shape 6,5 -detectors 2,3 -ensemble_samples 12"
    words += " -ensemble_keep curves -sweep_min .4 -sweep_max .8 -sweep_points 201"
    words += " -statistics_windows .4,.6,.5,.8 -output_file b.h5 -output_progress none"
    world.Barrier()
    if world.rank == 0:
        (shared_path / "b.opts").write_text(words.replace(" -", "\n-"))
    world.Barrier()
    done = call("run", "b.opts", "-statistics_windows", ".5,.501")
    assert (done.returncode, (shared_path / "b.h5").exists()) == (0, True)
    assert "no statistics: window: it needs 3 amplitudes" in done.stdout + done.stderr
    done = call("run", "b.opts", "-output_overwrite")
    assert done.returncode == 0, done.stderr
    assert "<I^2>/<I>^2" in done.stdout + done.stderr
    stored = pgran.load(shared_path / "b.h5")
    windows = [(0.4, 0.6), (0.5, 0.8)]
    assert_same(pgran.statistics(stored.ensemble, windows), stored.statistics)
    assert_same(stored.ensemble, pgran.ensemble(
        "response", 12, lattice={"shape": (6, 5)}, keep="curves",
        omegas=np.linspace(0.4, 0.8, 201), detectors=(2, 3),
    ))  # fmt: skip
