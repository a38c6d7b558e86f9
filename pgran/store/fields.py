"""What records of several experiments hold."""

from dataclasses import dataclass

import numpy as np

from pgran.store.record import Record, array

DETECTOR = "indices of the detecting balls"
PHASE = "phase, unwrapped along omega; without damping 0 or pi"
BOUND = "bound of the error of the displacement; NaN: none is known"
FLOOR = "1: the bound is below error_floor, but not small against the amplitude"


@dataclass(frozen=True, eq=False, repr=False)
class Frequencies(Record):
    """What is computed at driving frequencies, of which those with a positive reason are good."""

    factorizations: int
    solve_seconds: float
    omega: np.ndarray = array("driving frequency, angular", "sqrt(k/m)")
    converged_reason: np.ndarray = array(
        "positive: as accurate as asked", "1", "omega", dtype=int, row=True
    )

    @property
    def failures(self):
        """How many frequencies missed the accuracy asked for."""
        return int(np.count_nonzero(self.converged_reason <= 0))


def ball_names(detectors):
    """Return what each detector is called, "ball (8, 10)"."""
    return [f"ball {site_name(site)}" for site in detectors]


def site_name(site):
    """Return the number of a ball, "11", or its indices on the axes, "(8, 10)"."""
    numbers = np.asarray(site).tolist()
    return str(numbers[0] if len(numbers) == 1 else tuple(numbers))
