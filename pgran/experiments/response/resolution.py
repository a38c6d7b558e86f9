"""A resolved curve: about how many intervals it needs, and where straight lines are right.

With the derivatives at both ends the amplitude between two neighbours is a cubic (Hermite's). Where
that cubic leaves the straight line between them, the line is wrong; where it does so by a large
part of the amplitude, the phase may have turned unseen. A resonance much narrower than the distance
hides from the cubic; what rules it out is a proven model, that no mode is near, or that all poles
are too far from the real axis. NumPy only.
"""

import numpy as np

from pgran.medium.rounding import EPSILON

PLACES = 0.25, 0.5, 0.75  # between two neighbours
SHARE = 0.8  # aim at this part of the deviation allowed, which the cubic only estimates
DOUBT = 0.3  # of that part: where the cubic says more, the line is looked at once more
FEW_UNKNOWNS = 1000  # of which all normal frequencies are found in a tenth of a second
MOST_ADDED = 7  # frequencies between two neighbours in one pass
PASSES = 40
LOOSEST = 0.5  # of the amplitude: lines further off than that are wrong for any use


def interval_length(lattice, omega):
    """Return about how long an interval is at some frequencies, which is where a march begins.

    Not collective. Where modes overlap it follows their width, beta / m near the bottom and about
    four times that at omega_mx; where they do not, an interval holds some five modes. Measured on
    lattices of 1 to 3 axes, 200 to 40,000 balls.
    """
    unit = lattice.omega_mx
    overlapping = lattice.damping / lattice.mass * (1 + 3 * np.asarray(omega) / unit)
    return np.maximum(overlapping, 5 * unit / lattice.balls)


def expected_intervals(lattice, low, high):
    """Return how many intervals a sweep is expected to need, and frequencies among them.

    Not collective.

    Parameters
    ----------
    lattice : pgran.medium.lattice.Lattice or pgran.medium.network.Network
    low, high : float
        The ends of the sweep.

    Returns
    -------
    counts, omega : numpy.ndarray, shape (n,)
        How many intervals end below each frequency.
    """
    omega = np.linspace(low, high, 1001)
    density = 1 / interval_length(lattice, omega)
    steps = 0.5 * (density[1:] + density[:-1]) * np.diff(omega)
    return np.append(0.0, np.cumsum(steps)), omega


def deviation(omega, amplitude, derivative):
    """Return how far the curve leaves straight lines between neighbours, relative to itself.

    Not collective.

    Parameters
    ----------
    omega : numpy.ndarray, shape (n,)
    amplitude, derivative : numpy.ndarray of complex, shape (n, nd)

    Returns
    -------
    numpy.ndarray, shape (n - 1, nd)
        Infinite where an end is unknown.
    """
    with np.errstate(all="ignore"):
        chord = np.diff(amplitude, axis=0)
        width = np.diff(omega)[:, None]
        below, above = width * derivative[:-1] - chord, width * derivative[1:] - chord
        # besides, where the line is nearest to zero
        nearest = np.where(chord == 0, 0.5, np.clip((-amplitude[:-1] / chord).real, 0, 1))
        t = np.stack(np.broadcast_arrays(*PLACES, nearest))
        bend = t * (1 - t) * ((1 - t) * below - t * above)
        found = np.abs(bend) / np.abs(amplitude[:-1] + t * chord + bend)
    return np.where(np.isfinite(found), found, np.inf).max(axis=0)


def line_errors(medium, omega, amplitude, derivative, modelled, tolerance):
    """Return how far the curve may leave straight lines between neighbours, relative to itself.

    Not collective. Where no model covers a line, the `deviation`, which the cubic only estimates,
    is raised by 1 / `SHARE`, and by what it would miss of a resonance between the neighbours.

    Parameters
    ----------
    medium : pgran.medium.lattice.Lattice or pgran.medium.network.Network
        In its own unit.
    omega : numpy.ndarray, shape (n,)
    amplitude, derivative : numpy.ndarray of complex, shape (n, nd)
    modelled : numpy.ndarray of bool, shape (n - 1,)
        Which lines were compared with a proven model.
    tolerance : float
        Of the lines: normal frequencies are looked for only if what is said of one hangs on them.

    Returns
    -------
    numpy.ndarray, shape (n - 1, nd)
        Infinite where an end is unknown, or anything may be hidden.
    """
    seen = deviation(omega, amplitude, derivative)
    hides = np.where(modelled, 1.0, hidden_part(omega, medium.relaxation_rate) / SHARE)
    with np.errstate(invalid="ignore"):
        doubtful = (seen <= LOOSEST) & (seen * hides[:, None] > tolerance)
    if doubtful.any() and medium.balls <= FEW_UNKNOWNS:
        clear = ~is_near_mode(omega, *normal_frequencies(medium))
        hides[clear & ~modelled] = 1 / SHARE
    with np.errstate(invalid="ignore"):
        return np.where(np.isinf(hides)[:, None], np.inf, seen * hides[:, None])


