"""The driving frequencies of a sweep: what may be asked, and what that makes."""

import numpy as np

from pgran.errors import InputError
from pgran.run.experiment import Asked
from pgran.run.machine import check_memory
from pgran.run.numbers import numbers
from pgran.run.options import INTEGER, REAL, REALS, TEXT, Option, alternatives, check_ends
from pgran.store.si import FREQUENCIES_IN, SI

GRID = (
    Option("sweep_min", REAL, 0.01, "lowest driving frequency", "angular", above=0),
    Option("sweep_max", REAL, 1.3, "highest driving frequency", "angular", above=0),
    Option("sweep_points", INTEGER, 1291, "frequencies of the linear grid", low=1),
    Option(
        "sweep_omega", REALS, None, "driving frequencies, instead of a grid", "angular", above=0
    ),
)
UNIT = Option(
    "sweep_unit", TEXT, "absolute",
    "what the frequencies of a sweep are given in; `Hz` needs `-units_time`",
    choices=FREQUENCIES_IN,
)  # fmt: skip


def check_sweep(values, given):
    """Raise where the options of a sweep contradict each other; make frequencies in Hz angular."""
    alternatives(("sweep_omega",), ("sweep_min", "sweep_max", "sweep_points"), values, given)
    asked = ("sweep_min", "sweep_max") if values["sweep_omega"] is None else ("sweep_omega",)
    hertz = _hertz(asked, values, given) if values.get("sweep_unit") == "Hz" else None
    if values["sweep_omega"] is None:
        check_ends("sweep", values)
    else:
        checked_frequencies(values["sweep_omega"])
    if hertz:
        for name in asked:
            angular = (hertz * np.array(values[name])).tolist()
            values[name] = tuple(angular) if isinstance(angular, list) else angular
        values["sweep_unit"] = "absolute"


def _hertz(asked, values, given):
    """Return the angular frequency of 1 Hz; raise unless options `asked` for are in Hz."""
    hertz = SI(time=values["units_time"]).angular("Hz")
    if hertz is None:
        raise InputError(
            "-sweep_unit Hz: -units_time is needed, the unit of time in s (pgran units computes it)"
        )
    for name in asked:
        # a default, or an options file that a later word gives another unit, is not in Hz
        if name not in given or given[name].rank < given["sweep_unit"].rank:
            raise InputError(f"-sweep_unit Hz: give -{name} in Hz, too")
    return hertz


def driving_frequencies(options, lattice=None):
    """Return the frequencies of a run's sweep, angular, increasing; the lattice may be their unit.

    Raises InputError if the lattice has no omega_mx to measure them in.
    """
    if options.sweep_omega:
        omegas = np.array(options.sweep_omega)
    else:
        check_memory("sweep_points", 64 * options.sweep_points)  # with the least of results
        omegas = np.linspace(options.sweep_min, options.sweep_max, options.sweep_points)
    if lattice is None or options.sweep_unit == "absolute":
        return omegas
    if not lattice.omega_mx > 0:
        raise InputError("-sweep_unit omega_mx: without stiff bonds omega_mx is 0")
    return omegas * lattice.omega_mx


def checked_frequencies(omegas):
    """Return driving frequencies as an array, which increase from above 0; raise InputError."""
    omegas = np.atleast_1d(numbers("-sweep_omega", omegas))
    if omegas.ndim != 1 or not omegas.size or not np.all(np.isfinite(omegas) & (omegas > 0)):
        raise InputError("-sweep_omega: the frequencies must be positive and finite, in a list")
    if np.any(np.diff(omegas) <= 0):
        raise InputError("-sweep_omega: the frequencies must increase")
    return omegas


def _of_run(options, world, lattice=None):
    return driving_frequencies(options, lattice)


FREQUENCIES = Asked(GRID, _of_run, checked_frequencies)
SWEEP = Asked((*GRID, UNIT), _of_run, checked_frequencies)
