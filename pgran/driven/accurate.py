"""What is accurate enough. NumPy only."""

import numpy as np


def is_accurate(bound, amplitude, tolerance):
    """Return whether errors are small against the true amplitudes.

    Parameters
    ----------
    bound : numpy.ndarray of float
        Of the absolute error; NaN, which is not accurate, where there is none.
    amplitude : numpy.ndarray of complex, the shape of `bound`
        As computed.
    tolerance : float
        Relative to the true amplitude.
    """
    return bound * (1 + tolerance) <= tolerance * np.abs(amplitude)


def below_relative_accuracy(error_bound, amplitude, tolerance):
    """Return which amplitudes have a bound, but miss the relative accuracy.

    Parameters are those of `is_accurate`.
    """
    missed = np.isfinite(error_bound) & ~is_accurate(error_bound, amplitude, tolerance)
    return missed.astype(np.int8)
