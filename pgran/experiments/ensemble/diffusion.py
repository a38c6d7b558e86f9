"""Energy of pulses that diffuses between two walls, and the fit of it to an ensemble.

Along the depth z energy spreads with D. Walls at 0 and W let none through, as what does not move
does no work, and it is absorbed at the rate 1/tau. A drive of the strength s(t) sends

    <u^2> ~ int s(t') e^(-(t-t')/tau) [1 + 2 sum_n cos(n pi z/W) e^(-D (n pi/W)^2 (t-t'))] dt'.

It holds once what comes straight has gone by, and not next to walls, where u = 0.
"""

import math

import numpy as np

from pgran.errors import InputError
from pgran.experiments.ensemble.profiles import along, certain
from pgran.experiments.ensemble.record import Diffusion
from pgran.experiments.pulse.signals import front_speed
from pgran.store.estimate import FEWEST_SAMPLES, Estimate, mean_of, plug_in, with_errors

MODES = 48  # cosines between the walls
BLOCKS = 24  # of times, over which squares are averaged
SENT = 0.999  # of the drive's square: what has passed when it has ended
LARGEST = 50.0  # of ln (D / guess)
ALIKE = 1e-6  # relative errors that are rounding, of samples that do not differ
FLAT = 1e-12  # added to the matrix of the fit: what does not matter has an enormous error


def spreading(time, depth, walls, diffusivity, rate, sent, strength):
    """Return <u^2> at some times and depths but for a factor, shape (nt, nd).

    `walls` is W, `rate` 1/tau; the drive has a `strength` at equal times `sent`, all before `time`.
    """
    n = np.arange(MODES)
    decay = rate + diffusivity * (math.pi * n / walls) ** 2
    shape = np.where(n > 0, 2.0, 1.0)[:, None] * np.cos(math.pi / walls * np.outer(n, depth))
    begun = strength @ np.exp(-np.outer(time[0] - sent, decay))
    return (np.exp(-np.outer(time - time[0], decay)) * begun) @ shape


def diffusion(ensemble, depth, walls, window, axes):
    """Return the Diffusion of an ensemble of pulses at detectors of these depths, along `axes`.

    It is fitted at depths in the `window`, from when the drive has ended and its middle, at the
    speed of fronts, has reached the wall at rest. Errors are those over parts of the samples.
    """
    from scipy.optimize import least_squares

    depths, share, inside = along(depth, window)
    depths, good = depths[inside], ensemble.good > 0
    samples, time, strength = np.count_nonzero(good), ensemble.time, ensemble.drive[0] ** 2
    arrivals = np.array_split(ensemble.arrival[good], len(ensemble.square))  # of each part
    every = np.full(len(arrivals), True)

    def fronts(some):
        each = np.concatenate([arrivals[part] for part in np.flatnonzero(some)])
        return front_speed(np.tile(depth, len(each)), each.ravel()).value

    speed = fronts(every)
    ended = time[np.argmax(np.cumsum(strength) > SENT * strength.sum())]
    start = np.maximum(ended, time @ strength / strength.sum() + walls / speed)
    each = np.count_nonzero(time > start) // BLOCKS
    if samples < FEWEST_SAMPLES or each < 2:
        raise InputError(
            f"transport: {samples} samples and {each * BLOCKS} times after {start:.3g}, when the "
            f"drive's front has gone by, are there; {FEWEST_SAMPLES} and {2 * BLOCKS} are needed"
        )

    def blocks(values):
        values = values[..., -each * BLOCKS :, :]
        return values.reshape(*values.shape[:-2], BLOCKS, each, -1).mean(axis=-2)

    early, late = time <= start, time[-each * BLOCKS :]
    parts, middle = blocks((ensemble.square @ share)[..., inside]), blocks(time[:, None])
    span = np.ptp(late)

    def squares(some):
        square = mean_of(parts[some])
        known = square.error > ALIKE * square.value  # not NaN either
        # of each depth, all times together: few samples do not know errors of single blocks
        part = np.divide(square.error, square.value, out=np.zeros(known.shape), where=known)
        part = np.sqrt(np.sum(part**2, axis=0) / np.maximum(known.sum(axis=0), 1))
        return square, known, np.broadcast_to(part, known.shape)[known]

    square, known, _ = squares(every)
    if np.mean(known) < 0.5:
        raise InputError("transport: errors hide the signals, or all samples are alike")

    guess = walls**2 / (30 * span)  # too small a D: of too large ones nothing is seen

    def logarithm(x):  # of the model, for ln (D / guess), span / tau and the logarithm of a factor
        D, rate = guess * math.exp(min(x[0], LARGEST)), x[1] / span
        values = spreading(late, depths, walls, D, rate, time[early], strength[early])
        return x[2] + np.log(np.maximum(blocks(values), np.finfo(float).tiny))

    def fit(some, x):
        square, known, part = squares(some)
        levels = np.log(square.value[known])
        return least_squares(lambda x: (levels - logarithm(x)[known]) / part, x, method="lm")

    left = (np.log(square.value) - logarithm((0.0, 0.0, 0.0)))[known]
    slope, factor = np.polyfit(np.broadcast_to(middle, known.shape)[known], left, 1)
    best = fit(every, (0.0, -span * slope, factor))

    def constants(some):
        x = fit(some, best.x).x
        D, rate = guess * math.exp(min(x[0], LARGEST)), x[1] / span
        length = math.sqrt(D / rate) if rate > 0 else math.nan
        return np.array([D, rate, length, axes * D / fronts(some)])

    measured = plug_in(constants, len(parts))
    # of a D that hardly matters all parts may agree on the guess; not so the matrix of the fit
    formal = math.sqrt(np.linalg.inv(best.jac.T @ best.jac + FLAT * np.eye(3))[0, 0])
    least = formal * measured.value * [1.0, 0.0, 0.5, 1.0]
    part = np.maximum(measured.error, least) / measured.value
    # the longer side, as what is fitted is ln D
    error = measured.value * np.expm1(np.minimum(part, LARGEST))
    told = certain(Estimate(measured.value, error))
    names = "diffusivity", "absorption", "length", "free_path"
    numbers = zip(names, told.value.tolist(), told.error.tolist(), strict=True)
    return Diffusion(
        samples=samples,
        speed=speed,
        misfit=math.sqrt(np.sum(best.fun**2) / (len(best.fun) - len(best.x))),
        depth=depths,
        time=middle[:, 0],
        fit=np.exp(logarithm(best.x)),
        **with_errors(mean_square=square, **{name: Estimate(*pair) for name, *pair in numbers}),
    )
