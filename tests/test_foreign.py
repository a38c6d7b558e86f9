"""HDF5 files of any origin: bonds are read or refused, and no file does harm."""

import os
import subprocess
import sys
import zlib

import h5py
import numpy as np
import pytest
from campaigns import fuzz
from samples import bond_arrays, random_lattice

from pgran import load
from pgran.errors import FileError
from pgran.medium.bonds_file import read_bonds
from pgran.medium.record import LatticeRecord
from pgran.store import file as store

NAMES = ("stiffness_x", "stiffness_y", "stiffness_z")


@pytest.fixture
def path(tmp_path):
    """A file name; each rank has its own folder."""
    return tmp_path / "k.h5"


def write(path, **members):
    """Write arrays into /lattice."""
    with h5py.File(path, "w") as file:
        for name, value in members.items():
            file[f"lattice/{name}"] = value
    return path


def good(shape=(2, 3)):
    """Arrays that fit a lattice, every number another."""
    return dict(zip(NAMES, bond_arrays(shape, np.random.default_rng(1).random), strict=False))


def refusal(path, member=None, read=read_bonds):
    """Return the one line that a file is refused with; it names the file and the member."""
    with pytest.raises(FileError) as caught:
        read(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert member is None or f" /lattice/{member}" in message
    assert len(message.splitlines()) == 1
    return message


def test_bonds_of_a_result_that_was_touched(path):
    """Damaged it is refused; without a seal another process tries it."""
    lattice = random_lattice((30, 40))
    store.write(path, {}, [LatticeRecord.of(lattice)])
    content = path.read_bytes()
    path.write_bytes(content[:-1000] + b"?" + content[-999:])
    assert "damaged or changed" in refusal(path)
    path.write_bytes(content)
    with h5py.File(path, "r+") as file:
        file["lattice"].attrs["mass"] = "mine"
        del file["lattice/stiffness_x"]
        file["lattice"].create_dataset("stiffness_x", data=lattice.stiffness[0], compression="gzip")
    found, kmax = read_bonds(path)
    assert kmax is None
    assert all(map(np.array_equal, found, lattice.stiffness))


def test_real_numbers_of_any_kind_become_doubles(path, here):
    for kind in ("f2", ">f8", "u8", np.longdouble):
        arrays = {name: (10 * k).astype(kind) for name, k in good((2, 3, 4)).items()}
        found, _ = read_bonds(write(path, **arrays))
        for k, expected in zip(found, arrays.values(), strict=True):
            assert k.dtype == float
            assert np.array_equal(k, expected.astype(float))


def test_unit_of_frequency(path, here):
    """kmax = m omega_mx^2 / (2 d)."""
    for mass, omega_mx, kmax in (
        (2, np.float32(3), 4.5), (1e300, 1e300, None), ("1", 1.0, None), ([1.0, 1.0], 1.0, None),
    ):  # fmt: skip
        write(path, **good())
        with h5py.File(path, "a") as file:
            file["lattice"].attrs.update({"mass": mass, "omega_mx": omega_mx})
        assert read_bonds(path)[1] == kmax


# What makes no lattice, lies elsewhere, or is less than it says


@pytest.mark.parametrize("of_result", [False, True])
@pytest.mark.parametrize(("placed", "said"), [case for case in fuzz.PLACED if case[1]])
def test_what_makes_no_bonds(path, here, placed, said, of_result):
    """Neither as bonds nor as a result: other values, shapes and types, links, other files."""
    if of_result:
        store.write(path, {}, [LatticeRecord.of(random_lattice(fuzz.SHAPE))])
    else:
        write(path, **good(fuzz.SHAPE))
    with h5py.File(path, "r+") as file:
        fuzz.place(file["lattice"], placed)
    assert said in refusal(path)
    if not (of_result and "bond constant" in said):  # which only bonds must be finite
        refusal(path, read=load)


def test_missing_members(path, here):
    for member, said in (
        ("lattice/x", "/lattice needs stiffness_x"), ("lattice", "/lattice is no group"),
        ("x", "/lattice is missing"), ("lattice/stiffness_z", "/lattice needs stiffness_x"),
        ("lattice/stiffness_x/x", "/lattice/stiffness_x is no dataset"),
    ):  # fmt: skip
        with h5py.File(path, "w") as file:
            file[member] = np.ones(3)
        assert said in refusal(path)


def test_a_group_that_lies_in_another_file(path, here):
    """Opening the pipe would hang."""
    os.mkfifo(path.with_name("pipe"))
    store.write(path, {}, [LatticeRecord.of(random_lattice((2, 3)))])
    with h5py.File(path, "r+") as file:
        del file["lattice"]
        file["lattice"] = h5py.ExternalLink("pipe", "/")
    for read in (read_bonds, load):
        assert "links are not read" in refusal(path, read=read)


def test_data_add_up(path, here):
    """Each is small enough, all together are not."""
    with h5py.File(path, "w") as file:
        for axis, name in enumerate(NAMES):
            shape = [180 + (a == axis) for a in range(3)]
            file.create_dataset(f"lattice/{name}", shape, float, compression="gzip")
    assert "far more" in refusal(path, "stiffness_y")


def test_a_chunk_that_becomes_too_large(path):
    """8 MB of bonds in a single gzip chunk of 1 GB, which would be decompressed whole."""
    press = zlib.compressobj(9, wbits=-15)
    block = press.compress(bytes(2**20)) + press.flush(zlib.Z_FULL_FLUSH)
    checksum = ((2**30 % 65521) << 16) | 1
    zeros = b"\x78\x9c" + 1024 * block + press.flush() + checksum.to_bytes(4, "big")
    with h5py.File(path, "w") as file:
        data = file.create_dataset(
            "lattice/stiffness_x", 10**6, float, chunks=2**27, maxshape=(None,), compression=1
        )
        data.id.write_direct_chunk((0,), zeros)
    assert path.stat().st_size < 3_000_000
    assert "far more" in refusal(path)


# What the library may die of happens to another process


@pytest.mark.parametrize(
    ("program", "said"),
    [
        ("ulimit -c 0; kill -11 $$", "crashed (SIGSEGV)"),
        ("exec sleep 60", "took more than"),
        ('echo "$OMPI_X$PMIX_RANK$*" >&2; exit 1', "crashed (-P -m pgran.medium.bonds_file "),
        (None, "cannot be read apart"),
    ],
)
def test_a_process_that_fails(path, monkeypatch, program, said):
    """In its place a program, kept from MPI, that dies as HDF5 can, hangs, or is not there."""
    monkeypatch.setenv("OMPI_X", "7")
    monkeypatch.setenv("PMIX_RANK", "3")
    reader = path.with_name("reader")
    if program:
        reader.write_text(f"#!/bin/sh\nexec 3>&-\n{program}\n")
        reader.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(reader))
    monkeypatch.setattr(store, "SECONDS", 0.2)
    assert said in refusal(write(path, **good()))


def test_limits_of_the_process(path):
    write(path, **good())
    program = (
        "import resource as r, sys; from pgran.medium.bonds_file import bonds, store;"
        "store.read_within_limits(sys.argv[1], bonds);"
        "print([r.getrlimit(n)[0] for n in (r.RLIMIT_CORE, r.RLIMIT_CPU, r.RLIMIT_AS)],"
        "'mpi4py' in sys.modules)"
    )
    words = [sys.executable, "-c", program, str(path)]
    said = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    assert said == f"{[0, 120, 2**29 + 4 * path.stat().st_size]} False\n"
