"""Loud sound: closed forms, motions in time, energy, folds, multipliers, refusals."""

import dataclasses

import numpy as np
import pytest
from loud_samples import Motion, chain, free_oscillation, packing, period
from mpi4py import MPI
from samples import random_lattice
from scipy.optimize import brentq

import pgran
from pgran.driven.operators import Operators
from pgran.experiments.loud.balance import Balance, waves
from pgran.experiments.loud.contacts import contacts_of
from pgran.experiments.loud.newton import solved
from pgran.experiments.loud.proof import SAMPLES, _Orbit, proof_of
from pgran.experiments.loud.scene import SCENE
from pgran.experiments.loud.scene import loud as loud_in
from pgran.run.crew import Crew


def test_a_bilinear_oscillator():
    """A ball on a spring, which touches a second one half of the time."""
    low, high = 1.0, 2.0
    exact = 2 * low * high / (low + high)
    network = chain([1.0, 3.0], [1e3, 1e-12], 1.0)
    errors = [abs(free_oscillation(network, 1.0, exact, N)[0] / exact - 1) for N in (3, 7, 15, 31)]
    assert np.all(np.array(errors) < [2e-4, 1e-5, 1e-6, 1e-7])


@pytest.mark.parametrize(("size", "error"), [(0.1, 1e-9), (0.5, 1e-9), (0.9, 1e-8), (1.5, 3e-6)])
def test_hertz_oscillators(size, error):
    """Between two contacts, which open beyond 1; and on one under a load."""
    network = chain([1.5, 1.5], [1.0, 1.0], 1.5)
    omega, motion = free_oscillation(network, size, np.sqrt(3), 15)
    both = lambda x: (max(1 + x, 0) ** 2.5 + max(1 - x, 0) ** 2.5) / 2.5  # noqa: E731
    top = abs(motion).max()
    assert omega == pytest.approx(2 * np.pi / period(both, -top, top), rel=error)

    network = chain([1.5, 1e-9], [1.0, 1.0], 1.5)
    omega, motion = free_oscillation(network, size, 1.2 - size**2 / 20, 15, (0,))
    one = lambda x: max(1 - x, 0) ** 2.5 / 2.5 + x  # noqa: E731
    # the contact is stretched by u, and opens at 1
    low = motion.min()
    high = brentq(lambda x: one(x) - one(low), 1e-9, 50)
    assert omega == pytest.approx(2 * np.pi / period(one, low, high), rel=error)


def test_statics_of_two_contacts_in_series():
    network = chain([1.5, 0.75], [1.0, 1.0], 1.5, 1e-9)
    found = pgran.loud(network, [1e-5], [1], [0.5, 2.0], harmonics=8, stability=False)
    h, c = network.overlap, network.force / network.overlap**1.5
    angle = 2 * np.pi * np.arange(4096) / 4096
    for a, amplitude in enumerate(found.amplitude):
        # overlaps x_1 = h_1 - u and x_2 share the whole, as F = c_1 x_1^1.5 = c_2 x_2^1.5
        whole, ratio = h.sum() - amplitude * np.cos(angle), (c[0] / c[1]) ** (2 / 3)
        exact = np.fft.rfft(h[0] - whole / (1 + ratio))[:9] / 4096 * np.r_[1, np.full(8, 2)]
        assert np.abs(found.harmonic[0, a, 0] - exact).max() < 1e-9 * amplitude


