"""Results on disk: everything comes back, nothing half-written stays, damage does no harm."""

import dataclasses
import hashlib
import os
import pickle
import resource
import stat
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from samples import random_lattice

from pgran import __main__ as command_line
from pgran import figures, load, results
from pgran.errors import DONE, FileError, PgranError
from pgran.files import store

ATTRIBUTES = {
    "scene": "response",
    "status": "complete",
    "options": "-scene response\n# é\n",
    "slepc_version": "",
    "mpi_size": 2,
    "seconds": 1.5,
}
VERSION_1 = Path(__file__).with_name("version1.h5")
RNG = np.random.default_rng(1)


def records(shape=(4, 5), fields=True, nw=3):
    """Two records with numbers that nothing else has."""
    numbers = {
        "f": RNG.normal, "c": lambda size: RNG.normal(size=size) + 1j * RNG.normal(size=size),
        "i": lambda size: RNG.integers(0, 9, size),
    }  # fmt: skip
    lengths = {"omega": nw, "detector_number": 2, "axis": len(shape), "balls": shape}
    values = {"field": None}
    for item in dataclasses.fields(results.Response):
        axes = item.metadata.get("axes", item.metadata.get("along"))
        if axes is None:
            values[item.name] = item.type(RNG.integers(1, 99))
        elif fields or item.name != "field":
            size = np.hstack([lengths[axis] for axis in axes or (item.name,)])
            dtype = np.dtype(item.metadata["dtype"])
            values[item.name] = numbers[dtype.kind](size=tuple(size)).astype(dtype)
    values["error_bound"][0] = np.nan
    return [results.LatticeRecord.of(random_lattice(shape)), results.Response(**values)]


OTHERS = [
    results.Modes(0, True, 0.1, *np.zeros((3, 0)), np.zeros((0, 4, 5))),
    results.Projection(
        *(2, False, 3, 0.1, np.arange(3.0), np.arange(2.0), np.ones((3, 2)) + 1j),
        *(np.arange(3), np.ones(3), np.arange(3)),
    ),
    results.Relaxation(
        *(0.6, 1, 0.1, 0.0, np.zeros((1, 3), int), np.zeros((1, 3, 2), int), np.ones((1, 3))),
        *(np.array([[1, 2]]), np.ones((1, 4, 1)) + 0j, np.ones((1, 4, 1))),
        np.ones((1, 4, 1), np.int8),
    ),
    results.Spectrum(2.0, 0.1, 1.9, 1.0, 0.01, 0.3, 8, np.arange(1, 4) / 8, np.ones(3)),
    results.ContinuumResponse(
        *((0.5, 0.25), (1.0, 1.0), 1.0, 1.0, 0.0),
        *(np.arange(3.0), np.ones(3) + 0j, np.ones(3), np.zeros(3), np.zeros(0)),
    ),
    results.Accuracy(
        *("response", 1, 3, 3, 1e-9, np.array(["a", "b c"]), np.array(["ä", "b"])),
        *np.ones((7, 2)),
        *np.ones((2, 2), int),
        np.array([True, False]),
    ),
]


@pytest.fixture
def path(tmp_path):
    """A result of eight records; each rank has its own folder."""
    store.write(tmp_path / "a.h5", ATTRIBUTES, [*records(), *OTHERS])
    return tmp_path / "a.h5"


def test_every_record_is_declared():
    assert {r.group for r in [*records(), *OTHERS]} == set(results.RECORDS)


@pytest.mark.parametrize("shape", [(7,), (4, 5), (2, 3, 4), (1, 1)])
@pytest.mark.parametrize("fields", [True, False])
def test_everything_comes_back(tmp_path, shape, fields):
    """Field by field, types included; bonds as a lattice takes them."""
    lattice = random_lattice(shape)
    others = OTHERS if len(shape) == 2 else OTHERS[3:]
    written = [*records(shape, fields), *others]
    store.write(tmp_path / "a.h5", ATTRIBUTES, written)
    result = load(tmp_path / "a.h5")
    assert list(result.records) == [record.group for record in written]
    for record in written:
        found = getattr(result, record.group)
        assert type(found) is type(record)
        for item in dataclasses.fields(record):
            value, same = getattr(record, item.name), getattr(found, item.name)
            assert type(same) is type(value), item.name
            assert np.array_equal(same, value, equal_nan=np.asarray(value).dtype.kind in "fc")
            assert np.asarray(same).dtype == np.asarray(value).dtype, item.name
    for name, value in ATTRIBUTES.items():
        assert getattr(result, name) == value
        assert type(getattr(result, name)) is type(value)
    assert (result.format, result.format_version) == ("pgran", 2)
    assert result.bonds_sha256 == result.lattice.bonds_sha256 == lattice.bonds_sha256
    stiffness, kmax = store.read_stiffness(tmp_path / "a.h5")
    assert kmax == pytest.approx(0.25)
    for arrays in (stiffness, result.lattice.stiffness):
        assert all(map(np.array_equal, arrays, lattice.stiffness))
        assert len(arrays) == len(shape)


