"""Packings of other programs: what is read, kept and chosen is what they hold."""

import itertools
import re

import numpy as np
import pytest
from packing_samples import (
    HERTZ,
    LENGTH,
    Sample,
    assert_same,
    bring,
    csv_of,
    dump,
    ids_of,
    row_of_balls,
)

import pgran
from pgran.foreign.contacts import power_of
from pgran.medium import packing
from pgran.medium.conditions import choose
from pgran.medium.network_file import read_network


@pytest.mark.parametrize("axes", [2, 3])
@pytest.mark.parametrize("law", ["hertz", "harmonic"])
@pytest.mark.parametrize("style", ["x", "xs", "xu"])
def test_dumps(call, place, here, axes, law, style):
    """Columns without names are recognised; K is that of the contacts one by one."""
    sample = Sample(axes, law)
    sample.write(place, style)
    said = bring(call, "--law", law)
    network, ids = assert_same(sample)
    assert f"{np.count_nonzero(~sample.touch)} contacts of balls that do not touch" in said
    alone = set(range(len(sample.id))) - set(sample.bond[sample.touch].ravel())
    assert set(sample.id) - set(ids) == {sample.id[k] for k in alone}
    assert f"{len(alone)} rattler" in said
    assert "fx = c_p[6]" in said
    order = {name: row for row, name in enumerate(sample.id)}
    np.testing.assert_allclose(network.position, sample.position[[order[n] for n in ids]])


def test_columns_named_by_the_user(call, place, here):
    sample = Sample(2)
    sample.write(place)
    for words, stress in (
        ("--columns _,_,id1,id2,distance,_,force --no-prestress", False),
        ("--columns id1=c_p[1],id2=4,force=c_p[5] --no-prestress", False),
        (f"--hertz {HERTZ}", True),  # stiffness by the force alone
    ):
        assert ("fx" in bring(call, "--law", "hertz", *words.split())) == stress
        assert (assert_same(sample, stress)[0].force is not None) == stress


def test_six_digits(call, place, here):
    """As LAMMPS prints unless told otherwise; balls that are not at rest are told."""
    sample = Sample(3)
    sample.write(place, digits=6)
    done = call("import", "a.atoms", "a.contacts", "-o", "n.h5", "--law", "hertz")
    assert "distance = c_p[3], force = c_p[5], fx = c_p[6]" in done.stdout
    assert "of the mean one on a free ball: gravity" in done.stderr
    assert "masses: all 1" not in done.stdout
    known = sample.stiffness[sample.touch]
    np.testing.assert_allclose(read_network("n.h5").stiffness, known, rtol=2e-4)


@pytest.mark.parametrize(
    ("law", "pressure"), [("hertz", 1e-3), ("hertz", 1e-6), ("hertz", 3e-8), ("harmonic", 1e-4)]
)
def test_rounding_of_overlaps(call, place, here, law, pressure):
    """By all contacts their law is known better than by one; it says how well, and which it is."""
    packing = pgran.pack(100, law=law, pressure=pressure, seed=4)
    unit, ball = LENGTH / packing.box[0], np.arange(len(packing.held)) + 1
    x, y = packing.position.T * unit
    balls = {"id": ball, "x": x, "y": y, "z": 0 * x, "radius": packing.radius * unit}
    contacts = dict(zip("ij", packing.bond.T + 1, strict=True))
    contacts |= {"distance": packing.distance * unit, "force": packing.force * 1e-7}
    words = "import", "a.atoms", "a.contacts", "--overwrite", "-o", "n.h5"
    (wrong,) = {"hertz", "harmonic"} - {law}
    fits = re.compile(rf"forces go like h\^\(\S+ \+- \S+\), h the overlap: --law {law} fits")
    for digits in (6, 9):
        place("a.atoms", dump("ATOMS", balls, digits))
        place("a.contacts", dump("ENTRIES", contacts, digits))
        done = call(*words, "--law", law)
        off = np.abs(read_network("n.h5").stiffness * unit * 1e7 / packing.stiffness - 1).max()
        said = float(re.search(r"each to (\S+) by the digits", done.stdout)[1])
        unsure = "the digits of overlaps leave a stiffness open" in done.stderr
        assert unsure == (said > 1e-2)
        assert off < (1.1 * said if unsure else min(1.1 * said, 2e-3))  # it is rounded itself
        assert not re.search("but forces go|on a free ball", done.stderr)
        assert "masses: all 1, as the balls" in done.stdout
        assert "; --damping" in done.stderr  # forces are 1e-7 of those where .003 is a damping
        if not unsure:
            assert fits.search(done.stdout)
            assert fits.search(call(*words).stderr), "--law is needed"
            assert fits.search(call(*words, "--law", wrong).stderr)


