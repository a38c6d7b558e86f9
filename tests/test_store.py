"""Results on disk: everything comes back, nothing half-written stays, no foreign file does harm."""

import dataclasses
import hashlib
import math
import os
import resource
import stat

import h5py
import numpy as np
import pytest
from samples import random_lattice

from pgran import foreign, load, store
from pgran.errors import FileError
from pgran.results import LatticeRecord, Response

ATTRIBUTES = {
    "scene": "response",
    "status": "complete",
    "options": "-scene response\n# é\n",
    "mpi_size": 2,
    "seconds": 1.5,
    "time_convention": "exp(+i omega t)",
}


def records(shape=(4, 5), fields=True, nw=3):
    """Records with numbers that nothing else has."""
    rng = np.random.default_rng(1)
    lattice = random_lattice(shape)
    displacement = rng.normal(size=(nw, 2)) + 1j * rng.normal(size=(nw, 2))
    response = Response(
        factorizations=7,
        solve_seconds=0.25,
        phase_slope=np.array([-150.0, math.nan]),
        phase_velocity=np.array([0.06, math.nan]),
        phase_intercept=np.array([1.0, math.nan]),
        phase_fit_min=0.3,
        phase_fit_max=1.0,
        omega=np.linspace(0.1, 1, nw),
        detector=rng.integers(0, 4, (2, len(shape))),
        displacement=displacement,
        amplitude=np.abs(displacement),
        phase=np.angle(displacement),
        backward_error=rng.random(nw),
        error_bound=np.array([[1e-20, math.nan]] * nw),
        at_floor=np.zeros((nw, 2), np.int8),
        iterations=np.arange(nw),
        converged_reason=np.array([2, 0, -3][:nw]),
        field=rng.normal(size=(nw, *shape)) + 0j if fields else None,
    )
    return [LatticeRecord.of(lattice), response]


def reseal(path):
    """Give a changed result the seal of its new content, as a malicious writer would."""
    content = path.read_bytes()[512:]
    seal = b"pgran result 1\nsha256 %s\n" % hashlib.sha256(content).hexdigest().encode()
    path.write_bytes(seal.ljust(512, b"\0") + content)


@pytest.fixture
def path(tmp_path):
    """A file name; each rank has its own folder."""
    return tmp_path / "a.h5"


@pytest.mark.parametrize("shape", [(7,), (4, 5), (2, 3, 4), (1, 1)])
@pytest.mark.parametrize("fields", [True, False])
def test_everything_comes_back(path, shape, fields):
    written = records(shape, fields)
    store.write(path, ATTRIBUTES, written)
    result = load(path)
    for record in written:
        group = getattr(result, record.group)
        for item in dataclasses.fields(record):
            value = getattr(record, item.name)
            if value is None:
                assert not hasattr(group, item.name)
                continue
            found = getattr(result if "of_run" in item.metadata else group, item.name)
            assert np.array_equal(found, value, equal_nan=np.asarray(value).dtype.kind in "fc")
            assert np.asarray(found).dtype == np.asarray(value).dtype or isinstance(value, str)
    for name, value in ATTRIBUTES.items():
        assert getattr(result, name) == value
    assert result.format == "pgran"
    assert result.format_version == 1
    assert result.bonds_sha256 == written[0].bonds_sha256
    assert result.response.displacement.dtype == complex


def test_every_dataset_has_units_name_and_scales(path):
    store.write(path, ATTRIBUTES, records((4, 5)))
    seen = []

    def check(name, item):
        if isinstance(item, h5py.Dataset):
            seen.append(name)
            assert isinstance(item.attrs["units"], str)
            assert item.attrs["units"]
            assert item.attrs["long_name"]
            if not h5py.h5ds.is_scale(item.id):
                for number, dimension in enumerate(item.dims):
                    assert len(dimension) == 1, f"{name} axis {number}"
                    assert dimension[0].shape[0] == item.shape[number]

    with h5py.File(path) as file:
        file.visititems(check)
        response = file["response"]
        assert response["displacement"].dims[0][0] == response["omega"]
        assert response["displacement"].dims[1][0] == response["detector"]
        assert response["field"].dims[0][0] == response["omega"]
        assert [d[0].name for d in response["field"].dims][1:] == ["/response/x", "/response/y"]
        assert file["lattice/stiffness_x"].shape == (5, 5)
        assert file["lattice/stiffness_y"].shape == (4, 6)
    declared = [
        item.name for r in records() for item in dataclasses.fields(r) if "axes" in item.metadata
    ]
    assert set(declared) - {"stiffness_z"} <= {name.split("/")[1] for name in seen}


