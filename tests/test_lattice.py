"""Sites, bonds, walls and detectors."""

import math

import numpy as np
import pytest
from reference import balls, bonds
from samples import bond_arrays, random_lattice, uniform_lattice

from pgran.errors import InputError
from pgran.medium.base import check_frequency
from pgran.medium.bonds import bond_count, bond_ends, bond_shape
from pgran.medium.lattice import Lattice

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
    assert uniform_lattice((20, 20)).omega_mx == 1.0
    assert uniform_lattice((20, 20), 0.5, mass=2.0).omega_mx == 1.0
    assert uniform_lattice((3, 3, 3), 1 / 6).omega_mx == pytest.approx(1.0, rel=1e-15)
    lattice = random_lattice((4, 5))
    assert lattice.omega_mx == 1.0 != Lattice(lattice.stiffness).omega_mx
    assert Lattice(lattice.stiffness).kmax == lattice.constants.max()


def test_arrays_are_frozen_and_the_callers_stay_writable():
    arrays = bond_arrays((3, 4), np.ones)
    for k in Lattice(arrays).stiffness:
        with pytest.raises(ValueError, match="read-only"):
            k[0, 0] = 2.0
    arrays[0][0, 0] = 1.0


def test_checksum(world):
    """Depends on every single bond, on nothing else, and neither on memory's layout nor ranks."""
    stiffness = random_lattice((3, 4)).stiffness
    other = Lattice(tuple(np.asfortranarray(k) for k in stiffness), 2.0, 0.1, 7.0)
    seen = {*world.allgather(Lattice(stiffness).bonds_sha256), other.bonds_sha256}
    for axis, index, *_ in bonds((3, 4)):
        changed = [a.copy() for a in stiffness]
        changed[axis][index] = np.nextafter(changed[axis][index], 1)
        seen.add(Lattice(tuple(changed)).bonds_sha256)
    assert len(seen) == 1 + bond_count((3, 4))


@pytest.mark.parametrize("shapes", ["", "1", "44", "4 4", "44 34", "43 35", "13 04", "322 232 222"])
def test_impossible_shapes(shapes):
    """An array for each word, whose digits are its lengths."""
    with pytest.raises(InputError, match="stiffness"):
        Lattice(tuple(np.ones([int(digit) for digit in word]) for word in shapes.split()))


@pytest.mark.parametrize("value", [-1e-300, math.nan, math.inf])
def test_impossible_values(value):
    arrays = bond_arrays((3, 4), np.ones)
    arrays[1][1, 2] = value
    with pytest.raises(InputError, match="stiffness_y"):
        Lattice(arrays)
    for name, wrong in (("mass", value), ("mass", 0.0), ("damping", value)):
        with pytest.raises(InputError, match=f"lattice_{name}"):
            Lattice(bond_arrays((3, 4), np.ones), **{name: wrong})


def test_units_that_do_not_fit_together_are_refused():
    """Frequencies are right for a lattice in any units, but doubles end somewhere."""
    stiffness = bond_arrays((3, 2), lambda size: np.full(size, 1e-200))
    for name, values in (("mass", (1e200, 0.0)), ("damping", (1.0, 1e200))):
        with pytest.raises(InputError, match=f"lattice_{name}: 1e\\+200 and bond constants"):
            Lattice(stiffness, *values).in_own_unit()


@pytest.mark.parametrize("kmax", [None, 1e-9, 0.25, 1e9])
def test_the_own_unit_changes_no_frequency(kmax):
    """Mass, bonds and kmax lose the same factor."""
    lattice = Lattice(bond_arrays((3, 2), lambda size: np.full(size, 1e-30)), kmax=kmax)
    scaled, unit = lattice.in_own_unit()
    assert 1 <= scaled.stiffest < 2
    assert scaled.omega_mx == pytest.approx(lattice.omega_mx, rel=1e-14)
    assert scaled.kmax * unit == lattice.kmax


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
    assert lattice.sites([[0, 19], [19, 0]]).tolist() == [[0, 19], [19, 0]]
    for detectors, said in (
        ((), "not 0 numbers"),
        (3, "needs 2 indices for each ball of this lattice, not 1 number"),
        ([[3], [4]], "not 2 numbers in 2 rows"),
        ((-1, 0), "outside"),
        ((1, 1, 3, 6), r"ball \(3, 6\) is outside the lattice of 4 x 6"),
    ):
        with pytest.raises(InputError, match=f"detectors: .*{said}"):
            uniform_lattice((4, 6)).sites(detectors)
