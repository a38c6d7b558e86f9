"""Speeds of long waves by statics: crystals in closed form, chains, packings, what is refused."""

import dataclasses

import numpy as np
import pytest
from samples import random_lattice

import pgran
import pgran.__main__ as program
from pgran.command.resolve import resolve
from pgran.command.sound import table
from pgran.errors import InputError
from pgran.medium import crystals
from pgran.medium.graph import part, rattlers
from pgran.medium.network import Network
from pgran.medium.network_file import parts_of, write_network
from pgran.medium.record import record_of
from pgran.medium.sample import make_lattice
from pgran.run.reading import read_words
from pgran.store.si import SI


def squares(waves):
    return [x**2 for x in (waves.speed, waves.affine, waves.slowest, waves.fastest)]


@pytest.mark.parametrize("force", [0.0, 0.1])
@pytest.mark.parametrize("tangential", [None, 0.3])
def test_triangular_lattice(force, tangential):
    """c_L^2 = 9/8 k + 3/8 (k_t - F), c_T^2 = 3/8 (k + k_t) - 9/8 F: relaxed = affine, isotropic.

    With rotations, which take the mean slip off; affine ones do not turn. Masses are those of all
    balls together.
    """
    kind = "vector" if tangential is None else "rotations"
    network = crystals.triangular((6, 4), 2.0, periodic=True, displacement=kind, damping=0.0)
    contacts = np.ones(network.bonds)
    masses = np.random.default_rng(1).uniform(1, 5, 48)
    values = {"force": 2 * force * contacts, "box": [6, 4 * 3**0.5], "masses": masses}
    if tangential:
        values["tangential"] = 2 * tangential * contacts
    found = pgran.sound(dataclasses.replace(network, **values))
    scale, kt = 2.0 / masses.mean(), tangential or 0.0
    along = scale * (9 / 8 + 3 / 8 * (kt - force))
    across = scale * (3 / 8 * (1 + kt) - 9 / 8 * force)
    unturned = scale * (3 / 8 - 9 / 8 * force + 9 / 8 * kt)
    np.testing.assert_allclose(squares(found.longitudinal), along, rtol=1e-12)
    np.testing.assert_allclose(squares(found.transverse), [across, unturned, across, across])
    assert found.shear == pytest.approx(across * masses.sum() / found.volume)
    assert found.bulk == pytest.approx((along - across) * masses.sum() / found.volume)
    # a mode a unit of area, k space and polarisation: V / (2 pi)^2 2 pi q dq, q = omega / c
    debye = found.volume / 48 * 0.2 / (2 * np.pi) * (1 / along + 1 / across)
    assert found.debye(0.2) == pytest.approx(debye)


def test_cubic_crystal_by_directions():
    """fcc: C11 = 2 C12 = 2 C44 = 2 k / a, rho = 4 m / a^3, a^2 = 2; along 100, 110 and 111."""
    network = crystals.fcc((3, 3, 3), periodic=True)
    found = pgran.sound(dataclasses.replace(network, box=np.full(3, 3 * 2**0.5)))
    np.testing.assert_allclose(squares(found.longitudinal)[2:], [1, 4 / 3], rtol=0.01)
    np.testing.assert_allclose(squares(found.transverse)[2:], [1 / 4, 1 / 2], rtol=0.01)
    # the means of c^2 are those of the Voigt averages of an isotropic medium
    assert squares(found.longitudinal)[0] == pytest.approx((3 * 2 + 2 * 1 + 4) / 5 / 2)
    assert squares(found.transverse)[0] == pytest.approx((2 - 1 + 3) / 5 / 2)
    assert found.bulk == pytest.approx(found.density * (2 + 2) / 3 / 2)


def test_scalar_chains_are_springs_in_a_row():
    """Between walls, and around a ring, whose contacts are not alike."""
    lattice = random_lattice((30,), 5, mass=1.7)
    soft = 31 / np.sum(1 / lattice.constants)
    found = pgran.sound(lattice)
    assert squares(found.longitudinal)[0] == pytest.approx(soft / 1.7, rel=1e-12)
    assert found.longitudinal.affine == pytest.approx(np.sqrt(lattice.constants.mean() / 1.7))
    assert (found.transverse, np.isnan(found.bulk)) == (None, True)
    rng, apart = np.random.default_rng(2), np.arange(9.0) ** 2
    k, masses = rng.uniform(0.1, 1, 10), rng.uniform(1, 3, 10)
    bond = np.stack([np.arange(10), (np.arange(10) + 1) % 10], axis=1)
    position = np.append(0.0, np.cumsum(1 + 0.01 * apart))[:, None]
    ring = Network(bond, k, np.zeros(10, int), masses, position=position, box=[14.0])
    along = pgran.sound(ring).longitudinal.speed ** 2
    assert along == pytest.approx(14**2 / np.sum(1 / k) / masses.sum(), rel=1e-12)


def test_square_lattice_between_walls():
    """Equal bonds resist as they are; random ones as effective-medium theory says."""
    found = pgran.sound(pgran.Lattice.random((6, 4, 3), law="constant", kmax=0.3, mass=2.0))
    np.testing.assert_allclose(squares(found.longitudinal), 0.15)
    found = pgran.sound(pgran.Lattice.random((100, 100)))
    assert found.longitudinal.speed == pytest.approx(0.316, abs=0.002)
    assert found.longitudinal.affine > 1.1 * found.longitudinal.speed