def test_the_second_order_of_a_chain():
    """u_0 = K^-1 B^T (k / 4h) |E|^2 / 2, u_2 = S(2 i omega)^-1 B^T (k / 4h) E^2 / 2; order a^2."""
    rng = np.random.default_rng(1)
    force = rng.uniform(0.2, 1, 7)
    network, omega = chain(1.5 * force ** (1 / 3), force, 1.5, 0.05), 0.9
    network = dataclasses.replace(network, damping_power=0.0)
    B, w, K, C, *_ = network.springs.B, network.springs.drive, *pgran.matrices(network)
    S = lambda s: (K + s * C).toarray() + s * s * np.eye(6)  # noqa: E731
    stretch = w + B @ np.linalg.solve(
        S(1j * omega), -B.T @ ((network.stiffness + 0.05j * omega) * w)
    )
    push = network.stiffness / (4 * network.overlap)
    exact = [np.linalg.solve(S(0), B.T @ (push * abs(stretch) ** 2 / 2)),
             np.linalg.solve(S(2j * omega), B.T @ (push * stretch**2 / 2))]  # fmt: skip
    found = pgran.loud(network, [omega], range(1, 7), [0.02, 0.04], unit="opening")
    scaled = found.harmonic[0][:, :, [0, 2]] / found.drive[0, :, None, None] ** 2
    missed = np.linalg.norm(scaled - np.transpose(exact), axis=1) / np.linalg.norm(exact, axis=1)
    assert np.all(missed[0] < 5e-4)
    assert missed[1] / missed[0] == pytest.approx([4, 4], rel=0.1)


def test_springs_that_stay_closed_are_the_linear_run():
    network, omega = packing(40, 2, "harmonic", 2, 5, 0.3, 0.0)
    found = pgran.loud(network, [omega], network.free[:5], [0.5, 0.999], unit="opening", reach=0)
    linear = pgran.sweep(network, [omega], network.free[:5], method="points")
    assert np.all(found.change == 0)
    assert np.all(found.harmonic[:, :, :, [0, 2, 3, 4, 5]] == 0)
    first = found.drive[0, :, None] * linear.displacement
    assert found.harmonic[0, :, :, 1] == pytest.approx(first, rel=1e-14)
    assert found.opening[0] == pytest.approx(linear.opening[0], rel=1e-12)
    assert not found.clapping.any()


@pytest.mark.parametrize(
    ("dimension", "law", "power", "amplitude"),
    [(3, "hertz", 1.0, 0.9), (2, "hertz", 0.0, 2.0), (2, "harmonic", 0.0, 2.0)],
)
def test_against_motions_in_time(dimension, law, power, amplitude):
    """Amplitudes by DOP853, errors within a factor of them, multipliers by a dense monodromy."""
    network, omega = packing(40, dimension, law, 3, 5, 0.3, power)
    found = pgran.loud(network, [omega], network.free, [amplitude], unit="opening")
    fields, matrix, missed = Motion(network, 3.0).periodic(omega, found.drive[0, 0], 8)
    assert missed < 1e-7
    unknowns, weights = network.readings(network.sites(network.free))
    exact = np.einsum("da,dan->dn", weights, fields[unknowns])[:, :6]
    error, estimate = (np.linalg.norm(x, axis=0) for x in (
        found.harmonic[0, 0] - exact, found.harmonic_error[0, 0]))  # fmt: skip
    assert np.all(error < 3 * estimate + 1e-7 * np.linalg.norm(exact))
    assert np.all((error > estimate / 3) | (estimate < 1e-7 * np.linalg.norm(exact)))
    largest = np.abs(np.linalg.eigvals(matrix)).max()
    assert abs(found.multiplier[0, 0]) == pytest.approx(largest, rel=2e-4)


@pytest.mark.parametrize(("law", "power"), [("hertz", 0.0), ("hertz", 0.5), ("hertz", 1.0),
                                            ("harmonic", 0.0), (2.0, 1.0)])  # fmt: skip
def test_energy_is_balanced(law, power):
    network, omega = packing(40, 2, law, 1, 5, 0.3, power)
    found = pgran.loud(network, [omega, 1.5 * omega], network.free[:2], [0.3, 1, 3], unit="opening")
    assert not found.failures
    assert np.all(np.abs(found.imbalance) < 2e-4)
    assert np.all(found.power_in > 0)
    assert np.all(np.diff(found.clapping) >= 0)


