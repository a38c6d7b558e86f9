"""Packings made here: what was asked, the laws of jamming, the command."""

import dataclasses

import numpy as np
import pytest

import pgran
from pgran.balance import settle
from pgran.balance.equilibrium import NotBalancedError
from pgran.balance.pack import diameters, packed_network


def test_sizes():
    rng = np.random.default_rng(1)
    two = diameters(10, "bidisperse", rng)
    assert [*np.unique(two) / two.min()] == pytest.approx([1, 1.4])
    assert np.ptp(diameters(10, "equal", rng)) == 0
    spread = diameters(1000, 0.1, rng)
    assert 0.19 < np.ptp(spread) < 0.201
    assert [two.mean(), spread.mean()] == pytest.approx([1, 1])
    assert diameters(3, [1.0, 2.0, 3.0], rng).tolist() == [0.5, 1.0, 1.5]


def test_a_packing_floats_with_the_modes_of_a_rigid_body():
    """Translations along each axis cost nothing, all else does; the seed alone says which it is."""
    network = pgran.pack(60, pressure=1e-2, seed=2)
    assert network == pgran.pack(60, pressure=1e-2, seed=2) != pgran.pack(60, pressure=1e-2, seed=3)
    assert not network.held.any()
    omega = pgran.find_modes(network).omega / network.omega_mx
    assert np.sum(np.abs(omega) < 1e-6) == 2
    assert np.all(np.sort(omega)[2:] > 1e-3)


def test_the_unit_of_frequency_has_the_rattlers_too():
    network = pgran.pack(60, pressure=1e-3, seed=2)
    median = np.mean(np.array([2.0, 2.8]) ** 2) / 2.4**2  # of 30 small discs and 30 large ones
    assert network.radius.size < 60
    assert network.median_mass == pytest.approx(median) != np.median(network.masses)


def test_walls_hold_both_ends():
    network = pgran.pack(120, pressure=1e-2, walls="x", shape=(2, 1), seed=2)
    assert network.box[0] == 0 < network.box[1]
    x = network.position[:, 0]
    assert x[network.held == 1].max() < x[network.held == 0].mean() < x[network.held == 2].min()
    across = np.abs(np.diff(x[network.bond], axis=1))
    assert across.max() < 2 * network.radius.max()  # no contact leads through the ends
    response = pgran.sweep(network, [0.3 * network.omega_mx], network.free[:1], method="points")
    assert response.error_bound[0, 0] <= 1e-4 * abs(response.displacement[0, 0])


def test_a_heap_between_walls_stands_on_a_floor_at_rest():
    """The floor's balls are the last; the free ones' weight is on it and on the walls."""
    network, packed = packed_network(60, gravity=1e-4, walls="x", seed=1)
    floor = packed.rest.balls.held
    assert floor[-1]
    assert np.all(network.held[floor] == 1)
    assert {*network.held[~floor]} == {0, 1, 2}
    assert np.median(network.position[floor, 1]) < network.position[~floor, 1].min()


def test_a_part_of_a_wall_drives():
    """The rest of both walls is at rest, and forces on the free balls are as they were."""
    choices = {"gravity": 1e-4, "walls": "x", "seed": 1}
    whole = pgran.pack(60, **choices)
    network = pgran.pack(60, **choices, drive="x>max-1 and y<4", rest="y<1 and x<3")
    assert np.array_equal(network.position, whole.position)
    (x, y), far = network.position.T, whole.held == 2
    driven, resting = network.held == 2, network.held == 1
    assert np.array_equal(driven, (x > x.max() - 1) & (y < 4))
    assert 0 < np.count_nonzero(driven) < np.count_nonzero(far)
    assert np.array_equal(resting, ~driven & ((whole.held > 0) | ((y < 1) & (x < 3))))
    each = [{(*pair,) for pair in net.bond.tolist()} for net in (network, whole)]
    assert each[0] <= each[1]
    assert np.all(np.any(network.held[network.bond] == 0, axis=1))
    periodic = pgran.pack(80, pressure=1e-2, seed=2, rest="x<1.5", drive="x>max-1.5")
    assert np.all(periodic.box > 0)
    response = pgran.sweep(periodic, [0.3 * periodic.omega_mx], periodic.free[:1], method="points")
    assert response.error_bound[0, 0] <= 1e-4 * abs(response.displacement[0, 0])


@pytest.mark.parametrize("law", ["harmonic", 2.0])
def test_strong_gravity_squeezes_no_ball_through_the_floor(law):
    """Softer balls settle under less of it first."""
    network, packed = packed_network(60, law=law, gravity=2e-3, seed=2)
    assert len(network.free) + packed.rattlers == 60
    floor = network.held > 0
    assert network.position[~floor, -1].min() > network.position[floor, -1].max()
    assert packed.descents < 9000


def test_balls_that_find_no_rest_are_an_error(monkeypatch):
    """They fall through the floor, or Newton's method fails after all descents."""
    fire = settle.fire
    monkeypatch.setattr(settle, "fire", lambda *words, **by: fire(*words, **by | {"steps": 900}))
    with pytest.raises(NotBalancedError, match=r"\d+ balls have fallen through the floor: gravity"):
        pgran.pack(60, law="hertz", gravity=0.2, seed=2)

    def fails(*words):
        raise NotBalancedError("no")

    monkeypatch.setattr(settle, "at_rest", fails)
    monkeypatch.setattr(settle, "RETURNS", 2)
    with pytest.raises(NotBalancedError, match="try another seed"):
        pgran.pack(30, pressure=1e-2)


