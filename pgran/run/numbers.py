"""What Python hands in as numbers and arrays: as plain ones, and told apart by checksums."""

import dataclasses
import functools
import hashlib

import numpy as np

from pgran.arguments import shown
from pgran.errors import InputError


def numbers(name, value, whole=False):
    """Return real numbers as an array of floats, or of integers; nothing is rounded or left out.

    Whole numbers may come as floats; the array may be the one that was given. Raises InputError,
    which calls them `name`, if they are complex, truth values, texts or masked.
    """
    kind, called = (np.int64, "whole") if whole else (float, "real")
    try:
        array = np.asarray(None if _has_truth_values(value) else value)
    except Exception:  # rows of several lengths, or whatever an object's own conversion raises
        array = np.asarray(None)
    if array.dtype.kind in "iuf" and not np.ma.is_masked(value):
        with np.errstate(all="ignore"):
            converted = array.astype(kind, copy=False)
        if not whole or np.array_equal(converted, array):
            return converted
    raise InputError(f"{name}: {called} numbers are needed, not {shown(value)}")


def number(name, value):
    """Return one real number as a float; raise an InputError if it is anything else."""
    array = numbers(name, value)
    if array.ndim:
        raise InputError(f"{name}: one number is needed, not {shown(value)}")
    return float(array)


def windows_of(name, values, within=None, called="the sweep"):
    """Return numbers low, high, low, high ... as windows, shape (n, 2).

    Raises InputError, which calls them `name`, unless they are such, and within ascending numbers.
    """
    ends = numbers(name, values).ravel()
    if not ends.size or ends.size % 2:
        raise InputError(f"{name}: a window has two ends, low,high; numbers given: {ends.size}")
    windows = ends.reshape(-1, 2)
    for low, high in windows:
        if not low < high:
            raise InputError(f"{name}: {low:g} is not below {high:g}")
        if within is not None and not within[0] <= low < high <= within[-1]:
            whole = f"{called}, {within[0]:g} to {within[-1]:g}"
            raise InputError(f"{name}: {low:g} to {high:g} is not within {whole}")
    return windows


def _has_truth_values(value):
    """Return whether a list holds truth values, which NumPy takes for numbers among others."""
    if isinstance(value, (list, tuple)):
        return any(map(_has_truth_values, value))
    return isinstance(value, (bool, np.bool_))


class Distinct:
    """A dataclass whose objects are equal if all that they are made of is, bit by bit."""

    @functools.cached_property
    def fingerprint(self):
        """Checksum of all fields."""
        fields = {item.name: getattr(self, item.name) for item in dataclasses.fields(self)}
        return fingerprint([type(self).__name__, fields])

    def __eq__(self, other):
        return type(other) is type(self) and self.fingerprint == other.fingerprint

    def __hash__(self):
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
