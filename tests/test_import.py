"""Packings of other programs: what is read is the packing, and what is wrong is refused."""

import itertools
import re
import sys
import tracemalloc

import h5py
import numpy as np
import pytest

from pgran.errors import FileError, InputError
from pgran.files import hdf5
from pgran.files.conditions import choose
from pgran.files.network import read_network
from pgran.files.tables import read_table
from pgran.physics import packing

LENGTH, HERTZ = 5.0, 2.5


@pytest.fixture
def here(monkeypatch):
    """Let networks be read without the trial by another process, which is quicker."""
    monkeypatch.setattr(hdf5, "try_apart", lambda *words: None)


class Sample:
    """Balls at random in a periodic cube, and all pairs that touch or nearly do."""

    def __init__(self, axes, law="hertz", seed=0, count=None):
        count = count or {2: 40, 3: 100}[axes]
        rng = np.random.default_rng([axes, seed])
        self.axes, self.id = axes, rng.permutation(900)[:count] + 1
        self.position = rng.random((count, axes)) * LENGTH
        self.radius, self.mass = rng.uniform(0.3, 0.5, count), rng.uniform(1, 2, count)
        rows = []
        shifts = np.array([*itertools.product((-LENGTH, 0, LENGTH), repeat=axes)])
        for i, j in itertools.combinations(range(count), 2):
            i, j = (i, j) if rng.random() < 0.5 else (j, i)
            images = self.position[j] + shifts - self.position[i]
            distance = np.sqrt(np.sum(images**2, axis=1))
            away, distance = images[np.argmin(distance)], distance.min()
            h = self.radius[i] + self.radius[j] - distance
            if h > -0.1:
                force = max(h, 0) ** 1.5 * HERTZ if law == "hertz" else max(h, 0) * HERTZ
                rows.append((i, j, *away / distance, distance, h, force))
        self.bond = np.array([row[:2] for row in rows])
        self.normal = np.array([row[2 : 2 + axes] for row in rows])
        self.distance, self.overlap, self.force = np.array([row[-3:] for row in rows]).T
        self.touch = self.overlap > 0
        h = np.where(self.touch, self.overlap, 1)
        k = 1.5 * HERTZ * np.sqrt(h) if law == "hertz" else HERTZ
        self.stiffness = np.where(self.touch, k, 0)

    def dense(self, stress=True):
        """Return K over all balls, contact by contact."""
        K = np.zeros((len(self.id), self.axes) * 2)
        for (i, j), n, k, f, d in zip(
            self.bond, self.normal, self.stiffness, self.force, self.distance, strict=True
        ):
            block = k * np.outer(n, n)
            block -= stress * f / d * (np.eye(self.axes) - np.outer(n, n))
            for a, b in itertools.product((i, j), repeat=2):
                K[a, :, b, :] += block if a == b else -block
        return K

    def write(self, place, style="x", digits=17, flags="pp pp pp"):
        """Write two dumps with names that say nothing, and columns that mislead."""
        rng = np.random.default_rng(5)
        where = {
            "x": self.position,
            "xs": self.position / LENGTH,
            "xu": self.position + LENGTH * rng.integers(-2, 3, self.position.shape),
        }[style]
        names = [style.replace("x", x) for x in "xyz"[: self.axes]]
        balls = dict(zip(names, where.T, strict=True))
        balls = {"radius": self.radius, "id": self.id, "type": self.id % 2 + 1, **balls}
        balls |= {"mass": self.mass, "element": np.full(len(self.id), "C")}
        place("a.atoms", dump("ATOMS", balls, digits, flags))
        sign = -self.force[:, None] * self.normal
        contacts = [np.arange(len(self.bond)) + 1, self.touch, *self.id[self.bond].T]
        contacts += [self.distance, np.maximum(self.overlap, 0), self.force, *sign.T, sign[:, 0]]
        names = ["index", *(f"c_p[{k}]" for k in range(len(contacts) - 1))]
        place("a.contacts", dump("ENTRIES", dict(zip(names, contacts, strict=True)), digits, flags))


