"""Bounds of driven amplitudes, against elimination in extended precision, over random cases.

`python tests/test_bounds.py 10000` runs as many cases and prints what was found.
"""

import math
import sys
from dataclasses import dataclass

import mpmath
import numpy as np
import pytest
from mpi4py import MPI
from reference import Reference, exact_amplitudes
from samples import (
    HAS_KLU,
    bond_arrays,
    needs_klu,
    option_values,
    random_lattice,
    uniform_lattice,
)

from pgran.physics.lattice import Lattice
from pgran.solve.database import holding
from pgran.solve.operators import Operators
from pgran.solve.steady import SteadySolver

SHAPES = [(1,), (2,), (17,), (60,), (1, 6), (6, 1), (4, 5), (7, 8), (2, 3, 2), (4, 3, 5)]
LAWS = ("uniform", "loguniform", "bimodal", "constant")
SOLVERS = {
    "default": "",
    "bcgs, ilu": "-steady_ksp_type bcgs -steady_pc_type ilu",
    "bcgs, ilu, 1e-2": "-steady_ksp_type bcgs -steady_pc_type ilu -steady_ksp_rtol 1e-2",
    "gmres, ilu, 1e-6": "-steady_ksp_type gmres -steady_pc_type ilu -steady_ksp_rtol 1e-6",
    "gmres, jacobi": "-steady_ksp_type gmres -steady_pc_type jacobi -steady_ksp_rtol 1e-3",
    "preonly, lu": "-steady_ksp_type preonly -steady_pc_type lu",
    "preonly, ilu": "-steady_ksp_type preonly -steady_pc_type ilu",
    "klu": "-steady_pc_type lu -steady_pc_factor_mat_solver_type klu",
    "preonly, klu": "-steady_ksp_type preonly -steady_pc_type lu "
    "-steady_pc_factor_mat_solver_type klu",
    "stale": "",
}
if not HAS_KLU:
    del SOLVERS["klu"], SOLVERS["preonly, klu"]


@dataclass(frozen=True)
class Case:
    """A lattice, its solver, and what is asked of it."""

    lattice: Lattice
    omegas: np.ndarray
    sites: np.ndarray
    solver: str
    tolerance: float


@dataclass(frozen=True)
class Point:
    """One amplitude: what it is, how wrong, what is said of it."""

    case: Case
    omega: float
    size: float
    error: float
    bound: float
    good: bool

    def __str__(self):
        """Say what it takes to see the point again."""
        lattice, case = self.case.lattice, self.case
        return (
            f"{lattice.shape} beta {lattice.damping:.1e} omega {self.omega:.17g} {case.solver} "
            f"tolerance {case.tolerance:.0e}: |A| {self.size:.1e}, error {self.error:.1e}, "
            f"bound {self.bound:.1e}{', good' if self.good else ''}"
        )


def random_case(seed):
    """One of many kinds of lattices and solvers."""
    rng = np.random.default_rng([7, seed])
    shape = SHAPES[rng.integers(len(SHAPES))]
    contrast = 10 ** rng.uniform(0, 12)
    draw = {
        "uniform": lambda size: rng.uniform(0, 0.25, size),
        "loguniform": lambda size: 0.25 * contrast ** -rng.uniform(0, 1, size),
        "bimodal": lambda size: rng.choice([0.0, 0.25], size, p=[0.3, 0.7]),
        "constant": lambda size: np.full(size, 0.25),
    }[LAWS[rng.integers(len(LAWS))]]
    mass = 10 ** rng.uniform(-1, 1)
    damping = 0.0 if rng.random() < 0.2 else math.sqrt(mass) * 10 ** rng.uniform(-8, 0)
    lattice = Lattice(bond_arrays(shape, draw), mass, damping, kmax=0.25)
    solver = list(SOLVERS)[rng.integers(len(SOLVERS))]
    first = lattice.omega_mx * (
        10 ** rng.uniform(-3, 0) if rng.random() < 0.5 else rng.uniform(0.1, 3)
    )
    step = 10 ** rng.uniform(-6, -1)
    omegas = first * (1 + step * np.arange(5 if solver == "stale" else 2))
    sites = np.array([[rng.integers(n) for n in shape]])
    return Case(lattice, omegas, sites, solver, 10 ** rng.uniform(-12, -1))


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


def solve(lattice, omegas, sites, solver="", tolerance=1e-4, refresh=0):
    """Return the states at some frequencies."""
    return [state for state, _ in solved(lattice, omegas, sites, solver, tolerance, refresh)]


