"""Sites, bonds, walls and detectors; the order in which balls are eliminated."""

import math

import numpy as np
import pytest
from petsc4py import PETSc
from reference import balls, bonds
from samples import bond_arrays, random_lattice, steady, uniform_lattice

from pgran import InputError, Lattice
from pgran.medium.base import check_frequency
from pgran.medium.bonds import bond_count, bond_ends, bond_shape, dissected

SHAPES = [(1,), (9,), (1, 4), (3, 1, 2), (4, 5, 6)]


@pytest.mark.parametrize("shape", SHAPES)
def test_shapes_counts_and_numbers(shape):
    """Bonds are numbered axis after axis, each in C order; -1 is the number of a wall."""
    lattice = random_lattice(shape)
    assert lattice.shape == shape
    assert lattice.size == math.prod(shape)
    table = list(bonds(shape))
    assert bond_count(shape) == len(table) == lattice.constants.size
    assert [k.shape for k in lattice.stiffness] == [bond_shape(shape, a) for a in range(len(shape))]
    assert lattice.constants.tolist() == [lattice.stiffness[axis][i] for axis, i, *_ in table]
    number = {ball: n for n, ball in enumerate(balls(shape))}
    ends = [[number.get(end, -1) for end in row[2:]] for row in table]
    assert bond_ends(np.arange(lattice.size).reshape(shape)).tolist() == ends
    assert (Lattice.random(shape).drive > 0).tolist() == [above == "driven" for *_, above in table]
    axes, places = lattice.bond_places(np.arange(len(table)))
    assert list(zip(axes, map(tuple, places), strict=True)) == [row[:2] for row in table]


def test_unit_of_frequency():
    """Paper: sqrt(4 Kmax / m), a ball held by its 4 springs; Kmax is the law's where it is known,
    else the largest constant."""
    assert uniform_lattice((20, 20), 0.5, mass=2.0).omega_mx == 1.0
    assert uniform_lattice((3, 3, 3), 1 / 6).omega_mx == pytest.approx(1.0, rel=1e-15)
    lattice = random_lattice((4, 5))
    assert lattice.omega_mx == 1.0 != Lattice(lattice.stiffness).omega_mx
    assert Lattice(lattice.stiffness).kmax == lattice.constants.max()


def test_checksum(world):
    """Depends on every single bond, on nothing else, and neither on memory's layout nor ranks."""
    with pytest.raises(ValueError, match="read-only"):
        random_lattice((3, 4)).stiffness[0][0, 0] = 2.0
    stiffness = random_lattice((3, 4)).stiffness
    other = Lattice(tuple(np.asfortranarray(k) for k in stiffness), 2.0, 0.1, 7.0)
    seen = {*world.allgather(Lattice(stiffness).bonds_sha256), other.bonds_sha256}
    for axis, index, *_ in bonds((3, 4)):
        changed = [a.copy() for a in stiffness]
        changed[axis][index] = np.nextafter(changed[axis][index], 1)
        seen.add(Lattice(tuple(changed)).bonds_sha256)
    assert len(seen) == 1 + bond_count((3, 4))


ONES = bond_arrays((3, 4), np.ones)
BAD = (-1e-300, math.nan, math.inf)


@pytest.mark.parametrize(
    ("key", "stiffness", "others"),
    [
        *(  # an array for each word, whose digits are its lengths
            ("stiffness", [np.ones([int(digit) for digit in word]) for word in words.split()], {})
            for words in ("", "1", "44", "4 4", "44 34", "43 35", "13 04", "322 232 222")
        ),
        *(("stiffness_y", (ONES[0], np.full((3, 5), bad)), {}) for bad in BAD),
        *(("lattice_mass", ONES, {"mass": bad}) for bad in (*BAD, 0.0)),
        *(("lattice_damping", ONES, {"damping": bad}) for bad in BAD),
    ],
)
def test_impossible_lattices(key, stiffness, others):
    with pytest.raises(InputError, match=key):
        Lattice(tuple(stiffness), **others)


@pytest.mark.parametrize("kmax", [None, 1e-9, 1e9])
def test_the_own_unit_changes_no_frequency(kmax):
    """Mass, bonds and kmax lose the same factor, which must leave all of them in doubles."""
    lattice = Lattice(bond_arrays((3, 2), lambda size: np.full(size, 1e-30)), kmax=kmax)
    scaled, unit = lattice.in_own_unit()
    assert 1 <= scaled.stiffest < 2
    assert scaled.omega_mx == pytest.approx(lattice.omega_mx, rel=1e-14)
    assert scaled.kmax * unit == lattice.kmax
    soft = bond_arrays((3, 2), lambda size: np.full(size, 1e-200))
    for name, values in (("mass", (1e200, 0.0)), ("damping", (1.0, 1e200))):
        with pytest.raises(InputError, match=f"lattice_{name}: 1e\\+200 and bond constants"):
            Lattice(soft, *values).in_own_unit()


HUGE = [(1e80, 1, 0, 1), (1e100, 1, 1e100, 1), (1, 1, 0, 1e308), (1, 1e-310, 0, 1)]


@pytest.mark.parametrize(("omega", "mass", "damping", "stiffness"), HUGE)
def test_numbers_too_large_are_refused(omega, mass, damping, stiffness):
    with pytest.raises(InputError, match="too large"):
        check_frequency(uniform_lattice((3, 2), stiffness, damping, mass), omega)
    check_frequency(uniform_lattice((3, 2)), 1e30)


def test_detectors():
    """Flat or a row each; balls that are not there are refused."""
    lattice = uniform_lattice((20, 20))
    assert lattice.sites((8, 10, 3, 4)).tolist() == [[8, 10], [3, 4]]
    assert lattice.sites([[0, 19]]).tolist() == [[0, 19]]
    for detectors, said in (
        ((), "not 0 numbers"),
        (3, "needs 2 indices for each ball of this lattice, not 1 number"),
        ([[3], [4]], "not 2 numbers in 2 rows"),
        ((-1, 0), "outside"),
        ((1, 1, 3, 6), r"ball \(3, 6\) is outside the lattice of 4 x 6"),
    ):
        with pytest.raises(InputError, match=f"detectors: .*{said}"):
            uniform_lattice((4, 6)).sites(detectors)


# Elimination by dissection, against PETSc's own orders


@pytest.mark.parametrize("shape", [*SHAPES, (1, 1), (2, 3), (8, 8), (13, 4), (1, 4, 3)], ids=str)
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
