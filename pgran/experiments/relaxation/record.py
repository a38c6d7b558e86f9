"""The records of a relaxation: amplitudes step by step, their spectrum, and what they remember."""

from dataclasses import dataclass

import numpy as np

from pgran.store.record import BOUND, DETECTOR, FLOOR, Record, array, attribute, error_of

STATES = "trajectory", "state", "detector_number"  # axes


@dataclass(frozen=True, eq=False, repr=False)
class Relaxation(Record):
    """The amplitude at the detectors while one bond a step is redrawn (paper: timeres).

    R trajectories of T steps, all from the bonds of the lattice. `drift` is the largest relative
    difference between the amplitude at the end of a window, from algebra, and the same amplitude
    solved for afresh; `step` is how many seconds a step takes, where the run was told.
    """

    group = "relaxation"
    omega: float = attribute("driving frequency, angular", "sqrt(k/m)")
    factorizations: int = attribute("how many matrices were factored", "1")
    solve_seconds: float = attribute("time of solving, of the slowest rank", "s")
    drift: float = attribute("largest relative difference where windows meet", "1")
    bond_axis: np.ndarray = array(
        "axis of the bond that changes", "1", "trajectory", "step", dtype=int
    )
    bond_index: np.ndarray = array(
        "its index into that axis's stiffness", "1", "trajectory", "step", "axis", dtype=int
    )
    stiffness: np.ndarray = array("its new constant", "k", "trajectory", "step")
    detector: np.ndarray = array(DETECTOR, "1", "detector_number", "axis", dtype=int)
    displacement: np.ndarray = array(
        "amplitude at the detectors relative to the driven wall, entry 0 before any change",
        "1", *STATES, dtype=complex, row=True,
    )  # fmt: skip
    error_bound: np.ndarray = array(BOUND, "1", *STATES, since=2, row=True)
    at_floor: np.ndarray = array(FLOOR, "1", *STATES, dtype=np.int8, since=2)
    step: float | None = attribute("how long a step takes", "s", optional=True)

    @property
    def amplitude(self):
        """Magnitude of the displacement."""
        return np.abs(self.displacement)

    @property
    def failures(self):
        """How many steps miss the accuracy asked for; they hold NaN."""
        return int(np.count_nonzero(np.isnan(self.displacement).any(axis=2)))


@dataclass(frozen=True, eq=False, repr=False)
class Spectrum(Record):
    """The power spectrum of amplitude series, and the power law fitted to it (paper: timeres).

    S(f) = scale / (2 sin(pi f))^exponent from `fit_min` to `fit_max` cycles per step, `scale` in
    the unit of `power`, `exponent_error` the standard error; a segment has `segment` steps.
    `exponent_plain` is minus the slope of log S against log f, aliases and all, as in the paper.
    All are NaN where the series is too short beside its memory for an error.
    """

    group = "spectrum"
    exponent: float = attribute("psi in scale / (2 sin(pi f))^psi", "1")
    exponent_error: float = attribute("its standard error", "1")
    exponent_plain: float = attribute("minus the slope of log S against log f", "1")
    scale: float = attribute("of the law that is fitted", "steps per cycle")
    fit_min: float = attribute("lower end of the fit", "cycles per step")
    fit_max: float = attribute("upper end of the fit", "cycles per step")
    segment: int = attribute("steps of a segment", "1")
    frequency: np.ndarray = array("frequency", "cycles per step")
    power: np.ndarray = array(
        "one-sided power density of the amplitude, averaged over segments and trajectories",
        "steps per cycle", "frequency",
    )  # fmt: skip

    def power_law(self, frequency):
        """Return the fitted law at some frequencies, in the unit of `power`."""
        return self.scale / (2 * np.sin(np.pi * np.asarray(frequency))) ** self.exponent


@dataclass(frozen=True, eq=False, repr=False)
class Memory(Record):
    """What a relaxation remembers (`memory`); B is the first detector's amplitude.

    `order` is kbar, how many of the `bonds` act jointly on average; `increment` the correlation of
    B with its increment, `successive` that of successive increments; each with its standard error.
    """

    group = "memory"
    bonds: int = attribute("M, how many bonds there are", "1")
    order: float = attribute("kbar, how many of them act jointly", "1")
    order_error: float = attribute("its standard error", "1")
    increment: float = attribute("correlation of B with its next increment", "1")
    increment_error: float = attribute("its standard error", "1")
    successive: float = attribute("that of increments after each other", "1")
    successive_error: float = attribute("its standard error", "1")
    lag: np.ndarray = array("steps in between", "steps", dtype=int)
    correlation: np.ndarray = array("autocorrelation of B", "1", "lag")
    correlation_error: np.ndarray = error_of(correlation)
    lowest: np.ndarray = array("its lower bound (1 - kbar/M)^t", "1", "lag")
    highest: np.ndarray = array("its upper bound (1 - 1/M)^t", "1", "lag")
