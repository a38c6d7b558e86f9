"""The power spectrum S(f) of amplitude time series and its exponent psi, S(f) ~ f^-psi.

The spectrum is Welch's, with Hann windows: between rectangular ones a series that ends elsewhere
than it began leaks like f^-2, which hides anything steeper. Each segment loses its straight line
as well; without that an f^-4 spectrum reads 4.1 to 4.6.

A series of unit steps has no continuous time behind it, and its power laws are powers of
2 sin(pi f), the gain of a difference, rather than of 2 pi f: a random walk of white steps has
S = s^2 / (4 sin^2(pi f)) exactly, f^-2 with its aliases summed. So psi is minus the slope of log S
against log sin(pi f), the log-periodogram regression of Geweke and Porter-Hudak (1983). Against
log f, as the paper reads it (`exponent_plain`), the same random walk has 1.94 between .01 and .3
cycles per step; up to .1 the two differ by .01.
"""

import logging
import math

import numpy as np
from scipy.signal import periodogram

from pgran.errors import InputError
from pgran.experiments.relaxation.memory import ROUNDING, checked_series
from pgran.experiments.relaxation.record import Spectrum

log = logging.getLogger("pgran")

# The main lobe of a Hann window is 2 frequencies wide to either side and raises f^-psi by
# psi (psi+1) / (6 j^2) at the j-th frequency of a segment: 1.6 % at the 8th for psi = 2.
LOWEST_USED, LOWEST_WANTED = 8, 16
GROUPS, FEWEST = 20, 4  # parts of the series for the error bar: wanted, needed
BINS_PER_DECADE = 10
CORNERS_ABOVE = 5  # the local slope of a series of one memory is 2 / (1 + 1/25) there
ALIASED = 0.44  # sin(pi f) / (pi f) < 1 / sqrt(2): most of a random walk's power is aliased
# Memories that errors need: of 2 exponents miss by 2.1 errors (rms), of 5 by 1.3, of 10 by 1.2.
MEMORIES = 10
FLATTER, FLATTER_ERRORS = 0.25, 5  # slope missing at the low end that is warned about; in errors


def power_spectrum(series, fit_min=0.01, fit_max=0.3, memory=None):
    """Return the power spectrum of a time series and its exponent (paper: powspc).

    The fit is by least squares through the means of log S and log sin(pi f) in bins evenly spaced
    in log f. Powers are averaged over segments before logarithms are taken, whose bias is then the
    same at all frequencies and spares the slope. The standard error is a jackknife over successive
    parts of the trajectories, or over whole ones; it holds as long as the memory is shorter than a
    part. At the paper's parameters seeds differ from their mean by .9 error bars (rms) for 10^5
    steps, by 1.2 for 2 10^4.

    `series`, (R, T) or (T,), is |A_d| after each step of R independent trajectories; the window of
    the fit is in cycles per step; `memory` is the longest correlation time in steps: n, if one of n
    bonds is redrawn a step. The exponent is withheld, NaN, aloud, where all trajectories together
    are shorter than `MEMORIES` of it. A window that reaches where the series is flat or aliased is
    warned about. Raises InputError if the series is too short for the window, or constant.
    """
    series = checked_series(series, "spectrum")
    segment = _segment_length(*series.shape, fit_min, fit_max)
    frequency, parts, segments = _powers(series, segment)
    total = parts.sum(axis=0)
    power = total / segments

    window = (frequency >= fit_min) & (frequency <= fit_max)
    f, others = frequency[window], (total - parts)[:, window]
    if np.any(others <= ROUNDING * segments * power[window]):
        raise InputError(
            "-relax_steps: amplitudes change in one part of the series only: take more steps"
        )
    means = _means_of_bins(f, fit_min, fit_max)
    weights = _slope_weights(f, means)
    exponent, plain, flatter = -np.log(power[window]) @ weights
    replicas = -np.log(others) @ weights  # the jackknife's: each leaves out one part
    error, _, flatter_error = math.sqrt(len(replicas) - 1) * np.std(replicas, axis=0)
    if memory is not None and series.size < MEMORIES * memory:
        log.warning(
            "no exponent psi: %d steps (trajectories: %d) are too few for a memory of %g; take %d",
            *(series.size, len(series), memory, math.ceil(MEMORIES * memory)),
        )
        exponent = plain = error = math.nan
    else:
        _warn(fit_min, fit_max, memory, flatter, flatter_error)
    law = np.log(power[window]) + exponent * np.log(2 * np.sin(np.pi * f))
    return Spectrum(
        exponent=float(exponent),
        exponent_error=float(error),
        exponent_plain=float(plain),
        scale=math.exp(means.mean(axis=0) @ law),
        fit_min=float(fit_min),
        fit_max=float(fit_max),
        segment=segment,
        frequency=frequency,
        power=power,
    )


