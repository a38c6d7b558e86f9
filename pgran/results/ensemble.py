"""The record of an ensemble: what holds over many samples of one kind."""

from dataclasses import dataclass

import numpy as np

from pgran.record import Record, array
from pgran.results.response import DETECTOR

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
