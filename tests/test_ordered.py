"""The ordered counterpart of a packing: what it shares with it, what not, what has none."""

import dataclasses
import itertools
import sys
from pathlib import Path

import numpy as np
import pytest

import pgran
from pgran.command.imports import middle
from pgran.medium.crystals import square
from pgran.medium.graph import subnetwork

sys.path.append(str(Path(__file__).parents[1] / "jobs"))

import geometry


def contacts_of(network):
    """How many each free ball has."""
    return np.bincount(network.bond.ravel(), minlength=len(network.held))[network.free]


@pytest.mark.parametrize(("axes", "isostatic"), [(2, 4), (3, 6)])
def test_it_shares_all_but_the_places(axes, isostatic):
    packing = pgran.pack(150, axes, "hertz", pressure=1e-4, sizes=0.2, walls="x", seed=3)
    lattice = pgran.ordered(packing)
    scalar = dataclasses.replace(packing, displacement="scalar", direction=None)
    assert (lattice.displacement, lattice.omega_mx) == ("scalar", scalar.omega_mx)
    per_ball = [network.bonds / len(network.free) for network in (lattice, packing)]
    assert per_ball[0] == pytest.approx(per_ball[1], abs=0.51 / len(lattice.free))
    free = [network.masses[network.free] for network in (lattice, packing)]
    for drawn, given in ((lattice.stiffness, packing.stiffness), free):
        assert np.isin(drawn, given).all()
        assert len(np.unique(drawn)) == min(len(drawn), len(given))  # none twice without need
        assert np.any(drawn[: len(given)] != given[: len(drawn)])
    # nearest neighbours all touch; what is beyond are diagonals, and few
    side = lattice.distance.min()
    assert {*np.round(lattice.distance / side, 6)} == {1.0, round(np.sqrt(2), 6)}
    near = subnetwork(lattice, contacts=np.flatnonzero(lattice.distance < 1.2 * side))
    assert np.all(contacts_of(near) == isostatic)
    assert contacts_of(lattice).var() < 0.6 * contacts_of(packing).var()
    ends = [
        [network.position[network.held == kind, 0].mean() for kind in (1, 2)]
        for network in (lattice, packing)
    ]
    assert np.diff(ends)[0] == pytest.approx(np.diff(ends)[1], abs=0.6 * side)
    assert lattice.box == pytest.approx(packing.box, abs=0.6 * side)
    assert pgran.ordered(packing, 4) != lattice == pgran.ordered(packing, 1993)
    noise = 1e-14 * np.random.default_rng(1).standard_normal((8, *lattice.position.shape))
    near = [dataclasses.replace(lattice, position=lattice.position * (1 + x)) for x in noise]
    assert {*map(middle, near)} == {middle(lattice)}  # rounding does not choose it


def test_of_a_lattice_it_is_that_lattice():
    """Of 7 x 8 balls, whose modes have closed forms: walls along x, periodic along y."""
    periodic = dataclasses.replace(square((9, 8), 2.0, periodic=(False, True)), box=(0, 8))
    lattice = pgran.ordered(periodic)
    assert lattice.bonds == periodic.bonds
    p, q = np.arange(1, 8)[:, None], np.arange(8)
    squares = 2.0 * (4 - 2 * np.cos(np.pi * p / 8) - 2 * np.cos(2 * np.pi * q / 8))
    omega = pgran.find_modes(lattice).omega
    assert omega == pytest.approx(np.sqrt(np.sort(squares.ravel())), rel=1e-12)


def test_what_has_no_counterpart():
    packing = pgran.pack(60, pressure=1e-2, walls="x", seed=2)
    turned = np.array([0, 2, 1])[packing.held]
    for message, refused in {
        "box is known": dataclasses.replace(packing, box=None),
        "under a pressure": pgran.pack(60, gravity=1e-4, seed=1),
        "ends of one axis": dataclasses.replace(packing, held=np.minimum(packing.held, 1)),
        "not beyond": dataclasses.replace(packing, held=turned),
        "more than a lattice": subnetwork(packing, contacts=3 * [*range(packing.bonds)]),
    }.items():
        with pytest.raises(pgran.InputError, match=message):
            pgran.ordered(refused)


def test_the_table_in_small(monkeypatch, capsys):
    """Two rows of it."""
    networks = geometry.networks
    monkeypatch.setattr(geometry, "networks", lambda *words: itertools.islice(networks(*words), 2))
    geometry.main(2, 50)
    head, _, *rows = [line.split(" | ") for line in capsys.readouterr().out.splitlines()]
    assert [row[0] for row in rows] == ["| lattice, alike", "| lattice, random"]
    assert {len(row) for row in rows} == {len(head)}
