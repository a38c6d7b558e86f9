"""Damped modes: closed forms, sums over all of them, what is defective, those near a target."""

import dataclasses

import numpy as np
import pytest
from figure_results import result_of
from network_samples import NetworkReference
from reference import uniform_frequencies
from samples import random_lattice, uniform_lattice

import pgran
from pgran.draw import pages
from pgran.errors import FileError, InputError
from pgran.experiments.modes import certain, damped, scene
from pgran.medium import crystals
from pgran.medium.springs import quadratic
from pgran.run.experiment import Caution


def told(record, medium):
    return list(scene.summary(result_of(record, medium)))


def both_halves(modes):
    """All s, those below the real axis too."""
    return np.concatenate([modes.eigenvalue, modes.eigenvalue[modes.omega > 0].conj()])


@pytest.mark.parametrize("damping", [0.05, 0.8])
def test_equal_bonds_have_their_modes_on_a_circle(damping):
    """|s + k / beta| = k / beta, twofold ones too, or real: most of .8, which are overdamped."""
    lattice, rate = uniform_lattice((7, 7), damping=damping, mass=1.7), 0.25 / damping
    modes = pgran.find_modes(lattice, damped=True, detectors=[(2, 3)])
    ringing = modes.eigenvalue[modes.omega > 0]
    np.testing.assert_allclose(np.abs(ringing + rate), rate, rtol=1e-12)
    squares = uniform_frequencies((7, 7), 0.25, 1.7).ravel().astype(float) ** 2
    found = both_halves(modes)
    assert modes.complete
    assert (len(found), modes.failures) == (98, 0)
    for s in np.concatenate([np.roots([1, w / rate, w]) for w in squares]):
        nearest = np.argmin(np.abs(found - s))
        assert abs(found[nearest] - s) < 1e-12
        found = np.delete(found, nearest)  # twofold ones are there twice
    real = f"overdamped modes, which do not ring: {len(modes.eigenvalue) - len(ringing)}"
    assert (real in " ".join(told(modes, lattice))) == (damping > 0.1)


@pytest.mark.parametrize("loss", [0.0, 0.1])
def test_laws_with_closed_forms(loss):
    """C = b K + alpha m, K (1 + i eta): s^2 + (b w^2 + alpha) s + (1 + i eta) w^2 = 0, above."""
    lattice = random_lattice((5, 4), 3, 0.05, mass=1.7)
    lattice = dataclasses.replace(lattice, damping_power=1.0, drag=0.02, loss=loss)
    modes = pgran.find_modes(lattice, damped=True, targets=[0.3], count=4, method="eps")
    squares = pgran.find_modes(lattice.undamped()).omega ** 2
    b = 0.05 / lattice.damping_reference
    exact = np.array([np.roots([1, b * w + 0.02, (1 + 1j * loss) * w]) for w in squares]).ravel()
    nearest = exact[np.argsort(np.abs(exact - 0.3j))[:4]]
    found = modes.eigenvalue[np.argsort(np.abs(modes.eigenvalue - 0.3j))]
    np.testing.assert_allclose(found, nearest, rtol=1e-13)


def test_a_network_and_widths_to_first_order():
    """Balls of any mass; shapes solve the equation of the reference, biorthonormal."""
    rng = np.random.default_rng(4)
    network = crystals.random_geometric(
        30, 2, 6.0, masses=10 ** rng.uniform(-1, 1, 30), direction=[3.0, 4.0], damping=2e-4,
        stiffness=lambda u: 0.5 + u / 2, seed=5
    )  # fmt: skip
    modes = pgran.find_modes(network, damped=True, shapes=True)
    exact = NetworkReference(network)
    mass = exact.M.astype(float)
    M, K, C = np.diag(mass), exact.K.astype(float), 2e-4 * exact.C.astype(float)
    s, x = modes.eigenvalue, modes.vector.T / np.sqrt(mass / network.mass)[:, None]
    assert np.abs(K @ x + C @ x * s + M @ x * s**2).max() < 1e-11
    gram = (s[:, None] + s) * (x.T @ M @ x) + x.T @ C @ x
    np.testing.assert_allclose(gram, np.eye(len(s)), atol=1e-10)
    first = pgran.find_modes(network)
    assert np.median(np.abs(modes.width / first.width - 1)) < 1e-3