def test_bad_packings_are_refused():
    refused = {
        "either a pressure or gravity": [{}, {"pressure": 1, "gravity": 1}],
        "must be positive": [{"pressure": 0}, {"gravity": -1.0}],
        "discs have 2": [{"pressure": 1, "dimension": 4}],
        "power from 1": [{"pressure": 1, "law": 0.5}],
        "law": [{"pressure": 1, "law": "soft"}],
        "sizes": [{"pressure": 1, "sizes": s} for s in ("large", 1.5, [1.0, 2.0])],
        "walls": [{"pressure": 1, "walls": "z"}, {"gravity": 1, "walls": "y"}],
        "shape": [{"pressure": 1, "shape": s} for s in ([1], [1, -1], [[1, 1]])],
        "more balls": [{"pressure": 1e-3, "balls": 4}],
        "whole number": [{"pressure": 1, "balls": 2.5}],
        "(balls: must be 1|seed: must be 0) or more": [
            {"pressure": 1, "balls": 0},
            {"pressure": 1, "seed": -1},
        ],
        "pack: rest: a column: .*x, y, radius": [{"gravity": 1e-3, "rest": "z<1"}],
        "'upwards' is no condition": [{"gravity": 1e-3, "drive": "upwards"}],
        "cannot be both": [{"gravity": 1e-3, "drive": "x<2", "rest": "x<1"}],
        "no ball is left free": [{"gravity": 1e-3, "rest": "y>min-1"}],
        "y<=0: none of these balls touches": [
            {"gravity": 1e-3, "drive": "y<=0", "rest": "y>0 and y<3"}
        ],
    }
    for message, each in refused.items():
        for choices in each:
            with pytest.raises(pgran.InputError, match=message) as caught:
                pgran.pack(**{"balls": 50} | choices)
            assert "\n" not in str(caught.value)


def test_networks_of_balls(caplog):
    """Of its own places and radii a packing is itself; what cannot be is refused."""
    p = pgran.pack(60, sizes="equal", law="hertz", pressure=1e-3, seed=2)
    K = pgran.matrices(pgran.Network.of_balls(p.position, p.radius, p.box, "hertz", 3.0)).K
    assert abs(K - 3 * pgran.matrices(p).K).max() <= 1e-9 * abs(K).max()
    row = {"position": [[0, 0], [0.9, 0], [1.8, 0]], "radius": 0.5, "held": [1, 0, 1]}
    assert (pgran.Network.of_balls(**row).bonds, len(caplog.messages)) == (2, 1)  # a rattler
    pgran.Network.of_balls(p.position, 2 * p.radius, p.box)
    assert "are the radii diameters?" in caplog.text
    for message, wrong in (
        ("no two balls overlap", {"radius": 0.45}), ("a positive stiffness", {"modulus": -1.0}),
        ("positive radii", {"radius": [0.5, 0, 1]}), ("same place", {"position": [[1.0, 2]] * 3}),
        ("balls need", {"position": np.empty((0, 2))}), ("1e100", {"position": [[1e200, 0]] * 3}),
    ):  # fmt: skip
        with pytest.raises(pgran.InputError, match=message):
            pgran.Network.of_balls(**row | wrong)


def test_the_command_makes_an_ordered_counterpart(call, shared_path):
    words = ["pack", "--balls", "60", "--pressure", "1e-2", "--walls", "x", "--seed", "7"]
    done = call(*words, "--ordered", "-o", "b.h5")
    assert done.returncode == 0, done.stderr
    assert "along diagonals; of the packing itself:" in done.stdout
    packing = pgran.pack(60, pressure=1e-2, walls="x", seed=7)
    assert pgran.load(shared_path / "b.h5") == pgran.ordered(packing, 7)
    refused = call(*words, "--ordered", "--displacement", "vector", "-o", "c.h5")
    assert "shear of vectors" in refused.stderr


def test_the_command_makes_what_a_run_takes(call, place, shared_path):
    """Its file, its words, and the ways to go wrong."""
    words = ["pack", "--balls", "60", "--pressure", "1e-2", "--walls", "x", "--shape", "2,1"]
    words += ["--seed", "7", "--rest", "x<2", "-o", "a.h5"]
    made = call(*words)
    assert made.returncode == 0, made.stderr
    assert "1 rattler left out" in made.stdout
    assert "contacts more than an isostatic packing has" in made.stdout
    network = pgran.load(shared_path / "a.h5")
    assert network == pgran.pack(60, pressure=1e-2, walls="x", shape=(2, 1), seed=7, rest="x<2")
    floats = call("pack", "--balls", "60", "--pressure", "1e-2", "-o", "c.h5")
    place("b.opts", "-scene response -sweep_points 3 -output_overwrite -output_file r.h5")
    for done in floats, made:
        run = call("run", "b.opts", *done.stdout.split(" FILE ")[1].split())
        assert run.returncode == 0, run.stderr
    assert pgran.load(shared_path / "r.h5").network.built == network
    assert "exists already" in call(*words).stderr
    assert call(*words, "--overwrite", "--displacement", "scalar").returncode == 0
    scalar = dataclasses.replace(network, displacement="scalar", direction=None)
    assert pgran.load(shared_path / "a.h5") == scalar
    assert "no positive number" in call("pack", "--balls", "9", "--pressure", "x", "-o", "b").stderr