def test_stiffness_comes_back_as_a_lattice_needs_it(path):
    for shape in [(7,), (4, 5), (2, 3, 4)]:
        store.write(path, ATTRIBUTES, records(shape))
        found = store.read_stiffness(path)[0]
        assert all(
            np.array_equal(a, b)
            for a, b in zip(found, random_lattice(shape).stiffness, strict=True)
        )


# Whole or not at all


def test_a_result_replaces_an_older_one_whole(path):
    store.write(path, ATTRIBUTES, records((4, 5)))
    store.write(path, ATTRIBUTES | {"status": "unconverged"}, records((7,), fields=False))
    result = load(path)
    assert result.status == "unconverged"
    assert not hasattr(result.lattice, "stiffness_y")
    assert os.listdir(path.parent) == ["a.h5"]


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
@pytest.mark.parametrize("where", ["_write_record", "_attach", "os.replace", "os.fsync"])
def test_a_failing_write_leaves_the_old_file(path, monkeypatch, where, error):
    store.write(path, ATTRIBUTES, records())
    before = path.read_bytes()

    def fail(*arguments):
        raise error

    *module, name = where.split(".")
    monkeypatch.setattr(os if module else store, name, fail)
    expected = FileError if isinstance(error, OSError) else KeyboardInterrupt
    with pytest.raises(expected):
        store.write(path, ATTRIBUTES, records())
    monkeypatch.undo()
    assert path.read_bytes() == before
    assert os.listdir(path.parent) == ["a.h5"]


def test_message_of_a_failing_write(path, monkeypatch):
    def fail(*arguments):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(FileError, match=r"a\.h5: cannot be written: No space left"):
        store.write(path, ATTRIBUTES, records())


@pytest.mark.parametrize("room", [0, 100, 3000, 20000])
def test_no_room(path, room, capfd):
    """A disk that is full at the beginning, in the middle, at the end: one error, no more words."""
    store.write(path, ATTRIBUTES, records())
    before = path.read_bytes()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    large = [LatticeRecord.of(random_lattice((60, 50)))]
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, limits[1]))
    try:
        with pytest.raises(FileError, match=r"a\.h5: cannot be written: File too large"):
            store.write(path, ATTRIBUTES, large)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert path.read_bytes() == before
    assert os.listdir(path.parent) == ["a.h5"]
    assert capfd.readouterr().err == ""


def test_a_folder_that_was_removed_is_made_anew(path):
    path = path.parent / "results" / "a.h5"
    store.write(path, ATTRIBUTES, records())
    assert load(path).status == ATTRIBUTES["status"]


def test_what_a_killed_run_left_is_replaced(path):
    path.with_name(".a.h5.part").write_bytes(b"half a result" * 1000)
    store.write(path, ATTRIBUTES, records())
    assert load(path).status == ATTRIBUTES["status"]
    assert os.listdir(path.parent) == ["a.h5"]


def test_a_result_is_readable_by_others(path):
    """As any file that open() makes: the umask decides."""
    store.write(path, ATTRIBUTES, records())
    other = path.with_name("other")
    other.touch()
    assert stat.S_IMODE(path.stat().st_mode) == stat.S_IMODE(other.stat().st_mode)


# check_output


def test_existing_output_needs_leave(path):
    store.write(path, ATTRIBUTES, records())
    before = path.read_bytes()
    with pytest.raises(FileError, match="exists already; -output_overwrite"):
        store.check_output(path, False)
    store.check_output(path, True)
    assert path.read_bytes() == before
    path.write_bytes(before[:1000])  # damaged, and still a result
    store.check_output(path, True)