def test_forces_given_by_components(call, place, here):
    """On the first ball or on the second; with friction and an area, as LIGGGHTS lists contacts.

    The force is along the normal what its components are there.
    """
    sample, rng = Sample(2), np.random.default_rng(2)
    sample.write(place)
    ids, along = sample.id[sample.bond].T, sample.force * sample.normal.T
    across = np.array([[0.0, -1], [1, 0]]) @ along * rng.uniform(-0.6, 0.6, len(sample.force))
    area = np.maximum(sample.overlap, 0) * 2
    for names, columns in (
        (["id1", "id2", "fx", "fy"], [*ids, *along]),
        (["id1", "id2", "fx", "fy"], [*ids, *-along]),
        ("pqrst", [*ids, *(along + across), area]),
    ):
        place("a.contacts", dump("ENTRIES", dict(zip(names, columns, strict=True))))
        told = "id1 = {}, id2 = {}, fx = {}, fy = {}".format(*names)
        assert told in bring(call, "--law", "hertz")
        assert_same(sample)


def test_a_law_of_forces_that_scatter():
    """As friction makes them: they flatten overlaps by forces, and the error covers that."""
    for noise in (0.0, 0.1, 0.3):
        rng = np.random.default_rng(1)
        h = 10 ** rng.uniform(-4, -2.5, 400)
        F = h**1.5 * np.exp(noise * rng.standard_normal(400))
        found = power_of(F, h, 1e-6 * h, (np.ones(1),))
        assert abs(found.value - 1.5) < min(found.far, 0.1 + noise)
        assert ("--law harmonic fits" in found.words, found.clear.all()) == (False, True)


def test_csv(call, place, here):
    """Without a box; the contacts' stiffness is in a column, and rows of no stiffness are left."""
    sample = Sample(3)
    inside = np.all(np.abs(sample.position[sample.bond[:, 1]] - sample.position[sample.bond[:, 0]])
                    < LENGTH / 2, axis=1)  # fmt: skip
    for name in ("bond", "normal", "distance", "overlap", "force", "touch", "stiffness"):
        setattr(sample, name, getattr(sample, name)[inside])
    csv_of(place, sample, stiffness=sample.stiffness, kt=sample.stiffness / 3)
    bring(call)
    assert assert_same(sample, stress=False)[0].tangential is None
    doubt = "the stiffness is 1 F/h by its column, but forces go like h^(1.5"
    for ratio in (1.5, 1):
        secant = sample.force / np.where(sample.touch, sample.overlap, 1)
        csv_of(place, sample, force=sample.force, stiffness=ratio * secant)
        done = call("import", "a.atoms", "a.contacts", "-o", "n.h5", "--overwrite")
        assert (doubt in done.stderr) == (ratio == 1), done.stderr
    csv_of(place, sample, overlap=sample.overlap, force=sample.force, tangential=sample.force)
    bring(call, "--law", "hertz", "--displacement", "rotations", "--damping", "0.25")
    network = read_network("n.h5")
    np.testing.assert_allclose(network.tangential, sample.force[sample.touch])
    assert (network.displacement, network.damping) == ("rotations", 0.25)
    bring(call, "--law", "force", "--displacement", "scalar")
    network, bare = read_network("n.h5"), read_network("n.h5", damping=0.5)
    assert (network.displacement, network.normal, bare.damping) == ("scalar", None, 0.5)
    np.testing.assert_array_equal(network.stiffness, sample.force[sample.touch])
    bring(call, "--law", "hertz", "--tangential", "0.5", "--direction", "0,3,4")
    network = read_network("n.h5")
    np.testing.assert_array_equal(network.tangential, network.stiffness / 2)
    np.testing.assert_allclose(network.direction, [0, 0.6, 0.8])


def test_the_last_snapshot_counts(call, place, here, shared_path):
    first, last = Sample(2, seed=1), Sample(2, seed=2)
    texts = {"a.atoms": "", "a.contacts": ""}
    for sample in (first, last):
        sample.write(place)
        for name in texts:
            texts[name] += (shared_path / name).read_text()
    for name, text in texts.items():
        place(name, text)
    assert "a.atoms: the last of 2 snapshots, of the time step 7" in bring(call, "--law", "hertz")
    assert_same(last)