def dump(kind, columns, digits=17, flags="pp pp pp", step=7):
    """Return a snapshot as LAMMPS writes it."""
    lines = ["ITEM: TIMESTEP", step, f"ITEM: NUMBER OF {kind}", len(next(iter(columns.values())))]
    lines += [f"ITEM: BOX BOUNDS {flags}", *[f"0 {LENGTH}"] * 3]
    lines += [f"ITEM: {kind} {' '.join(columns)}"]
    word = lambda x: f"{x:.{digits}g}" if isinstance(x, float) else str(x)  # noqa: E731
    rows = zip(*columns.values(), strict=True)
    lines += [" ".join(word(x) for x in row) for row in rows]
    return "".join(f"{line}\n" for line in lines).replace("True", "1").replace("False", "0")


def bring(call, *words):
    """Import a.atoms and a.contacts, and return what was said."""
    done = call("import", "a.atoms", "a.contacts", "-o", "n.h5", "--overwrite", *words)
    assert done.returncode == 0, done.stderr
    return done.stdout


def assert_same(network, ids, sample, stress=True):
    """K of a network is that of the sample, in its mass-weighted unknowns."""
    K = (network.B.T.multiply(network.springs.constants) @ network.B).toarray()
    rows = {name: row for row, name in enumerate(sample.id)}
    at = [rows[name] for name in ids[network.held == 0]]
    np.testing.assert_allclose(sample.mass[at], network.masses[network.held == 0])
    wanted = sample.dense(stress)[np.ix_(at, range(sample.axes), at, range(sample.axes))]
    weight = np.repeat(np.sqrt(network.mass / sample.mass[at]), sample.axes)
    wanted = weight[:, None] * wanted.reshape(K.shape) * weight
    np.testing.assert_allclose(K, wanted, rtol=0, atol=1e-11 * np.abs(wanted).max())


def ids_of(path):
    with h5py.File(path) as file:
        return file["network/id"][()]


@pytest.mark.parametrize("axes", [2, 3])
@pytest.mark.parametrize("law", ["hertz", "harmonic"])
@pytest.mark.parametrize("style", ["x", "xs", "xu"])
def test_dumps(call, place, here, axes, law, style):
    """Columns without names are recognised; K is that of the contacts one by one."""
    sample = Sample(axes, law)
    sample.write(place, style)
    said = bring(call, "--law", law)
    network, ids = read_network("n.h5"), ids_of("n.h5")
    assert_same(network, ids, sample)
    assert f"{np.count_nonzero(~sample.touch)} contacts of balls that do not touch" in said
    alone = set(range(len(sample.id))) - set(sample.bond[sample.touch].ravel())
    assert set(sample.id) - set(ids) == {sample.id[k] for k in alone}
    assert f"{len(alone)} rattler" in said
    assert "fx = c_p[6]" in said
    order = {name: row for row, name in enumerate(sample.id)}
    np.testing.assert_allclose(network.position, sample.position[[order[n] for n in ids]])


@pytest.mark.parametrize("names", ["_,_,id1,id2,distance,_,force", "id1=c_p[1],id2=4,force=c_p[5]"])
def test_columns_named_by_the_user(call, place, here, names):
    sample = Sample(2)
    sample.write(place)
    assert "fx" not in bring(call, "--law", "hertz", "--columns", names, "--no-prestress")
    assert read_network("n.h5").force is None
    assert_same(read_network("n.h5"), ids_of("n.h5"), sample, stress=False)


def test_six_digits(call, place, here):
    """As LAMMPS prints unless told otherwise; stiffness is then as good as the overlaps."""
    sample = Sample(3)
    sample.write(place, digits=6)
    assert "distance = c_p[3], force = c_p[5], fx = c_p[6]" in bring(call, "--law", "hertz")
    network, touch = read_network("n.h5"), sample.touch
    worst = 4e-5 / sample.overlap[touch].min()
    np.testing.assert_allclose(network.stiffness, sample.stiffness[touch], rtol=worst)


