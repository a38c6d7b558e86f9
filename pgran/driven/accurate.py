"""What is accurate enough. NumPy only."""

import numpy as np


def is_accurate(bound, amplitude, tolerance):
    """Return where errors are small against the true amplitudes; NaN is no bound and not accurate.

    With |A~| the amplitude found and b its bound, |A| >= |A~| - b; so b <= t (|A~| - b) proves the
    relative tolerance t.
    """
    return bound * (1 + tolerance) <= tolerance * np.abs(amplitude)


def below_relative_accuracy(error_bound, amplitude, tolerance):
    """Return which amplitudes have a bound, but miss the relative accuracy."""
    missed = np.isfinite(error_bound) & ~is_accurate(error_bound, amplitude, tolerance)
    return missed.astype(np.int8)
