"""Derivatives by all bonds, masses and beta, and the power through bonds: identities, 60 digits."""

import dataclasses
from collections import Counter

import numpy as np
import pytest
from change_faults import derivative_faults
from mpmath import mp, mpf
from network_samples import as_network
from samples import random_lattice
from sensitivity_samples import (
    STALE,
    Exact,
    assert_same_on_ranks,
    derived,
    packing,
    random_sensitivity,
)

from pgran.driven import drive
from pgran.medium.lattice import Lattice

CASE = random_sensitivity(0)  # of another tolerance and frequencies
DERIVATIVES = "by_stiffness", "by_mass", "by_damping", "by_tangential", "by_force"


MEDIA = {
    "1d": random_lattice((5,), 1),
    "2d undamped": random_lattice((2, 3), 2, damping=0.0, mass=0.3),
    "3d zeros": random_lattice((2, 2, 1), 3, 0.01, law="bimodal"),
    "scalar": packing("scalar", unit=1e-6),
    "vector": packing("vector", unit=1e6, damped="normal"),
    "vector 3d": packing("vector", 3, damping=0.0),
    "rotations": packing("rotations", damping=0.3, component="y"),
    "rotations 3d": packing("rotations", 3, damping=0.0),
    "zeros": packing("vector", tangential=np.zeros(11), force=None, damped="normal"),
    "zeros, rotations": packing(
        "rotations", tangential=np.zeros(11), force=np.zeros(11), damping=0.0, damped="normal"
    ),
}


@pytest.mark.parametrize("name", MEDIA)
def test_derivatives_against_central_differences(name):
    """Of elimination with 60 digits, some by constants; all within the bounds, which are small."""
    medium, case = MEDIA[name], dataclasses.replace(CASE, tolerance=1e-7, omegas=[0.37])
    sites = numbers = [1, 2]
    if isinstance(medium, Lattice):
        sites = np.array([[0] * len(medium.shape), np.subtract(medium.shape, 1)])
        numbers = np.ravel_multi_index(sites.T, medium.shape)
    found = derived(medium, case.omegas, sites, error_tolerance=case.tolerance)
    assert found.converged_reason[0] > 0
    for kind in ("by_stiffness", "by_mass"):
        largest = np.abs(getattr(found, kind)).max(axis=-1)
        assert np.all(getattr(found, f"{kind}_bound").max(axis=-1) <= case.tolerance * largest)
    with mp.workdps(60):
        exact, step = Exact(medium), mpf(10) ** -20
        states = exact.states(0.37j, numbers)
        assert not list(derivative_faults(case, found, 0, exact, states, Counter()))
        derivatives = exact.derivatives(0.37j, *states[:2])
        for contact in np.random.default_rng(0).choice(len(exact.contacts), 2, replace=False):
            here, *parts = exact.contacts[contact]
            for kind, part in zip(("stiffness", "tangential", "force"), parts, strict=True):
                ends = (exact.states(0.37j, numbers, [(here, h * part)])[2] for h in (step, -step))
                slope = np.subtract(*ends) / (2 * step)
                error = np.abs(derivatives[kind][:, contact] - slope)
                assert np.all(error <= mpf(10) ** -25 * (1 + np.abs(slope)))


@pytest.mark.parametrize("name", MEDIA)
def test_amplitudes_do_not_change_with_all_units_of_mass(name):
    """Euler: sum k dA/dk + beta dA/dbeta + sum m dA/dm = 0, tangential springs and forces too."""
    medium = MEDIA[name]
    sites = [[0] * len(medium.shape)] if isinstance(medium, Lattice) else [3]
    found = derived(medium, np.linspace(0.1, 1.1, 7), sites)
    network = as_network(medium) if isinstance(medium, Lattice) else medium
    values = {
        "stiffness": network.stiffness, "mass": network.masses[network.free],
        "damping": np.array(network.damping), "tangential": network.tangential,
        "force": network.force,
    }  # fmt: skip
    total = bound = size = 0.0
    for kind, value in values.items():
        if getattr(found, f"by_{kind}") is not None:
            parts = (value * getattr(found, f"by_{kind}{what}") for what in ("", "_bound"))
            part, known = (x if kind == "damping" else x.sum(axis=-1) for x in parts)
            total, bound, size = total + part, bound + known, size + np.abs(part)
    assert np.all(np.abs(total) <= bound)
    assert np.all(np.abs(total) <= 1e-10 * size)
    assert np.all(found.converged_reason > 0)


# Power


