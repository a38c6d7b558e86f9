"""The record of how far sound gets: amplitudes of many samples against depth."""

from dataclasses import dataclass

import numpy as np

from pgran.record import Record, array, attribute

PLACE = "omega", "depth"
BAND = "band", "depth"


@dataclass(frozen=True, eq=False, repr=False)
class Transport(Record):
    """Means over the samples of an ensemble, against the distance from what is driven.

    The straight line <ln|A|> = a - depth / length gives the attenuation length of the amplitude;
    the intensity falls in half of it. It is NaN where nothing falls for certain, and below
    `first_mode`, the lowest of the first sample, where no wave is excited and the walls alone make
    the fall. The group delay is weighted by intensity; `band_delay` is its mean over the
    frequencies between one `edge` and the next, which grows with depth by `delay_growth`. (Files
    before version 5 have no more of delays than a mean over all frequencies, `delay`, which is not
    read.) See `pgran.physics.transport`.
    """

    group = "transport"
    samples: int
    first_mode: float = attribute(since=5)
    depth: np.ndarray = array("distance from what is driven", "spacing")
    omega: np.ndarray = array("driving frequency, angular", "sqrt(k/m)")
    ln_amplitude: np.ndarray = array("mean of ln|A|", "1", *PLACE)
    ln_amplitude_error: np.ndarray = array("its standard error", "1", *PLACE)
    intensity: np.ndarray = array("mean of |A|^2", "1", *PLACE)
    intensity_error: np.ndarray = array("its standard error", "1", *PLACE)
    rate: np.ndarray = array("1 / attenuation length", "1/spacing", "omega")
    rate_error: np.ndarray = array("its standard error", "1/spacing", "omega")
    length: np.ndarray = array("attenuation length of the amplitude", "spacing", "omega")
    length_error: np.ndarray = array("its standard error", "spacing", "omega")
    group_delay: np.ndarray = array("mean group delay", "sqrt(m/k)", *PLACE, since=5)
    group_delay_error: np.ndarray = array("its standard error", "sqrt(m/k)", *PLACE, since=5)
    edge: np.ndarray = array("ends of bands of frequencies, angular", "sqrt(k/m)", since=5)
    band_delay: np.ndarray = array("mean group delay of a band", "sqrt(m/k)", *BAND, since=5)
    band_delay_error: np.ndarray = array("its standard error", "sqrt(m/k)", *BAND, since=5)
    delay_growth: np.ndarray = array(
        "growth of the mean group delay of a band with depth", "sqrt(m/k)/spacing", "band", since=5
    )
    delay_growth_error: np.ndarray = array(
        "its standard error", "sqrt(m/k)/spacing", "band", since=5
    )