def test_stiffness_by_the_force_alone(call, place, here):
    sample = Sample(2)
    sample.write(place)
    bring(call, "--law", "hertz", "--hertz", str(HERTZ))
    assert_same(read_network("n.h5"), ids_of("n.h5"), sample)


def test_forces_given_by_components(call, place, here):
    """On the first ball or on the second."""
    sample, names = Sample(2), ["id1", "id2", "fx", "fy"]
    for sign in (1, -1):
        sample.write(place)
        parts = [*sample.id[sample.bond].T, *(sign * sample.force[:, None] * sample.normal).T]
        place("a.contacts", dump("ENTRIES", dict(zip(names, parts, strict=True))))
        bring(call, "--law", "hertz")
        assert_same(read_network("n.h5"), ids_of("n.h5"), sample)


def test_friction_and_an_area(call, place, here):
    """As LIGGGHTS lists contacts: the force is along the normal what its components are there."""
    sample, rng = Sample(2), np.random.default_rng(2)
    sample.write(place)
    touching = np.array([[0.0, -1], [1, 0]]) @ sample.normal.T * sample.force
    total = sample.force * sample.normal.T + touching * rng.uniform(-0.6, 0.6, len(sample.force))
    columns = [*sample.id[sample.bond].T, *total, np.maximum(sample.overlap, 0) * 2]
    place("a.contacts", dump("ENTRIES", dict(zip("pqrst", columns, strict=True))))
    assert "id1 = p, id2 = q, fx = r, fy = s" in bring(call, "--law", "hertz")
    assert_same(read_network("n.h5"), ids_of("n.h5"), sample)


def csv_of(place, sample, **contacts):
    """Write CSV files, contacts with the columns given."""
    table = [sample.id, *sample.position.T, sample.radius, sample.mass]
    head = f"id,{','.join('xyz'[: sample.axes])},radius,mass\n"
    place("a.atoms", head + "".join(",".join(map(repr, r)) + "\n" for r in _rows(table)))
    table = [*sample.id[sample.bond].T, *contacts.values()]
    rows = "".join(";".join(map(repr, row)) + "\n" for row in _rows(table))
    place("a.contacts", "\ufeff# contacts\ni;j;" + ";".join(contacts) + "\n\n" + rows)


def _rows(table):
    return list(zip(*(np.asarray(column).tolist() for column in table), strict=True))


def test_csv(call, place, here):
    """Without a box; the contacts' stiffness is in a column, and rows of no stiffness are left."""
    sample = Sample(3)
    inside = np.all(np.abs(sample.position[sample.bond[:, 1]] - sample.position[sample.bond[:, 0]])
                    < LENGTH / 2, axis=1)  # fmt: skip
    for name in ("bond", "normal", "distance", "overlap", "force", "touch", "stiffness"):
        setattr(sample, name, getattr(sample, name)[inside])
    csv_of(place, sample, stiffness=sample.stiffness, kt=sample.stiffness / 3)
    bring(call)
    assert_same(read_network("n.h5"), ids_of("n.h5"), sample, stress=False)
    assert read_network("n.h5").tangential is None
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
    assert_same(read_network("n.h5"), ids_of("n.h5"), last)


# What is held, cut and left out


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


@pytest.mark.parametrize("seed", range(8))
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
        np.testing.assert_array_equal(choose(text, np.arange(50), table.get), wanted, text)
    ids = rng.permutation(50)
    listed = choose("3, 7-9,40 - 60", ids, table.get)
    assert set(ids[listed]) == {3, 7, 8, 9, *range(40, 50)}