def test_every_dataset_has_units_name_and_scales(path):
    """As netCDF-4 has it: every axis has one scale, which has one axis, and their lengths agree."""
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


@pytest.mark.parametrize("engine", ["h5netcdf", "netcdf4"])
def test_xarray_reads_what_records_become(path, engine):
    """The same variables, coordinates and attributes from the file and from the record."""
    pytest.importorskip({"netcdf4": "netCDF4"}.get(engine, engine))
    xarray = pytest.importorskip("xarray")
    for group, record in load(path).records.items():
        made = record.to_xarray()
        with xarray.open_dataset(path, engine=engine, group=group) as found:
            for name, variable in made.variables.items():
                read = found[name].values
                if variable.dtype.kind == "U":  # bytes by h5netcdf
                    read = [t.decode() if isinstance(t, bytes) else t for t in read]
                elif variable.dtype.kind == "c" and read.dtype.names:  # by netCDF4
                    read = read["r"] + 1j * read["i"]
                nan = variable.dtype.kind in "fc"
                assert np.array_equal(read, variable.values, equal_nan=nan), name
                assert found[name].dims == variable.dims
                assert found[name].attrs["units"] == variable.attrs["units"]
            assert set(made.coords) <= set(found.coords)
            for name in set(made.attrs) - {"bonds_sha256"}:
                assert np.array_equal(found.attrs[name], made.attrs[name])
    response = load(path).response
    made = response.to_xarray()
    assert made.field.dims == ("omega", "x", "y")
    assert made.displacement.dtype == complex
    near = made.amplitude.sel(omega=response.omega[1], method=None)
    assert np.array_equal(near, response.amplitude[1])
    with xarray.open_dataset(path, engine=engine) as found:
        assert found.attrs["options"] == ATTRIBUTES["options"]


def test_no_xarray(monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(PgranError, match="pip install xarray"):
        records()[1].to_xarray()


def test_a_result_by_name(path):
    lattice, response = records((40, 50), nw=1000)
    result = results.Result([lattice, response], scene="response", records=3)
    assert result.response is response
    assert (result.scene, result.attributes["records"]) == ("response", 3)
    assert list(result.records) == ["lattice", "response"]
    assert {"lattice", "scene"} <= set(dir(result))
    assert getattr(result, "spectrum", None) is None
    for error in (AttributeError, FileError):
        with pytest.raises(error, match="holds no spectrum; its groups are: lattice, response"):
            _ = result.spectrum
    assert pickle.loads(pickle.dumps(result)).scene == "response"
    assert "omega: float64 (1000,)" in repr(response)
    assert "shape=(40, 50)" in repr(lattice)
    assert len(repr(response)) < 1000
    assert repr(result) == "Result(scene='response', status=None, lattice, response)"


# Whole or not at all


def test_a_result_replaces_an_older_one_whole(path):
    path.with_name(".a.h5.part").write_bytes(b"what a killed run left")
    store.write(path, ATTRIBUTES | {"status": "unconverged"}, records((7,), fields=False))
    result = load(path)
    assert result.status == "unconverged"
    assert result.lattice.stiffness_y is None
    assert os.listdir(path.parent) == ["a.h5"]


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
@pytest.mark.parametrize("where", ["_write_record", "_attach", "os.replace", "os.fsync"])
def test_a_failing_write_leaves_the_old_file(path, monkeypatch, where, error):
    before = path.read_bytes()

    def fail(*arguments):
        raise error

    *module, name = where.split(".")
    monkeypatch.setattr(os if module else store, name, fail)
    disk = isinstance(error, OSError)
    words = r"a\.h5: cannot be written: No space left" if disk else None
    with pytest.raises(FileError if disk else KeyboardInterrupt, match=words):
        store.write(path, ATTRIBUTES, records())
    monkeypatch.undo()
    assert path.read_bytes() == before
    assert os.listdir(path.parent) == ["a.h5"]


@pytest.mark.parametrize("room", [0, 100, 3000, 20000])
def test_no_room(path, room, capfd):
    """A disk that is full at the beginning, in the middle, at the end: one error, no more words."""
    before = path.read_bytes()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    large = [results.LatticeRecord.of(random_lattice((60, 50)))]
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, limits[1]))
    try:
        with pytest.raises(FileError, match=r"a\.h5: cannot be written: File too large"):
            store.write(path, ATTRIBUTES, large)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert path.read_bytes() == before
    assert os.listdir(path.parent) == ["a.h5"]
    assert capfd.readouterr().err == ""


