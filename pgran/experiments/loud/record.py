"""The record of loud sound: periodic states of contacts by their own law."""

from dataclasses import dataclass

import numpy as np

from pgran.store.record import DETECTOR, Record, array, attribute, error_of

FOLDS = 8  # that are told of a branch, the first ones


def of_state(meaning, units="1", *axes, dtype=float, optional=False):
    """Declare what each state has."""
    axes = "omega", "amplitude", *axes
    return array(meaning, units, *axes, dtype=dtype, optional=optional, row=True)


POWER = "k length^2 sqrt(k/m)"


@dataclass(frozen=True, eq=False, repr=False)
class Loud(Record):
    """Periodic states u(t) = Re sum_n u_n exp(i n omega t) of a drive `drive` cos(omega t).

    `nw` frequencies, `na` amplitudes, `nd` detectors, harmonics 0 to N. A state is as accurate as
    asked where its `converged_reason` is positive; 0: it has larger errors; -1: it was not reached,
    and its numbers are NaN. A motion does not stay in an `unstable` one, whose largest Floquet
    multiplier exceeds 1. Where frequencies are followed each amplitude is there twice, for the
    `direction` up and down. Parts of a field are by 2-norms of sqrt(m) u.
    """

    group = "loud"
    unit: str = attribute("of the amplitudes: length, overlap (the mean one), or opening")
    follow: str = attribute("amplitude, or frequency")
    error_kind: str = attribute("estimated: a Newton step with twice the harmonics and samples")
    near: int = attribute("how many pairs that nearly touch are contacts, too", "1")
    reach: float = attribute("within which gap, in mean overlaps", "1")
    overlap: float = attribute("mean overlap of the contacts", "length")
    turning: float = attribute(
        "that over the mean distance of balls in contact; NaN: they have one displacement", "1"
    )
    solve_seconds: float = attribute("time of solving, of the slowest rank", "s")
    omega: np.ndarray = array("driving frequency, angular", "sqrt(k/m)")
    amplitude: np.ndarray = array("amplitude of the drive, in the unit asked for", "1")
    direction: np.ndarray = array("rising amplitude; or up, down", "1", "amplitude", dtype=str)
    detector: np.ndarray = array(DETECTOR, "1", "detector_number", "axis", dtype=int)
    contact: np.ndarray = array("number of each contact", "1", "contact_number", dtype=int)
    opening: np.ndarray = array(
        "amplitude of the drive at which the linear field opens the first contact: no less, no "
        "more; NaN: no linear field", "length", "omega", "bound",
    )  # fmt: skip
    opening_part: np.ndarray = array("at which it opens 1 % of them", "length", "omega", "bound")
    converged_reason: np.ndarray = of_state("positive: as accurate as asked", dtype=int)
    drive: np.ndarray = of_state("amplitude of the drive", "length")
    harmonic: np.ndarray = of_state(
        "displacement of the detectors, convention exp(+i n omega t)", "length",
        "detector_number", "harmonic_number", dtype=complex,
    )  # fmt: skip
    harmonic_error: np.ndarray = error_of(harmonic, "its error, as error_kind says")
    change: np.ndarray = of_state("fundamental of the field less the linear one, over that")
    second: np.ndarray = of_state("second harmonic of the field over its fundamental")
    third: np.ndarray = of_state("third harmonic over the fundamental")
    mean: np.ndarray = of_state("mean displacement over the fundamental")
    clapping: np.ndarray = of_state("part of the contacts that open and close in a period")
    closing: np.ndarray = of_state("part of the near pairs that do")
    clapped: np.ndarray = of_state(
        "1: this contact opens and closes", "1", "contact_number", dtype=np.int8
    )
    multiplier: np.ndarray = of_state(
        "largest Floquet multiplier; NaN: not asked for, or not found", dtype=complex
    )
    certificate: np.ndarray = of_state(
        "1: that a periodic motion exists is proven; 0: it is not; -1: no proof was tried",
        dtype=int, optional=True,
    )  # fmt: skip
    certificate_bound: np.ndarray = of_state(
        "proven bound of the error of harmonic; NaN: no proof", "length", "detector_number",
        "harmonic_number", optional=True,
    )  # fmt: skip
    certificate_radius: np.ndarray = of_state(
        "no other periodic motion has stretches of all contacts within this of its; inf: there is "
        "no other; NaN: no proof", "length", optional=True,
    )  # fmt: skip
    power_in: np.ndarray = of_state("mean power that the drive puts in", POWER)
    power_lost: np.ndarray = of_state("mean power that is lost, by all harmonics", POWER)
    fold: np.ndarray = of_state(
        "frequencies, or amplitudes of the drive, at folds passed on the way", "1", "fold_number"
    )
    folds: np.ndarray = of_state("how many there are", dtype=int)
    harmonics: np.ndarray = of_state("harmonics that it was solved with", dtype=int)
    samples: np.ndarray = of_state("samples of a period", dtype=int)
    products: np.ndarray = of_state("products with the Jacobian", dtype=int)
    factorizations: np.ndarray = of_state("matrices factored", dtype=int)

    @property
    def failures(self):
        """How many states were not reached, or miss the accuracy asked for."""
        return int(np.count_nonzero(self.converged_reason <= 0))

    @property
    def reached(self):
        """Which states there are, shape (nw, na)."""
        return self.converged_reason >= 0

    @property
    def unstable(self):
        """Which states a motion does not stay in, shape (nw, na); False where that is unknown."""
        return np.abs(self.multiplier) > 1

    @property
    def proven(self):
        """Which states are proven to exist, shape (nw, na); none where no proof was asked for."""
        return np.full(self.drive.shape, self.certificate is not None and self.certificate > 0)

    @property
    def imbalance(self):
        """The power lost over that put in, less 1, shape (nw, na)."""
        return self.power_lost / self.power_in - 1
