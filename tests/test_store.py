"""Results on disk: everything comes back, others can read it, and damage does no harm."""

import contextlib
import dataclasses
import hashlib
import os
import pickle
import subprocess
from pathlib import Path

import h5py
import numpy as np
import pytest
from result_samples import ATTRIBUTES, KINDS, change, make, stored
from samples import assert_same, random_lattice

from pgran import __main__ as command_line
from pgran import load, results
from pgran.errors import DONE, FileError, PgranError
from pgran.medium.bonds_file import read_bonds
from pgran.store import file as store
from pgran.store.file import FORMAT_VERSION
from pgran.store.paths import check_seal
from pgran.store.record import Result

VERSION_1 = Path(__file__).with_name("version1.h5")


@pytest.fixture
def path(tmp_path):
    """A result with a record of every kind; each rank has its own folder."""
    return stored(tmp_path / "a.h5")


@pytest.mark.parametrize(
    ("shape", "without"),
    [((7,), ()), ((4, 5), ("field", "vector", "models")), ((2, 3, 4), ()), ((1, 1), ())],
)
def test_everything_comes_back(tmp_path, shape, without):
    """Field by field, types and parts included; bonds as a lattice takes them."""
    written = [make(kind, shape, without) for kind in KINDS]
    path = tmp_path / "a.h5"
    store.write(path, ATTRIBUTES, written)
    result = load(path)
    for record in written:
        assert_same(getattr(result, record.group), record, but=())
    for name, value in (ATTRIBUTES | {"format": "pgran", "format_version": FORMAT_VERSION}).items():
        assert (getattr(result, name), type(getattr(result, name))) == (value, type(value))
    stiffness, kmax = read_bonds(path)
    assert kmax == pytest.approx(0.25)
    for arrays in (stiffness, result.lattice.stiffness):
        assert len(arrays) == len(shape)
        assert all(map(np.array_equal, arrays, random_lattice(shape).stiffness))


def test_xarray_reads_what_records_become(path, tmp_path):
    """The same variables, coordinates and attributes from the file and from the record."""
    pytest.importorskip("h5netcdf")
    xarray = pytest.importorskip("xarray")
    for group, record in load(path).records.items():
        made, alone = record.to_xarray(), tmp_path / f"{group}.h5"
        store.write(alone, ATTRIBUTES, [record])
        with xarray.open_dataset(alone, engine="h5netcdf", group=group) as found:
            for name, variable in made.variables.items():
                read, kind = found[name].values, variable.dtype.kind
                if kind == "U":
                    read = np.char.decode(read.astype(bytes), "utf-8")
                assert np.array_equal(read, variable.values, equal_nan=kind in "fc"), name
                assert found[name].dims == variable.dims
                assert found[name].attrs["units"] == variable.attrs["units"]
            assert set(made.coords) <= set(found.coords)
            for name in set(made.attrs) - {"bonds_sha256"}:  # which belongs to the whole file
                nan = isinstance(made.attrs[name], np.ndarray)
                assert np.array_equal(found.attrs[name], made.attrs[name], equal_nan=nan)
    with xarray.open_dataset(path, engine="h5netcdf") as found:
        assert found.attrs["options"] == ATTRIBUTES["options"]
    assert load(path).response.to_xarray().field.dims == ("omega", "x", "y")


def test_every_axis_has_one_coordinate_of_its_length(path):
    """By HDF5's own dimension scales, each within the group or above it."""
    seen = []

    def check(name, data):
        if isinstance(data, h5py.Dataset):
            for length, dimension in zip(data.shape, data.dims, strict=True):
                if not h5py.h5ds.is_scale(data.id):
                    (scale,) = dimension.values()
                    assert h5py.h5ds.is_scale(scale.id), name
                    assert scale.shape == (length,), name
                    seen.append(name)
            assert data.attrs["units"], name
            assert data.attrs["long_name"], name

    with h5py.File(path) as file:
        file.visititems(check)
    assert len(seen) > 100


@pytest.mark.parametrize("mask", [0o022, 0o077])
def test_who_may_read_it_is_for_the_users_mask_to_say(tmp_path, mask):
    before = os.umask(mask)
    try:
        store.write(tmp_path / "a.h5", ATTRIBUTES, [make(KINDS[0])])
    finally:
        os.umask(before)
    assert (tmp_path / "a.h5").stat().st_mode & 0o777 == 0o666 & ~mask


def test_a_result_by_name():
    lattice, modes = make(results.LatticeRecord), make(results.Modes)
    result = Result([lattice, modes], scene="modes")
    assert (result.scene, result.modes) == ("modes", modes)
    assert {"lattice", "scene"} <= set(dir(result))
    assert getattr(result, "spectrum", None) is None
    with pytest.raises(FileError, match="holds no spectrum; its groups are: lattice, modes"):
        _ = result.spectrum
    assert pickle.loads(pickle.dumps(result)).scene == "modes"
    assert repr(result) == "Result(scene='modes', status=None, lattice, modes)"
    assert repr(modes).startswith("Modes(count_expected=7, count_certified=True, ")
    assert "vector: float64 (4, 4, 5)" in repr(modes)


# Changed and damaged files; tests/test_foreign.py has those that point elsewhere


