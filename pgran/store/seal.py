"""The seal of a result: its last 512 bytes, which HDF5 does not look at.

It says what the file is, and the SHA-256 of all bytes before. Whoever opens the file for writing by
HDF5 loses it. In format version 1 it comes first, where it hid the file from netCDF.
"""

import hashlib
import os

from pgran.errors import FileError
from pgran.store.paths import open_regular

# | what HDF5 has written ... | pgran result 2, sha256 of all before, zeros: 512 bytes |
SEAL_SIZE, SEAL = 512, b"pgran result "
AT_END = 2  # the version of a seal in this place, that of the format which brought it
PIECE = 2**20  # bytes read at a time


def seal_of(stream, version, start, stop):
    """Return the seal, of some version, of the bytes of a file from `start` to `stop`."""
    stream.seek(start)
    digest, left = hashlib.sha256(), stop - start
    while piece := stream.read(min(left, PIECE)):
        digest.update(piece)
        left -= len(piece)
    seal = SEAL + f"{version}\nsha256 {digest.hexdigest()}\n".encode()
    return seal.ljust(SEAL_SIZE, b"\0")


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


def has_seal(path):
    """Return whether a file has a seal, right or wrong."""
    with open_regular(path) as stream:
        return bool(_read_seal(stream)[0])


def check_seal(path):
    """Raise a FileError unless a file is a result, unchanged since written."""
    with open_regular(path, ".h5") as stream:
        seal, version, content = _read_seal(stream)
        if not seal:
            raise FileError(f"{path}: not a result of pgran, or damaged or changed since (no seal)")
        if seal != seal_of(stream, version, *content):
            raise FileError(f"{path}: damaged or changed since it was written (checksum differs)")
