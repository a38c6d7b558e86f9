"""Statistics of normal modes: their spacings, their widths, and how these overlap."""

import math

import numpy as np

from pgran.errors import InputError
from pgran.store.estimate import FEWEST, FEWEST_SAMPLES, MOST, Estimate, mean_of

# Mean of min(s, s') / max(s, s') of neighbouring spacings: extended modes, whose matrices are as
# good as those of the Gaussian orthogonal ensemble, and independent levels, as of localized modes,
# 2 ln 2 - 1 (Oganesyan and Huse, Phys. Rev. B 75, 155111 (2007); Atas, Bogomolny, Giraud and Roux,
# Phys. Rev. Lett. 110, 084101 (2013)).
GOE_SPACING_RATIO = 0.5307
POISSON_SPACING_RATIO = 2 * math.log(2) - 1
RATIOS_IN_PART = 10  # a ratio knows of its neighbours, with which it shares spacings
NUMBERS_AT_ONCE = 1 << 22
BELOW_ZERO = 1e-12  # of |K|: so that a K with modes at rest can be factored


def spacing_ratio(values, window=None):
    """Return the mean ratio of neighbouring spacings, the smaller to the larger one.

    Not collective. `GOE_SPACING_RATIO`, `POISSON_SPACING_RATIO`. It needs no density of modes, and
    eigenvalues or their square roots do alike.

    Parameters
    ----------
    values : array_like of float, shape (nm,), or sequence of these
        All eigenvalues, or frequencies, of one sample or of several in the window, ascending. The
        modes of one symmetry class: others know nothing of each other.
    window : tuple of float, optional
        Of the values.

    Returns
    -------
    Estimate
        Its error is that over samples where there are 8 or more, else over parts of the spectra.

    Raises
    ------
    InputError
        If values do not ascend, three of them coincide, or there are too few.
    """
    ratios = [_ratios(spectrum) for spectrum in _spectra(values, window)]
    if sum(r.size >= RATIOS_IN_PART for r in ratios) >= FEWEST_SAMPLES:
        parts = [r for r in ratios if len(r)]
    else:
        parts = [
            part
            for r in ratios
            if len(r) >= RATIOS_IN_PART
            for part in np.array_split(r, min(len(r) // RATIOS_IN_PART, MOST))
        ]
    if len(parts) < FEWEST:
        raise InputError(
            f"values: {sum(map(len, ratios))} ratios of spacings are too few; "
            f"{FEWEST * RATIOS_IN_PART} are needed"
        )
    return _mean_of_parts(np.array([r.sum() for r in parts]), np.array([len(r) for r in parts]))


def _mean_of_parts(sums, counts):
    """Return the mean of numbers of which parts have sums, with the error over parts."""
    mean, parts = sums.sum() / counts.sum(), len(sums)
    missed = sums - mean * counts
    error = math.sqrt(parts / (parts - 1) * np.sum(missed**2)) / counts.sum()
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


def _spectra(values, window):
    """Return one array a sample of what lies in a window."""
    single = np.ndim(values[0]) == 0 if len(values) else True
    spectra = [np.asarray(v, dtype=float) for v in ([values] if single else values)]
    if any(v.ndim != 1 or not np.all(np.isfinite(v)) for v in spectra):
        raise InputError("values: every spectrum must be an array of finite numbers")
    low, high = (-math.inf, math.inf) if window is None else window
    if not low < high:
        raise InputError(f"window: {low:g} to {high:g} is no interval")
    return [v[(v >= low) & (v <= high)] for v in spectra]


def first_mode(lattice):
    """Return the frequency of the lowest normal mode, 0 if it is one at rest or unstable.

    Not collective. By ARPACK, around 0, without a certificate.

    Parameters
    ----------
    lattice : pgran.medium.lattice.Lattice or pgran.medium.network.Network
    """
    from scipy.sparse import diags
    from scipy.sparse.linalg import eigsh

    springs = lattice.springs
    K = (springs.B.T @ diags(springs.constants) @ springs.B).tocsc()
    size = abs(K).sum(axis=1).max()
    if springs.unknowns < 3 or size == 0:  # too few for an iteration
        square = np.linalg.eigvalsh(K.toarray())[0]
    else:
        square = eigsh(K, 1, sigma=-BELOW_ZERO * size, return_eigenvectors=False)[0]
    return math.sqrt(square / lattice.mass) if square > BELOW_ZERO * size else 0.0


def modal_widths(lattice, vectors):
    """Return Gamma = beta f^T C f / m of each mode f, C = B^T B of the dashpots.

    Not collective. The full width at half power of |A|^2 along omega where the mode stands alone,
    to first order in beta: S f = (m omega_i^2 - m omega^2 + i omega beta C) f, so that
    |f^T A|^2 ~ 1 / ((omega_i - omega)^2 + (Gamma/2)^2).

    Parameters
    ----------
    lattice : pgran.medium.lattice.Lattice or pgran.medium.network.Network
    vectors : numpy.ndarray, shape (nm, *shape)
        Modes, of any length, in the lattice's unknowns.

    Returns
    -------
    numpy.ndarray, shape (nm,)
    """
    widths, at_once = np.empty(len(vectors)), max(1, NUMBERS_AT_ONCE // lattice.bonds)
    for first in range(0, len(vectors), at_once):
        some = vectors[first : first + at_once]
        power = sum(
            longer**2 @ damped for longer, _, damped in lattice.stretched(some, np.zeros(len(some)))
        )
        size = np.sum(some.reshape(len(some), -1) ** 2, axis=1)
        widths[first : first + at_once] = lattice.damping * power / (lattice.mass * size)
    return widths


def modal_overlap(omega, width, window):
    """Return the modal overlap: mean width times density of modes, sum Gamma_i / (high - low).

    Not collective. Below 1 modes stand alone; far above, A is a complex Gaussian field.

    Parameters
    ----------
    omega, width : array_like of float, shape (nm,), or sequences of these, one a sample
        All modes of the window.
    window : tuple of float
        Of omega.

    Returns
    -------
    Estimate
        Its error is that over samples where there are 8 or more. For fewer it takes parts of the
        window as independent, and what differs between neighbouring ones as their error; modes that
        repel each other are more regular than that.

    Raises
    ------
    InputError
        If there are too few modes.
    """
    single = np.ndim(omega[0]) == 0 if len(omega) else True
    omega, width = ([x] if single else x for x in (omega, width))
    low, high = window
    if not low < high:
        raise InputError(f"window: {low:g} to {high:g} is no interval")
    inside = sum(np.count_nonzero((low <= np.asarray(w)) & (np.asarray(w) <= high)) for w in omega)
    parts = min(MOST, inside // (2 * len(omega)))
    if parts < FEWEST:
        raise InputError(
            f"window: {inside} modes of {len(omega)} samples lie in it, and {2 * FEWEST} of each "
            "are needed"
        )
    sums = np.array(
        [
            np.histogram(w, parts, (low, high), weights=g)[0]
            for w, g in zip(omega, width, strict=True)
        ]
    )
    if len(sums) >= FEWEST_SAMPLES:
        found = mean_of(sums.sum(axis=1))
        return Estimate(float(found.value / (high - low)), float(found.error / (high - low)))
    mean = sums.mean(axis=0)
    error = math.sqrt(parts * 0.5 * np.mean(np.diff(mean) ** 2))
    return Estimate(float(mean.sum() / (high - low)), error / (high - low))
