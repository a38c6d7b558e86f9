"""Measures of a noisy response curve: the intensity I = |A|^2 along omega, of one sample or many.

With several samples a moment is taken over the samples at each frequency, and what follows from it
averaged over the window, so that a fall of <I> along omega counts for nothing. Of one curve moments
are taken over the window, which should be so narrow that <I> hardly changes in it.

Averages along omega are integrals by the trapezoidal rule, as points may lie closer here than
there. Correlations need equal distances: A is resampled along straight lines for them.

    curves = NoisyCurves(response.omega, response.displacement[:, 0], window=(0.5, 0.7))
    width = half_width(curves)  # width.value, width.error
"""

import math

import numpy as np

from pgran.errors import InputError
from pgran.experiments.ensemble.noise import spacing_of_maxima
from pgran.store.estimate import FEWEST, Estimate

# Of a complex Gaussian field, the sum of many independent modes: P(I/<I>) = exp(-I/<I>), so that
# <I^2>/<I>^2 = 2 (Goodman, Speckle Phenomena in Optics, 2007, section 3.2); and the standard
# deviation of 10 log10 I in dB (Schroeder, Acustica 4, 594 (1954)).
GAUSSIAN_CONTRAST = 2.0
GAUSSIAN_SPREAD = 10 / math.log(10) * math.pi / math.sqrt(6)
# Samples from which errors are right: of Gaussian fields in windows of 10 Gamma estimates less the
# truth, over their errors, have a mean within .35 and a deviation below 1.35 there. With 9 samples
# these are -.8 and 1.9 for <I^2>/<I>^2, which few strong samples rule (tests/campaigns/estimates).
SAMPLES_FOR = {"<I^2>/<I>^2": 80, "spread in dB": 20, "half width": 80}
LENGTH_FOR_WIDTH = 800  # half widths of a single curve; of 600 these are -.6 and 1.6
NEAR = 0.1  # of an edge: within that its density is counted
POINTS_TO_MAXIMUM = 6  # with fewer, splines miss more than one maximum in a hundred


def _moment(x, weights):
    """Return the mean over the samples at each frequency; of one curve that over the window."""
    return x.mean(axis=0) if len(x) > 1 else np.average(x[0], weights=weights)


def _along(y, weights):
    """Return the mean over the window of a function of `_moment`."""
    return np.average(y, weights=weights) if np.ndim(y) else y


def _enough(curves, name):
    """Raise where samples are too few for the error of a measure to be right."""
    needed = SAMPLES_FOR[name]
    if 1 < curves.samples < needed:
        few = f"{curves.samples} samples are too few for the error of {name}"
        raise InputError(f"amplitude: {few}; {needed} are needed")


def contrast(curves):
    """Return <I^2>/<I>^2; `GAUSSIAN_CONTRAST` for a complex Gaussian field.

    Where few strong samples are missed both it and its spread over samples come out small. The
    inverse <I>^2/<I^2> varies about as much wherever it lies, so the error is taken from that:

        1 / (1/c - e) - c = c (c e) / (1 - c e),    e the error of the inverse, c the value,

    the larger of both sides; NaN if e is as large as the inverse.
    """
    _enough(curves, "<I^2>/<I>^2")

    def measure(x, w):
        return _along(_moment(x**2, w) / _moment(x, w) ** 2, w)

    value = curves.estimate(measure).value
    relative = value * curves.estimate(lambda x, w: 1 / measure(x, w)).error
    return Estimate(value, value * relative / (1 - relative) if relative < 1 else math.nan)


def spread(curves):
    """Return the standard deviation of 10 log10 I in dB; `GAUSSIAN_SPREAD` for Gaussian fields."""
    _enough(curves, "spread in dB")
    if np.any(curves.intensity == 0):
        raise InputError("amplitude: one vanishes, and has no level in dB")

    def measure(x, w):
        level = 10 * np.log10(x)
        level -= level.mean()  # which drops out; without it digits would cancel
        return np.sqrt(_along(_moment(level**2, w) - _moment(level, w) ** 2, w))

    return curves.estimate(measure)


