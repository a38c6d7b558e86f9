"""Amplitudes: what bounds their errors, which are accurate enough, and their phases. NumPy only.

The straight line through a phase over a sweep gives a phase velocity.
"""

from dataclasses import dataclass

import numpy as np

from pgran.store.estimate import counted
from pgran.store.record import attribute

# Where the curve stays within this part of the amplitude of the straight line between two points,
# its phase turns as that line's does.
CERTAIN_DEVIATION = 0.25
FIT_BLOCKS = 10  # of the window of a fit, each several resonances wide
LARGEST_BEND = 2.0  # of a line: its slope in one half of the window over that in the other


@dataclass(frozen=True, eq=False)
class Limits:
    """Norms from which bounds of a response follow, in the medium's own unit.

    |S(i omega) x|_2 >= omega stability |x|_2, with stability = lambda_min(C). The norms of
    |K|, |C| and |M|, entries taken by magnitude, all damping in C, are no more than `stiffness`,
    `damping` and `mass`; |f(s)|_2 is at most drive + |s| drive_damping.
    """

    stability: float = attribute("lambda_min(C)", "sqrt(k m)")
    stiffness: float = attribute("bound of the norm of |K|", "k")
    damping: float = attribute("bound of the norm of |C|", "sqrt(k m)")
    mass: float = attribute("bound of the norm of |M|", "m")
    drive: float = attribute("|f(s)| <= drive + |s| drive_damping", "k")
    drive_damping: float = attribute("see drive", "sqrt(k m)")


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


def phase_of(displacement, damped):
    """Return the phase of amplitudes over a sweep, shape (n, nd); NaN where these are unknown.

    It has no jumps, from the lowest frequency on. Amplitudes without damping are real: their phase
    jumps between 0 and pi where their sign changes, which is to be followed by no unwrapping.
    """
    if not damped:
        sign = np.where(displacement.real < 0, np.pi, 0.0)
        return np.where(np.isnan(displacement), np.nan, sign)
    phase = np.angle(displacement)
    for column in phase.T:
        finite = np.isfinite(column)
        column[finite] = np.unwrap(column[finite])
    return phase


def fit_line(x, y):
    """Return slope and intercept of the straight line through some points; y may hold NaN.

    NaN where less than three points are known, or where rounding hides a slope.
    """
    finite = np.isfinite(y)
    x, y = x[finite], y[finite]
    if len(x) < 3 or np.ptp(x) < 1e-10 * np.abs(x).max():
        return np.nan, np.nan
    middle = x.mean()
    slope, height = np.polyfit(x - middle, y, 1)
    return slope, height - slope * middle


@dataclass(frozen=True)
class PhaseLine:
    """The straight line through a phase between two x, or why there is none; NaN without a line."""

    slope: float = np.nan
    slope_error: float = np.nan
    intercept: float = np.nan
    low: float = np.nan
    high: float = np.nan
    why_not: str = ""


def fit_phase(x, phase, line_error, low, high):
    """Fit the straight line to a phase, if it is one, its turns certain over the whole window.

    The line is that of least squares along the curve, whose points may lie closer here than there.
    What it misses is correlated over the width of a resonance; so the standard error is that of
    `FIT_BLOCKS` parts of the window, `low` to `high`, taken as independent.

    `x` (n,) are frequencies in units of omega_mx, `phase` is unwrapped, NaN where unknown, and
    `line_error` is how far the curve leaves the straight line from the point before.
    """
    if not len(x) or x[0] > low * (1 + 1e-9) or x[-1] < high * (1 - 1e-9):
        why = f"the sweep does not cover the window of the fit, {low:g} to {high:g} omega_mx"
        return PhaseLine(why_not=f"{why} (-phase_fit_min, -phase_fit_max)")
    # Rounding of the window's ends leaves no point out. Neighbours across an end count as well.
    inside = (low * (1 - 1e-9) <= x) & (x <= high * (1 + 1e-9))
    between = (x[1:] > low * (1 + 1e-9)) & (x[:-1] < high * (1 - 1e-9))
    certain = (line_error[1:] <= CERTAIN_DEVIATION) & np.isfinite(phase[1:] - phase[:-1])
    uncertain = np.flatnonzero(between & ~certain)
    if uncertain.size:
        first = uncertain[0]
        why = f"the phase is not certain between {x[first]:.6g} and {x[first + 1]:.6g} omega_mx"
        return PhaseLine(why_not=why + and_more(uncertain.size - 1))
    x, phase = x[inside], phase[inside]
    if len(x) < FIT_BLOCKS or np.ptp(x) < 1e-10 * x[-1]:
        why = f"the window of the fit holds {len(x)} frequencies, and {FIT_BLOCKS} apart are needed"
        return PhaseLine(why_not=why)
    slope, intercept, along = _least_squares(x, phase)
    middle = 0.5 * (x[0] + x[-1])
    place = np.searchsorted(x, middle)
    halved = np.insert(x, place, middle), np.insert(phase, place, np.interp(middle, x, phase))
    (lower, *_), (upper, *_) = (
        _least_squares(*(part[half] for part in halved))
        for half in (slice(place + 1), slice(place, None))
    )
    less, more = sorted([abs(lower), abs(upper)])
    if not (lower * upper > 0 and more <= LARGEST_BEND * less):
        why = f"its slope is {lower:.4g} in the lower half of the window, {upper:.4g} in the upper"
        return PhaseLine(why_not=f"the phase is not a straight line: {why} (rad per omega_mx)")
    missed = along * (phase - intercept - slope * x)
    block = np.minimum((x - x[0]) / (x[-1] - x[0]) * FIT_BLOCKS, FIT_BLOCKS - 1).astype(int)
    spread = np.sum(np.bincount(block, missed, FIT_BLOCKS) ** 2) * FIT_BLOCKS / (FIT_BLOCKS - 2)
    return PhaseLine(slope, np.sqrt(spread) / (along @ x), intercept, x[0], x[-1])


def _least_squares(x, phase):
    """Return slope and intercept of a line along a curve, and each point's lever for the slope."""
    gaps = np.diff(x)
    weights = np.append(gaps, 0.0) + np.append(0.0, gaps)  # of the trapezoidal rule
    middle = np.average(x, weights=weights)
    along = weights * (x - middle)
    slope = along @ phase / (along @ x)
    return slope, np.average(phase, weights=weights) - slope * middle, along


def and_more(count):
    """Say in words that a place is not the only one."""
    return f", and in {counted(count, 'more place')}" if count else ""


def group_delay(amplitude, derivative, error_bound, derivative_bound):
    """Return -d arg A / d omega, and a bound of its error, from A, A' and bounds a, b of theirs.

    A'/A is wrong by at most (b + |A'/A| a) / (|A| - a); NaN and infinite where A may vanish.
    """
    with np.errstate(all="ignore"):
        ratio = derivative / amplitude
        room = np.abs(amplitude) - error_bound
        bound = 1.01 * (derivative_bound + np.abs(ratio) * error_bound) / room
    bounded = (room > 0) & np.isfinite(bound)
    return np.where(bounded, -ratio.imag, np.nan), np.where(bounded, bound, np.inf)
