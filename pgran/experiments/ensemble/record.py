"""The records of an ensemble: what each sample tells, and noise and transport over all of them.

What is read of a sample is one entry of `Ensemble`: `sampled` says from which record, and the row
that ranks send, the file and the bands follow; a `measure` is told and drawn besides.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pgran.catalogue import EXPERIMENTS
from pgran.store.record import DETECTOR, Record, array, attribute, error_of

Array = np.ndarray | None  # what not every ensemble has
CERTAIN = 2.0  # standard errors that a number is above 0 by, if it is for certain
ABOVE_FLOOR = 5.0  # times its floor of few samples |<A>|^2 is, if it counts: e^-5 by chance
LOCALIZED = 0.05  # of the balls: modes in which fewer of them take part
CURVE = "omega", "detector_number"
VALUE = "seed", "detector_number"
SIGNAL = "time", "detector_number"
# Units of measures: as axes show them, in SI, and the power of omega_mx that numbers are in.
UNITS = {
    "1": ("", None, 0),
    "length x omega_mx": (r"($d\,\omega_{mx}$)", "m/s", 1),
    "sqrt(m/k)": (r"($\sqrt{m/k}$)", "s", 0),
    "sqrt(k/m)": (r"($\sqrt{k/m}$)", "1/s", 0),
}


class Sampled(NamedTuple):
    """How a number of each sample is read: by `read(record, medium)` from its record of a group.

    `words` tell it, `label` names its axis; without them it is stored only.
    """

    group: str
    read: Callable
    units: str
    words: str
    label: str

    @property
    def quantity(self):
        """What an axis shows: name, unit, that in SI, and the power of omega_mx of the numbers."""
        return self.label, *UNITS[self.units]


def sampled(source, long_name, units, *axes, read=None, dtype=float, words="", label=""):
    """Declare an array that is read of each sample; see `pgran.store.record.array`.

    The source is a group and what is read of its record, "pulse.arrival", or a group and `read`, as
    in `Sampled`. The first axis is `seed`, or `statistic` where only the band of all is stored.
    """
    group, _, name = source.partition(".")
    read = read or (lambda record, medium: getattr(record, name))
    declared = array(long_name, units, *axes, dtype=dtype, optional=True, row=True)
    reading = {"sampled": Sampled(group, read, units, words, label)}
    return dataclasses.field(default=None, metadata=declared.metadata | reading)


def measure(source, long_name, units, *axes, words="", label="", **reading):
    """Declare a number of each sample that is told and drawn, in its long name or other words."""
    words = words or long_name
    return sampled(source, long_name, units, *axes, words=words, label=label or words, **reading)


def logarithms(response, medium):
    """Return ln|A| where it is known: NaN where A is but an upper limit, or missed its accuracy."""
    unknown = (response.at_floor > 0) | (response.converged_reason <= 0)[:, None]
    with np.errstate(divide="ignore"):
        return np.where(unknown, np.nan, np.log(response.amplitude))


def effective_bonds(sensitivity, medium):
    """Return (sum x)^2 / sum x^2 over the bonds, x = (d ln|A| / d ln k)^2, mean over omega."""
    x = sensitivity.log_amplitude**2
    return np.mean(x.sum(axis=2) ** 2 / (x**2).sum(axis=2), axis=0)


def squares(pulse, medium):
    """Return the envelope's square, u^2 + (v / omega)^2; NaN where it may be an error."""
    return np.where(pulse.envelope > pulse.error, pulse.envelope, np.nan) ** 2


