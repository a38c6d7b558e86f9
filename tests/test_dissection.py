"""The order in which the balls of a lattice are eliminated, against PETSc's own orders."""

import math

import numpy as np
import pytest
from petsc4py import PETSc
from samples import random_lattice, steady

from pgran.medium.bonds import dissected

SHAPES = [(1,), (9,), (1, 1), (1, 7), (2, 3), (8, 8), (13, 4), (1, 4, 3), (3, 1, 2), (5, 4, 6)]


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_each_ball_is_eliminated_once(shape):
    assert sorted(dissected(shape)) == list(range(math.prod(shape)))


def test_a_line_is_cut_into_halves():
    """Of seven balls the middle one comes last, its neighbours' middles before each half's end."""
    assert np.flatnonzero(dissected((7,)) == 3) == 6
    assert {*dissected((7,))[:3]} in ({0, 1, 2}, {4, 5, 6})


def entries(matrix, order):
    """The entries of a matrix's factor in an order."""
    with_order = PETSc.PC().create(matrix.getComm())
    with_order.setOperators(matrix)
    with_order.setType("cholesky")
    with_order.setFactorOrdering(order)
    with_order.setUp()
    count = with_order.getFactorMatrix().getInfo()["nz_used"]
    with_order.destroy()
    return count


@pytest.mark.parametrize("shape", [(20, 20), (30, 70), (60, 60), (11, 11, 11)], ids=str)
def test_factors_fill_less_than_by_petsc(shape):
    """A tenth at least less than its nested dissection, and no more than by minimum degree."""
    with steady(random_lattice(shape), [0] * len(shape)) as (operators, _):
        operators.combine(0.3j)
        own, dissection, degree = (entries(operators.S, o) for o in ("natural", "nd", "qmd"))
        assert own < 0.9 * dissection
        assert own < degree


def test_incomplete_factors_have_an_order_of_their_own(solver_options):
    """By dissection they miss more, and take several times as many iterations."""
    taken = []
    for order in ("", " -steady_pc_factor_mat_ordering_type natural"):
        solver_options(f"-steady_pc_type ilu -steady_pc_factor_levels 4{order}")
        with steady(random_lattice((20, 20), damping=0.03), [10, 10]) as (_, solver):
            state = solver.solve(0.3j)
            assert state.converged_reason > 0
            taken.append(state.iterations)
    assert 2 * taken[0] < taken[1]
