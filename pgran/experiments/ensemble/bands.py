"""What many samples of a curve have in common: mean, its error, median, and a band."""

import numpy as np

# Names of what `over_samples` returns: a tenth of the samples lies below `low`, and above `high`.
STATISTICS = ("mean", "error", "median", "low", "high")
PARTS = (0.5, 0.1, 0.9)


def over_samples(curves):
    """Return the STATISTICS of curves over samples, shape (5, ...).

    Not collective. What is not finite in a sample, a delay that is not known, say, is left out at
    that place; where fewer than two samples are left all is NaN.

    Parameters
    ----------
    curves : numpy.ndarray, shape (samples, ...)
    """
    if len(curves) < 2:
        return np.full((len(STATISTICS), *curves.shape[1:]), np.nan)
    known = np.isfinite(curves)
    count = np.count_nonzero(known, axis=0)
    with np.errstate(all="ignore"):
        mean = np.where(known, curves, 0.0).sum(axis=0) / count
        squares = np.where(known, curves - mean, 0.0) ** 2
        error = np.sqrt(squares.sum(axis=0) / (count - 1) / count)
        ordered = np.sort(np.where(known, curves, np.inf), axis=0)
        found = np.stack([mean, error, *(_quantile(ordered, count, part) for part in PARTS)])
    return np.where(count > 1, found, np.nan)


def _quantile(ordered, count, part):
    """Return a quantile of the first `count` of sorted samples, linear between neighbours."""
    place = np.maximum(count - 1, 0) * part
    below = np.floor(place).astype(int)
    above = np.minimum(below + 1, np.maximum(count - 1, 0))
    low, high = (np.take_along_axis(ordered, n[None], axis=0)[0] for n in (below, above))
    return low + (place - below) * (high - low)