@dataclass(frozen=True, eq=False, repr=False)
class Ensemble(Record):
    """One experiment on many samples, the scene `of`; what it did not measure is None.

    Bands and means are over the samples that are `good`, as accurate as asked for everywhere; a
    number that is not certain of a sample is NaN.
    """

    group = "ensemble"
    of: str = attribute("the experiment that is repeated")
    solve_seconds: float = attribute("time of solving, of the slowest rank", "s")
    left_out: int = attribute("samples that failed or missed their accuracy", "1")
    seed: np.ndarray = array("which sample", "1", dtype=int)
    good: np.ndarray = array("1: as accurate as asked", "1", "seed", dtype=np.int8, row=True)
    detector: Array = array(DETECTOR, "1", "detector_number", "axis", dtype=int, optional=True)
    omega: Array = array("driving frequency, angular", "sqrt(k/m)", optional=True)
    statistic: Array = array(
        "over the samples: mean, its standard error, median, what a tenth of the samples is "
        "below (low) and above (high)", "1", dtype=str, optional=True,
    )  # fmt: skip
    ln_amplitude: Array = sampled("response", "ln|A|", "1", "statistic", *CURVE, read=logarithms)
    delay: Array = sampled("response.delay", "group delay", "sqrt(m/k)", "statistic", *CURVE)
    delay_samples: Array = array(
        "how many samples have a group delay that is certain", "1", *CURVE, dtype=int, optional=True
    )
    coherent: Array = array("mean of the displacement", "1", *CURVE, dtype=complex, optional=True)
    intensity: Array = array("mean of |displacement|^2", "1", *CURVE, optional=True)
    slope: Array = sampled("response.phase_slope", "slope of the phase", "rad", *VALUE)
    velocity: Array = measure(
        "response.phase_velocity", "phase velocity", "length x omega_mx", *VALUE
    )
    exponent: Array = measure(
        "spectrum.exponent", "exponent psi of the spectrum", "1", "seed",
        words="exponent psi", label=r"exponent $\psi$ of the spectrum",
    )  # fmt: skip
    exponent_error: Array = sampled("spectrum.exponent_error", "its standard error", "1", "seed")
    order: Array = measure(
        "memory.order", "bonds that act jointly, kbar of a relaxation", "1", "seed",
        words="bonds that act jointly", label=r"bonds that act jointly, $\bar k$",
    )  # fmt: skip
    modes: Array = measure(
        "modes", "how many modes were found", "1", "seed", words="modes found",
        read=lambda modes, medium: len(modes.omega),
    )  # fmt: skip
    above: Array = measure(
        "modes", "modes above omega_mx", "1", "seed", label=r"modes above $\omega_{mx}$",
        read=lambda modes, medium: np.count_nonzero(modes.omega > medium.omega_mx),
    )  # fmt: skip
    arrival: Array = measure("pulse.arrival", "arrival of the front", "sqrt(m/k)", *VALUE)
    centre: Array = measure(
        "pulse.centre", "mean time of the envelope", "sqrt(m/k)", *VALUE,
        words="centre of the envelope",
    )  # fmt: skip
    decay: Array = measure(
        "pulse.decay", "rate of decay of the envelope", "sqrt(k/m)", *VALUE, words="rate of decay"
    )
    effective_bonds: Array = measure(
        "sensitivity",
        "participation ratio of (d ln|A| / d ln k)^2 over the bonds, mean over frequencies", "1",
        *VALUE, read=effective_bonds, label="bonds that matter",
        words="bonds that matter, on the mean over frequencies,",
    )  # fmt: skip
    mode_omega: Array = sampled(
        "modes.omega", "mode frequencies, NaN after the last", "sqrt(k/m)", "seed", "mode"
    )
    participation: Array = sampled(
        "modes.participation", "participation ratios", "1", "seed", "mode"
    )
    mode_width: Array = sampled("modes.width", "widths of the modes", "sqrt(k/m)", "seed", "mode")
    displacement: Array = sampled(
        "response.displacement", "amplitudes of each sample", "1", "seed", *CURVE, dtype=complex
    )
    sample_delay: Array = array(
        "group delay of each sample", "sqrt(m/k)", "seed", *CURVE, optional=True
    )
    time: Array = array("time", "sqrt(m/k)", optional=True)
    drive: Array = sampled("pulse.wall", "motion of the drive in each part", "1", "part", "time")
    square: Array = sampled(
        "pulse", "mean of the envelope's square in each part", "1", "part", *SIGNAL, read=squares
    )
    mean_square: Array = array("mean over all samples", "1", *SIGNAL, optional=True)
    mean_square_error: Array = error_of(mean_square)

    def widths(self, medium):
        """Return the widths of all modes that ring, and which of them a few balls alone make."""
        if self.mode_width is None:  # of an older file
            return np.zeros(0), np.zeros(0, dtype=bool)
        good = self.good > 0
        rings = (self.mode_omega[good] > 0) & (self.mode_width[good] > 0)
        few = self.participation[good][rings] < LOCALIZED * medium.free_balls
        return self.mode_width[good][rings], few

    def measured(self, record):
        """Return a record of what the samples tell, which follows this one in a result."""
        return record.computed_on(self, **self.origin[1]) if self.origin else record

    @property
    def failures(self):
        """How many samples failed, or missed the accuracy asked for."""
        return self.left_out


