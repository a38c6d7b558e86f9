"""Packings for LAMMPS: what its files hold, and that their forces are those of the network."""

import dataclasses
import functools
import re

import lammps_like
import numpy as np
import pytest
from packing_samples import ids_of
from small import OPTIONS

import pgran
from pgran.balance.networks import by_positions, floor
from pgran.errors import FileError, InputError
from pgran.medium.base import record_of
from pgran.medium.network_file import parts_of, read_network, write_network
from pgran.store.record import Result

CASES = {
    "discs": {"balls": 60, "pressure": 1e-3, "sizes": 0.2},
    "spheres": {"balls": 120, "dimension": 3, "law": "hertz", "pressure": 1e-3},
    "walls": {"balls": 80, "pressure": 1e-2, "walls": "x", "shape": (2, 1)},
    "heap": {"balls": 60, "law": "hertz", "gravity": 1e-4, "walls": "x"},
}


@functools.cache
def packing(name):
    return pgran.pack(**CASES[name], seed=3)


@pytest.mark.parametrize("name", CASES)
def test_the_files_hold_the_packing(tmp_path, name):
    """All numbers to all digits; forces, contact by contact, as far as positions hold them."""
    network = packing(name)
    paths = pgran.export(network, tmp_path / "a.lmp")
    assert [path.name for path in paths] == ["a.lmp", "a.in"]
    found = lammps_like.read_packing(paths[1])
    for what in ("position", "radius"):
        assert np.array_equal(found[what], getattr(network, what))
    assert np.array_equal(found["type"], network.held + 1)
    assert np.array_equal(found["periods"], network.box)
    np.testing.assert_allclose(found["mass"], network.masses, rtol=1e-15)
    assert not found["beyond"].any()
    room = network.position - network.radius[:, None] - found["low"][: network.axes]
    assert np.all(room[:, network.box == 0] > 0)
    rows = lammps_like.contacts_of(found)
    rows = rows[np.any(network.held[rows[:, :2].astype(int)] == 0, axis=1)]
    known = {tuple(sorted(pair)): F for pair, F in zip(network.bond, network.force, strict=True)}
    assert {(i, j) for i, j, *_ in rows} == known.keys()
    wrong = max(abs(F - known[i, j]) for i, j, _, F in rows) / network.force.mean()
    assert wrong < 2 * floor(network)
    assert by_positions(network) == pytest.approx(wrong, rel=1)


@pytest.mark.parametrize("name", ["spheres", "heap"])
def test_there_and_back(call, shared_path, here, name):
    """By the command in the script's head, of what LAMMPS would write."""
    network = packing(name)
    write_network(shared_path / "a.h5", *parts_of(network))
    made = call("export", "a.h5", "b/a.lmp")
    assert made.stdout.split() == ["b/a.lmp", "b/a.in"], made.stderr
    assert "positions hold each force to" in made.stderr
    script = (shared_path / "b" / "a.in").read_text()
    lammps_like.main(shared_path / "b" / "a.in")
    words = re.search(r"pgran (import .*)", script)[1].replace("'", "").replace("a.", "b/a.")
    assert call(*words.split()).returncode == 0
    back, balls = read_network("a_lammps.h5"), ids_of("a_lammps.h5") - 1
    assert back.power == network.power
    assert np.array_equal(back.held, network.held[balls])
    forces = [
        {tuple(sorted(pair)): F for pair, F in zip(pairs, net.force, strict=True)}
        for net, pairs in ((network, network.bond), (back, balls[back.bond]))
    ]
    assert forces[0].keys() == forces[1].keys()
    wrong = max(abs(forces[0][pair] - forces[1][pair]) for pair in forces[0])
    assert wrong < 2 * floor(network) * network.force.mean()
    pull = re.search(r"gravity (\S+) vector (.*)", script)
    if name == "heap":
        assert float(pull[1]) == -network.gravity[1]
        assert [float(x) for x in pull[2].split()] == [*network.gravity, 0.0]
    else:
        assert pull is None


def test_units_of_an_import_and_of_a_result(tmp_path):
    """The law's modulus is that of the forces; a result's packing is exported, too."""
    spheres = read_network(OPTIONS / "packings" / "spheres.h5")
    scaled = dataclasses.replace(
        spheres, force=7 * spheres.force, stiffness=7 * spheres.stiffness, kmax=7 * spheres.kmax
    )
    result = Result([record_of(scaled), pgran.find_modes(scaled)], scene="modes")
    _, script = pgran.export(result, tmp_path / "a.lmp")
    assert lammps_like.read_packing(script)["modulus"] == pytest.approx(7)


def test_what_lammps_cannot_take(tmp_path):
    network, lattice = packing("discs"), pgran.Lattice((np.ones(3),), 1.0, 0.1)
    shaken = dataclasses.replace(network, force=1.01 * network.force)
    odd = pgran.pack(40, law=1.25, pressure=1e-2)
    for medium, name, message in (
        (lattice, "a", "no packing in this result"),
        (odd, "a", "the power 1.25: LAMMPS has"),
        (network, "a b", "no name like 'a b'"),
        (dataclasses.replace(network, force=None), "a", "does not know its contact law"),
        (dataclasses.replace(network, box=None), "a", "contact .* periods of the box missing"),
        (shaken, "a", "say other forces, by .* of the mean one"),
    ):
        with pytest.raises((FileError, InputError), match=message) as refused:
            pgran.export(medium, tmp_path / f"{name}.lmp")
        assert "\n" not in str(refused.value)
    assert not [*tmp_path.iterdir()]
