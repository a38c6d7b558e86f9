"""Paths of files that users name."""

import os
import stat

from pgran.errors import FileError, reason_of


def open_regular(path):
    """Return a file opened for reading bytes, refusing what could block or never end.

    Not collective.

    Raises
    ------
    FileError
        If it cannot be opened, or is a folder, a pipe or a device.
    """
    try:
        mode = os.stat(path).st_mode
        if not stat.S_ISREG(mode):
            kind = "directory" if stat.S_ISDIR(mode) else "pipe or a device, not a file"
            raise FileError(f"{path}: is a {kind}")
        return open(path, "rb")
    except OSError as error:
        raise FileError(reason_of(error)) from None
    except ValueError as error:
        raise FileError(f"{path!r}: no name of a file: {error}") from None