def solved(lattice, omegas, sites, solver, tolerance, refresh, whole_field=False):
    """Return the states and fields at some frequencies, the solver's options set for the while."""
    with (
        holding(option_values(f"-steady_ksp_max_it 200 {solver}")),
        Operators(lattice, MPI.COMM_SELF) as operators,
        SteadySolver(operators, sites, tolerance, refresh, whole_field) as steady,
    ):
        return [(steady.solve(float(w)), operators.field(steady.field).ravel()) for w in omegas]


def points(case, whole_field=False):
    """Solve a case, and compare the amplitude at its ball, or the whole field in the 2-norm."""
    lattice, refresh = case.lattice, 1000 if case.solver == "stale" else 0
    asked = case.omegas, case.sites, SOLVERS[case.solver], case.tolerance, refresh, whole_field
    reference = Reference(lattice.stiffness, lattice.mass, lattice.damping)
    number = np.ravel_multi_index(tuple(case.sites[0]), lattice.shape)
    for state, found in solved(lattice, *asked):
        exact, bound = eliminate(*reference.system(state.omega)), state.field_bound
        if not whole_field:
            exact, found, bound = exact[number], state.displacement[0], state.error_bound[0]
        size, error = (float(np.sqrt(np.sum(np.abs(x) ** 2))) for x in (exact, found - exact))
        yield Point(case, state.omega, size, error, float(bound), state.converged_reason > 0)


def campaign(first, count, stride=1, whole_field=False):
    """Return the points of many cases."""
    cases = map(random_case, range(first, count, stride))
    return [point for case in cases for point in points(case, whole_field)]


def faults(found):
    """Return the points whose bound does not hold, and those wrong but not marked."""
    false = [p for p in found if p.error > p.bound or (p.good and math.isnan(p.bound))]
    wrong = [p for p in found if p.good and p.error > p.case.tolerance * p.size]
    return false, wrong


def overestimate(found):
    """Return bound / error of all good points whose error is more than rounding."""
    return [p.bound / p.error for p in found if p.good and p.error > 1e-13 * p.size]


def report(found):
    """Print the figures, solver by solver and damping by damping."""
    false, wrong = faults(found)
    print(f"{len(found)} points; bound does not hold: {len(false)}; wrong, unmarked: {len(wrong)}")
    for point in [*false, *wrong][:20]:
        print("   ", point)
    kinds = {"all": found}
    kinds |= {solver: [p for p in found if p.case.solver == solver] for solver in SOLVERS}
    kinds["undamped"] = [p for p in found if p.case.lattice.damping == 0]
    print(f"{'':20} points   good  beyond rounding   bound/error: median  9 of 10")
    for label, some in kinds.items():
        ratios = overestimate(some)
        median, most = np.quantile(ratios, [0.5, 0.9]) if ratios else (math.nan, math.nan)
        good = sum(p.good for p in some)
        print(f"{label:20} {len(some):6} {good:6} {len(ratios):16} {median:20.1e} {most:8.1e}")


@pytest.mark.parametrize(("cases", "whole_field"), [(300, False), (160, True)])
def test_bounds_hold_over_random_cases(world, cases, whole_field):
    """No bound is exceeded, nothing wrong passes, and most bounds are of use."""
    found = world.allgather(campaign(world.rank, cases, world.size, whole_field))
    found = [point for part in found for point in part]
    false, wrong = faults(found)
    assert not false, "\n".join(map(str, false))
    assert not wrong, "\n".join(map(str, wrong))
    assert np.mean([point.good for point in found]) > 0.8
    assert np.median(overestimate(found)) < 1000
    for solver in {"bcgs, ilu", "gmres, jacobi", "preonly, klu"} & SOLVERS.keys():
        assert any(not point.good for point in found if point.case.solver == solver)


def test_elimination_in_extended_precision():
    """It serves nearly singular systems too, as far as extended precision goes."""
    i = np.arange(1, 9, dtype=np.longdouble)
    hilbert = 1 / (i[:, None] + i - 1)
    x = eliminate(hilbert.astype(np.clongdouble), hilbert.sum(axis=1).astype(np.clongdouble))
    assert np.abs(x - 1).max() < 1e10 * np.finfo(np.longdouble).eps


