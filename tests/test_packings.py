"""The packings that come with pgran are balanced and obey their laws, and are what is imported."""

import re
from pathlib import Path

import h5py
import numpy as np
import pytest
from packing_samples import pushes

import pgran
from pgran.command import imports
from pgran.command.resolve import resolve
from pgran.medium.network_file import read_network
from pgran.medium.springs import FREE
from pgran.run.options import read_file

ROOT = Path(__file__).parents[1]
PACKINGS = ROOT / "options" / "packings"
PAGE = ROOT / "pgran" / "manual" / "networks.md"
HELD = {
    "discs": ["--law", "harmonic", "--cut", "x", "--rest", "x<1.5", "--drive", "x>max-1.5"],
    "spheres": ["--law", "hertz", "--rest", "type==3", "--drive", "type==4"],
}
AXES = {"discs": 2, "spheres": 3}


class Dumps:
    """What is in the two dumps of a packing, read without pgran."""

    def __init__(self, name):
        atoms, contacts = PACKINGS / f"{name}.atoms", PACKINGS / f"{name}.contacts"
        rows, axes = np.loadtxt(atoms, skiprows=9), AXES[name]
        self.type, self.position = rows[:, 1], rows[:, 2 : 2 + axes]
        self.radius = rows[:, 2 + axes]
        assert np.array_equal(rows[:, 0], np.arange(len(rows)) + 1)
        box = np.loadtxt(atoms, skiprows=5, max_rows=3)[:axes]
        self.size = box[:, 1] - box[:, 0]
        ends, self.distance, self.force = np.split(np.loadtxt(contacts, skiprows=9), [2, 3], axis=1)
        self.distance, self.force = self.distance[:, 0], self.force[:, 0]
        self.bond = ends.astype(int) - 1
        away = np.diff(self.position[self.bond], axis=1)[:, 0]
        away -= self.size * np.round(away / self.size)
        self.normal = away / np.linalg.norm(away, axis=1)[:, None]
        self.overlap = np.maximum(self.radius[self.bond].sum(axis=1) - self.distance, 0)
        one, other = self.radius[self.bond].T
        self.power = {"discs": 1.0, "spheres": 1.5}[name]
        self.law = (one * other / (one + other)) ** (self.power - 1)


@pytest.mark.parametrize("name", AXES)
def test_the_balls_bear_their_load(name):
    """Of discs F = h, and by the virial the pressure is sum F d / (2 A).

    Of spheres F = sqrt(R1 R2 / (R1 + R2)) h^(3/2); the walls bear opposite forces, .001 a sphere.
    """
    balls = Dumps(name)
    limit, total = 1e-10 * balls.force.mean(), pushes(balls)
    assert np.allclose(balls.force, balls.law * balls.overlap**balls.power, rtol=0, atol=limit)
    assert np.abs(total[balls.type < 3]).max() < limit
    if name == "discs":
        virial = balls.force @ balls.distance / (2 * balls.size.prod())
        assert virial == pytest.approx(0.02, rel=1e-9)
    else:
        walls = [total[balls.type == wall, 0].sum() for wall in (3, 4)]
        assert walls == pytest.approx([-0.036, 0.036], rel=1e-9)


@pytest.mark.parametrize("name", AXES)
def test_the_networks_are_those_of_the_dumps(name, tmp_path):
    dumps = [str(PACKINGS / f"{name}.{part}") for part in ("atoms", "contacts")]
    imports.run([*dumps, "-o", str(tmp_path / "a.h5"), *HELD[name]])
    with h5py.File(tmp_path / "a.h5") as made, h5py.File(PACKINGS / f"{name}.h5") as shipped:
        assert [*made["network"]] == [*shipped["network"]]
        for part, array in made["network"].items():
            assert np.array_equal(array, shipped["network"][part])
        for part, value in shipped["network"].attrs.items():
            assert np.array_equal(made["network"].attrs[part], value)
    # contacts by geometry are LAMMPS's: in the box of the dump, and in that of a table
    known, table = pgran.matrices(PACKINGS / f"{name}.h5"), tmp_path / "a.csv"
    table.write_text(Path(dumps[0]).read_text().partition("ITEM: ATOMS ")[2])
    box = {"discs": "22.972206471849454,22.972206471849454", "spheres": "0,6,6"}[name]
    for words in (dumps[:1], [str(table), "--box", box]):
        imports.run([*words, "-o", f"{tmp_path}/a.h5", "--overwrite", *HELD[name]])
        for one, other in zip(pgran.matrices(f"{tmp_path}/a.h5")[:3], known, strict=False):
            assert abs(one - other).max() <= 1e-8 * abs(other).max()


