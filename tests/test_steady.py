"""The certified steady state: against the dense reference and closed forms."""

import math
import os
from pathlib import Path

import numpy as np
import pytest
from reference import uniform_field
from samples import random_lattice, reference_of, solve, steady, uniform_lattice

LU = "-steady_ksp_type preonly -steady_pc_type lu"
MUMPS = "-steady_pc_factor_mat_solver_type mumps"
POOR = "-steady_ksp_type gmres -steady_pc_type ilu -steady_ksp_max_it 60"
SOLVERS = [
    f"{LU} {MUMPS}",
    f"-steady_pc_type cholesky {MUMPS}",
    "-steady_pc_type lu -steady_pc_factor_mat_solver_type superlu_dist",
    "-steady_ksp_type gmres -steady_pc_type bjacobi -steady_ksp_gmres_restart 200",
]


def assert_certified(states, lattice, sites, tolerance, tiny=0.0):
    """Every bound holds, and every point is as accurate as asked, or marked where it may be tiny.

    The reference's own error is 1e-3 of what rounding adds to any bound: it is the same
    conditioning times a roundoff of extended precision (test_reference.py).
    """
    reference = reference_of(lattice)
    for state in states:
        exact = reference.amplitudes(state.s.imag, sites)
        error = np.abs(state.displacement - exact)
        assert np.all(error <= state.error_bound)
        if state.converged_reason > 0:
            assert np.all(error <= tolerance * np.abs(exact))
        else:
            assert np.abs(exact).min() < tiny


