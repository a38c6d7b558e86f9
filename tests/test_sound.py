"""Speeds of long waves by statics: crystals in closed form, chains, packings, what is refused."""

import dataclasses

import numpy as np
import pytest
from samples import random_lattice

import pgran
import pgran.__main__ as program
from pgran.command.resolve import resolve
from pgran.command.sound import table
from pgran.medium import crystals, statics
from pgran.medium.base import record_of
from pgran.medium.graph import rattlers, subnetwork, with_rattlers_at_rest
from pgran.medium.network_file import parts_of, write_network
from pgran.medium.sample import make_lattice
from pgran.run.options import read_words
from pgran.store.si import SI

BOX = [6, 4 * 3**0.5]
TRIANGULAR = dataclasses.replace(crystals.triangular((6, 4), periodic=True), box=BOX)


def squares(waves):
    return [x * abs(x) for x in waves]


@pytest.mark.parametrize("force", [0.0, 0.1])
@pytest.mark.parametrize("kt", [0.0, 0.3])
def test_triangular_lattice(force, kt):
    """c_L^2 = 9/8 k + 3/8 (k_t - F), c_T^2 = 3/8 (k + k_t) - 9/8 F, of any masses, isotropic.

    Relaxed is affine, but for rotations, which take the mean slip off.
    """
    masses, contacts = np.random.default_rng(1).uniform(1, 5, 48), 2 * np.ones(144)
    values = {"stiffness": contacts, "force": force * contacts, "masses": masses}
    if kt:
        values |= {"displacement": "rotations", "tangential": kt * contacts}
        values["radius"] = np.full(48, 0.5)
    found = pgran.sound(dataclasses.replace(TRIANGULAR, **values))
    along = (9 / 8 + 3 / 8 * (kt - force)) * 2 / masses.mean()
    across = (3 / 8 * (1 + kt) - 9 / 8 * force) * 2 / masses.mean()
    unturned = across + 3 / 4 * kt * 2 / masses.mean()
    np.testing.assert_allclose(squares(found.longitudinal), along, rtol=1e-12)
    np.testing.assert_allclose(squares(found.transverse), [across, unturned, across, across])
    assert found.shear == pytest.approx(across * found.density)
    assert found.bulk == pytest.approx((along - across) * found.density)
    # a mode for each (2 pi)^2 / V of wave vectors q = omega / c, and polarisation
    debye = np.prod(BOX) / 48 * 0.2 / (2 * np.pi) * (1 / along + 1 / across)
    assert found.debye(0.2) == pytest.approx(debye)


def test_cubic_crystal_by_directions():
    """fcc: C11 = 2 C12 = 2 C44 = 2 k / a, rho = 4 m / a^3, a^2 = 2; along 100, 110 and 111."""
    network = crystals.fcc((3, 3, 3), periodic=True)
    found = pgran.sound(dataclasses.replace(network, box=np.full(3, 3 * 2**0.5)))
    voigt = (3 * 2 + 2 * 1 + 4) / 10, (2 - 1 + 3) / 10  # the means of an isotropic medium
    np.testing.assert_allclose(squares(found.longitudinal)[1:], [voigt[0], 1, 4 / 3])
    np.testing.assert_allclose(squares(found.transverse)[1:], [voigt[1], 1 / 4, 1 / 2])
    assert found.bulk == pytest.approx(found.density * (2 + 2) / 3 / 2)


def test_scalar_chains_are_springs_in_a_row():
    """Between walls, and around a ring of unequal contacts and masses."""
    lattice = random_lattice((30,), 5, mass=1.7)
    found = pgran.sound(lattice).longitudinal
    soft, mean = 31 / np.sum(1 / lattice.constants), lattice.constants.mean()
    np.testing.assert_allclose(squares(found)[:2], [soft / 1.7, mean / 1.7])
    rng, places = np.random.default_rng(2), 14 * np.arange(10) / 10
    k, masses, last = rng.uniform(0.1, 1, 10), rng.uniform(1, 3, 10), np.arange(10)
    position = (places + rng.uniform(-0.2, 0.2, 10))[:, None]
    bond = np.stack([last, (last + 1) % 10], axis=1)
    ring = pgran.Network(bond, k, 0 * last, masses, position=position, box=[14.0])
    speed = pgran.sound(ring).longitudinal.speed
    assert speed**2 == pytest.approx(14**2 / np.sum(1 / k) / masses.sum(), rel=1e-12)


def test_lattices_between_walls():
    """Equal bonds resist as they are; random ones as effective-medium theory says."""
    found = pgran.sound(pgran.Lattice.random((6, 4, 3), law="constant", kmax=0.3, mass=2.0))
    np.testing.assert_allclose(squares(found.longitudinal), 0.15)
    found = pgran.sound(pgran.Lattice.random((6, 4), law="constant", kmax=0.3, free=["y+"]))
    np.testing.assert_allclose(squares(found.longitudinal), 0.3)
    with pytest.raises(pgran.InputError, match="no axis of the lattice has two walls"):
        pgran.sound(pgran.Lattice.random((6, 4), free=["x-", "y+"]))
    found = pgran.sound(pgran.Lattice.random((100, 100))).longitudinal
    assert found.speed == pytest.approx(0.316, abs=0.002)


