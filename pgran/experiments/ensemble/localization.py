"""Transport from many samples: amplitude against depth, attenuation length, delay."""

import logging
import math
from dataclasses import dataclass

import numpy as np

from pgran.errors import InputError
from pgran.store.estimate import FEWEST_SAMPLES, Estimate, jackknife_samples, mean_of

log = logging.getLogger("pgran")

FALLS = 2.0  # errors that a slope is negative by, for an attenuation length


@dataclass(frozen=True, eq=False)
class Profile:
    """A mean over samples, at each depth.

    Attributes
    ----------
    depth : numpy.ndarray, shape (nx,)
        Distances from what is driven, ascending.
    mean : pgran.store.estimate.Estimate
        Arrays of shape (..., nx).
    """

    depth: np.ndarray
    mean: Estimate


@dataclass(frozen=True, eq=False)
class Attenuation:
    """The straight line <ln|A|> = a - depth / length, by frequency.

    Attributes
    ----------
    rate : pgran.store.estimate.Estimate
        1 / length, arrays of shape (nw,).
    length : pgran.store.estimate.Estimate
        Of the amplitude; the intensity falls in half of it. NaN where <ln|A|> does not fall by
        `FALLS` errors at least.
    """

    rate: Estimate
    length: Estimate


def log_amplitude_profile(depth, amplitude):
    """Return <ln|A|> against depth, by frequency.

    Not collective. The typical amplitude: it averages itself where <|A|^2> is ruled by few samples
    (Sheng, Introduction to Wave Scattering, Localization and Mesoscopic Phenomena, 2006, ch. 8).

    Parameters
    ----------
    depth : array_like of float, shape (nd,)
        Of the detectors; those at one depth are averaged in each sample.
    amplitude : array_like of complex, shape (samples, nw, nd)
        Samples that have amplitudes that are not finite are left out, aloud.

    Returns
    -------
    Profile
        Of shape (nw, nx).

    Raises
    ------
    InputError
        If shapes do not fit, samples are too few, or an amplitude vanishes.
    """
    depth, amplitude = _checked(depth, amplitude)
    depths, levels = _by_depth(depth, _logarithms(amplitude))
    return Profile(depths, mean_of(levels))


def intensity_profile(depth, amplitude):
    """Return <|A|^2> against depth, by frequency. Not collective.

    Parameters, result and errors are those of `log_amplitude_profile`.
    """
    depth, amplitude = _checked(depth, amplitude)
    depths, intensity = _by_depth(depth, np.abs(amplitude) ** 2)
    return Profile(depths, mean_of(intensity))


def attenuation(depth, amplitude):
    """Return the attenuation length by frequency.

    Not collective. Depths weigh by the variance of their <ln|A|>. The line through the means is the
    mean of the samples' lines, and its error is that over samples: depths of one sample are not
    independent, so weights alone would claim too much. Depths should be those where the fall is
    straight: not next to the walls, and not below the first mode, where walls alone make it.

    Parameters
    ----------
    depth, amplitude
        As in `log_amplitude_profile`.

    Returns
    -------
    Attenuation

    Raises
    ------
    InputError
        As there, and if there are less than three depths.
    """
    depth, amplitude = _checked(depth, amplitude)
    depths, levels = _by_depth(depth, _logarithms(amplitude))
    _enough_depths(depths)
    variance = levels.var(axis=0)
    floor = 1e-12 * np.maximum(variance.max(axis=1, keepdims=True), np.finfo(float).tiny)
    weights = 1 / np.maximum(variance, floor)
    middle = np.sum(weights * depths, axis=1, keepdims=True) / weights.sum(axis=1, keepdims=True)
    along = weights * (depths - middle)
    rate = mean_of(-np.sum(along * levels, axis=2) / np.sum(along * (depths - middle), axis=1))
    with np.errstate(all="ignore"):
        falls = rate.value > FALLS * rate.error
        length = np.where(falls, 1 / rate.value, math.nan)
        error = np.where(falls, rate.error / rate.value**2, math.nan)
    return Attenuation(rate, Estimate(length, error))