def sampled_of(of=None):
    """Return what is read of each sample of an experiment, or of all of them: `Sampled` by name."""
    groups = EXPERIMENTS[of].groups if of else None
    declared = {i.name: i.metadata.get("sampled") for i in dataclasses.fields(Ensemble)}
    return {name: s for name, s in declared.items() if s and (not of or s.group in groups)}


def measures():
    """Return what is told and drawn of samples: `Sampled` by name."""
    return {name: sampled for name, sampled in sampled_of().items() if sampled.words}


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
    samples: int = attribute("how many samples", "1")
    low: np.ndarray = array("lower end of the window, angular", "sqrt(k/m)", "window")
    high: np.ndarray = array("upper end of the window, angular", "sqrt(k/m)", "window")
    part: np.ndarray = array("part of the field A", "1", dtype=str)
    detector: np.ndarray = array(DETECTOR, "1", "detector_number", "axis", dtype=int)
    edge: np.ndarray = array("edges of the bins of I/<I>", "1")
    shift: np.ndarray = array("shift along omega", "sqrt(k/m)", "window", "shift_number")
    coherent_part: np.ndarray = array("|<A>|^2 / <|A|^2>", "1", *PLACE)
    coherent_part_error: np.ndarray = error_of(coherent_part)
    contrast: np.ndarray = array("<I^2>/<I>^2", "1", *EACH)
    contrast_error: np.ndarray = error_of(contrast)
    spread: np.ndarray = array("standard deviation of 10 log10 I", "dB", *EACH)
    spread_error: np.ndarray = error_of(spread)
    half_width: np.ndarray = array("shift at which the correlation is 1/2", "sqrt(k/m)", *EACH)
    half_width_error: np.ndarray = error_of(half_width)
    maxima_spacing: np.ndarray = array("mean distance of maxima of |A|", "sqrt(k/m)", *EACH)
    maxima_spacing_error: np.ndarray = error_of(maxima_spacing)
    density: np.ndarray = array("density of I/<I>", "1", *EACH, "bin")
    density_error: np.ndarray = error_of(density)
    correlation: np.ndarray = array("correlation of I", "1", *EACH, "shift_number")
    correlation_error: np.ndarray = error_of(correlation)


DEPTH, BAND = ("omega", "depth"), ("band", "depth")