def refused(path, match, read=load):
    with pytest.raises(FileError, match=match) as caught:
        read(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_and_other_files(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    h5py.File(tmp_path / "foreign", "w").close()
    for path, said in (
        (tmp_path / "none.h5", "No such file"),
        (tmp_path, "directory"),
        (tmp_path / "pipe", "pipe"),
        (Path(__file__), "not an HDF5 file"),
        (tmp_path / "foreign", "neither a result of pgran nor a network"),
    ):
        refused(path, said)


@pytest.mark.parametrize(
    ("name", "value", "match"),
    [
        ("/@format_version", FORMAT_VERSION + 1, f"this pgran reads 1 to {FORMAT_VERSION}"),
        ("/@format", "other", "neither a result"),
        ("modes/omega", None, "/modes/omega is missing"),
        ("modes@count_expected", None, "/modes/count_expected is missing"),
        ("modes/omega", np.ones((4, 1)), r"/modes/omega: shape \(4, 1\) is not \(omega: 4\)"),
        ("modes/vector", np.ones((4, 4, 6)), r"/modes/vector: .* \(omega: 4, x: 4, y: 5\)"),
        ("response@phase_slope", np.ones(9), r"\(detector_number: 9\)"),
        ("response/displacement", np.ones((4, 5)), "displacement holds no complex numbers"),
        ("response/models/own", None, "/response/models/own is missing"),
        ("response/models/low", np.ones((2, 2)), r"/response/models/low: .* \(interval: 2\)"),
        ("response/models@mass", "1", "/response/models/mass: '1' is not a single real number"),
        ("response/iterations", np.ones(4), "iterations holds no integers but float64"),
        ("modes@count_expected", 1.5, "count_expected: 1.5 is not a single integer"),
        ("modes@count_certified", "yes", "count_certified: 'yes' is not a single truth value"),
        ("lattice@shape", (5, 4), r"stiffness_x: .* \(bond_x: 6, y: 4\)"),
        ("lattice@shape", (4, 5, 6), "shape: .* does not fit 2 arrays stiffness"),
        ("lattice@shape", (-1, 5), "shape: .* does not fit 2 arrays stiffness"),
        ("lattice/stiffness_y", None, "shape: .* does not fit 1 arrays stiffness"),
    ],
)
def test_what_does_not_fit_its_declaration(path, name, value, match):
    refused(change(path, name, value), match)


def test_what_users_add_does_no_harm(path):
    """Attributes, groups and datasets of their own; integers as frequencies."""
    for name in ("/@records", "modes/omega", "modes/own", "own/data"):
        change(path, name, np.arange(4))
    result = load(change(path))
    assert (result.note, len(result.attributes["records"])) == ("mine", 4)
    assert result.modes.omega.dtype == float
    assert not hasattr(result, "own")


def test_files_of_version_1_are_read():
    """Its seal comes first, and some arrays came later."""
    result = load(VERSION_1)
    assert (result.format_version, result.pgran_version) == (1, "0.1.0")
    assert result.response.at_floor is None
    assert result.lattice.shape == (3, 2)
    stiffness, kmax = read_bonds(VERSION_1)
    assert np.array_equal(stiffness[0], result.lattice.stiffness_x)
    assert kmax == pytest.approx(0.25)
    check_seal(VERSION_1)


NEW = {  # in the version after
    2: {"method", "phase_slope_error", "derivative", "line_error"},
    3: {"force", "force_bound", "power"},
    4: {"modelled"},
}


@pytest.mark.parametrize("version", NEW)
def test_older_responses_are_read(path, version):
    """As they were then; what came later is None."""
    written = load(path).response
    fields = dataclasses.fields(written)
    new = [f.name for f in fields if f.metadata.get("since", 1) > version or "part" in f.metadata]
    assert set(new) >= {"models"}.union(*(NEW[since] for since in NEW if since >= version))
    for name in new:
        plain = "axes" not in next(f for f in fields if f.name == name).metadata
        change(path, f"response@{name}" if plain and name != "models" else f"response/{name}", None)
    found = load(change(path, "/@format_version", version)).response
    assert_same(found, dataclasses.replace(written, **dict.fromkeys(new)))
    if version < 4:
        assert found.dynamic_mass is None
    with pytest.raises(PgranError, match="holds no models"):
        found.at([0.5])


def test_verify(path, capsys, monkeypatch):
    """The seal is the checksum of all before; with it no other process reads the bonds."""
    words = ["verify", str(path)]
    assert command_line.main(words) == DONE
    assert capsys.readouterr().out == f"{path}: as it was written\n"
    content, seal = path.read_bytes()[:-512], path.read_bytes()[-512:]
    digest = hashlib.sha256(content).hexdigest()
    assert seal.rstrip(b"\0") == f"pgran result 2\nsha256 {digest}\n".encode()
    with monkeypatch.context() as patch:
        patch.setattr(subprocess, "run", None)
        read_bonds(path)
    refused(change(path), "changed since .no seal.", lambda path: command_line.main(words))


def test_every_changed_byte_is_found_and_none_does_harm(tmp_path):
    """One bit anywhere, bytes more or less: `load` reads what only lost its seal."""
    path = tmp_path / "a.h5"
    kinds = results.LatticeRecord, results.Response
    store.write(path, ATTRIBUTES, [make(kind, (1, 1)) for kind in kinds])
    whole = path.read_bytes()
    rng, size = np.random.default_rng(3), len(whole)
    for place in [*range(0, 600, 11), *range(size - 600, size, 11), *rng.integers(0, size, 150)]:
        changed = bytearray(whole)
        changed[place] ^= 1 << rng.integers(8)
        path.write_bytes(changed)
        refused(path, "damaged or changed", check_seal)
        with contextlib.suppress(FileError):
            assert load(path).response.omega.size
            assert place >= size - 512
    for content in (whole[1:], whole[:-1], whole + b"\0", whole[:300], VERSION_1.read_bytes()[:-1]):
        path.write_bytes(content)
        refused(path, "damaged or changed", check_seal)
    path.write_bytes(whole[: size // 2])
    refused(path, "damaged")
