"""HDF5 files read with care: nothing outside the file, and no more than it holds.

HDF5 can point outside itself, can declare far more data than it holds, and the library can crash or
hang on files that are not what they seem. Files that are not pgran's own are read by a process of
their own, of bounded memory and time: `python -m pgran.files.hdf5 FILE`, which writes the bonds to
its standard output as NumPy arrays.
"""

import contextlib
import io
import os
import resource
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np

from pgran.errors import BAD_FILE, DONE, FileError, reason_of
from pgran.files.paths import open_regular
from pgran.machine import total_memory
from pgran.physics.lattice import AXES, bond_shape

FORMAT = "pgran"  # what results say they are
MODEST = 64 * 2**20  # bytes that the data of a smaller file may be when they are decompressed
# What a process that reads a file may use, apart from what grows with the file.
MEMORY, SECONDS = 512 * 2**20, 60
# Variables that would make the reading process take part in this MPI job.
LAUNCHERS = ("OMPI_", "PMIX_", "PMI_", "PRTE_", "HYDRA_", "MPI_LOCAL", "SLURM_")
TROUBLE = (OSError, RuntimeError, KeyError, ValueError, TypeError, OverflowError, MemoryError)


@contextlib.contextmanager
def opened(path):
    """Open an HDF5 file as a `CarefulFile`, every trouble a FileError. Not collective."""
    open_regular(path).close()
    try:
        if not h5py.is_hdf5(path):
            raise FileError(f"{path}: not an HDF5 file")
        with h5py.File(path, "r") as file:
            yield CarefulFile(file, path)
    except TROUBLE as error:
        raise FileError(f"{path}: damaged: {error}") from None


class CarefulFile:
    """An HDF5 file from which only what lies in it is read, and no more than it holds.

    Parameters
    ----------
    file : h5py.File
    path : str or os.PathLike
        For messages.

    Raises
    ------
    FileError
        By every method, for what is missing, lies elsewhere or is too large.
    """

    def __init__(self, file, path):
        """Keep the file."""
        self.file, self.path = file, path
        self._left = max(os.path.getsize(path), MODEST)

    def refuse(self, name, why):
        """Raise a FileError about a member."""
        raise FileError(f"{self.path}: /{name.strip('/')} {why}")

    def _member(self, name, kind):
        """Return a member, found without following a link that leads elsewhere."""
        member, way = self.file, ""
        for part in name.strip("/").split("/") if name != "/" else []:
            way = f"{way}/{part}"
            if not isinstance(member, h5py.Group) or not member.id.links.exists(part.encode()):
                self.refuse(way, "is missing")
            if member.id.links.get_info(part.encode()).type != h5py.h5l.TYPE_HARD:
                self.refuse(way, "is a link; links are not read")
            member = member[part]
        if not isinstance(member, kind):
            self.refuse(name, f"is no {kind.__name__.lower()}")
        return member

    def names(self, group):
        """Return the names of a group's members."""
        return list(self._member(group, h5py.Group))

    def attributes(self, group):
        """Return a group's attributes that are texts, numbers or short lists of numbers."""
        found = {}
        member = self._member(group, h5py.Group)
        for name in member.attrs:
            declared = member.attrs.get_id(name)
            if declared.dtype.kind in "fiub" or declared.shape == ():
                value = member.attrs[name]
                if isinstance(value, str | np.generic | np.ndarray):
                    found[name] = value
        return found

    def dataset(self, name):
        """Return a dataset of the file itself, of numbers or a list of texts, not yet read."""
        data = self._member(name, h5py.Dataset)
        # Asking for the shape of data that lie elsewhere would open the other file.
        if data.external or data.is_virtual:
            self.refuse(name, "lies in another file; such data are not read")
        texts = data.dtype.kind == "S" and data.ndim == 1
        if data.dtype.kind not in "fiucb" and not texts:
            self.refuse(name, f"holds no numbers but {data.dtype}")
        if data.shape is None:
            self.refuse(name, "is empty")
        return data

    def array(self, name):
        """Return a dataset's values."""
        data = self.dataset(name)
        declared = data.size * data.dtype.itemsize
        self._left -= declared
        if self._left < 0:
            self.refuse(name, f"declares {declared} bytes, far more than the file holds")
        if data.dtype.kind == "S":
            return np.char.decode(data[()], "utf-8")
        truth = data.dtype == np.int8 and data.attrs.get("dtype") == "bool"
        return data[()].astype(bool) if truth else data[()]


