"""What is read from signals in time: fronts, envelopes, codas, work and energy. NumPy and SciPy."""

import numpy as np

from pgran.experiments.pulse.laplace import AT_ONCE
from pgran.medium.rounding import SMALLEST_NORMAL

FRONT = 1e-3  # of the integral of v^2: what has passed when a front has arrived
BLOCKS, FEWEST_BLOCKS = 16, 6  # that a coda is cut into, and that a rate needs
NODES = 6  # steps of an integrator that a polynomial goes through
DEGREE = 11  # of the splines that are integrated: an odd number


def arrivals(time, velocity, error, earliest=0.0):
    """Return when FRONT of each signal's energy, the integral of v^2, has passed.

    Not collective. NaN where errors hide it, nothing moves, or it would be before the `earliest`,
    the driven wall's own: of a motion whose early part alone passes, say, shares of the whole tell
    no front.

    Parameters
    ----------
    time : numpy.ndarray, shape (nt,)
    velocity, error : numpy.ndarray, shape (nt, nd)
    earliest : float
    """
    passed, wrong = (_passed(time, x) for x in (velocity, error))
    found = []
    for energy, missed in zip(passed.T, wrong.T, strict=True):
        level = FRONT * energy[-1]
        first = np.argmax(energy > level)
        if not missed[first] < 0.01 * level:  # a tenth of the velocity
            found.append(np.nan)
            continue
        part = (level - energy[first - 1]) / (energy[first] - energy[first - 1])
        at = time[first - 1] + part * (time[first] - time[first - 1])
        found.append(at if at >= earliest else np.nan)
    return np.array(found)


def _passed(time, x):
    """Return the integral of x^2 until each time, by the trapezoidal rule, shape (nt, nd)."""
    squares = x**2
    parts = 0.5 * np.diff(time)[:, None] * (squares[1:] + squares[:-1])
    return np.concatenate([np.zeros((1, x.shape[1])), np.cumsum(parts, axis=0)])


def envelopes(displacement, velocity):
    """Return sqrt(u^2 + (v / omega)^2), omega^2 the mean of v^2 over that of u^2.

    Not collective. It begins with the signal, unlike those by Hilbert's transform or a smoothing.

    Parameters
    ----------
    displacement, velocity : numpy.ndarray, shape (nt, nd)
    """
    u, v = np.sum(displacement**2, axis=0), np.sum(velocity**2, axis=0)
    slowness = np.sqrt(u / np.maximum(v, SMALLEST_NORMAL))
    return np.hypot(displacement, slowness * velocity)


def centres(time, envelope):
    """Return the mean time of each envelope, weighted by its square. Not collective."""
    weights = envelope**2
    return time @ weights / np.maximum(weights.sum(axis=0), SMALLEST_NORMAL)


def codas(time, envelope, error):
    """Return the rates at which envelopes decay after their centres, and their standard errors.

    Not collective. A straight line goes through the logarithm of the mean square of each of BLOCKS
    blocks, as far as errors are below a tenth of it; NaN where too few are left, or nothing decays.

    Parameters
    ----------
    time : numpy.ndarray, shape (nt,)
    envelope, error : numpy.ndarray, shape (nt, nd)
        The error is that of the displacement.
    """
    from scipy.stats import linregress  # here: SciPy takes its time, and all scenes are imported

    rates = np.full((2, envelope.shape[1]), np.nan)
    for d, centre in enumerate(centres(time, envelope)):
        after = np.flatnonzero(time > centre)
        if len(after) < 4 * BLOCKS:
            continue
        blocks = np.array_split(after, BLOCKS)
        level = np.array([np.mean(envelope[block, d] ** 2) for block in blocks])
        known = np.array([error[block, d].max() for block in blocks]) ** 2 < 0.01 * level
        count = BLOCKS if known.all() else np.argmin(known)
        if count >= FEWEST_BLOCKS:
            middle = [time[block].mean() for block in blocks[:count]]
            line = linregress(middle, np.log(level[:count]))
            if line.slope < 0:
                rates[:, d] = -line.slope / 2, line.stderr / 2
    return rates


def integral(time, values, at=None):
    """Return the integral of a smooth function, given at equal times, from the first one on.

    Not collective. By a spline of degree DEGREE; at the same times unless others are given.
    """
    from scipy.interpolate import make_interp_spline

    degree, at = min(DEGREE, (len(time) - 1) // 2 * 2 - 1), time if at is None else at
    if degree < 1:
        steps = np.diff(time) * (values[1:] + values[:-1]) / 2
        return np.interp(at, time, np.append(0.0, np.cumsum(steps)))
    return make_interp_spline(time, values, degree).antiderivative()(at)


def interpolated(nodes, values, slopes, time):
    """Return functions at any times from their values and slopes at an integrator's steps.

    Not collective. By polynomials of degree 11 through six steps around each time.

    Parameters
    ----------
    nodes : numpy.ndarray, shape (steps,)
        Increasing; they embrace all times.
    values, slopes : numpy.ndarray, shape (steps, ...)
    time : numpy.ndarray, shape (nt,)
    """
    count = min(NODES, len(nodes))
    first = np.searchsorted(nodes, time) - count // 2
    near = np.clip(first, 0, len(nodes) - count)[:, None] + np.arange(count)
    t = nodes[near]
    apart = t[:, :, None] - t[:, None, :] + np.eye(count)
    away = (time[:, None] - t)[:, None, :] * np.ones((count, 1))
    away[:, np.eye(count, dtype=bool)] = 1.0
    square = np.prod(away / apart, axis=2) ** 2  # of Lagrange's polynomials
    turn = np.sum(1 / apart, axis=2) - 1.0  # their slopes at their own nodes
    offset = time[:, None] - t
    of_values, of_slopes = (1 - 2 * offset * turn) * square, offset * square
    return np.einsum("tn,tn...->t...", of_values, values[near]) + np.einsum(
        "tn,tn...->t...", of_slopes, slopes[near]
    )


def energies(lattice, line, field, time, fine):
    """Return the energy of all springs and balls, and the power that the dashpots take.

    Not collective.

    Parameters
    ----------
    lattice : pgran.medium.lattice.Lattice or pgran.medium.network.Network
    line : pgran.experiments.pulse.laplace.Line
    field : numpy.ndarray, shape (ns, *lattice.shape)
        A(s) of all balls.
    time, fine : numpy.ndarray
        At which the energy is wanted, and the power.

    Returns
    -------
    energy, power : numpy.ndarray, of the shapes of `time` and `fine`
    """
    s, U = line.s[:, None], line.transform.reshape(-1, *[1] * (field.ndim - 1))
    moved = field * U
    flat = moved.reshape(len(s), -1)
    energy = _squares(line, s * flat, np.full(flat.shape[1], 0.5 * lattice.mass), time)
    power = np.zeros_like(fine)
    for longer, k, damped in lattice.stretched(moved, line.transform):
        energy += _squares(line, longer, 0.5 * k, time)
        if lattice.damping:
            power += _squares(line, s * longer, lattice.damping * damped, fine)
    return energy, power


def _squares(line, transforms, weights, time):
    """Return at some times the weighted sum of squares of functions, from transforms (ns, n)."""
    parts = np.array_split(time, 1 + len(time) * len(line.s) // AT_ONCE)
    return np.concatenate([line.at(part, transforms) ** 2 @ weights for part in parts])
