"""Statistics of normal modes: their spacings, and how their widths overlap."""

import contextlib
import math

import numpy as np

from pgran.errors import InputError
from pgran.medium.springs import stiffness_matrix
from pgran.store.estimate import FEWEST, FEWEST_SAMPLES, MOST, Estimate, mean_of, with_error

REGIMES = ("below .3", 0.0, 0.3), ("from .3 to 1", 0.3, 1.0), ("above 1", 1.0, math.inf)  # omega_mx
# Mean of min(s, s') / max(s, s') of neighbouring spacings: extended modes, whose matrices are as
# good as those of the Gaussian orthogonal ensemble, and independent levels, as of localized modes,
# 2 ln 2 - 1 (Oganesyan and Huse, Phys. Rev. B 75, 155111 (2007); Atas, Bogomolny, Giraud and Roux,
# Phys. Rev. Lett. 110, 084101 (2013)).
GOE_SPACING_RATIO = 0.5307
POISSON_SPACING_RATIO = 2 * math.log(2) - 1
RATIOS_IN_PART = 10  # a ratio knows of its neighbours, with which it shares spacings
BELOW_ZERO = 1e-12  # of |K|: so that a K with modes at rest can be factored


def spacings(spectra, unit):
    """Yield in words how the modes of samples keep apart, in three ranges of frequencies.

    Nothing of ranges with too few modes, or where three of them coincide. `spectra` are all
    frequencies of each sample, or those of an interval, `unit` is omega_mx.
    """
    ratios = []
    for name, *ends in REGIMES:
        with contextlib.suppress(InputError):
            ratio = spacing_ratio(spectra, [end * unit for end in ends])
            ratios.append(f"{with_error(ratio.value, ratio.error)} {name}")
    if ratios:
        yield (
            f"mean ratio of neighbouring spacings {', '.join(ratios)} omega_mx (extended modes "
            f"{GOE_SPACING_RATIO:.3f}, localized ones {POISSON_SPACING_RATIO:.3f})"
        )


def spacing_ratio(values, window=None):
    """Return the mean ratio of neighbouring spacings, the smaller to the larger one, an Estimate.

    `values` are all eigenvalues of one sample, or of several, in the window, ascending, of one
    symmetry class, since others know nothing of each other; frequencies do alike. The error is that
    over samples where there are 8 or more, else over parts of the spectra. Raises an InputError if
    values do not ascend, three of them coincide, or there are too few.
    """
    low, high = (-math.inf, math.inf) if window is None else window
    _check_window(low, high)
    spectra = [np.asarray(spectrum, dtype=float) for spectrum in _samples(values)]
    if any(s.ndim != 1 or not np.all(np.isfinite(s)) for s in spectra):
        raise InputError("values: every spectrum must be an array of finite numbers")
    ratios = [_ratios(s[(s >= low) & (s <= high)]) for s in spectra]
    long = [r for r in ratios if len(r) >= RATIOS_IN_PART]
    if len(long) >= FEWEST_SAMPLES:
        parts = [r for r in ratios if len(r)]
    else:
        parts = [p for r in long for p in np.array_split(r, min(len(r) // RATIOS_IN_PART, MOST))]
    if len(parts) < FEWEST:
        few = f"{sum(map(len, ratios))} ratios of spacings are too few"
        raise InputError(f"values: {few}; {FEWEST * RATIOS_IN_PART} are needed")
    # the mean of all ratios, its error by how far the sums of the parts are from their shares of it
    sums, counts = np.array([r.sum() for r in parts]), np.array([len(r) for r in parts])
    mean, number = sums.sum() / counts.sum(), len(parts)
    deviation = sums - mean * counts
    error = math.sqrt(number / (number - 1) * np.sum(deviation**2)) / counts.sum()
    return Estimate(float(mean), float(error))


def _ratios(values):
    """Return the ratios of neighbouring spacings of one spectrum."""
    spacing = np.diff(values)
    if np.any(spacing < 0):
        raise InputError("values: eigenvalues must ascend")
    larger = np.maximum(spacing[1:], spacing[:-1])
    if np.any(larger == 0):
        at = values[np.argmin(larger)]
        raise InputError(f"values: three modes coincide at {at:g}, so spacings have no ratio there")
    return np.minimum(spacing[1:], spacing[:-1]) / larger


def _samples(values):
    """Return the arrays of samples, one if values are those of a single sample."""
    return [values] if not len(values) or np.ndim(values[0]) == 0 else values


def _check_window(low, high):
    """Raise an InputError unless a window is an interval."""
    if not low < high:
        raise InputError(f"window: {low:g} to {high:g} is no interval")


def first_mode(lattice):
    """Return the frequency of the lowest normal mode, 0 if it is one at rest or unstable.

    By ARPACK, around 0, without a certificate.
    """
    from scipy.sparse.linalg import eigsh

    K = stiffness_matrix(lattice).tocsc()
    size = abs(K).sum(axis=1).max()
    if lattice.size < 3 or size == 0:  # too few for an iteration
        square = np.linalg.eigvalsh(K.toarray())[0]
    else:
        begun = np.random.default_rng(0).standard_normal(lattice.size)  # ARPACK's own changes
        shifted = {"sigma": -BELOW_ZERO * size, "v0": begun}
        square = eigsh(K, 1, return_eigenvectors=False, **shifted)[0]
    return math.sqrt(square / lattice.mass) if square > BELOW_ZERO * size else 0.0


def modal_overlap(omega, width, window):
    """Return the modal overlap: mean width times density of modes, sum Gamma_i / (high - low).

    Below 1 modes stand alone; far above, A is a complex Gaussian field. `omega` and `width`, shape
    (nm,), or sequences of these, one a sample, are of all modes in the window. The Estimate's error
    is that over samples where there are 8 or more. For fewer it takes parts of the window as
    independent, and what differs between neighbouring ones as their error; modes that repel each
    other are more regular than that. Raises an InputError if there are too few modes.
    """
    low, high = window
    _check_window(low, high)
    omega, width = _samples(omega), _samples(width)
    inside = sum(np.count_nonzero((low <= np.asarray(w)) & (np.asarray(w) <= high)) for w in omega)
    parts = min(MOST, inside // (2 * len(omega)))
    if parts < FEWEST:
        raise InputError(
            f"window: modes in it: {inside}, samples: {len(omega)}; each needs {2 * FEWEST} modes"
        )
    pairs = zip(omega, width, strict=True)
    sums = np.array([np.histogram(w, parts, window, weights=gamma)[0] for w, gamma in pairs])
    if len(sums) >= FEWEST_SAMPLES:
        total = mean_of(sums.sum(axis=1))
    else:
        mean = sums.mean(axis=0)
        total = Estimate(mean.sum(), math.sqrt(parts * 0.5 * np.mean(np.diff(mean) ** 2)))
    return Estimate(float(total.value / (high - low)), float(total.error / (high - low)))
