"""What is read of results for the table of the paper: maxima, dips, participation, widths."""

import dataclasses
from types import SimpleNamespace

import numpy as np

import pgran
from pgran.driven.amplitudes import fit_line
from pgran.experiments.modes.figures import pick

DEEP = 10.0  # dB: a sharp decrease


def within(curve, low, high):
    """Return omega and |A| of a curve in an interval."""
    inside = (curve.omega >= low) & (curve.omega < high)
    return curve.omega[inside], curve.amplitude.reshape(len(curve.omega))[inside]


def maxima(curve, low, high):
    """Return where |A| is larger than at both neighbours, and |A| there."""
    omega, size = within(curve, low, high)
    top = 1 + np.flatnonzero((size[1:-1] > size[:-2]) & (size[1:-1] >= size[2:]))
    return omega[top], size[top]


def dips(curve, low=0.3, high=1.0):
    """Return by how many dB |A| falls between neighbouring maxima, below the lower of both."""
    omega, size = within(curve, low, high)
    places, tops = maxima(curve, low, high)
    ends = list(zip(places, places[1:], tops, tops[1:], strict=False))
    least = [size[(omega >= a) & (omega <= b)].min() for a, b, _, _ in ends]
    return 20 * np.log10([min(t) / s for (_, _, *t), s in zip(ends, least, strict=True)])


def apart(count, low=0.3, high=1.0):
    """Return the mean distance of so many in an interval; infinite of none."""
    return (high - low) / count if count else np.inf


def deep(*results):
    """Return how many dips are deeper than DEEP, of each response."""
    return [int(np.count_nonzero(dips(result.response) > DEEP)) for result in results]


def count(modes, low, high):
    """Return how many modes an interval has."""
    return int(np.count_nonzero((modes.omega >= low) & (modes.omega < high)))


def nearest(modes, omega):
    """Return the frequency of the mode nearest to one, and its participation ratio."""
    at = np.abs(modes.omega - omega).argmin()
    return modes.omega[at], modes.participation[at]


def usual(modes):
    """Return frequency and participation ratio of the second of the modes that are pictured."""
    at = pick(modes.omega, modes.participation)[1]
    return modes.omega[at], modes.participation[at]


def participation(modes):
    """Return the medians of three ranges of frequencies."""
    ends = [0.0, 0.3, 1.0, np.inf]
    split = np.digitize(modes.omega, ends) - 1
    return [np.median(modes.participation[split == part]) for part in range(3)]


def audible(modes, shape, least=0.01):
    """Return how many modes above omega_mx have a peak |A| above the `least`, of how many.

    And the median of their peaks; decades by which the detector's and the wall's part in a mode
    falls with each spacing between them and the ball that moves most; both correlations.
    """
    high = modes.omega > 1
    peaks, part = modes.peak[high, 0], np.abs(modes.reading[high, 0])
    vectors = np.abs(modes.vector[high]).reshape(np.count_nonzero(high), -1)
    centre = np.stack(np.unravel_index(vectors.argmax(axis=1), shape), axis=1)
    falls = []
    for away, size in (
        (np.linalg.norm(centre - modes.detector[0], axis=1), part),
        (shape[0] - centre[:, 0], np.abs(modes.source[high])),
    ):
        falls += [fit_line(away, np.log10(size))[0], np.corrcoef(away, np.log10(size))[0, 1]]
    return np.count_nonzero(peaks > least), len(peaks), np.median(peaks), *falls


def spread(values):
    """Return mean, standard deviation and range of what is certain, and how many that are."""
    known = values[np.isfinite(values)]
    if known.size < 2:
        return [np.nan] * 4 + [known.size]
    return known.mean(), known.std(ddof=1), known.min(), known.max(), known.size


def off_drive(projection, low, high):
    """Return how far the dominant mode is from the drive on the mean, and its slope."""
    omega = projection.omega
    inside = (omega >= low) & (omega < high) & (projection.converged_reason > 0)
    mode = projection.mode_omega[projection.dominant[inside]]
    return np.abs(mode - omega[inside]).mean(), fit_line(omega[inside], mode)[0]


def width(projection):
    """Return the full width at half power of the most excited mode; NaN beyond the sweep."""
    power = np.abs(projection.coefficient) ** 2
    power = power[:, power.max(axis=0).argmax()]
    below, top = np.flatnonzero(power < power.max() / 2), power.argmax()
    lower, upper = below[below < top], below[below > top]
    if not (lower.size and upper.size):
        return np.nan
    return projection.omega[upper[0]] - projection.omega[lower[-1]]


def excited(projection, drive=0.6):
    """Return the mode of the largest |c_i|, the share near the drive, the rank of the nearest."""
    at = np.abs(projection.omega - drive).argmin()
    size = np.abs(projection.coefficient[at])
    away = np.abs(projection.mode_omega - projection.omega[at])
    share = (size**2)[away < 0.05].sum() / (size**2).sum()
    rank = 1 + np.count_nonzero(size > size[away.argmin()])
    return projection.mode_omega[size.argmax()], share, rank


def local_exponents(*results):
    """Return the exponents with which the phase's slope falls from each beta to the next."""
    beta = [result.lattice.damping for result in results]
    slope = [-result.response.phase_slope[0] for result in results]
    return -np.diff(np.log(slope)) / np.diff(np.log(beta))


def in_its_units(result):
    """Return the response or the modes of a network, omega in units of the paper's omega_mx."""
    record = result.modes if hasattr(result, "modes") else result.response
    unit = np.sqrt(2) * result.network.omega_mx  # that of scalars is sqrt(2 kmax / m)
    return dataclasses.replace(record, omega=record.omega / unit)


def bonds(lattice):
    """Return the constants of all bonds of a plane lattice."""
    return np.concatenate([lattice.stiffness_x.ravel(), lattice.stiffness_y.ravel()])


def edge(result, ends=(1.1, 1.3)):
    """Return by how many decades |A| falls from its median in .9-1 omega_mx to other ends."""
    curve, unit = result.response, result.lattice.omega_mx
    start = np.median(within(curve, 0.9 * unit, unit)[1])
    last = [within(curve, 0, (end + 1e-9) * unit)[1][-1] for end in ends]
    return np.log10(start / np.array(last))


def likeness(one, other):
    """Return the correlation of ln|A| of two responses in .3-1, each less its straight line."""
    found = pgran.compare(one, other, windows=[(0.3, 1.0)])
    return found.correlation[0, 0, list(found.signal).index("ln|A|")]


def slow_spectrum(relaxation_seconds):
    """Return the exponent of a power spectrum, its window in Hz, its two corners and kbar."""
    result = relaxation_seconds
    spectrum, memory, step = result.spectrum, result.memory, result.relaxation.step
    corner = 1 / (2 * np.pi * memory.bonds * step)
    window = spectrum.fit_min / step, spectrum.fit_max / step
    return spectrum.exponent, *window, corner, memory.order, memory.order * corner


def deepest(*results):
    """Return what a tenth and a fiftieth of the dips at all detectors exceed in dB, on two grids.

    Of each response: of the resolved curve, and of the frequencies asked for, which the paper has.
    """
    found = []
    for response in (result.response for result in results):
        for grid in (slice(None), response.requested > 0):
            omega, sizes = response.omega[grid], response.amplitude[grid].T
            curves = [SimpleNamespace(omega=omega, amplitude=size) for size in sizes]
            found += [*np.quantile(np.concatenate([dips(c) for c in curves]), [0.9, 0.98])]
    return found