@pytest.mark.parametrize("name", AXES)
def test_all_modes_of_the_packings(name):
    """Those of K summed contact by contact from the dumps; no mode is missing, which is proven."""
    dumps, network = Dumps(name), read_network(PACKINGS / f"{name}.h5")
    axes, count = AXES[name], len(dumps.radius)
    along = np.einsum("ci,cj->cij", dumps.normal, dumps.normal)
    stiffness = dumps.power * dumps.law * dumps.overlap ** (dumps.power - 1)
    stiffness[dumps.overlap == 0] = 0.0
    shear = (dumps.force / dumps.distance)[:, None, None]
    blocks = stiffness[:, None, None] * along - shear * (np.eye(axes) - along)
    K = np.zeros((count, count, axes, axes))
    i, j = dumps.bond.T
    for here, there, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
        np.add.at(K, (here, there), sign * blocks)
    with h5py.File(PACKINGS / f"{name}.h5") as file:
        balls = file["network/id"][()] - 1
    free = balls[network.free]
    K = K[np.ix_(free, free)].transpose(0, 2, 1, 3).reshape(2 * [len(free) * axes])
    weights = np.repeat(1 / np.sqrt(network.masses[network.free]), axes)
    squares = np.linalg.eigvalsh(weights[:, None] * K * weights)
    modes = pgran.find_modes(network)
    assert modes.count_certified
    assert modes.omega_bound.max() < 1e-10
    np.testing.assert_allclose(modes.omega**2, squares, rtol=0, atol=1e-9 * squares[-1])


@pytest.mark.parametrize(
    "path", sorted((ROOT / "options").glob("*packing*.opts")), ids=lambda p: p.stem
)
def test_experiments_on_packings_listen_to_free_balls(path, monkeypatch, here):
    monkeypatch.chdir(ROOT)
    options = resolve(read_file(path))
    network = read_network(options.network_file[0])
    assert np.all(network.held[list(getattr(options, "detectors", ()))] == FREE)


def test_the_beads_are_at_rest_under_their_load():
    """Of glass, under 30 weights of a bead in the mean; a bead that grows does so by 1000 A."""
    options = resolve(read_file(ROOT / "options" / "heater_packing.opts"))
    beads = read_network(PACKINGS / "beads.h5")
    one, other = beads.radius[beads.bond].T
    overlap = (beads.force / np.sqrt(one * other / (one + other))) ** (2 / 3)
    assert np.allclose(beads.stiffness, 1.5 * beads.force / overlap, rtol=1e-12, atol=0)
    assert np.abs(pushes(beads)[beads.free]).max() <= 1e-12 * beads.force.mean()
    gaps = np.linalg.norm(
        beads.position[beads.bond[:, 1]] - beads.position[beads.bond[:, 0]], axis=1
    )
    inside = gaps < 2  # others are periodic images
    assert np.abs(one + other - gaps - overlap)[inside].max() <= 1e-9 * overlap.mean()
    acceleration = options.units_length / options.units_time**2
    assert beads.force.mean() / beads.mass * acceleration / 9.81 == pytest.approx(30, rel=0.05)
    assert options.heat_radius * options.units_length == pytest.approx(1e-7)


def test_the_network_that_the_manual_writes(tmp_path, monkeypatch):
    """Three contacts of one free ball: K is the sum of k n n^T."""
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    (lines,) = (block for block in blocks if "network/bond" in block)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "results").mkdir()
    exec(lines, {})
    network = read_network("results/mine.h5")
    n = np.array([[0.5, 0.9], [-0.5, 0.9], [1, 0]])
    n /= np.linalg.norm(n, axis=1)[:, None]
    K = np.einsum("c,ci,cj->ij", [1, 1, 0.5], n, n)
    assert np.allclose(network.restoring_forces(np.eye(2)), K, rtol=1e-14, atol=1e-14)
