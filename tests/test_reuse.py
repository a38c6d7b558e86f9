"""When a lattice is factored, by what, and when anew: by counts and prices, the same every time."""

import math

import numpy as np
import pytest
from samples import random_lattice, reference_of, steady

from pgran.driven.linear import ReusePolicy, expected_iterations, factor_package


def serve(price, points, iterations, limit=0):
    """How old a factorization is at each point, if reusing takes `iterations(age)`."""
    policy, ages = ReusePolicy(limit), []
    policy.price = price
    for _ in range(points):
        due = policy.due()
        ages.append(0 if due else ages[-1] + 1)
        policy.count(due, 1 if due else iterations(ages[-1]))
    return ages


def test_policy_factors_at_the_start_and_where_it_is_cheaper():
    """After the first frequency beyond a limit, or once reuse has shown to be dearer."""
    assert serve(0.0, 7, lambda age: 3 * age, limit=5) == [0, 1, 2, 0, 1, 2, 0]
    assert not any(serve(1.0, 40, lambda age: 10)[3:])
    assert serve(50.0, 200, lambda age: 3).count(0) == 1


def test_policy_comes_near_the_cheapest_constant_cycle():
    """Iterations that grow with the age of the factorization: at most 1.3 of the best price."""

    def cost(ages):
        return sum(2 * age if age else 61 for age in ages)

    best = min(cost([i % cycle for i in range(300)]) for cycle in range(1, 60))
    assert cost(serve(60.0, 300, lambda age: 2 * age)) <= 1.3 * best


def test_policy_gives_up_what_did_not_work():
    """In time, and after a failure for good."""
    policy = ReusePolicy()
    policy.price = 50.0
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


def test_what_factors_by_default():
    """PETSc, by orders of test_dissection.py; MUMPS where lattices are large or shared."""
    small, large = random_lattice((20, 20)), random_lattice((450, 450))
    assert factor_package(small, 1) == "petsc"
    assert factor_package(large, 1) == factor_package(small, 2) == "mumps"


@pytest.mark.parametrize(
    ("options", "limit", "step", "factorizations", "iterates"),
    [
        ("", 0, 5e-5, range(1, 31), True),
        ("", 1000, 5e-5, [1], True),
        ("", 1000, 1e-6, [1], False),  # the line through two solutions meets the third
        ("-steady_ksp_type preonly", 1000, 5e-5, [31], False),
    ],
)
def test_a_factorization_is_reused(
    comm, options, limit, step, factorizations, iterates, solver_options
):
    """As long as it is cheaper, or as iterations are allowed; amplitudes are as accurate.

    A solver that makes no iterations factors at each frequency.
    """
    solver_options(options)
    lattice, omegas = random_lattice((15, 14), 9), 0.6 + step * np.arange(31)
    with steady(lattice, (5, 5), comm, 1e-6, refresh_iterations=limit) as (_, solver):
        states = [solver.solve(1j * omega) for omega in omegas]
        if limit or comm.size == 1:  # shared factors are so cheap here that reuse need not pay
            assert solver.factorizations in factorizations
            assert (max(state.iterations for state in states[1:]) > 0) == iterates
    for omega, state in zip(omegas[::5], states[::5], strict=True):
        exact = reference_of(lattice).amplitudes(omega, (5, 5))
        assert state.converged_reason > 0
        assert np.abs(state.displacement - exact) <= state.error_bound
        assert state.error_bound <= 1e-6 * np.abs(exact)
