"""The number of modes below frequencies, against all modes by dense linear algebra."""

import dataclasses
import re
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
from pgran.experiments.modes.density_moments import Traces
from pgran.medium.base import record_of
from pgran.run.crew import Crew
from pgran.run.options import read_words
from pgran.run.task import carry_out


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


MOMENTS = {"method": "moments", "vectors": 4}


def test_errors_of_estimates_are_their_scatter():
    """Of 200 samples: bins by z of rms 1, counts within four standard errors."""
    bins, counts = [], []
    for seed in range(200):
        lattice = random_lattice((16, 16), seed=seed // 4)
        if seed % 4 == 0:
            exact = np.sqrt(np.linalg.eigvalsh(pgran.matrices(lattice).K.toarray() / lattice.mass))
            omegas = np.linspace(0.2, 1.0, 6) * exact[-1]
        with Traces(lattice, omegas, MPI.COMM_SELF, 4, None, None, seed=seed) as task:
            found = carry_out(task, Crew(MPI.COMM_SELF, 1))
        modes = np.histogram(exact, omegas)[0]
        bins.append((found.modes - modes) / found.modes_error)
        apart = found.count - np.searchsorted(exact, omegas)
        counts.append(apart[:-1] / np.maximum(found.count_error[:-1], 1.0))
    assert 0.9 < np.sqrt(np.mean(np.square(bins))) < 1.15
    assert np.abs(counts).max() < 4


@pytest.mark.parametrize("axis", "xy")
def test_diffusivities_are_those_of_dense_sums(axis, world):
    """d = (pi / 2 omega) tr(D V D V^T) / tr D by all modes and the same kernel; on any ranks."""
    lattice = random_lattice((12, 9), seed=2)
    omegas, choices = np.linspace(0.3, 1.1, 5), MOMENTS | {"vectors": 300, "moments": 40}
    found = []
    for ranks in sorted({1, world.size}):
        with Crew(world, ranks) as crew:
            each = pgran.count_modes(lattice, omegas, crew, diffusivity=axis, **choices)
            found.append(world.bcast(each))
    assert np.allclose(found[0].diffusivity, found[-1].diffusivity, rtol=1e-9, atol=0)
    assert np.allclose(found[0].density, found[-1].density, rtol=1e-9, atol=0)
    A = pgran.matrices(lattice).K.toarray() / lattice.mass
    squares, modes = np.linalg.eigh(A)
    x = np.indices(lattice.shape)["xy".index(axis)].ravel()
    V = modes.T @ (A * (x[:, None] - x)) @ modes
    with Traces(lattice, omegas, MPI.COMM_SELF, 2, 40, None) as task:
        kernel, size = task._weights(task.middle), task.series.a * task.scaled.mass
        angles = np.arccos((size * squares - task.series.b) / 2)
        D = kernel @ np.cos(np.outer(np.arange(40), angles))  # at each middle, of each mode
    exact = np.einsum("wi,ij,wj->w", D, V**2, D) / D.sum(axis=1) * size / (2 * found[0].middle)
    apart = (found[0].diffusivity - exact) / found[0].diffusivity_error
    assert np.abs(apart).max() < 4
    assert np.all(found[0].diffusivity_error < 0.2 * exact)


def test_words_of_estimates():
    lattice, choices = random_lattice((14, 13), seed=2), MOMENTS | {"vectors": 60}
    omegas = np.linspace(0, 1.3, 4)
    found = pgran.count_modes(lattice, omegas, diffusivity="x", moments=24, **choices)
    shown = SimpleNamespace(density=found, medium=record_of(lattice))
    first, errors, *diffusive, last = density.summary(shown)
    assert first.startswith(f"modes below 4 frequencies estimated by {found.moments} moments of 60")
    assert errors.startswith("standard error of a density ")
    assert all("energy diffusivity along x at omega = " in line for line in diffusive)
    assert re.fullmatch("modes below omega = 0: about 0 .*; below 1.3: about 182 .*", last)
    for changes, words in (
        ({"unstable": -1}, "-modes_density_method count says"),
        ({"resolution": 9 * found.resolution}, "of which no error tells: take more"),
        ({"density": 0 * found.density}, "no mode was seen"),
        ({"diffusivity": 99 * found.diffusivity}, "too small, as walls are nearer than"),
        ({"diffusivity": -found.diffusivity}, "no diffusivity is twice its error"),
    ):
        shown.density = dataclasses.replace(found, **changes)
        assert any(words in line for line in density.summary(shown))
    with pytest.raises(pgran.InputError, match=r"so close take 2e\+0. moments, of 1000000 at most"):
        pgran.count_modes(lattice, [0.3, 0.3 + 1e-8], **MOMENTS)
    with pytest.raises(pgran.InputError, match=r"diffusivity z: .*; take x or y"):
        pgran.count_modes(lattice, [0.1, 0.2], diffusivity="z", **MOMENTS)
