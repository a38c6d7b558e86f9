"""Where results are written: whole or not at all, and what may be replaced."""

import os
import resource

import pytest
from result_samples import ATTRIBUTES, change, make, stored

from pgran import load, results
from pgran.errors import FileError
from pgran.files import store


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
    before, limits = path.read_bytes(), resource.getrlimit(resource.RLIMIT_FSIZE)
    large = make(results.LatticeRecord, (60, 50))
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, limits[1]))
    try:
        with pytest.raises(FileError, match=r"a\.h5: cannot be written: File too large"):
            store.write(path, ATTRIBUTES, [large])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert path.read_bytes() == before
    assert os.listdir(path.parent) == ["a.h5"]
    assert capfd.readouterr().err == ""


# What may be replaced


def test_existing_output_needs_leave(path):
    with pytest.raises(FileError, match="exists already; -output_overwrite"):
        store.check_output(path, False)
    before = path.read_bytes()
    store.check_output(change(path), True)
    path.write_bytes(before.replace(b"lattice", b"lettuce"))  # damaged, and still a result
    store.check_output(path, True)
    assert path.exists()


@pytest.mark.parametrize("content", [b"mine", b"", b"\x89HDF\r\n\x1a\n" + bytes(600)])
@pytest.mark.parametrize("overwrite", [False, True])
def test_only_results_are_replaced(tmp_path, content, overwrite):
    path, pipe = tmp_path / "a.h5", tmp_path / "pipe"
    path.write_bytes(content)
    os.mkfifo(pipe)
    for place in (path, pipe, tmp_path):
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
