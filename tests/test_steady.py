"""The driven steady state: closed forms, poor solvers, failures; test_guarantees.py has bounds."""

import math
import os
from pathlib import Path

import numpy as np
import pytest
from petsc4py import PETSc
from reference import uniform_field
from samples import SOLVERS, random_lattice, reference_of, solve, steady, uniform_lattice

from pgran.command.resolve import resolve
from pgran.errors import InputError
from pgran.run.agreement import met_by_all
from pgran.run.options import read_words

LU = "-steady_ksp_type preonly -steady_pc_type lu"
MUMPS = "-steady_pc_factor_mat_solver_type mumps"
POOR = "-steady_ksp_type gmres -steady_pc_type ilu -steady_ksp_max_it 60"


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
    failed = [i for i, state in enumerate(states[:-1]) if state.converged_reason <= 0]
    assert any(states[i + 1].converged_reason > 0 for i in failed)
    for i in failed[-5:]:
        (alone,), _ = solve(lattice, omegas[i + 1], site, **choices)
        assert alone.displacement[0] == states[i + 1].displacement[0]


# m omega^2 = 2 k is an eigenvalue of these lattices exactly, in doubles too.
SINGULAR = [((1,), 0.5, 1.0), ((2, 2), 0.5, 1.0), ((5, 5, 5), 1.5, 3.0)]


@pytest.mark.parametrize("whole_field", [False, True])
@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("case", SINGULAR, ids=str)
def test_a_singular_frequency_spoils_no_other_one(case, solver, whole_field, solver_options):
    """Each later frequency has what it has alone, bit for bit; by a direct solver it is good."""
    solver_options(SOLVERS[solver])
    (shape, stiffness, omega), together = case, []
    lattice = uniform_lattice(shape, stiffness, damping=0.0)
    sites = [] if whole_field else (0,) * len(shape)
    with steady(lattice, sites, whole_field=whole_field) as (_, opened):
        for part in (1.0, 0.8, 1.0, 1.02):
            opened.restart()
            together.append(opened.solve(1j * omega * part))
    for state in together:
        (alone,), _ = solve(lattice, state.s.imag, sites, whole_field=whole_field)
        good = state.converged_reason > 0
        assert (alone.converged_reason > 0) == good
        if good:
            assert np.array_equal(alone.displacement, state.displacement)
            assert np.array_equal(alone.error_bound, state.error_bound)
            assert alone.field_bound == state.field_bound or not whole_field
        if state.s.imag == omega:
            assert not good
        elif solver in ("default", "preonly, lu", "mumps"):  # SuperLU_DIST exchanges no pivots
            assert good


@pytest.mark.parametrize("options", ["", LU, f"{LU} {MUMPS}"])
def test_nothing_passes_on_an_undamped_resonance(comm, options, solver_options):
    """At the double next to an eigenfrequency no digit of the amplitude can be known.

    A rounding of S, 1e-16, is then as large as its smallest eigenvalue, however small the residual.
    """
    solver_options(options)
    uneven = random_lattice((8, 9), 3, damping=0.0)
    resonant = np.sqrt(reference_of(uneven).eigenvalues()[[0, 5, 40]])
    for sites, whole_field in (([0, 0], False), ([], True)):
        states, _ = solve(uneven, resonant, sites, comm, whole_field=whole_field)
        assert [state.s.imag for state in states if state.converged_reason > 0] == []


def test_a_point_passes_only_if_every_detector_does(comm):
    """Next to the wall the amplitude is known to rounding, at the far end, 1e-30, no digit is."""
    lattice = random_lattice((120,), 4, damping=0.3)
    (state,), _ = solve(lattice, 0.55, [(119,), (1,)], comm)
    assert (state.error_bound <= 1e-4 * np.abs(state.displacement)).tolist() == [True, False]
    assert state.converged_reason <= 0


@pytest.mark.parametrize("options", ["", "-steady_ksp_type preonly"])
def test_an_error_of_petsc_is_the_mark_of_its_point(
    comm, options, solver_options, caplog, monkeypatch
):
    """It ends no sweep, is told once, and the next point is solved."""
    solver_options(options)
    lattice, bad = random_lattice((8, 9), 3), (2, 3, 5)
    omegas = np.linspace(0.3, 0.9, 7)
    right, _ = solve(lattice, omegas, (3, 3), comm)
    with steady(lattice, (3, 3), comm) as (_, solver):
        factor = solver._factor

        def failing():
            if number in bad:
                raise PETSc.Error(76)  # an error in an outside package
            return factor()

        monkeypatch.setattr(solver, "_factor", failing)
        for number, omega in enumerate(omegas):
            state = solver.solve(1j * omega)
            assert (state.converged_reason > 0) == (number not in bad)
            if number in bad:
                assert np.isnan(state.displacement[0])
                assert np.isnan(solver.field.getArray()).all()
                assert state.error_bound[0] == math.inf
            else:
                assert abs(state.displacement[0] - right[number].displacement[0]) <= 1e-10
    assert len([r for r in caplog.records if "is marked: PETSc" in r.getMessage()]) == 1


def test_an_error_that_one_rank_alone_meets(world):
    """It is known from one that all ranks meet, and then ends the run."""
    assert met_by_all(world)
    apart = world.Dup()  # what one rank has begun here the others never end
    if world.size > 1 and world.rank == 0:
        assert not met_by_all(apart)


ENDLESS = [
    "-steady_pc_type icc -steady_pc_factor_zeropivot 0",
    "-steady_pc_factor_shift_type POSITIVE_DEFINITE -steady_pc_factor_zeropivot 1e-20",
    "-steady_sub_pc_type icc -steady_sub_pc_factor_zeropivot 0",
    "-steady_pc_type asm -steady_sub_pc_factor_zeropivot 0",
]
UNSHIFTED = "-steady_pc_type icc -steady_pc_factor_shift_type none -steady_pc_factor_zeropivot 0"


@pytest.mark.parametrize("words", ENDLESS)
def test_what_petsc_would_never_end_is_refused(words):
    """A shift of pivots by nothing; other thresholds, and no shift, pass."""
    with pytest.raises(InputError, match="may never end"):
        resolve(read_words(["-scene", "response", *words.split()]))
    for good in (f"{words.rsplit(maxsplit=1)[0]} 1e-13", UNSHIFTED):
        resolve(read_words(["-scene", "response", *good.split()]))


@pytest.mark.parametrize("damping", [0.003, 0.0])
def test_memory_stays_flat(damping):
    """Leaked by each solve a vector of 1000 balls would be 2 MB, a matrix by each solver 2 MB."""
    lattice, resident = random_lattice((5, 200), damping=damping), []
    for _ in range(25):
        solve(lattice, np.linspace(0.6, 0.6002, 5), [(2, 3), (4, 5)], refresh_iterations=5)
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        resident.append(pages * os.sysconf("SC_PAGE_SIZE"))
    assert resident[-1] - resident[4] < 1e6
