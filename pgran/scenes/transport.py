"""Transport through an ensemble: amplitude, attenuation and delay against depth."""

import numpy as np

from pgran.arguments import called_right
from pgran.errors import InputError
from pgran.files.streams import saying_once
from pgran.results import Ensemble, Transport
from pgran.results.digits import two_digits
from pgran.results.si import SI
from pgran.scenes import common

FEWEST_DEPTHS = 3


@called_right
@saying_once()
def transport(medium, ensemble):
    """Return what an ensemble's responses say of transport.

    Not collective. Only samples count that are good. A delay that is not certain, as the amplitude
    may vanish there, has no weight.

    Parameters
    ----------
    medium : pgran.physics.lattice.Lattice or pgran.physics.network.Network
        One of the samples, or of their size.
    ensemble : pgran.results.Ensemble
        Of responses at detectors of three depths or more, with their curves.

    Returns
    -------
    pgran.results.Transport

    Raises
    ------
    InputError
        If there are no curves, or too few depths or samples, or an amplitude vanishes.
    """
    from pgran.physics.transport import (
        attenuation,
        delay_profile,
        intensity_profile,
        log_amplitude_profile,
    )

    if not isinstance(ensemble, Ensemble) or ensemble.displacement is None:
        raise InputError("transport: this ensemble has no curves; -ensemble_keep curves keeps them")
    depth, good = depths_of(common.medium(medium), ensemble.detector), ensemble.good > 0
    displacement = ensemble.displacement[good]
    logs = log_amplitude_profile(depth, displacement)
    intensity = intensity_profile(depth, displacement)
    line = attenuation(depth, displacement)
    # d arg A / d omega is minus the delay
    turned = -1j * np.nan_to_num(ensemble.sample_delay[good]) * displacement
    late = delay_profile(depth, displacement, turned)
    return Transport(
        samples=len(displacement),
        depth=logs.depth,
        omega=ensemble.omega,
        ln_amplitude=logs.mean.value,
        ln_amplitude_error=logs.mean.error,
        intensity=intensity.mean.value,
        intensity_error=intensity.mean.error,
        rate=line.rate.value,
        rate_error=line.rate.error,
        length=line.length.value,
        length_error=line.length.error,
        delay=late.mean.value,
        delay_error=late.mean.error,
    )


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
    known = np.isfinite(found.length)
    if not known.any():
        yield "no attenuation length: amplitudes do not fall with depth for certain"
        return
    shortest = np.flatnonzero(known)[np.argmin(found.length[known])]
    length, omega = found.length[shortest], found.omega[shortest]
    error = two_digits(found.length_error[shortest])
    yield (
        f"amplitudes fall with depth at {np.count_nonzero(known)} of {len(known)} frequencies; the "
        f"shortest attenuation length is {length:.3g} +- {error} "
        f"spacings{si.say('m', length)}, at omega = {omega:.4g}{si.say('Hz', omega)}"
    )
