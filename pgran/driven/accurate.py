"""What bounds a response, and what is accurate enough. NumPy only."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Limits:
    """Norms from which bounds of a response follow, in the medium's own unit.

    |S(i omega) x|_2 >= omega stability |x|_2, with stability = lambda_min(C). The norms of
    |K|, |C| and |M|, entries taken by magnitude, all damping in C, are no more than `stiffness`,
    `damping` and `mass`; |f(s)|_2 is at most drive + |s| drive_damping.
    """

    stability: float
    stiffness: float
    damping: float
    mass: float
    drive: float
    drive_damping: float


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
