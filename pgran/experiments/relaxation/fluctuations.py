"""The fluctuations of a relaxation: the power spectrum of an amplitude, and its memory."""

import math

import numpy as np

from pgran.errors import InputError, log
from pgran.experiments.relaxation.record import Memory, Spectrum
from pgran.run.options import REAL, Option
from pgran.store.estimate import MOST, Estimate, jackknife, with_error, with_errors

SPECTRUM = (
    Option("spectrum_fit_min", REAL, 0.01, "lower end of the fit of psi", "cycles/step", above=0),
    Option("spectrum_fit_max", REAL, 0.3, "upper end of the fit of psi", "cycles/step", above=0),
)
FIT = tuple(option.default for option in SPECTRUM)
ROUNDING = 1e-12  # relative differences that may be rounding
LAGS = 60  # of the autocorrelation, evenly spaced in their logarithm

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

MEMORIES_IN_PART = 3  # length of a part that errors are taken from, in M
PARTS_AT_LEAST = 7  # (tests/campaigns/estimates.py)
ONE_SIGMA = 0.8413  # what lies below one standard error of a normal law


def measured(relaxation, window, bonds):
    """Return a relaxation, and its spectrum and memory where it has them; `window` is the fit's."""
    spectrum = _spectrum_of(relaxation, window, bonds)
    remembered = _memory_of(relaxation, bonds) if spectrum else None
    return [record for record in (relaxation, spectrum, remembered) if record]


def _spectrum_of(relaxation, window, bonds):
    """Return the power spectrum of the first detector's amplitude; None, aloud, if it has none."""
    if relaxation.failures:
        log.warning("no spectrum: some steps have no amplitude")
    elif relaxation.at_floor[:, :, 0].any():
        log.warning("no spectrum: some amplitudes have an upper limit only (at_floor)")
    else:
        try:
            return power_spectrum(relaxation.amplitude[:, :, 0], *window, memory=bonds)
        except InputError as error:
            log.warning("no spectrum: %s", error)
    return None