@pytest.mark.parametrize(
    "text",
    ["", "x", "x<", "x<1.5.2", "x<1 and", "x<1 xor y<2", "__import__('os')", "x<y", "x<min1", "1<x",
     "x=1", "50-60", "3,77", "x>100", "x<nan", "3,,4", "9" * 30],
)  # fmt: skip
def test_conditions_refused(text):
    table = {"x": np.arange(5.0), "y": np.arange(5.0)}
    with pytest.raises(InputError):
        choose(text, np.arange(5), table.__getitem__)


# What is wrong


GOOD = {
    "a.atoms": "id,x,y,radius,mass\n1,0,0,.6,1\n2,1,0,.6,1\n3,2,0,.6,1\n",
    "a.contacts": "i,j,stiffness\n1,2,1\n2,3,1\n",
}
HEAD = "ITEM: TIMESTEP\n7\nITEM: NUMBER OF ATOMS\n{}\nITEM: BOX BOUNDS {}\n{}ITEM: ATOMS id x y\n"
BOX = "0 9\n" * 3
PP = "pp pp pp"


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.atoms", "", "a.atoms: is empty"),
        ("a.atoms", "1,2\n3,4\n", "a.atoms:1: the first line must name"),
        ("a.atoms", "id,x,x\n1,2,3\n", "a.atoms:1: two columns are called 'x'"),
        ("a.atoms", "id,x,y\n", "a.atoms:1: there are no rows"),
        ("a.atoms", "id,x\n1,0\n", "a.atoms: has no column y; it has id, x"),
        ("a.atoms", "i,x,y\n1,0,0\n", "a.atoms: has no column id"),
        ("a.atoms", "id,x,y\n1,0,0\n1,1,0\n", "a.atoms:3: a second ball has the id 1"),
        ("a.atoms", "id,x,y\n1,0,0\n2,nan,0\n3,2,0\n", "a.atoms:3: x is nan"),
        ("a.atoms", "id,x,y\n1,0,0\n\n2,1,C\n3,2,0\n", "a.atoms:4: y is 'C'"),
        ("a.atoms", "id,x,y\n1,0,0\n2.5,1,0\n", "a.atoms:3: id is 2.5, no integer"),
        ("a.atoms", "id,x,y\n1,0,0\n2,1\n", "a.atoms:3: 2 words where the columns are 3"),
        ("a.atoms", "id,x,y,mass\n1,0,0,1\n2,1,0,-1\n", "a.atoms:3: mass must be positive"),
        ("a.atoms", "id,x,y,radius\n1,0,0,-1\n", "a.atoms:2: radius must be positive"),
        ("a.atoms", "id,x,y,held\n1,0,0,3\n", "a.atoms:2: held must be 0"),
        ("a.atoms", "\x1f\x00\x02\n", "a.atoms:1: is no line of text"),
        ("a.atoms", "x" * 70000, "a.atoms:1: is no line of text"),
        ("a.atoms", "<graphml/>", "GraphML file ends in .graphml"),
        ("a.atoms", "ITEM: NUMBER OF ATOMS\n1\n", "a.atoms: is no dump"),
        ("a.atoms", "ITEM: TIMESTEP\n7\n", "a.atoms:2: the file ends here, within its head"),
        ("a.atoms", "ITEM: TIMESTEP\nx\n", "a.atoms:2: 'x' is no time step"),
        ("a.atoms", "ITEM: TIMESTEP\n7\nhm\n", "a.atoms:3: 'hm' where a line ITEM"),
        ("a.atoms", HEAD.format(2, PP, BOX) + "1 0 0\n2 1 0", "a.atoms:11: the file ends here"),
        ("a.atoms", HEAD.format(1, PP, BOX) + "1 0 0\n2 1 0\n", "a.atoms:11: more than the 1 rows"),
        ("a.atoms", HEAD.format(-1, PP, BOX), "a.atoms:4: '-1' is no number of rows"),
        ("a.atoms", HEAD.format(10**7, PP, BOX) + "1 0 0\n", "within its 10000000 rows"),
        ("a.atoms", HEAD.format(1, "xy xz yz " + PP, BOX), "a.atoms:5: the box is triclinic"),
        ("a.atoms", HEAD.format(1, "", BOX), "a.atoms:5: does not say"),
        ("a.atoms", HEAD.format(1, PP, "0 0\n" * 3), "a.atoms:6: the box must have a positive"),
        ("a.atoms", HEAD.format(1, PP, "0 1 2\n" * 3), "a.atoms:6: the two ends"),
        ("a.contacts", "i,j,stiffness\n1,2,1\n2,4,1\n", "a.contacts:3: no ball 4 in a.atoms"),
        ("a.contacts", "i,j,stiffness\n1,1,1\n", "a.contacts:2: a ball touches itself"),
        ("a.contacts", "i,stiffness\n1,1\n", "a.contacts: has no column id2"),
        ("a.contacts", "i,j,stiffness\n1,2,inf\n", "a.contacts:2: stiffness is inf"),
        ("a.contacts", "i,j,stiffness\n1,2,1\n2,1,2\n", "a.contacts:3: these balls touch twice"),
        ("a.contacts", "i,j,stiffness,distance,force\n1,2,1,1,1\n2,3,1,1.1,1\n",
         "a.contacts:3: the distance is 1.1, but 1 by the balls"),
        ("a.contacts", "i,j,stiffness,overlap,force\n1,2,1,.3,1\n",
         "a.contacts:2: the overlap is 0.3, but 0.2 by the balls"),
        ("a.contacts", "i,j,stiffness,force,fx,fy\n1,2,1,1,-1,0\n2,3,1,1,-2,0\n",
         "a.contacts:3: the force is 1, but 2 by its components"),
    ],
)  # fmt: skip
def test_refused_files(call, place, name, text, said):
    for each, content in (GOOD | {name: text}).items():
        place(each, content)
    done = call("import", "a.atoms", "a.contacts", "-o", "n.h5")
    assert (done.returncode, len(done.stderr.splitlines())) == (4, 1), done.stderr
    assert said in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (
            "--law linear",
            2,
            "--law linear: there is no such column; it is hertz, harmonic, or one of i, j",
        ),
        ("--law hertz", 2, "needs forces"),
        ("--hertz 2", 2, "--hertz goes with --law hertz"),
        ("--law hertz --hertz 0", 2, "0 is not positive"),
        ("--law hertz --hertz x", 2, "x is not 0 or more"),
        ("--columns i,j,k,l", 2, "--columns l"),
        ("--columns id1=q", 2, "--columns id1=q"),
        ("--rest z<1", 2, "balls have no column z; there are x, y"),
        ("--rest x>7", 2, "'x>7' chooses no ball"),
        ("--rest x<1 --drive x<2", 2, "ball 1 cannot be both"),
        ("--rest x>=0", 2, "no contact is left"),
        ("--rest x<1.5 --drive 1-2", 2, "cannot be both"),
        ("--cut x", 2, "not periodic along x"),
        ("--cut w", 2, "must be axes"),
        ("--direction z", 2, "the packing has 2 axes"),
        ("--direction 1,2,3", 2, "the packing has 2 axes"),
        ("--direction 0,0", 2, "neither x, y, z"),
        ("--prestress", 2, "--prestress needs forces"),
        ("--displacement scalar --tangential 1", 2, "need vector displacements"),
        ("--displacement tensor", 2, "invalid choice"),
        ("--damping -1", 2, "-1 is not 0 or more"),
        ("--nonsense", 2, "unrecognized arguments"),
        ("-o a.atoms", 4, "a.atoms: exists and is no network"),
        ("-o missing\0/n.h5", 4, "cannot be written"),
        ("-o a.atoms/n.h5", 4, "cannot be written"),
    ],
)
def test_refused_words(call, place, words, code, said):
    for each, content in GOOD.items():
        place(each, content)
    done = call("import", "a.atoms", "a.contacts", "-o", "n.h5", *words.split())
    assert (done.returncode, len(done.stderr.splitlines())) == (code, 1), done.stderr
    assert said in done.stderr


