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

but both correlations are small, -sqrt(kbar / 2M) and -<k^2> / (2 kbar M): what the paper's steps
know of each other shows within M steps only.

Series must be stationary: trajectories that start from the same bonds know of each other for the
first M steps or so, which should be left out.
"""

import math
from dataclasses import dataclass

import numpy as np

from pgran.errors import InputError
from pgran.store.estimate import MOST, Estimate, jackknife

ROUNDING = 1e-12  # relative differences that may be rounding
MEMORIES_IN_PART = 3  # length of a part that errors are taken from, in M
PARTS_AT_LEAST = 7  # (tests/campaigns/estimates.py)
WITHIN = 0.8413  # what lies below one standard error of a normal law


def checked_series(values, wanted):
    """Return time series, of shape (T,) or (R, T), as an array (R, T); R trajectories of T steps.

    Raises InputError if they are not finite reals, or never change, so that they have not what is
    `wanted` of them.
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


@dataclass(frozen=True, eq=False)
class Series:
    """A stationary series of an observable: B after each step, shape (T,) or (R, T); M bonds.

    Raises InputError as `checked_series` does, and if it is too short for errors.
    """

    values: np.ndarray
    bonds: int

    def __post_init__(self):
        """Check the values."""
        values = checked_series(self.values, "memory")
        object.__setattr__(self, "values", values)
        if self.bonds < 1:
            raise InputError(f"bonds: there must be one at least, not {self.bonds}")
        if len(values) * self._parts_of_one < PARTS_AT_LEAST:
            needed = MEMORIES_IN_PART * self.bonds * math.ceil(PARTS_AT_LEAST / len(values))
            raise InputError(
                f"series: {values.shape[1]} steps (trajectories: {len(values)}) are too few to "
                f"tell the memory of {self.bonds} bonds with an error; {needed} are needed"
            )

    @property
    def _parts_of_one(self):
        """How many independent parts a trajectory has."""
        trajectories, steps = self.values.shape
        return min(max(1, MOST // trajectories), int(steps / (MEMORIES_IN_PART * self.bonds)))

    def estimate(self, measure, longest):
        """Return what `measure(C)` comes to, with its error, C(t) known for t <= `longest`.

        Pairs belong to the part that their first member is in. As parts may be few, an error is
        Student's: as often as a normal one is the truth within it.
        """
        from scipy.special import stdtrit  # here: SciPy takes its time

        steps, parts = self.values.shape[1], self._parts_of_one
        if longest > steps // 2:
            raise InputError(f"lags: must lie between 0 and {steps // 2}, not {longest}")
        starts = np.arange(parts) * steps // parts
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
    lags = np.asarray(lags)
    if lags.size == 0 or lags.dtype.kind not in "iu" or np.any(lags < 0):
        raise InputError("lags: whole numbers of steps are needed, not negative")
    return series.estimate(lambda C: C[lags] / C[0], max(1, int(lags.max())))


def mean_order(series):
    """Return kbar = M <(Delta B)^2> / (2 C(0)), how many bonds act jointly on average.

    From 1, where bonds only add up, to M. It is the rate of forgetting at t = 0.
    """
    return series.estimate(lambda C: series.bonds * (1 - C[1] / C[0]), 1)


def bounds(lags, bonds, order):
    """Return the least and the largest C(t) / C(0) that a mean order kbar, from 1 to M, allows.

    ((1 - kbar/M)^t, (1 - 1/M)^t): the first is Jensen's inequality, equal where all parts have one
    order; the second holds as no part has an order below 1.
    """
    if not 1 <= order <= bonds:
        raise InputError(f"order: kbar must lie between 1 and the number of bonds, not {order:g}")
    lags = np.asarray(lags)
    return (1 - order / bonds) ** lags, (1 - 1 / bonds) ** lags


def increment_correlation(series):
    """Return the correlation coefficient of B with its increment, -sqrt(kbar / 2M).

    <dB Delta B> / sqrt(<dB^2> <(Delta B)^2>) = -sqrt((C(0) - C(1)) / (2 C(0))).
    """
    return series.estimate(lambda C: -math.sqrt(max(C[0] - C[1], 0.0) / (2 * C[0])), 1)


def successive_correlation(series):
    """Return the correlation coefficient of successive increments, -<k^2> / (2 kbar M).

    (2 C(1) - C(0) - C(2)) / (2 (C(0) - C(1))), with <k^2> = sum k^2 W_k / sum W_k.
    """
    return series.estimate(lambda C: (2 * C[1] - C[0] - C[2]) / (2 * (C[0] - C[1])), 2)