def test_a_folder_that_was_removed_is_made_anew_and_the_umask_decides(tmp_path):
    path, other = tmp_path / "results" / "a.h5", tmp_path / "other"
    store.write(path, ATTRIBUTES, records())
    other.touch()
    assert load(path).status == ATTRIBUTES["status"]
    assert stat.S_IMODE(path.stat().st_mode) == stat.S_IMODE(other.stat().st_mode)


# What may be replaced


def change(path, edit=lambda file: file.attrs.update(note="mine")):
    """Change a result by h5py, which drops the seal."""
    with h5py.File(path, "r+") as file:
        edit(file)
    return path


def test_existing_output_needs_leave(path):
    with pytest.raises(FileError, match="exists already; -output_overwrite"):
        store.check_output(path, False)
    before = path.read_bytes()
    store.check_output(path, True)
    assert path.read_bytes() == before
    path.write_bytes(before.replace(b"lattice", b"lettuce"))  # damaged, and still a result
    store.check_output(path, True)
    path.write_bytes(before)
    store.check_output(change(path), True)
    store.check_output(VERSION_1, True)


@pytest.mark.parametrize("content", [b"mine", b"", b"pgran", b"\x89HDF\r\n\x1a\n" + bytes(600)])
@pytest.mark.parametrize("overwrite", [False, True])
def test_only_results_are_replaced(tmp_path, content, overwrite):
    path = tmp_path / "a.h5"
    path.write_bytes(content)
    with pytest.raises(FileError, match="no result of pgran: move it away yourself"):
        store.check_output(path, overwrite)
    assert path.read_bytes() == content
    path.unlink()
    os.mkfifo(path)
    with pytest.raises(FileError, match="no result of pgran"):
        store.check_output(path, overwrite)


@pytest.mark.parametrize("name", ["a" * 300, "a" * 248, "a\0b", "file/a.h5", "/proc/a.h5"])
def test_outputs_that_cannot_be_written(tmp_path, name):
    """Found out before the work: the temporary name is longer than the name itself."""
    (tmp_path / "file").touch()
    with pytest.raises(FileError, match="cannot be written"):
        store.check_output(tmp_path / name, False)
    assert os.listdir(tmp_path) == ["file"]


def test_output_folders(tmp_path):
    store.check_output(tmp_path / "new" / "er" / "a.h5", False)
    assert os.listdir(tmp_path / "new" / "er") == []
    with pytest.raises(FileError, match="no result of pgran"):
        store.check_output(tmp_path / "new", True)


# Changed, damaged and forged files; tests/test_foreign.py has those that point elsewhere


