"""Phases of amplitudes over a sweep, and the straight line that gives a phase velocity."""

import numpy as np


def phase_of_sign(displacement):
    """Return the phase of amplitudes that are real, as without damping: 0 or pi; NaN where unknown.

    Not collective. Its jumps are changes of sign, to be followed by no unwrapping.
    """
    sign = np.where(displacement.real < 0, np.pi, 0.0)
    return np.where(np.isnan(displacement), np.nan, sign)


def unwrap(displacement):
    """Return the phase along the first axis without its jumps, from the lowest frequency on.

    Not collective. Frequencies that have no amplitude keep NaN and are passed over.
    """
    phase = np.angle(displacement)
    for column in phase.T:
        known = np.isfinite(column)
        column[known] = np.unwrap(column[known])
    return phase


def fit_line(x, y):
    """Return slope and intercept of the straight line through some points; y may hold NaN.

    Not collective. NaN where less than three points are known, or where these are too close
    together, by 1e-10, to tell a slope from rounding.
    """
    known = np.isfinite(y)
    x, y = x[known], y[known]
    if len(x) < 3 or np.ptp(x) < 1e-10 * np.abs(x).max():
        return np.nan, np.nan
    middle = x.mean()
    slope, height = np.polyfit(x - middle, y, 1)
    return slope, height - slope * middle


def fit_phase(x, phase):
    """Return slope and intercept of the phase (n, nd) of each detector over x, by `fit_line`.

    Not collective.
    """
    return np.transpose([fit_line(x, column) for column in phase.T])


def phase_velocity(slope, distance):
    """Return the velocity in spacings times omega_mx (paper: phsvel).

    Not collective. The slope of the phase is in rad per omega_mx, the distance from the driven wall
    in spacings.
    """
    with np.errstate(divide="ignore"):
        return distance / np.abs(slope)
