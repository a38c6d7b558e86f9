"""Balls much lighter than the unit of mass: what reads them is no vector of length 1.

The unknowns are mass-weighted, the median mass being the unit.
"""

import dataclasses
from collections import Counter
from itertools import pairwise

import numpy as np
import pytest
from change_faults import sensitivity_faults
from mpmath import mp
from network_samples import NetworkReference
from samples import listened, swept
from scipy.integrate import solve_ivp
from sensitivity_samples import SensitivityCase

import pgran
from pgran.experiments.response.models import SmallSystems, evaluate

HEAVY = 7  # balls of mass 1 beside the light ones, each held by the wall: they set the unit
LIGHT = [1e-4, 1e-8]


def light_chain(mass, count, damping):
    """Balls of some mass between both walls, all of frequencies about 1."""
    chain = [0, *range(2, 2 + count), 1]
    bond = [*pairwise(chain), *([0, 2 + count + i] for i in range(HEAVY))]
    stiffness = [*(mass * np.linspace(0.6, 1.4, count + 1)), *[1.0] * HEAVY]
    held = [1, 2] + [0] * (count + HEAVY)
    masses = [1.0, 1.0] + [mass] * count + [1.0] * HEAVY
    return pgran.Network(bond, stiffness, held, masses, damping=damping)


@pytest.mark.parametrize("mass", LIGHT)
def test_what_a_pulse_leaves_out_and_repeats_is_bounded(world, mass):
    """Against an integrator, where the bound is the smallest: at the first times."""
    network = light_chain(mass, 1, 0.0)
    pulse = {"shape": "gauss", "width": 1.0, "time": 15.0, "points": 101, "error_tolerance": 1e-2}
    found = listened(network, [2], world, **pulse)

    def slope(t, y):
        return [y[1], 1.4 * np.exp(-0.5 * (t - 6) ** 2) - 2.0 * y[0]]

    precise = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-17, "max_step": 0.05}
    exact = solve_ivp(slope, (-6, 15), [0, 0], t_eval=found.time, **precise).y
    assert np.all(np.abs(found.displacement[:, 0] - exact[0]) <= found.error_bound[:, 0])
    assert np.all(np.abs(found.velocity[:, 0] - exact[1]) <= found.velocity_bound[:, 0])
    assert found.error_bound.max() < 1e-2


@pytest.mark.parametrize("mass", LIGHT)
def test_curves_of_light_balls(world, mass):
    """Values and derivatives by models, against elimination with 50 digits."""
    network = light_chain(mass, 4, 0.02 * mass)
    found = swept(network, [0.3, 1.9], [[2], [4]], world, method="curve", keep_models=True)
    assert found.failures == 0
    omegas, step = np.arange(20, 120, 7) / 64, 2.0**-30  # their sums are exact
    at = found.at(omegas)
    with mp.workdps(50):
        reference = NetworkReference(network)
        for n, omega in enumerate(omegas):
            below, exact, above = (
                np.array(reference.amplitudes(1j * w, [2, 4]))
                for w in (omega - step, omega, omega + step)
            )
            assert np.all(abs(at.displacement[n] - exact) <= at.error_bound[n])
            slope = (above - below) / (2 * step)
            assert np.all(abs(at.derivative[n] - slope) <= at.derivative_bound[n])
    assert np.all(at.error_bound <= 1e-4 * np.abs(at.displacement))


@pytest.mark.parametrize("factor", [1e-6, 1e-3, 1e3, 1e6])
def test_bounds_of_a_model_are_in_units_of_what_a_detector_reads(comm, factor):
    """As many times as large as that: e_d stands in a reading and in the first column of W."""
    kept = {"method": "curve", "keep_models": True}
    models = swept(light_chain(1e-4, 4, 2e-6), [5.0, 6.0], [[2]], comm, **kept).models
    model = {name: a[0].copy() for name, a in vars(models).items() if np.ndim(a)}
    omegas = np.linspace(model["low"], model["high"], 50)
    before, rounding = evaluate(model, omegas, models), SmallSystems(model, models, omegas).rounding
    model["reading"] *= factor
    model["own"][1:, :, 0] *= factor
    model["triangle"][1:, :, 0] *= factor
    larger = dataclasses.replace(models, receiver=factor * models.receiver)
    after, scaled = evaluate(model, omegas, larger), SmallSystems(model, larger, omegas).rounding
    for name in ("displacement", "error_bound", "derivative", "derivative_bound"):
        assert after[name] == pytest.approx(factor * before[name], rel=1e-2), name
    assert np.array_equal(after["reaction_bound"], before["reaction_bound"])
    # what rounding leaves of the residual of z, of whose parts e_d is one, no less than S z
    assert models.receiver == pytest.approx(100, rel=1e-12)
    assert scaled == pytest.approx(rounding * [[1], [factor]], rel=1e-2)
    assert np.all(scaled[1] >= models.rounding * 200 * factor)
    older = SmallSystems(model, dataclasses.replace(models, receiver=None), omegas)
    assert np.all(older.rounding[1] >= scaled[1])  # of files that do not say


@pytest.mark.parametrize("mass", LIGHT)
def test_derivatives_and_changes_of_light_balls(comm, mass):
    """Sensitivities, a warm ball, cut contacts, each amplitude, against elimination."""
    network, seen = light_chain(mass, 4, 0.02 * mass), Counter()
    omegas, sites = np.array([0.8, 1.7]), np.array([2, 4])
    case = SensitivityCase(0, network, omegas, sites, "default", 1e-2, {"factor": 2.0})
    assert list(sensitivity_faults(case, seen, comm)) == []
    assert comm.rank or (seen["good"] == 2 and seen["by_stiffness bounded"] > 0)
