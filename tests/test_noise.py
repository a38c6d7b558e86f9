"""The noise of an ensemble's responses: of fields of known law, and where there is none."""

import dataclasses

import numpy as np
import pytest
from samples import assert_same
from synthetic import gaussian_fields

import pgran
from pgran.errors import InputError
from pgran.experiments.ensemble import intensity
from pgran.experiments.ensemble import statistics as noise
from pgran.experiments.ensemble.noise import NoisyCurves
from pgran.experiments.ensemble.record import Ensemble

GAMMA, SAMPLES = 0.02, 150


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
    rng = np.random.default_rng(8)
    omega, A, _ = gaussian_fields(rng, SAMPLES, 101, GAMMA, GAMMA / 5)
    omega = omega - omega[0] + 0.5
    A = A / np.sqrt(np.mean(np.abs(A) ** 2))
    return ensemble_of(omega, np.stack([A, A + np.sqrt(0.5)], axis=2))


def test_each_place_holds_the_measures_of_its_curves(gaussian):
    """What these are of Gaussian fields is in test_statistics.py."""
    windows = [(0.5, 0.7), (0.6, 0.9)]
    found = pgran.statistics(gaussian, windows)
    assert found.samples == SAMPLES
    assert np.array_equal(np.transpose([found.low, found.high]), windows)

    def same(name, place, estimate, known=...):
        for n, expected in ((name, estimate.value), (f"{name}_error", estimate.error)):
            np.testing.assert_array_equal(getattr(found, n)[place][known], expected)

    for w, d, p in np.ndindex(2, 2, 2):
        A = gaussian.displacement[:, :, d]
        curves = NoisyCurves(gaussian.omega, A, windows[w], incoherent=p == 1)
        for name in noise.MEASURED:
            same(name, (w, d, p), getattr(intensity, name)(curves))
        same("density", (w, d, p), intensity.histogram(curves, found.edge))
        known = found.shift[w] < 0.5 * np.ptp(windows[w]) - 0.01 * GAMMA
        assert np.array_equal(np.isfinite(found.correlation[w, d, p]), known)
        correlation = intensity.correlation(curves, found.shift[w][known])
        same("correlation", (w, d, p), correlation, known)
    # a coherent part of a third makes the whole field's spread of I smaller: 2 - r^2
    assert np.all(np.abs(found.coherent_part - [0, 1 / 3]) < 4 * found.coherent_part_error)
    away = found.contrast[:, 1, 0] - (2 - 1 / 9)
    assert np.all(np.abs(away) < 4 * found.contrast_error[:, 1, 0])


def test_only_good_samples_count(gaussian):
    wrong = gaussian.displacement.copy()
    wrong[[3, 50]] = np.nan
    wrong[7] = 1e6
    good = np.ones(SAMPLES, np.int8)
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
    assert "half width of the correlation unknown, spacing of maxima unknown" in lines
    assert "(Gaussian: 2)" in lines
    assert "ball (0, 0), 0.5 to 0.7: " in lines
    number = dataclasses.replace(found, detector=found.detector[:, :1])
    assert "ball 0, 0.5 to 0.7: " in "\n".join(noise.summary(number))
    assert "nan" not in lines


@pytest.mark.parametrize(
    ("windows", "said"),
    [
        ([0.5, 0.6, 0.7], "numbers given: 3"), ([], "numbers given: 0"),
        ([(0.6, 0.5)], "0.6 is not below 0.5"), ([(0.4, 0.6)], "0.4 to 0.6 is not within"),
    ],
)  # fmt: skip
def test_windows_that_are_none(gaussian, windows, said):
    with pytest.raises(InputError, match=said):
        pgran.statistics(gaussian, windows)


def test_ensembles_without_curves_or_samples(gaussian):
    bare = dataclasses.replace(gaussian, displacement=None)
    with pytest.raises(InputError, match="no curves; -ensemble_keep curves"):
        pgran.statistics(bare, [(0.5, 0.7)])
    few = ensemble_of(gaussian.omega, gaussian.displacement[:5])
    with pytest.raises(InputError, match="need 8, not 5"):
        pgran.statistics(few, [(0.5, 0.7)])


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