def waves_of(network, q):
    """c^2 of both Bloch waves along each direction `q`, ascending, the box their cell."""
    n, kd, balls = network.normal, network.force / network.distance, len(network.held)
    blocks = np.einsum("b,bi,bj->bij", network.stiffness + kd, n, n) - kd[:, None, None] * np.eye(2)
    root, squares, short = np.sqrt(np.repeat(network.masses, 2)), [], 3e-4
    for along in q / np.linalg.norm(q, axis=1)[:, None]:
        K = np.zeros((balls, 2, balls, 2), complex)
        turn = np.exp(1j * short * network.distance * (n @ along))
        for (i, j), block, phase in zip(network.bond, blocks, turn, strict=True):
            K[i, :, i] += block
            K[j, :, j] += block
            K[i, :, j] -= block * phase
            K[j, :, i] -= block / phase
        values = np.linalg.eigvalsh(K.reshape(2 * balls, -1) / root / root[:, None])
        squares.append(np.sort(values[np.argsort(np.abs(values))[:2]]) / short**2)
    return np.array(squares)


@pytest.mark.parametrize(("seed", "stable"), [(1, True), (3, False)])
def test_packings_have_the_speeds_of_their_bloch_waves(seed, stable):
    """Also where shear along some direction would rearrange a packing: c^2 < 0."""
    packed = pgran.pack(60, pressure=1e-2, seed=seed)
    found = pgran.sound(packed)
    assert (found.transverse.slowest > 0) == stable
    steps = np.array([(1, 0), (2, 1), (1, 1), (1, 2), (0, 1), (-1, 2), (-1, 1), (-2, 1)])
    both = found.transverse, found.longitudinal
    for waves, each in zip(both, waves_of(packed, steps).T, strict=True):
        np.testing.assert_allclose(squares(waves)[2:], [each.min(), each.max()], atol=1e-5)
    evenly = np.arange(8) * np.pi / 8  # of which the mean is that of all directions
    total = waves_of(packed, np.stack([np.cos(evenly), np.sin(evenly)], axis=1)).sum() / 8
    assert sum(waves.speed**2 for waves in both) == pytest.approx(total, rel=1e-5)


def test_rattlers_are_left_out(tmp_path, world):
    """A ball with two contacts left; of a path all; in a run they rest, and keep their numbers."""
    cut = np.flatnonzero(np.any(TRIANGULAR.bond == 20, axis=1))[2:]
    loose = subnetwork(TRIANGULAR, contacts=np.setdiff1d(np.arange(144), cut))
    rest, balls = pgran.without_rattlers(loose)
    assert np.array_equal(balls, np.delete(np.arange(48), 20))
    assert pgran.sound(loose) == pgran.sound(rest)._replace(rattlers=1)
    write_network(tmp_path / "a.h5", *parts_of(loose))
    words = ["-scene", "modes", "-network_rattlers", "remove"]
    file = ["-network_file", str(tmp_path / "a.h5")]
    made = make_lattice(resolve(read_words([*words, *file])), world)
    assert np.array_equal(made.held, np.arange(48) == 20)
    assert made.bonds == rest.bonds
    with pytest.raises(pgran.InputError, match="network_rattlers belongs"):
        resolve(read_words(words))
    bond = [[0, 1], [1, 2], [2, 0], [2, 3], [3, 4]]
    places = [[0, 0], [1, 0], [0, 1], [0, 2], [0, 3]]
    path = pgran.Network(bond, np.ones(5), [1, 1, 0, 0, 0], displacement="vector", position=places)
    rough = dataclasses.replace(path, tangential=np.ones(5))
    scalar = dataclasses.replace(path, displacement="scalar", direction=None)
    for network, few in ((path, [2, 3, 4]), (rough, [3, 4]), (scalar, [])):
        assert np.flatnonzero(rattlers(network)).tolist() == few
    for leave_out in (pgran.sound, pgran.without_rattlers, with_rattlers_at_rest):
        with pytest.raises(pgran.InputError, match="all of its 3 free balls are rattlers"):
            leave_out(path)
    assert pgran.find_modes(rough).omega[0] > 0.1  # rattlers hang on one contact, in two ways


def test_what_has_no_sound(monkeypatch):
    for changes, message in (
        ({"box": None}, "need a box"),
        ({"box": [6.0, 0.0]}, "need a box"),
        ({"held": [2] + 47 * [0]}, "need a box .* no ball that is held"),
        ({"force": np.full(144, 0.4)}, "unstable"),
        ({"stiffness": np.zeros(144)}, "loose"),
        ({"stiffness": np.repeat([1.0, 0.0], [96, 48])}, "loose"),
    ):
        with pytest.raises(pgran.InputError, match=f"^sound: .*{message}"):
            pgran.sound(dataclasses.replace(TRIANGULAR, **changes))
    monkeypatch.setattr(statics, "LARGEST_IMBALANCE", -1.0)
    with pytest.raises(pgran.PgranError, match="forces balance to"):
        pgran.sound(random_lattice((5, 4)))


def test_sound_in_words(tmp_path, capsys, caplog):
    """Of a network's file and of a lattice, in SI units where these are known."""
    packed, path = pgran.pack(60, pressure=1e-2, seed=3), str(tmp_path / "packed.h5")
    write_network(path, *parts_of(packed))
    assert program.main(["sound", path]) == 0
    found, (first, _, *rows) = pgran.sound(packed), capsys.readouterr().out.splitlines()
    assert first.startswith(f"{found.balls} balls, in a periodic box, 0 rattlers left out")
    told = {row[:32].strip(): row[32:].split() for row in rows}
    assert told["transverse waves"][0] == f"{found.transverse.speed:.4g}"
    assert told["bulk modulus"] == [f"{found.bulk:.4g}"]
    assert "c^2 < 0; such a shear would rearrange" in caplog.text
    lattice = record_of(pgran.Lattice.random((6, 5), law="constant"))
    _, _, waves, *_ = table(pgran.sound(lattice), lattice, SI(2.0, 1e-3))
    assert waves.startswith("long waves ")
    assert waves.endswith("(1 km/s)")
