"""What Python hands in as numbers and arrays, as plain ones."""

import numpy as np

from pgran.arguments import shown
from pgran.errors import InputError


def numbers(name, value, whole=False):
    """Return real numbers as an array of floats, or of integers; nothing is rounded or left out.

    Whole numbers may come as floats; the array may be the one that was given. Raises InputError,
    which calls them `name`, if they are complex, truth values, texts or masked.
    """
    try:
        array = None if _has_truth_values(value) else np.asarray(value)
    except Exception:  # rows of several lengths, or whatever an object's own conversion raises
        array = None
    if array is None or array.dtype.kind not in "iuf" or np.ma.is_masked(value):
        needed = "whole" if whole else "real"
        raise InputError(f"{name}: {needed} numbers are needed, not {shown(value)}")
    with np.errstate(all="ignore"):
        found = array.astype(np.int64 if whole else float, copy=False)
    if whole and not np.array_equal(found, array):
        raise InputError(f"{name}: whole numbers are needed, not {shown(value)}")
    return found


def number(name, value):
    """Return one real number as a float; raise an InputError if it is anything else."""
    found = numbers(name, value)
    if found.ndim:
        raise InputError(f"{name}: one number is needed, not {shown(value)}")
    return float(found)


def _has_truth_values(value):
    """Return whether a list holds truth values, which NumPy takes for numbers among others."""
    if isinstance(value, (list, tuple)):
        return any(map(_has_truth_values, value))
    return isinstance(value, (bool, np.bool_))
