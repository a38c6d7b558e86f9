"""Packings of other programs: what is wrong is refused, with the file and line it is in."""

import tracemalloc

import numpy as np
import pytest
from packing_samples import Sample, csv_of, dump, row_of_balls

from pgran.errors import FileError
from pgran.foreign.tables import read_table

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
        ("--law hertz --hertz 0", 2, "0 is no positive number"),
        ("--law hertz --hertz x", 2, "x is no positive number"),
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
        ("--damping -1", 2, "-1 is no finite number of 0 or more"),
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


def test_balls_that_the_geometry_does_not_tell(call, place):
    """Two pairs of columns that fit as well, and a single pair that does not fit."""
    row_of_balls(place)  # no radii: whether a force fits is not known
    words = "import", "a.atoms", "a.contacts", "-o", "n.h5", "--overwrite", "--law"
    done = call(*words, "s")
    said = "the balls could be in p and q, or q and r, by the geometry; --columns id1,id2"
    assert (done.returncode, said in done.stderr) == (4, True)
    assert call(*words, "s", "--columns", "id1,id2").returncode == 0
    sample = Sample(2)
    sample.write(place)
    first, other = sample.id[sample.bond].T
    wrong = {"a": np.roll(first, 1), "b": other, "c": sample.distance, "d": sample.force}
    place("a.contacts", dump("ENTRIES", wrong))
    done = call(*words, "d")
    assert (done.returncode, "no two columns hold ids" in done.stderr) == (4, True)


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
            warned = done.stderr.count("pgran: warning: no ball is held")
            assert len(done.stderr.splitlines()) == (1 if done.returncode else warned)
            assert (shared_path / "n.h5").exists() == (done.returncode == 0)
            (shared_path / "n.h5").unlink(missing_ok=True)
            codes.add(done.returncode)
        (shared_path / name).write_bytes(good)
    assert 4 in codes