def test_folds_of_one_ball_and_hysteresis(world):
    """From both sides at the same frequencies; between them the states differ."""
    network = chain([1.5, 1.5], [1.0, 1.0], 1.5, 0.01)
    omega = np.sqrt(3) * np.linspace(0.9, 1.05, 16)
    found = pgran.loud(network, omega, [1], [0.005, 0.04], follow="frequency", stability=False)
    assert not found.failures
    assert found.direction.tolist() == ["up", "down", "up", "down"]
    folds = found.fold[-1, 2, :2], found.fold[0, 3, 1::-1]
    assert folds[0] == pytest.approx(folds[1], rel=2e-6)
    assert found.folds[-1].tolist() == [0, 0, 2, 0]
    size = np.abs(found.harmonic[:, :, 0, 1])
    between = (omega > folds[0].min()) & (omega < folds[0].max())
    assert np.all(size[between, 3] > 2 * size[between, 2])
    assert size[~between, 3] == pytest.approx(size[~between, 2], rel=1e-5)
    assert size[:, 0] == pytest.approx(size[:, 1], rel=1e-6)
    assert np.all(np.isfinite(found.opening))


def test_multipliers_of_a_quiet_medium_are_those_of_its_modes(world):
    lattice = random_lattice((4, 3), 2, damping=0.05)
    lattice = dataclasses.replace(lattice, hertz=1.0)
    found = pgran.loud(lattice, [0.5], [(1, 1)], [1e-4], unit="opening")
    modes = pgran.find_modes(lattice, damped=True, method="dense")
    exact = np.exp(2 * np.pi / 0.5 * modes.eigenvalue)
    exact = exact[np.argmax(np.abs(exact))]
    assert abs(found.multiplier[0, 0]) == pytest.approx(abs(exact), rel=1e-3)
    assert not found.unstable.any()


def test_ranks_that_share_a_medium(world):
    network, omega = packing(40, 3, "hertz", 3, 5, 0.3, 1.0)
    asked = np.array([omega]), network.free[:3], np.array([0.9, 3.0])
    alone = pgran.loud(network, *asked, unit="opening", certificate=True)
    with Crew(world, world.size) as crew:
        shared = world.bcast(loud_in(network, *asked, crew, unit="opening", certificate=True))
    for name in ("harmonic", "change", "clapping", "multiplier", "power_in", "power_lost", "drive"):
        assert getattr(shared, name) == pytest.approx(getattr(alone, name), rel=1e-7, abs=0), name
    assert np.array_equal(shared.clapped, alone.clapped)
    assert shared.proven.tolist() == alone.proven.tolist()
    assert shared.certificate_bound == pytest.approx(alone.certificate_bound, rel=0.01, nan_ok=True)


def test_what_is_not_accurate_or_not_stable_is_said():
    network, omega = packing(60, 3, "hertz", 1, 5, 0.3, 1.0, shape=(1.5, 1, 1), sizes=0.1)
    found = pgran.loud(network, [omega], network.free[:1], [0.3, 3.0], unit="opening")
    assert found.unstable.tolist() == [[False, True]]
    lines = list(SCENE.summary(found.as_result()))
    assert any("1 of 2 states are unstable" in line for line in lines)
    assert all("unstable" in line for line in lines if "differs from the linear" in line)
    lattice = dataclasses.replace(random_lattice((4, 3), 2, damping=0.05), hertz=1.0)
    for power, said in ((1.0, "proven: 1 of 1"), (0.5, "no proof was tried")):
        untried = dataclasses.replace(lattice, damping_power=power)
        untried = pgran.loud(untried, [0.5], [(1, 1)], [0.1], unit="opening", certificate=True)
        assert said in "".join(SCENE.summary(untried.as_result()))
    # a state that no tolerance of this kind can be met by
    strict = pgran.loud(network, [omega], network.free[:1], [3.0], unit="opening",
                        error_tolerance=1e-11, stability=False)  # fmt: skip
    assert strict.failures == 1
    assert strict.harmonics[0, 0] == 40
    assert np.all(strict.harmonic_error[0, 0, 0] < found.harmonic_error[0, 1, 0])
    assert any("1 of 1 states" in line for line in SCENE.summary(strict.as_result()))


CERTIFIED = [
    (30, 2, "hertz", 1, 4, 0.3, 1.0), (30, 2, "hertz", 1, 4, 0.2, 0.0),
    (30, 2, "harmonic", 1, 4, 0.3, 0.0), (30, 2, "harmonic", 1, 3, 0.4, 1.0),
]  # fmt: skip


