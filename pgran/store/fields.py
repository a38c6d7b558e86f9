"""What records of several experiments hold."""

import numpy as np

DETECTOR = "indices of the detecting balls"
PHASE = "phase, unwrapped along omega; without damping 0 or pi"
BOUND = "bound of the error of the displacement; NaN: none is known"
FLOOR = "1: the bound is below error_floor, but not small against the amplitude"


class Frequencies:
    """What records with a `converged_reason` for each frequency have in common."""

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
