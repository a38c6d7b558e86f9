"""Results on disk: everything comes back, nothing half-written stays, no foreign file does harm."""

import dataclasses
import hashlib
import math
import os
import resource
import stat
from pathlib import Path

import h5py
import numpy as np
import pytest
from samples import random_lattice

from pgran import load
from pgran.errors import FileError
from pgran.files import hdf5 as foreign
from pgran.files import store
from pgran.results import (
    Accuracy,
    ContinuumResponse,
    LatticeRecord,
    Modes,
    Projection,
    Relaxation,
    Response,
    Spectrum,
)

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
    """Give a result that h5py changed the seal of its new content, as a malicious writer would."""
    content = path.read_bytes()
    seal = b"pgran result 2\nsha256 %s\n" % hashlib.sha256(content).hexdigest().encode()
    path.write_bytes(content + seal.ljust(512, b"\0"))


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
    assert result.format_version == 2
    assert result.bonds_sha256 == written[0].bonds_sha256
    assert result.response.displacement.dtype == complex


SPECTRUM = Spectrum(2.0, 0.1, 1.9, 1.0, 0.01, 0.3, 8, np.arange(1, 4) / 8, np.ones(3))
CONTINUUM = ContinuumResponse(
    *((0.5, 0.5), (1.0, 1.0), 1.0, 1.0, 0.0),
    *(np.arange(3.0), np.ones(3) + 0j, np.ones(3), np.zeros(3), np.zeros(0)),
)
MODES = Modes(0, True, 0.1, *np.zeros((3, 0)), np.zeros((0, 4, 5)))
PROJECTION = Projection(
    *(2, False, 3, 0.1, np.arange(3.0), np.arange(2.0), np.ones((3, 2)) + 1j),
    *np.zeros((3, 3)),
)
RELAXATION = Relaxation(
    *(0.6, 1, 0.1, 0.0, np.zeros((1, 3), int), np.zeros((1, 3, 2), int), np.ones((1, 3))),
    *(np.array([[1, 2]]), np.ones((1, 4, 1)) + 0j, np.ones((1, 4, 1)), np.ones((1, 4, 1), np.int8)),
)
ACCURACY = Accuracy(
    *("response", 1, 3, 3, 1e-9, np.array(["a", "b c"]), np.array(["ä", "b"])),
    *np.ones((7, 2)),
    *np.ones((2, 2), int),
    np.array([True, False]),
)
ALL = [*records(), MODES, PROJECTION, RELAXATION, SPECTRUM, CONTINUUM, ACCURACY]


def test_every_dataset_has_units_name_and_scales(path):
    """As netCDF-4 has it: every axis has one scale, which has one axis, and their lengths agree."""
    store.write(path, ATTRIBUTES, ALL)
    with h5py.File(path) as file:
        members = [data for group in file.values() for data in group.values()]
        for data in members:
            assert isinstance(data.attrs["units"], str)
            assert data.attrs["units"]
            assert data.attrs["long_name"]
            if h5py.h5ds.is_scale(data.id):
                assert data.ndim == 1, data.name
                continue
            assert data.name.split("/")[2] not in [d[0].name.split("/")[2] for d in data.dims]
            for number, dimension in enumerate(data.dims):
                assert len(dimension) == 1, f"{data.name} axis {number}"
                assert dimension[0].shape == data.shape[number : number + 1]
                assert dimension[0].parent == data.parent
        assert {data.name.split("/")[2] for data in members} >= {
            item.name for r in ALL for item in dataclasses.fields(r) if "axes" in item.metadata
        } - {"stiffness_z"}
        for name, scales in {
            "response/displacement": "omega detector_number",
            "response/detector": "detector_number axis",
            "response/field": "omega x y",
            "lattice/stiffness_x": "bond_x y",
            "relaxation/bond_index": "trajectory step axis",
            "spectrum/power": "frequency",
        }.items():
            assert [d[0].name.split("/")[2] for d in file[name].dims] == scales.split()


