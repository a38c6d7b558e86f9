"""The number of modes below frequencies, against all modes by dense linear algebra."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from mpi4py import MPI
from network_samples import random_network
from reference import uniform_frequencies
from samples import assert_same, islands, random_lattice, reference_of, run_scene, uniform_lattice

import pgran
from pgran.command.resolve import resolve
from pgran.driven.counting import ModeCounter
from pgran.experiments.modes import density
from pgran.medium.base import record_of
from pgran.run.crew import Crew
from pgran.run.options import read_words


def check(found, squares):
    """Assert that all counts are certified and right, moved only where a mode is next to them."""
    omega = np.sign(squares) * np.sqrt(np.abs(squares))
    omega[np.abs(squares) < 1e-13 * np.abs(squares).max()] = 0.0
    assert found.certified.all()
    assert found.failures == 0
    expected = [np.count_nonzero(omega < limit) for limit in found.omega - found.margin]
    assert found.count.tolist() == expected
    apart = np.abs(squares - found.omega[:, None] ** 2).min(axis=1)  # from the nearest mode
    assert np.all(apart[found.margin > 0] <= 0.05 * np.abs(squares).max() / len(squares))
    widths = np.diff(found.omega) / found.omega_mx
    assert np.sum(found.density * widths) * found.balls == pytest.approx(np.ptp(found.count))


@pytest.mark.parametrize(
    "lattice",
    [
        random_lattice((13, 12), seed=1, mass=1.7), random_lattice((11, 6), law="wide"),
        random_lattice((40,)), random_lattice((4, 5, 3)), random_lattice((1, 1)),
        random_lattice((2, 3, 15), law="bimodal"), islands((12, 13), 3),
    ],
    ids=lambda lattice: "x".join(map(str, lattice.shape)),
)  # fmt: skip
def test_counts_are_those_of_the_dense_spectrum(lattice):
    squares = reference_of(lattice).eigenvalues() / lattice.mass
    top = 1.1 * np.sqrt(squares[-1])
    check(pgran.count_modes(lattice, np.linspace(0, top, 15)), squares)


@pytest.mark.parametrize("shape", [(9, 9), (13,), (4, 5, 6)])
def test_at_modes_that_many_share(shape):
    """At a mode, and at those equal to it but for rounding, they are not counted."""
    lattice = uniform_lattice(shape, mass=0.8)
    exact = uniform_frequencies(shape, 0.25, 0.8)
    some = exact[:: len(exact) // 8]
    omegas = np.unique(np.concatenate([some, 0.999 * some]).round(12))
    found = pgran.count_modes(lattice, omegas)
    check(found, exact**2)
    at = np.abs(omegas[:, None] - exact).min(axis=1) < 1e-11
    assert at.sum() >= 8
    assert np.all(found.margin[at] > 0)
    assert found.count[at].tolist() == [np.sum(exact < w - 1e-9) for w in omegas[at]]


@pytest.mark.parametrize("seed", range(3))
def test_networks_that_are_damped(seed):
    """Of all unstable ones `guarantees` counts; what damps has no effect."""
    network = dataclasses.replace(random_network(seed).network, damping=0.1, drag=0.1, loss=0.3)
    squares = np.linalg.eigvalsh(network.restoring_forces(np.eye(network.size))) / network.mass
    top = np.sqrt(max(squares[-1], 1e-12))
    found = pgran.count_modes(network, top * np.array([0.0, 0.1, 0.35, 0.8, 1.5]))
    assert found.balls == len(network.free)
    check(found, squares)


WEAK = [(weak, first) for weak in (-1e-5, -1e-7, -1e-9) for first in (0.0, 1e-5)]


@pytest.mark.parametrize(
    ("bonds", "squares", "omegas", "counts"),
    [
        *(({(0, 1): 1, (2, 3): weak}, [weak, 1], [w, 2e-4, 2], [1, 1, 2]) for weak, w in WEAK),
        ({(0, 1): -0.2, (2, 3): 1, (3, 4): 1}, [-0.2, 0, 1, 3], [0, 0.5, 1.9, 2], [1, 2, 4, 4]),
    ],
)
def test_modes_hardly_below_zero_and_at_zero(bonds, squares, omegas, counts):
    """The former lie below all frequencies, and are counted at 0 even if that is not asked for.

    Of the latter nothing tells on which side of 0 they are, where others are unstable: they are not
    counted there, nor as unstable.
    """
    held = [0, 1, 0, 1] if len(bonds) == 2 else [0, 1, 0, 0, 0]
    network = pgran.Network(list(bonds), list(bonds.values()), held, damping=0.0)
    found = pgran.count_modes(network, omegas)
    check(found, np.array(squares, dtype=float))
    assert found.count.tolist() == counts
    assert found.unstable == 1
    if 0 in squares:
        assert 0 < found.margin[0] < 1e-5


def test_weyls_law_of_long_waves():
    """What the lattice has more, A (omega / c)^4 / (64 pi), is added; the rest fluctuates."""
    lattice = uniform_lattice((60, 60))
    waves = np.linspace(0.2, 1.0, 15)
    omegas = 0.5 * waves
    found = pgran.count_modes(lattice, omegas)
    expected = 61**2 * waves**2 / (4 * np.pi) - 61 * waves / np.pi
    np.testing.assert_allclose(found.weyl(record_of(lattice), omegas), expected, rtol=1e-12)
    difference = found.count - expected - 61**2 * waves**4 / (64 * np.pi)
    assert np.abs(difference).max() < 2 * np.sqrt(61 * waves[-1] / np.pi)
    assert abs(difference.mean()) < 1
    for other in (random_lattice((4, 4)), uniform_lattice((5,))):
        assert found.weyl(record_of(other), omegas) is None


def test_any_ranks_and_units_of_measure(world):
    lattice = random_lattice((9, 8), seed=6)
    omegas = np.linspace(0, 1.2, 9)
    found = pgran.count_modes(lattice, omegas)
    with Crew(MPI.COMM_SELF, 1) as alone:
        assert_same(found, density.count_modes(lattice, omegas, alone))
    with Crew(world, 1) as crew:
        assert (density.count_modes(lattice, omegas, crew) is None) == (world.rank > 0)
    other = pgran.Lattice(tuple(1e120 * k for k in lattice.stiffness), 1e120, 0.0, kmax=0.25e120)
    assert np.array_equal(pgran.count_modes(other, omegas).count, found.count)


def test_counts_that_nothing_certifies(monkeypatch):
    """They are marked, and so is the run."""
    sure = ModeCounter.below

    def unsure(self, shift, clearance):
        return None if 0.1 < shift < 0.3 else sure(self, shift, clearance)

    monkeypatch.setattr(ModeCounter, "below", unsure)
    monkeypatch.setattr(density, "CLEARANCES", (0.01,))
    monkeypatch.setattr(density, "ATTEMPTS", 3)
    lattice = random_lattice((5, 4))
    mass = lattice.in_own_unit()[0].mass
    found = pgran.count_modes(lattice, np.sqrt(np.array([0.05, 0.2, 0.5, 0.8]) / mass))
    assert found.certified.tolist() == [True, False, True, True]
    assert found.count[1] == -1
    assert found.failures == 1
    assert np.isnan(found.density).tolist() == [True, True, False]
    said = " ".join(density.summary(SimpleNamespace(density=found)))
    assert "NOT CERTIFIED: 1 of the counts" in said


@pytest.mark.parametrize(
    "omegas", [[0.5], [], [[0.1, 0.2]], [0.2, 0.1], [-0.1, 0.1], [0, np.nan], [0.1, 1e200]]
)
def test_frequencies_that_make_no_staircase(omegas):
    message = "too large" if 1e200 in omegas else "two frequencies or more"
    with pytest.raises(pgran.InputError, match=message):
        pgran.count_modes(random_lattice((4, 4)), omegas)


def test_the_scene_and_its_words(world):
    """By default from 0 to above all modes."""
    words = "-scene modes -lattice_shape 6,5 -modes_density 7 -output_progress none"
    records = run_scene(resolve(read_words(words.split())), world)
    if world.rank == 0:
        _, found = records
        assert (found.count[0], found.count[-1], len(found.omega)) == (0, 30, 7)
        line, certified, last = density.summary(SimpleNamespace(density=found))
        assert line.startswith("modes counted below 7 frequencies")
        assert certified == "all counts certified"
        assert last.startswith("modes below omega = 0: 0; below ")
    found = pgran.count_modes(uniform_lattice((3,)), np.sqrt([0.1, 0.5, 0.6]))
    assert found.margin.astype(bool).tolist() == [False, True, False]
    for unstable, number in ((2, "2"), (-1, "unknown")):
        shown = dataclasses.replace(found, unstable=unstable)
        said = list(density.summary(SimpleNamespace(density=shown)))
        assert said[2].startswith("a mode is too close to 1 of the frequencies")
        assert said[3] == f"UNSTABLE: modes with omega^2 < 0, their number is {number}"
