"""When a lattice is factored, by what, and when anew: by counts and prices, the same every time."""

import math

import numpy as np
import pytest
from samples import drive, random_lattice, reference_of, steady

from pgran.solve.linear import factor_package
from pgran.solve.reuse import ReusePolicy, expected_iterations


def policy_of(price, limit=0):
    """A policy that has seen what a factorization costs."""
    policy = ReusePolicy(limit)
    policy.price = price
    return policy


def serve(policy, iterations):
    """Let the policy decide for frequencies that would take these iterations when reusing."""
    fresh = []
    for count in iterations:
        fresh.append(policy.due())
        policy.count(fresh[-1], 1 if fresh[-1] else count)
    return fresh


def test_policy_factors_at_the_start_and_where_it_is_cheaper():
    """After the first frequency beyond a limit, or once reuse has shown to be dearer."""
    fresh = serve(policy_of(0.0, limit=4), [9, 4, 4, 5, 9, 3])
    assert fresh == [True, False, False, False, True, False]
    assert all(serve(policy_of(1.0), [10] * 40)[3:])
    policy = policy_of(50.0)
    assert serve(policy, [3] * 200).count(True) == 1
    policy.restart()
    assert serve(policy, [3] * 2) == [True, False]


def test_policy_comes_near_the_cheapest_constant_cycle():
    """Iterations that grow with the age of the factorization: at most 1.3 of the best price."""
    price, growth, points = 60.0, 2, 300

    def cost(ages):
        return sum(price + 1 if age == 0 else growth * age for age in ages)

    policy, ages, age = policy_of(price), [], 0
    for _ in range(points):
        due = policy.due()
        age = 0 if due else age + 1
        policy.count(due, 1 if due else growth * age)
        ages.append(age)
    best = min(cost([i % cycle for i in range(points)]) for cycle in range(1, 60))
    assert cost(ages) <= 1.3 * best


def test_policy_gives_up_what_did_not_work():
    """In time, and after a failure for good."""
    policy = policy_of(50.0)
    assert (policy.patience(), ReusePolicy(limit=3).patience()) == (100, None)
    policy.count(True, 1)
    assert not policy.due()
    policy.count_failure()
    policy.count(True, 1)
    assert policy.due()


def test_what_to_expect_of_an_old_factorization():
    """Nothing beyond a resonance's width in omega^2, 2 d omega beta / m; within, each application
    gains what is left of it; in whatever units."""
    assert expected_iterations(1j * math.sqrt(1 - 0.041), 1j, 2, 1.0, 0.01) == math.inf
    assert expected_iterations(1j, 1j, 2, 1.0, 0.01) == 1
    for part, count in ((1e-1, 3), (1e-2, 1.5), (1e-3, 1)):
        for m, w in ((1.0, 1.0), (7.0, 1.0), (1.0, 3.0)):
            before = w * math.sqrt(1 - 0.04 * part)
            found = expected_iterations(1j * before, 1j * w, 2, m, m * w * 0.01)
            assert found == pytest.approx(count, rel=1e-9)


def test_what_factors_by_default(solver_options):
    """PETSc in the ordering of the smaller factor; MUMPS where lattices are large or shared."""
    assert factor_package((20, 20), 1) == "petsc"
    assert factor_package((1000, 1000), 1) == factor_package((20, 20), 2) == "mumps"
    entries = []
    for options in ("", "-steady_pc_factor_mat_ordering_type nd"):
        solver_options(options)
        with steady(random_lattice((30, 30)), (5, 5)) as (_, solver):
            drive(solver, 0.6)
            entries.append(solver.factor.getInfo()["nz_used"])
    assert entries[0] < entries[1]


def test_a_factorization_is_reused(comm):
    """As long as it is cheaper, or as iterations are allowed; amplitudes are as accurate.

    The line through two solutions close together meets the third without an iteration.
    """
    lattice, far = random_lattice((15, 14), 9), np.linspace(0.6, 0.6015, 31)
    close = 0.6 + 1e-4 * np.arange(5)
    for limit, tolerance, omegas in ((0, 1e-6, far), (1000, 1e-6, far), (1000, 1e-4, close)):
        with steady(lattice, (5, 5), comm, tolerance, refresh_iterations=limit) as (_, solver):
            states = [drive(solver, omega) for omega in omegas]
            if limit:
                assert solver.factorizations == 1
                assert (max(state.iterations for state in states) > 0) == (omegas is far)
            elif comm.size == 1:  # shared factors are so cheap here that reuse need not pay
                assert solver.factorizations < len(omegas)
        for omega, state in zip(omegas[::5], states[::5], strict=True):
            exact = reference_of(lattice).amplitudes(omega, (5, 5))
            assert state.converged_reason > 0
            assert np.abs(state.displacement - exact) <= state.error_bound
            assert state.error_bound <= tolerance * np.abs(exact)


def test_preonly_factors_at_each_frequency(comm, solver_options):
    """Whatever is said of iterations, of which it makes none."""
    solver_options("-steady_ksp_type preonly -steady_pc_type lu")
    with steady(random_lattice((6, 7)), (2, 2), comm, refresh_iterations=1000) as (_, solver):
        for omega in np.linspace(0.6, 0.61, 7):
            drive(solver, omega)
        assert solver.factorizations == 7