@dataclass(frozen=True, eq=False, repr=False)
class Transport(Record):
    """Means over the samples of an ensemble, against the distance from what is driven.

    In depths from `depth_low` to `depth_high` straight lines tell how quantities fall: |A|, by <ln
    |A|> = a - depth / length, which a `straightness` below REFUSED refuses; <|A|^2> ~ exp(-depth /
    intensity_length); and the coherent <A> ~ exp(-i k depth - depth / (2 l)), less its floor of few
    samples, k the wave number and l the scattering length. They are NaN where none is certain, or
    waves stand: where the group delay does not grow with depth for certain, and so below the
    `first_mode`, the lowest of the first sample. The delay is weighted by intensity; `band_delay`
    is its mean over the frequencies between one `edge` and the next. See
    `pgran.experiments.ensemble.profiles`.
    """

    group = "transport"
    REFUSED = 0.01
    samples: int = attribute("how many samples", "1")
    first_mode: float = attribute("lowest mode of the first sample, angular", "sqrt(k/m)", since=5)
    depth: np.ndarray = array("distance from what is driven", "spacing")
    omega: np.ndarray = array("driving frequency, angular", "sqrt(k/m)")
    ln_amplitude: np.ndarray = array("mean of ln|A|", "1", *DEPTH)
    ln_amplitude_error: np.ndarray = error_of(ln_amplitude)
    intensity: np.ndarray = array("mean of |A|^2", "1", *DEPTH)
    intensity_error: np.ndarray = error_of(intensity)
    rate: np.ndarray = array("1 / attenuation length", "1/spacing", "omega")
    rate_error: np.ndarray = error_of(rate)
    length: np.ndarray = array("attenuation length of the amplitude", "spacing", "omega")
    length_error: np.ndarray = error_of(length)
    group_delay: np.ndarray = array("mean group delay", "sqrt(m/k)", *DEPTH, since=5)
    group_delay_error: np.ndarray = error_of(group_delay)
    edge: np.ndarray = array("ends of bands of frequencies, angular", "sqrt(k/m)", since=5)
    band_delay: np.ndarray = array("mean group delay of a band", "sqrt(m/k)", *BAND, since=5)
    band_delay_error: np.ndarray = error_of(band_delay)
    delay_growth: np.ndarray = array(
        "growth of the mean group delay of a band with depth", "sqrt(m/k)/spacing", "band", since=5
    )
    delay_growth_error: np.ndarray = error_of(delay_growth)
    depth_low: float | None = attribute("lowest depth of the lines", "spacing", optional=True)
    depth_high: float | None = attribute("highest depth of the lines", "spacing", optional=True)
    straightness: Array = array("p-value of that line", "1", "omega", optional=True)
    intensity_length: Array = array("that of the intensity", "spacing", "omega", optional=True)
    intensity_length_error: Array = error_of(intensity_length)
    wave_number: Array = array("that of <A>", "rad/spacing", "omega", optional=True)
    wave_number_error: Array = error_of(wave_number)
    scattering_length: Array = array("that of |<A>|^2", "spacing", "omega", optional=True)
    scattering_length_error: Array = error_of(scattering_length)

    @property
    def propagates(self):
        """Whether the delay grows with depth for certain, by band."""
        return self.delay_growth > CERTAIN * self.delay_growth_error

    @property
    def refused(self):
        """Whether there is a length, and its line is refused, by frequency."""
        return np.isfinite(self.length) & (self.straightness < self.REFUSED)


@dataclass(frozen=True, eq=False, repr=False)
class Diffusion(Record):
    """The mean square of an ensemble's pulses, and the fit of `ensemble.transport` to it.

    Energy diffuses with D, the `diffusivity`, and is absorbed at the rate 1/tau; `length` is sqrt(D
    tau), `free_path` the transport mean free path d D / c in d dimensions, c the `speed` of fronts.
    NaN is not certain. `misfit` is the root mean square of residuals over their errors.
    """

    group = "diffusion"
    WRONG = 2.0  # misfit from which diffusion does not hold
    samples: int = attribute("how many samples", "1")
    speed: float = attribute("speed of the fronts, c", "spacing sqrt(k/m)")
    diffusivity: float = attribute("D", "spacing^2 sqrt(k/m)")
    diffusivity_error: float = attribute("its standard error", "spacing^2 sqrt(k/m)")
    absorption: float = attribute("1/tau", "sqrt(k/m)")
    absorption_error: float = attribute("its standard error", "sqrt(k/m)")
    length: float = attribute("sqrt(D tau)", "spacing")
    length_error: float = attribute("its standard error", "spacing")
    free_path: float = attribute("transport mean free path, d D / c", "spacing")
    free_path_error: float = attribute("its standard error", "spacing")
    misfit: float = attribute("root mean square of residuals over their errors", "1")
    depth: np.ndarray = array("distance from what is driven", "spacing")
    time: np.ndarray = array("middle of a block of times", "sqrt(m/k)")
    mean_square: np.ndarray = array("mean of u^2 + (v / omega)^2", "1", "time", "depth")
    mean_square_error: np.ndarray = error_of(mean_square)
    fit: np.ndarray = array("the fit to it", "1", "time", "depth")
