"""Samples that are networks, listed, or in files: each as it comes out alone."""

import numpy as np
import pytest
from network_samples import as_network
from samples import run_scene
from test_ensemble import LATTICE, OMEGAS, lattice_of

import pgran
from pgran.command.resolve import resolve
from pgran.errors import FileError, InputError
from pgran.experiments.ensemble import sampling
from pgran.medium.base import record_of
from pgran.medium.network_file import parts_of, write_network
from pgran.run.options import read_words
from pgran.store import file as store


def test_samples_of_networks(world):
    """From a function of the seed: here a ring of contacts on the paper's model."""

    def ring(seed):
        rng = np.random.default_rng(seed)
        bond = [(n, (n + 1) % 8) for n in range(8)]
        return pgran.Network(bond, rng.uniform(0.1, 0.3, 8), held=[2, 0, 0, 0, 1, 0, 0, 0])

    found = pgran.ensemble("modes", 3, lattice=ring, seed=4, keep="curves")
    for n in range(3):
        assert np.array_equal(found.mode_omega[n], pgran.find_modes(ring(4 + n)).omega)
    assert found.seed.tolist() == [4, 5, 6]


def test_samples_of_a_list(place):
    """Lattices, networks, results and files of both."""
    lattices = [lattice_of(seed) for seed in (7, 8, 9)]
    asked = {"omegas": OMEGAS, "detectors": (2, 2), "keep": "curves"}
    expected = pgran.ensemble("response", 3, lattice=LATTICE, seed=7, **asked)
    run = {"scene": "modes", "bonds_sha256": ""}
    path = place("a.h5", store.write, run, [record_of(lattices[2])])
    for listed in ([*lattices[:2], path], [*lattices[:2], pgran.load(path)]):
        found = pgran.ensemble("response", 3, lattice=listed, **asked)
        assert np.array_equal(found.displacement, expected.displacement)
        assert found.seed.tolist() == [0, 1, 2]
    balls = {"held": [2, 0, 0], "bond": [[0, 1], [1, 2]], "stiffness": [1.0, 0.5]}
    path = place("n.h5", write_network, balls, {})
    network = pgran.load(path)
    found = pgran.ensemble("modes", 2, lattice=[network, str(path)], keep="curves")
    assert np.array_equal(found.mode_omega, [pgran.find_modes(network).omega] * 2)


@pytest.mark.parametrize("of", ["response", "modes"])
def test_samples_that_are_files_of_packings(world, place, caplog, of):
    """Each of its own size, heard by the free balls nearest to a place."""
    packed = [pgran.pack(30, pressure=0.05, walls="x", seed=seed) for seed in (1, 2)]
    assert packed[0].size != packed[1].size
    for n, network in enumerate(packed):
        path = place(f"pack_{n}.h5", write_network, *parts_of(network))
    words = "-sweep_omega .3,.5 -detectors_at 3,2,2,3 -transport_depths 1,2"
    words = words if of == "response" else ""
    keep = f"-network_file {path.parent}/pack_*.h5 -ensemble_keep curves"
    options = resolve(read_words(f"-scene ensemble -ensemble_of {of} {keep} {words}".split()))
    _, found = world.bcast(run_scene(options, world))
    told = "-transport_depths: no transport; detectors at three depths" in caplog.text
    assert told == (of == "response" and world.rank == 0)
    for n, network in enumerate(packed):
        if of == "modes":
            own, count = pgran.find_modes(network).omega, network.size
            assert np.array_equal(found.mode_omega[n, :count], own)
            assert np.isnan(found.mode_omega[n, count:]).all()
        else:
            away = np.linalg.norm(network.position - np.array([[[3, 2]], [[2, 3]]]), axis=2)
            near = np.where(network.held == 0, away, np.inf).argmin(axis=1)
            assert np.array_equal(
                found.displacement[n], pgran.sweep(network, [0.3, 0.5], near).displacement
            )


@pytest.mark.parametrize(
    ("last", "asked", "said"),
    [
        ("cut off", "-detectors 1", "cut off before its end"),
        ("held", "-detectors 1", "-detectors: ball 1 is held"),
        ("held", "-detectors 2 -drive_balls 1", "-drive_balls: ball 1 is held"),
    ],
)
def test_all_files_are_looked_at_before_any_work(world, place, monkeypatch, last, asked, said):
    """The last of many may be bad, or lack the ball that is to listen, or to be pushed."""

    def write(path, held):
        balls = {"held": held, "bond": [[0, 1], [1, 2]], "stiffness": [1.0, 0.5]}
        write_network(path, balls, {})
        if path.name == "3.h5" and last == "cut off":
            path.write_bytes(path.read_bytes()[:-100])

    files = [place(f"{n}.h5", write, [2, n == 3 and last == "held", 0]) for n in range(4)]
    monkeypatch.setattr(sampling.Samples, "work", lambda *_: pytest.fail("worked"))
    words = f"-network_file {','.join(map(str, files))} {asked} -sweep_omega .3"
    with pytest.raises((FileError, InputError), match=f"3(.h5)?: .*{said}"):
        run_scene(resolve(read_words(f"-scene ensemble {words}".split())), world)


def test_places_that_name_no_ball(caplog):
    network = pgran.Network([[0, 1]], [1.0], [0, 1], position=[[0.0, 0.0], [1.0, 0.0]])
    for of, place, message in (
        (network, (1, 1, 1), "-detectors_at: a place has 2 coordinates"),
        (network, (0, 0, 1, 1), "-detectors_at: two places have the same nearest ball"),
        (as_network(lattice_of(1)), (1, 1), "-detectors_at: this network has no positions"),
    ):
        with pytest.raises(InputError, match=message):
            of.nearest_free(place)
    network.nearest_free((9.0, 0.0))
    assert "-detectors_at: the nearest free ball, 0, is 9 away" in caplog.text
