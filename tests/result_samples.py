"""Results to store and to damage: a record of every kind, as it is declared."""

import contextlib
import dataclasses
import functools
import resource
import tempfile
from pathlib import Path

import h5py
import numpy as np
import pytest
from samples import random_lattice

from pgran.catalogue import RECORDS, record_kind
from pgran.errors import FileError
from pgran.store import file as store

ATTRIBUTES = {"scene": "modes", "status": "complete", "options": "# é\n", "slepc_version": "",
              "mpi_size": 2, "seconds": 1.5}  # fmt: skip
PLAIN = {int: 7, float: 0.3, bool: True, str: "é", tuple[float, ...]: (0.5, 1.0)}
# a result belongs to a lattice or to another network
KINDS = [record_kind(group) for group in RECORDS if group != "network"]


@contextlib.contextmanager
def no_room_beyond(size, named):
    """Let no file grow beyond some bytes, and expect the error, which names the file."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        with pytest.raises(FileError, match=f"{named}: cannot be written"):
            yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def fill(size, dtype):
    """Return an array of entries that are all different, among real numbers a NaN."""
    numbers = np.arange(np.prod(size)).reshape(size)
    if dtype is str:
        return np.char.mod("é%d", numbers)
    return (np.where(numbers == 1, np.nan, 1.5 * numbers) if dtype is float else numbers).astype(
        dtype
    )


def make(kind, shape=(4, 5), without=()):
    """Return a record as it is declared, every axis of another length."""
    if kind.group == "lattice":
        return kind.of(random_lattice(shape))
    lengths, values = {"axis": len(shape), "balls": shape}, {}
    for item in dataclasses.fields(kind):
        axes = item.metadata.get("axes", item.metadata.get("along"))
        if "part" in item.metadata and item.name not in without:
            values[item.name] = make(item.metadata["part"], shape)
        elif axes is None or item.name in without:
            values[item.name] = PLAIN.get(item.type)
        else:
            size = [lengths.setdefault(n, 2 + len(lengths)) for n in axes or [item.name]]
            values[item.name] = fill(np.hstack(size), item.metadata["dtype"])
    return kind(**values)


@functools.cache
def content():
    """The bytes of a result with a record of every kind."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.h5"
        store.write(path, ATTRIBUTES, map(make, KINDS))
        return path.read_bytes()


def stored(path):
    """Write a result with a record of every kind."""
    path.write_bytes(content())
    return path


def change(path, name="/@note", value="mine"):
    """Change an attribute (`group@name`) or a dataset of a result by h5py, which drops the seal."""
    group, attribute, key = name.partition("@")
    with h5py.File(path, "r+") as file:
        members = file[group].attrs if attribute else file
        members.pop(key or name, None)
        if value is not None:
            members[key or name] = value
    return path