def test_critical_damping_is_said_to_be_defective():
    """One ball with K = 1, C = 2: s = -1 twice, with a single shape."""
    lattice = pgran.Lattice((np.array([0.5, 0.5]),), 1.0, 1.0)
    modes = pgran.find_modes(lattice, damped=True, detectors=[(0,)], shapes=True)
    np.testing.assert_allclose(modes.eigenvalue, -1, atol=1e-7)
    assert not modes.rigidity.any()
    assert np.isnan([modes.residue, modes.vector]).all()
    lines = told(modes, lattice)
    assert "without residues: 2," in " ".join(lines)
    assert isinstance(lines[1], Caution)  # without discs


CHAIN = {"bond": [[0, 1], [1, 2], [2, 3]], "stiffness": [1.0, 1.0, 2.0], "held": [2, 0, 0, 0]}


@pytest.mark.parametrize(
    ("medium", "site", "ringing", "near"),
    [
        (random_lattice((9, 8), 3, 0.003, mass=1.7), (2, 3), True, 1e-12),
        (random_lattice((9, 8), 3, 0.3, mass=1.7), (7, 1), True, 1e-12),
        # half of modes that do not ring have x^T (2 s m + C) x < 0, and so an imaginary x
        (pgran.Lattice.random((3, 2), damping=0.0, drag=4.0), (1, 1), False, 1e-12),
        (pgran.Lattice.random((3, 2), damping=5.0, drag=8.0), (1, 1), False, 1e-12),
        # beside |s| = 1e6 what is small is not defective
        (pgran.Network(**CHAIN, drag=[0, 1e6, 0, 0]), 2, True, 1e-6),
    ],
)
def test_sums_over_all_modes(medium, site, ringing, near):
    """Widths add up to the trace of C / m, residues to the amplitude."""
    modes = pgran.find_modes(medium, damped=True, detectors=[site])
    assert np.any(modes.omega) == ringing
    _, C, m = quadratic(medium)
    assert -both_halves(modes).real.sum() == pytest.approx(C.diagonal().sum() / m, rel=1e-12)
    omegas = np.array([0.3, 0.9])
    exact = pgran.sweep(medium, omegas, [site], method="points", error_tolerance=1e-10)
    terms = modes.residue[:, 0] / (1j * omegas[:, None] - modes.eigenvalue)
    error = np.abs(modes.response(omegas) - exact.displacement)[:, 0]
    assert np.all(error <= near * np.abs(terms).sum(axis=1) + exact.error_bound[:, 0])


@pytest.mark.parametrize("target", [0.0, 0.4])
def test_a_search_finds_the_nearest_of_all(world, target):
    """Near zero, too, where mirror images take part; whatever the number of ranks."""
    lattice = random_lattice((9, 8), 3, 0.05)
    wanted = {"damped": True, "detectors": [(2, 3)], "targets": [target], "count": 5}
    near = pgran.find_modes(lattice, method="eps", **wanted)
    dense = pgran.find_modes(lattice, method="dense", **wanted)
    np.testing.assert_allclose(near.eigenvalue, dense.eigenvalue, atol=1e-12)
    np.testing.assert_allclose(near.residue, dense.residue, atol=1e-10)
    assert near.count_certified
    weak = random_lattice((9, 8), 3, 0.001)  # its lowest ones are counted by undamped modes
    lowest = pgran.find_modes(weak, method="eps", certificate="none", **wanted)
    expected = ("none", False) if target else ("below", True)
    assert (lowest.certificate, lowest.count_certified) == expected
    some = pgran.find_modes(lattice, damped=True, interval=(0.2, 0.4))
    every = both_halves(pgran.find_modes(lattice, damped=True))
    assert len(some.omega) == np.count_nonzero((every.imag >= 0.2) & (every.imag <= 0.4))


