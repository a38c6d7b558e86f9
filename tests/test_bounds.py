"""Bounds of driven amplitudes on and right of the imaginary axis, against extended precision."""

import math
from itertools import product

import mpmath
import numpy as np
import pytest
from reference import exact_amplitudes
from samples import SOLVERS, needs_klu, random_lattice, reference_of, solve, steady, uniform_lattice

from pgran.medium.lattice import Lattice


def norm_of_inverse(lattice, s):
    """|S(s)^-1|_2."""
    S, _ = reference_of(lattice).system(-1j * s)
    return 1 / np.linalg.svd(S.astype(complex), compute_uv=False)[-1]


@pytest.mark.parametrize("limit", [0, 1000])
@pytest.mark.parametrize("solver", SOLVERS)
def test_bounds_hold_for_any_s(solver, limit, solver_options):
    """No bound is exceeded and nothing wrong passes, by good and poor solvers, fresh or stale.

    test_guarantees.py has harder lattices, on the imaginary axis.
    """
    solver_options(SOLVERS[solver])
    rng, choices = np.random.default_rng(1), {"refresh_iterations": limit, "whole_field": True}
    for shape, damping in product(((1,), (9,), (5, 6), (2, 3, 2)), (0.0, 0.01, 1.0)):
        lattice, site = random_lattice(shape, 1, damping, 2.0, "wide"), tuple(n // 2 for n in shape)
        z = 10 ** rng.uniform(-2, 0.5) * np.exp(0.5j * math.pi * rng.uniform(-1, 1))
        with steady(lattice, site, **choices) as (operators, opened):
            for s in (z, 1.01 * z, z.conjugate(), abs(z), 1.1j * abs(z)):
                state, exact = opened.solve(s), reference_of(lattice).field(-1j * s)
                error, size = abs(state.displacement[0] - exact[site]), abs(exact[site])
                missed = (operators.layout.field(opened.field) - exact).astype(complex)
                assert not error > state.error_bound[0]
                assert not np.linalg.norm(missed) > state.field_bound
                if state.converged_reason > 0:
                    assert error <= 1e-4 * size
                    assert np.linalg.norm(missed) <= 1e-4 * np.linalg.norm(exact.astype(complex))
                else:
                    assert solver not in ("default", "mumps", "superlu_dist")


@pytest.mark.parametrize("damping", [0.0, 1e-8])
@pytest.mark.parametrize("digits", [1, 3])
def test_an_eigenvalue_just_beyond_what_a_count_excludes(damping, digits):
    """The norm of the inverse holds where the nearest eigenvalue is hardly farther than counted."""
    lattice = random_lattice((5, 6), 3, damping)
    eigenvalue = reference_of(lattice).eigenvalues()[9]
    with steady(lattice, [[2, 2]]) as (operators, solver):
        distance = 0.0
        for _ in range(5):  # the first guess of the distance depends a little on the frequency
            s = 1j * math.sqrt(eigenvalue + distance)
            solver.solve(s)
            distance = 1.02 * 10**-digits * solver.bounds.scale / operators.size
        exact = norm_of_inverse(lattice, s)
        assert exact <= solver.bounds.inverse_norm <= 1.5 * exact


@pytest.mark.parametrize("damping", [0.0, 0.05])
@pytest.mark.parametrize("shape", [(7,), (4, 5), (2, 3, 2)])
def test_norm_of_the_inverse_right_of_the_axis(comm, shape, damping):
    """It needs no damping, however ranks share the lattice; none could be smaller without springs.

    There S = s beta C + s^2 m, whose smallest value is |s| |beta lambda_min(C) + s m|.
    """
    rng = np.random.default_rng(5)
    for stiffness in (0.2, 0.0):
        lattice = uniform_lattice(shape, stiffness, damping)
        with steady(lattice, [0] * len(shape), comm) as (_, solver):
            for s in [0.3, 2.0, *(rng.uniform(0.01, 1, 8) + 1j * rng.uniform(-2, 2, 8))]:
                state = solver.solve(s)
                assert state.converged_reason > 0 or not stiffness  # nothing moves there
                exact, bound = norm_of_inverse(lattice, s), solver.bounds.inverse_norm
                assert exact <= (1 + 1e-12) * bound
                assert stiffness or s.imag or bound <= (1 + 1e-12) * exact


@needs_klu
def test_bounds_are_reached(solver_options):
    """One ball on its resonance, solved with the conjugate matrix: no bound could be smaller."""
    solver_options(SOLVERS["preonly, klu"])
    lattice = uniform_lattice((1, 1), 0.125, damping=0.1, mass=2.0)
    ((state,), (field,)) = solve(lattice, [0.5], [[0, 0]], whole_field=True)
    exact = reference_of(lattice).field(0.5)
    missed = abs(exact - field)[0, 0]
    assert missed <= state.field_bound <= 1.02 * missed
    error = abs(exact[0, 0] - state.displacement[0])
    assert error <= state.error_bound[0] <= 1.03 * error


@pytest.mark.parametrize(("shape", "damping"), [((40,), 0.3), ((7, 8), 0.02), ((4, 3, 5), 0.003)])
def test_residuals_are_no_larger_than_said(comm, shape, damping):
    """In extended precision; and what rounding does is told from |f| + |S| |A|."""
    lattice, site = random_lattice(shape, 3, damping), tuple(n // 2 for n in shape)
    reference, loose, axis = reference_of(lattice), [], 1j * np.linspace(0.05, 1.4, 14)
    with steady(lattice, site, comm) as (operators, solver):
        primal, bounds, terms = solver.primal, solver.bounds, operators.f.duplicate()
        for s in [*axis, *(axis[::3] + 0.4), *(0.1 - axis[::5]), 0.7]:
            solver.solve(s)
            rounding = bounds.rounding(primal.solution)
            terms.setArray(rounding)
            fields = (operators.layout.field(x) for x in (primal.solution, terms))
            A, sizes = (comm.bcast(field).ravel() for field in fields)
            S, f = reference.system(-1j * s)
            # the parts of S apart: those of its diagonal may cancel
            parts = np.abs(reference.K) + abs(s) * damping * np.abs(reference.C)
            exact = np.abs(f) + parts @ np.abs(A) + abs(s) ** 2 * np.abs(A)
            assert np.all(np.abs(sizes / exact - 1) < 1e-12)
            assert np.abs(S).sum(axis=1).max() <= bounds.scale
            missed = np.sqrt(np.sum(np.abs(f - S @ A) ** 2))
            loose.append(bounds.primal_residual(primal, rounding) / missed)
        terms.destroy()
    assert min(loose) >= 1
    assert np.median(loose) < 100


@pytest.mark.parametrize("damping", [0.0, 1e-3])
@pytest.mark.parametrize("axes", [1, 2, 3])
def test_roundings_that_all_go_one_way(axes, damping):
    """One ball: the sum of its bonds loses each of those that are less than half a roundoff."""
    lost = 0.49 * np.finfo(float).eps
    stiffness = [np.full([1 + (a == axis) for a in range(axes)], lost) for axis in range(axes)]
    stiffness[0].flat[-1] = 1.0
    for omega in (1e-3, 0.9, 0.9999, 1.5):
        (state,), _ = solve(Lattice(stiffness, 1.0, damping), omega, [0] * axes, tolerance=1e-3)
        (exact,) = exact_amplitudes(stiffness, 1.0, damping, omega, [0] * axes)
        error = abs(mpmath.mpc(complex(state.displacement[0])) - exact)
        assert error <= state.error_bound[0] <= 1e-3 * abs(exact)


def test_what_passes_is_accurate_wherever_within_its_bound_the_truth_lies(solver_options):
    """Relative to the true amplitude, not to the one found, which makes half of it of a half."""
    solver_options("-steady_ksp_type bcgs -steady_pc_type ilu -steady_ksp_rtol 1e-2")
    lattice, omegas = random_lattice((7, 8), 3, damping=0.03), np.linspace(0.1, 1.3, 50)
    states, fields = solve(lattice, omegas, [3, 4], tolerance=0.5, whole_field=True)
    for state, field in zip(states, fields, strict=True):
        assert state.converged_reason > 0
        sizes = abs(state.displacement[0]), np.linalg.norm(field)
        for size, bound in zip(sizes, (state.error_bound[0], state.field_bound), strict=True):
            assert bound <= 0.5 * (size - bound)


def test_what_is_missed_is_factored_anew_or_refined_or_marked(solver_options):
    """Three iterations with a stale factorization solve nothing here."""
    solver_options("-steady_ksp_max_it 3")
    lattice, choices = random_lattice((7, 6), 3), {"tolerance": 1e-6, "refresh_iterations": 1000}
    with steady(lattice, [3, 3], **choices) as (_, solver):
        assert all(solver.solve(1j * omega).converged_reason > 0 for omega in (0.5, 1.1, 0.2))
        assert solver.factorizations == 3
    solver_options("-steady_pc_type ilu -steady_ksp_rtol 1e-2 -steady_ksp_max_it 200")
    for tolerance, good in (1e-11, True), (1e-17, False):
        (state,), _ = solve(lattice, 1.1, [3, 3], tolerance=tolerance)
        assert (state.converged_reason > 0) == good
        assert state.error_bound[0] <= 1e-11 * abs(state.displacement[0])
