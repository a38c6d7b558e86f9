"""Bonds from HDF5 files of any origin: what is refused, and that no file does harm."""

import os
import signal
import subprocess
import sys
import zlib

import h5py
import numpy as np
import pytest
from mpi4py import MPI

from pgran.errors import FileError
from pgran.files import hdf5 as foreign
from pgran.files.store import read_stiffness

serial = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="starts programs: serial run only")


@pytest.fixture
def path(tmp_path):
    """A file name; each rank has its own folder."""
    return tmp_path / "k.h5"


def write(path, **members):
    """Write members of /lattice, arrays or what h5py makes of them."""
    with h5py.File(path, "w") as file:
        group = file.create_group("lattice")
        for name, value in members.items():
            group[name] = value
    return path


def read_here(path):
    """Read bonds in this process, which is quicker; `read_stiffness` starts one of its own."""
    with foreign.opened(path) as file:
        return foreign.bonds(file)


def refusal(path, member=None, read=read_here):
    """Return the one line that a file is refused with; it names the file and the member."""
    with pytest.raises(FileError) as caught:
        read(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert member is None or f" /lattice/{member} " in message
    assert len(message.splitlines()) == 1
    return message


def good(shape=(2, 3)):
    """Arrays that fit a lattice, every number another."""
    rng = np.random.default_rng(1)
    names = ("stiffness_x", "stiffness_y", "stiffness_z")[: len(shape)]
    sizes = [tuple(n + (a == b) for b, n in enumerate(shape)) for a in range(len(shape))]
    return {name: rng.random(size) for name, size in zip(names, sizes, strict=True)}


@pytest.mark.parametrize("shape", [(1,), (7,), (2, 3), (1, 1), (2, 3, 4)])
def test_bonds_come_back_bit_for_bit(path, shape):
    write(path, **good(shape))
    found, kmax = read_here(path)
    assert kmax is None
    for k, expected in zip(found, good(shape).values(), strict=True):
        assert k.dtype == float
        assert np.array_equal(k, expected)


def test_bonds_and_unit_come_back_through_the_pipe(path):
    write(path, **good((2, 3, 4)))
    with h5py.File(path, "a") as file:
        file["lattice"].attrs.update(mass=2.0, omega_mx=3.0)
    found, kmax = read_stiffness(path)
    assert kmax == 3.0
    assert all(map(np.array_equal, found, good((2, 3, 4)).values()))


@pytest.mark.parametrize("kind", ["f2", "f4", ">f8", "i2", "u8", np.longdouble])
def test_real_numbers_of_any_kind_become_doubles(path, kind):
    arrays = {name: (10 * k).astype(kind) for name, k in good().items()}
    found, _ = read_here(write(path, **arrays))
    for k, expected in zip(found, arrays.values(), strict=True):
        assert k.dtype == float
        assert np.array_equal(k, expected.astype(float))


def test_compressed_and_chunked_bonds_are_read(path):
    arrays = good((30, 40))
    with h5py.File(path, "w") as file:
        for name, k in arrays.items():
            file.create_dataset(f"lattice/{name}", data=k, compression="gzip", shuffle=True)
    assert all(map(np.array_equal, read_stiffness(path)[0], arrays.values()))


@pytest.mark.parametrize(
    ("attributes", "expected"),
    [
        ({"mass": 2.0, "omega_mx": 3.0}, 2 * 9 / 4),
        ({"mass": 2, "omega_mx": np.float32(3)}, 2 * 9 / 4),
        ({"mass": 1e300, "omega_mx": 1e300}, None),
        ({"mass": -1.0, "omega_mx": 1.0}, None),
        ({"mass": "1", "omega_mx": 1.0}, None),
        ({"mass": [1.0, 1.0], "omega_mx": 1.0}, None),
        ({"mass": 1.0}, None),
    ],
)
def test_unit_of_frequency(path, attributes, expected):
    """kmax = m omega_mx^2 / (2 d)."""
    write(path, **good())
    with h5py.File(path, "a") as file:
        file["lattice"].attrs.update(attributes)
    assert read_here(path)[1] == expected


# Values, types and shapes


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, -0.25, -1e-300])
def test_impossible_constants(path, value):
    arrays = good()
    arrays["stiffness_y"][1, 2] = value
    message = refusal(write(path, **arrays), "stiffness_y")
    assert "(1, 2)" in message
    assert str(value) in message


def test_numbers_beyond_doubles(path):
    if np.finfo(np.longdouble).max > np.finfo(float).max:
        arrays = good() | {"stiffness_x": np.full((3, 3), 1e308, np.longdouble) * 100}
        assert "inf" in refusal(write(path, **arrays), "stiffness_x")


RECORD = [("a", float), ("b", int)]


