"""Results on disk: one HDF5 file a run, written whole by rank 0, and read back with care.

The fields of the records say what a file holds: it is written and checked by them. A group is one
of netCDF-4, too: each axis of an array has a dimension scale of one axis.

HDF5 files can point to others, can declare far more data than they hold, and can let the library
crash or hang. A `CarefulFile` reads nothing outside of a file, and no more than it holds. What
nobody vouches for is read first by a process of its own, of bounded memory and time.
"""

import contextlib
import dataclasses
import datetime
import io
import math
import os
import resource
import signal
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np

from pgran.catalogue import groups_of, record_kind
from pgran.errors import BAD_FILE, DONE, FileError, InputError, reason_of
from pgran.store.paths import AT_END, has_seal, open_regular, seal_of, try_beside, whole, writing
from pgran.store.record import KINDS, Result, axes_of, plain_value

FORMAT, FORMAT_VERSION = "pgran", 5
CHECKED = ("v108", "v108")  # versions of HDF5's structures: the first ones with checksums
MODEST = 64 * 2**20  # bytes that the data of a smaller file may be when they are decompressed
# What a process that tries a file may use, apart from what grows with the file.
MEMORY, SECONDS = 512 * 2**20, 60
# Variables that would make that process take part in this MPI job.
LAUNCHERS = ("OMPI_", "PMIX_", "PMI_", "PRTE_", "HYDRA_", "MPI_LOCAL", "SLURM_")
# Who writes groups that a file of another kind lacks.
WRITERS = {"/lattice": ": runs on lattices write it", "/network": ": pgran pack writes it"}
TROUBLE = (OSError, RuntimeError, KeyError, ValueError, TypeError, OverflowError, MemoryError)


def check_output(path, overwrite, make=True):
    """Raise a FileError unless a result can be written; make its folder if asked to."""
    with writing(path):
        _check_place(path, overwrite)
        try_beside(Path(path), make)


def _check_place(path, overwrite):
    """Raise a FileError if what is at a path must stay: all but a result to `overwrite`."""
    if not os.path.lexists(path):
        return
    why = "exists already; -output_overwrite replaces it,"
    if not is_result(path):
        why = "exists and is no result of pgran: move it away yourself, or"
    elif overwrite:
        return
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
    for item, value in record.filled():
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
    for item, value in record.filled():
        if "axes" in item.metadata:
            for number, scale in enumerate(axes_of(item, value)):
                _attach(group, group[item.name], number, scale)


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
    with contextlib.suppress(FileError), opened(path) as file:
        return str(file.attributes("/").get("format")) == FORMAT
    return False


def read_result(path):
    """Return the result in a file; see `pgran.load`."""
    with opened(path) as file:
        facts = file.attributes("/")
        file.check_version(facts, FORMAT_VERSION)
        records = []
        for group in file.members("/", groups_of(str(facts.get("scene")))):
            axes = records[0].axes if records else {}  # of the medium, which comes first
            record = _read_record(file, group, record_kind(group), facts, axes)
            records.append(record.computed_on(Result(records), **facts))
        return Result(records, **facts)


def _read_record(file, group, kind, facts, axes):
    """Return a group as the record that declares it.

    `facts` are the attributes of the file, `axes` the lengths of the medium's axes by name.
    """
    fields = dataclasses.fields(kind)
    names = [item.name for item in fields]
    there, attributes = file.members(group, names), file.attributes(group, names)
    values = {}
    try:
        for item in fields:
            name, meta = item.name, item.metadata
            may_lack = meta.get("optional") or meta.get("since", 1) > facts["format_version"]
            source = facts if "of_run" in meta else attributes
            if "part" in meta:
                inner = f"{group}/{meta['part'].group}"
                if meta["part"].group in there:
                    values[name] = _read_record(file, inner, meta["part"], facts, axes)
            elif may_lack and name not in (there if "axes" in meta else source):
                values[name] = None
            elif "axes" in meta:
                values[name] = file.array(f"{group}/{name}", meta["dtype"])
            elif name in source:
                values[name] = plain_value(item, source[name])
            else:
                file.refuse(f"{group}/{name}", "is missing")
        record = kind(**values)
        record.check(axes or record.axes)
    except InputError as error:
        raise FileError(f"{file.path}: /{group}/{error}") from None
    return record


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


def read_within_limits(path, read):
    """Let `read` have a file as a `CarefulFile`, in this process alone; return the exit code."""
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
