"""Where results are written: whole or not at all, and what may be replaced."""

import os

import pytest
from result_samples import ATTRIBUTES, change, make, no_room_beyond, stored

from pgran import load, results
from pgran.errors import FileError
from pgran.store import file as store
from pgran.store import paths


@pytest.fixture
def path(tmp_path):
    """A result with a record of every kind; each rank has its own folder."""
    return stored(tmp_path / "a.h5")


def test_a_result_replaces_an_older_one_whole(path):
    """What a killed run left is in nobody's way; a folder that was removed is made anew."""
    path.with_name(".a.h5.part").write_bytes(b"half")
    for place in (path, path.parent / "removed" / "a.h5"):
        store.write(place, {"status": "new"}, [make(results.LatticeRecord, (7,))])
        assert load(place).status == "new"
        assert load(place).lattice.stiffness_y is None
        assert os.listdir(place.parent) == ["a.h5"]


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
@pytest.mark.parametrize(
    ("module", "name"), [(store, "_attach"), (store.os, "replace"), (store.os, "fsync")]
)
def test_a_failing_write_leaves_the_old_file(path, monkeypatch, module, name, error):
    def fail(*arguments):
        raise error

    before, disk = path.read_bytes(), isinstance(error, OSError)
    monkeypatch.setattr(module, name, fail)
    words = r"a\.h5: cannot be written: No space left" if disk else None
    with pytest.raises(FileError if disk else KeyboardInterrupt, match=words):
        store.write(path, ATTRIBUTES, [make(results.Modes)])
    assert path.read_bytes() == before
    assert os.listdir(path.parent) == ["a.h5"]


@pytest.mark.parametrize("room", [0, 100, 3000, 20000])
def test_no_room(path, room, capfd):
    """A disk that is full at the beginning, in the middle, at the end: one error, no more words."""
    before, large = path.read_bytes(), make(results.LatticeRecord, (60, 50))
    with no_room_beyond(room, r"a\.h5"):
        store.write(path, ATTRIBUTES, [large])
    assert path.read_bytes() == before
    assert os.listdir(path.parent) == ["a.h5"]
    assert capfd.readouterr().err == ""


def test_a_link_in_the_place_of_the_new_file_is_not_followed(path, tmp_path):
    """What it leads to stays, whatever is written."""
    thesis, part = tmp_path / "thesis", tmp_path / ".b.h5.part"
    thesis.write_bytes(b"mine")
    part.symlink_to(thesis)
    store.write(tmp_path / "b.h5", {}, [make(results.LatticeRecord, (7,))])
    part.with_name(f".c.txt.{os.getpid()}.part").symlink_to(thesis)
    with paths.whole(tmp_path / "c.txt") as stream:
        stream.write(b"new")
    assert thesis.read_bytes() == b"mine"
    assert (tmp_path / "c.txt").read_bytes() == b"new"
    assert not (tmp_path / "b.h5").is_symlink()
    assert sorted(os.listdir(tmp_path)) == ["a.h5", "b.h5", "c.txt", "thesis"]


# What may be replaced


@pytest.mark.parametrize("overwrite", [False, True])
def test_what_appears_while_a_result_is_written_stays(tmp_path, overwrite, monkeypatch):
    """A file of somebody's, and a link that leads nowhere; a result unless it may be replaced."""
    path, record = tmp_path / "a.h5", make(results.LatticeRecord, (7,))
    appear, sync = [], os.fsync
    monkeypatch.setattr(os, "fsync", lambda number: sync(number) or appear.pop()())
    for make_it in (lambda: path.write_bytes(b"mine"), lambda: path.symlink_to(tmp_path / "no")):
        appear.append(make_it)
        with pytest.raises(FileError, match="no result of pgran: move it away yourself"):
            store.write(path, {}, [record], overwrite)
        assert path.is_symlink() or path.read_bytes() == b"mine"
        assert os.listdir(tmp_path) == ["a.h5"]
        path.unlink()
    other = stored(tmp_path.with_name(f"{tmp_path.name}.other")).read_bytes()
    appear.append(lambda: path.write_bytes(other))
    if overwrite:
        store.write(path, {}, [record], overwrite)
    else:
        with pytest.raises(FileError, match="exists already"):
            store.write(path, {}, [record], overwrite)
    assert (path.read_bytes() == other) == (not overwrite)


@pytest.mark.parametrize("overwrite", [False, True])
def test_only_results_are_replaced(path, overwrite):
    """And only if that is asked for; changed or damaged they are results still."""
    result = path.read_bytes()
    for content in (result, change(path).read_bytes(), result.replace(b"lattice", b"lettuce")):
        path.write_bytes(content)
        if overwrite:
            store.check_output(path, overwrite)
        else:
            with pytest.raises(FileError, match="exists already; -output_overwrite"):
                store.check_output(path, overwrite)
    os.mkfifo(path.with_name("pipe"))
    for content in (b"mine", b"", b"\x89HDF\r\n\x1a\n" + bytes(600)):
        path.write_bytes(content)
        for place in (path, path.with_name("pipe"), path.parent):
            with pytest.raises(FileError, match="no result of pgran: move it away yourself"):
                store.check_output(place, overwrite)
        assert path.read_bytes() == content


@pytest.mark.parametrize("name", ["a" * 300, "a" * 248, "a\0b", "file/a.h5", "/proc/a.h5"])
def test_outputs_that_cannot_be_written(tmp_path, name):
    """Found out before the work: the temporary name is longer than the name itself."""
    (tmp_path / "file").touch()
    with pytest.raises(FileError, match="cannot be written"):
        store.check_output(tmp_path / name, False)
    assert os.listdir(tmp_path) == ["file"]
    store.check_output(tmp_path / "new" / "er" / "a.h5", False)
    assert os.listdir(tmp_path / "new" / "er") == []