def cases():
    """Lattices of all shapes and laws, frequencies in any order, and solvers."""
    rng, laws = np.random.default_rng(20), ("uniform", "bimodal", "wide")
    shapes = [(9,), (5, 6), (6, 5), (1, 7), (7, 1), (3, 4, 3), (2, 1, 5), (12, 12)]
    for number, shape in enumerate(shapes):
        damping, mass = 10 ** rng.uniform(-6, 0), 10 ** rng.uniform(-1, 1)
        omegas = 10 ** rng.uniform(-2, 0.3, 6) / math.sqrt(mass)
        last = tuple(n - 1 for n in shape)
        sites = [(0,) * len(shape), last, last, tuple(n // 2 for n in shape)]
        lattice = random_lattice(shape, number, damping, mass, laws[number % 3])
        yield lattice, omegas, sites, 10 ** rng.uniform(-8, -1), ""
    lattice, sites = random_lattice((9, 10), 8), [(3, 4), (8, 0)]
    for options in SOLVERS:
        yield lattice, [0.5, 0.55, 1.3, 0.9, 0.9], sites, 1e-4, options


@pytest.mark.parametrize(("lattice", "omegas", "sites", "tolerance", "options"), list(cases()))
def test_what_is_certified_is_right(
    comm, lattice, omegas, sites, tolerance, options, solver_options
):
    """Only amplitudes below 1e-17 may miss the tolerance, but must say so."""
    solver_options(options)
    states, _ = solve(lattice, omegas, sites, comm, tolerance)
    assert_certified(states, lattice, sites, tolerance, tiny=1e-17)


@pytest.mark.parametrize("shape", [(40,), (15, 10), (1, 8), (8, 1), (6, 5, 4)])
def test_uniform_lattice(comm, shape):
    """The closed form, within the bound of the whole field."""
    arguments = uniform_lattice(shape), [0.02, 0.71, 1.1, 1.5], [], comm, 1e-9
    states, fields = solve(*arguments, whole_field=True)
    for state, field in zip(states, fields, strict=True):
        assert state.converged_reason > 0
        if field is not None:
            exact = uniform_field(shape, 0.25, 1.0, 0.003, state.s.imag)
            assert np.abs(field - exact).max() <= 1e-12 * max(1.0, np.abs(exact).max())
            error = np.linalg.norm((field - exact).astype(complex))
            assert error <= state.field_bound <= 1e-9 * np.linalg.norm(field)


def test_mumps_solves_for_all_detectors_at_once(comm, solver_options):
    """Each amplitude and adjoint with its own right-hand side: nothing is left to iterate."""
    solver_options(MUMPS)
    with steady(random_lattice((9, 10), 8), [(3, 4), (8, 0), (0, 9)], comm) as (_, solver):
        for omega in (0.5, 0.7):
            assert solver.solve(1j * omega).iterations == 0
            for system in (solver.primal, *solver.adjoints):
                assert system.norm <= 1e-13 * system.rhs.norm()


@pytest.mark.parametrize("solver", ["richardson", "bcgs"])
@pytest.mark.parametrize("damping", [0.003, 0.0])
def test_hopeless_solvers_are_marked(comm, solver, damping, solver_options):
    """And leave no larger residual than no solution at all; what they leave is told."""
    solver_options(f"-steady_ksp_type {solver} -steady_pc_type none -steady_ksp_max_it 1")
    lattice = random_lattice((9, 10), 8, damping)
    states, fields = solve(lattice, [0.1, 0.4, 0.7, 1.0], [3, 4], comm)
    assert all(state.converged_reason <= 0 for state in states)
    for state, field in zip(states, fields, strict=True):
        if field is not None:
            S, f = (x.astype(complex) for x in reference_of(lattice).system(state.s.imag))
            missed, largest = np.linalg.norm(f - S @ field.ravel()), np.linalg.norm(S, np.inf)
            assert missed <= (1 + 1e-12) * np.linalg.norm(f)
            expected = missed / (largest * np.linalg.norm(field) + np.linalg.norm(f))
            assert 0.3 * expected < state.backward_error < 1.01 * expected


@pytest.mark.parametrize(
    ("options", "shape", "damping", "omegas"),
    [
        (POOR, (12, 12), 0.003, np.linspace(0.1, 1.3, 25)),
        ("", (120,), 0.3, np.linspace(0.6, 0.1, 30)),  # at first amplitudes beyond all digits
    ],
)
def test_after_a_failure_the_next_frequency_starts_afresh(
    options, shape, damping, omegas, solver_options
):
    """Though the factors could be reused, it gets what it would get alone."""
    solver_options(options)
    lattice, site = random_lattice(shape, 8, damping), [0] * len(shape)
    choices = {"refresh_iterations": 1000}
    states, _ = solve(lattice, omegas, site, **choices)
    assert_certified(states, lattice, site, 1e-4, tiny=math.inf)
    failed = [i for i, state in enumerate(states[:-1]) if state.converged_reason <= 0]
    assert any(states[i + 1].converged_reason > 0 for i in failed)
    for i in failed[-5:]:
        (alone,), _ = solve(lattice, omegas[i + 1], site, **choices)
        assert alone.displacement[0] == states[i + 1].displacement[0]


def test_a_point_passes_only_if_every_detector_does(comm):
    """Next to the wall the amplitude is known to rounding, at the far end, 1e-30, no digit is."""
    lattice = random_lattice((120,), 4, damping=0.3)
    (state,), _ = solve(lattice, 0.55, [(119,), (1,)], comm)
    assert (state.error_bound <= 1e-4 * np.abs(state.displacement)).tolist() == [True, False]
    assert state.converged_reason <= 0


@pytest.mark.parametrize("options", ["", "-steady_ksp_type preonly", LU, f"{LU} {MUMPS}"])
def test_nothing_passes_on_an_undamped_resonance(comm, options, solver_options):
    """At the double next to an eigenfrequency no digit of the amplitude can be known.

    A rounding of S, 1e-16, is then as large as its smallest eigenvalue, however small the residual.
    In uniform lattices omega = 1/2 is an eigenfrequency exactly, in doubles too, and the wall
    drives its mode: m omega^2 = K0 (4 - 2 cos(p pi/(n+1)) - 2 cos(q pi/(n+1))) is 4 K0 for
    p = q = (n+1)/2, n odd; q is odd where n is not 3, 7, ...
    """
    solver_options(options)
    uneven = random_lattice((8, 9), 3, damping=0.0)
    resonant = np.sqrt(reference_of(uneven).eigenvalues()[[0, 5, 40]])
    uniform = uniform_lattice((5, 5), 0.0625, damping=0.0)
    for lattice, omegas in ((uneven, resonant), (uniform, 0.5)):
        for sites, whole_field in (([0, 0], False), ([], True)):
            states, _ = solve(lattice, omegas, sites, comm, whole_field=whole_field)
            assert [state.s.imag for state in states if state.converged_reason > 0] == []


@pytest.mark.parametrize("damping", [0.003, 0.0])
def test_memory_stays_flat(damping):
    """Leaked by each solve a vector of 1000 balls would be 2 MB, a matrix by each solver 2 MB."""
    lattice, resident = random_lattice((5, 200), damping=damping), []
    for _ in range(25):
        solve(lattice, np.linspace(0.6, 0.6002, 5), [(2, 3), (4, 5)], refresh_iterations=5)
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        resident.append(pages * os.sysconf("SC_PAGE_SIZE"))
    assert resident[-1] - resident[4] < 1e6
