"""The noise of an ensemble's responses, in windows of frequencies, beside the Gaussian laws."""

import logging
from functools import partial

import numpy as np

from pgran.arguments import called_right
from pgran.errors import InputError
from pgran.experiments.ensemble import intensity
from pgran.experiments.ensemble.noise import MAXIMA_SPACING, NoisyCurves
from pgran.experiments.ensemble.record import Ensemble, NoiseStatistics
from pgran.run.numbers import windows_of
from pgran.store.estimate import Estimate, told, with_errors
from pgran.store.record import ball_names

log = logging.getLogger("pgran")

EDGES = np.append(np.arange(0.0, 4.0, 0.25), np.arange(4.0, 8.5, 0.5))  # of I/<I>
SHIFTS = 60  # at which correlations are stored, as far as half of the window
PARTS = "whole", "incoherent"
MEASURED = "contrast", "spread", "half_width", "maxima_spacing"


@called_right
def statistics(ensemble, windows):
    """Measure the noise of an ensemble's responses (paper: freqres, "noisy").

    Samples that are not good are left out. A measure that cannot be computed, such as that of a
    curve that is not resolved, is NaN, with a warning.

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
    return NoiseStatistics(
        samples=len(A),
        low=windows[:, 0].copy(),
        high=windows[:, 1].copy(),
        part=np.array(PARTS),
        detector=ensemble.detector,
        edge=EDGES,
        shift=arrays.pop("shift")[:, 0],  # those of a window, whatever the detector is
        **arrays,
    )


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
    coherent = whole.estimate(_coherent_part, whole.amplitude)
    fields = {name: np.array([part[name] for part in both]) for name in both[0]}
    return {"shift": shifts} | with_errors(coherent_part=coherent) | fields


def _coherent_part(A, weights):
    """Return |<A>|^2 / <|A|^2>, its mean over the window."""
    return np.average(np.abs(A.mean(axis=0)) ** 2 / (np.abs(A) ** 2).mean(axis=0), weights=weights)


def _measure(curves, shifts, where, missing):
    """Return measures of some curves and errors by name; NaN for what is `missing`."""
    omega = curves.uniform.omega
    known = np.flatnonzero(shifts < omega[len(omega) // 2] - omega[0])
    measures = {name: ((), partial(getattr(intensity, name), curves)) for name in MEASURED}
    measures["density"] = (len(EDGES) - 1,), partial(intensity.histogram, curves, EDGES)
    measures["correlation"] = known.shape, partial(intensity.correlation, curves, shifts[known])
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
            contrast, spread, width, spacing = (told(found, n, (w, d, p)) for n in MEASURED)
            ratio = found.maxima_spacing[w, d, p] / found.half_width[w, d, p]
            beside = f", {ratio:.3g} half widths ({MAXIMA_SPACING:.3g})" if ratio > 0 else ""
            yield (
                f"  {part}: <I^2>/<I>^2 {contrast} (Gaussian: {intensity.GAUSSIAN_CONTRAST:g}), "
                f"spread {spread} dB ({intensity.GAUSSIAN_SPREAD:.3g}), half width of the "
                f"correlation {width}, spacing of maxima {spacing}{beside}"
            )
