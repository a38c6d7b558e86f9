"""Results on disk: one HDF5 file a run, written whole by rank 0, and read back.

Foreign files are looked at before they are read: HDF5 can point outside itself, and can declare far
more data than it holds.
"""

import contextlib
import dataclasses
import datetime
import os
import tempfile
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np

from pgran.errors import FileError, describe
from pgran.lattice import AXES, bond_shape

FORMAT, FORMAT_VERSION = "pgran", 1
LARGEST = 8 * 2**30  # bytes that a dataset may take in memory unless it is stored in full
BOND_AXES = {f"stiffness_{name}": axis for axis, name in enumerate(AXES)}


def check_output(path, overwrite):
    """Raise unless a result can be written to `path`; make its folder. Not collective.

    Raises
    ------
    FileError
        If there is a file already, or the folder cannot be written to.
    """
    path = Path(path)
    if path.exists() and not overwrite:
        raise FileError(
            f"{path}: exists already; -output_overwrite replaces it, -output_file takes another"
        )
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {error.strerror}") from None
    if path.is_dir():
        raise FileError(f"{path}: is a folder")


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
    known = {"format": FORMAT, "format_version": FORMAT_VERSION, "created": now}
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with h5py.File(temporary, "w") as file:
            file.attrs.update(known | attributes)
            axes = next((len(r.shape) for r in records if r.group == "lattice"), 0)
            for record in records:
                _write_record(file, record, axes)
        with open(temporary, "rb+") as stream:
            os.fsync(stream.fileno())
        os.replace(temporary, path)
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {describe(error)}") from None
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


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
        If the file is not pgran's, or is damaged.
    """
    with _opened(path) as file:
        if _text(file.attrs.get("format")) != FORMAT:
            raise FileError(f"{path}: not a result of pgran")
        version = file.attrs.get("format_version")
        if version != FORMAT_VERSION:
            raise FileError(f"{path}: format version {version}; this pgran reads {FORMAT_VERSION}")
        return _namespace(file, path)


def read_stiffness(path):
    """Return the bond constants in `/lattice/stiffness_x` and so on. Not collective.

    Returns
    -------
    stiffness : tuple of numpy.ndarray
    kmax : float or None
        What the file's unit of frequency belongs to, if it says.

    Raises
    ------
    FileError
        If they are missing or of shapes that fit no lattice; values are checked by `Lattice`.
    """
    with _opened(path) as file:
        lattice = _member(file, "lattice", path)
        names = [name for name in BOND_AXES if isinstance(lattice, h5py.Group) and name in lattice]
        if names != list(BOND_AXES)[: len(names)] or not names:
            raise FileError(f"{path}: needs /lattice/stiffness_x, and _y, _z without a gap")
        arrays = [_array(_member(lattice, name, path), path) for name in names]
        attributes = {name: float(lattice.attrs[name]) for name in _real_attributes(lattice)}
    shape = tuple(n - (a == 0) for a, n in enumerate(arrays[0].shape))
    for axis, k in enumerate(arrays):
        if k.ndim != len(arrays) or min(shape) < 1 or k.shape != bond_shape(shape, axis):
            raise FileError(
                f"{path}: /lattice/{names[axis]} has shape {k.shape}, "
                f"which fits no lattice of {len(arrays)} axes with the others"
            )
        if k.dtype.kind not in "fiu":
            raise FileError(f"{path}: /lattice/{names[axis]} holds no real numbers")
    unit, mass = (attributes.get(name, np.nan) for name in ("omega_mx", "mass"))
    kmax = float(mass * unit**2 / (2 * len(shape)))
    return tuple(k.astype(float) for k in arrays), kmax if 0 < kmax < np.inf else None


def _real_attributes(group):
    """Return the names of a group's attributes that are single real numbers."""
    return [
        name
        for name, value in group.attrs.items()
        if np.isrealobj(value) and np.size(value) == 1 and np.asarray(value).dtype.kind in "fiu"
    ]


@contextlib.contextmanager
def _opened(path):
    """Open an HDF5 file for reading, every trouble a FileError."""
    try:
        with open(path, "rb"):
            pass
        if not h5py.is_hdf5(path):
            raise FileError(f"{path}: not an HDF5 file")
        with h5py.File(path, "r") as file:
            yield file
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
        if isinstance(error, OSError) and error.filename:
            raise FileError(describe(error)) from None
        raise FileError(f"{path}: damaged: {error}") from None


def _member(group, name, path):
    """Return a member that lies in the file itself."""
    link = group.get(name, getlink=True)
    if link is None:
        raise FileError(f"{path}: {group.name.rstrip('/')}/{name} is missing")
    if not isinstance(link, h5py.HardLink):
        raise FileError(f"{path}: {group.name.rstrip('/')}/{name} is a link; links are not read")
    return group[name]


def _array(data, path):
    """Return a dataset's values, stored in the file itself."""
    if not isinstance(data, h5py.Dataset):
        raise FileError(f"{path}: {data.name} is no dataset")
    if data.external or data.is_virtual:
        raise FileError(f"{path}: {data.name} lies in another file; such data are not read")
    text = data.dtype.kind == "S" and data.ndim == 1  # names of rows
    if data.dtype.kind not in "fiucb" and not text:
        raise FileError(f"{path}: {data.name} holds no numbers")
    size = data.size * data.dtype.itemsize
    if data.size is None or size > max(data.id.get_storage_size(), LARGEST):
        raise FileError(f"{path}: {data.name} declares {size} bytes, far more than the file holds")
    return np.char.decode(data[()], "utf-8") if text else data[()]


def _namespace(group, path):
    """Return a group's attributes and members."""
    found = {}
    for name, value in group.attrs.items():
        if not isinstance(value, h5py.Empty) and name.isidentifier():
            found[name] = _text(value)
    for name in group:
        member = _member(group, name, path)
        nested = isinstance(member, h5py.Group)
        found[name] = _namespace(member, path) if nested else _array(member, path)
    return SimpleNamespace(**found)


def _text(value):
    """Return an attribute, text as str."""
    return value.decode() if isinstance(value, bytes) else value
