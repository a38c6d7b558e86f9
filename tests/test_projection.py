"""Projections of driven states on normal modes."""

import dataclasses

import numpy as np
import pytest
from mpi4py import MPI
from reference import Reference
from samples import paper_lattice, random_lattice

from pgran.command.resolve import resolve
from pgran.files.reading import read_words
from pgran.parallel.crew import Crew
from pgran.scenes.modes import find_modes
from pgran.scenes.projection import project, which_modes

OMEGAS = np.array([0.02, 0.31, 0.6, 0.93, 1.3])


@pytest.fixture
def crew(world):
    with Crew(world, 1) as crew:
        yield crew


def projected(lattice, crew, which=None, omegas=OMEGAS, **keywords):
    """A projection and the modes it is on, on all ranks."""
    found = project(lattice, omegas, crew, which, **keywords)
    modes = find_modes(lattice, crew, **(which or {}), shapes=True)
    return crew.world.bcast(found), crew.world.bcast(modes)


@pytest.mark.parametrize("damping", [0.003, 0.03])
@pytest.mark.parametrize("shape", [(9, 8), (4, 5, 3), (12,)])
def test_every_mode_obeys_its_equation(shape, damping, crew):
    """(lambda_i - m omega^2) c_i + i omega beta f_i^T C A = f_i^T f, and A = sum c_i f_i."""
    lattice = random_lattice(shape, seed=6, damping=damping, mass=1.3)
    found, modes = projected(lattice, crew, error_tolerance=1e-8)
    reference = Reference(lattice.stiffness, lattice.mass, damping)
    F = modes.vector.reshape(lattice.balls, -1)
    assert found.failures == 0
    assert found.count_expected == lattice.balls
    for omega, c in zip(OMEGAS, found.coefficient, strict=True):
        A = F.T @ c
        f = reference.drive_K + 1j * omega * damping * reference.drive_C
        left = lattice.mass * (found.mode_omega**2 - omega**2) * c
        left += 1j * omega * damping * F @ (reference.C @ A)
        np.testing.assert_allclose(left, F @ f, rtol=0, atol=1e-10 * np.linalg.norm(f))
        exact = reference.solve(omega)
        assert np.linalg.norm(A - exact) <= 1e-8 * np.linalg.norm(exact)


@pytest.mark.parametrize("tolerance", [1e-2, 1e-6])
def test_error_bounds_hold(tolerance, crew, solver_options):
    """By a poor solver, whose errors are more than rounding; units of two frequencies."""
    solver_options("-steady_pc_type jacobi")
    lattice, omegas = random_lattice((6, 5), seed=2), np.linspace(0.1, 1.2, 128)
    found, modes = projected(lattice, crew, omegas=omegas, error_tolerance=tolerance)
    F, ratios = modes.vector.reshape(lattice.balls, -1), []
    assert found.failures == 0
    for omega, c, bound in zip(omegas, found.coefficient, found.error_bound, strict=True):
        A = Reference(lattice.stiffness).solve(omega).astype(complex)
        error = np.linalg.norm(c - F @ A)
        assert error <= bound + 1e-12 * np.linalg.norm(A)
        assert bound <= tolerance * np.linalg.norm(A)
        ratios += [bound / error] if error > 1e-12 * np.linalg.norm(A) else []
    assert len(ratios) > 30
    assert np.median(ratios) < 1000


def test_frequencies_that_miss_their_accuracy_are_marked(crew, solver_options):
    solver_options("-steady_ksp_type gmres -steady_pc_type none -steady_ksp_max_it 1")
    found, modes = projected(random_lattice((6, 5)), crew)
    assert modes.count_certified
    assert np.all(found.converged_reason <= 0)
    assert found.failures == len(OMEGAS)
    missing = dataclasses.replace(found, count_certified=False)
    assert missing.failures == len(OMEGAS) + 1
    missing = dataclasses.replace(missing, count_expected=found.count_expected + 3)
    assert missing.failures == len(OMEGAS) + 3


def test_modes_diagonalise_the_undamped_lattice(crew):
    lattice = random_lattice((7, 9), damping=0.0)
    found, modes = projected(lattice, crew)
    drive = modes.vector.reshape(lattice.balls, -1) @ Reference(lattice.stiffness).drive_K.astype(
        float
    )
    exact = drive / (modes.omega**2 - OMEGAS[:, None] ** 2)
    np.testing.assert_allclose(found.coefficient, exact, atol=1e-9 * np.abs(exact).max())
    bound = found.error_bound[:, None]
    assert np.all(np.abs(found.coefficient - exact) <= bound + 1e-12 * np.abs(exact).max())
    assert np.all(bound <= 1e-4 * np.linalg.norm(exact, axis=1, keepdims=True))
    assert found.failures == 0


@pytest.mark.parametrize(
    "which",
    [{"interval": (0.4, 0.7)}, {"targets": [0.6], "count": 3}, {"targets": OMEGAS, "count": 4}],
)
def test_part_of_the_modes_is_part_of_the_projection(which, crew):
    lattice = random_lattice((9, 9), seed=1)
    part, _ = projected(lattice, crew, which)
    whole, _ = projected(lattice, crew)
    assert 0 < len(part.mode_omega) == part.count_expected < lattice.balls
    place = np.argmin(np.abs(whole.mode_omega - part.mode_omega[:, None]), axis=1)
    np.testing.assert_allclose(part.mode_omega, whole.mode_omega[place], rtol=1e-12)
    expected = whole.coefficient[:, place]
    np.testing.assert_allclose(part.coefficient, expected, atol=1e-9 * np.abs(expected).max())
    largest = np.abs(part.coefficient)[np.arange(len(OMEGAS)), part.dominant]
    np.testing.assert_array_equal(largest, np.abs(part.coefficient).max(axis=1))


def test_which_modes_are_projected_on():
    """All of a small lattice; else, or where a number is given, those near each frequency."""
    for balls, words, expected in (
        (3600, "", {}),
        (3601, "", {"targets": OMEGAS, "count": 60}),
        (3600, "-modes_count 7", {"targets": OMEGAS, "count": 7}),
        (3601, "-modes_count 7 -modes_target .5", {"targets": [0.5], "count": 7}),
        (3601, "-modes_omega_min .1 -modes_omega_max .2", {"interval": (0.1, 0.2)}),
    ):
        options = resolve(read_words(["-scene", "projection", *words.split()]))
        assert which_modes(options, balls, OMEGAS) == expected


def test_no_modes_no_dominant_one(crew):
    found, _ = projected(random_lattice((5, 5)), crew, {"interval": (7.0, 8.0)})
    assert found.coefficient.shape == (len(OMEGAS), 0)
    np.testing.assert_array_equal(found.dominant, -1)


@pytest.mark.parametrize("seed", [0, 1])
def test_dominant_mode_follows_the_drive(seed, crew):
    """Slope 1.00 +- .03 between .1 and .9 omega_mx (the paper's figure maxci)."""
    omegas = np.linspace(0.1, 0.9, 401)
    found = crew.world.bcast(project(paper_lattice(seed), omegas, crew))
    slope = np.polyfit(omegas, found.mode_omega[found.dominant], 1)[0]
    assert abs(slope - 1) <= 0.03


def test_number_of_ranks_does_not_matter(crew):
    lattice = random_lattice((9, 7), seed=9)
    together, _ = projected(lattice, crew, omegas=np.linspace(0.1, 1.2, 70))
    with Crew(MPI.COMM_SELF, 1) as single:
        alone = project(lattice, np.linspace(0.1, 1.2, 70), single)
    np.testing.assert_array_equal(together.coefficient, alone.coefficient)
