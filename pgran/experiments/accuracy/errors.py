"""Numbers with bounds of their errors, and their true errors against a reference. NumPy only."""

import numpy as np

from pgran.experiments.modes.shapes import RESIDUAL

# A number of an experiment, a bound of its absolute error, what errors are relative to, and whether
# the number is as accurate as was asked for.
ENTRY = np.dtype([("value", complex), ("bound", float), ("size", float), ("good", bool)])


def entries(values, bounds, good, sizes=None):
    """Return numbers in one flat array of ENTRY; bounds, good and sizes broadcast to the values.

    Errors are relative to the numbers themselves unless sizes are given.
    """
    numbers = np.zeros(np.size(values), ENTRY)
    sizes = np.abs(values) if sizes is None else sizes
    for name, column in zip(ENTRY.names, (values, bounds, sizes, good), strict=True):
        numbers[name] = np.broadcast_to(column, np.shape(values)).ravel()
    return numbers


def read_response(response):
    """Return the amplitudes of a sweep."""
    good = response.converged_reason[:, None] > 0
    return entries(response.displacement, response.error_bound, good)


def read_relaxation(relaxation):
    """Return the amplitudes of a relaxation, which are NaN where they miss the tolerance."""
    amplitudes = relaxation.displacement
    return entries(amplitudes, relaxation.error_bound, np.isfinite(amplitudes))


def read_pulse(signals):
    """Return the displacements of a pulse, relative to the largest of each ball's signal.

    What an integration bounds its errors by are estimates.
    """
    largest = np.abs(signals.displacement).max(axis=0)
    good = signals.error.max(axis=0) <= signals.tolerance * largest
    return entries(signals.displacement, signals.error, good, largest)


def read_modes(lattice, modes):
    """Return the frequencies of accurate modes, and zeros that are not good for missing ones."""
    accurate = modes.residual <= RESIDUAL
    omega = modes.omega[accurate]
    numbers = entries(omega, mode_bounds(lattice, omega, modes.residual[accurate]), True)
    missing = np.zeros(max(modes.count_expected - len(omega), 0), ENTRY)
    return np.concatenate([numbers, missing])


def mode_bounds(lattice, omega, residual):
    """Return bounds of the errors of modes' frequencies, by their residuals, in units of |K|.

    K is symmetric, so a residual |K f - lambda f| of a unit vector is no smaller than the distance
    of lambda = m omega^2 from an eigenvalue.
    """
    missed = (residual + lattice.rounding) * lattice.stiffness_norm / lattice.mass
    # |omega - omega'| (omega + omega') = |omega^2 - omega'^2| <= missed
    with np.errstate(divide="ignore"):
        return np.minimum(missed / omega, np.sqrt(missed))


def relative_bounds(numbers):
    """Return the bound of each number's relative error, inf for none."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = numbers["bound"] / numbers["size"]
    return np.where(np.isfinite(ratio), ratio, np.inf)


def relative_errors(numbers, reference):
    """Return the relative error of each number, at least the bound of the reference's own error."""
    difference = np.abs(numbers["value"] - reference["value"])
    return np.maximum(difference, reference["bound"]) / reference["size"]


def matched(modes, reference):
    """Return modes in the places of the reference's; where one is missing, it is not good.

    Both ascend. Two can be the same mode if they are no further apart than their bounds allow.
    """
    placed, place = np.zeros(len(reference), ENTRY), 0
    for mode in modes[modes["good"]]:
        allowed = mode["bound"] + reference["bound"]
        distance = (reference["value"] - mode["value"]).real
        while place < len(reference) and distance[place] < -allowed[place]:
            place += 1  # the mode at this place is missing
        if place < len(reference) and distance[place] <= allowed[place]:
            placed[place] = mode
            place += 1
    return placed


def front(seconds, error, failures):
    """Return which of n configurations no other one beats, of those without failures.

    One beats another if it is as fast and as accurate, and better in one of both.
    """
    eligible = (failures == 0) & np.isfinite(error)
    # [i, j]: whether i beats j
    faster, closer = seconds[:, None] < seconds, error[:, None] < error
    beats = (faster & (error[:, None] <= error)) | (closer & (seconds[:, None] <= seconds))
    return eligible & ~np.any(beats[eligible], axis=0)
