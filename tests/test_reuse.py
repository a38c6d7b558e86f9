"""When a factorization is refreshed: by counts and prices, the same way every time."""

import math

import numpy as np
import pytest

from pgran.solve.reuse import ReusePolicy, expected_iterations


def serve(policy, iterations):
    """Let the policy decide for frequencies that would take these iterations when reusing."""
    fresh = []
    for count in iterations:
        due = policy.due()
        policy.count(due, 1 if due else count)
        fresh.append(due)
    return fresh


def test_policy_factors_at_the_start_and_after_a_restart():
    policy = ReusePolicy()
    policy.price = 1000.0
    assert serve(policy, [2, 2, 2]) == [True, False, False]
    policy.restart()
    assert serve(policy, [2, 2]) == [True, False]


def test_policy_with_a_limit():
    """Refresh after the first frequency that took more than the limit."""
    assert serve(ReusePolicy(limit=4), [9, 4, 4, 5, 9, 3]) == [
        True,
        False,
        False,
        False,
        True,
        False,
    ]


def test_policy_refreshes_where_reuse_is_dearer():
    """A factorization for the price of one iteration is made again once reuse has shown 10."""
    policy = ReusePolicy()
    policy.price = 1.0
    fresh = serve(policy, [10] * 40)
    assert all(fresh[3:])


def test_policy_reuses_while_that_is_cheaper():
    policy = ReusePolicy()
    policy.price = 50.0
    assert serve(policy, [3] * 200).count(True) == 1


def test_policy_comes_near_the_cheapest_constant_cycle():
    """Iterations that grow with the age of the factorization: at most 1.3 of the best price."""
    price, growth, points = 60.0, 2, 300

    def cost(ages):
        return sum(price + 1 if age == 0 else growth * age for age in ages)

    policy = ReusePolicy()
    policy.price = price
    ages, age = [], 0
    for _ in range(points):
        due = policy.due()
        age = 0 if due else age + 1
        policy.count(due, 1 if due else growth * age)
        ages.append(age)
    best = min(cost([i % cycle for i in range(points)]) for cycle in range(1, 60))
    assert cost(ages) <= 1.3 * best


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
    omega, damping = 1.0, 0.01
    assert expected_iterations(1j * math.sqrt(1 - 0.041), 1j * omega, 2, 1.0, damping) == math.inf
    for part, count in ((1e-1, 3), (1e-2, 1.5), (1e-3, 1)):
        for m, w in ((1.0, 1.0), (7.0, 1.0), (1.0, 3.0)):
            before = w * math.sqrt(1 - 0.04 * part)
            found = expected_iterations(1j * before, 1j * w * omega, 2, m, m * w * damping)
            assert found == pytest.approx(count, rel=1e-9)
    assert expected_iterations(1j * omega, 1j * omega, 2, 1.0, damping) == 1


def test_policy_is_deterministic():
    counts = np.random.default_rng(0).integers(1, 30, 200)
    first, second = ReusePolicy(), ReusePolicy()
    first.price = second.price = 40.0
    assert serve(first, counts) == serve(second, counts)
