"""Paths of files that users name: read with care, and written whole."""

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