def test_balls_in_order_are_no_row_numbers(call, place, here):
    """Contact k joins the balls k and k + 1: its first ball is the number of its row.

    Column q and ball 1 in column r would have the numbers of rows as distances; their forces are
    where they do not touch.
    """
    row_of_balls(place, radius=np.full(8, 0.51))
    said = bring(call, "--law", "harmonic", "--direction", "0,2,0")
    assert "id1 = p, id2 = q, distance = r, force = s" in said
    network = read_network("n.h5")
    assert network.direction.tolist() == [0, 1]  # of a plane's, in space
    np.testing.assert_array_equal(network.bond, [[k, k + 1] for k in range(7)])
    np.testing.assert_allclose(network.stiffness, 1 + np.arange(1, 8) / 20)


# What is held, cut and left out


def test_the_unit_of_frequency_does_not_follow_what_is_held(call, place, here):
    """sqrt(2 d k / m) of the stiffest contact and the median mass of the whole packing."""
    sample = Sample(2)
    sample.write(place)
    omega_mx = np.sqrt(4 * 1.5 * sample.stiffness.max() / np.median(sample.mass))
    for words in ("", "--rest x<2", "--cut xy --rest y<2 --drive y>max-2"):
        said = bring(call, "--law", "hertz", "--tangential", "1.5", *words.split())
        assert read_network("n.h5").omega_mx == pytest.approx(omega_mx, rel=1e-14)
        assert f"omega_mx {omega_mx:.4g}, by" in said


def chain(place):
    """Balls 0 to 9 in a row, one more on top of 4, across the end of the box; others apart."""
    x = [*np.arange(10) * 0.5 + 0.25, 2.25, 0.25, 4.75, 2.25, 2.25, 2.25]
    y = [*[1.0] * 10, 1.5, 2, 2, 3, 3.5, 4.5]
    columns = {"id": np.arange(16) + 100, "x": x, "y": y}
    columns |= {"diameter": np.full(16, 0.5), "density": np.full(16, 6 / np.pi / 0.5**3)}
    place("a.atoms", dump("ATOMS", columns))
    pairs = [*((k, (k + 1) % 10) for k in range(10)), (4, 10), (11, 12), (13, 14), (10, 4)]
    bond = np.array(pairs).T + 100
    ones = np.ones(len(pairs))
    place("a.contacts", dump("ENTRIES", {"i": bond[0], "j": bond[1], "stiffness": ones}))


def test_what_is_held_cut_and_left_out(call, place, here):
    chain(place)
    words = ["--rest", "x<min+0.6", "--drive", "x>max-0.6 and y<1.5 or x>4.7 and y<1.5"]
    said = bring(call, *words, "--cut", "x")
    for part in (
        "7 free balls, 1 at rest, 1 driven; 8 contacts", "cut: 2 contacts across x",
        "1 rattler without", "2 balls in parts without a path",
        "3 held balls without", "1 ball torn off",
        "1 contact listed a second time", "2 contacts between held",
    ):  # fmt: skip
        assert part in said, said
    network, ids = read_network("n.h5"), ids_of("n.h5")
    assert dict(zip(ids.tolist(), network.held.tolist(), strict=True)) == {
        101: 1, 108: 2, 110: 0, **dict.fromkeys(range(102, 108), 0)
    }  # fmt: skip
    np.testing.assert_allclose(network.masses, 1)
    assert "8 springs for 14 unknowns, 6 fewer than isostatic" in said
    # 11 and 12 touch across the end only
    assert "2 balls torn off by the cut" in bring(call, "--cut", "x")
    assert "torn off" not in bring(call)
    done = call("import", "a.atoms", "a.contacts", "-o", "floats.h5")  # its modes are defined
    assert done.stderr.startswith("pgran: warning: no ball is held: the network floats")
    floats = read_network("floats.h5")
    assert not floats.held.any()
    assert f"than isostatic ({2 * (len(floats.held) - 1) + 1})" in done.stdout


@pytest.mark.parametrize("seed", range(5))
def test_what_hangs_together(seed):
    """Against a flood that starts from the held balls."""
    rng = np.random.default_rng(seed)
    bond = rng.permuted(np.array(list(itertools.combinations(range(30), 2))), axis=1)
    bond = bond[rng.permutation(len(bond))[: rng.integers(10, 40)]]
    held = rng.choice(3, 30, p=[0.8, 0.1, 0.1]) if seed else np.zeros(30, dtype=int)
    cut = rng.random(len(bond)) < 0.3
    kept = packing.keep(bond, held, cut)
    wet = set(np.flatnonzero(held)) if seed else set(range(30))
    for _ in range(30):
        wet |= {b for pair in bond[~cut] if wet & set(pair) for b in pair}
    contacts = [not c and any(held[b] == 0 and b in wet for b in pair)
                for c, pair in zip(cut, bond.tolist(), strict=True)]  # fmt: skip
    assert kept.contacts.tolist() == contacts
    assert set(np.flatnonzero(kept.balls)) == set(bond[contacts].ravel())
    out = kept.rattlers + kept.torn_off + kept.floating + kept.idle
    assert out == 30 - np.count_nonzero(kept.balls)
    touched = np.bincount(bond.ravel(), minlength=30)
    assert kept.rattlers == np.count_nonzero((touched == 0) & (held == 0))


