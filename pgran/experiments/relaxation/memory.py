"""Time series of an observable B, and their memory: what redrawing one of M bonds a step leaves.

Split the variance of B into parts W_k that depend on k bonds jointly (Hoeffding, Ann. Math. Stat.
19, 293 (1948); Efron and Stein, Ann. Stat. 9, 586 (1981)). One of M bonds, drawn uniformly, is
redrawn a step, and a part survives as long as none of its k bonds is drawn:

    C(t) = <dB(0) dB(t)> = sum_k W_k (1 - k/M)^t.

With the mean order kbar = sum k W_k / sum W_k, from 1 where bonds add up to at most M,

    (1 - kbar/M)^t <= C(t) / C(0) <= (1 - 1/M)^t,
    C(0) - C(1) = <(Delta B)^2> / 2 = C(0) kbar / M.

The paper asks of its random walk: "Are B and Delta B actually uncorrelated? Are successive values
for Delta B uncorrelated?" They cannot be, in any stationary series:

    <dB Delta B> = C(1) - C(0) = -C(0) kbar / M,
    <Delta B Delta B'> = 2 C(1) - C(0) - C(2) = -sum_k W_k (k/M)^2,

but both correlations are small, -sqrt(kbar / 2M) and -<k^2> / (2 kbar M), <k^2> the mean of k^2
by W_k: what the paper's steps know of each other shows within M steps only.

Series must be stationary: trajectories that start from the same bonds know of each other for the
first M steps or so, which should be left out.
"""

import math

import numpy as np

from pgran.errors import InputError
from pgran.store.estimate import MOST, Estimate, jackknife

ROUNDING = 1e-12  # relative differences that may be rounding
MEMORIES_IN_PART = 3  # length of a part that errors are taken from, in M
PARTS_AT_LEAST = 7  # (tests/campaigns/estimates.py)
WITHIN = 0.8413  # what lies below one standard error of a normal law


def checked_series(values, wanted):
    """Return time series, of shape (T,) or (R, T), as an array (R, T); R trajectories of T steps.

    Raises InputError if they never change, and so have not what is `wanted` of them.
    """
    series = np.atleast_2d(np.asarray(values, dtype=float))
    if np.ptp(series) <= ROUNDING * np.abs(series).max():
        raise InputError(f"series: the amplitude never changes, so it has no {wanted}")
    return series


class Series:
    """A stationary series of an observable: B after each step, shape (T,) or (R, T); M bonds."""

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
        checked_series(self.values, "memory")

    def estimate(self, measure, longest):
        """Return what `measure(C)` comes to, with its error, C(t) known for t <= `longest`.

        Pairs belong to the part that their first member is in. As parts may be few, an error is
        Student's: as often as a normal one is the truth within it.
        """
        from scipy.special import stdtrit  # here: SciPy takes its time

        steps = self.values.shape[1]
        starts = np.arange(self.parts) * steps // self.parts
        deviations = self.values - self.values.mean()  # sums of squares round less
        sums = np.concatenate([_pair_sums(row, starts, longest) for row in deviations])
        whole = sums.sum(axis=0)
        estimate = jackknife(
            lambda part: measure(_covariance(whole if part is None else whole - sums[part])),
            len(sums),
        )
        return Estimate(estimate.value, estimate.error * stdtrit(len(sums) - 1, WITHIN))


def _pair_sums(row, starts, longest):
    """Return sums over pairs (t, t + lag) by part, shape (parts, 4, longest + 1).

    The four are the number of pairs and the sums of their first members, second members, products.
    """
    lags = np.arange(longest + 1)
    steps, ends = len(row), np.append(starts[1:], len(row))
    size = 1 << int(steps + longest).bit_length()
    transform = np.fft.rfft(row, size)
    total = np.append(0.0, np.cumsum(row))
    out = np.empty((len(starts), 4, longest + 1))
    #  row    0 . . . start [first members] end . . . steps      second members are `lag` later,
    #                                 last <= steps - lag        and must be in the row, too
    for part, (start, end) in enumerate(zip(starts, ends, strict=True)):
        last = np.maximum(np.minimum(end, steps - lags), start)  # firsts are start <= t < last
        out[part, 0] = last - start
        out[part, 1] = total[last] - total[start]
        out[part, 2] = (
            total[np.minimum(last + lags, steps)] - total[np.minimum(start + lags, steps)]
        )
        own = np.zeros(steps)
        own[start:end] = row[start:end]
        # the correlation of the part with the whole row, padded so that it does not wrap around
        out[part, 3] = np.fft.irfft(np.conj(np.fft.rfft(own, size)) * transform, size)[lags]
    return out


def _covariance(sums):
    """Return C(t) from the sums over pairs."""
    count, first, second, product = sums
    return product / count - first * second / count**2


def autocorrelation(series, lags):
    """Return C(t) / C(0) at lags from 0 to half of a trajectory, with errors.

    C(0) itself would need a hundred memories for an error: of 20 it comes out small, and its error
    smaller, misses of 1.9 errors.
    """
    return series.estimate(lambda C: C[lags] / C[0], max(1, *lags))


def mean_order(series):
    """Return kbar = M <(Delta B)^2> / (2 C(0)), how many bonds act jointly on average."""
    return series.estimate(lambda C: series.bonds * (1 - C[1] / C[0]), 1)


def bounds(lags, bonds, order):
    """Return the least and the largest C(t) / C(0) that a mean order kbar, from 1 to M, allows.

    The first is Jensen's inequality, equal where all parts have one order; the second holds as no
    part has an order below 1.
    """
    return (1 - order / bonds) ** lags, (1 - 1 / bonds) ** lags


def increment_correlation(series):
    """Return the correlation of B with its increment, <dB Delta B> / sqrt(C(0) <(Delta B)^2>)."""
    return series.estimate(lambda C: -math.sqrt(max(C[0] - C[1], 0.0) / (2 * C[0])), 1)


def successive_correlation(series):
    """Return the correlation of successive increments, <Delta B Delta B'> / <(Delta B)^2>."""
    return series.estimate(lambda C: (2 * C[1] - C[0] - C[2]) / (2 * (C[0] - C[1])), 2)
