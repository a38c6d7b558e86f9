"""Time series of an observable, such as |A_d| after each step of a relaxation."""

import numpy as np

from pgran.errors import InputError

ROUNDING = 1e-12  # relative differences that may be rounding


def checked_series(values, wanted):
    """Return time series as an array (trajectories, steps).

    Not collective.

    Parameters
    ----------
    values : array_like of float, shape (steps,) or (trajectories, steps)
    wanted : str
        What is asked of them, as messages call it.

    Raises
    ------
    InputError
        If they are not finite reals, or never change.
    """
    if np.iscomplexobj(values):
        raise InputError(f"series: the {wanted} is that of a real series, such as |A_d|")
    series = np.atleast_2d(np.asarray(values, dtype=float))
    if series.ndim > 2 or series.size == 0:
        raise InputError(f"series: shape {series.shape} is not trajectories by steps")
    if not np.all(np.isfinite(series)):
        row, step = np.argwhere(~np.isfinite(series))[0]
        raise InputError(f"series: step {step} of trajectory {row} is {series[row, step]}")
    if np.ptp(series) <= ROUNDING * np.abs(series).max():
        raise InputError(f"series: the amplitude never changes, so it has no {wanted}")
    return series