def test_refused_laws(call, place):
    """Forces that the law cannot have given."""
    place("a.atoms", GOOD["a.atoms"])
    for row, said in (
        ("2,3,-1", "a force of -1 at an overlap of 0.2"),
        ("1,3,1", "a force of 1 at an overlap of -0.8"),
    ):
        place("a.contacts", f"i,j,force\n1,2,1\n{row}\n")
        done = call("import", "a.atoms", "a.contacts", "-o", "n.h5", "--law", "harmonic")
        assert done.returncode == 4
        assert f"a.contacts:3: {said}" in done.stderr
    place("a.atoms", "id,x,y\n1,0,0\n2,1,0\n3,2,0\n")
    done = call("import", "a.atoms", "a.contacts", "-o", "n.h5", "--law", "hertz")
    assert (done.returncode, "needs overlaps" in done.stderr) == (2, True)


def test_other_snapshots_and_columns_that_say_nothing(call, place):
    sample = Sample(2)
    sample.write(place)
    some = {"a": sample.id[sample.bond[:, 0]], "b": sample.distance}
    place("a.contacts", dump("ENTRIES", some))
    done = call("import", "a.atoms", "a.contacts", "-o", "n.h5")
    assert (done.returncode, "--columns id1,id2" in done.stderr) == (4, True)
    place("a.contacts", dump("ENTRIES", some, step=8))
    done = call("import", "a.atoms", "a.contacts", "-o", "n.h5")
    assert "of the time step 8, a.atoms of 7" in done.stderr
    ball = sample.id[sample.bond]
    some = {"a": ball[:, 0], "b": ball[:, 1], "c": sample.force, "d": 2 * sample.force}
    place("a.contacts", dump("ENTRIES", some))
    done = call("import", "a.atoms", "a.contacts", "-o", "n.h5")
    assert (done.returncode, "c, d could each be the force" in done.stderr) == (4, True)
    sample.id[sample.bond[-1, 0]] = 1000
    some |= {"a": sample.id[sample.bond[:, 0]]}
    place("a.contacts", dump("ENTRIES", some))
    done = call("import", "a.atoms", "a.contacts", "-o", "n.h5")
    assert (done.returncode, ": no ball 1000 in a.atoms" in done.stderr) == (4, True)


