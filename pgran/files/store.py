"""Results on disk: one HDF5 file a run, written whole by rank 0, and read back.

The last 512 bytes, which HDF5 does not look at, are a seal: what the file is, and the SHA-256 of
all bytes before. No result with a broken seal reaches the HDF5 library, which can crash on damaged
files. In format version 1 the seal came first, where it hid the file from netCDF.

A group is one of netCDF-4, too: each axis of an array has a dimension scale of one axis.
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

from pgran.errors import FileError, reason_of
from pgran.files import hdf5 as foreign
from pgran.files.paths import open_regular
from pgran.physics.lattice import AXES

FORMAT_VERSION = 2
SEAL_SIZE, SEAL = 512, b"pgran result "
PIECE = 2**20  # bytes read at a time
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
            with h5py.File(stream, "w") as file:
                file.attrs.update(known | attributes)
                axes = next((len(r.shape) for r in records if r.group == "lattice"), 0)
                for record in records:
                    _write_record(file, record, axes)
            size = stream.seek(0, os.SEEK_END)
            stream.write(_seal(stream, FORMAT_VERSION, 0, size))
            if stream.failure:
                raise stream.failure
            os.fsync(stream.fileno())
        os.replace(temporary, path)
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {reason_of(error)}") from None
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
            (file if item.metadata else group).attrs[item.name] = _stored(value)
            continue
        data = group.create_dataset(item.name, data=_stored(value))
        data.attrs["units"] = item.metadata["units"]
        data.attrs["long_name"] = item.metadata["long_name"]
        if np.asarray(value).dtype == bool:
            data.attrs["dtype"] = "bool"  # as xarray writes and reads it
    for item in dataclasses.fields(record):
        if item.name in group:
            for number, scale in enumerate(_axis_names(item, axes)):
                _attach(group, group[item.name], number, scale)


def _stored(value):
    """Return a value as HDF5 and netCDF take it: text as UTF-8, truth as an integer."""
    kind = np.asarray(value).dtype.kind
    if kind == "b":
        return np.int8(value)
    if kind != "U" or isinstance(value, str):
        return value
    encoded = np.char.encode(value, "utf-8")
    return encoded.astype(h5py.string_dtype("utf-8", encoded.itemsize))


def _axis_names(item, axes):
    """Return the names of the coordinates along each axis of a declared array."""
    names = list(AXES[:axes])
    if item.name in BOND_AXES:
        axis = BOND_AXES[item.name]
        return [f"bond_{n}" if a == axis else n for a, n in enumerate(names)]
    declared = item.metadata["axes"] or (item.name,)  # coordinates lie along themselves
    return [n for name in declared for n in (names if name == "balls" else [name])]


def _attach(group, data, number, scale):
    """Attach a coordinate to an axis of a dataset, a plain index where there is none yet."""
    if scale not in group:
        index = group.create_dataset(scale, data=np.arange(data.shape[number]))
        index.attrs["units"] = "1"
        index.attrs["long_name"] = f"index along {scale}"
    if not h5py.h5ds.is_scale(group[scale].id):
        group[scale].make_scale(scale)
    if data != group[scale]:
        data.dims[number].attach_scale(group[scale])


def _seal(stream, version, start, stop):
    """Return the seal of a part of a file, which is read through."""
    stream.seek(start)
    digest, left = hashlib.sha256(), stop - start
    while piece := stream.read(min(left, PIECE)):
        digest.update(piece)
        left -= len(piece)
    seal = SEAL + f"{version}\nsha256 {digest.hexdigest()}\n".encode()
    return seal.ljust(SEAL_SIZE, b"\0")


def _read_seal(stream):
    """Return a file's seal, the version that has it there, and which bytes it is of.

    The seal is empty where there is none.
    """
    size = stream.seek(0, os.SEEK_END)
    end = max(0, size - SEAL_SIZE)
    for version, place, content in ((2, end, (0, end)), (1, 0, (SEAL_SIZE, size))):
        stream.seek(place)
        seal = stream.read(SEAL_SIZE)
        if seal.startswith(SEAL):
            return seal, version, content
    return b"", None, None


def is_result(path):
    """Return whether a file has the seal of a result, broken or not. Not collective."""
    if not Path(path).is_file():
        return False
    with open_regular(path) as stream:
        return bool(_read_seal(stream)[0])


def check_seal(path):
    """Raise unless a file is a result of pgran, unchanged since it was written. Not collective."""
    with open_regular(path) as stream:
        seal, version, content = _read_seal(stream)
        if not seal:
            raise FileError(f"{path}: not a result of pgran, or damaged or changed since (no seal)")
        said = seal[len(SEAL) :].split(b"\n")[0]
        if said != b"%d" % version:
            said = said[:20].decode(errors="replace")
            raise FileError(
                f"{path}: format version {said}; this pgran reads 1 to {FORMAT_VERSION}"
            )
        if seal != _seal(stream, version, *content):
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
