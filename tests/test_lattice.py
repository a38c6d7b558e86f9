"""Sites, bonds, walls and detectors."""

import dataclasses
import math

import numpy as np
import pytest
from reference import bonds
from samples import bond_arrays, random_lattice, uniform_lattice

from pgran.errors import InputError
from pgran.physics.lattice import Lattice, bond_count, bond_shape, check_frequency, detector_sites


@pytest.mark.parametrize("shape", [(1,), (9,), (20, 20), (1, 4), (3, 1, 2), (4, 5, 6)])
def test_shapes_and_counts(shape):
    lattice = random_lattice(shape)
    assert lattice.shape == shape
    assert lattice.balls == math.prod(shape)
    assert bond_count(shape) == len(list(bonds(shape))) == sum(k.size for k in lattice.stiffness)
    for axis, k in enumerate(lattice.stiffness):
        assert k.shape == bond_shape(shape, axis)


def test_paper_has_840_bonds():
    assert bond_count((20, 20)) == 840
    assert bond_shape((20, 20), 0) == (21, 20)
    assert bond_shape((20, 20), 1) == (20, 21)


def test_unit_of_frequency():
    """Paper: sqrt(4 Kmax / m), a ball held by its 4 springs, 1 for its parameters."""
    assert uniform_lattice((20, 20)).omega_mx == 1.0
    assert uniform_lattice((20, 20), 0.5, mass=2.0).omega_mx == 1.0
    assert uniform_lattice((3,), 0.5).omega_mx == 1.0
    assert uniform_lattice((3, 3, 3), 1 / 6).omega_mx == pytest.approx(1.0, rel=1e-15)


def test_kmax():
    """The law's where it is known, else the largest bond."""
    stiffness = random_lattice((4, 5)).stiffness
    assert Lattice(stiffness).kmax == max(k.max() for k in stiffness)
    assert Lattice(stiffness, kmax=0.25).omega_mx == 1.0


def test_arrays_are_frozen_and_the_callers_stay_writable():
    arrays = bond_arrays((3, 4), np.ones)
    lattice = Lattice(arrays)
    for k in lattice.stiffness:
        with pytest.raises(ValueError, match="read-only"):
            k[0, 0] = 2.0
    arrays[0][0, 0] = 1.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        lattice.mass = 2.0


def test_checksum():
    """Depends on every single bond, on nothing else, and not on the memory layout."""
    stiffness = random_lattice((3, 4)).stiffness
    first = Lattice(stiffness).bonds_sha256
    assert Lattice(stiffness, 2.0, 0.1, 7.0).bonds_sha256 == first
    assert Lattice(tuple(np.asfortranarray(k) for k in stiffness)).bonds_sha256 == first
    seen = {first}
    for axis, k in enumerate(stiffness):
        for index in np.ndindex(k.shape):
            changed = [a.copy() for a in stiffness]
            changed[axis][index] = np.nextafter(changed[axis][index], 1)
            seen.add(Lattice(tuple(changed)).bonds_sha256)
    assert len(seen) == 1 + bond_count((3, 4))


def test_checksum_is_the_same_on_all_ranks(world):
    assert len(set(world.allgather(random_lattice((5, 6)).bonds_sha256))) == 1


@pytest.mark.parametrize(
    "shapes",
    [
        [],
        [()],
        [(1,)],
        [(4,), (4,)],
        [(4, 4), (3, 4)],
        [(4, 4), (4, 5)],
        [(4, 3), (3, 5)],
        [(1, 3), (0, 4)],
        [(4, 0), (3, 1)],
        [(3, 2, 2), (2, 3, 2), (2, 2, 2)],
        [(2, 1, 1, 1), (1, 2, 1, 1), (1, 1, 2, 1), (1, 1, 1, 2)],
    ],
    ids=str,
)
def test_impossible_shapes(shapes):
    with pytest.raises(InputError, match="stiffness"):
        Lattice(tuple(np.ones(shape) for shape in shapes))


@pytest.mark.parametrize("value", [-1e-300, math.nan, math.inf])
@pytest.mark.parametrize("axis", [0, 1])
def test_impossible_bonds(axis, value):
    arrays = bond_arrays((3, 4), np.ones)
    arrays[axis][1, 2] = value
    with pytest.raises(InputError, match=f"stiffness_{'xy'[axis]}"):
        Lattice(arrays)


@pytest.mark.parametrize(
    ("values", "name"),
    [
        ({"mass": 0.0}, "mass"),
        ({"mass": -1.0}, "mass"),
        ({"mass": math.nan}, "mass"),
        ({"mass": math.inf}, "mass"),
        ({"damping": -1e-9}, "damping"),
        ({"damping": math.nan}, "damping"),
        ({"damping": math.inf}, "damping"),
    ],
)
def test_impossible_values(values, name):
    with pytest.raises(InputError, match=f"lattice_{name}"):
        Lattice(bond_arrays((3, 4), np.ones), **values)


# Detectors


def test_detectors():
    assert detector_sites((20, 20), (8, 10)).tolist() == [[8, 10]]
    assert detector_sites((20, 20), (8, 10, 3, 4)).tolist() == [[8, 10], [3, 4]]
    assert detector_sites((20, 20), [[0, 19], [19, 0]]).tolist() == [[0, 19], [19, 0]]
    assert detector_sites((5,), (0, 4)).tolist() == [[0], [4]]
    assert detector_sites((5, 1, 2), (4, 0, 1)).tolist() == [[4, 0, 1]]


@pytest.mark.parametrize(
    ("shape", "detectors"),
    [
        ((20, 20), ()),
        ((20, 20), (8,)),
        ((20, 20), (8, 10, 3)),
        ((20, 20, 20), (8, 10)),
        ((20, 20), (20, 0)),
        ((20, 20), (0, 20)),
        ((20, 20), (-1, 0)),
        ((4, 6), (5, 3)),
        ((4, 6), (0, 0, 0, 6)),
    ],
)
def test_impossible_detectors(shape, detectors):
    with pytest.raises(InputError, match="detectors"):
        detector_sites(shape, detectors)


def test_detector_message_names_the_ball():
    with pytest.raises(InputError, match=r"ball \(3, 9\) is outside the lattice of 4 x 6"):
        detector_sites((4, 6), (1, 1, 3, 9))


@pytest.mark.parametrize(
    "values",
    [
        {"omega": 1e80},
        {"omega": 1e10, "mass": 1e300},
        {"omega": 1e100, "damping": 1e100},
        {"stiffness": 1e308},
        {"mass": 1e-310},
    ],
)
def test_numbers_too_large_are_refused(values):
    ordinary = {"omega": 1.0, "mass": 1.0, "damping": 0.003, "stiffness": 0.25}
    omega, mass, damping, stiffness = (ordinary | values).values()
    with pytest.raises(InputError, match="too large"):
        check_frequency(uniform_lattice((3, 2), stiffness, damping, mass), omega)
    check_frequency(uniform_lattice((3, 2)), 1e30)
