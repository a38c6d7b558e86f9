"""Results on disk: one HDF5 file a run, written whole by rank 0, and read back.

The first 512 bytes, which HDF5 skips, are a seal: what the file is, and the SHA-256 of all that
follows. No result with a broken seal reaches the HDF5 library, which can crash on damaged files.
"""

import contextlib
import dataclasses
import datetime
import hashlib
import io
import os
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np

from pgran import foreign
from pgran.errors import FileError, describe, open_regular
from pgran.lattice import AXES

FORMAT_VERSION = 1
SEAL_SIZE, SEAL = 512, b"pgran result "
BOND_AXES = {f"stiffness_{name}": axis for axis, name in enumerate(AXES)}


def check_output(path, overwrite, make=True):
    """Raise unless a result can be written to `path`; make its folder unless told not to.

    Not collective.

    Raises
    ------
    FileError
        If something is there already that may not be replaced, or the folder cannot be written to.
    """
    path = Path(path)
    try:
        if path.exists():
            if not is_result(path):
                raise FileError(
                    f"{path}: exists and is no result of pgran: move it away yourself, or "
                    "-output_file takes another"
                )
            if not overwrite:
                raise FileError(
                    f"{path}: exists already; -output_overwrite replaces it, "
                    "-output_file takes another"
                )
        if make:
            path.parent.mkdir(parents=True, exist_ok=True)
        folder = next(p for p in path.parents if p.exists())
        trial = folder / f".{path.name}.{os.getpid()}.trial"  # a name no shorter than any needed
        trial.touch()
        trial.unlink()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise FileError(f"{path}: cannot be written: {reason}") from None


def write(path, attributes, records):
    """Write a result whole, or leave what was there as it was. Not collective: rank 0.

    Parameters
    ----------
    path : str or os.PathLike
    attributes : dict
        What the run says of itself; `format`, `format_version` and `created` are added.
    records : sequence
        Dataclasses of `pgran.results`, a group each.

    Raises
    ------
    FileError
        If it cannot be written.
    """
    path = Path(path)
    now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    known = {"format": foreign.FORMAT, "format_version": FORMAT_VERSION, "created": now}
    temporary = path.with_name(f".{path.name}.part")  # of the one run that holds the journal
    try:
        path.parent.mkdir(parents=True, exist_ok=True)  # it may have been removed meanwhile
        with _Stream(temporary, "w+") as stream:
            with h5py.File(stream, "w", userblock_size=SEAL_SIZE) as file:
                file.attrs.update(known | attributes)
                axes = next((len(r.shape) for r in records if r.group == "lattice"), 0)
                for record in records:
                    _write_record(file, record, axes)
            seal = _seal(stream)
            stream.seek(0)
            stream.write(seal)
            if stream.failure:
                raise stream.failure
            os.fsync(stream.fileno())
        os.replace(temporary, path)
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {describe(error)}") from None
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


class _Stream(io.FileIO):
    """A file that HDF5 writes to; it keeps the first failure of the disk to itself, as `failure`.

    HDF5 cannot close a file that it cannot write: each of its objects would fail anew.
    """

    failure = None

    def write(self, data):
        """Write all bytes, or remember why not."""
        left = memoryview(data).cast("B")
        try:
            while left and not self.failure:
                left = left[super().write(left) :]
        except OSError as error:
            self.failure = error
        return len(data)

    def truncate(self, size=None):
        """Set the size, or remember why not."""
        try:
            return super().truncate(size)
        except OSError as error:
            self.failure = error
            return size


def _write_record(file, record, axes):
    """Write a dataclass: arrays that it declares as datasets, the rest as attributes."""
    group = file.create_group(record.group)
    for item in dataclasses.fields(record):
        value = getattr(record, item.name)
        if value is None:
            continue
        if "axes" not in item.metadata:
            (file if item.metadata else group).attrs[item.name] = value
            continue
        data = group.create_dataset(item.name, data=_stored(value))
        data.attrs["units"] = item.metadata["units"]
        data.attrs["long_name"] = item.metadata["long_name"]
    for item in dataclasses.fields(record):
        if item.name in group:
            for number, scale in enumerate(_axis_names(item, axes)):
                _attach(group, group[item.name], number, scale)


