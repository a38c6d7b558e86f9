"""How far sound gets through an ensemble: of responses by depth, of pulses by diffusion.

Energy of pulses diffuses between two walls: along the depth z it spreads with D. Walls at 0 and W
let none through, as what does not move does no work, and it is absorbed at the rate 1/tau. A drive
of the strength s(t) sends

    <u^2> ~ int s(t') e^(-(t-t')/tau) [1 + 2 sum_n cos(n pi z/W) e^(-D (n pi/W)^2 (t-t'))] dt'.

It holds once what comes straight has gone by, and not next to walls, where u = 0.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from pgran.arguments import called_right
from pgran.errors import InputError
from pgran.experiments.ensemble.profiles import FEWEST_DEPTHS, Profiles, along, certain
from pgran.experiments.ensemble.record import CERTAIN, Diffusion, Ensemble, Transport
from pgran.experiments.modes.levels import first_mode
from pgran.medium.base import medium as medium_of
from pgran.medium.lattice import Lattice
from pgran.medium.network import Network
from pgran.run.experiment import Caution
from pgran.run.numbers import windows_of
from pgran.store.estimate import (
    FEWEST_SAMPLES,
    Estimate,
    mean_of,
    plug_in,
    told,
    with_errors,
)
from pgran.store.si import SI

RIM = 1 / 7  # of the system at both ends, which walls bend: 3 spacings of 20 x 20, as measured
BAND = 0.1  # omega_mx
RECIPROCAL = 4.0  # errors that a rate is above 0 by, if 1 / rate is told, with its longer side's
COSINES = 48  # between the walls
BLOCKS = 24  # of times, over which squares are averaged
SENT = 0.999  # of the drive's square: what has passed when it has ended
LARGEST = 50.0  # of ln (D / guess)
ALIKE = 1e-6  # relative errors that are rounding, of samples that do not differ
FLAT = 1e-12  # added to the matrix of the fit: what does not matter has an enormous error


@called_right
def transport(
    medium: "Lattice | Network", ensemble: Ensemble, depths: "ArrayLike | None" = None
) -> Transport | Diffusion:
    """Compute the transport of sound or energy from an ensemble of responses or pulses.

    Samples that are not good are left out. A delay that is not certain, as the amplitude may vanish
    there, has no weight. Where it is not certain that the delay grows with depth, waves are
    standing, and no length is given.

    Parameters
    ----------
    medium : pgran.Lattice or pgran.Network
        One of the samples, or of their size.
    ensemble : pgran.results.Ensemble
        Of responses or pulses at detectors of three depths or more, with their curves.
    depths : tuple of float, optional
        The lowest and the highest depth of lines and fits; by default a seventh of the system is
        left out at both ends.

    Returns
    -------
    pgran.results.Transport or pgran.results.Diffusion

    Raises
    ------
    InputError
        If there are no curves, or too few depths, samples or times, or an amplitude vanishes, or
        all frequencies lie below the first mode.

    Examples
    --------
    >>> box = {"shape": (12, 6), "damping": 0.1}
    >>> line = [(i, 3) for i in range(2, 10)]
    >>> many = pgran.ensemble(
    ...     "response", 10, lattice=box, omegas=[0.5, 0.6], detectors=line, keep="curves"
    ... )
    >>> found = pgran.transport(pgran.Lattice.random(**box), many)
    >>> found.ln_amplitude.shape, bool(np.all(found.rate > 0))
    ((2, 8), True)
    """
    if not has_curves(ensemble):
        raise InputError("transport: this ensemble has no curves; -ensemble_keep curves keeps them")
    medium = medium_of(medium)
    depth = np.asarray(medium.depths(medium.sites(ensemble.detector)), dtype=float)
    every = np.argwhere(np.ones(medium.shape)) if medium.is_grid else medium.free[:, None]
    length = float(medium.depths(every).max() + medium.is_grid)  # to a lattice's wall at rest
    rims = RIM * length, length - RIM * length
    window = rims if depths is None else window_of(depths)
    if ensemble.square is not None:
        if medium.push is not None or getattr(medium, "wall", None) is not None:
            raise InputError("transport: from a part of a wall, or a push, energy spreads sideways")
        return ensemble.measured(diffusion(ensemble, depth, length, window, medium.axes))
    first, omega = first_mode(medium), ensemble.omega
    if not np.any(omega >= first):
        raise InputError(f"transport: all frequencies lie below the first mode, at {first:.4g}")
    good = ensemble.good > 0
    displacement = ensemble.displacement[good]
    # dA/domega along the circle |A| alone: d arg A / domega is minus the delay
    turned = -1j * np.nan_to_num(ensemble.sample_delay[good]) * displacement
    profiles = Profiles(depth, displacement, turned, window)
    edges, over = _bands(omega, first, medium.omega_mx)
    growth = profiles.delay_growth(over)
    waves = np.any(over[growth.value > CERTAIN * growth.error] > 0, axis=0)
    rate, (wave_number, scattering) = profiles.attenuation(), profiles.coherent()

    def length_of(rate):
        rate = certain(rate, waves & (rate.value > RECIPROCAL * rate.error))
        return Estimate(1 / rate.value, 1 / (rate.value - rate.error) - 1 / rate.value)

    found = Transport(
        samples=len(displacement),
        first_mode=first,
        depth_low=float(window[0]),
        depth_high=float(window[1]),
        depth=profiles.depths,
        omega=omega,
        edge=edges,
        straightness=profiles.straightness(),
        **with_errors(
            ln_amplitude=mean_of(profiles.levels),
            intensity=mean_of(profiles.intensities),
            rate=rate,
            length=length_of(rate),
            intensity_length=length_of(profiles.attenuation_of_intensity()),
            wave_number=certain(wave_number, waves),
            scattering_length=length_of(scattering),
            group_delay=profiles.delay(),
            band_delay=profiles.delay(over),
            delay_growth=growth,
        ),
    )
    return ensemble.measured(found)


def has_curves(ensemble):
    """Return whether an ensemble has amplitudes or squares to be looked at against depth."""
    curves = isinstance(ensemble, Ensemble) and (ensemble.displacement, ensemble.square)
    return bool(curves) and any(curve is not None for curve in curves)


def is_line(medium, detectors):
    """Return whether detectors have so many depths that a run looks at transport unasked."""
    depth = np.asarray(medium.depths(detectors), dtype=float)
    return bool(np.all(np.isfinite(depth)) and len(np.unique(depth)) >= FEWEST_DEPTHS)


def window_of(depths):
    """Return two depths that were handed in, checked."""
    windows = windows_of("-transport_depths", depths)
    if len(windows) > 1:
        raise InputError("-transport_depths: one window of depths is needed, low,high")
    return windows[0]


def _bands(omega, first, unit):
    """Return the edges of bands above the first mode, and the averages over each, (bands, nw).

    As many as are about `BAND` wide, or fewer, so that there are frequencies in each.
    """
    waves, low = omega[omega >= first], max(first, omega.min())
    count = max(1, round((omega.max() - low) / (BAND * unit)))
    while not np.all(np.histogram(waves, edges := np.linspace(low, omega.max(), count + 1))[0]):
        count -= 1
    place = np.minimum(np.searchsorted(edges, omega, "right"), count) - 1
    inside = (place == np.arange(count)[:, None]) & (omega >= first)
    return edges, inside / np.count_nonzero(inside, axis=1, keepdims=True)


def spreading(time, depth, walls, diffusivity, rate, sent, strength):
    """Return <u^2> at some times and depths but for a factor, shape (nt, nd).

    `walls` is W, `rate` 1/tau; the drive has a `strength` at equal times `sent`, all before `time`.
    """
    n = np.arange(COSINES)
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

    from pgran.experiments.pulse.signals import front_speed

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
    sure = certain(Estimate(measured.value, error))
    names = "diffusivity", "absorption", "length", "free_path"
    numbers = zip(names, sure.value.tolist(), sure.error.tolist(), strict=True)
    return Diffusion(
        samples=samples,
        speed=speed,
        misfit=math.sqrt(np.sum(best.fun**2) / (len(best.fun) - len(best.x))),
        depth=depths,
        time=middle[:, 0],
        fit=np.exp(logarithm(best.x)),
        **with_errors(mean_square=square, **{name: Estimate(*pair) for name, *pair in numbers}),
    )


def summary(result):
    """Return in words how far sound gets."""
    si = SI.of(result)
    if found := getattr(result, "diffusion", None):
        yield from _diffusion(found, si)
        return
    found = result.transport
    if not np.any(found.propagates):
        yield "sound propagates nowhere: in no band the group delay grows with depth for certain"
        return
    ends = np.flatnonzero(np.diff(found.propagates, prepend=False, append=False)).reshape(-1, 2)
    ranges = ", ".join(f"{low:.3g} to {high:.3g}" for low, high in found.edge[ends])
    growth = np.where(found.propagates, found.delay_growth, np.nan)
    least, most = (told(found, "delay_growth", f(growth)) for f in (np.nanargmin, np.nanargmax))
    yield (
        f"sound propagates at omega from {ranges}: there the group delay grows with depth for "
        f"certain, by {least} to {most} a spacing; elsewhere no lengths are given"
    )
    for name, words in (("length", "attenuation"), ("scattering_length", "scattering")):
        values = getattr(found, name)
        if known := np.count_nonzero(np.isfinite(values)):
            n = np.nanargmin(values)
            length, omega = si.say("m", values[n]), found.omega[n]
            yield (
                f"the {words} length is certain at {known} frequencies; the shortest is "
                f"{told(found, name, n)} spacings{length}, at omega = {omega:.4g}"
                f"{si.say('Hz', omega)}"
            )
    if refused := np.count_nonzero(found.refused):
        yield f"at {refused} frequencies <ln|A|> is not straight (p < {found.REFUSED:g})"


def _diffusion(found, si):
    """Return in words how energy diffuses."""
    if found.misfit > found.WRONG:
        yield Caution("no diffusion with one D and one tau: residuals are far beyond their errors")
    (low, high), start = found.depth[[0, -1]], found.time[0]
    yield (
        f"energy diffuses with D = {told(found, 'diffusivity')} and is absorbed at the rate "
        f"{told(found, 'absorption')}: sqrt(D tau) = {told(found, 'length')} "
        f"spacings{si.say('m', found.length)}; the transport mean free path is "
        f"{told(found, 'free_path')} spacings, as fronts run at {found.speed:.3g}; from {low:.3g} "
        f"to {high:.3g} spacings deep and the time {start:.4g} on residuals are "
        f"{found.misfit:.2g} of their errors"
    )