@pytest.mark.parametrize("damping", [0.0, 1e-10, 1e-7, 1e-4, 0.1])
@pytest.mark.parametrize("distance", [1e-9, 1e-6, 1e-3])
def test_norm_of_the_inverse(damping, distance):
    """|S^-1| is no larger than said, and not much smaller where next to nothing is damped."""
    lattice = random_lattice((5, 6), 3, damping)
    reference = Reference(lattice.stiffness, 1.0, damping)
    with (
        Operators(lattice, MPI.COMM_SELF) as operators,
        SteadySolver(operators, [[2, 2]]) as steady,
    ):
        for eigenvalue in reference.eigenvalues()[[0, 9, 29]]:
            omega = math.sqrt(eigenvalue * (1 + distance))
            steady.solve(omega)
            S = reference.system(omega)[0].astype(complex)
            exact = 1 / np.linalg.svd(S, compute_uv=False)[-1]
            assert exact <= steady.bounds.inverse_norm
            if damping == 0:
                assert steady.bounds.inverse_norm <= 30 * max(exact, operators.balls)


@needs_klu
def test_bounds_are_reached():
    """One ball on its resonance, solved with the conjugate matrix: no bound could be smaller."""
    lattice = uniform_lattice((1, 1), 0.125, damping=0.1, mass=2.0)
    ((state, field),) = solved(lattice, [0.5], [[0, 0]], SOLVERS["preonly, klu"], 1e-4, 0, True)
    exact = Reference(lattice.stiffness, 2.0, 0.1).field(0.5).ravel()
    assert abs(exact[0] - field[0]) <= state.field_bound <= 1.02 * abs(exact[0] - field[0])
    error = abs(exact[0] - state.displacement[0])
    assert error <= state.error_bound[0] <= 1.03 * error


@pytest.mark.parametrize("damping", [0.0, 1e-8])
@pytest.mark.parametrize("digits", [1, 2, 3])
def test_an_eigenvalue_just_beyond_what_a_count_excludes(damping, digits):
    """The norm of the inverse holds where the nearest eigenvalue is hardly farther than counted."""
    lattice = random_lattice((5, 6), 3, damping)
    reference = Reference(lattice.stiffness, 1.0, damping)
    eigenvalue = reference.eigenvalues()[9]
    with (
        Operators(lattice, MPI.COMM_SELF) as operators,
        SteadySolver(operators, [[2, 2]]) as steady,
    ):
        distance = 0.0
        for _ in range(5):  # the first guess of the distance depends a little on the frequency
            omega = math.sqrt(eigenvalue + distance)
            steady.solve(omega)
            distance = 1.02 * 10**-digits * steady.bounds.scale / operators.balls
        S = reference.system(omega)[0].astype(complex)
        exact = 1 / np.linalg.svd(S, compute_uv=False)[-1]
        assert exact <= steady.bounds.inverse_norm <= 1.5 * exact


