"""HDF5 files read with care: nothing outside the file, and no more than it holds.

HDF5 can point outside itself, can declare far more data than it holds, and the library can crash or
hang on files that are not what they seem. What nobody vouches for is read first by a process of its
own, of bounded memory and time.
"""

import contextlib
import math
import os
import resource
import signal
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np

from pgran.errors import BAD_FILE, DONE, FileError, reason_of
from pgran.store.paths import open_regular
from pgran.store.record import KINDS

MODEST = 64 * 2**20  # bytes that the data of a smaller file may be when they are decompressed
# What a process that tries a file may use, apart from what grows with the file.
MEMORY, SECONDS = 512 * 2**20, 60
# Variables that would make that process take part in this MPI job.
LAUNCHERS = ("OMPI_", "PMIX_", "PMI_", "PRTE_", "HYDRA_", "MPI_LOCAL", "SLURM_")
# Who writes groups that a file of another kind lacks.
WRITERS = {"/lattice": ": runs on lattices write it", "/network": ": pgran pack writes it"}
TROUBLE = (OSError, RuntimeError, KeyError, ValueError, TypeError, OverflowError, MemoryError)


@contextlib.contextmanager
def opened(path):
    """Open an HDF5 file as a `CarefulFile`, every trouble a FileError."""
    open_regular(path, ".h5").close()
    try:
        if not h5py.is_hdf5(path):
            raise FileError(f"{path}: not an HDF5 file")
        with h5py.File(path, "r") as file:
            yield CarefulFile(file, path)
    except TROUBLE as error:
        cut = "cut off before its end" if "truncated" in str(error) else error
        raise FileError(f"{path}: damaged: {cut}") from None


class CarefulFile:
    """An HDF5 file; refuses what is missing, lies elsewhere, is too large or of another type."""

    def __init__(self, file, path):
        self.file, self.path = file, path
        self._left = self._most = max(os.path.getsize(path), MODEST)

    def refuse(self, name, why):
        """Raise a FileError about a member."""
        raise FileError(f"{self.path}: /{name.strip('/')} {why}")

    def _member(self, name, kind):
        """Return a member, found without following a link that leads elsewhere."""
        # step by step: HDF5 itself would follow a link before it can be asked whether it is one
        member, way = self.file, ""
        for part in name.strip("/").split("/") if name != "/" else []:
            way = f"{way}/{part}"
            if not isinstance(member, h5py.Group) or not member.id.links.exists(part.encode()):
                self.refuse(way, f"is missing{WRITERS.get(way, '')}")
            if member.id.links.get_info(part.encode()).type != h5py.h5l.TYPE_HARD:
                self.refuse(way, "is a link; links are not read")
            member = member[part]
        if not isinstance(member, kind):
            self.refuse(name, f"is no {kind.__name__.lower()}")
        return member

    def members(self, group, names):
        """Return which names a group has members of. HDF5 can crash on listing a damaged group."""
        member = self._member(group, h5py.Group)
        return [name for name in names if member.id.links.exists(name.encode())]

    def contents(self, group):
        """Yield of a group's attributes and members name and noun, and whether they are data."""
        member = self._member(group, h5py.Group)
        for name in member.attrs:
            yield name, "attribute", member.attrs.get_id(name).dtype.kind not in "SO"
        for name in member:
            hard = member.id.links.get_info(name.encode()).type == h5py.h5l.TYPE_HARD
            data = hard and isinstance(member[name], h5py.Dataset)
            yield name, "dataset", data and not h5py.h5ds.is_scale(member[name].id)

    def attributes(self, group, names=()):
        """Return a group's texts, numbers and short lists of numbers; some `names` must be such."""
        values = {}
        member = self._member(group, h5py.Group)
        for name in member.attrs:
            declared = member.attrs.get_id(name)
            if declared.dtype.kind in "fiub" or declared.shape == ():
                value = member.attrs[name]
                if isinstance(value, np.bytes_):  # a text of fixed length
                    value = value.decode()
                if isinstance(value, str | np.generic | np.ndarray):
                    values[name] = value.item() if isinstance(value, np.generic) else value
            if name in names and name not in values:
                self.refuse(f"{group}/{name}", "is no text, number or list of numbers")
        return values

    def check_version(self, facts, newest):
        """Raise unless the attributes of the file name a version of its format that is known."""
        version = facts.get("format_version")
        if version not in range(1, newest + 1):
            raise FileError(
                f"{self.path}: format version {version}; this pgran reads 1 to {newest}"
            )

    def array(self, name, dtype):
        """Return a dataset of the file itself, as the type that a record declares."""
        data = self._member(name, h5py.Dataset)
        # Asking for the shape of data that lie elsewhere would open the other file.
        if data.external or data.is_virtual:
            self.refuse(name, "lies in another file; such data are not read")
        texts = data.dtype.kind == "S" and data.ndim == 1
        kinds, called = KINDS[np.dtype(dtype).kind]
        if ("U" if texts else data.dtype.kind) not in kinds:
            self.refuse(name, f"holds no {called}s but {data.dtype}")
        if data.shape is None:
            self.refuse(name, "is empty")
        # a few bytes of compressed zeros can declare terabytes
        self._left -= data.size * data.dtype.itemsize
        if self._left < 0 or math.prod(data.chunks or ()) * data.dtype.itemsize > self._most:
            self.refuse(name, f"of shape {data.shape} declares far more than the file holds")
        if texts:
            return np.char.decode(data[()], "utf-8")
        with np.errstate(over="ignore"):  # a number too large for its type becomes infinite
            return np.asarray(data[()]).astype(dtype, copy=False)


