"""A resolved curve: straight lines between its points are right, and what may hide between them.

With the derivatives at both ends the amplitude between two neighbours is a cubic (Hermite's). Where
that cubic leaves the straight line between them, the line is wrong; where it does so by a large
part of the amplitude, the phase may have turned unseen. A resonance much narrower than the distance
hides from the cubic; what rules it out is a proven model, that no mode is near, or that all poles
are too far from the real axis. NumPy only.
"""

import numpy as np

from pgran.medium.base import EPSILON

PLACES = 0.25, 0.5, 0.75  # between two neighbours
SHARE = 0.8  # aim at this part of the deviation allowed, which the cubic only estimates
DOUBT = 0.3  # of that part: where the cubic says more, the line is looked at once more
DENSE = 1000  # unknowns, of which all normal frequencies are found in a tenth of a second
MAX_ADDED = 7  # frequencies between two neighbours in one pass
PASSES = 40
LOOSEST = 0.5  # of the amplitude: lines further off than that are wrong for any use


def deviation(omega, amplitude, derivative):
    """Return how far the curve leaves straight lines between neighbours, relative to itself.

    Of amplitudes and derivatives, complex, of the shape (n, nd), at `omega` (n,). Between two
    neighbours, at the part t of their distance h, the cubic leaves its chord c by

        t (1 - t) ((1 - t) (h A'_below - c) - t (h A'_above - c)).

    What is returned has the shape (n - 1, nd), and is infinite where an end is unknown.
    """
    with np.errstate(all="ignore"):
        chord = np.diff(amplitude, axis=0)
        width = np.diff(omega)[:, None]
        below, above = width * derivative[:-1] - chord, width * derivative[1:] - chord
        # besides, where the line is nearest to zero
        nearest = np.where(chord == 0, 0.5, np.clip((-amplitude[:-1] / chord).real, 0, 1))
        t = np.stack(np.broadcast_arrays(*PLACES, nearest))
        bend = t * (1 - t) * ((1 - t) * below - t * above)
        relative = np.abs(bend) / np.abs(amplitude[:-1] + t * chord + bend)
    return np.where(np.isfinite(relative), relative, np.inf).max(axis=0)


def line_errors(medium, omega, amplitude, derivative, modelled, tolerance):
    """Return how far the curve may leave straight lines between neighbours, relative to itself.

    As `deviation` does. Where no proven model was compared with a line, `modelled` (n - 1,), the
    `deviation`, which the cubic only estimates, is raised by 1 / `SHARE`, and by what it would miss
    of a resonance between the neighbours. The medium is in its own unit; its normal frequencies are
    looked for only if a line's meeting the `tolerance` hangs on them.
    """
    seen = deviation(omega, amplitude, derivative)
    hides = np.where(modelled, 1.0, hidden_part(omega, medium.relaxation_rate) / SHARE)
    with np.errstate(invalid="ignore"):
        doubtful = (seen <= LOOSEST) & (seen * hides[:, None] > tolerance)
    if doubtful.any() and medium.size <= DENSE:
        clear = ~is_near_mode(omega, *normal_frequencies(medium))
        hides[clear & ~modelled] = 1 / SHARE
    with np.errstate(invalid="ignore"):  # 0 times infinity
        return np.where(np.isinf(hides)[:, None], np.inf, seen * hides[:, None])


def hidden_part(omega, relaxation_rate):
    """Return by what factor a resonance between neighbours exceeds what the cubic shows of it.

    A damped mode x, S(s) x = 0, has |s|^2 = x^H K x / x^H M x and -2 Re s = x^H C x / x^H M x, and
    x^H K x <= q x^H C x, q being the largest k / beta of a spring, the `relaxation_rate`; infinite
    if one has no dashpot. So all poles lie in the disc |s + q| <= q, and none is nearer to i omega
    than

        h = sqrt(q^2 + omega^2) - q.

    Of a pole at the distance h, halfway between neighbours d apart, the cubic shows a deviation
    that is too small by the factor 1 + (d / 2 h)^2; at other places it shows more.
    """
    low, q = omega[:-1], relaxation_rate
    with np.errstate(all="ignore"):
        # 1 / h = (sqrt(q^2 + omega^2) + q) / omega^2, which cancels nothing
        return 1 + (np.diff(omega) * (np.hypot(q, low) + q) / (2 * low**2)) ** 2


def is_near_mode(omega, lowest, highest):
    """Return which lines have a normal frequency between their ends, or as near as these are.

    Each normal frequency lies between its `lowest` and `highest`, both ascending.
    """
    width = np.diff(omega)
    begun = np.searchsorted(lowest, omega[1:] + width, side="right")
    return begun > np.searchsorted(highest, omega[:-1] - width)


def normal_frequencies(medium):
    """Return between which two numbers each normal frequency lies, from all of dense K.

    Ascending arrays, apart by what rounding may do. An unstable mode stands at 0.
    """
    units = np.eye(medium.size).reshape(-1, *medium.shape)
    values = np.linalg.eigvalsh(medium.restoring_forces(units).reshape(-1, medium.size))
    error = 4 * len(values) * EPSILON * medium.stiffness_norm
    return tuple(np.sqrt(np.maximum(values + e, 0.0) / medium.mass) for e in (-error, error))


def resolve(evaluate, omegas, tolerance):
    """Return a curve at frequencies so close that straight lines between them are right.

    To the `tolerance`, relative to the amplitude. `evaluate` takes frequencies, and whether
    `derivatives` are wanted, and returns points, as `models.evaluate` does; `omegas`, ascending,
    are those to begin with.
    """
    points = evaluate(omegas)
    for _ in range(PASSES):
        omega = points["omega"]
        missed = deviation(omega, points["displacement"], points["derivative"]).max(axis=1)
        missed /= SHARE * tolerance
        missed[(np.diff(omega) <= 1e-12 * omega[1:]) | ~np.isfinite(missed)] = 0.0
        # the deviation falls with the square of the distance
        count = np.clip(np.ceil(np.sqrt(missed)) - 1, 0, MAX_ADDED).astype(int)
        if not count.any():
            count = _astray(evaluate, points, missed > DOUBT, tolerance).astype(int)
        if not count.any():
            break
        # count[i] frequencies cut line i into equal parts
        part = np.concatenate([np.arange(1, n + 1) / (n + 1) for n in count])
        start, width = (np.repeat(x, count) for x in (omega[:-1], np.diff(omega)))
        points = np.concatenate([points, evaluate(start + part * width)])
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
