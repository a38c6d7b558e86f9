"""The fluctuations of a relaxation: the power spectrum of an amplitude, and its memory."""

import logging

import numpy as np

from pgran.errors import InputError
from pgran.experiments.relaxation import memory
from pgran.experiments.relaxation.record import Memory
from pgran.run.options import REAL, Option
from pgran.store.estimate import with_error, with_errors

log = logging.getLogger("pgran")

SPECTRUM = (
    Option("spectrum_fit_min", REAL, 0.01, "lower end of the fit of psi", "cycles/step", above=0),
    Option("spectrum_fit_max", REAL, 0.3, "upper end of the fit of psi", "cycles/step", above=0),
)
FIT = tuple(option.default for option in SPECTRUM)
LAGS = 60  # of the autocorrelation, evenly spaced in their logarithm


def measured(relaxation, window, bonds):
    """Return a relaxation, and its spectrum and memory where it has them; `window` is the fit's."""
    spectrum = _spectrum_of(relaxation, window, bonds)
    remembered = _memory_of(relaxation, bonds) if spectrum else None
    return [record for record in (relaxation, spectrum, remembered) if record]


def _spectrum_of(relaxation, window, bonds):
    """Return the power spectrum of the first detector's amplitude; None, aloud, if it has none."""
    from pgran.experiments.relaxation.spectrum import power_spectrum

    if relaxation.failures:
        log.warning("no spectrum: some steps have no amplitude")
    elif relaxation.at_floor[:, :, 0].any():
        log.warning("no spectrum: some amplitudes have an upper limit only (at_floor)")
    else:
        try:
            return power_spectrum(relaxation.amplitude[:, :, 0], *window, memory=bonds)
        except InputError as error:
            log.warning("no spectrum: %s", error)
    return None


def _memory_of(relaxation, bonds):
    """Return what the first detector's amplitude remembers; None where the series is too short."""
    values = np.abs(relaxation.displacement[:, :, 0])
    if len(values) > 1:  # they know of each other until most bonds are redrawn
        values = values[:, bonds:]
    try:
        series = memory.Series(values, bonds)
    except InputError as error:
        log.info("no memory: %s", error)
        return None
    longest = min(3 * bonds, values.shape[1] // 2)
    lags = np.unique(np.append(0, np.geomspace(1, longest, LAGS).astype(int)))
    order = memory.mean_order(series)
    lowest, highest = memory.bounds(lags, bonds, min(max(order.value, 1.0), bonds))
    estimates = with_errors(
        order=order,
        increment=memory.increment_correlation(series),
        successive=memory.successive_correlation(series),
        correlation=memory.autocorrelation(series, lags),
    )
    return Memory(bonds=bonds, lag=lags, lowest=lowest, highest=highest, **estimates)


def summary(result):
    """Return in words what the fluctuations tell."""
    spectrum = getattr(result, "spectrum", None)
    if spectrum and np.isfinite(spectrum.exponent):
        step, low, high = result.relaxation.step, spectrum.fit_min, spectrum.fit_max
        hertz = f" ({low / step:.3g} to {high / step:.3g} Hz)" if step else ""
        yield (
            "power spectrum S(f) ~ f^-psi with psi = "
            f"{with_error(spectrum.exponent, spectrum.exponent_error)} between "
            f"{low:g} and {high:g} cycles per step{hertz}"
        )
    remembered = getattr(result, "memory", None)
    if remembered:
        order = with_error(remembered.order, remembered.order_error)
        yield (
            f"memory: {order} of {remembered.bonds} bonds act "
            "jointly on average; the amplitude and its next increment have the correlation "
            f"{with_error(remembered.increment, remembered.increment_error)}"
        )
