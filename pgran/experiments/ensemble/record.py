"""The record of an ensemble: what holds over many samples of one kind."""

from dataclasses import dataclass

import numpy as np

from pgran.store.fields import DETECTOR
from pgran.store.record import Record, array, attribute

CURVE = "omega", "detector_number"
VALUE = "seed", "detector_number"


@dataclass(frozen=True, eq=False, repr=False)
class Ensemble(Record):
    """One experiment on many samples, the scene `of`; what it did not measure is None.

    Bands and means are over the samples that are `good`, as accurate as asked for everywhere; a
    number that is not certain of a sample is NaN.
    """

    group = "ensemble"
    of: str
    solve_seconds: float
    left_out: int
    seed: np.ndarray = array("which sample", "1", dtype=int)
    good: np.ndarray = array("1: as accurate as asked", "1", "seed", dtype=np.int8)
    detector: np.ndarray | None = array(
        DETECTOR, "1", "detector_number", "axis", dtype=int, optional=True
    )
    omega: np.ndarray | None = array("driving frequency, angular", "sqrt(k/m)", optional=True)
    statistic: np.ndarray | None = array(
        "what over the samples: mean, its standard error, median, what a tenth of the samples is "
        "below (low) and above (high)", "1", dtype=str, optional=True,
    )  # fmt: skip
    ln_amplitude: np.ndarray | None = array("ln|A|", "1", "statistic", *CURVE, optional=True)
    delay: np.ndarray | None = array("group delay", "sqrt(m/k)", "statistic", *CURVE, optional=True)
    delay_samples: np.ndarray | None = array(
        "how many samples have a group delay that is certain", "1", *CURVE, dtype=int,
        optional=True,
    )  # fmt: skip
    coherent: np.ndarray | None = array(
        "mean of the displacement", "1", *CURVE, dtype=complex, optional=True
    )
    intensity: np.ndarray | None = array("mean of |displacement|^2", "1", *CURVE, optional=True)
    slope: np.ndarray | None = array("slope of the phase", "rad", *VALUE, optional=True)
    velocity: np.ndarray | None = array(
        "phase velocity", "length x omega_mx", *VALUE, optional=True
    )
    exponent: np.ndarray | None = array("exponent psi of the spectrum", "1", "seed", optional=True)
    exponent_error: np.ndarray | None = array("its standard error", "1", "seed", optional=True)
    order: np.ndarray | None = array(
        "bonds that act jointly, kbar of a relaxation", "1", "seed", optional=True
    )
    modes: np.ndarray | None = array("how many modes were found", "1", "seed", optional=True)
    above: np.ndarray | None = array("modes above omega_mx", "1", "seed", optional=True)
    arrival: np.ndarray | None = array("arrival of the front", "sqrt(m/k)", *VALUE, optional=True)
    centre: np.ndarray | None = array(
        "mean time of the envelope", "sqrt(m/k)", *VALUE, optional=True
    )
    decay: np.ndarray | None = array(
        "rate of decay of the envelope", "sqrt(k/m)", *VALUE, optional=True
    )
    effective_bonds: np.ndarray | None = array(
        "participation ratio of (d ln|A| / d ln k)^2 over the bonds, mean over frequencies", "1",
        *VALUE, optional=True,
    )  # fmt: skip
    mode_omega: np.ndarray | None = array(
        "mode frequencies, NaN after the last", "sqrt(k/m)", "seed", "mode", optional=True
    )
    participation: np.ndarray | None = array(
        "participation ratios", "1", "seed", "mode", optional=True
    )
    displacement: np.ndarray | None = array(
        "amplitudes of each sample", "1", "seed", *CURVE, dtype=complex, optional=True
    )
    sample_delay: np.ndarray | None = array(
        "group delay of each sample", "sqrt(m/k)", "seed", *CURVE, optional=True
    )

    @property
    def failures(self):
        """How many samples failed, or missed the accuracy asked for."""
        return self.left_out


PLACE = "window", "detector_number"
DEPTH, BAND = ("omega", "depth"), ("band", "depth")


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


@dataclass(frozen=True, eq=False, repr=False)
class Transport(Record):
    """Means over the samples of an ensemble, against the distance from what is driven.

    The straight line <ln|A|> = a - depth / length gives the attenuation length of the amplitude;
    the intensity falls in half of it. It is NaN where nothing falls for certain, and below
    `first_mode`, the lowest of the first sample, where no wave is excited and the walls alone make
    the fall. The group delay is weighted by intensity; `band_delay` is its mean over the
    frequencies between one `edge` and the next, which grows with depth by `delay_growth`. (Files
    before version 5 have no more of delays than a mean over all frequencies, `delay`, which is not
    read.) See `localization`.
    """

    group = "transport"
    samples: int
    first_mode: float = attribute(since=5)
    depth: np.ndarray = array("distance from what is driven", "spacing")
    omega: np.ndarray = array("driving frequency, angular", "sqrt(k/m)")
    ln_amplitude: np.ndarray = array("mean of ln|A|", "1", *DEPTH)
    ln_amplitude_error: np.ndarray = array("its standard error", "1", *DEPTH)
    intensity: np.ndarray = array("mean of |A|^2", "1", *DEPTH)
    intensity_error: np.ndarray = array("its standard error", "1", *DEPTH)
    rate: np.ndarray = array("1 / attenuation length", "1/spacing", "omega")
    rate_error: np.ndarray = array("its standard error", "1/spacing", "omega")
    length: np.ndarray = array("attenuation length of the amplitude", "spacing", "omega")
    length_error: np.ndarray = array("its standard error", "spacing", "omega")
    group_delay: np.ndarray = array("mean group delay", "sqrt(m/k)", *DEPTH, since=5)
    group_delay_error: np.ndarray = array("its standard error", "sqrt(m/k)", *DEPTH, since=5)
    edge: np.ndarray = array("ends of bands of frequencies, angular", "sqrt(k/m)", since=5)
    band_delay: np.ndarray = array("mean group delay of a band", "sqrt(m/k)", *BAND, since=5)
    band_delay_error: np.ndarray = array("its standard error", "sqrt(m/k)", *BAND, since=5)
    delay_growth: np.ndarray = array(
        "growth of the mean group delay of a band with depth", "sqrt(m/k)/spacing", "band", since=5
    )
    delay_growth_error: np.ndarray = array(
        "its standard error", "sqrt(m/k)/spacing", "band", since=5
    )