def waves_of(network, angle, q=1e-3):
    """c^2 of both waves along a direction, ascending: of Bloch waves, the box their cell."""
    n, kd, balls = network.normal, network.force / network.distance, len(network.held)
    blocks = np.einsum("b,bi,bj->bij", network.stiffness + kd, n, n) - kd[:, None, None] * np.eye(2)
    along = q * np.array([np.cos(angle), np.sin(angle)])
    turn = np.exp(1j * network.distance * (n @ along))
    K = np.zeros((balls, 2, balls, 2), complex)
    for (i, j), block, phase in zip(network.bond, blocks, turn, strict=True):
        K[i, :, i] += block
        K[j, :, j] += block
        K[i, :, j] -= block * phase
        K[j, :, i] -= block / phase
    root = np.sqrt(np.repeat(network.masses, 2))
    values = np.linalg.eigvalsh(K.reshape(2 * balls, -1) / root / root[:, None])
    return values[np.argsort(np.abs(values))[:2]] / q**2


@pytest.mark.parametrize(("seed", "stable"), [(1, True), (3, False)])
def test_packings_have_the_speeds_of_their_bloch_waves(seed, stable):
    """Also where shear along some direction would rearrange a packing; c^2 < 0 then."""
    packed = pgran.pack(60, pressure=1e-2, seed=seed)
    found = pgran.sound(packed)
    exact = np.sort([waves_of(packed, angle) for angle in np.arange(8) * np.pi / 8])
    low, high = np.min(exact, axis=0), np.max(exact, axis=0)
    for waves, slowest, fastest in zip(
        (found.transverse, found.longitudinal), low, high, strict=True
    ):
        assert waves.slowest * abs(waves.slowest) <= slowest + 1e-5
        assert waves.fastest**2 >= fastest - 1e-5
        assert waves.speed < waves.affine
    total = found.transverse.speed**2 + found.longitudinal.speed**2
    assert total == pytest.approx(exact.sum(axis=1).mean(), rel=1e-5)
    assert (found.transverse.slowest > 0) == stable


def test_rattlers_are_left_out():
    """A ball with two contacts left: the others have the sound of the crystal without it."""
    box = {"box": [6, 4 * 3**0.5], "masses": np.arange(1.0, 49)}
    crystal = dataclasses.replace(crystals.triangular((6, 4), periodic=True), **box)
    cut = np.flatnonzero(np.any(crystal.bond == 20, axis=1))[2:]
    loose = part(crystal, contacts=np.setdiff1d(np.arange(crystal.bonds), cut))
    rest, balls = pgran.without_rattlers(loose)
    assert np.array_equal(balls, np.delete(np.arange(48), 20))
    found, bare = pgran.sound(loose), pgran.sound(rest)
    assert (found.rattlers, bare.rattlers) == (1, 0)
    assert found._replace(rattlers=0) == bare
    assert found.longitudinal.speed < min(found.longitudinal.affine, np.sqrt(9 / 8 / 24.5))


def test_how_many_contacts_hold_a_ball():
    """In two dimensions 3, with tangential springs 2, of scalars 1: a path of balls unravels."""
    bond = [[0, 1], [1, 2], [2, 0], [2, 3], [3, 4]]
    position = [[0, 0], [1, 0], [0.5, 0.9], [0.5, 1.9], [0.5, 2.9]]
    path = Network(bond, np.ones(5), [1, 1, 0, 0, 0], displacement="vector", position=position)
    rough = dataclasses.replace(path, tangential=np.ones(5))
    scalar = dataclasses.replace(path, displacement="scalar", direction=None)
    for network, loose in ((path, [2, 3, 4]), (rough, [3, 4]), (scalar, [])):
        assert np.flatnonzero(rattlers(network)).tolist() == loose


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"box": None}, "does not say its positions"),
        ({"box": [6.0, 0.0]}, "not periodic along y"),
        ({"held": [2] + 47 * [0]}, "balls of the network are held"),
        ({"force": np.full(144, 0.4)}, "unstable"),
        ({"stiffness": np.zeros(144)}, "c.2 = 0 in the mean"),
        ({"stiffness": np.repeat([1.0, 0.0], [96, 48])}, "loose"),
    ],
)
def test_what_has_no_sound(changes, message):
    network = crystals.triangular((6, 4), periodic=True)
    box = {"box": [6, 4 * 3**0.5]}
    with pytest.raises(InputError, match=f"^sound: .*{message}"):
        pgran.sound(dataclasses.replace(network, **box | changes))


def test_sound_in_words(tmp_path, capsys, caplog):
    """Of a network's file and of a result's lattice, in SI units where these are known."""
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


def test_rattlers_of_a_run(tmp_path, world):
    """They touch nothing, and balls keep their numbers; of a lattice there are none."""
    bond, position = [[0, 1], [0, 2], [1, 2], [2, 3]], [[0, 0], [2, 0], [1, 0.1], [1, 1]]
    network = Network(bond, np.ones(4), [1, 2, 0, 0], displacement="vector", position=position)
    rough = dataclasses.replace(network, tangential=np.ones(4))
    write_network(tmp_path / "rough.h5", *parts_of(rough))
    words = ["-scene", "modes", "-network_rattlers", "remove", "-network_file"]
    made = make_lattice(resolve(read_words([*words, str(tmp_path / "rough.h5")])), world)
    assert np.array_equal(made.held, [1, 2, 0, 1])
    assert np.array_equal(made.bond, bond[:3])
    with pytest.raises(InputError, match="-network_rattlers belongs"):
        resolve(read_words(words[:4]))