@pytest.mark.parametrize("name", MEDIA)
def test_power_flows_from_the_drive_into_the_dashpots(name):
    """Contact by contact as forces times velocities; no free ball keeps any."""
    medium, omega = MEDIA[name], 0.37
    found = derived(medium, [omega], [[0] * len(medium.shape)] if "d" in name[:2] else [1])
    flux, loss = found.flux[0], found.loss[0]
    with mp.workdps(30):
        exact = Exact(medium)
        u, _, _ = exact.states(1j * omega, [1])
        width, given = exact.axes + exact.turns, []  # what each contact gives to both its balls
        for contact in range(len(flux)):
            here, elastic, lossy = exact.contact(contact)
            at = here[1].ravel()
            force = -(elastic + 1j * mpf(omega) * exact.beta * lossy) @ u[at]
            power = force * np.array([mp.conj(x) for x in 1j * mpf(omega) * u[at]]) / 2
            given.append([float(sum(end).real) for end in (power[:width], power[width:])])
    given, held, ends = np.array(given), exact.network.held, exact.ends
    scale = np.abs(given).max()
    assert np.abs(flux - np.diff(given)[:, 0] / 2).max() <= 1e-12 * scale
    assert np.abs(loss + given.sum(axis=1)).max() <= 1e-12 * scale
    gains = np.zeros(len(held))
    np.add.at(gains, ends, np.stack([-flux - loss / 2, flux - loss / 2], axis=1))
    assert np.abs(gains[held == 0]).max() <= 1e-12 * scale
    assert abs(gains[held == 2].sum() + loss.sum()) <= 1e-12 * scale
    assert np.all(loss >= 0)
    assert bool(loss.any()) == (medium.damping > 0)


# Which are kept, on how many ranks, and what fails


@pytest.mark.parametrize(
    ("medium", "sites", "inertia"),
    [
        (random_lattice((4, 3), 5), [[0, 0], [2, 1]], 1.0),
        (packing("rotations"), [1, 3], packing("rotations").masses[1:4]),
    ],
)
def test_the_largest_are_kept(medium, sites, inertia):
    every, few, all_kept = (
        derived(medium, np.linspace(0.1, 1.0, 5), sites, most=most) for most in (0, 3, 10**6)
    )
    bonds = "by_stiffness", "by_stiffness_bound", "log_amplitude", "log_bound", "by_force"
    for size, kept, names in (
        (np.hypot(every.log_amplitude, every.log_phase), few.bond, bonds),
        (np.abs(every.by_mass * inertia), few.ball, ("by_mass", "by_mass_bound")),
    ):
        largest = np.sort(size, axis=-1)[..., :-4:-1]
        assert np.allclose(np.take_along_axis(size, kept, -1), largest, rtol=1e-12)
        for name in names:
            if (values := getattr(every, name)) is not None:
                values = np.take_along_axis(values, kept, -1)
                assert np.array_equal(values, getattr(few, name)), name
    assert np.array_equal(every.flux, few.flux)
    assert all_kept.bond.shape[-1] == medium.bonds


@pytest.mark.parametrize(
    ("medium", "sites"),
    [(random_lattice((4, 5), 6), [[1, 1], [3, 2]]), (packing("rotations"), [1, 3])],
)
def test_any_number_of_ranks(world, medium, sites):
    names = *DERIVATIVES, "displacement", "flux", "loss", "log_amplitude", "log_phase"
    assert_same_on_ranks(world, derived, medium, np.linspace(0.2, 1.2, 9), sites, names)


def test_what_fails_is_marked(solver_options):
    """A resonance without damping, where S is 0, and a solver that does not get there."""
    found = derived(Lattice((np.ones(2),), 2.0, 0.0), [0.5, 1.0], [0])
    assert found.converged_reason[0] > 0 >= found.converged_reason[1]
    assert found.failures == 1
    solver_options("-steady_ksp_type gmres -steady_pc_type none -steady_ksp_max_it 2")
    found = derived(random_lattice((6, 5), 1), [0.3, 0.9], [[1, 2]])
    assert np.all(found.converged_reason <= 0)
    for name in ("by_stiffness", "by_mass", "by_damping", "flux"):
        assert np.isnan(getattr(found, name)).all()


@pytest.mark.parametrize("solver", [STALE, "-steady_ksp_type gmres -steady_pc_type ilu", ""])
def test_inexact_factors(monkeypatch, solver_options, solver):
    """Bounds hold, and derivatives are as accurate as asked or marked; with direct ones none is."""
    solver_options(solver)
    monkeypatch.setattr(drive, "ranges", lambda count: [range(count)])
    lattice, omegas = random_lattice((4, 3), 3), np.linspace(0.4, 0.41, 6)
    found = derived(lattice, omegas, [[1, 1]])
    case = dataclasses.replace(CASE, tolerance=1e-4, omegas=omegas)
    with mp.workdps(40):
        exact = Exact(lattice)
        for n, omega in enumerate(omegas):
            states = exact.states(1j * omega, [4])
            assert not list(derivative_faults(case, found, n, exact, states, Counter()))
    assert "ilu" in solver or np.all(found.converged_reason > 0)


def test_logarithmic_derivatives_by_a_negative_stiffness():
    """d ln A by dk / k, whatever the sign of k: by differences."""
    network = packing("scalar")
    k = network.stiffness * np.where(np.arange(network.bonds) == 1, -0.05, 1)
    near = [
        dataclasses.replace(network, stiffness=k * np.where(np.arange(network.bonds) == 1, x, 1))
        for x in (1.0, 1 - 1e-4, 1 + 1e-4)
    ]
    found, less, more = (derived(each, [0.6], [2], error_tolerance=1e-9) for each in near)
    slope = np.log(more.displacement / less.displacement)[0, 0] / 2e-4
    assert found.log_amplitude[0, 0, 1] == pytest.approx(slope.real, rel=1e-5)
    assert found.log_phase[0, 0, 1] == pytest.approx(slope.imag, rel=1e-5)