def test_unbalanced_force():
    """Two contacts that push a ball from both sides, and a third that nothing balances."""
    bond = np.array([[0, 1], [1, 2], [3, 1]])
    normal = np.array([[1.0, 0], [1, 0], [0, 1]])
    free = np.array([False, True, False, False])
    assert packing.unbalanced(bond[:2], normal[:2], np.array([2.0, 2.0]), free) == 0
    assert packing.unbalanced(bond, normal, np.array([2.0, 2.0, 5.0]), free) == pytest.approx(5 / 3)


# Conditions


def test_conditions():
    rng = np.random.default_rng(1)
    table = {name: rng.integers(0, 9, 50).astype(float) for name in ("x", "y", "c_a[1]")}
    x, y, c = table.values()
    for text, wanted in {
        "x<3": x < 3, "x <= 3.": x <= 3, "x>-1": x > -1, "y!=4": y != 4, "c_a[1]==2": c == 2,
        "x<min+1.5": x < x.min() + 1.5, "x==max": x == x.max(),
        "x > max - 15e-1": x > x.max() - 1.5,
        "x<2 or x>6 and y>=4": (x < 2) | ((x > 6) & (y >= 4)),
        "x>2 and x<6 and y<5 or y==8": ((x > 2) & (x < 6) & (y < 5)) | (y == 8),
    }.items():  # fmt: skip
        np.testing.assert_array_equal(choose("rest", text, np.arange(50), table.get), wanted, text)
    ids = rng.permutation(50)
    listed = choose("rest", "3, 7-9,40 - 60", ids, table.get)
    assert set(ids[listed]) == {3, 7, 8, 9, *range(40, 50)}
    for wrong in (
        "", "x", "x<", "x<1.5.2", "x<1 and", "x<1 xor y<2", "__import__('os')", "x<y", "x<min1",
        "1<x", "x=1", "50-60", "3,77", "x>100", "x<nan", "3,,4", "9" * 30,
    ):  # fmt: skip
        with pytest.raises(pgran.InputError):
            choose("rest", wrong, np.arange(50), table.__getitem__)


# GraphML


def test_graphs(call, place, here):
    """Nodes with names, and without positions."""
    networkx = pytest.importorskip("networkx")
    graph = networkx.Graph()
    for name, held in (("top", 2), ("middle", 0), ("bottom", 1), ("alone", 0)):
        graph.add_node(name, held=held, mass=2.0)
    graph.add_edge("top", "middle", weight=3.0)
    graph.add_edge("middle", "bottom", weight=1.5)
    networkx.write_graphml(graph, "a.graphml")
    done = call("import", "a.graphml", "-o", "n.h5")
    assert done.returncode == 0, done.stderr
    network = read_network("n.h5")
    assert network.displacement == "scalar"
    assert network.stiffness.tolist() == [3.0, 1.5]
    assert network.held.tolist() == [2, 0, 1]
    assert ids_of("n.h5").tolist() == [b"top", b"middle", b"bottom"]
    assert pgran.matrices(network).K.toarray().tolist() == [[4.5]]
    del graph.nodes["top"]["mass"]
    networkx.write_graphml(graph, "a.graphml")
    done = call("import", "a.graphml", "-o", "m.h5")
    assert (done.returncode, "a.graphml, node top: mass is nan" in done.stderr) == (4, True)
    for text in ("", "<graphml>", "garbage", "<a/>", "<graphml xmlns='x'><graph/></graphml>"):
        place("a.graphml", text)
        done = call("import", "a.graphml", "-o", "m.h5")
        assert (done.returncode, len(done.stderr.splitlines())) == (4, 1), done.stderr


def test_one_file_or_two(call):
    assert "one GraphML file" in call("import", "a.graphml", "b", "-o", "n.h5").stderr
    assert "CONTACTS is missing" in call("import", "a.csv", "-o", "n.h5").stderr
