"""The fluctuations of a relaxation: the power spectrum of an amplitude, and its memory."""

import logging

import numpy as np

from pgran.errors import InputError
from pgran.experiments.relaxation.record import Memory
from pgran.run.options import REAL, Option
from pgran.store.estimate import two_digits

log = logging.getLogger("pgran")

SPECTRUM = (
    Option("spectrum_fit_min", REAL, 0.01, "window of the exponent's fit", "cycles/step", above=0),
    Option("spectrum_fit_max", REAL, 0.3, "window of the exponent's fit", "cycles/step", above=0),
)
LAGS = 60  # at which the memory is looked at
FIT = tuple(option.default for option in SPECTRUM)


def measured(relaxation, window, bonds):
    """Return a relaxation, and its spectrum and its memory where it has them. Not collective."""
    spectrum = spectrum_of(relaxation, window, bonds)
    memory = memory_of(relaxation, bonds) if spectrum else None
    return [record for record in (relaxation, spectrum, memory) if record]


def spectrum_of(relaxation, window, memory):
    """Return the power spectrum of the first detector's amplitude; None, aloud, if it has none.

    Not collective.

    Parameters
    ----------
    relaxation : pgran.results.Relaxation
    window : tuple of float
        Of the exponent's fit, in cycles per step.
    memory : float
        Longest correlation time, in steps.
    """
    from pgran.experiments.relaxation.spectrum import power_spectrum

    if relaxation.failures:
        log.warning("no spectrum: some steps have no amplitude")
    elif relaxation.at_floor[:, :, 0].any():
        log.warning("no spectrum: some amplitudes have an upper limit only (at_floor)")
    else:
        try:
            return power_spectrum(relaxation.amplitude[:, :, 0], *window, memory=memory)
        except InputError as error:
            log.warning("no spectrum: %s", error)
    return None


def memory_of(relaxation, bonds):
    """Return what the first detector's amplitude remembers; None where the series is too short.

    Not collective.

    Parameters
    ----------
    relaxation : pgran.results.Relaxation
        All of whose states are accurate.
    bonds : int
        M, one of which is redrawn a step.
    """
    from pgran.experiments.relaxation import memory

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
    found = memory.autocorrelation(series, lags)
    order, increment, successive = (
        measure(series)
        for measure in (
            memory.mean_order,
            memory.increment_correlation,
            memory.successive_correlation,
        )
    )
    lowest, highest = memory.bounds(lags, bonds, min(max(order.value, 1.0), bonds))
    return Memory(
        bonds=bonds,
        order=order.value,
        order_error=order.error,
        increment=increment.value,
        increment_error=increment.error,
        successive=successive.value,
        successive_error=successive.error,
        lag=lags,
        correlation=found.value,
        correlation_error=found.error,
        lowest=lowest,
        highest=highest,
    )


def summary(result):
    """Return in words what the fluctuations tell. Not collective."""
    spectrum = getattr(result, "spectrum", None)
    if spectrum and np.isfinite(spectrum.exponent):
        yield (
            f"power spectrum S(f) ~ f^-psi with psi = {spectrum.exponent:.3f} +- "
            f"{spectrum.exponent_error:.3f} between {spectrum.fit_min:g} and "
            f"{spectrum.fit_max:g} cycles per step"
        )
    memory = getattr(result, "memory", None)
    if memory:
        errors = two_digits(memory.order_error), two_digits(memory.increment_error)
        yield (
            f"memory: {memory.order:.3g} +- {errors[0]} of {memory.bonds} bonds act jointly on "
            "average; the amplitude and its next increment have the correlation "
            f"{memory.increment:.3g} +- {errors[1]}"
        )
