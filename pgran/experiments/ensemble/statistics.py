"""The noise of an ensemble's responses, in windows of frequencies, beside the Gaussian laws.

What is measured is the intensity I = |A|^2 along omega. A moment is taken over the samples at each
frequency, and what follows from it averaged over the window, so that a fall of <I> along omega
counts for nothing. Averages along omega are integrals by the trapezoidal rule, as points may lie
closer here than there. Correlations need equal distances: A is resampled along straight lines for
them. Errors come from leaving out a part of the samples at a time.
"""

import math
from functools import cached_property, partial

import numpy as np
from numpy.typing import ArrayLike

from pgran.arguments import called_right
from pgran.errors import InputError, log
from pgran.experiments.ensemble.record import Ensemble, NoiseStatistics
from pgran.run.numbers import windows_of
from pgran.store.estimate import (
    FEWEST,
    FEWEST_SAMPLES,
    Estimate,
    jackknife_samples,
    told,
    with_errors,
)
from pgran.store.record import ball_names

EDGES = np.append(np.arange(0.0, 4.0, 0.25), np.arange(4.0, 8.5, 0.5))  # of I/<I>
SHIFTS = 60  # at which correlations are stored, as far as half of the window
PARTS = "whole", "incoherent"
NUMBERS = "contrast", "spread", "half_width", "maxima_spacing"  # measured of each part

# Of a complex Gaussian field, the sum of many independent modes: P(I/<I>) = exp(-I/<I>), so that
# <I^2>/<I>^2 = 2 (Goodman, Speckle Phenomena in Optics, 2007, section 3.2); and the standard
# deviation of 10 log10 I in dB (Schroeder, Acustica 4, 594 (1954)).
GAUSSIAN_CONTRAST = 2.0
GAUSSIAN_SPREAD = 10 / math.log(10) * math.pi / math.sqrt(6)
# Maxima of |A| are this times Gamma apart where modes of one width Gamma overlap: the integral of
# Kac and Rice for A = int g(t) exp(-i omega t) dt, <|g|^2> = exp(-Gamma t). It is the 3.91 Hz over
# the reverberation time of Schroeder and Kuttruff, J. Acoust. Soc. Am. 34, 76 (1962), and .981 of
# their shorter formula, pi / sqrt(3).
MAXIMA_SPACING = 1.780084

# Samples from which errors are right: of Gaussian fields in windows of 10 Gamma estimates less the
# truth, over their errors, have a mean within .35 and a deviation below 1.35 there. With 9 samples
# these are -.8 and 1.9 for <I^2>/<I>^2, which few strong samples rule (tests/campaigns/estimates).
SAMPLES_FOR = {"<I^2>/<I>^2": 80, "spread in dB": 20, "half width": 80}
NEAR_EDGE = 0.1  # of an edge: within that its density is counted
POINTS_TO_MAXIMUM = 6  # with fewer, splines miss more than one maximum in a hundred
SPLINE_POINTS = 8  # between two of a curve, to look for its maxima
MOST_POINTS = 1 << 15  # of a curve that is resampled


@called_right
def statistics(ensemble: Ensemble, windows: "ArrayLike") -> NoiseStatistics:
    """Measure the noise of an ensemble's responses (paper: freqres, "noisy").

    Samples that are not good are left out. A measure that cannot be computed, such as that of a
    curve that is not resolved, is NaN, with a warning. Of a complex Gaussian field, the sum of many
    modes of one width Gamma, the contrast <I^2>/<I>^2 is 2, I/<I> has the density exp(-I/<I>), and
    <dI(omega) dI(omega + s)> / <dI^2> = 1 / (1 + (s/Gamma)^2).

    Parameters
    ----------
    ensemble : pgran.results.Ensemble
        Of responses, with their curves.
    windows : array_like of float, shape (n, 2)
        Lowest and highest frequency of each, angular.

    Returns
    -------
    pgran.results.NoiseStatistics

    Raises
    ------
    InputError
        If the ensemble has no curves, or a window lies outside the sweep, or samples are too few.

    Examples
    --------
    >>> omegas = np.linspace(0.4, 0.8, 81)
    >>> made = {"shape": (6, 5), "damping": 0.1}
    >>> many = pgran.ensemble(
    ...     "response", 20, lattice=made, omegas=omegas, detectors=[(2, 3)], keep="curves"
    ... )
    >>> noise = pgran.statistics(many, [(0.4, 0.8)])
    >>> bool(noise.coherent_part[0, 0] < 1)
    True
    """
    if not isinstance(ensemble, Ensemble) or ensemble.displacement is None:
        raise InputError("statistics: no curves; -ensemble_keep curves keeps them")
    windows = windows_of("-statistics_windows", windows, ensemble.omega)
    A = ensemble.displacement[ensemble.good > 0]
    detectors, missing = range(A.shape[2]), {}
    places = [
        [_of_place(ensemble.omega, A[:, :, d], window, d, missing) for d in detectors]
        for window in windows
    ]
    for (name, error), where in missing.items():
        log.warning("no %s in %s: %s", name, "; ".join(where), error)
    arrays = {name: np.array([[d[name] for d in row] for row in places]) for name in places[0][0]}
    noise = NoiseStatistics(
        samples=len(A),
        low=windows[:, 0].copy(),
        high=windows[:, 1].copy(),
        part=np.array(PARTS),
        detector=ensemble.detector,
        edge=EDGES,
        shift=arrays.pop("shift")[:, 0],  # those of a window, whatever the detector is
        **arrays,
    )
    return ensemble.measured(noise)