@pytest.mark.parametrize(
    "kind",
    ["S4", complex, bool, RECORD, h5py.ref_dtype, h5py.string_dtype(), h5py.vlen_dtype(float),
     "V2", h5py.opaque_dtype(np.dtype("M8[s]"))],
)  # fmt: skip
def test_other_types(path, kind):
    """Texts, complex numbers, flags, records, references, ragged rows, raw bytes, dates."""
    write(path, **good())
    with h5py.File(path, "a") as file:
        del file["lattice/stiffness_x"]
        file.create_dataset("lattice/stiffness_x", (3, 3), kind)
    assert "numbers" in refusal(path, "stiffness_x")


def test_a_text_and_nothing_at_all(path):
    assert "numbers" in refusal(write(path, stiffness_x="text"), "stiffness_x")
    assert "empty" in refusal(write(path, stiffness_x=h5py.Empty(float)), "stiffness_x")


@pytest.mark.parametrize(
    "shape", [(), (0,), (1,), (0, 3), (3, 0), (1, 3), (2, 3), (3, 2), (3, 3, 1), (3, 3, 3, 3)]
)
def test_shapes_that_fit_no_lattice(path, shape):
    arrays = good() | {"stiffness_x": np.ones(shape)}
    assert "fits no lattice" in refusal(write(path, **arrays))
    assert "fits no lattice" in refusal(write(path, stiffness_x=np.ones((*shape, 2, 2, 2))))


def test_missing_members(path):
    with h5py.File(path, "w"):
        pass
    assert "/lattice is missing" in refusal(path)
    assert "/lattice needs stiffness_x" in refusal(write(path))
    three = good((2, 3, 4))
    for gap in ("stiffness_x", "stiffness_y"):
        members = {name: k for name, k in three.items() if name != gap}
        assert "without a gap" in refusal(write(path, **members))
    with h5py.File(path, "w") as file:
        file["lattice"] = np.ones(3)
    assert "/lattice is no group" in refusal(path)
    write(path).unlink()
    with h5py.File(path, "w") as file:
        file.create_group("lattice/stiffness_x")
    assert "is no dataset" in refusal(path, "stiffness_x")


def test_group_that_holds_itself(path):
    write(path, **good())
    with h5py.File(path, "a") as file:
        file["lattice/again"] = file["lattice"]
        file["lattice/stiffness_z"] = file["lattice"]
    assert "is no dataset" in refusal(path, "stiffness_z")


# Files that point outside themselves


def test_links(path):
    other = write(path.with_name("other.h5"), **good())
    for link in (
        h5py.SoftLink("/lattice/stiffness_y"),
        h5py.SoftLink("/nowhere"),
        h5py.ExternalLink(other.name, "/lattice/stiffness_x"),
        h5py.ExternalLink("missing.h5", "/"),
    ):
        message = refusal(write(path, **good() | {"stiffness_x": link}), "stiffness_x")
        assert "links are not read" in message
        with h5py.File(path, "w") as file:
            file["lattice"] = link
        assert "/lattice is a link" in refusal(path)


@serial
def test_an_external_link_is_not_even_opened(path):
    """A pipe would hang whoever opens it."""
    os.mkfifo(path.with_name("pipe"))
    write(path, **good() | {"stiffness_x": h5py.ExternalLink("pipe", "/")})
    refusal(path, "stiffness_x", read_stiffness)


def test_external_storage(path):
    secret = path.with_name("secret")
    secret.write_bytes(bytes(72))
    with h5py.File(path, "w") as file:
        external = [(str(secret), 0, 72)]
        file.create_dataset("lattice/stiffness_x", (3, 3), float, external=external)
    assert "another file" in refusal(path, "stiffness_x")


@pytest.mark.parametrize("rows", [3, None])
def test_virtual_datasets(path, rows):
    """Of a fixed number of rows, and of as many as the source has."""
    other = write(path.with_name("other.h5"), **good())
    layout = h5py.VirtualLayout((3, 3), float, maxshape=(rows, 3))
    source = h5py.VirtualSource(other, "lattice/stiffness_x", (3, 3), maxshape=(rows, 3))
    if rows:
        layout[...] = source
    else:
        layout[: h5py.h5s.UNLIMITED, :] = source[: h5py.h5s.UNLIMITED, :]
    with h5py.File(path, "w") as file:
        file.create_virtual_dataset("lattice/stiffness_x", layout)
    assert "another file" in refusal(path, "stiffness_x")


# Files that hold less than they say, or break the library


@pytest.mark.parametrize("how", [{"chunks": (1000, 1000)}, {"compression": "gzip"}, {}])
def test_more_declared_than_stored(path, how):
    """80 GB in a few kB."""
    with h5py.File(path, "w") as file:
        for axis in range(2):
            shape = [100_000 + (a == axis) for a in range(2)]
            file.create_dataset(f"lattice/stiffness_{'xy'[axis]}", shape, float, **how)
    assert path.stat().st_size < 100_000
    assert "far more than the file holds" in refusal(path, "stiffness_x")