@pytest.mark.parametrize("mass", [1e-30, 1e20])
def test_a_search_does_not_depend_on_the_unit_of_time(mass):
    lattice = random_lattice((5, 4), 3, 0.05)
    light = pgran.Lattice(lattice.stiffness, mass, 0.05 * np.sqrt(mass))
    here, there = (
        pgran.find_modes(
            each, damped=True, method="eps", targets=[0.2 * each.omega_mx], count=4, shapes=True,
            detectors=[(2, 3)], certificate="proven",
        )
        for each in (lattice, light)
    )  # fmt: skip
    assert (there.failures, there.radius.max() < 1e-9 * light.omega_mx) == (0, True)
    unit = 1 / np.sqrt(mass)
    np.testing.assert_allclose(there.eigenvalue, unit * here.eigenvalue, rtol=1e-12)
    np.testing.assert_allclose(there.residue, unit * here.residue, rtol=1e-9)
    np.testing.assert_allclose(np.abs(there.vector), unit**0.5 * np.abs(here.vector), rtol=1e-9)


def test_a_search_in_a_narrow_band():
    """Balls between two walls, hardly coupled: 60 modes within .001, the nearest ones in order."""
    along, across = np.full((61, 1), 1e-3), np.ones((60, 2))
    lattice = pgran.Lattice((along, across), damping=1e-5)
    top = pgran.find_modes(lattice.undamped()).omega
    wanted = {"damped": True, "targets": [top[30]], "count": 6}
    found, exact = (pgran.find_modes(lattice, method=name, **wanted) for name in ("eps", "dense"))
    np.testing.assert_allclose(found.eigenvalue, exact.eigenvalue, rtol=1e-9)
    assert found.failures == 0


def test_overdamped_modes_are_real_as_far_as_they_may_be(monkeypatch):
    """The sign of an imaginary part that is rounding must not drop them."""
    lattice = pgran.Lattice.random((8, 7), damping=0.0, drag=40.0)
    wanted = {"damped": True, "method": "eps", "targets": [0.0], "count": 4}
    exact, search = pgran.find_modes(lattice, **wanted), damped.nearest

    def below(*arguments):
        s, X = search(*arguments)
        return s - 1.5e-12j * np.abs(s).max(), X

    monkeypatch.setattr(damped, "nearest", below)
    found = pgran.find_modes(lattice, **wanted)
    assert (found.failures, len(found.omega), found.omega.any()) == (0, 4, False)
    np.testing.assert_allclose(found.eigenvalue, exact.eigenvalue, atol=1e-12)


def test_inaccurate_modes_are_marked():
    lattice = random_lattice((9, 8), 3, 0.05)
    wanted = {"damped": True, "method": "eps", "targets": [0.4], "count": 5}
    modes = pgran.find_modes(lattice, solver={"damped_pep_tol": 1e-3}, **wanted)
    assert modes.poor > 0
    assert modes.failures >= modes.poor
    line = next(line for line in told(modes, lattice) if line.startswith("NOT ACCURATE"))
    assert isinstance(line, Caution)


@pytest.mark.parametrize("certificate", ["none", "counted", "proven"])
def test_modes_that_are_missed_are_missed(monkeypatch, certificate):
    """Nothing is said where nobody asks."""
    lattice = random_lattice((9, 8), 3, 0.05)
    more = certificate == "proven"
    number, wanted = certain.number_within, {"targets": [0.4], "count": 5, "method": "eps"}
    monkeypatch.setattr(certain, "radii", lambda K, C, m, s, X: np.full(len(s), 1e-9))
    monkeypatch.setattr(certain, "number_within", lambda *a: number(*a[:-1]) + 1 if more else None)
    modes = pgran.find_modes(lattice, damped=True, certificate=certificate, **wanted)
    assert modes.failures == (certificate != "none")
    says = {"none": "not counted", "counted": "NOT CERTIFIED", "proven": "NOT ALL MODES: 5 found"}
    (line,) = (line for line in told(modes, lattice) if line.startswith(says[certificate]))
    heading = " ".join(pages.make(result_of(modes, lattice))["widths"].heading)
    assert heading == (line if certificate != "none" else "")
    assert np.all(modes.radius > 0) == (certificate == "proven")


