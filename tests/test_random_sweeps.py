"""Sweeps of random lattices of many kinds; tests/campaigns/random_sweeps.py takes more of them."""

from campaigns.random_sweeps import differing, points
from samples import random_case


def test_sweeps_of_all_kinds(world):
    """No bound is broken, nothing wrong passes, and no frequency depends on the others."""
    mine = [random_case(seed) for seed in range(world.rank, 60, world.size)]
    found = [point for case in mine for point in points(case)]
    assert [str(point) for point in found if point.fault] == []
    assert [(case.seed, omega) for case in mine[::3] for omega in differing(case)] == []
    good = world.allreduce(sum(point.good for point in found))
    assert good > 0.6 * world.allreduce(len(found))
