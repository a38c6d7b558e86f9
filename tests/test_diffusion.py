"""Energy that diffuses between two walls: of known fields, and of ensembles of pulses."""

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest

import pgran
from pgran.errors import InputError
from pgran.experiments.ensemble import transport
from pgran.experiments.modes import shapes
from pgran.results import Ensemble
from pgran.run.experiment import Caution


def images(time, depth, walls, D, rate):
    """What diffuses from one wall of two that reflect, by its mirror images."""
    places = depth - 2 * walls * np.arange(-20, 21)[:, None, None]
    spread = np.exp(-(places**2) / (4 * D * time[:, None])).sum(axis=0)
    return spread * (np.exp(-rate * time) / np.sqrt(np.pi * D * time))[:, None]


def pulses(D=0.3, rate=0.01, noise=1.0, seed=8, time=600.0):
    """An ensemble whose energy diffuses, with noise, and the depths of its detectors."""
    time, depth = np.arange(1.0, time, 2.0), np.arange(6.0, 30.0, 5.0)
    drive = np.where(np.abs(time - 20) < 4, 1.0, 0.0)  # middle 20
    late = np.maximum(time - 20, 1.0)
    square = images(late, depth, 36.0, D, rate) * (time > 24)[:, None]
    shaken = np.random.default_rng(seed).exponential(1.0, (20, *square.shape))
    square = square * (1 + noise * (shaken - 1))
    facts = {"of": "pulse", "solve_seconds": 0.0, "left_out": 0, "good": np.ones(20, dtype=np.int8)}
    facts |= {"arrival": np.tile(depth / 0.4, (20, 1)), "drive": np.tile(drive, (20, 1))}
    return Ensemble(seed=np.arange(20), time=time, square=square, **facts), depth


WALLS = 36.0, (0.0, 36.0), 2


def test_diffusion_between_walls():
    """The series and the mirror images agree, and the fit finds what they are made with."""
    time, depth = np.linspace(40, 300, 9), np.linspace(0, 36, 5)
    sent, strength = np.array([0.0, 10.0, 20.0]), np.array([1.0, 3.0, 2.0])
    made = transport.spreading(time, depth, 36.0, 0.4, 0.02, sent, strength)
    each = [images(time - t, depth, 36.0, 0.4, 0.02) for t in sent]
    assert made / 36 == pytest.approx(np.tensordot(strength, each, 1), rel=1e-9)
    for seed in range(2):
        found = transport.diffusion(*pulses(seed=seed), *WALLS)
        truths = {"diffusivity": 0.3, "absorption": 0.01, "length": math.sqrt(30)}
        for name, truth in truths.items():
            assert abs(getattr(found, name) - truth) < 3 * getattr(found, f"{name}_error")
            assert getattr(found, f"{name}_error") < 0.1 * truth
        assert found.free_path == pytest.approx(2 * found.diffusivity / 0.4)
        assert 0.8 < found.misfit < 1.2


def test_errors_are_those_of_the_whole_fit():
    """Of fits that leave a sample out, from its signals, their errors and its fronts on."""
    ensemble, depth = pulses()
    arrival = ensemble.arrival + np.random.default_rng(3).normal(0, 9, ensemble.arrival.shape)

    def fit(some):
        own = {"square": ensemble.square[some], "arrival": arrival[some], "good": some[some] * 1}
        found = transport.diffusion(dataclasses.replace(ensemble, **own), depth, *WALLS)
        values = [found.diffusivity, found.absorption, found.length, found.free_path]
        return np.array(values), found

    few = np.arange(20) < 9
    found = fit(few)[1]
    others = np.array([fit(few & (np.arange(20) != n))[0] for n in range(9)])
    error = others.std(axis=0) * math.sqrt(8) * math.sqrt(8 / 6)  # the jackknife's, Student's t
    names = "diffusivity", "absorption", "length", "free_path"
    value = np.array([getattr(found, name) for name in names])
    error = value * np.expm1(error / value)  # the longer side
    assert [getattr(found, f"{name}_error") for name in names] == pytest.approx(error, rel=1e-2)


def test_what_is_no_diffusion():
    flat = transport.diffusion(*pulses(D=100.0), *WALLS)  # no gradient is left
    assert np.isnan(flat.diffusivity)
    assert abs(flat.absorption - 0.01) < 3 * flat.absorption_error
    with pytest.raises(InputError, match=r"20 samples and \d+ times after"):
        transport.diffusion(*pulses(time=140.0), *WALLS)
    ensemble, depth = pulses()

    def fit(square):
        return transport.diffusion(dataclasses.replace(ensemble, square=square), depth, *WALLS)

    for square in (np.nan * ensemble.square, np.repeat(ensemble.square[:1], 20, axis=0)):
        with pytest.raises(InputError, match="errors hide the signals, or all samples are alike"):
            fit(square)
    found = fit(ensemble.square * np.exp(2 * np.sin(depth)))
    said = next(transport.summary(SimpleNamespace(diffusion=found)))
    assert isinstance(said, Caution)


def test_energy_is_absorbed_in_the_widths_of_modes():
    """1/tau = Gamma: a narrow band of bonds that differ little, whose modes are as wide."""
    lattice = {"shape": (12, 8), "damping": 0.004, "law": "uniform", "kmin": 0.1}
    sent = {"omega": 0.8, "width": 40.0, "time": 650.0, "points": 501, "error_tolerance": 1e-3}
    line = [(i, 4) for i in (3, 5, 7, 9)]
    ensemble = pgran.ensemble("pulse", 8, lattice=lattice, detectors=line, keep="curves", **sent)
    first = pgran.Lattice.random(**lattice)
    found, modes = pgran.transport(first, ensemble), pgran.find_modes(first, shapes=True)
    near = np.abs(modes.omega - 0.8) < 2 / 40
    width = shapes.modal_widths(first, modes.vector)[near].mean()
    assert abs(found.absorption - width) < 3 * found.absorption_error < 0.2 * width
    parts = ensemble.square
    assert ensemble.mean_square == pytest.approx(parts.mean(axis=0), nan_ok=True)
    assert ensemble.mean_square_error == pytest.approx(
        parts.std(axis=0, ddof=1) / math.sqrt(8), nan_ok=True
    )
    pushed = pgran.with_source(first, balls=[(1, 1)])
    with pytest.raises(InputError, match="or a push, energy spreads sideways"):
        pgran.transport(pushed, ensemble)
