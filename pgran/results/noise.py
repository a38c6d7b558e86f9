"""The record of how noisy the responses of an ensemble are."""

from dataclasses import dataclass

import numpy as np

from pgran.record import Record, array
from pgran.results.response import DETECTOR

PLACE = "window", "detector_number"
EACH = *PLACE, "part"


@dataclass(frozen=True, eq=False, repr=False)
class NoiseStatistics(Record):
    """The intensity I = |A|^2 of an ensemble's responses in windows of frequencies.

    Of the `whole` field, and of the `incoherent` one, A less its mean over the samples. `density`
    is that of I/<I> in the bins between `edge`, `correlation` <dI(omega) dI(omega + shift)> /
    <dI^2> with dI = I/<I> - 1. What could not be measured is NaN.
    """

    group = "statistics"
    samples: int
    low: np.ndarray = array("lower end of the window, angular", "sqrt(k/m)", "window")
    high: np.ndarray = array("upper end of the window, angular", "sqrt(k/m)", "window")
    part: np.ndarray = array("of which part of the field A", "1", dtype=str)
    detector: np.ndarray = array(DETECTOR, "1", "detector_number", "axis", dtype=int)
    edge: np.ndarray = array("edges of the bins of I/<I>", "1")
    shift: np.ndarray = array("shift along omega", "sqrt(k/m)", "window", "shift_number")
    coherent_part: np.ndarray = array("|<A>|^2 / <|A|^2>", "1", *PLACE)
    coherent_part_error: np.ndarray = array("its standard error", "1", *PLACE)
    contrast: np.ndarray = array("<I^2>/<I>^2", "1", *EACH)
    contrast_error: np.ndarray = array("its standard error", "1", *EACH)
    spread: np.ndarray = array("standard deviation of 10 log10 I", "dB", *EACH)
    spread_error: np.ndarray = array("its standard error", "dB", *EACH)
    half_width: np.ndarray = array("shift at which the correlation is 1/2", "sqrt(k/m)", *EACH)
    half_width_error: np.ndarray = array("its standard error", "sqrt(k/m)", *EACH)
    maxima_spacing: np.ndarray = array("mean distance of maxima of |A|", "sqrt(k/m)", *EACH)
    maxima_spacing_error: np.ndarray = array("its standard error", "sqrt(k/m)", *EACH)
    density: np.ndarray = array("density of I/<I>", "1", *EACH, "bin")
    density_error: np.ndarray = array("its standard error", "1", *EACH, "bin")
    correlation: np.ndarray = array("correlation of I", "1", *EACH, "shift_number")
    correlation_error: np.ndarray = array("its standard error", "1", *EACH, "shift_number")
