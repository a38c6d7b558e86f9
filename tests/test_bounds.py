"""Bounds of driven amplitudes on and right of the imaginary axis, against extended precision."""

import math
from dataclasses import dataclass

import mpmath
import numpy as np
import pytest
from reference import exact_amplitudes
from samples import (
    SOLVERS,
    needs_klu,
    option_values,
    random_case,
    random_lattice,
    reference_of,
    solve,
    steady,
    uniform_lattice,
)

from pgran.physics.lattice import Lattice
from pgran.solve.database import holding

COARSE = "-steady_ksp_type bcgs -steady_pc_type ilu -steady_ksp_rtol 1e-2"


def system(lattice, s):
    """S(s) and f(s) as dense arrays, in extended precision."""
    reference, s = reference_of(lattice), np.clongdouble(s)
    loss = s * np.longdouble(lattice.damping)
    S = reference.K + loss * reference.C
    S[np.diag_indices_from(S)] += np.longdouble(lattice.mass) * s * s
    return S, reference.drive_K + loss * reference.drive_C


def norm_of_inverse(S):
    """|S^-1|_2."""
    return 1 / np.linalg.svd(S.astype(complex), compute_uv=False)[-1]


def eliminate(S, f):
    """Solve S x = f by Gauss in extended precision, with pivoting and one refinement."""
    n = len(f)
    factors, order = S.copy(), np.arange(n)
    for k in range(n):
        p = k + np.argmax(np.abs(factors[k:, k]))
        factors[[k, p]], order[[k, p]] = factors[[p, k]], order[[p, k]]
        factors[k + 1 :, k] /= factors[k, k]
        factors[k + 1 :, k + 1 :] -= np.multiply.outer(factors[k + 1 :, k], factors[k, k + 1 :])
    x = np.zeros_like(f)
    for _ in range(2):
        y = (f - S @ x)[order]
        for k in range(n):
            y[k + 1 :] -= factors[k + 1 :, k] * y[k]
        for k in reversed(range(n)):
            y[k] /= factors[k, k]
            y[:k] -= factors[:k, k] * y[k]
        x = x + y
    return x


@dataclass(frozen=True)
class Point:
    """An amplitude, or a field in the 2-norm: how large, how wrong, what is said of it."""

    what: str
    size: float
    error: float
    bound: float
    good: bool
    tolerance: float


def points(seed, whole_field):
    """Drive a random lattice at some s of its own; yield what came out."""
    case, rng = random_case(seed), np.random.default_rng([7, seed])
    if case.digits > 76:  # constants too far apart for extended precision
        return
    lattice, _ = case.lattice.in_own_unit()
    turn = np.exp(-0.5j * math.pi * rng.choice([0, 0, 1, rng.random(), 1 + rng.random()]))
    omegas, stale = case.omegas, seed % 5 == 0
    if stale:
        omegas = omegas[0] * (1 + 10 ** rng.uniform(-6, -1) * np.arange(4))
    if turn.real < 1e-9:  # s = sigma, without rounding
        turn = complex(0.0, -1.0)
    number = np.ravel_multi_index(tuple(case.sites[0]), lattice.shape)
    choices = {"refresh_iterations": 1000 * stale, "whole_field": whole_field}
    with (
        holding(option_values("" if stale else SOLVERS[case.solver])),
        steady(lattice, case.sites[0], tolerance=case.tolerance, **choices) as (operators, solver),
        np.errstate(all="ignore"),
    ):
        for omega in omegas:
            s = 1j * float(omega) * turn
            state = solver.solve(s)
            found, bound = operators.field(solver.field).ravel(), state.field_bound
            exact = eliminate(*system(lattice, s))
            if not whole_field:
                exact, found, bound = exact[number], state.displacement[0], state.error_bound[0]
            size, error = (float(np.sqrt(np.sum(np.abs(x) ** 2))) for x in (exact, found - exact))
            what = f"case {seed}, {lattice.shape}, {case.solver}, s = {s!r}"
            good = state.converged_reason > 0
            yield Point(what, size, error, float(bound), good, case.tolerance)


