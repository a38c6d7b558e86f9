"""Networks that pgran makes: crystals against phonon bands, random graphs, dilution."""

import itertools
import math

import numpy as np
import pytest
from mpi4py import MPI

from pgran import InputError, find_modes
from pgran.driven.counting import smallest_damping
from pgran.driven.operators import Operators
from pgran.medium import crystals as makers
from pgran.medium.graph import without_floating

ROOT3 = math.sqrt(3)


# Crystals. A spring is its constant and {unknown: [(where, entry of B)]}.


def contact(direction, first, second, k=1.0):
    """The spring of a contact of two balls of a cell, given by their first unknowns."""
    ends = (first, np.zeros(len(direction)), -1), (second, direction, 1)
    return k, [
        (start + a, place, sign * part)
        for start, place, sign in ends
        for a, part in enumerate(direction)
    ]


def bands(springs, wavenumbers, unknowns, inertia=1.0):
    """omega^2 of all Bloch waves, ascending."""
    root, found = np.sqrt(np.broadcast_to(inertia, (unknowns,))), []
    for k in wavenumbers:
        D = np.zeros((unknowns, unknowns), complex)
        for constant, entries in springs:
            row = np.zeros(unknowns, complex)
            for unknown, place, entry in entries:
                row[unknown] += entry * np.exp(1j * np.dot(k, place)) / root[unknown]
            D += constant * np.outer(row.conj(), row)
        found.append(np.linalg.eigvalsh(D))
    return np.sort(np.concatenate(found))


SIXTY = [np.array([math.cos(a), math.sin(a)]) for a in (0, math.pi / 3, 2 * math.pi / 3)]
THIRTY = [np.array([0.0, 1.0]), np.array([ROOT3 / 2, -0.5]), np.array([-ROOT3 / 2, -0.5])]
DIAGONALS = [
    np.array(v) / math.sqrt(2)
    for v in itertools.product((-1, 0, 1), repeat=3)
    if np.dot(v, v) == 2 and next(x for x in v if x) > 0
]
# Shape, cells of the lattice of wavenumbers along each axis, edges, springs, unknowns a cell
CRYSTALS = {
    "square": ((4, 3), (1, 1), (1, 1), [contact(e, 0, 0) for e in np.eye(2)], 2),
    "triangular": ((4, 3), (1, 2), (1, ROOT3), [contact(e, 0, 0) for e in SIXTY], 2),
    "honeycomb": ((3, 2), (1, 2), (ROOT3, 3), [contact(e, 0, 2) for e in THIRTY], 4),
    "cubic": ((3, 2, 4), (1, 1, 1), (1, 1, 1), [contact(e, 0, 0) for e in np.eye(3)], 3),
    "fcc": ((2, 1, 3), (1, 2, 2), [math.sqrt(2)] * 3, [contact(e, 0, 0) for e in DIAGONALS], 3),
}


def wavenumbers(shape, zones, edges):
    """Those that a periodic sample allows."""
    ranges = [np.arange(n * z) * 2 * math.pi / (n * a)
              for n, z, a in zip(shape, zones, edges, strict=True)]  # fmt: skip
    return itertools.product(*ranges)


@pytest.mark.parametrize("name", CRYSTALS)
def test_phonon_bands(world, name):
    shape, zones, edges, springs, unknowns = CRYSTALS[name]
    network = getattr(makers, name)(shape, 0.7, periodic=True, masses=1.3)
    modes = find_modes(network)
    expected = bands(springs, wavenumbers(shape, zones, edges), unknowns) * 0.7 / 1.3
    assert modes.count_certified
    assert np.allclose(modes.omega**2, expected, rtol=0, atol=1e-12 * expected[-1])
    floppy = network.size - len(network.bond)  # Maxwell's count, no more than the zero modes
    assert np.count_nonzero(modes.omega < 1e-6) >= floppy
    assert floppy > 0 or name != "honeycomb"