@pytest.mark.parametrize(("shape", "damping"), [((40,), 0.3), ((7, 8), 0.02), ((4, 3, 5), 0.003)])
def test_residuals_are_no_larger_than_said(comm, shape, damping):
    """Those of fields and adjoints, by extended precision: rounding hides a part of them."""
    lattice, sites = random_lattice(shape, 3, damping), [tuple(n // 2 for n in shape)]
    reference, hidden, loose = Reference(lattice.stiffness, 1.0, damping), 0, []
    unit = np.zeros(shape)
    unit[sites[0]] = 1.0
    with Operators(lattice, comm) as operators, SteadySolver(operators, sites) as steady:
        (adjoint,), primal, bounds = steady.adjoints, steady.primal, steady.bounds
        terms = operators.f.duplicate()
        for omega in np.linspace(0.05, 1.4, 20):
            steady.solve(omega)
            rounding = bounds.rounding(primal.solution)
            said = bounds.primal_residual(primal, rounding), bounds.adjoint_residual(adjoint)
            terms.setArray(rounding)
            vectors = primal.solution, adjoint.solution, terms
            A, z, sizes = (comm.bcast(operators.field(x)).ravel() for x in vectors)
            S, f = reference.system(omega)
            assert np.abs(S).sum(axis=1).max() <= bounds.scale
            assert len(set(comm.allgather(bounds.scale))) == 1
            # |f| + |S| |A|, the parts of S apart: those of its diagonal may cancel
            parts = np.abs(reference.K) + omega * damping * np.abs(reference.C)
            exact = np.abs(f) + parts @ np.abs(A) + omega**2 * np.abs(A)
            assert np.all(np.abs(sizes / exact - 1) < 1e-12)
            for bound, system, missed in zip(
                said, (primal, adjoint), (f - S @ A, unit.ravel() - S @ z), strict=True
            ):
                true = np.sqrt(np.sum(np.abs(missed) ** 2))
                assert true <= bound
                hidden += true > system.norm
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
            (state,) = solve(lattice, [omega], [[0] * axes], tolerance=1e-3)
            (exact,) = exact_amplitudes(stiffness, 1.0, damping, omega, [[0] * axes])
            error = abs(mpmath.mpc(complex(state.displacement[0])) - exact)
            assert error <= state.error_bound[0] <= 1e-3 * abs(exact)


@pytest.mark.parametrize("whole_field", [False, True])
def test_what_passes_is_accurate_wherever_within_its_bound_the_truth_lies(whole_field):
    """Relative to the true amplitude, not to the one found, which makes half of it of a half."""
    lattice, tolerance = random_lattice((7, 8), 3, damping=0.03), 0.5
    omegas, solver = np.linspace(0.1, 1.3, 100), SOLVERS["bcgs, ilu, 1e-2"]
    found = solved(lattice, omegas, [[3, 4]], solver, tolerance, 0, whole_field)
    assert all(state.converged_reason > 0 for state, _ in found)
    for state, field in found:
        size, bound = abs(state.displacement[0]), state.error_bound[0]
        if whole_field:
            size, bound = np.linalg.norm(field), state.field_bound
        assert bound <= tolerance * (size - bound)


@pytest.mark.parametrize(
    "solver",
    [
        pytest.param("klu", marks=needs_klu),
        pytest.param("preonly, klu", marks=needs_klu),
        "preonly, ilu",
        "bcgs, ilu, 1e-2",
    ],
)
def test_a_wrong_solver_is_caught(solver):
    """KLU solves with the conjugate matrix: alone it is wrong everywhere, under a KSP nowhere."""
    lattice = random_lattice((6, 7), 8, damping=0.1)
    omegas = np.linspace(0.2, 1.2, 20)
    states = solve(lattice, omegas, [[3, 4]], SOLVERS[solver], 1e-6)
    reference = Reference(lattice.stiffness, 1.0, 0.1)
    for state in states:
        exact = reference.amplitudes(state.omega, [[3, 4]])[0]
        error = abs(state.displacement[0] - exact)
        assert error <= state.error_bound[0]
        assert error <= 1e-6 * abs(exact) or state.converged_reason <= 0
    if "klu" in solver:
        failed = [state.converged_reason <= 0 for state in states]
        assert failed == [solver == "preonly, klu"] * len(states)


def test_what_is_missed_is_refined_or_factored_anew_or_marked(solver_options):
    """Three iterations with a stale factorization solve nothing here."""
    solver_options("-steady_ksp_max_it 3")
    lattice = random_lattice((7, 6), 3)
    with (
        Operators(lattice, MPI.COMM_SELF) as operators,
        SteadySolver(operators, [[3, 3]], 1e-6, refresh_iterations=1000) as steady,
    ):
        states = [steady.solve(omega) for omega in (0.5, 1.1, 0.2)]
        assert steady.factorizations == 3
    assert all(state.converged_reason > 0 for state in states)
    coarse = "-steady_pc_type ilu -steady_ksp_rtol 1e-2"
    (state,) = solve(lattice, [1.1], [[3, 3]], coarse, 1e-11)
    assert state.converged_reason > 0
    assert state.error_bound[0] <= 1e-11 * abs(state.displacement[0])
    (state,) = solve(lattice, [1.1], [[3, 3]], tolerance=1e-17)
    assert state.converged_reason <= 0


@pytest.mark.parametrize("solver", ["default", "preonly, lu", "bcgs, ilu", "gmres, jacobi"])
@pytest.mark.parametrize("damping", [0.003, 0.0])
@pytest.mark.parametrize("s", [1e20, 1e-20])
def test_units_change_nothing(s, damping, solver):
    """Stiffness in other units, and frequency or mass with it: the same amplitudes and bounds."""
    lattice, omegas, sites = random_lattice((7, 6), 3, damping), [0.1, 0.11, 0.5, 1.3], [[3, 3]]
    stiffness = tuple(s * k for k in lattice.stiffness)
    faster = Lattice(stiffness, 1.0, math.sqrt(s) * damping)
    heavier = Lattice(stiffness, s, s * damping)
    expected = solve(lattice, omegas, sites, SOLVERS[solver], 1e-10)
    for scaled, factor in ((faster, math.sqrt(s)), (heavier, 1.0)):
        found = solve(scaled, factor * np.array(omegas), sites, SOLVERS[solver], 1e-10)
        for a, b in zip(expected, found, strict=True):
            assert abs(a.displacement[0] - b.displacement[0]) <= 1e-12 * abs(a.displacement[0])
            assert a.converged_reason == b.converged_reason
            assert 0.1 < a.error_bound[0] / b.error_bound[0] < 10


if __name__ == "__main__":
    report(campaign(0, int(sys.argv[1])))
