"""How far sound gets through an ensemble: of responses by depth, of pulses by diffusion."""

import numpy as np

from pgran.arguments import called_right
from pgran.errors import InputError
from pgran.experiments.ensemble.diffusion import diffusion
from pgran.experiments.ensemble.profiles import FEWEST_DEPTHS, Profiles, certain
from pgran.experiments.ensemble.record import CERTAIN, Ensemble, Transport
from pgran.experiments.modes.levels import first_mode
from pgran.medium.base import medium as medium_of
from pgran.run.experiment import Caution
from pgran.run.numbers import windows_of
from pgran.store.estimate import Estimate, mean_of, told, with_errors
from pgran.store.si import SI

RIM = 1 / 7  # of the system at both ends, which walls bend: 3 spacings of 20 x 20, as measured
BAND = 0.1  # omega_mx
RECIPROCAL = 4.0  # errors that a rate is above 0 by, if 1 / rate is told, with its longer side's


@called_right
def transport(medium, ensemble, depths=None):
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
        return diffusion(ensemble, depth, length, window, medium.axes)
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

    return Transport(
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
