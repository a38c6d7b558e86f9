"""Many samples: each as it comes out alone, what they have in common, and what is refused."""

import dataclasses
import re
import time

import numpy as np
import pytest
from mpi4py import MPI
from samples import assert_same, run_scene
from test_journal import stopped_again_and_again

import pgran
from pgran.command.forecast import forecast
from pgran.command.resolve import SCENES, resolve
from pgran.experiments.ensemble import scene
from pgran.experiments.ensemble.sampling import over_samples
from pgran.experiments.ensemble.scene import KEPT
from pgran.experiments.relaxation.fluctuations import Series, mean_order, power_spectrum
from pgran.medium.base import record_of
from pgran.medium.crystals import triangular
from pgran.medium.sample import make_lattice
from pgran.run.options import read_words
from pgran.store.record import Result

SEEDS = range(1993, 1998)
LATTICE = {"shape": (5, 4)}
OMEGAS = np.linspace(0.3, 0.9, 25)
RELAXATION = {"omega": 0.5, "detectors": (2, 2), "steps": 2100, "law": pgran.BondLaw("uniform")}


def read_off(record, **names):
    """Numbers of a record by their names in an ensemble."""
    return {name: getattr(record, own) for name, own in names.items()}


def swept(lattice, _, **given):
    found = pgran.sweep(lattice, **given, resolve=0)
    names = {"sample_delay": "delay", "slope": "phase_slope", "velocity": "phase_velocity"}
    return read_off(found, displacement="displacement", **names)


def moved(lattice, _):
    found = pgran.find_modes(lattice)
    counts = {"modes": len(found.omega), "above": np.count_nonzero(found.omega > lattice.omega_mx)}
    return counts | read_off(found, mode_omega="omega", participation="participation")


def relaxed(lattice, number, **given):
    """With changes of its own: in the end the bonds are what these have made them."""
    walk = pgran.relax(lattice, **given, seed=1 + number)
    spectrum = power_spectrum(walk.amplitude[:, :, 0], memory=lattice.bonds)
    kbar = mean_order(Series(np.abs(walk.displacement[:, :, 0]), lattice.bonds))
    exponent = read_off(spectrum, exponent="exponent", exponent_error="exponent_error")
    return exponent | {"order": kbar.value}


def pulsed(lattice, _, **given):
    found = pgran.pulse(lattice, **given)
    return read_off(found, arrival="arrival", centre="centre", decay="decay")


def sensed(lattice, _, **given):
    weights = pgran.sensitivity(lattice, **given).log_amplitude[:, 0] ** 2
    return {"effective_bonds": [np.mean([w.sum() ** 2 / (w**2).sum() for w in weights])]}


# Of each kind: its options, the keywords in Python, and the numbers of one sample by its function.
KINDS = {
    "response": (
        "-detectors 2,2,4,0 -sweep_min .3 -sweep_max .9 -sweep_points 25",
        {"omegas": OMEGAS, "detectors": (2, 2, 4, 0)},
        swept,
    ),
    "modes": ("", {}, moved),
    "relaxation": ("-detectors 2,2 -relax_steps 2100 -relax_omega .5", RELAXATION, relaxed),
    "pulse": (
        "-detectors 2,2 -pulse_width 5 -pulse_time 150 -pulse_points 200",
        {"detectors": (2, 2), "width": 5.0, "time": 150.0, "points": 200},
        pulsed,
    ),
    "sensitivity": (
        "-detectors 2,2 -sweep_omega .4,.5",
        {"omegas": [0.4, 0.5], "detectors": (2, 2)},
        sensed,
    ),
}
KEEP = {of: "curves" if of in KEPT else "measures" for of in KINDS}


def chosen(of, text=""):
    """The options of five samples."""
    words = f"-scene ensemble -ensemble_of {of} -ensemble_samples 5 -ensemble_keep {KEEP[of]}"
    words += f" -lattice_shape 5,4 -output_progress none {text}"
    return resolve(read_words(words.split()), "a.h5")


def ran(of, text, world, journal=None):
    """The records of five samples, on every rank."""
    return world.bcast(run_scene(chosen(of, f"{KINDS[of][0]} {text}"), world, journal))


def lattice_of(seed):
    return pgran.Lattice.random(seed=seed, **LATTICE)


def told(*records):
    """The summary of a run, line by line."""
    return list(SCENES["ensemble"].summary(Result(records)))