def delay_profile(depth, amplitude, derivative, over=None):
    """Return the mean group delay against depth, each sample's weighted by its intensity.

        tau = < |A|^2 (-d arg A / d omega) > / < |A|^2 > = -< Im(A* dA/domega) > / < |A|^2 >,

    by frequency. Not collective. For a complex Gaussian field this is the mean delay itself, whose
    own distribution has no variance (van Tiggelen, Sebbah, Stoytchev and Genack, Phys. Rev. E 59,
    7166 (1999)); where modes of one width Gamma overlap it is 1/Gamma.

    Parameters
    ----------
    depth : array_like of float, shape (nd,)
    amplitude, derivative : array_like of complex, shape (samples, nw, nd)
        A and dA/domega.
    over : array_like of float, shape (n, nw), optional
        Averages over frequencies, one a row, that are wanted in place of single frequencies.

    Returns
    -------
    Profile
        Of shape (nw, nx), or (n, nx).

    Raises
    ------
    InputError
        As `log_amplitude_profile`.
    """
    depths, measure, samples = _delays(depth, amplitude, derivative, over)
    return Profile(depths, jackknife_samples(measure, samples))


def delay_per_depth(depth, amplitude, derivative, over=None):
    """Return by how much the mean group delay grows with depth, 1 / speed.

    Not collective. The slope of the straight line through `delay_profile`, all depths alike, with
    the error over samples. What stands and rings between walls has none; what propagates has.

    Returns
    -------
    pgran.store.estimate.Estimate
        Arrays of shape (nw,), or (n,).

    Raises
    ------
    InputError
        As `attenuation`. Parameters are those of `delay_profile`.
    """
    depths, measure, samples = _delays(depth, amplitude, derivative, over)
    _enough_depths(depths)
    away = depths - depths.mean()
    return jackknife_samples(lambda some: measure(some) @ away / np.sum(away**2), samples)


def _delays(depth, amplitude, derivative, over):
    """Return depths, what the mean delays of some samples are, and how many samples there are."""
    derivative = np.asarray(derivative, dtype=complex)
    if np.shape(amplitude) != derivative.shape:
        raise InputError(
            f"derivative: shape {derivative.shape} is not that of the amplitudes, "
            f"{np.shape(amplitude)}"
        )
    finite = np.where(np.isfinite(derivative), np.asarray(amplitude, dtype=complex), math.nan)
    kept = np.all(np.isfinite(finite), axis=(1, 2)) if finite.ndim == 3 else slice(None)
    depth, amplitude = _checked(depth, finite)
    flow = -np.imag(np.conj(amplitude) * derivative[kept])
    depths, flow = _by_depth(depth, flow)
    intensity = _by_depth(depth, np.abs(amplitude) ** 2)[1]
    if not np.all(intensity.any(axis=0)):
        raise InputError("amplitude: it vanishes in all samples")

    def measure(some):
        late = flow[some].mean(axis=0) / intensity[some].mean(axis=0)
        return late if over is None else over @ late

    return depths, measure, len(flow)


def _enough_depths(depths):
    if len(depths) < 3:
        raise InputError(f"depth: {len(depths)} depths are too few for a line; 3 are needed")


def _checked(depth, amplitude):
    """Return depths, and the amplitudes of samples that are finite."""
    depth, amplitude = np.asarray(depth, dtype=float), np.asarray(amplitude, dtype=complex)
    if amplitude.ndim != 3 or depth.shape != amplitude.shape[2:] or amplitude.size == 0:
        raise InputError(
            f"amplitude: shape {amplitude.shape} is not samples by frequencies by "
            f"{depth.size} detectors"
        )
    if not np.all(np.isfinite(depth)):
        raise InputError("depth: every one must be finite")
    kept = np.all(np.isfinite(amplitude), axis=(1, 2))
    if not np.all(kept):
        log.warning(
            "amplitude: %d of %d samples are left out, as some amplitudes are not finite; "
            "sample %d is the first",
            *(np.count_nonzero(~kept), len(kept), np.argmin(kept)),
        )
    if np.count_nonzero(kept) < FEWEST_SAMPLES:
        raise InputError(
            f"amplitude: {np.count_nonzero(kept)} samples are too few; {FEWEST_SAMPLES} are needed"
        )
    return depth, amplitude[kept]


def _logarithms(amplitude):
    """Return ln|A|."""
    size = np.abs(amplitude)
    if np.any(size == 0):
        sample, frequency, detector = np.argwhere(size == 0)[0]
        raise InputError(
            f"amplitude: that of sample {sample}, frequency {frequency}, detector {detector} "
            "vanishes and has no logarithm"
        )
    return np.log(size)


def _by_depth(depth, numbers):
    """Return the depths there are, and the mean of the detectors at each."""
    depths, place = np.unique(depth, return_inverse=True)
    share = (place[:, None] == np.arange(len(depths))) / np.bincount(place)
    return depths, numbers @ share