def zeros_deflated(megabytes):
    """A valid zlib stream of zeros, without the work of compressing them."""
    press = zlib.compressobj(9, wbits=-15)
    block = press.compress(bytes(2**20)) + press.flush(zlib.Z_FULL_FLUSH)
    adler = ((megabytes * 2**20 % 65521) << 16) | 1
    return b"\x78\x9c" + megabytes * block + press.flush() + adler.to_bytes(4, "big")


@serial
def test_a_chunk_that_becomes_too_large(path):
    """8 MB of bonds in a single gzip chunk of 1 GB, which has to be decompressed whole."""
    with h5py.File(path, "w") as file:
        shape, chunk = (1_000_000,), (2**27,)
        data = file.create_dataset(
            "lattice/stiffness_x", shape, float, chunks=chunk, maxshape=(None,), compression=1
        )
        data.id.write_direct_chunk((0,), zeros_deflated(1024))
    assert path.stat().st_size < 3_000_000
    assert "damaged" in refusal(path, read=read_stiffness)


def test_links_to_one_dataset_do_not_add_up(path):
    """Each is small enough, all together are not."""
    write(path)
    with h5py.File(path, "a") as file:
        for name, shape in (("x", (181, 180, 180)), ("y", (180, 181, 180)), ("z", (180, 180, 181))):
            data = {"shape": shape, "dtype": float, "compression": "gzip"}
            file.create_dataset(f"lattice/stiffness_{name}", **data)
    assert "far more" in refusal(path, "stiffness_y")


@serial
@pytest.mark.parametrize("signum", [signal.SIGSEGV, signal.SIGKILL, signal.SIGABRT])
def test_a_crash_of_the_reader(path, monkeypatch, signum):
    """A program in the reader's place that dies as libhdf5 does on a bad file."""
    reader = path.with_name("reader")
    reader.write_text(f"#!/bin/sh\nulimit -c 0\nkill -{int(signum)} $$\n")
    reader.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(reader))
    assert f"crashed ({signum.name})" in refusal(write(path, **good()), read=read_stiffness)


@serial
@pytest.mark.parametrize(
    ("program", "said"),
    [("sleep 60", "took more than"), ("echo words >&2; exit 1", "crashed (words)")],
)
def test_a_reader_that_hangs_or_fails(path, monkeypatch, program, said):
    reader = path.with_name("reader")
    reader.write_text(f"#!/bin/sh\nexec 3>&-\n{program}\n".replace("sleep", "exec sleep"))
    reader.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(reader))
    monkeypatch.setattr(foreign, "SECONDS", 0.2)
    assert said in refusal(write(path, **good()), read=read_stiffness)


def test_no_reader_at_all(path, monkeypatch):
    monkeypatch.setattr(sys, "executable", str(path.with_name("none")))
    assert "cannot be read apart" in refusal(write(path, **good()), read=read_stiffness)


@serial
def test_the_reader_is_limited_and_knows_nothing_of_mpi(path, monkeypatch):
    monkeypatch.setenv("OMPI_COMM_WORLD_SIZE", "7")
    monkeypatch.setenv("PMIX_RANK", "3")
    (path.parent / "numpy.py").write_text("raise SystemExit('taken from the present folder')")
    monkeypatch.chdir(path.parent)
    program = path.with_name("program.py")
    program.write_text(
        "import os, resource as r, sys, pgran.files.hdf5\n"
        "from pathlib import Path\n"
        "pgran.files.hdf5.bonds = lambda file: sys.exit(' '.join(map(str, [\n"
        "    r.getrlimit(r.RLIMIT_CORE)[0], r.getrlimit(r.RLIMIT_AS)[0] < 10**9,\n"
        "    r.getrlimit(r.RLIMIT_CPU)[0] < 1000, 'mpi4py' in sys.modules,\n"
        "    [k for k in os.environ if k.startswith(('OMPI', 'PMI'))]])))\n"
        "pgran.files.hdf5.main(sys.argv[1])\n"
    )
    run = subprocess.run

    def start(words, **more):
        assert words[1:4] == ["-P", "-m", "pgran.files.hdf5"]
        return run([words[0], "-P", str(program), words[4]], **more)

    monkeypatch.setattr(subprocess, "run", start)
    assert "crashed (0 True True False [])" in refusal(write(path, **good()), read=read_stiffness)


def test_messages_are_one_short_line():
    """Whatever a file's names hold, a terminal has nothing to obey."""
    message = str(FileError("k.h5: /lattice/\x1b[2J\r\n\u2028é\udc80" + 10**6 * "x" + "end"))
    assert message.startswith("k.h5: /lattice/?[2J???é?")
    assert message.endswith("end")
    assert len(message) < 1100
