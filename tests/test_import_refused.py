"""Packings of other programs: what is wrong is refused, with the file and line it is in."""

import tracemalloc

import numpy as np
import pytest
from campaigns.fuzz import change_bytes
from packing_samples import Sample, csv_of, dump, row_of_balls

from pgran.errors import FileError
from pgran.foreign.tables import read_table

ATOMS, CONTACTS = "a.atoms", "a.contacts"
GOOD = {
    ATOMS: "id,x,y,radius,mass\n1,0,0,.6,1\n2,1,0,.6,1\n3,2,0,.6,1\n",
    CONTACTS: "i,j,stiffness\n1,2,1\n2,3,1\n",
}
HEAD = "ITEM: TIMESTEP\n7\nITEM: NUMBER OF ATOMS\n{}\nITEM: BOX BOUNDS {}\n{}ITEM: ATOMS id x y\n"
BOX = "0 9\n" * 3
PP = "pp pp pp"
FILES = [  # which file holds what else than a good one, and what is said
    (ATOMS, "", "a.atoms: is empty"),
    (ATOMS, "1,2\n3,4\n", "a.atoms:1: the first line must name"),
    (ATOMS, "id,x,x\n1,2,3\n", "a.atoms:1: two columns are called 'x'"),
    (ATOMS, "id,x,y\n", "a.atoms:1: there are no rows"),
    (ATOMS, "id,x\n1,0\n", "a.atoms: has no column y; it has id, x"),
    (ATOMS, "id,x,y\n1,0,0\n1,1,0\n", "a.atoms:3: a second ball has the id 1"),
    (ATOMS, "id,x,y\n1,0,0\n2,nan,0\n3,2,0\n", "a.atoms:3: x is nan"),
    (ATOMS, "id,x,y\n1,0,0\n\n2,1,C\n3,2,0\n", "a.atoms:4: y is 'C'"),
    (ATOMS, "id,x,y\n1,0,0\n2.5,1,0\n", "a.atoms:3: id is 2.5, no integer"),
    (ATOMS, "id,x,y\n1,0,0\n2,1\n", "a.atoms:3: 2 words where the columns are 3"),
    (ATOMS, "id,x,y,mass\n1,0,0,1\n2,1,0,-1\n", "a.atoms:3: mass must be positive"),
    (ATOMS, "id,x,y,held\n1,0,0,3\n", "a.atoms:2: held must be 0"),
    (ATOMS, "\x1f\x00\x02\n", "a.atoms:1: is no line of text"),
    (ATOMS, "x" * 70000, "a.atoms:1: is no line of text"),
    (ATOMS, "<graphml/>", "GraphML file ends in .graphml"),
    (ATOMS, "ITEM: NUMBER OF ATOMS\n1\n", "a.atoms: is no dump"),
    (ATOMS, "ITEM: TIMESTEP\n7\n", "a.atoms:2: the file ends here, within its head"),
    (ATOMS, "ITEM: TIMESTEP\nx\n", "a.atoms:2: 'x' is no time step"),
    (ATOMS, "ITEM: TIMESTEP\n7\nhm\n", "a.atoms:3: 'hm' where a line ITEM"),
    (ATOMS, HEAD.format(2, PP, BOX) + "1 0 0\n2 1 0", "a.atoms:11: the file ends here"),
    (ATOMS, HEAD.format(1, PP, BOX) + "1 0 0\n2 1 0\n", "a.atoms:11: more than the 1 rows"),
    (ATOMS, HEAD.format(-1, PP, BOX), "a.atoms:4: '-1' is no number of rows"),
    (ATOMS, HEAD.format(1, "xy xz yz " + PP, BOX), "a.atoms:5: the box is triclinic"),
    (ATOMS, HEAD.format(1, "", BOX), "a.atoms:5: does not say"),
    (ATOMS, HEAD.format(1, PP, "0 0\n" * 3), "a.atoms:6: the box must have a positive"),
    (ATOMS, HEAD.format(1, PP, "0 1 2\n" * 3), "a.atoms:6: the two ends"),
    (ATOMS, HEAD.format(3, PP, "0 2\n" * 3) + "1 0 0\n2 1 0\n3 .5 0\n",
     "a.contacts:2: these balls are 1 apart, and half a period is 1: the box is too small"),
    (CONTACTS, "i,j,stiffness\n1,2,1\n2,4,1\n", "a.contacts:3: no ball 4 in a.atoms"),
    (CONTACTS, "i,j,stiffness\n1,1,1\n", "a.contacts:2: a ball touches itself"),
    (CONTACTS, "i,stiffness\n1,1\n", "a.contacts: has no column id2"),
    (CONTACTS, "i,j,stiffness\n1,2,inf\n", "a.contacts:2: stiffness is inf"),
    (CONTACTS, "i,j,stiffness\n1,2,1\n2,1,2\n", "a.contacts:3: these balls touch twice"),
    (CONTACTS, "i,j,stiffness,distance,force\n1,2,1,1,1\n2,3,1,1.1,1\n",
     "a.contacts:3: the distance is 1.1, but 1 by the balls"),
    (CONTACTS, "i,j,stiffness,overlap,force\n1,2,1,.3,1\n",
     "a.contacts:2: the overlap is 0.3, but 0.2 by the balls"),
    (CONTACTS, "i,j,stiffness,force,fx,fy\n1,2,1,1,-1,0\n2,3,1,1,-2,0\n",
     "a.contacts:3: the force is 1, but 2 by its components"),
]  # fmt: skip
WORDS = [  # words of the command, and what is said
    ("--law linear", "--law linear: there is no such column; it is hertz, harmonic, or one of i"),
    ("--law hertz", "needs forces"),
    ("--hertz 2", "--hertz goes with --law hertz"),
    ("--columns i,j,k,l", "--columns l"),
    ("--columns id1=q", "--columns id1=q"),
    ("--rest z<1", "balls have no column z; there are x, y"),
    ("--rest x>7", "'x>7' chooses no ball"),
    ("--rest x<1 --drive x<2", "ball 1 cannot be both"),
    ("--rest x>=0", "no contact is left"),
    ("--cut x", "not periodic along x"),
    ("--cut w", "must be axes"),
    ("--direction z", "--direction: choose x, y, or 2 components, not 'z'"),
    ("--box 1", "--box: 2 lengths are needed"),
    ("--prestress", "--prestress needs forces"),
    ("--displacement scalar --tangential 1", "need vector displacements"),
    ("--damping -1", "-1 is no finite number of 0 or more"),
    ("--nonsense", "--nonsense: unknown option; see pgran import --help"),
]
NO_RADII = {ATOMS: "id,x,y\n1,0,0\n2,1,0\n3,2,0\n", CONTACTS: "i,j,force\n1,2,1\n"}
BOTH = [  # files and words together, the exit code, and what is said
    ({CONTACTS: "i,j,force\n1,2,1\n2,3,-1\n"}, "--law harmonic", 4,
     "a.contacts:3: a harmonic contact has no force of -1 at an overlap of 0.2"),
    ({CONTACTS: "i,j,force\n1,2,1\n1,3,1\n"}, "--law harmonic", 4,
     "a.contacts:3: a harmonic contact has no force of 1 at an overlap of -0.8"),
    (NO_RADII, "--law hertz", 2, "needs overlaps"),
    ({}, "-o a.atoms", 4, "a.atoms: exists and is no network"),
    ({}, "-o missing\0/n.h5", 4, "cannot be written"),
    ({}, "-o a.atoms/n.h5", 4, "cannot be written"),
]  # fmt: skip
IMPORT = "import", ATOMS, CONTACTS, "-o", "n.h5"