@pytest.mark.parametrize("engine", ["h5netcdf", "netcdf4"])
def test_xarray_reads_every_group(path, engine):
    pytest.importorskip({"netcdf4": "netCDF4"}.get(engine, engine))
    xarray = pytest.importorskip("xarray")
    store.write(path, ATTRIBUTES, ALL)
    for record in ALL:
        with xarray.open_dataset(path, engine=engine, group=record.group) as found:
            for item in dataclasses.fields(record):
                value = getattr(record, item.name)
                if value is None or "of_run" in item.metadata:
                    continue
                read = found[item.name].values if item.metadata else found.attrs[item.name]
                kind = np.asarray(value).dtype.kind
                if kind == "U":  # bytes by h5netcdf
                    read = [t.decode() if isinstance(t, bytes) else t for t in np.atleast_1d(read)]
                    value = np.atleast_1d(value)
                if kind == "c" and read.dtype.names:  # by netCDF4
                    read = read["r"] + 1j * read["i"]
                assert np.array_equal(read, value, equal_nan=kind in "fc"), item.name
    with xarray.open_dataset(path, engine=engine, group="response") as found:
        assert found.displacement.dims == ("omega", "detector_number")
        assert found.detector.dims == ("detector_number", "axis")
        near = found.amplitude.sel(omega=0.56, method="nearest").values
        assert np.array_equal(near, ALL[1].amplitude[1])
    with xarray.open_dataset(path, engine=engine) as found:
        assert found.attrs["options"] == ATTRIBUTES["options"]


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
    path.write_bytes(before.replace(b"lattice", b"lettuce"))  # damaged, and still a result
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


@pytest.mark.parametrize("version", [b"0", b"1", b"3", b"2.0", b"\x1b[31m", b""])
def test_other_format_versions(path, version):
    store.write(path, ATTRIBUTES, records())
    content, seal = path.read_bytes()[:-512], path.read_bytes()[-512:]
    seal = seal.replace(b"result 2\n", b"result %s\n" % version).ljust(512, b"\0")[:512]
    path.write_bytes(content + seal)
    refused(path, "format version .*; this pgran reads 1 to 2")


VERSION_1 = Path(__file__).with_name("version1.h5")


def test_files_of_version_1_are_read(path):
    """Its seal comes first; `detector` is a scale of two axes."""
    result = load(VERSION_1)
    assert (result.format_version, result.pgran_version) == (1, "0.1.0")
    assert result.response.amplitude.shape == (5, 1)
    assert result.response.detector.tolist() == [[1, 1]]
    stiffness, kmax = store.read_stiffness(VERSION_1)
    assert np.array_equal(stiffness[0], result.lattice.stiffness_x)
    assert kmax == pytest.approx(0.25)
    store.check_output(VERSION_1, True)
    whole = VERSION_1.read_bytes()
    for place in (20, 511, 512, 3000, len(whole) - 1):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 4]) + whole[place + 1 :])
        refused(path, "damaged or changed")


def test_seal_is_the_checksum_of_all_before(path):
    store.write(path, ATTRIBUTES, records())
    before = path.read_bytes()
    path.write_bytes(before[:-512])
    reseal(path)
    assert path.read_bytes() == before
    assert before[-512:].startswith(b"pgran result 2\nsha256 ")
    assert before.startswith(b"\x89HDF\r\n\x1a\n")


def test_every_changed_byte_is_found(path):
    """One bit anywhere, the padding of the seal included; one byte more or less."""
    store.write(path, ATTRIBUTES, records((1, 1), fields=False, nw=1))
    whole = path.read_bytes()
    rng = np.random.default_rng(3)
    size = len(whole)
    for place in [*range(0, 600, 7), *range(size - 600, size, 7), *rng.integers(0, size, 200)]:
        changed = bytearray(whole)
        changed[place] ^= 1 << rng.integers(8)
        path.write_bytes(changed)
        refused(path, "damaged or changed|format version")
    for content in (whole[1:], whole[:-512] + whole, whole * 2):
        path.write_bytes(content)
        both_refuse(path, "damaged or changed")
    for content in (whole[:-1], whole + b"\0", whole[:-512], whole[:512], whole[:300]):
        path.write_bytes(content)
        refused(path, "damaged or changed")
        refused(path, "damaged", store.read_stiffness)
    path.write_bytes(whole)
    load(path)


def test_bonds_of_a_result_without_seal_are_refused(path):
    """A single bit of the seal's first word, or the file copied by a tool that drops the seal."""
    store.write(path, ATTRIBUTES, records())
    whole = path.read_bytes()
    for content in (whole[:-512] + b"q" + whole[-511:], whole[:-512]):
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
    with h5py.File(path, "r+") as file:  # which drops what follows HDF5's own bytes
        del file.attrs["format"]
    assert not store.is_result(path)
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
