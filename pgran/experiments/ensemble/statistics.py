"""The noise of an ensemble's responses, in windows of frequencies, beside the Gaussian laws."""

import logging
from functools import partial

import numpy as np

from pgran.arguments import called_right
from pgran.errors import InputError
from pgran.experiments.ensemble.record import Ensemble, NoiseStatistics
from pgran.run.numbers import numbers
from pgran.run.streams import saying_once
from pgran.store.estimate import two_digits
from pgran.store.fields import ball_names

log = logging.getLogger("pgran")

EDGES = np.append(np.arange(0.0, 4.0, 0.25), np.arange(4.0, 8.5, 0.5))  # of I/<I>
SHIFTS = 60  # at which correlations are stored, as far as half of the window
PARTS = "whole", "incoherent"
MEASURED = "contrast", "spread", "half_width", "maxima_spacing"


def windows_of(values, omegas=None):
    """Return numbers low, high, low, high ... as windows, shape (n, 2).

    Not collective. Raises InputError unless they are such, and within the sweep if it is given.
    """
    ends = numbers("-statistics_windows", values).ravel()
    if not ends.size or ends.size % 2:
        raise InputError(
            f"-statistics_windows: a window has two ends, so {ends.size} numbers make none"
        )
    windows = ends.reshape(-1, 2)
    for low, high in windows:
        if not low < high:
            raise InputError(f"-statistics_windows: {low:g} is not below {high:g}")
        if omegas is not None and not omegas[0] <= low < high <= omegas[-1]:
            raise InputError(
                f"-statistics_windows: {low:g} to {high:g} is not within the sweep, "
                f"{omegas[0]:g} to {omegas[-1]:g}"
            )
    return windows


@called_right
@saying_once()
def statistics(ensemble, windows):
    """Measure the noise of an ensemble's responses (paper: freqres, "noisy").

    Not collective. Only samples count that are good. What cannot be measured, because a curve is
    not resolved, say, is NaN, which is said.

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
    """
    from pgran.experiments.ensemble.intensity import NoisyCurves

    if not isinstance(ensemble, Ensemble) or ensemble.displacement is None:
        raise InputError(
            "statistics: this ensemble has no curves; -ensemble_keep curves keeps them"
        )
    windows = windows_of(windows, ensemble.omega)
    A = ensemble.displacement[ensemble.good > 0]
    shifts, found, missing = np.empty((len(windows), SHIFTS)), {}, {}
    for w, window in enumerate(windows):
        for d in range(A.shape[2]):
            whole, rest = (
                NoisyCurves(ensemble.omega, A[:, :, d], window, s) for s in (False, True)
            )
            shifts[w] = _shifts(whole.uniform.omega)
            where = f"{window[0]:g} to {window[1]:g}, detector {d}"
            both = [_measure(curves, shifts[w], where, missing) for curves in (whole, rest)]
            coherent = whole.estimate(_coherent_part, whole.amplitude)
            for name in both[0]:
                parts = [one[name] for one in both]
                for key, kind in ((name, "value"), (f"{name}_error", "error")):
                    found.setdefault(key, []).append([getattr(one, kind) for one in parts])
            found.setdefault("coherent_part", []).append(coherent.value)
            found.setdefault("coherent_part_error", []).append(coherent.error)
    for (name, error), places in missing.items():
        log.warning("no %s in %s: %s", name, "; ".join(places), error)
    across = len(windows), A.shape[2]
    arrays = {n: np.array(v).reshape(*across, *np.shape(v)[1:]) for n, v in found.items()}
    return NoiseStatistics(
        samples=len(A),
        low=windows[:, 0].copy(),
        high=windows[:, 1].copy(),
        part=np.array(PARTS),
        detector=ensemble.detector,
        edge=EDGES,
        shift=shifts,
        **arrays,
    )


def _shifts(omega):
    """Return shifts that are multiples of the step, as correlations are known there."""
    stride = -(-(len(omega) - 1) // (2 * SHIFTS))
    return stride * (omega[1] - omega[0]) * np.arange(SHIFTS)


def _coherent_part(A, weights):
    """Return |<A>|^2 / <|A|^2>, its mean over the window."""
    return np.average(np.abs(A.mean(axis=0)) ** 2 / (np.abs(A) ** 2).mean(axis=0), weights=weights)


def _measure(curves, shifts, where, missing):
    """Return the measures of some curves by name; NaN where there is none.

    What there is not goes into `missing`: by name and reason the places, each once.
    """
    from pgran.experiments.ensemble import intensity as measures
    from pgran.store.estimate import Estimate

    wanted = {name: ((), partial(getattr(measures, name), curves)) for name in MEASURED}
    wanted["density"] = (len(EDGES) - 1,), partial(measures.histogram, curves, EDGES)
    omega = curves.uniform.omega
    known = np.flatnonzero(shifts < omega[len(omega) // 2] - omega[0])
    wanted["correlation"] = known.shape, partial(measures.correlation, curves, shifts[known])
    found = {}
    for name, (shape, measure) in wanted.items():
        try:
            found[name] = measure()
        except InputError as error:
            missing.setdefault((name.replace("_", " "), str(error)), {})[where] = True
            found[name] = Estimate(*[np.full(shape, np.nan)] * 2)
    beyond = (0, len(shifts) - len(known))
    padded = [
        np.pad(x, beyond, constant_values=np.nan) for x in vars(found["correlation"]).values()
    ]
    found["correlation"] = Estimate(*padded)
    return found


def summary(found):
    """Return in words what the noise is like, beside Gaussian laws. Not collective."""
    from pgran.experiments.ensemble.intensity import (
        GAUSSIAN_CONTRAST,
        GAUSSIAN_SPREAD,
        MAXIMA_SPACING,
    )

    for w, d in np.ndindex(found.coherent_part.shape):
        yield (
            f"{ball_names(found.detector)[d]}, {found.low[w]:g} to {found.high[w]:g}: "
            f"{_said(found, 'coherent_part', (w, d))} of <|A|^2> is coherent, |<A>|^2"
        )
        for f, part in enumerate(found.part):
            contrast, spread, width, spacing = (_said(found, n, (w, d, f)) for n in MEASURED)
            ratio = found.maxima_spacing[w, d, f] / found.half_width[w, d, f]
            beside = f", {ratio:.3g} half widths ({MAXIMA_SPACING:.3g})" if ratio > 0 else ""
            yield (
                f"  {part}: <I^2>/<I>^2 {contrast} (Gaussian: {GAUSSIAN_CONTRAST:g}), spread "
                f"{spread} dB ({GAUSSIAN_SPREAD:.3g}), half width of the correlation {width}, "
                f"spacing of maxima {spacing}{beside}"
            )


def _said(found, name, place):
    """Return a measure with its error."""
    value, error = (getattr(found, n)[place] for n in (name, f"{name}_error"))
    return f"{value:.3g} +- {two_digits(error)}" if np.isfinite(error) else "unknown"