@pytest.mark.parametrize("of", KINDS)
def test_each_sample_is_what_it_is_alone(world, of):
    """Exactly; and by the command as in Python, on any number of ranks."""
    lattice, found = ran(of, "", world)
    _, given, alone = KINDS[of]
    assert (found.of, found.left_out, found.failures) == (of, 0, 0)
    assert np.array_equal(found.seed, SEEDS)
    assert np.array_equal(lattice.stiffness[0], lattice_of(SEEDS[0]).stiffness[0])
    for n, seed in enumerate(SEEDS):
        for name, value in alone(lattice_of(seed), n, **given).items():
            rounding = 1e-13 if name == "effective_bonds" else 0
            np.testing.assert_allclose(getattr(found, name)[n], value, rounding, err_msg=name)
    if world.size > 1:
        assert_same(found, ran(of, "", MPI.COMM_SELF)[1])
    for lattice in (LATTICE, lattice_of):
        python = pgran.ensemble(of, 5, lattice=lattice, keep=KEEP[of], **given)
        assert_same(python, found)


def test_bands_and_means_are_those_of_the_curves(world):
    _, found = ran("response", "", world)
    A = found.displacement
    np.testing.assert_allclose(found.ln_amplitude, over_samples(np.log(np.abs(A))), rtol=1e-12)
    assert np.array_equal(found.delay, over_samples(found.sample_delay), equal_nan=True)
    assert np.array_equal(found.delay_samples, np.isfinite(found.sample_delay).sum(axis=0))
    assert found.statistic.tolist() == ["mean", "error", "median", "low", "high"]
    np.testing.assert_allclose(found.coherent, A.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(found.intensity, np.mean(abs(A) ** 2, axis=0), rtol=1e-12)
    assert np.array_equal(found.omega, OMEGAS)
    measures = ran("response", "-ensemble_keep measures", world)[1]
    assert_same(measures, dataclasses.replace(found, displacement=None, sample_delay=None))


def test_what_is_not_known_of_a_sample_is_left_out_at_that_place():
    """Against numpy, which leaves out NaN; where less than two are left there is nothing."""
    rng = np.random.default_rng(3)
    curves = rng.normal(size=(9, 40))
    curves[rng.random(curves.shape) < 0.3] = np.nan
    curves[2, 5] = np.inf
    curves[1:, 7] = np.nan
    known = np.where(np.isfinite(curves), curves, np.nan)
    known[:, 7] = np.nan
    with pytest.warns(RuntimeWarning):
        expected = [
            np.nanmean(known, axis=0),
            np.nanstd(known, axis=0, ddof=1) / np.sqrt(np.isfinite(known).sum(axis=0)),
            *np.nanpercentile(known, [50, 10, 90], axis=0),
        ]
    np.testing.assert_allclose(over_samples(curves), expected, rtol=1e-12)
    assert np.isnan(over_samples(curves[:1])).all()
    assert over_samples(curves[:0]).shape == (5, 40)


def test_measures_in_words(world):
    """How many are not certain, as none is through 25 points; at several balls in one line."""
    medium, found = ran("response", "", world)
    unknown = np.isnan(found.velocity).sum(axis=0)
    assert unknown.any()
    said = "\n".join(told(medium, found))
    for count in unknown[unknown > 0]:
        assert re.search(f"not certain in (up to )?{count} sample", said)
    good = np.flatnonzero(found.good)
    velocity = np.full((len(SEEDS), 3), np.nan)
    velocity[good, 1] = 1 + np.arange(len(good))
    velocity[good[0], 2] = 1.0
    changed = {"velocity": velocity, "detector": np.array([[2, 2], [4, 0], [1, 1]])}
    lines = told(medium, dataclasses.replace(found, **changed))
    one, several = (line for line in lines if "phase velocity" in line)
    assert one.startswith("ball (4, 0): phase velocity ")
    assert "unknown" not in one
    assert several == (
        f"phase velocity unknown at 2 balls; not certain in up to {len(good)} samples"
    )
    # of networks a ball has one number, and distances are in the unit of the positions
    changed = {"velocity": np.ones((len(SEEDS), 1)), "detector": np.array([[11]])}
    changed["good"] = np.ones(len(SEEDS), np.int8)
    lines = told(record_of(triangular((3, 3))), dataclasses.replace(found, **changed))
    assert "ball 11: phase velocity 1 +- 0 lengths x omega_mx, spread 0" in lines


def test_a_sample_that_misses_its_accuracy_is_left_out(world):
    """Driven without damping at a mode of its own, to the last bit."""
    omega = pgran.find_modes(lattice_of(1995)).omega[3]
    asked = {"omegas": [omega], "detectors": (2, 2), "error_tolerance": 1e-10}
    undamped = LATTICE | {"damping": 0.0}
    found = pgran.ensemble("response", 5, lattice=undamped, keep="curves", **asked)
    assert found.good.tolist() == [1, 1, 0, 1, 1]
    assert found.left_out == found.failures == 1
    others = found.displacement[found.good > 0]
    np.testing.assert_allclose(found.coherent, others.mean(axis=0), rtol=1e-14)
    np.testing.assert_allclose(found.ln_amplitude[0], np.log(np.abs(others)).mean(axis=0))


@pytest.mark.parametrize("failing", [{1994}, set(SEEDS)])
def test_a_sample_that_cannot_be_computed_is_left_out_aloud(world, monkeypatch, caplog, failing):
    def broken(options, group):
        if options.bonds_seed in failing:
            raise pgran.PgranError("it is broken")
        return make_lattice(options, group)

    monkeypatch.setattr(scene, "make_lattice", broken)
    medium, found = ran("response", "", world)
    assert set(found.seed[found.good == 0]) == failing
    assert np.isnan(found.displacement[found.good == 0]).all()
    assert np.isnan(found.coherent).all() == (failing == set(SEEDS))
    assert sum(world.allgather(caplog.text.count("it is broken"))) == len(failing)
    lines = told(medium, found)
    assert lines[1].startswith(f"{len(failing)} of {len(found.seed)} samples are left out")


def test_wrong_input_is_the_runs_and_not_a_samples(world, monkeypatch):
    def broken(*given):
        raise pgran.InputError("wrong")

    monkeypatch.setattr(scene, "make_lattice", broken)
    if world.size == 1:
        with pytest.raises(pgran.InputError, match="wrong"):
            ran("response", "", world)


def test_a_run_that_went_on_equals_one_never_stopped(world, shared_path):
    """Stopped after each sample, of which each of three ranks has several."""
    of, more = "response", "-ensemble_samples 12"
    options = chosen(of, f"{KINDS[of][0]} {more}")
    run = world, shared_path / "a.h5", options.identity()
    found = stopped_again_and_again(*run, lambda journal: run_scene(options, world, journal))
    if world.rank == 0:
        assert_same(found[1], ran(of, more, MPI.COMM_SELF)[1])


def test_modes_of_an_interval_are_counted(world):
    found = ran("modes", "-modes_omega_min .3 -modes_omega_max .5", world)[1]
    expected = [len(pgran.find_modes(lattice_of(s), interval=(0.3, 0.5)).omega) for s in SEEDS]
    assert np.array_equal(found.modes, expected)
    assert found.above is None
    for omega, count in zip(found.mode_omega, expected, strict=True):
        assert np.all((omega[:count] >= 0.3) & (omega[:count] <= 0.5))
        assert np.isnan(omega[count:]).all()


@pytest.mark.parametrize("of", KINDS)
def test_a_dry_run_foresees_it(world, of):
    """The samples, memory, time and disk, without doing them all."""
    options = chosen(of, KINDS[of][0])
    lines = world.bcast(forecast(SCENES["ensemble"], options, world, time.perf_counter()))
    said = dict(line.split(maxsplit=1) for line in lines)
    assert said["work"].startswith("5 samples")
    assert set(said) >= {"unknowns", "work", "memory", "time", "disk"}


@pytest.mark.parametrize(
    ("of", "text", "said"),
    [
        ("response", f"-bonds_seed {2**63 - 3}", "no seeds are left"),
        ("relaxation", f"-relax_seed {2**63 - 3}", "no seeds are left"),
        ("response", "-statistics_windows .4,2 -ensemble_samples 8", "0.4 to 2 is not within"),
        ("response", "-detectors 5,0", "detectors"),
    ],
)
def test_what_only_the_run_can_see(world, of, text, said):
    with pytest.raises(pgran.InputError, match=said):
        ran(of, text, world)


def test_samples_stay_different_while_bonds_are_redrawn(world):
    """Each by changes of its own: by the same ones all would become one network."""
    found = ran("modes", "-bonds_redrawn 2000", world)[1]
    assert len(set(found.mode_omega[:, 0].tolist())) == len(SEEDS)