def correlation(curves, shifts):
    """Return C(s) = <dI(omega) dI(omega + s)> / <dI^2>, dI = I/<I> - 1, at some shifts s.

    Of overlapping modes of one width Gamma it is 1 / (1 + (s/Gamma)^2) (Ericson, Ann. Phys. 23, 390
    (1963); Schroeder, J. Acoust. Soc. Am. 34, 1819 (1962), for rooms). Shifts lie between 0 and
    half of the window, as those beyond have few pairs.
    """
    curves = curves.uniform
    grid = curves.omega[: len(curves.omega) // 2 + 1] - curves.omega[0]
    return curves.estimate(lambda x, w: np.interp(shifts, grid, _correlations(x, w)), slow=False)


def half_width(curves):
    """Return the shift at which the correlation C of I has fallen to 1/2.

    It is Gamma where many modes of that width overlap. A single curve must be `LENGTH_FOR_WIDTH`
    long.
    """
    _enough(curves, "half width")
    if curves.samples == 1 and curves.length < LENGTH_FOR_WIDTH:
        raise InputError(
            f"window: it is {curves.length:.3g} half widths of the correlation long, and "
            f"{LENGTH_FOR_WIDTH} are needed to tell them from one curve"
        )
    curves = curves.uniform
    return curves.estimate(lambda x, w: _first_half(curves, _correlations(x, w)), slow=False)


def _first_half(curves, C):
    """Return the first shift at which a correlation is 1/2, up to a quarter of the window."""
    C = C[: len(C) // 2 + 1]  # beyond, only windows in which it happens to fall early have one
    at = int(np.argmax(C < 0.5))
    if C[at] >= 0.5:
        raise InputError("window: the correlation of I does not fall to 1/2 within a quarter of it")
    if at < 3:
        raise InputError("omega: I is not resolved, its correlation is 1/2 within two points")
    step = curves.omega[1] - curves.omega[0]
    # between points 1/C is a straight line over the square of the shift, as of a Lorentzian; past
    # 10 the line is no better than its end
    before, after = 1 / C[at - 1], 1 / max(C[at], 0.1)
    squares = (at - 1) ** 2 + (2 - before) / (after - before) * (at**2 - (at - 1) ** 2)
    return step * math.sqrt(squares)


def _correlations(intensity, weights):
    """Return C at all shifts up to half of the window, in steps of the grid.

    With x = dI and m = 1 where a point has a weight, 0 elsewhere,

        C(s) ~ sum m x(omega) x(omega + s) / n - sum m x(omega) sum m x(omega + s) / n^2,

    sums over the n pairs, m of the first point, of all samples.
    """
    points = intensity.shape[1]
    lags, size = points // 2 + 1, 2 * points  # twice as long, so that no pair wraps around
    mask = (weights > 0).astype(float)
    x = intensity / _moment(intensity, mask) - 1
    if len(x) > 1:
        x -= x.mean(axis=0)
    transform = np.fft.rfft(x, size)
    firsts_only = transform if np.all(mask) else np.fft.rfft(mask * x, size)

    def pairs(products):
        return np.fft.irfft(products, size)[:lags]

    def firsts(y):  # sums over the first points that have a partner at each lag
        return np.cumsum(y)[points - 1 - np.arange(lags)]

    count = len(x) * firsts(mask)
    product = pairs(np.sum(np.conj(firsts_only) * transform, axis=0)) / count
    seconds = pairs(np.conj(np.fft.rfft(mask, size)) * transform.sum(axis=0))
    means = firsts((mask * x).sum(axis=0)) * seconds / count**2
    C = product - means
    if not C[0] > 1e-12:
        raise InputError("amplitude: the intensity is the same everywhere and has no correlation")
    return C / C[0]


def maxima_spacing(curves):
    """Return the mean distance along omega of the maxima of |A|.

    It is `noise.MAXIMA_SPACING` times Gamma where many modes of that width overlap. Every maximum
    of splines through the points counts: a curve must be computed more exactly than it varies from
    point to point.
    """
    spacing = curves.estimate(spacing_of_maxima, curves.maxima, slow=False)
    points = spacing.value / np.average(np.diff(curves.omega))
    if points < POINTS_TO_MAXIMUM:
        few = f"{points:.2g} points to a maximum of |A| are too few to tell maxima apart"
        raise InputError(f"omega: {few}; {POINTS_TO_MAXIMUM} are needed")
    return spacing


def histogram(curves, edges):
    """Return the density P of I/<I> in bins between ascending edges; of Gaussian fields exp(-x).

    The error is NaN in bins that less than 5 samples, or stretches of one curve, reach. As each
    point is measured by the mean, of n independent ones, P is that of n beta(1, n-1) for a Gaussian
    field: nearer to exp(-x) than its error, by a part of order 1/n.
    """
    edges = np.asarray(edges, dtype=float)
    x = curves.intensity / _moment(curves.intensity, curves.weights)
    size = len(x) * np.sum(curves.weights)

    def share(x, w, edges):
        return np.histogram(x, edges, weights=np.broadcast_to(w, x.shape))[0] / size

    # The jackknife leaves data out, and <x> of the rest is no longer 1 but a mean m. Its I/<I> is
    # x/m, an edge e lies at e m. Counted anew, single points would jump over edges; to first order
    # what lies below e grows by e P(e) (m - 1), and e P(e) is what lies within e (1 -+ NEAR),
    # divided by 2 NEAR.
    around = zip((1 - NEAR) * edges, (1 + NEAR) * edges, strict=True)
    growth = [
        share(x, curves.weights, ends)[0] / (2 * NEAR) if 0 < ends[0] < ends[1] < math.inf else 0.0
        for ends in around
    ]

    def measure(x, w):
        rest = len(x) * np.sum(w) / size
        mean = _along(_moment(x, w), w)
        return (share(x, w, edges) / rest + np.diff(growth) * (mean - 1)) / np.diff(edges)

    density = curves.estimate(measure, x, slow=False)
    bins = np.searchsorted(edges, x, side="right") - 1
    owner = curves.stretch if curves.samples == 1 else np.arange(curves.samples)[:, None]
    owner = np.broadcast_to(owner, bins.shape)
    reached = np.array([len(np.unique(owner[bins == n])) for n in range(len(edges) - 1)])
    return Estimate(density.value, np.where(reached < FEWEST, math.nan, density.error))