@pytest.mark.parametrize("content", [b"mine", b"", b"pgran", b"\x89HDF\r\n\x1a\n" + bytes(600)])
@pytest.mark.parametrize("overwrite", [False, True])
def test_only_results_are_replaced(path, content, overwrite):
    path.write_bytes(content)
    with pytest.raises(FileError, match="no result of pgran: move it away yourself"):
        store.check_output(path, overwrite)
    assert path.read_bytes() == content
    path.unlink()
    os.mkfifo(path)
    with pytest.raises(FileError, match="no result of pgran"):
        store.check_output(path, overwrite)


@pytest.mark.parametrize("name", ["a" * 300, "a" * 248, "a\0b"])
def test_names_that_cannot_be_written(tmp_path, name):
    """Found out before the work: the temporary name is longer than the name itself."""
    with pytest.raises(FileError, match="cannot be written"):
        store.check_output(tmp_path / name, False)
    assert os.listdir(tmp_path) == []


def test_output_folder_is_made(tmp_path):
    store.check_output(tmp_path / "new" / "er" / "a.h5", False)
    assert os.listdir(tmp_path / "new" / "er") == []


def test_output_under_a_file(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(FileError, match="cannot be written"):
        store.check_output(tmp_path / "file" / "a.h5", False)


def test_output_is_a_folder(tmp_path):
    (tmp_path / "a.h5").mkdir()
    for overwrite in (False, True):
        with pytest.raises(FileError):
            store.check_output(tmp_path / "a.h5", overwrite)


def test_unwritable_folder():
    """/proc takes no files from anybody, root included."""
    with pytest.raises(FileError, match="cannot be written"):
        store.check_output("/proc/a.h5", False)


# Foreign and damaged files


def refused(path, match, read=load):
    with pytest.raises(FileError, match=match) as caught:
        read(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_and_other_files(tmp_path):
    refused(tmp_path / "none.h5", "No such file")
    refused(tmp_path, "directory")
    os.mkfifo(tmp_path / "pipe.h5")
    (tmp_path / "text.h5").write_text("hello")
    (tmp_path / "empty.h5").touch()
    with h5py.File(tmp_path / "foreign.h5", "w") as file:
        file["x"] = 1.0
    for name, why in [("text", "not an HDF5 file"), ("empty", "not an HDF5 file")]:
        refused(tmp_path / f"{name}.h5", "not a result of pgran")
        refused(tmp_path / f"{name}.h5", why, store.read_stiffness)
    refused(tmp_path / "foreign.h5", "not a result of pgran")
    refused(tmp_path / "foreign.h5", "/lattice is missing", store.read_stiffness)
    both_refuse(tmp_path / "pipe.h5", "pipe")


@pytest.mark.parametrize("version", [b"0", b"2", b"1.0", b"\x1b[31m", b""])
def test_other_format_versions(path, version):
    store.write(path, ATTRIBUTES, records())
    content = path.read_bytes()
    path.write_bytes(content.replace(b"result 1\n", b"result %s\n" % version, 1))
    refused(path, "format version")


def test_seal_is_the_checksum_of_all_that_follows(path):
    store.write(path, ATTRIBUTES, records())
    before = path.read_bytes()
    reseal(path)
    assert path.read_bytes() == before
    assert before.startswith(b"pgran result 1\nsha256 ")
    with h5py.File(path) as file:
        assert file.userblock_size == 512


def test_every_changed_byte_is_found(path):
    """One bit anywhere, the padding of the seal included; one byte more or less."""
    store.write(path, ATTRIBUTES, records((1, 1), fields=False, nw=1))
    whole = path.read_bytes()
    rng = np.random.default_rng(3)
    for place in [*range(0, 600, 7), *rng.integers(0, len(whole), 200), len(whole) - 1]:
        changed = bytearray(whole)
        changed[place] ^= 1 << rng.integers(8)
        path.write_bytes(changed)
        refused(path, "damaged or changed|not a result|format version")
    for content in (whole[:-1], whole + b"\0", whole[:512], whole[:300], whole * 2):
        path.write_bytes(content)
        both_refuse(path, "damaged or changed")
    path.write_bytes(whole)
    load(path)


def test_bonds_of_a_result_without_seal_are_refused(path):
    """A single bit of the seal's first word, or the file copied by a tool that drops the seal."""
    store.write(path, ATTRIBUTES, records())
    whole = path.read_bytes()
    for content in (b"q" + whole[1:], whole[512:]):
        path.write_bytes(content)
        refused(path, "not a result")
        refused(path, "damaged or changed .no seal", store.read_stiffness)


def test_a_result_changed_by_hand_is_refused(path):
    """Its bonds too: nobody can tell a change from damage."""
    store.write(path, ATTRIBUTES, records())
    with h5py.File(path, "r+") as file:
        file["lattice/stiffness_x"][0, 0] = 0.5
    both_refuse(path, "damaged or changed")


@pytest.mark.parametrize("part", [0.1, 0.5, 0.9, 0.999])
def test_truncated_files(path, part):
    store.write(path, ATTRIBUTES, records())
    whole = path.read_bytes()
    path.write_bytes(whole[: int(part * len(whole))])
    refused(path, "damaged")


def with_member(path, make):
    """A result whose /lattice/stiffness_x is made by `make`, with a true seal."""
    store.write(path, ATTRIBUTES, records())
    with h5py.File(path, "a") as file:
        del file["lattice/stiffness_x"]
        make(file["lattice"])
    reseal(path)


def both_refuse(path, match):
    refused(path, match)
    refused(path, match, store.read_stiffness)


def apart(path):
    """Take the seal away, so that the bonds are read as from any other file."""
    with h5py.File(path, "r+") as file:
        del file.attrs["format"]
    path.write_bytes(bytes(512) + path.read_bytes()[512:])
    return path


def all_refuse(path, match):
    """As a result, as bonds, and as bonds of any other file."""
    both_refuse(path, match)
    with pytest.raises(FileError, match=match), foreign.opened(apart(path)) as file:
        foreign.bonds(file)


def test_soft_and_external_links(path):
    other = path.with_name("other.h5")
    store.write(other, ATTRIBUTES, records())
    links = [h5py.SoftLink("/lattice/stiffness_y"), h5py.SoftLink("/lattice")]
    for link in [*links, h5py.ExternalLink("other.h5", "/lattice/stiffness_x")]:
        with_member(path, lambda group, link=link: group.__setitem__("stiffness_x", link))
        all_refuse(path, "link")


def test_external_group_link(path):
    other = path.with_name("other.h5")
    store.write(other, ATTRIBUTES, records())
    store.write(path, ATTRIBUTES, records())
    with h5py.File(path, "a") as file:
        del file["lattice"]
        file["lattice"] = h5py.ExternalLink("other.h5", "/lattice")
    reseal(path)
    all_refuse(path, "link")


def test_external_storage(path):
    secret = path.with_name("secret")
    secret.write_bytes(bytes(5 * 5 * 8))

    def make(group):
        group.create_dataset("stiffness_x", (5, 5), float, external=[(str(secret), 0, 5 * 5 * 8)])

    with_member(path, make)
    all_refuse(path, "another file")


def test_virtual_dataset(path):
    other = path.with_name("other.h5")
    store.write(other, ATTRIBUTES, records())

    def make(group):
        layout = h5py.VirtualLayout((5, 5), float)
        layout[...] = h5py.VirtualSource(other, "lattice/stiffness_x", (5, 5))
        group.create_virtual_dataset("stiffness_x", layout)

    with_member(path, make)
    all_refuse(path, "another file")


def test_far_more_declared_than_stored(path):
    """80 GB in a few kB."""

    def make(group):
        group.create_dataset("stiffness_x", (100_000, 100_000), float, chunks=(1000, 1000))

    with_member(path, make)
    assert path.stat().st_size < 100_000
    refused(path, "declares")


def test_text_and_records_instead_of_numbers(path):
    for value in (b"text", np.zeros(3, [("a", float), ("b", int)])):
        with_member(path, lambda group, value=value: group.__setitem__("stiffness_x", value))
        both_refuse(path, "no numbers")