def test_a_box_that_is_too_small(call, place):
    """Two balls that touch through both ends."""
    columns = {"id": [1, 2], "x": [1.0, 3.5], "y": [1, 1], "radius": [1.5, 1.5]}
    place("a.atoms", dump("ATOMS", columns))
    place("a.contacts", dump("ENTRIES", {"i": [1], "j": [2], "stiffness": [1.0]}))
    done = call("import", "a.atoms", "a.contacts", "-o", "n.h5")
    assert (done.returncode, "a.contacts:10: these balls are 2.5 apart" in done.stderr) == (4, True)


def test_claims_cost_no_memory(place):
    path = place("a.atoms", HEAD.format(10**17, PP, BOX) + "1 0 0\n" * 100)
    tracemalloc.start()
    try:
        with pytest.raises(FileError, match="was it cut"):
            read_table(path)
        assert tracemalloc.get_traced_memory()[1] < 2**21
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("kind", ["dump", "csv"])
def test_damage_is_refused_or_harmless(call, place, shared_path, kind):
    """Bytes are cut away, changed, repeated: no error but pgran's, and nothing half written."""
    rng, sample = np.random.default_rng(3), Sample(2, count=12)
    if kind == "dump":
        sample.write(place)
    else:
        csv_of(place, sample, force=sample.force)
    codes = set()
    for name in ("a.atoms", "a.contacts"):
        good = (shared_path / name).read_bytes()
        for _ in range(60):
            bad, (first, last) = bytearray(good), np.sort(rng.integers(0, len(good), 2))
            match rng.integers(4):
                case 0:
                    del bad[first:]
                case 1:
                    del bad[first:last]
                case 2:
                    bad[first] = rng.integers(256)
                case 3:
                    bad[first:first] = bad[first:last]
            (shared_path / name).write_bytes(bad)
            done = call("import", "a.atoms", "a.contacts", "-o", "n.h5", "--law", "hertz")
            assert done.returncode in (0, 2, 4), done.stderr
            assert len(done.stderr.splitlines()) == (done.returncode > 0)
            assert (shared_path / "n.h5").exists() == (done.returncode == 0)
            (shared_path / "n.h5").unlink(missing_ok=True)
            codes.add(done.returncode)
        (shared_path / name).write_bytes(good)
    assert 4 in codes