def refused(path, match, read=load):
    with pytest.raises(FileError, match=match) as caught:
        read(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_and_other_files(tmp_path):
    refused(tmp_path / "none.h5", "No such file")
    refused(tmp_path, "directory")
    os.mkfifo(tmp_path / "pipe.h5")
    refused(tmp_path / "pipe.h5", "pipe")
    (tmp_path / "text.h5").write_text("hello")
    refused(tmp_path / "text.h5", "not an HDF5 file")
    with h5py.File(tmp_path / "foreign.h5", "w") as file:
        file["x"] = 1.0
    refused(tmp_path / "foreign.h5", "not a result of pgran")


def replace(name, value):
    """Return an edit that puts a dataset in the place of another, or an attribute."""

    def edit(file):
        if name.endswith("/"):
            file[os.path.dirname(name[:-1]) or "/"].attrs[os.path.basename(name[:-1])] = value
            return
        del file[name]
        if value is not None:
            file[name] = value

    return edit


@pytest.mark.parametrize(
    ("name", "value", "match"),
    [
        ("format_version/", 3, "format version 3; this pgran reads 1 to 2"),
        ("format_version/", "x", "format version x"),
        ("format/", "other", "not a result"),
        ("response/omega", None, "/response/omega is missing"),
        ("response/omega", np.ones(4), r"/response/\w+: shape .* is not omega \(\d\)"),
        ("response/omega", np.ones((3, 1)), r"/response/omega: shape \(3, 1\) is not omega \(3\)"),
        ("response/field", np.ones((3, 4, 5, 1)) + 0j, r"/field: .* omega \(3\) x x \(4\) x y"),
        ("response/field", np.ones((3, 4, 6)) + 0j, r"/field: shape .* y \(5\)"),
        ("response/displacement", np.ones((3, 2)), "displacement holds no complex numbers"),
        ("response/iterations", np.ones(3), "iterations holds no integers but float64"),
        ("response/omega", "text", "omega holds no real numbers"),
        ("response/phase_slope/", np.ones(3), r"phase_slope: shape \(3,\) is not detector_number"),
        ("response/phase_slope/", 1.0, "phase_slope: 1.0 is not a list of real numbers"),
        ("response/factorizations/", 1.5, "factorizations: 1.5 is not a single integer"),
        ("modes/count_certified/", "yes", "count_certified: 'yes' is not a single truth value"),
        ("lattice/shape/", (5, 4), r"stiffness_x: shape \(5, 5\) is not bond_x \(6\) x y \(4\)"),
        ("lattice/shape/", (4, 5, 6), "shape: .* does not fit 2 arrays stiffness"),
        ("lattice/shape/", (-1, 5), "shape: .* does not fit 2 arrays stiffness"),
        ("lattice/stiffness_y", None, "shape: .* does not fit 1 arrays stiffness"),
    ],
)
def test_what_does_not_fit_its_declaration(path, name, value, match):
    refused(change(path, replace(name, value)), match)


def test_a_missing_attribute(path):
    refused(change(path, lambda file: file["lattice"].attrs.pop("mass")), "/lattice/mass is miss")


def test_what_users_add_does_no_harm(path):
    """Attributes, groups and datasets of their own; integers as frequencies."""

    def edit(file):
        file.attrs.update(note="mine", many=np.ones(4), records=1)
        file["own/data"] = file["response/own"] = np.ones(2)
        del file["response/omega"]
        file["response/omega"] = np.arange(3)

    result = load(change(path, edit))
    assert (result.note, result.attributes["records"]) == ("mine", 1)
    assert result.response.omega.dtype == float
    assert not hasattr(result, "own")


def test_files_of_version_1_are_read(tmp_path):
    """Its seal comes first, and some arrays came later."""
    result = load(VERSION_1)
    assert (result.format_version, result.pgran_version) == (1, "0.1.0")
    assert result.response.at_floor is None
    assert result.response.amplitude.shape == (5, 1)
    assert result.lattice.shape == (3, 2)
    stiffness, kmax = store.read_stiffness(VERSION_1)
    assert np.array_equal(stiffness[0], result.lattice.stiffness_x)
    assert kmax == pytest.approx(0.25)
    store.check_seal(VERSION_1)
    assert len(list(figures.draw(result, tmp_path / "a.png"))) > 1
    whole = VERSION_1.read_bytes()
    for place in (20, 511, 512, 3000, len(whole) - 1):
        (tmp_path / "b.h5").write_bytes(
            whole[:place] + bytes([whole[place] ^ 4]) + whole[place + 1 :]
        )
        refused(tmp_path / "b.h5", "damaged or changed", store.check_seal)


# The seal


def test_verify(path, capsys):
    """The seal is the checksum of all before; reading does not need it."""
    assert command_line.main(["verify", str(path)]) == DONE
    assert capsys.readouterr().out == f"{path}: as it was written\n"
    content, seal = path.read_bytes()[:-512], path.read_bytes()[-512:]
    digest = hashlib.sha256(content).hexdigest()
    assert seal.rstrip(b"\0") == f"pgran result 2\nsha256 {digest}\n".encode()
    assert content.startswith(b"\x89HDF\r\n\x1a\n")
    change(path)
    assert load(path).note == "mine"
    refused(path, "changed since .no seal.", lambda path: command_line.main(["verify", str(path)]))


def test_a_sealed_result_is_read_by_no_other_process(path, monkeypatch):
    monkeypatch.setattr(subprocess, "run", None)
    store.read_stiffness(path)


def test_every_changed_byte_is_found_and_none_does_harm(tmp_path):
    """One bit anywhere, one byte more or less: `load` reads or refuses, `check_seal` knows."""
    path = tmp_path / "a.h5"
    store.write(path, ATTRIBUTES, records((1, 1), fields=False, nw=1))
    whole = path.read_bytes()
    rng, size, refusals = np.random.default_rng(3), len(whole), 0
    for place in [*range(0, 600, 7), *range(size - 600, size, 7), *rng.integers(0, size, 300)]:
        changed = bytearray(whole)
        changed[place] ^= 1 << rng.integers(8)
        path.write_bytes(changed)
        refused(path, "damaged or changed", store.check_seal)
        try:
            load(path)
        except FileError as error:
            refusals += 1
            assert "\n" not in str(error)
    assert refusals > 100
    for content in (whole[1:], whole * 2, whole[:-1], whole + b"\0", whole[:-512], whole[:300]):
        path.write_bytes(content)
        refused(path, "damaged or changed", store.check_seal)
    for part in (0.1, 0.5, 0.9):
        path.write_bytes(whole[: int(part * size)])
        refused(path, "damaged")