def bonds(file):
    """Return the bond constants in `/lattice`, checked, and the stiffness that sets their unit.

    Not collective.

    Parameters
    ----------
    file : CarefulFile

    Returns
    -------
    stiffness : tuple of numpy.ndarray
        As `pgran.physics.lattice.Lattice` takes them.
    kmax : float or None
        What the unit of frequency belongs to, if the file says.
    """
    names = [f"stiffness_{axis}" for axis in AXES]
    there = [name for name in names if name in file.names("lattice")]
    if not there or there != names[: len(there)]:
        file.refuse("lattice", "needs stiffness_x, and _y, _z without a gap")
    members = {f"lattice/{name}": file.dataset(f"lattice/{name}") for name in there}
    shape = next(iter(members.values())).shape
    shape = tuple(n - (axis == 0) for axis, n in enumerate(shape))
    for axis, (name, data) in enumerate(members.items()):
        fits = data.ndim == len(members) and min(shape) > 0
        if not fits or data.shape != bond_shape(shape, axis):
            file.refuse(
                name,
                f"has shape {data.shape}, which fits no lattice with {len(members)} stiffness_*",
            )
        if data.dtype.kind not in "fiu":
            file.refuse(name, f"holds no real numbers but {data.dtype}")
    stiffness = []
    for name in members:
        with np.errstate(all="ignore"):  # what overflows is refused below
            k = file.array(name).astype(float, copy=False)
        impossible = ~(np.isfinite(k) & (k >= 0))
        if impossible.any():
            place = np.unravel_index(np.argmax(impossible), k.shape)
            file.refuse(
                name,
                f"holds {k[place]} at {tuple(map(int, place))}; "
                "a bond constant is finite and not negative",
            )
        stiffness.append(k)
    said = file.attributes("lattice")
    mass, unit = (np.asarray(said.get(name, np.nan)) for name in ("mass", "omega_mx"))
    if any(value.shape or value.dtype.kind not in "fiu" for value in (mass, unit)):
        return tuple(stiffness), None
    with np.errstate(all="ignore"):
        kmax = float(mass * unit.astype(float) ** 2 / (2 * len(shape)))
    return tuple(stiffness), kmax if 0 < kmax < np.inf else None


def read_apart(path):
    """Return `bonds` of a file as a process of its own reads them. Not collective.

    Raises
    ------
    FileError
        If that process refuses the file, crashes, or needs too much time or memory.
    """
    with open_regular(path) as stream:
        seconds = SECONDS + os.fstat(stream.fileno()).st_size / 2**25
    kept = {k: v for k, v in os.environ.items() if not k.startswith(LAUNCHERS)}
    home = str(Path(__file__).parents[2])
    kept["PYTHONPATH"] = os.pathsep.join(filter(None, [home, os.environ.get("PYTHONPATH")]))
    # -P: a file numpy.py in the present folder stays what it is.
    words = [sys.executable, "-P", "-m", "pgran.files.hdf5", os.fspath(path)]
    try:
        done = subprocess.run(
            words, env=kept, stdin=subprocess.DEVNULL, capture_output=True, timeout=seconds
        )
    except subprocess.TimeoutExpired:
        raise FileError(f"{path}: damaged: reading it took more than {seconds:.0f} s") from None
    except OSError as error:
        raise FileError(f"{path}: cannot be read apart: {reason_of(error)}") from None
    said = done.stderr.decode(errors="replace").strip().split("\n")[-1]
    if done.returncode == BAD_FILE:
        raise FileError(said)
    if done.returncode:
        crash = signal.Signals(-done.returncode).name if done.returncode < 0 else said
        raise FileError(f"{path}: damaged: reading it crashed ({crash})")
    stream = io.BytesIO(done.stdout)
    kmax, *stiffness = (np.load(stream, allow_pickle=False) for _ in range(1 + int(said)))
    return tuple(stiffness), None if np.isnan(kmax) else float(kmax)


def main(path):
    """Read a file and write its bonds to standard output, their number to standard error."""
    size = os.path.getsize(path)
    seconds = int(2 * SECONDS + size / 2**25)  # ends it where nobody is left to do so
    for limit, most in (
        (resource.RLIMIT_CORE, 0),
        (resource.RLIMIT_CPU, seconds),
        (resource.RLIMIT_AS, min(MEMORY + 4 * size, total_memory() // 4)),
    ):
        with contextlib.suppress(ValueError, OSError):  # a limit that is lower already
            resource.setrlimit(limit, (most, most))
    try:
        with opened(path) as file:
            if file.attributes("/").get("format") == FORMAT:
                raise FileError(f"{path}: a result of pgran that was damaged or changed (no seal)")
            stiffness, kmax = bonds(file)
    except FileError as error:
        print(error, file=sys.stderr)
        return BAD_FILE
    pipe = SimpleNamespace(write=sys.stdout.buffer.write)
    for values in (np.nan if kmax is None else kmax, *stiffness):
        np.save(pipe, values, allow_pickle=False)
    sys.stdout.flush()
    print(len(stiffness), file=sys.stderr)
    return DONE


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