@pytest.mark.parametrize(
    ("files", "words", "code", "said"),
    [
        *(({name: text}, "", 4, said) for name, text, said in FILES),
        *(({}, words, 2, said) for words, said in WORDS),
        *BOTH,
    ],
)
def test_refused(call, place, files, words, code, said):
    for name, content in (GOOD | files).items():
        place(name, content)
    done = call(*IMPORT, *words.split())
    assert (done.returncode, len(done.stderr.splitlines())) == (code, 1), done.stderr
    assert said in done.stderr
    assert "Traceback" not in done.stderr


def test_columns_that_say_nothing(call, place):
    """Too few of them, of another snapshot, forces or balls that could be either, unknown balls."""
    sample = Sample(2)
    sample.write(place)
    first, other = sample.id[sample.bond].T
    few = {"a": first, "b": sample.distance}
    two = {"a": first, "b": other, "c": sample.force, "d": 2 * sample.force}
    unlike = {"a": np.roll(first, 1), "b": other, "c": sample.distance, "d": sample.force}
    strange = {"a": np.append(first[:-1], 1000), "b": other, "c": sample.force}
    for columns, step, said in (
        (few, 7, "no two columns hold ids"),
        (few, 8, "of the time step 8, a.atoms of 7"),
        (two, 7, "c, d could each be the force; --columns id1,id2"),
        (unlike, 7, "no two columns hold ids"),
        (strange, 7, ": no ball 1000 in a.atoms"),
    ):
        place(CONTACTS, dump("ENTRIES", columns, step=step))
        done = call(*IMPORT, "--law", "d")
        assert (done.returncode, said in done.stderr) == (4, True), done.stderr
    row_of_balls(place)  # no radii: whether a force fits is not known
    done = call(*IMPORT, "--law", "s")
    said = "the balls could be in p and q, or q and r, by the geometry; --columns id1,id2"
    assert (done.returncode, said in done.stderr) == (4, True)
    assert call(*IMPORT, "--law", "s", "--columns", "id1,id2").returncode == 0


def test_claims_cost_no_memory(place):
    path = place(ATOMS, HEAD.format(10**17, PP, BOX) + "1 0 0\n" * 100)
    tracemalloc.start()
    try:
        with pytest.raises(FileError, match="was it cut"):
            read_table(path)
        assert tracemalloc.get_traced_memory()[1] < 2**21
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("kind", ["dump", "csv"])
def test_damage_is_refused_or_harmless(call, place, shared_path, kind):
    """No error but pgran's, and nothing half written."""
    rng, sample = np.random.default_rng(3), Sample(2, count=12)
    if kind == "dump":
        sample.write(place)
    else:
        csv_of(place, sample, force=sample.force)
    codes = set()
    for name in (ATOMS, CONTACTS):
        good = (shared_path / name).read_bytes()
        for _ in range(60):
            (shared_path / name).write_bytes(change_bytes(good, rng))
            done = call(*IMPORT, "--law", "hertz")
            assert done.returncode in (0, 2, 4), done.stderr
            warned = done.stderr.count("pgran: warning: ")
            assert len(done.stderr.splitlines()) == (1 if done.returncode else warned)
            assert (shared_path / "n.h5").exists() == (done.returncode == 0)
            (shared_path / "n.h5").unlink(missing_ok=True)
            codes.add(done.returncode)
        (shared_path / name).write_bytes(good)
    assert 4 in codes