def test_bands_of_discs_that_roll(world):
    """A chain: longitudinal waves, waves of slip, and as many modes of rolling; then triangles."""
    k, slip, m = 0.9, 0.4, 1.3
    inertia = np.array([m, m, m / 8])  # of discs of radius 1/2
    q = np.arange(7) * 2 * math.pi / 7
    chain = makers.square(
        (7, 1), k, periodic=(True, False), displacement="rotations", tangential=np.full(7, slip),
        masses=m
    )  # fmt: skip
    sine, cosine = 4 * np.sin(q / 2) ** 2, 4 * np.cos(q / 2) ** 2
    expected = np.concatenate([k * sine / m, slip * (sine + 2 * cosine) / m, 0 * q])
    omega = find_modes(chain).omega
    assert np.allclose(omega**2, np.sort(expected), rtol=0, atol=1e-12)

    springs, nothing = [contact(n, 0, 0, k) for n in SIXTY], np.zeros(2)
    for n in SIXTY:
        constant, entries = contact(np.array([-n[1], n[0]]), 0, 0, slip)
        entries = [(unknown, n if place.any() else nothing, e) for unknown, place, e in entries]
        springs.append((constant, [*entries, (2, nothing, -0.5), (2, n, -0.5)]))
    shape = (3, 2)
    network = makers.triangular(
        shape, k, periodic=True, displacement="rotations", tangential=np.full(36, slip), masses=m
    )
    expected = bands(springs, wavenumbers(shape, (1, 2), (1, ROOT3)), 3, inertia)
    omega = find_modes(network).omega
    assert np.allclose(omega**2, expected, rtol=0, atol=1e-12 * expected[-1])


# Makers


def test_crystals_of_given_constants_whose_balls_are_held_anywhere():
    """Constants are in the order of the contacts, those between held balls included."""
    held = np.pad(np.zeros((2, 3), int), 1, constant_values=1)
    held[-1] = 2
    number, constants = np.arange(20).reshape(4, 5), np.arange(31.0)
    network = makers.crystal("square", (4, 5), constants, held=held, displacement="scalar")
    pairs = [(number[:-1], number[1:]), (number[:, :-1], number[:, 1:])]
    bond = np.concatenate([np.stack([a.ravel(), b.ravel()], axis=1) for a, b in pairs])
    moving = np.any(held.ravel()[bond] == 0, axis=1)
    assert np.array_equal(network.bond, bond[moving])
    assert np.array_equal(network.stiffness, constants[moving])
    assert np.array_equal(network.held, held.ravel())


def test_random_geometric_graphs():
    """A pure function of the seed, of the mean number of contacts that is asked for."""
    for dimension, periodic in ((2, True), (3, True), (3, (False, True, True))):
        one, same, other = (
            makers.random_geometric(600, dimension, 8.0, periodic=periodic, seed=seed)
            for seed in (1, 1, 2)
        )
        assert one.bonds_sha256 == same.bonds_sha256 != other.bonds_sha256
        anchored = one.held.any()
        assert anchored == (periodic is not True)
        if not anchored:
            assert abs(2 * len(one.bond) / 600 - 8) < 0.6
            edge = 600 ** (1 / dimension)
            away = one.position[one.bond[:, 1]] - one.position[one.bond[:, 0]]
            shift = (one.normal * one.distance[:, None] - away) / edge
            assert np.allclose(shift, np.rint(shift))
            assert np.abs(np.rint(shift)).max() == 1


def test_dilution_removes_contacts_and_what_floats():
    network = makers.triangular((8, 5), displacement="scalar", damping=0.1)
    assert makers.diluted(network, 0.0).bonds_sha256 == network.bonds_sha256
    some, more = (makers.diluted(network, missing, seed=2) for missing in (0.5, 0.7))

    def places(sample):
        ends = sample.position[sample.bond]
        return {tuple(np.round(end.ravel(), 6)) for end in ends}

    assert places(more) < places(some) < places(network)
    for sample in (some, more):
        assert without_floating(sample)[0].size == sample.size
        with Operators(sample, MPI.COMM_SELF) as operators:
            assert smallest_damping(operators.lattice) > 0
    with pytest.raises(InputError):
        makers.diluted(network, 1.0)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: makers.square((3,)), "2 positive numbers"),
        (lambda: makers.square((3, 1), periodic=True), "touches itself"),
        (lambda: makers.random_geometric(20, 2, 18.0, periodic=True), "images"),
        (lambda: makers.random_geometric(20, 4), "dimensions"),
        (lambda: makers.diluted(makers.square((3, 3)), 2), "between 0 and 1"),
        (lambda: makers.square((2, 3)), "every ball is held"),
    ],
)
def test_makers_refuse_what_is_impossible(make, said):
    with pytest.raises(InputError, match=said):
        make()