@pytest.mark.parametrize("case", CERTIFIED)
def test_what_is_proven_holds(case):
    """Against far finer motions; and where Z reaches 1 nothing is said to be proven."""
    network, omega = packing(*case)
    asked = network, [omega], network.free, [0.03, 0.3, 1.0, 2.0, 10.0]
    told = {"unit": "opening", "stability": False, "error_tolerance": 1e-2}
    found = pgran.loud(*asked, harmonics=3, certificate=True, **told)
    exact = pgran.loud(*asked, harmonics=31, **told)
    assert np.all(exact.samples >= 512)
    proven = found.proven
    assert proven[0, :2].all()
    error = np.abs(found.harmonic - exact.harmonic[..., :4])[proven]
    bound, size = found.certificate_bound[proven], np.abs(found.harmonic[proven]).max((1, 2))
    assert np.all(error <= bound + 1e-10 * size[:, None, None])
    assert np.all(bound.max((1, 2)) < 0.1 * size)
    assert np.all(found.certificate_radius[proven] > 0)
    assert np.isnan(found.certificate_bound[~proven]).all()
    said = "".join(SCENE.summary(found.as_result()))
    assert f"proven: {np.count_nonzero(proven)} of 5" in said
    assert ("not proven" in said) == (not proven.all())


def test_a_spoilt_motion_is_not_proven():
    """A bound is never less than by how much it is spoilt; between samples P misses no more."""
    network, omega = packing(30, 2, "hertz", 1, 4, 0.3, 1.0)
    contacts, sites = contacts_of(network, 3.0), network.sites(network.free)
    amplitude = pgran.sweep(network, [omega], network.free, method="points").opening[0, 0]
    with (
        Operators(network, MPI.COMM_SELF) as operators,
        Balance(operators, contacts, 16) as balance,
    ):
        balance.omega, balance.amplitude = omega, amplitude
        state = solved(balance, np.full((network.size, 17), 1e-9 + 0j), 1e-11)
        state = state[operators.layout.numbers.ravel()]
    unknowns, weights = network.readings(sites)

    def proof(U):
        shown = np.einsum("da,dan->dn", weights, U[unknowns])
        return proof_of(network, contacts, omega, amplitude, U, sites, shown), shown

    good, exact = proof(state)
    for part, provable in ((0, True), (1e-8, True), (1e-6, None), (0.3, False)):
        for n in (1, 3):
            spoilt = state.copy()
            spoilt[::3, n] += part * np.abs(state[:, 1]).max()
            found, shown = proof(spoilt)
            assert provable is None or found.proven == provable
            assert not found.proven or np.all(found.bound + good.bound >= np.abs(shown - exact))
    orbit = _Orbit(contacts, omega, amplitude, 3 * state)
    wave, E = waves(np.arange(256), 16 * SAMPLES), 3 * orbit.B @ state
    E[:, 1] += amplitude * contacts.drive
    missed = contacts.forces(E.view(float) @ wave[:34])[0] - orbit.P.view(float) @ wave
    assert np.all(np.sqrt(np.mean(missed**2, axis=1)) <= orbit.rest)


HERTZ = packing(30, 2, "hertz", 1, 5, 0.3, 0.0)[0]
REFUSED = [
    ({}, {"medium": random_lattice((3, 3))}, "bonds_hertz"),
    ({"power": None}, {}, "contact law"),
    ({"tangential": HERTZ.stiffness}, {}, "tangential springs"),
    ({"loss": 0.1}, {}, "damping_loss"),
    ({"damping": 0.0}, {}, "nothing is damped"),
    ({"damping_power": -1.0}, {}, "-damping_power"),
    ({}, {"amplitudes": [1.0, 0.5]}, "increase"),
    ({}, {"unit": "opening", "follow": "frequency"}, "-loud_follow frequency"),
    ({}, {"follow": "frequency"}, "two frequencies"),
]


@pytest.mark.parametrize(("changes", "asked", "said"), REFUSED)
def test_what_is_refused(changes, asked, said):
    asked = {"medium": dataclasses.replace(HERTZ, **changes), "amplitudes": [0.1]} | asked
    with pytest.raises(pgran.InputError, match=said):
        pgran.loud(asked.pop("medium"), [0.2], HERTZ.free[:1], asked.pop("amplitudes"), **asked)