def test_a_pulse_decays_with_its_slowest_mode():
    """Late signals of a chain are that mode alone."""
    lattice = uniform_lattice((3,), 1.0, 0.2)
    modes = pgran.find_modes(lattice, damped=True)
    found = pgran.pulse(lattice, [(0,)], shape="gauss", width=2.0, time=150.0, points=301)
    late = found.time > 110
    wave = np.exp(modes.eigenvalue[np.argmin(modes.width)] * found.time[late])
    basis, signal = np.stack([wave.real, wave.imag], axis=1), found.displacement[late, 0]
    left = signal - basis @ np.linalg.lstsq(basis, signal, rcond=None)[0]
    assert np.linalg.norm(left) < 1e-5 * np.linalg.norm(signal)


def test_widths_of_samples():
    """Overdamped modes are more than unknowns; P(Gamma) is of those that ring."""
    law = {"shape": (5, 4), "damping": 0.8}
    found = pgran.ensemble("modes", 2, lattice=law, keep="curves", damped=True)
    medium = pgran.Lattice.random(seed=1993, **law)
    modes = pgran.find_modes(medium, damped=True)
    assert found.modes[0] == len(modes.width) > 20
    np.testing.assert_array_equal(found.mode_width[0, : len(modes.width)], modes.width)
    width, localized = found.widths(medium)
    assert len(width) == np.count_nonzero(found.mode_omega > 0)
    assert np.count_nonzero(localized) == 0  # a twentieth of 20 balls


def test_what_is_refused():
    lattice = random_lattice((4, 3))
    with pytest.raises(InputError, match="nothing is damped"):
        pgran.find_modes(dataclasses.replace(lattice, damping=0.0), damped=True)
    with pytest.raises(InputError, match="near one -modes_target, fewer than a quarter"):
        pgran.find_modes(lattice, damped=True, method="eps")
    none = pgran.find_modes(lattice, damped=True, interval=(50.0, 51.0))
    assert told(none, lattice)[0].startswith("0 damped modes")
    with pytest.raises(pgran.PgranError, match="no residues"):
        none.response([0.3])
    with pytest.raises(FileError, match="no modes"):
        pages.make(result_of(none, lattice))


@pytest.mark.parametrize(("last", "proven"), [(0.9, True), (0.9, False), (-1e-3, True)])
def test_rounding_does_not_grow(last, proven):
    """Chains behind a damped ball hold undamped motions: Re s is 0, or 1e-16, of either sign."""
    chains, k = [[0, 1], [1, 2], [2, 3], [0, 4], [4, 5], [5, 6]], [0.8, 0.2, 0.3, 0.5, 0.6, last]
    network = pgran.Network(chains, k, [2, *6 * [0]], damping=0.0, drag=[0, 0.1, *5 * [0]])
    modes = pgran.find_modes(network, damped=True)
    s = modes.eigenvalue
    modes = dataclasses.replace(
        modes, eigenvalue=np.where(abs(s.real) < 1e-14, 4e-17 + 1j * s.imag, s)
    )
    if not proven:
        modes = dataclasses.replace(modes, radius=np.full(len(s), np.nan))
    said, unstable = " ".join(told(modes, network)), last < 0
    assert ("UNSTABLE: growing modes: 1" in said) == np.any(modes.width < 0) == unstable
    assert "to inf, median" in said
    assert "nan" not in said
