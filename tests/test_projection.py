"""Projections of driven states on normal modes."""

import dataclasses

import numpy as np
import pytest
from mpi4py import MPI
from samples import random_lattice, reference_of

from pgran.command.resolve import resolve
from pgran.experiments.modes.projection import project, which_modes
from pgran.experiments.modes.scene import find_modes
from pgran.run.crew import Crew
from pgran.run.options import read_words

OMEGAS = np.array([0.02, 0.31, 0.6, 0.93, 1.3])


def projected(lattice, comm, which=None, omegas=OMEGAS, **choices):
    """A projection, and the shapes of the modes it is on, a row each, on all ranks."""
    with Crew(comm, 1) as crew:
        found = comm.bcast(project(lattice, omegas, crew, which, **choices))
        modes = comm.bcast(find_modes(lattice, crew, **(which or {}), shapes=True))
    return found, modes.vector.reshape(len(modes.omega), lattice.size)


@pytest.mark.parametrize(
    ("shape", "damping"), [((9, 8), 0.0), ((4, 5, 3), 0.003), ((12,), 0.03), ((9, 8), 0.03)]
)
def test_every_mode_obeys_its_equation(shape, damping, world):
    """(lambda_i - m omega^2) c_i + i omega beta f_i^T C A = f_i^T f, and A = sum c_i f_i."""
    lattice = random_lattice(shape, seed=6, damping=damping, mass=1.3)
    found, F = projected(lattice, world, error_tolerance=1e-8)
    reference = reference_of(lattice)
    assert found.failures == 0
    assert found.count_expected == lattice.size
    for omega, c in zip(OMEGAS, found.coefficient, strict=True):
        A, exact, (_, f) = F.T @ c, reference.solve(omega), reference.system(omega)
        assert np.linalg.norm(A - exact) <= 1e-8 * np.linalg.norm(exact)
        left = lattice.mass * (found.mode_omega**2 - omega**2) * c
        left += 1j * omega * damping * F @ (reference.C @ A)
        assert np.abs(left - F @ f).max() <= 1e-10 * np.linalg.norm(c)


@pytest.mark.parametrize("tolerance", [1e-2, 1e-6])
def test_error_bounds_hold(tolerance, world, solver_options):
    """By a poor solver, whose errors exceed rounding; units of two frequencies, any ranks."""
    solver_options("-steady_pc_type jacobi")
    lattice, omegas = random_lattice((6, 5), seed=2), np.linspace(0.1, 1.2, 128)
    found, F = projected(lattice, world, omegas=omegas, error_tolerance=tolerance)
    alone, _ = projected(lattice, MPI.COMM_SELF, omegas=omegas, error_tolerance=tolerance)
    np.testing.assert_array_equal(found.coefficient, alone.coefficient)
    ratios, reference = [], reference_of(lattice)
    assert found.failures == 0
    for omega, c, bound in zip(omegas, found.coefficient, found.error_bound, strict=True):
        A = reference.solve(omega).astype(complex)
        error = np.linalg.norm(c - F @ A)
        assert error <= bound + 1e-12 * np.linalg.norm(A)
        assert bound <= tolerance * np.linalg.norm(A)
        ratios += [bound / error] if error > 1e-12 * np.linalg.norm(A) else []
    assert np.median(ratios) < 1000


def test_frequencies_that_miss_their_accuracy_are_marked(world, solver_options):
    """Modes that are missing count beside them."""
    solver_options("-steady_ksp_type gmres -steady_pc_type none -steady_ksp_max_it 1")
    found, _ = projected(random_lattice((6, 5)), world)
    assert np.all(found.converged_reason <= 0)
    for certified, more in ((True, 0), (False, 1), (False, 3)):
        expected = found.count_expected + more * (more > 1)
        shown = dataclasses.replace(found, count_certified=certified, count_expected=expected)
        assert shown.failures == len(OMEGAS) + more


@pytest.mark.parametrize("which", [{"interval": (0.4, 0.7)}, {"targets": OMEGAS, "count": 4}])
def test_part_of_the_modes_is_part_of_the_projection(which, world):
    """The dominant one is that of the largest coefficient; of none there is none."""
    lattice = random_lattice((9, 9), seed=1)
    (part, _), (whole, _) = (projected(lattice, world, modes) for modes in (which, None))
    none, _ = projected(lattice, world, {"interval": (7.0, 8.0)})
    assert none.coefficient.shape == (len(OMEGAS), 0)
    assert np.all(none.dominant == -1)
    assert len(part.mode_omega) == part.count_expected < lattice.size
    place = np.argmin(np.abs(whole.mode_omega - part.mode_omega[:, None]), axis=1)
    assert np.abs(part.mode_omega - whole.mode_omega[place]).max() < 1e-12
    expected = whole.coefficient[:, place]
    assert np.abs(part.coefficient - expected).max() <= 1e-9 * np.abs(expected).max()
    assert np.array_equal(part.dominant, np.argmax(np.abs(part.coefficient), axis=1))


def test_which_modes_are_projected_on():
    """All of a small lattice; else, or where a number is given, those near each frequency."""
    for balls, words, expected in (
        (3600, "", {}),
        (3601, "", {"targets": OMEGAS, "count": 60}),
        (3600, "-modes_count 7", {"targets": OMEGAS, "count": 7}),
        (3601, "-modes_count 7 -modes_target .5", {"targets": (0.5,), "count": 7}),
        (9, "-modes_count 7 -modes_target .5,.9", {"targets": (0.5, 0.9), "count": 7}),
        (3601, "-modes_omega_min .1 -modes_omega_max .2", {"interval": (0.1, 0.2)}),
    ):
        options = resolve(read_words(["-scene", "projection", *words.split()]))
        assert which_modes(options, balls, OMEGAS) == expected


def test_dominant_mode_follows_the_drive(world):
    """Slope 1.00 +- .03 between .1 and .9 omega_mx (the paper's figure maxci)."""
    omegas = np.linspace(0.1, 0.9, 201)
    found, _ = projected(random_lattice((20, 20)), world, omegas=omegas)
    slope, _ = np.polyfit(omegas, found.mode_omega[found.dominant], 1)
    assert abs(slope - 1) <= 0.03