_tried = set()  # what files were that could be read


def try_apart(path, module):
    """Raise a FileError unless a process of its own, which runs a module, can read a file."""
    status = os.stat(path)
    state = module, status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns
    if state in _tried:
        return
    seconds = SECONDS + status.st_size / 2**25
    variables = {k: v for k, v in os.environ.items() if not k.startswith(LAUNCHERS)}
    home = str(Path(__file__).parents[2])
    variables["PYTHONPATH"] = os.pathsep.join(filter(None, [home, os.environ.get("PYTHONPATH")]))
    # -P: a file numpy.py in the present folder stays what it is. A group of its own: mpirun hands
    # the signals that ask a run to stop on to all processes of a rank's.
    words = [sys.executable, "-P", "-m", module, os.fspath(path)]
    # what asks a run to stop, and meets all its processes, says nothing of the file
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGTERM, signal.SIGUSR1))
    try:
        done = subprocess.run(
            words, env=variables, stdin=subprocess.DEVNULL, capture_output=True, timeout=seconds,
            process_group=0,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        raise FileError(f"{path}: damaged: reading it took more than {seconds:.0f} s") from None
    except OSError as error:
        raise FileError(f"{path}: cannot be read apart: {reason_of(error)}") from None
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
    last_words = done.stderr.decode(errors="replace").strip().split("\n")[-1]
    if done.returncode == BAD_FILE:
        raise FileError(last_words)
    if done.returncode:
        crash = signal.Signals(-done.returncode).name if done.returncode < 0 else last_words
        raise FileError(f"{path}: damaged: reading it crashed ({crash})")
    _tried.add(state)


def main(path, read):
    """Let `read` have a file as a `CarefulFile` within limits, and return the exit code."""
    size = os.path.getsize(path)
    for limit, most in (
        (resource.RLIMIT_CORE, 0),
        (resource.RLIMIT_CPU, int(2 * SECONDS + size / 2**25)),  # where nobody is left to end it
        (resource.RLIMIT_AS, MEMORY + 4 * size),
    ):
        with contextlib.suppress(ValueError, OSError):  # a limit that is lower already
            resource.setrlimit(limit, (most, most))
    try:
        with opened(path) as file:
            read(file)
    except FileError as error:
        print(error, file=sys.stderr)
        return BAD_FILE
    return DONE