def _of_place(omega, A, window, detector, missing):
    """Return the arrays of a record, but the first two axes: of one window and detector.

    `missing` gets what there is not, by name and reason the places, each once.
    """
    whole = NoisyCurves(omega, A, window)
    incoherent = NoisyCurves(omega, A, window, incoherent=True)
    where = f"{window[0]:g} to {window[1]:g}, detector {detector}"
    # multiples of the step, where correlations are known: as many steps as leave SHIFTS of them
    omega = whole.uniform.omega
    stride = -(-(len(omega) - 1) // (2 * SHIFTS))
    shifts = stride * (omega[1] - omega[0]) * np.arange(SHIFTS)
    both = [_measure(curves, shifts, where, missing) for curves in (whole, incoherent)]
    coherent = whole.estimate(
        lambda A: whole.average(np.abs(A.mean(axis=0)) ** 2 / (np.abs(A) ** 2).mean(axis=0)),
        whole.amplitude,
    )
    fields = {name: np.array([part[name] for part in both]) for name in both[0]}
    return {"shift": shifts} | with_errors(coherent_part=coherent) | fields


def _measure(curves, shifts, where, missing):
    """Return measures of some curves and errors by name; NaN for what is `missing`."""
    omega = curves.uniform.omega
    known = np.flatnonzero(shifts < omega[len(omega) // 2] - omega[0])
    numbers = contrast, spread, half_width, maxima_spacing
    measures = {measure.__name__: ((), partial(measure, curves)) for measure in numbers}
    measures["density"] = (len(EDGES) - 1,), partial(histogram, curves, EDGES)
    measures["correlation"] = known.shape, partial(correlation, curves, shifts[known])
    estimates = {}
    for name, (shape, measure) in measures.items():
        try:
            estimates[name] = measure()
        except InputError as error:
            missing.setdefault((name.replace("_", " "), str(error)), {})[where] = True
            estimates[name] = Estimate(np.full(shape, np.nan), np.full(shape, np.nan))
    beyond, found = (0, len(shifts) - len(known)), estimates["correlation"]
    pad = partial(np.pad, pad_width=beyond, constant_values=np.nan)
    estimates["correlation"] = Estimate(pad(found.value), pad(found.error))
    return with_errors(**estimates)


def summary(found):
    """Return in words what the noise is like, beside Gaussian laws."""
    for w, d in np.ndindex(found.coherent_part.shape):
        yield (
            f"{ball_names(found.detector)[d]}, {found.low[w]:g} to {found.high[w]:g}: "
            f"{told(found, 'coherent_part', (w, d))} of <|A|^2> is coherent, |<A>|^2"
        )
        for p, part in enumerate(found.part):
            contrast, spread, width, spacing = (told(found, n, (w, d, p)) for n in NUMBERS)
            ratio = found.maxima_spacing[w, d, p] / found.half_width[w, d, p]
            beside = f", {ratio:.3g} half widths ({MAXIMA_SPACING:.3g})" if ratio > 0 else ""
            yield (
                f"  {part}: <I^2>/<I>^2 {contrast} (Gaussian: {GAUSSIAN_CONTRAST:g}), "
                f"spread {spread} dB ({GAUSSIAN_SPREAD:.3g}), half width of the "
                f"correlation {width}, spacing of maxima {spacing}{beside}"
            )


class NoisyCurves:
    """Response curves of one detector in a window of frequencies (low, high), checked.

    `amplitude` is A of the samples, shape (samples, nw), at angular frequencies `omega`, ascending
    at any distances, which reach beyond the window. Samples that are not finite are left out,
    aloud. `incoherent` takes the mean over the samples off A first, for laws of a field without a
    coherent part. An InputError says that too little is left.
    """

    def __init__(self, omega, amplitude, window=None, incoherent=False):
        low, high = omega[[0, -1]] if window is None else window
        inside = (low * (1 - 1e-9) <= omega) & (omega <= high * (1 + 1e-9))
        omega, amplitude = omega[inside], amplitude[:, inside]
        amplitude = amplitude[finite_samples(amplitude)]
        if len(omega) < 3:
            raise InputError(f"window: it needs 3 amplitudes or more, and holds {len(omega)}")
        if len(amplitude) < FEWEST_SAMPLES:
            few = f"means over samples need {FEWEST_SAMPLES}, not {len(amplitude)}"
            raise InputError(f"amplitude: {few}")
        if not np.all(np.any(np.abs(amplitude) ** 2 > 0, axis=0)):
            raise InputError("amplitude: it vanishes, or its square does, in all samples")
        self.omega, self.amplitude, self.incoherent = omega, amplitude, incoherent
        self.samples = len(amplitude)
        gaps = np.diff(omega)  # for the trapezoidal rule
        self.weights = 0.5 * (np.append(gaps, 0.0) + np.append(0.0, gaps))

    def average(self, values):
        """Return the mean over the window of values at its frequencies."""
        return np.average(values, weights=self.weights)

    def estimate(self, measure, data=None):
        """Return the Estimate of `measure(data)`, shape (samples, nw): I unless data are given."""
        data = self.intensity if data is None else data
        return jackknife_samples(lambda some: measure(data[some]), self.samples)

    @cached_property
    def uniform(self):
        """The same curves at equal distances, as close as the closest unless these are too many."""
        gaps, length = np.diff(self.omega), np.ptp(self.omega)
        if np.ptp(gaps) < 1e-6 * gaps.min():
            return self
        count = min(math.ceil(length / gaps.min() * (1 - 1e-9)) + 1, MOST_POINTS)
        omega = np.linspace(self.omega[0], self.omega[-1], count)
        amplitude = np.array([np.interp(omega, self.omega, row) for row in self.amplitude])
        return NoisyCurves(omega, amplitude, None, self.incoherent)

    @cached_property
    def intensity(self):
        """I, shape (samples, nw); without the coherent part if so asked."""
        if not self.incoherent:
            return np.abs(self.amplitude) ** 2
        # taken off once, and not anew for each part of the samples that the jackknife leaves: to
        # first order an error of the mean changes no moment of a circular field
        fields = self.amplitude - self.amplitude.mean(axis=0)
        return np.abs(fields) ** 2 * (self.samples / (self.samples - 1))

    @cached_property
    def maxima(self):
        """How many maxima of |A| each sample has in the window.

        They are those of the cubic splines through Re A and Im A. Of the points themselves, a tenth
        of Gamma apart, one maximum in 50 is not seen: it is too close to another.
        """
        from scipy.interpolate import CubicSpline
        from scipy.signal import argrelmax

        shift = self.amplitude.mean(axis=0) if self.incoherent else 0.0
        points = np.arange(len(self.omega))
        fine = np.arange(points[-1] * SPLINE_POINTS + 1) / SPLINE_POINTS
        field = CubicSpline(self.omega, self.amplitude - shift, axis=1)
        sample, _ = argrelmax(np.abs(field(np.interp(fine, points, self.omega))), axis=1)
        return np.bincount(sample, minlength=self.samples)


def finite_samples(amplitude):
    """Return which samples, the first axis, are finite everywhere; say which are left out."""
    kept = np.isfinite(amplitude).all(axis=tuple(range(1, np.ndim(amplitude))))
    if not np.all(kept):
        log.warning(
            "amplitude: %d of %d samples are left out, sample %d first, as they are not finite",
            *(np.count_nonzero(~kept), len(kept), np.argmin(kept)),
        )
    return kept


def _check_samples(curves, name):
    """Raise where samples are too few for the error of a measure to be right."""
    needed = SAMPLES_FOR[name]
    if curves.samples < needed:
        few = f"{curves.samples} samples are too few for the error of {name}"
        raise InputError(f"amplitude: {few}; {needed} are needed")


def contrast(curves):
    """Return <I^2>/<I>^2; `GAUSSIAN_CONTRAST` for a complex Gaussian field.

    Where few strong samples are missed both it and its spread over samples come out small. The
    inverse <I>^2/<I^2> varies about as much wherever it lies, so the error is taken from that:

        1 / (1/c - e) - c = c (c e) / (1 - c e),    e the error of the inverse, c the value,

    the larger of both sides; NaN if e is as large as the inverse.
    """
    _check_samples(curves, "<I^2>/<I>^2")

    def measure(x):
        return curves.average((x**2).mean(axis=0) / x.mean(axis=0) ** 2)

    value = curves.estimate(measure).value
    relative = value * curves.estimate(lambda x: 1 / measure(x)).error
    return Estimate(value, value * relative / (1 - relative) if relative < 1 else math.nan)


def spread(curves):
    """Return the standard deviation of 10 log10 I in dB; `GAUSSIAN_SPREAD` for Gaussian fields."""
    _check_samples(curves, "spread in dB")
    if np.any(curves.intensity == 0):
        raise InputError("amplitude: one vanishes, and has no level in dB")

    def measure(x):
        level = 10 * np.log10(x)
        level -= level.mean()  # which drops out; without it digits would cancel
        return np.sqrt(curves.average((level**2).mean(axis=0) - level.mean(axis=0) ** 2))

    return curves.estimate(measure)


def correlation(curves, shifts):
    """Return C(s) = <dI(omega) dI(omega + s)> / <dI^2>, dI = I/<I> - 1, at some shifts s.

    Of overlapping modes of one width Gamma it is 1 / (1 + (s/Gamma)^2) (Ericson, Ann. Phys. 23, 390
    (1963); Schroeder, J. Acoust. Soc. Am. 34, 1819 (1962), for rooms). Shifts lie between 0 and
    half of the window, as those beyond have few pairs.
    """
    curves = curves.uniform
    grid = curves.omega[: len(curves.omega) // 2 + 1] - curves.omega[0]
    return curves.estimate(lambda x: np.interp(shifts, grid, _correlations(x)))


def half_width(curves):
    """Return the shift at which the correlation C of I has fallen to 1/2.

    It is Gamma where many modes of that width overlap.
    """
    _check_samples(curves, "half width")
    curves = curves.uniform
    return curves.estimate(lambda x: _first_half(curves, _correlations(x)))


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


def _correlations(intensity):
    """Return C at all shifts up to half of the window, in steps of the grid.

    Sums over all pairs of points at a distance, by Fourier transforms of twice the length, so that
    no pair wraps around. As <dI> over the samples is 0 at each frequency, no mean is taken off.
    """
    points = intensity.shape[1]
    lags = points // 2 + 1
    x = intensity / intensity.mean(axis=0) - 1
    power = np.sum(np.abs(np.fft.rfft(x, 2 * points)) ** 2, axis=0)
    C = np.fft.irfft(power, 2 * points)[:lags] / (points - np.arange(lags)) / len(x)
    if not C[0] > 1e-12:
        raise InputError("amplitude: the intensity is the same everywhere and has no correlation")
    return C / C[0]


def maxima_spacing(curves):
    """Return the mean distance along omega of the maxima of |A|.

    It is `MAXIMA_SPACING` times Gamma where many modes of that width overlap. Every maximum of
    splines through the points counts: a curve must be computed more exactly than it varies from
    point to point.
    """
    length = np.ptp(curves.omega)

    def measure(counts):
        if counts.sum() < 2 * FEWEST:
            few = f"{counts.sum()} maxima of |A| lie in it, {2 * FEWEST} are needed"
            raise InputError(f"window: {few}")
        return len(counts) * length / counts.sum()

    spacing = curves.estimate(measure, curves.maxima)
    points = spacing.value / np.average(np.diff(curves.omega))
    if points < POINTS_TO_MAXIMUM:
        few = f"{points:.2g} points to a maximum of |A| are too few to tell maxima apart"
        raise InputError(f"omega: {few}; {POINTS_TO_MAXIMUM} are needed")
    return spacing


def histogram(curves, edges):
    """Return the density P of I/<I> in bins between ascending edges; of Gaussian fields exp(-x).

    The error is NaN in bins that less than 5 samples reach. As each point is measured by the mean,
    of n independent ones, P is that of n beta(1, n-1) for a Gaussian field: nearer to exp(-x) than
    its error, by a part of order 1/n.
    """
    edges = np.asarray(edges, dtype=float)
    x = curves.intensity / curves.intensity.mean(axis=0)

    def share(x, edges):  # of the points of some samples in each bin
        weights = np.broadcast_to(curves.weights, x.shape)
        return np.histogram(x, edges, weights=weights)[0] / np.sum(weights)

    # The jackknife leaves samples out, and <x> of the rest is no longer 1 but a mean m. Its I/<I>
    # is x/m, an edge e lies at e m. Counted anew, single points would jump over edges; to first
    # order what lies below e grows by e P(e) (m - 1), and e P(e) is what lies within e (1 -+ d),
    # divided by 2 d.
    around = zip((1 - NEAR_EDGE) * edges, (1 + NEAR_EDGE) * edges, strict=True)
    growth = [
        share(x, ends)[0] / (2 * NEAR_EDGE) if 0 < ends[0] < ends[1] < math.inf else 0.0
        for ends in around
    ]

    def measure(x):
        mean = curves.average(x.mean(axis=0))
        return (share(x, edges) + np.diff(growth) * (mean - 1)) / np.diff(edges)

    density = curves.estimate(measure, x)
    bins = np.searchsorted(edges, x, side="right") - 1
    reached = [np.count_nonzero(np.any(bins == n, axis=1)) for n in range(len(edges) - 1)]
    return Estimate(density.value, np.where(np.array(reached) < FEWEST, math.nan, density.error))
