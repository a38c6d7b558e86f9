"""Noisy curves to measure: checked, cut to a window, and how estimates of them get their errors.

Errors come from leaving out a part of the samples at a time, or of one curve a stretch of omega of
several correlation widths (`pgran.store.estimate.jackknife`).
"""

import logging
import math
from functools import cached_property

import numpy as np

from pgran.errors import InputError
from pgran.store.estimate import FEWEST, FEWEST_SAMPLES, Estimate, jackknife, jackknife_samples

log = logging.getLogger("pgran")

# Maxima of |A| are this times Gamma apart where modes of one width Gamma overlap: the integral of
# Kac and Rice for A = int g(t) exp(-i omega t) dt, <|g|^2> = exp(-Gamma t). It is the 3.91 Hz over
# the reverberation time of Schroeder and Kuttruff, J. Acoust. Soc. Am. 34, 76 (1962), and .981 of
# their shorter formula, pi / sqrt(3).
MAXIMA_SPACING = 1.780084

STRETCH = 8  # half widths of the correlation that a stretch of a single curve has at least
MOST_STRETCHES = 20
MOST_POINTS = 1 << 15  # of a curve that is resampled
SPLINE_POINTS = 8  # between two of a curve, to look for its maxima


class NoisyCurves:
    """Response curves of one detector in a window of frequencies (low, high), checked.

    `amplitude` is A of one sample, shape (nw,), or of several, (samples, nw), at angular
    frequencies `omega`, ascending at any distances, which reach beyond the window. What is not
    finite is left out, aloud: samples of many, points of one. `incoherent` takes the mean over the
    samples off A first, for laws of a field without a coherent part. An InputError says that too
    little is left.
    """

    def __init__(self, omega, amplitude, window=None, incoherent=False):
        low, high = omega[[0, -1]] if window is None else window
        amplitude = np.atleast_2d(amplitude)
        inside = (low * (1 - 1e-9) <= omega) & (omega <= high * (1 + 1e-9))
        omega, amplitude = omega[inside], amplitude[:, inside]
        if not np.all(np.isfinite(amplitude)):
            omega, amplitude = _finite(omega, amplitude)
        if len(omega) < 3:
            raise InputError(f"window: it needs 3 amplitudes or more, and holds {len(omega)}")
        if 1 < len(amplitude) < FEWEST_SAMPLES or (incoherent and len(amplitude) == 1):
            alone = "" if incoherent else ", or one curve at a time"
            raise InputError(
                f"amplitude: means over samples need {FEWEST_SAMPLES}, not {len(amplitude)}{alone}"
            )
        if not np.all(np.any(np.abs(amplitude) ** 2 > 0, axis=0 if len(amplitude) > 1 else 1)):
            raise InputError(
                "amplitude: it vanishes, or its square does, in the whole window or in all samples"
            )
        self.omega, self.amplitude, self.incoherent = omega, amplitude, incoherent
        self.samples = len(amplitude)

    @cached_property
    def weights(self):
        """The weights of the trapezoidal rule, shape (nw,)."""
        gaps = np.diff(self.omega)
        return 0.5 * (np.append(gaps, 0.0) + np.append(0.0, gaps))

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
    def length(self):
        """How many half widths Gamma of the correlation the window has; Gamma is told by maxima."""
        gamma = spacing_of_maxima(self.maxima, self.weights) / MAXIMA_SPACING
        return np.ptp(self.omega) / gamma

    @cached_property
    def stretches(self):
        """Into how many stretches a single curve is cut, and by what that makes errors too small.

        With a Lorentzian correlation of half width Gamma, the variance of a mean over the length
        x Gamma is that of a point times

            V(x) = 2 / x^2 (x atan x - ln(1 + x^2) / 2)

        Of n independent stretches it would be V(x/n) / n. A stretch knows a little of its
        neighbours, so it is more, and the spread of the stretches about their mean is less: the
        jackknife finds (V(x/n) - V(x)) / (n - 1) instead of V(x).
        """
        x = self.length
        count = min(int(x / STRETCH), MOST_STRETCHES)
        if count < FEWEST:
            raise InputError(
                f"window: it is {x:.3g} half widths of the correlation long, and "
                f"{FEWEST * STRETCH} are needed to tell errors from one curve"
            )

        def variance(x):
            return 2 / x**2 * (x * math.atan(x) - 0.5 * math.log1p(x**2))

        # errors, so the root of that ratio
        whole, part = variance(x), variance(x / count)
        return count, math.sqrt(whole * (count - 1) / (part - whole))

    @cached_property
    def stretch(self):
        """The number of the stretch that each frequency of a single curve belongs to."""
        count, low, length = self.stretches[0], self.omega[0], np.ptp(self.omega)
        return np.minimum((self.omega - low) / length * count, count - 1).astype(int)

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
        """How many maxima of |A| lie next to each frequency, shape (samples, nw).

        They are those of the cubic splines through Re A and Im A. Of the points themselves, a tenth
        of Gamma apart, one maximum in 50 is not seen: it is too close to another.
        """
        from scipy.interpolate import CubicSpline
        from scipy.signal import argrelmax

        shift = self.amplitude.mean(axis=0) if self.incoherent else 0.0
        fine = np.interp(
            np.arange((len(self.omega) - 1) * SPLINE_POINTS + 1) / SPLINE_POINTS,
            np.arange(len(self.omega)),
            self.omega,
        )
        field = CubicSpline(self.omega, self.amplitude - shift, axis=1)(fine)
        sample, at = argrelmax(np.abs(field), axis=1)
        counts = np.zeros(self.amplitude.shape, dtype=int)
        # point i of the curve is point SPLINE_POINTS i of the fine one: the nearest i
        np.add.at(counts, (sample, (at + SPLINE_POINTS // 2) // SPLINE_POINTS), 1)
        return counts

    def estimate(self, measure, data=None, *, slow=True):
        """Return the Estimate of `measure(data, weights)`, shapes (samples, nw) and (nw,).

        The data are I unless given. `slow` measures are correlated along omega as far as I is, so
        that `stretches` are not quite independent: products and counts forget sooner.
        """
        data, w = self.intensity if data is None else data, self.weights
        if self.samples > 1:
            return jackknife_samples(lambda some: measure(data[some], w), self.samples)
        count, factor = self.stretches

        def without(stretch):
            return measure(data, w if stretch is None else w * (self.stretch != stretch))

        estimate = jackknife(without, count)
        return Estimate(estimate.value, estimate.error * (factor if slow else 1.0))


def finite_samples(amplitude):
    """Return which samples, the first axis, are finite everywhere; say which are left out."""
    kept = np.isfinite(amplitude).all(axis=tuple(range(1, np.ndim(amplitude))))
    if not np.all(kept):
        log.warning(
            "amplitude: %d of %d samples are left out, sample %d first, as they are not finite",
            *(np.count_nonzero(~kept), len(kept), np.argmin(kept)),
        )
    return kept


def _finite(omega, amplitude):
    """Return the samples that are finite, or the points of a single one; say what is left out."""
    if len(amplitude) > 1:
        return omega, amplitude[finite_samples(amplitude)]
    finite = np.isfinite(amplitude[0])
    log.warning(
        "amplitude: %d of %d points are left out, as they are not finite; the first is at %g",
        *(np.count_nonzero(~finite), finite.size, omega[np.argmin(finite)]),
    )
    return omega[finite], amplitude[:, finite]


def spacing_of_maxima(maxima, weights):
    """Return the mean distance of the maxima next to points that have a weight."""
    count = int(np.sum(maxima[:, weights > 0]))
    if count < 2 * FEWEST:
        raise InputError(f"window: {count} maxima of |A| lie in it, {2 * FEWEST} are needed")
    return len(maxima) * np.sum(weights) / count
