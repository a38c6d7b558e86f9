"""What is accurate enough; true errors against a reference with a bound. NumPy only."""

import numpy as np

# A number of an experiment, a bound of its absolute error, what errors are relative to, and whether
# that is what was asked for.
ENTRY = np.dtype([("value", complex), ("bound", float), ("size", float), ("good", bool)])


def entries(values, bounds, good, sizes=None):
    """Return numbers in one flat array of ENTRY.

    Not collective.

    Parameters
    ----------
    values, bounds, good, sizes : array_like
        Columns of ENTRY; but for the values they may be scalars. Errors are relative to the numbers
        themselves unless sizes are given.
    """
    found = np.zeros(np.size(values), ENTRY)
    sizes = np.abs(values) if sizes is None else np.broadcast_to(sizes, np.shape(values))
    for name, column in zip(ENTRY.names, (values, bounds, sizes, good), strict=True):
        found[name] = np.ravel(column)
    return found


def read_response(response):
    """Return the amplitudes of a sweep. Not collective."""
    good = np.broadcast_to(response.converged_reason[:, None] > 0, response.displacement.shape)
    return entries(response.displacement, response.error_bound, good)


def read_relaxation(relaxation):
    """Return the amplitudes of a relaxation, NaN where they miss the tolerance. Not collective."""
    found = relaxation.displacement
    return entries(found, relaxation.error_bound, np.isfinite(found))


def read_pulse(signals):
    """Return the displacements of a pulse, relative to the largest of each ball's signal.

    Not collective. Of an integration, what it bounds its errors by are estimates.
    """
    largest = np.abs(signals.displacement).max(axis=0)
    good = np.broadcast_to(
        signals.error.max(axis=0) <= signals.tolerance * largest, signals.error.shape
    )
    return entries(signals.displacement, signals.error, good, largest)


def read_modes(lattice, largest, modes):
    """Return the frequencies of modes, and zeros that are not good for those that are missing.

    Not collective.

    Parameters
    ----------
    lattice : pgran.medium.lattice.Lattice
    largest : float
        Modes with residuals above it, in units of |K|, count as missing.
    modes : pgran.results.Modes
    """
    good = modes.residual <= largest
    omega = modes.omega[good]
    found = entries(omega, mode_bounds(lattice, omega, modes.residual[good]), True)
    missing = np.zeros(max(modes.count_expected - len(omega), 0), ENTRY)
    return np.concatenate([found, missing])


def relative_bounds(found):
    """Return the bound of each number's relative error, inf for none. Not collective."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = found["bound"] / found["size"]
    return np.where(np.isfinite(ratio), ratio, np.inf)


def relative_errors(found, reference):
    """Return the relative error of each number, at least the bound of the reference's own error.

    Not collective. A smaller difference from the reference says nothing; so an error returned is
    too large rather than too small.
    """
    difference = np.abs(found["value"] - reference["value"])
    return np.maximum(difference, reference["bound"]) / reference["size"]


def mode_bounds(lattice, omega, residual):
    """Return how wrong frequencies of modes may be, by their residuals and these' roundings.

    Not collective. K is symmetric, so a residual |K f - lambda f| of a unit vector is no smaller
    than the distance of lambda = m omega^2 from an eigenvalue.

    Parameters
    ----------
    lattice : pgran.medium.lattice.Lattice
    omega, residual : numpy.ndarray, shape (nm,)
        As in `pgran.results.Modes`.
    """
    missed = (residual + lattice.rounding) * lattice.stiffness_norm / lattice.mass
    # |omega - omega'| (omega + omega') = |omega^2 - omega'^2| <= missed
    with np.errstate(divide="ignore"):
        return np.minimum(missed / omega, np.sqrt(missed))


def matched(found, reference):
    """Return found modes in the places of the reference's; where one is missing, it is not good.

    Not collective. Both ascend; two can be the same mode if they are no further apart than their
    bounds allow.
    """
    placed, place = np.zeros(len(reference), ENTRY), 0
    for entry in found[found["good"]]:
        allowed = entry["bound"] + reference["bound"]
        distance = (reference["value"] - entry["value"]).real
        while place < len(reference) and distance[place] < -allowed[place]:
            place += 1
        if place < len(reference) and distance[place] <= allowed[place]:
            placed[place] = entry
            place += 1
    return placed


def front(seconds, error, failures):
    """Return which configurations no other one beats, of those without failures.

    Not collective. One beats another if it is as fast and as accurate, and better in one of both.

    Parameters
    ----------
    seconds, error, failures : numpy.ndarray, shape (n,)
    """
    eligible = (failures == 0) & np.isfinite(error)
    faster, closer = seconds[:, None] < seconds, error[:, None] < error
    beats = (faster & (error[:, None] <= error)) | (closer & (seconds[:, None] <= seconds))
    return eligible & ~np.any(beats[eligible], axis=0)