# GraphML


def test_graphs(call, place, here):
    """Nodes with names, anywhere; of the same network, with positions."""
    networkx = pytest.importorskip("networkx")
    graph = networkx.Graph()
    for name, held in (("top", 2), ("middle", 0), ("bottom", 1), ("alone", 0)):
        graph.add_node(name, held=held, mass=2.0, x=0.0, y=float(-held))
    graph.add_edge("top", "middle", weight=3.0)
    graph.add_edge("middle", "bottom", weight=1.5)
    for name in ("top", "middle", "bottom", "alone"):
        del graph.nodes[name]["x"], graph.nodes[name]["y"]
    networkx.write_graphml(graph, "a.graphml")
    done = call("import", "a.graphml", "-o", "n.h5")
    assert done.returncode == 0, done.stderr
    network = read_network("n.h5")
    assert network.displacement == "scalar"
    assert network.stiffness.tolist() == [3.0, 1.5]
    assert network.held.tolist() == [2, 0, 1]
    assert ids_of("n.h5").tolist() == [b"top", b"middle", b"bottom"]
    (K,) = (network.B.T.multiply(network.springs.constants) @ network.B).toarray()
    np.testing.assert_allclose(K, 4.5)
    del graph.nodes["top"]["mass"]
    networkx.write_graphml(graph, "a.graphml")
    done = call("import", "a.graphml", "-o", "m.h5")
    assert (done.returncode, "a.graphml, node top: mass is nan" in done.stderr) == (4, True)
    for text in ("", "<graphml>", "garbage", "<a/>", "<graphml xmlns='x'><graph/></graphml>"):
        place("a.graphml", text)
        done = call("import", "a.graphml", "-o", "m.h5")
        assert (done.returncode, len(done.stderr.splitlines())) == (4, 1), done.stderr


def test_without_networkx(call, place, monkeypatch):
    monkeypatch.setitem(sys.modules, "networkx", None)
    place("a.graphml", "<graphml/>")
    done = call("import", "a.graphml", "-o", "n.h5")
    assert (done.returncode, "pip install networkx" in done.stderr) == (1, True)
    assert "one GraphML file" in call("import", "a.graphml", "b", "-o", "n.h5").stderr
    assert "CONTACTS is missing" in call("import", "a.csv", "-o", "n.h5").stderr


# Networks on disk


def five_lines(path, attributes=(), **members):
    with h5py.File(path, "w") as file:
        for name, value in members.items():
            file[f"network/{name}"] = value
        file.require_group("network").attrs.update(attributes)
    return path


SPRINGS = {"bond": [[0, 1], [1, 2]], "stiffness": [1.0, 2.0], "mass": [1, 2, 3]}


