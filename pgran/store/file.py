"""Results on disk: one HDF5 file a run, written whole by rank 0, and read back.

The fields of the records say what a file holds: it is written and checked by them. A group is one
of netCDF-4, too: each axis of an array has a dimension scale of one axis.
"""

import contextlib
import dataclasses
import datetime
import io
import os
from pathlib import Path

import h5py
import numpy as np

from pgran.catalogue import groups_of, record_kind
from pgran.errors import FileError
from pgran.store import careful as hdf5
from pgran.store.paths import try_beside, whole, writing
from pgran.store.record import MisfitError, Result, axes_of, dimensions_of, in_part, plain_value
from pgran.store.seal import AT_END, has_seal, seal_of

FORMAT, FORMAT_VERSION = "pgran", 5
CHECKED = ("v108", "v108")  # versions of HDF5's structures: the first ones with checksums


def check_output(path, overwrite, make=True):
    """Raise a FileError unless a result can be written; make its folder if asked to."""
    with writing(path):
        _check_place(path, overwrite)
        try_beside(Path(path), make)


def _check_place(path, overwrite):
    """Raise a FileError if what is at a path must stay: all but a result to `overwrite`."""
    if os.path.lexists(path) and not (is_result(path) and overwrite):
        why = "exists and is no result of pgran: move it away yourself, or"
        if is_result(path):
            why = "exists already; -output_overwrite replaces it,"
        raise FileError(f"{path}: {why} -output_file takes another")


def write(path, attributes, records, overwrite=True):
    """Write a result whole, or leave what was there as it was and raise a FileError.

    `attributes` are what the run says of itself.
    """
    now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    own = {"format": FORMAT, "format_version": FORMAT_VERSION, "created": now}
    # by the one run that holds the journal: what it has left when it was killed is its own
    with whole(path, lambda: _check_place(path, overwrite), _Stream, owner="") as stream:
        with h5py.File(stream, "w", libver=CHECKED) as file:
            for name, value in (own | attributes).items():
                file.attrs[name] = _stored(value)
            for record in records:
                _write_record(file, record)
        size = stream.seek(0, os.SEEK_END)
        stream.write(seal_of(stream, AT_END, 0, size))
        if stream.failure:
            raise stream.failure


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


def _write_record(parent, record):
    """Write a record: datasets and attributes as its fields declare them, and its parts."""
    group = parent.create_group(record.group)
    for item in dataclasses.fields(record):
        value = getattr(record, item.name)
        if value is None:
            continue
        if "part" in item.metadata:
            _write_record(group, value)
        elif "axes" not in item.metadata:
            (group.file if "of_run" in item.metadata else group).attrs[item.name] = _stored(value)
        else:
            data = group.create_dataset(item.name, data=_stored(value))
            data.attrs["units"] = item.metadata["units"]
            data.attrs["long_name"] = item.metadata["long_name"]
            if item.metadata["dtype"] is bool:
                data.attrs["dtype"] = "bool"  # as xarray writes and reads it
    for item in dataclasses.fields(record):
        if "axes" in item.metadata and item.name in group:
            data = group[item.name]
            for number, scale in enumerate(axes_of(item, dimensions_of(item, data))):
                _attach(group, data, number, scale)


def _stored(value):
    """Return a value as HDF5 and netCDF take it: truth as an integer, texts of a list in place."""
    if isinstance(value, str):
        return value
    value = np.asarray(value)
    if value.dtype.kind == "U":
        encoded = np.char.encode(value, "utf-8")
        return encoded.astype(h5py.string_dtype("utf-8", max(encoded.itemsize, 1)))
    return value.astype(np.int8) if value.dtype.kind == "b" else value


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


def is_result(path):
    """Return whether a file is a result, whatever became of it since."""
    if not Path(path).is_file():
        return False
    if has_seal(path):
        return True
    with contextlib.suppress(FileError), hdf5.opened(path) as file:
        return str(file.attributes("/").get("format")) == FORMAT
    return False


def read_result(path):
    """Return the result in a file; see `pgran.load`."""
    with hdf5.opened(path) as file:
        facts = file.attributes("/")
        file.check_version(facts, FORMAT_VERSION)
        records, axes = [], {}
        for group in file.members("/", groups_of(str(facts.get("scene")))):
            try:
                record = _read_record(file, group, record_kind(group), facts)
                axes = record.axes if group in ("lattice", "network") else axes
                record.check(axes)
            except MisfitError as error:
                raise FileError(f"{path}: /{group}/{error}") from None
            records.append(record)
        return Result(records, **facts)


def _read_record(file, group, kind, facts):
    """Return a group as the record that declares it; `facts` are the attributes of the file."""
    fields = dataclasses.fields(kind)
    names = [item.name for item in fields]
    there, attributes = file.members(group, names), file.attributes(group, names)
    values = {}
    for item in fields:
        name, meta = item.name, item.metadata
        newer = meta.get("since", 1) > facts["format_version"]
        source = facts if "of_run" in meta else attributes
        if "part" in meta:
            inner = meta["part"].group
            if inner in there:
                with in_part(inner):
                    values[name] = _read_record(file, f"{group}/{inner}", meta["part"], facts)
        elif "axes" in meta:
            lacks = (newer or meta["optional"]) and name not in there
            values[name] = None if lacks else file.array(f"{group}/{name}", meta["dtype"])
        elif name in source:
            values[name] = plain_value(item, source[name])
        elif newer or meta.get("optional"):
            values[name] = None
        else:
            file.refuse(f"{group}/{name}", "is missing")
    return kind(**values)
