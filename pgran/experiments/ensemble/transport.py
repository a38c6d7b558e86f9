"""Transport through an ensemble: amplitude, attenuation and delay against depth."""

import numpy as np

from pgran.arguments import called_right
from pgran.errors import InputError
from pgran.experiments.ensemble.record import Ensemble, Transport
from pgran.experiments.modes.levels import REGIMES
from pgran.medium.base import medium as medium_of
from pgran.run.streams import saying_once
from pgran.store.estimate import two_digits
from pgran.store.si import SI

FEWEST_DEPTHS = 3


@called_right
@saying_once()
def transport(medium, ensemble):
    """Return what an ensemble's responses say of transport.

    Not collective. Only samples count that are good. A delay that is not certain, as the amplitude
    may vanish there, has no weight. Below the first mode walls alone make amplitudes fall, in a
    length that is geometry, and there is none.

    Parameters
    ----------
    medium : pgran.medium.lattice.Lattice or pgran.medium.network.Network
        One of the samples, or of their size.
    ensemble : pgran.results.Ensemble
        Of responses at detectors of three depths or more, with their curves.

    Returns
    -------
    pgran.results.Transport

    Raises
    ------
    InputError
        If there are no curves, or too few depths or samples, or an amplitude vanishes, or all
        frequencies lie below the first mode.
    """
    from pgran.experiments.ensemble.localization import (
        attenuation,
        delay_per_depth,
        delay_profile,
        intensity_profile,
        log_amplitude_profile,
    )
    from pgran.experiments.modes.levels import first_mode

    if not isinstance(ensemble, Ensemble) or ensemble.displacement is None:
        raise InputError("transport: this ensemble has no curves; -ensemble_keep curves keeps them")
    medium = medium_of(medium)
    first, omega = first_mode(medium), ensemble.omega
    waves = omega >= first
    if not waves.any():
        raise InputError(f"transport: all frequencies lie below the first mode, at {first:.4g}")
    depth, good = depths_of(medium, ensemble.detector), ensemble.good > 0
    displacement = ensemble.displacement[good]
    logs = log_amplitude_profile(depth, displacement)
    intensity = intensity_profile(depth, displacement)
    line = attenuation(depth, displacement)
    # d arg A / d omega is minus the delay
    turned = -1j * np.nan_to_num(ensemble.sample_delay[good]) * displacement
    edges, over = _bands(omega, first, medium.omega_mx)
    late = delay_profile(depth, displacement, turned)
    banded = delay_profile(depth, displacement, turned, over)
    growth = delay_per_depth(depth, displacement, turned, over)
    return Transport(
        samples=len(displacement),
        first_mode=first,
        depth=logs.depth,
        omega=omega,
        ln_amplitude=logs.mean.value,
        ln_amplitude_error=logs.mean.error,
        intensity=intensity.mean.value,
        intensity_error=intensity.mean.error,
        rate=line.rate.value,
        rate_error=line.rate.error,
        length=np.where(waves, line.length.value, np.nan),
        length_error=np.where(waves, line.length.error, np.nan),
        group_delay=late.mean.value,
        group_delay_error=late.mean.error,
        edge=edges,
        band_delay=banded.mean.value,
        band_delay_error=banded.mean.error,
        delay_growth=growth.value,
        delay_growth_error=growth.error,
    )


def _bands(omega, first, unit):
    """Return the edges of bands above the first mode, and the averages over each, (bands, nw)."""
    ends, rows = [], []
    for _, low, high in REGIMES:
        inside = (omega >= max(first, low * unit)) & (omega < high * unit)
        if inside.any():
            lowest = max(first, low * unit, omega.min())
            ends[len(rows) :] = [lowest, min(high * unit, omega.max())]
            rows.append(inside / np.count_nonzero(inside))
    return np.array(ends), np.array(rows)


def depths_of(medium, detectors):
    """Return the depth of each detector; NaN where it is unknown. Not collective."""
    return np.asarray(medium.depths(detectors), dtype=float)


def is_line(medium, detectors):
    """Return whether detectors lie at so many depths that a line tells something. Not collective.

    Then a run looks at transport without being asked.
    """
    depth = depths_of(medium, detectors)
    return bool(np.all(np.isfinite(depth)) and len(np.unique(depth)) >= FEWEST_DEPTHS)


def summary(result):
    """Return in words how far sound gets. Not collective."""
    found, si = result.transport, SI.of(result)
    known, waves = np.isfinite(found.length), found.omega >= found.first_mode
    if not known.any():
        yield "no attenuation length: amplitudes do not fall with depth for certain"
    else:
        shortest = np.flatnonzero(known)[np.argmin(found.length[known])]
        length, omega = found.length[shortest], found.omega[shortest]
        error = two_digits(found.length_error[shortest])
        yield (
            f"amplitudes fall with depth at {np.count_nonzero(known)} of "
            f"{np.count_nonzero(waves)} frequencies above the first mode, {found.first_mode:.4g}; "
            f"the shortest attenuation length is {length:.3g} +- {error} "
            f"spacings{si.say('m', length)}, at omega = {omega:.4g}{si.say('Hz', omega)}"
        )
    for low, high, growth, error in zip(
        found.edge[:-1], found.edge[1:], found.delay_growth, found.delay_growth_error, strict=True
    ):
        yield (
            f"from {low:.3g} to {high:.3g}{si.say('Hz', low, high)} the group delay grows by "
            f"{growth:.3g} +- {two_digits(error)} a spacing"
        )