def _segment_length(trajectories, steps, fit_min, fit_max):
    """Return the steps of a segment: `LOWEST_WANTED` periods of `fit_min`, or down to LOWEST_USED.

    Shorter ones are taken where there would be fewer than `GROUPS`; they overlap by half.
    """
    check_window(fit_min, fit_max)
    shortest, longest = (math.ceil(n / (2 * fit_min)) for n in (LOWEST_USED, LOWEST_WANTED))
    needed = (math.ceil(FEWEST / trajectories) + 1) * shortest
    if steps < needed:
        raise InputError(
            f"-relax_steps: {steps} amplitudes (trajectories: {trajectories}) are too few for a "
            f"spectrum above {fit_min} cycles per step; at least {needed:.9g} are needed"
        )
    half = steps // (math.ceil(GROUPS / trajectories) + 1)
    return 2 * min(max(half, shortest), longest)


def check_window(fit_min, fit_max):
    """Raise InputError unless an exponent can be fitted in a window."""
    if not 1e-300 < fit_min < 0.5:
        raise InputError(f"-spectrum_fit_min: must lie between 1e-300 and .5, not {fit_min}")
    if not 2 * fit_min <= fit_max <= 0.5:
        raise InputError(
            f"-spectrum_fit_max: must lie between {2 * fit_min} and .5 cycles/step, not {fit_max}"
        )


def _powers(series, segment):
    """Return frequencies, summed powers of the parts of all trajectories, number of segments."""
    trajectories, steps = series.shape
    count = (steps - segment) // (segment // 2) + 1
    groups = min(math.ceil(GROUPS / trajectories), count)
    starts = np.arange(groups) * count // groups
    # of a trajectory   |<- segment ->|         each segment begins at the middle of the one before;
    #                          |<- segment ->|  `starts`: which segment is the first one of a part
    parts = []
    for row in series:
        pieces = np.lib.stride_tricks.sliding_window_view(row, segment)[:: segment // 2]
        frequency, powers = periodogram(pieces, window="hann", detrend="linear")
        parts.append(np.add.reduceat(powers, starts, axis=0))
    # A line hides f = 0, and f = 1/2 is counted once where the others are counted twice.
    return frequency[1:-1], np.concatenate(parts)[:, 1:-1], trajectories * count


def _means_of_bins(f, fit_min, fit_max):
    """Return weights (bins, nf) that average over bins evenly spaced in log f."""
    bins = max(3, round(BINS_PER_DECADE * math.log10(fit_max / fit_min)))
    edges = np.geomspace(fit_min, fit_max, bins + 1)[1:-1]
    member = np.searchsorted(edges, f, side="right") == np.arange(bins)[:, None]
    return member / member.sum(axis=1, keepdims=True)


def _slope_weights(f, means):
    """Return weights (nf, 3) of log S: slopes over log sin(pi f), log f, and what the first misses.

    The third is by how much the slope in the lowest third of the bins is smaller than in all.
    """

    def weights(means, abscissa):  # of least squares: slope = sum x y / sum x^2 over bins
        x = means @ abscissa
        x -= x.mean()
        return x @ means / (x @ x)

    sine = np.log(np.sin(np.pi * f))
    slope = weights(means, sine)
    low = weights(means[: max(2, len(means) // 3)], sine)
    return np.stack([slope, weights(means, np.log(f)), slope - low], axis=1)


def _warn(fit_min, fit_max, memory, flatter, flatter_error):
    """Warn of a window that reaches the flat low end or the aliased high end of a spectrum."""
    if memory is not None and fit_min * 2 * math.pi * memory < CORNERS_ABOVE:
        log.warning(
            "-spectrum_fit_min: %g is less than %g times the corner 1/(2 pi %g) = %.2g cycles per "
            "step, below which a series of this memory is flat; the exponent will be too small",
            *(fit_min, CORNERS_ABOVE, memory, 1 / (2 * math.pi * memory)),
        )
    if flatter > max(FLATTER, FLATTER_ERRORS * flatter_error):
        log.warning(
            "-spectrum_fit_min: near %g cycles per step the slope is smaller by %.2f +- %.2f than "
            "in the whole window; the exponent will be too small",
            *(fit_min, flatter, flatter_error),
        )
    if fit_max > ALIASED:
        log.warning(
            "-spectrum_fit_max: above %g cycles per step most of the power may be aliased from "
            "above 1/2; the exponent holds only for a series without anything between steps",
            ALIASED,
        )