def test_five_lines_write_a_network(tmp_path):
    """Read by a process of its own first; what is missing follows from what is there."""
    network = read_network(five_lines(tmp_path / "a.h5", **SPRINGS))
    assert (network.displacement, network.held.tolist()) == ("scalar", [0, 0, 0])
    place = [[0, 0], [0, 1], [2, 1]]
    made = {"direction": "y", "kmax": 7}
    path = five_lines(tmp_path / "b.h5", made, position=place, held=[2, 0, 0], **SPRINGS)
    network = read_network(path, damping=0.125)
    assert (network.displacement, network.kmax, network.damping) == ("vector", 7, 0.125)
    np.testing.assert_array_equal(network.normal, [[0, 1], [1, 0]])
    np.testing.assert_array_equal(network.direction, [0, 1])
    assert read_network(path, displacement="scalar").axes == 1
    with pytest.raises(InputError):
        read_network(path, damping=-1)


@pytest.mark.parametrize(
    ("members", "attributes", "said"),
    [
        ({"bond": None}, {}, "/network/bond is missing"),
        ({"stiffness": None}, {}, "/network/stiffness is missing"),
        ({"mass": None}, {}, "does not say how many balls"),
        ({"masses": [1, 2, 3], "mass": None}, {}, "/network/masses is not known; is mass meant"),
        ({}, {"dampin": 1.0}, "is damping meant"),
        ({}, {"damping": "much"}, "/network/damping must be a number"),
        ({}, {"displacement": 1}, "/network/displacement must be a text"),
        ({}, {"displacement": "tensor"}, "'tensor' is none of"),
        ({"normal": [[1, 0], [1, 0]]}, {"direction": "z"}, "no such axis"),
        ({"damping": 1.0}, {}, "is an attribute"),
        ({"bond": [[0, 1], [1, 5]]}, {}, "no balls (1, 5) among 3"),
        ({"bond": [[0.5, 1], [1, 2]]}, {}, "/network/bond holds no integers"),
        ({"bond": 3}, {}, "bond"),
        ({"stiffness": [1.0]}, {}, "stiffness: shape (1,) is not (2,)"),
        ({"stiffness": [1.0, np.nan]}, {}, "must be finite"),
        ({"mass": [1, -1, 2]}, {}, "masses must be positive"),
        ({"mass": ["a", "b", "c"]}, {}, "/network/mass"),
        ({"held": [1, 1, 1]}, {}, "every ball is held"),
        ({"held": 0}, {}, "held"),
        ({"normal": [[1, 0], [1, 1]]}, {}, "length 1"),
        ({"stiffness": h5py.SoftLink("/network/mass")}, {}, "is a link"),
    ],
)
def test_refused_networks(tmp_path, here, members, attributes, said):
    values = {k: v for k, v in (SPRINGS | members).items() if v is not None}
    path = five_lines(tmp_path / "a.h5", attributes, **values)
    with pytest.raises(FileError, match=re.escape(said)) as caught:
        read_network(path)
    assert str(caught.value).startswith(str(path))


def test_a_damaged_packing_has_checksums(call, place, shared_path, here):
    """Wherever a bit flips that h5py reads, it is found: the network is the same or refused."""
    sample, rng = Sample(2), np.random.default_rng(1)
    sample.write(place)
    bring(call, "--law", "hertz")
    network, content = read_network("n.h5"), (shared_path / "n.h5").read_bytes()
    refused = 0
    for place in rng.integers(0, len(content), 60):
        bad = bytearray(content)
        bad[place] ^= 1 << rng.integers(8)
        (shared_path / "n.h5").write_bytes(bad)
        try:
            assert read_network("n.h5").bonds_sha256 == network.bonds_sha256
        except FileError:
            refused += 1
    assert refused > 10


def test_damaged_networks(tmp_path):
    path = five_lines(tmp_path / "a.h5", **SPRINGS)
    content = path.read_bytes()
    for bad in (b"", b"garbage", content[: len(content) // 2], content[:900] + bytes(800)):
        path.write_bytes(bad)
        with pytest.raises(FileError):
            read_network(path)
