"""Checksums of plain values and arrays, by which they are told apart."""

import dataclasses
import functools
import hashlib

import numpy as np

from pgran.arguments import shown


class Distinct:
    """A dataclass whose objects are equal if all that they are made of is, bit by bit."""

    @functools.cached_property
    def fingerprint(self):
        """Checksum of all fields."""
        fields = {item.name: getattr(self, item.name) for item in dataclasses.fields(self)}
        return fingerprint([type(self).__name__, fields])

    def __eq__(self, other):
        """Return whether another object is of the same kind and made of the same."""
        if type(other) is not type(self):
            return NotImplemented
        return self.fingerprint == other.fingerprint

    def __hash__(self):
        """Return a number that equal objects share."""
        return hash(self.fingerprint)


def fingerprint(value):
    """Return a checksum of plain values, arrays and what holds them; of functions their names."""
    digest = hashlib.sha256()
    try:
        _feed(digest, value)
    except Exception:  # lists within themselves, endless numbers: refused where they are checked
        return shown(type(value))
    return digest.hexdigest()


def _feed(digest, value):
    if isinstance(value, np.ndarray):
        digest.update(f"{value.dtype.str} {value.shape}".encode())
        digest.update(np.ascontiguousarray(value))
    elif isinstance(value, Distinct):
        digest.update(value.fingerprint.encode())
    elif isinstance(value, dict):
        _feed(digest, sorted(value.items(), key=lambda item: str(item[0])))
    elif isinstance(value, (list, tuple)):
        digest.update(f"{type(value).__name__} of {len(value)}".encode())
        for item in value:
            _feed(digest, item)
    else:
        plain = isinstance(value, (int, float, complex, str, bytes, np.generic, type(None)))
        text = repr(value) if plain else getattr(value, "__qualname__", type(value).__qualname__)
        digest.update(f"{text};".encode(errors="backslashreplace"))