@pytest.mark.parametrize(("cases", "whole_field"), [(250, False), (120, True)])
def test_bounds_hold_over_random_cases(world, cases, whole_field):
    """No bound is exceeded, nothing wrong passes, and most bounds are of use."""
    seeds = range(world.rank, cases, world.size)
    found = world.allgather([point for seed in seeds for point in points(seed, whole_field)])
    found = [point for part in found for point in part]
    assert [p for p in found if p.error > p.bound or (p.good and math.isnan(p.bound))] == []
    assert [p for p in found if p.good and p.error > p.tolerance * p.size] == []
    assert np.mean([p.good for p in found]) > 0.6
    beyond_rounding = [p for p in found if p.good and p.error > 1e-13 * p.size]
    assert np.median([p.bound / p.error for p in beyond_rounding]) < 1000


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
            distance = 1.02 * 10**-digits * solver.bounds.scale / operators.balls
        exact = norm_of_inverse(system(lattice, s)[0])
        assert exact <= solver.bounds.inverse_norm <= 1.5 * exact


@pytest.mark.parametrize("damping", [0.0, 0.05])
@pytest.mark.parametrize("shape", [(7,), (4, 5), (2, 3, 2)])
def test_norm_of_the_inverse_right_of_the_axis(comm, shape, damping):
    """It needs no damping, however ranks share the lattice; none could be smaller without springs.

    There S = s beta C + s^2 m, whose smallest value is |s| |beta lambda_min(C) + s m|.
    """
    rng, springs = np.random.default_rng(5), random_lattice(shape, 2, damping)
    loose = Lattice([0 * k for k in springs.stiffness], 1.0, damping, kmax=0.25)
    for lattice in (springs, loose):
        with steady(lattice, [[0] * len(shape)], comm) as (_, solver):
            for s in [0.3, 2.0, *(rng.uniform(0.01, 1, 8) + 1j * rng.uniform(-2, 2, 8))]:
                state = solver.solve(s)
                assert state.converged_reason > 0 or lattice is loose  # nothing moves there
                exact, bound = norm_of_inverse(system(lattice, s)[0]), solver.bounds.inverse_norm
                assert exact <= (1 + 1e-12) * bound
                if lattice is loose and s.imag == 0:
                    assert bound <= (1 + 1e-12) * exact


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
    """Those of fields and adjoints, by extended precision: rounding hides a part of them."""
    lattice, sites = random_lattice(shape, 3, damping), [tuple(n // 2 for n in shape)]
    reference, hidden, loose = reference_of(lattice), 0, []
    unit = np.zeros(shape)
    unit[sites[0]] = 1.0
    with steady(lattice, sites, comm) as (operators, solver):
        (adjoint,), primal, bounds = solver.adjoints, solver.primal, solver.bounds
        terms = operators.f.duplicate()
        axis = 1j * np.linspace(0.05, 1.4, 14)
        for s in [*axis, *(axis[::3] + 0.4), *(0.1 - axis[::5]), 0.7]:
            solver.solve(s)
            rounding = bounds.rounding(primal.solution)
            said = bounds.primal_residual(primal, rounding), bounds.adjoint_residual(adjoint)
            terms.setArray(rounding)
            vectors = primal.solution, adjoint.solution, terms
            A, z, sizes = (comm.bcast(operators.field(x)).ravel() for x in vectors)
            S, f = system(lattice, s)
            assert np.abs(S).sum(axis=1).max() <= bounds.scale
            assert len(set(comm.allgather(bounds.scale))) == 1
            # |f| + |S| |A|, the parts of S apart: those of its diagonal may cancel
            parts = np.abs(reference.K) + abs(s) * damping * np.abs(reference.C)
            exact = np.abs(f) + parts @ np.abs(A) + abs(s) ** 2 * np.abs(A)
            assert np.all(np.abs(sizes / exact - 1) < 1e-12)
            for bound, solved, missed in zip(
                said, (primal, adjoint), (f - S @ A, unit.ravel() - S @ z), strict=True
            ):
                true = np.sqrt(np.sum(np.abs(missed) ** 2))
                assert true <= bound
                hidden += true > solved.norm
                loose.append(bound / true)
        terms.destroy()
    assert hidden > 4
    assert np.median(loose) < 100


@pytest.mark.parametrize("axes", [1, 2, 3])
def test_roundings_that_all_go_one_way(axes):
    """One ball: the sum of its bonds loses each of those that are less than half a roundoff."""
    lost = 0.49 * np.finfo(float).eps
    stiffness = [np.full([1 + (a == axis) for a in range(axes)], lost) for axis in range(axes)]
    stiffness[0].flat[-1] = 1.0
    for damping in (0.0, 1e-3):
        lattice = Lattice(stiffness, 1.0, damping)
        for omega in (1e-3, 0.9, 0.9999, 1.5):
            (state,), _ = solve(lattice, [omega], [[0] * axes], tolerance=1e-3)
            (exact,) = exact_amplitudes(stiffness, 1.0, damping, omega, [[0] * axes])
            error = abs(mpmath.mpc(complex(state.displacement[0])) - exact)
            assert error <= state.error_bound[0] <= 1e-3 * abs(exact)


@pytest.mark.parametrize("whole_field", [False, True])
def test_what_passes_is_accurate_wherever_within_its_bound_the_truth_lies(
    whole_field, solver_options
):
    """Relative to the true amplitude, not to the one found, which makes half of it of a half."""
    solver_options(COARSE)
    lattice, tolerance = random_lattice((7, 8), 3, damping=0.03), 0.5
    omegas, choices = np.linspace(0.1, 1.3, 50), {"whole_field": whole_field}
    states, fields = solve(lattice, omegas, [[3, 4]], tolerance=tolerance, **choices)
    assert all(state.converged_reason > 0 for state in states)
    for state, field in zip(states, fields, strict=True):
        size, bound = abs(state.displacement[0]), state.error_bound[0]
        if whole_field:
            size, bound = np.linalg.norm(field), state.field_bound
        assert bound <= tolerance * (size - bound)


def test_what_is_missed_is_refined_or_factored_anew_or_marked():
    """Three iterations with a stale factorization solve nothing here."""
    lattice = random_lattice((7, 6), 3)
    choices = {"tolerance": 1e-6, "refresh_iterations": 1000}
    with (
        holding(option_values("-steady_ksp_max_it 3")),
        steady(lattice, [[3, 3]], **choices) as (_, solver),
    ):
        states = [solver.solve(1j * omega) for omega in (0.5, 1.1, 0.2)]
        assert solver.factorizations == 3
    assert all(state.converged_reason > 0 for state in states)
    with holding(option_values("-steady_pc_type ilu -steady_ksp_rtol 1e-2")):
        (state,), _ = solve(lattice, [1.1], [[3, 3]], tolerance=1e-11)
    assert state.converged_reason > 0
    assert state.error_bound[0] <= 1e-11 * abs(state.displacement[0])
    (state,), _ = solve(lattice, [1.1], [[3, 3]], tolerance=1e-17)
    assert state.converged_reason <= 0


@pytest.mark.parametrize("solver", ["default", "preonly, lu", "ilu", "gmres, jacobi"])
@pytest.mark.parametrize("damping", [0.003, 0.0])
@pytest.mark.parametrize("unit", [1e20, 1e-20])
def test_units_change_nothing(unit, damping, solver, solver_options):
    """Stiffness in other units, and frequency or mass with it: the same amplitudes and bounds."""
    solver_options(SOLVERS[solver])
    lattice, omegas, sites = random_lattice((7, 6), 3, damping), [0.1, 0.11, 0.5, 1.3], [[3, 3]]
    stiffness = tuple(unit * k for k in lattice.stiffness)
    faster = Lattice(stiffness, 1.0, math.sqrt(unit) * damping)
    heavier = Lattice(stiffness, unit, unit * damping)
    expected, _ = solve(lattice, omegas, sites, tolerance=1e-10)
    for scaled, factor in ((faster, math.sqrt(unit)), (heavier, 1.0)):
        found, _ = solve(scaled, factor * np.array(omegas), sites, tolerance=1e-10)
        for a, b in zip(expected, found, strict=True):
            assert abs(a.displacement[0] - b.displacement[0]) <= 1e-12 * abs(a.displacement[0])
            assert a.converged_reason == b.converged_reason
            assert 0.1 < a.error_bound[0] / b.error_bound[0] < 10