def _memory_of(relaxation, bonds):
    """Return what the first detector's amplitude remembers; None where the series is too short."""
    values = np.abs(relaxation.displacement[:, :, 0])
    if len(values) > 1:  # they know of each other until most bonds are redrawn
        values = values[:, bonds:]
    try:
        series = Series(values, bonds)
    except InputError as error:
        log.info("no memory: %s", error)
        return None
    longest = min(3 * bonds, values.shape[1] // 2)
    lags = np.unique(np.append(0, np.geomspace(1, longest, LAGS).astype(int)))
    order = mean_order(series)
    lowest, highest = bounds(lags, bonds, min(max(order.value, 1.0), bonds))
    estimates = with_errors(
        order=order,
        increment=increment_correlation(series),
        successive=successive_correlation(series),
        correlation=autocorrelation(series, lags),
    )
    return Memory(bonds=bonds, lag=lags, lowest=lowest, highest=highest, **estimates)


def summary(result):
    """Return in words what the fluctuations tell."""
    spectrum = getattr(result, "spectrum", None)
    if spectrum and np.isfinite(spectrum.exponent):
        step, low, high = result.relaxation.step, spectrum.fit_min, spectrum.fit_max
        hertz = f" ({low / step:.3g} to {high / step:.3g} Hz)" if step else ""
        exponent = with_error(spectrum.exponent, spectrum.exponent_error)
        line = f"power spectrum S(f) ~ f^-psi with psi = {exponent} between "
        yield f"{line}{low:g} and {high:g} cycles per step{hertz}"
    memory = getattr(result, "memory", None)
    if memory:
        order = with_error(memory.order, memory.order_error)
        increment = with_error(memory.increment, memory.increment_error)
        line = f"memory: {order} of {memory.bonds} bonds act jointly on average; the amplitude "
        yield f"{line}and its next increment have the correlation {increment}"


def _checked(values, wanted):
    """Return time series (T,) or (R, T) as an array (R, T); raise where they never change."""
    series = np.atleast_2d(np.asarray(values, dtype=float))
    if np.ptp(series) <= ROUNDING * np.abs(series).max():
        raise InputError(f"series: the amplitude never changes, so it has no {wanted}")
    return series


# The power spectrum


def power_spectrum(series, fit_min=0.01, fit_max=0.3, memory=None):
    """Return the power spectrum S(f) ~ f^-psi of a time series and its exponent (paper: powspc).

    The spectrum is Welch's, with Hann windows: between rectangular ones a series that ends
    elsewhere than it began leaks like f^-2, which hides anything steeper. Each segment loses its
    straight line as well; without that an f^-4 spectrum reads 4.1 to 4.6.

    A series of unit steps has no continuous time behind it, and its power laws are powers of
    2 sin(pi f), the gain of a difference, rather than of 2 pi f: a random walk of white steps has
    S = s^2 / (4 sin^2(pi f)) exactly, f^-2 with its aliases summed. So psi is minus the slope of
    log S against log sin(pi f), the log-periodogram regression of Geweke and Porter-Hudak (1983).
    Against log f, as the paper reads it (`exponent_plain`), the same random walk has 1.94 between
    .01 and .3 cycles per step; up to .1 the two differ by .01.

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
    series = _checked(series, "spectrum")
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
    from scipy.signal import periodogram  # here: SciPy takes its time

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


# The memory


class Series:
    """A stationary series of an observable B, and its memory: one of M bonds is redrawn a step.

    `values` are B after each step, shape (T,) or (R, T). Trajectories that start from the same
    bonds know of each other for the first M steps or so, which should be left out.

    Split the variance of B into parts W_k that depend on k bonds jointly (Hoeffding, Ann. Math.
    Stat. 19, 293 (1948); Efron and Stein, Ann. Stat. 9, 586 (1981)). A part survives as long as
    none of its k bonds is drawn:

        C(t) = <dB(0) dB(t)> = sum_k W_k (1 - k/M)^t.

    With the mean order kbar = sum k W_k / sum W_k, from 1 where bonds add up to at most M,

        (1 - kbar/M)^t <= C(t) / C(0) <= (1 - 1/M)^t,
        C(0) - C(1) = <(Delta B)^2> / 2 = C(0) kbar / M.

    The paper asks of its random walk: "Are B and Delta B actually uncorrelated? Are successive
    values for Delta B uncorrelated?" They cannot be, in any stationary series:

        <dB Delta B> = C(1) - C(0) = -C(0) kbar / M,
        <Delta B Delta B'> = 2 C(1) - C(0) - C(2) = -sum_k W_k (k/M)^2,

    but both correlations are small, -sqrt(kbar / 2M) and -<k^2> / (2 kbar M), <k^2> the mean of k^2
    by W_k: what the paper's steps know of each other shows within M steps only.
    """

    def __init__(self, values, bonds):
        self.values, self.bonds = np.atleast_2d(np.asarray(values, dtype=float)), bonds
        trajectories, steps = self.values.shape
        # independent parts of one trajectory
        self.parts = min(max(1, MOST // trajectories), int(steps / (MEMORIES_IN_PART * bonds)))
        if trajectories * self.parts < PARTS_AT_LEAST:
            needed = MEMORIES_IN_PART * bonds * math.ceil(PARTS_AT_LEAST / trajectories)
            raise InputError(
                f"series: {steps} steps (trajectories: {trajectories}) are too few to "
                f"tell the memory of {bonds} bonds with an error; {needed} are needed"
            )
        _checked(self.values, "memory")

    def estimate(self, measure, lags):
        """Return what `measure(C)` comes to, C(t) known at some lags t, with its error.

        Pairs belong to the part that their first member is in. As parts may be few, an error is
        Student's: as often as a normal one is the truth within it.
        """
        from scipy.special import stdtrit  # here: SciPy takes its time

        steps = self.values.shape[1]
        starts = np.arange(self.parts) * steps // self.parts
        deviations = self.values - self.values.mean()  # sums of squares round less
        sums = np.concatenate([_pair_sums(row, starts, lags) for row in deviations])
        whole = sums.sum(axis=0)

        def of_others(part):
            count, first, second, product = whole if part is None else whole - sums[part]
            return measure(product / count - first * second / count**2)

        estimate = jackknife(of_others, len(sums))
        return Estimate(estimate.value, estimate.error * stdtrit(len(sums) - 1, ONE_SIGMA))


def _pair_sums(row, starts, lags):
    """Return how many pairs (t, t + lag) have their t in each part of a row, and their sums:

    of first members, second members and products; shape (parts, 4, lags).
    """
    sums = np.zeros((len(starts), 4, len(lags)))
    for place, lag in enumerate(lags):
        first, second = row[: len(row) - lag], row[lag:]
        pairs = np.zeros((4, len(row)))  # no pair begins among the last
        pairs[:, : len(first)] = np.ones(len(first)), first, second, first * second
        sums[:, :, place] = np.add.reduceat(pairs, starts, axis=1).T
    return sums


def autocorrelation(series, lags):
    """Return C(t) / C(0) at lags from 0 to half of a trajectory, with errors.

    C(0) itself would need a hundred memories for an error: of 20 it comes out small, and its error
    smaller, misses of 1.9 errors.
    """
    return series.estimate(lambda C: C[1:] / C[0], [0, *lags])


def mean_order(series):
    """Return kbar = M <(Delta B)^2> / (2 C(0)), how many bonds act jointly on average."""
    return series.estimate(lambda C: series.bonds * (1 - C[1] / C[0]), [0, 1])


def increment_correlation(series):
    """Return the correlation of B with its increment, <dB Delta B> / sqrt(C(0) <(Delta B)^2>)."""
    return series.estimate(lambda C: -math.sqrt(max(C[0] - C[1], 0.0) / (2 * C[0])), [0, 1])


def successive_correlation(series):
    """Return the correlation of successive increments, <Delta B Delta B'> / <(Delta B)^2>."""
    return series.estimate(lambda C: (2 * C[1] - C[0] - C[2]) / (2 * (C[0] - C[1])), [0, 1, 2])


def bounds(lags, bonds, order):
    """Return the least and the largest C(t) / C(0) that a mean order kbar, from 1 to M, allows.

    The first is Jensen's inequality, equal where all parts have one order; the second holds as no
    part has an order below 1.
    """
    return (1 - order / bonds) ** lags, (1 - 1 / bonds) ** lags
