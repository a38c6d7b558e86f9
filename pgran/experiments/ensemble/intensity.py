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
from pgran.experiments.ensemble.noise import MAXIMA_SPACING, NoisyCurves, spacing_of_maxima
from pgran.store.estimate import FEWEST, Estimate

__all__ = [
    "GAUSSIAN_CONTRAST",
    "GAUSSIAN_SPREAD",
    "MAXIMA_SPACING",
    "NoisyCurves",
    "contrast",
    "correlation",
    "gaussian_distribution",
    "half_width",
    "histogram",
    "lorentzian",
    "maxima_spacing",
    "mean_intensity",
    "spread",
]

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
NEAR = 0.1  # of an edge: where the density at it is taken from
POINTS_TO_MAXIMUM = 6  # with fewer, splines miss more than one maximum in a hundred


def gaussian_distribution(x):
    """Return exp(-x), the density of x = I/<I> of a complex Gaussian field. Not collective."""
    return np.exp(-np.asarray(x))


def lorentzian(shift, gamma):
    """Return 1 / (1 + (shift/gamma)^2), the correlation of I where many modes overlap.

    Not collective. Of overlapping modes of one width Gamma (Ericson, Ann. Phys. 23, 390 (1963);
    Schroeder, J. Acoust. Soc. Am. 34, 1819 (1962), for rooms).
    """
    return 1 / (1 + (np.asarray(shift) / gamma) ** 2)


def _moment(x, weights):
    """Return the mean over the samples at each frequency; of one curve that over the window."""
    return x.mean(axis=0) if len(x) > 1 else np.average(x[0], weights=weights)


def _along(y, weights):
    """Return the mean over the window of what `_moment` has found."""
    return np.average(y, weights=weights) if np.ndim(y) else y


def _enough(curves, name):
    """Raise where samples are too few for a measure with an error that is right."""
    needed = SAMPLES_FOR[name]
    if 1 < curves.samples < needed:
        raise InputError(
            f"amplitude: {curves.samples} samples are too few for the error of {name}; {needed} "
            "are needed"
        )


def mean_intensity(curves):
    """Return <I> over samples and window. Not collective."""
    return curves.estimate(lambda x, w: _along(_moment(x, w), w))


def contrast(curves):
    """Return <I^2>/<I>^2; `GAUSSIAN_CONTRAST` for a complex Gaussian field.

    Not collective. Where few strong samples are missed both it and its spread over samples come out
    small. The inverse <I>^2/<I^2> varies about as much wherever it lies, so the error is taken
    from that, and is the larger of the two that one of the inverse makes; NaN if that is as large
    as the inverse.

    Raises
    ------
    InputError
        If samples are fewer than `SAMPLES_FOR` has.
    """
    _enough(curves, "<I^2>/<I>^2")

    def measure(x, w):
        return _along(_moment(x**2, w) / _moment(x, w) ** 2, w)

    value = curves.estimate(measure).value
    part = value * curves.estimate(lambda x, w: 1 / measure(x, w)).error
    return Estimate(value, value * part / (1 - part) if part < 1 else math.nan)


def spread(curves):
    """Return the standard deviation of 10 log10 I in dB.

    Not collective. `GAUSSIAN_SPREAD` for a complex Gaussian field.

    Raises
    ------
    InputError
        If an amplitude vanishes, or samples are fewer than `SAMPLES_FOR` has.
    """
    _enough(curves, "spread in dB")
    if np.any(curves.intensity == 0):
        raise InputError("amplitude: one vanishes, and has no level in dB")

    def measure(x, w):
        level = 10 * np.log10(x)
        level -= level.mean()
        return np.sqrt(_along(_moment(level**2, w) - _moment(level, w) ** 2, w))

    return curves.estimate(measure)


