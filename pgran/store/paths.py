"""Files that users name: opened with care, written whole, and sealed against changes.

The seal of a result is its last 512 bytes, which HDF5 does not look at. It says what the file is,
and the SHA-256 of all bytes before. Whoever opens the file for writing by HDF5 loses it. In format
version 1 it comes first, where it hid the file from netCDF.
"""

import contextlib
import glob
import math
import os
import stat
from pathlib import Path

from pgran.arguments import meant, nearest, shown
from pgran.errors import FileError, reason_of


def open_regular(path, ending="", what="", most=math.inf):
    """Return a file opened for reading bytes; refuse what could block or never end.

    Or has more than `most` bytes: `what` it is. Where there is none a file called alike is named,
    of the same ending or of `ending`.
    """
    try:
        facts = os.stat(os.fspath(path))
        if not stat.S_ISREG(facts.st_mode):
            kind = "directory" if stat.S_ISDIR(facts.st_mode) else "pipe or a device, not a file"
            raise FileError(f"{path}: is a {kind}")
        if facts.st_size > most:
            raise FileError(f"{path}: {what} has at most {most} bytes")
        return open(path, "rb")
    except FileNotFoundError as error:
        raise FileError(f"{reason_of(error)}{_alike(Path(path), ending)}") from None
    except OSError as error:
        raise FileError(reason_of(error)) from None
    except (TypeError, ValueError) as error:
        raise FileError(f"{shown(path)}: no name of a file: {error}") from None


def _alike(path, ending):
    """Return which file may be meant by a name that there is none of, in words."""
    files = {}
    for folder in (Path("results"), Path("options"), path.expanduser().parent):
        with contextlib.suppress(OSError):
            for suffix in filter(None, (path.suffix, ending)):
                files |= {file.stem: file for file in folder.glob(f"*{glob.escape(suffix)}")}
    return meant(files.get(nearest(path.stem, sorted(files))))


@contextlib.contextmanager
def writing(path):
    """Turn what goes wrong meanwhile into a FileError: that `path` cannot be written."""
    try:
        yield
    except (OSError, ValueError) as error:  # a name with a zero byte
        why = getattr(error, "strerror", None) or error
        raise FileError(f"{path}: cannot be written: {why}") from None


def try_beside(path, make):
    """Raise an OSError unless a file can be made beside `path`; make its folder if asked to."""
    if make:
        path.parent.mkdir(parents=True, exist_ok=True)
    folder = next(p for p in path.parents if p.exists())
    trial = folder / f".{path.name}.{os.getpid()}.trial"  # a name no shorter than any needed
    trial.touch()
    trial.unlink()


@contextlib.contextmanager
def whole(path, check=lambda: None, kind=open, owner=None):
    """Open a file for bytes that takes the place of `path` once it is whole.

    Where anything fails, what was there stays as it was. The folder is made if it is missing, and a
    link is not followed. `check` raises, just before, where what is at `path` by then must stay;
    `kind` opens the new file; `owner` is a part of its name, by default this process's number.
    """
    path = Path(path)
    owner = f"{os.getpid()}." if owner is None else owner
    temporary = path.with_name(f".{path.name}.{owner}part")
    try:
        with writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            temporary.unlink(missing_ok=True)
            with kind(temporary, "xb+") as stream:
                yield stream
                stream.flush()
                os.fsync(stream.fileno())
            check()
            os.replace(temporary, path)
    finally:
        with contextlib.suppress(OSError, ValueError):
            temporary.unlink(missing_ok=True)


# | what HDF5 has written ... | pgran result 2, sha256 of all before, zeros: 512 bytes |
SEAL_SIZE, SEAL = 512, b"pgran result "
AT_END = 2  # the version of a seal in this place, that of the format which brought it
PIECE = 2**20  # bytes read at a time


def seal_of(stream, version, start, stop):
    """Return the seal, of some version, of the bytes of a file from `start` to `stop`."""
    import hashlib  # not by those who only read options

    stream.seek(start)
    digest, left = hashlib.sha256(), stop - start
    while piece := stream.read(min(left, PIECE)):
        digest.update(piece)
        left -= len(piece)
    seal = SEAL + f"{version}\nsha256 {digest.hexdigest()}\n".encode()
    return seal.ljust(SEAL_SIZE, b"\0")


def check_seal(path):
    """Raise a FileError unless a file is a result, unchanged since written."""
    with open_regular(path, ".h5") as stream:
        seal, version, content = _read_seal(stream)
        if not seal:
            raise FileError(f"{path}: not a result of pgran, or damaged or changed since (no seal)")
        if seal != seal_of(stream, version, *content):
            raise FileError(f"{path}: damaged or changed since it was written (checksum differs)")


def has_seal(path):
    """Return whether a file has a seal, right or wrong."""
    with open_regular(path) as stream:
        return bool(_read_seal(stream)[0])


def _read_seal(stream):
    """Return a file's seal, empty if none, its version, and which bytes it is of."""
    size = stream.seek(0, os.SEEK_END)
    end = max(0, size - SEAL_SIZE)
    for version, place, content in ((AT_END, end, (0, end)), (1, 0, (SEAL_SIZE, size))):
        stream.seek(place)
        seal = stream.read(SEAL_SIZE)
        if seal.startswith(SEAL):
            return seal, version, content
    return b"", None, None