def hidden_part(omega, relaxation_rate):
    """Return by what factor a resonance between neighbours exceeds what the cubic shows of it.

    Not collective. A damped mode x, S(s) x = 0, has |s|^2 = x^H K x / x^H M x and -2 Re s =
    x^H C x / x^H M x, and x^H K x <= q x^H C x, q being the largest k / beta of a spring. So all
    poles lie in the disc |s + q| <= q, and none is nearer to i omega than

        h = sqrt(q^2 + omega^2) - q.

    Of a pole at the distance h, halfway between neighbours d apart, the cubic shows a deviation
    that is too small by the factor 1 + (d / 2 h)^2; at other places it shows more.

    Parameters
    ----------
    omega : numpy.ndarray, shape (n,)
    relaxation_rate : float
        q; infinite if a spring has no dashpot.

    Returns
    -------
    numpy.ndarray, shape (n - 1,)
    """
    low, q = omega[:-1], relaxation_rate
    with np.errstate(all="ignore"):
        return 1 + (np.diff(omega) * (np.hypot(q, low) + q) / (2 * low**2)) ** 2


def is_near_mode(omega, lowest, highest):
    """Return which lines have a normal frequency between their ends, or as near as these are.

    Not collective.

    Parameters
    ----------
    omega : numpy.ndarray, shape (n,)
    lowest, highest : numpy.ndarray, shape (nm,)
        Between which each normal frequency lies, both ascending.
    """
    width = np.diff(omega)
    begun = np.searchsorted(lowest, omega[1:] + width, side="right")
    return begun > np.searchsorted(highest, omega[:-1] - width)


def resolve(evaluate, omegas, tolerance):
    """Return a curve at frequencies so close that straight lines between them are right.

    Not collective.

    Parameters
    ----------
    evaluate : callable
        Takes frequencies and whether `derivatives` are wanted, returns an array of
        `models.point_dtype`.
    omegas : numpy.ndarray
        Frequencies to begin with, ascending.
    tolerance : float
        Of the lines, relative to the amplitude; 0 adds no frequency.
    """
    points = evaluate(omegas)
    for _ in range(PASSES if tolerance else 0):
        omega = points["omega"]
        missed = deviation(omega, points["displacement"], points["derivative"]).max(axis=1)
        missed /= SHARE * tolerance
        missed[(np.diff(omega) <= 1e-12 * omega[1:]) | ~np.isfinite(missed)] = 0.0
        # the deviation falls with the square of the distance
        count = np.clip(np.ceil(np.sqrt(missed)) - 1, 0, MOST_ADDED).astype(int)
        if not count.any():
            count = _astray(evaluate, points, missed > DOUBT, tolerance).astype(int)
        if not count.any():
            break
        place = np.concatenate([np.arange(1, n + 1) / (n + 1) for n in count])
        start, width = (np.repeat(x, count) for x in (omega[:-1], np.diff(omega)))
        points = np.concatenate([points, evaluate(start + place * width)])
        points = points[np.argsort(points["omega"], kind="stable")]
    return points


def _astray(evaluate, points, doubtful, tolerance):
    """Return which doubtful lines miss the curve halfway, whatever the cubic says."""
    before, after = points[:-1][doubtful], points[1:][doubtful]
    half = evaluate(0.5 * (before["omega"] + after["omega"]), derivatives=False)["displacement"]
    with np.errstate(all="ignore"):
        missed = np.abs(half - 0.5 * (before["displacement"] + after["displacement"]))
    astray = np.zeros(len(doubtful), dtype=bool)
    astray[doubtful] = np.any(missed > tolerance * np.abs(half), axis=1)
    return astray


def normal_frequencies(medium):
    """Return between which two numbers each normal frequency lies, from all of dense K.

    Not collective. For few unknowns n: it takes n^3 operations. An unstable mode has none, and
    stands at 0.

    Parameters
    ----------
    medium : pgran.medium.lattice.Lattice or pgran.medium.network.Network
        In its own unit.

    Returns
    -------
    lowest, highest : numpy.ndarray, shape (n,)
        Ascending, apart by what rounding may do.
    """
    units = np.eye(medium.balls).reshape(-1, *medium.shape)
    values = np.linalg.eigvalsh(medium.restoring_forces(units).reshape(-1, medium.balls))
    error = 4 * len(values) * EPSILON * medium.stiffness_norm
    return tuple(np.sqrt(np.maximum(values + e, 0.0) / medium.mass) for e in (-error, error))