def correlation(curves, shifts):
    """Return C(s) = <dI(omega) dI(omega + s)> / <dI^2>, dI = I/<I> - 1, at some shifts.

    Not collective. `lorentzian` where many modes of one width overlap.

    Parameters
    ----------
    curves : NoisyCurves
    shifts : array_like of float, shape (n,)
        From 0 to half of the window.

    Raises
    ------
    InputError
        If a shift is outside that.
    """
    curves, shifts = curves.uniform, np.asarray(shifts, dtype=float)
    grid = curves.omega[: len(curves.omega) // 2 + 1] - curves.omega[0]
    if not np.all((shifts >= 0) & (shifts <= grid[-1])):
        raise InputError(f"shifts: must lie between 0 and half of the window, {grid[-1]:g}")
    return curves.estimate(lambda x, w: np.interp(shifts, grid, _correlations(x, w)), slow=False)


def half_width(curves):
    """Return the shift at which the correlation C of I has fallen to 1/2.

    Not collective. Gamma where many modes of that width overlap. Between points 1/C is a straight
    line over the square of the shift, as it is for a Lorentzian.

    Raises
    ------
    InputError
        If it has not within a quarter of the window, or has at once: the curve is not resolved; or
        if samples are fewer than `SAMPLES_FOR` has, a single curve shorter than `LENGTH_FOR_WIDTH`.
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
    """Return the first shift at which a correlation is 1/2, up to a quarter of the window.

    Beyond, only windows in which it happens to fall early would have one.
    """
    C = C[: len(C) // 2 + 1]
    at = int(np.argmax(C < 0.5))
    if C[at] >= 0.5:
        raise InputError(
            "window: the correlation of the intensity does not fall to 1/2 within a quarter of it"
        )
    if at < 3:
        raise InputError(
            "omega: the correlation of the intensity falls to 1/2 within two points, so the curve "
            "is not resolved"
        )
    step = curves.omega[1] - curves.omega[0]
    before, after = 1 / C[at - 1], 1 / max(C[at], 0.1)  # past 10 the line is no better than its end
    squares = (at - 1) ** 2 + (2 - before) / (after - before) * (at**2 - (at - 1) ** 2)
    return step * math.sqrt(squares)


def _correlations(intensity, weights):
    """Return C at all shifts up to half of the window, in steps of the grid.

    Pairs count whose first point has a weight: sums over them of products and of both members.
    """
    points = intensity.shape[1]
    lags, size = points // 2 + 1, 2 * points
    kept = (weights > 0).astype(float)
    x = intensity / _moment(intensity, kept) - 1
    if len(x) > 1:
        x -= x.mean(axis=0)
    transform = np.fft.rfft(x, size)
    masked = transform if np.all(kept) else np.fft.rfft(kept * x, size)

    def pairs(products):
        return np.fft.irfft(products, size)[:lags]

    def firsts(y):  # of what has a partner
        return np.cumsum(y)[points - 1 - np.arange(lags)]

    count = len(x) * firsts(kept)
    product = pairs(np.sum(np.conj(masked) * transform, axis=0)) / count
    seconds = pairs(np.conj(np.fft.rfft(kept, size)) * transform.sum(axis=0))
    means = firsts((kept * x).sum(axis=0)) * seconds / count**2
    C = product - means
    if not C[0] > 1e-12:
        raise InputError("amplitude: the intensity is the same everywhere and has no correlation")
    return C / C[0]


def maxima_spacing(curves):
    """Return the mean distance along omega of the maxima of |A|.

    Not collective. `MAXIMA_SPACING` times Gamma where many modes of that width overlap. Every
    maximum of splines through the points counts: a curve must be computed more exactly than it
    varies from point to point.

    Raises
    ------
    InputError
        If there are too few maxima, or too few points to each of them.
    """
    found = curves.estimate(spacing_of_maxima, curves.maxima, slow=False)
    points = found.value / np.average(np.diff(curves.omega))
    if points < POINTS_TO_MAXIMUM:
        raise InputError(
            f"omega: {points:.2g} points to a maximum of |A| are too few to tell maxima apart; "
            f"{POINTS_TO_MAXIMUM} are needed"
        )
    return found


def histogram(curves, edges):
    """Return the density P of I/<I> in bins; `gaussian_distribution` for a complex Gaussian field.

    Not collective. The error is NaN in bins that less than 5 samples, or stretches of one curve,
    reach. As each point is measured by the mean, of n independent ones, P is that of n beta(1, n-1)
    for a Gaussian field: nearer to exp(-x) than its error, by a part of order 1/n.

    Parameters
    ----------
    curves : NoisyCurves
    edges : array_like of float, shape (n + 1,)
        Of the bins, ascending.

    Returns
    -------
    Estimate
        Arrays of shape (n,).
    """
    edges = np.asarray(edges, dtype=float)
    if edges.ndim != 1 or len(edges) < 2 or not np.all(np.diff(edges) > 0):
        raise InputError("edges: two at least are needed, ascending")

    x = curves.intensity / _moment(curves.intensity, curves.weights)
    size = len(x) * np.sum(curves.weights)

    def part(x, w, edges):
        return np.histogram(x, edges, weights=np.broadcast_to(w, x.shape))[0] / size

    # By how much more lies below an edge as <I> grows: counted anew, it would jump.
    ends = ((1 - NEAR) * edges, (1 + NEAR) * edges)
    growth = [
        part(x, curves.weights, pair)[0] / (2 * NEAR) if 0 < pair[0] < pair[1] < math.inf else 0.0
        for pair in zip(*ends, strict=True)
    ]

    def measure(x, w):
        kept = len(x) * np.sum(w) / size
        mean = _along(_moment(x, w), w)
        return (part(x, w, edges) / kept + np.diff(growth) * (mean - 1)) / np.diff(edges)

    found = curves.estimate(measure, x, slow=False)
    bins = np.searchsorted(edges, x, side="right") - 1
    single = curves.samples == 1
    owner = curves.stretch if single else np.arange(curves.samples)[:, None]
    owner, count = np.broadcast_to(owner, bins.shape), len(edges) - 1
    reached = [len(np.unique(owner[bins == number])) for number in range(count)]
    return Estimate(found.value, np.where(np.array(reached) < FEWEST, math.nan, found.error))