def _stored(value):
    """Return an array as HDF5 takes it: text as UTF-8 of fixed length."""
    if np.asarray(value).dtype.kind != "U":
        return value
    encoded = np.char.encode(value, "utf-8")
    return encoded.astype(h5py.string_dtype("utf-8", encoded.itemsize))


def _axis_names(item, axes):
    """Return the names of the coordinates along each axis of a declared array."""
    names = list(AXES[:axes])
    if item.name in BOND_AXES:
        axis = BOND_AXES[item.name]
        return [f"bond_{n}" if a == axis else n for a, n in enumerate(names)]
    declared = item.metadata["axes"]
    return [n for name in declared for n in (names if name == "balls" else [name])]


def _attach(group, data, number, scale):
    """Attach a coordinate to an axis of a dataset, a plain index where there is none yet."""
    if scale not in group:
        index = group.create_dataset(scale, data=np.arange(data.shape[number]))
        index.attrs["units"] = "1"
        index.attrs["long_name"] = f"index along {scale}"
    if not h5py.h5ds.is_scale(group[scale].id):
        group[scale].make_scale(scale)
    data.dims[number].attach_scale(group[scale])


def _seal(stream):
    """Return the seal that belongs to a file; reads it through, piece by piece."""
    stream.seek(SEAL_SIZE)
    digest = hashlib.file_digest(stream, "sha256").hexdigest()
    return (SEAL + f"{FORMAT_VERSION}\nsha256 {digest}\n".encode()).ljust(SEAL_SIZE, b"\0")


def is_result(path):
    """Return whether a file has the seal of a result, broken or not. Not collective."""
    if not Path(path).is_file():
        return False
    with open_regular(path) as stream:
        return stream.read(len(SEAL)) == SEAL


def check_seal(path):
    """Raise unless a file is a result of pgran, unchanged since it was written. Not collective."""
    with open_regular(path) as stream:
        seal = stream.read(SEAL_SIZE)
        if not seal.startswith(SEAL):
            raise FileError(f"{path}: not a result of pgran")
        version = seal[len(SEAL) :].split(b"\n")[0]
        if version != b"%d" % FORMAT_VERSION:
            version = version[:20].decode(errors="replace")
            raise FileError(f"{path}: format version {version}; this pgran reads {FORMAT_VERSION}")
        if seal != _seal(stream):
            raise FileError(f"{path}: damaged or changed since it was written (checksum differs)")


def load(path):
    """Return a result as attributes that hold NumPy arrays: `load(path).response.omega`.

    Not collective.

    Parameters
    ----------
    path : str or os.PathLike

    Returns
    -------
    types.SimpleNamespace
        Groups as namespaces; datasets and attributes under their names (see the README).

    Raises
    ------
    FileError
        If the file is not pgran's, or is damaged or changed.
    """
    check_seal(path)
    with foreign.opened(path) as file:
        result = SimpleNamespace(**file.attributes("/"))
        for name in file.names("/"):
            arrays = {item: file.array(f"{name}/{item}") for item in file.names(name)}
            setattr(result, name, SimpleNamespace(**file.attributes(name), **arrays))
        return result


def read_stiffness(path):
    """Return the bond constants in `/lattice/stiffness_x` and so on. Not collective.

    A result is read as it is; any other HDF5 file by a process of its own.

    Returns
    -------
    stiffness : tuple of numpy.ndarray
    kmax : float or None
        What the file's unit of frequency belongs to, if it says.

    Raises
    ------
    FileError
        If they are missing, impossible, or of shapes that fit no lattice.
    """
    if not is_result(path):
        return foreign.read_apart(path)
    check_seal(path)
    with foreign.opened(path) as file:
        return foreign.bonds(file)
