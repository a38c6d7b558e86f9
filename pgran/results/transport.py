"""The record of how far sound gets: amplitudes of many samples against depth."""

from dataclasses import dataclass

import numpy as np

from pgran.record import Record, array

PLACE = "omega", "depth"


@dataclass(frozen=True, eq=False, repr=False)
class Transport(Record):
    """Means over the samples of an ensemble, against the distance from what is driven.

    The straight line <ln|A|> = a - depth / length gives the attenuation length of the amplitude;
    the intensity falls in half of it. It is NaN where nothing falls for certain. The delay is
    weighted by intensity, over all frequencies. See `pgran.physics.transport`.
    """

    group = "transport"
    samples: int
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
    delay: np.ndarray = array("mean group delay", "sqrt(m/k)", "depth")
    delay_error: np.ndarray = array("its standard error", "sqrt(m/k)", "depth")
