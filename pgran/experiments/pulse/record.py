"""The record of a pulse."""

from dataclasses import dataclass

import numpy as np

from pgran.store.record import DETECTOR, ERROR, Record, array, attribute, attribute_array

BOUND = "bound of the error of the "
ESTIMATE = "estimate of the error of the "
HEARD = "detector_number"
SIGNALS = "time", HEARD  # axes


@dataclass(frozen=True, eq=False, repr=False)
class Signals(Record):
    """What balls do in time when the driven wall moves: `nt` times, `nd` detectors.

    A front has arrived when a thousandth of the signal's energy, the integral of the velocity's
    square, has passed, NaN where errors leave that open, or it would be before the wall's own,
    `wall_arrival`. (Files before version 5: when a displacement first exceeds a tenth of its
    largest.) `centre` is the mean time, weighted by the square of the envelope, `decay` the rate at
    which the envelope decays after it, with its standard error.
    """

    group = "pulse"
    shape: str = attribute("how the wall moves: gauss, ricker, burst, step, file")
    pulse_omega: float = attribute("where its spectrum is largest, angular", "sqrt(k/m)")
    pulse_width: float = attribute("standard deviation of the bell", "sqrt(m/k)")
    method: str = attribute("laplace or moments; of older files integrate: estimates")
    sigma: float = attribute("real part of s on the transform's line", "sqrt(k/m)")
    period: float = attribute("period of the transform", "sqrt(m/k)")
    solves: int = attribute("points on the line, or moments", "1")
    factorizations: int = attribute("how many matrices were factored", "1")
    solve_seconds: float = attribute("time of solving, of the slowest rank", "s")
    tolerance: float = attribute("relative accuracy asked for", "1")
    wall_arrival: float = attribute("arrival of the wall's own motion", "sqrt(m/k)")
    arrival: np.ndarray = attribute_array("arrival of the front", "sqrt(m/k)", HEARD)
    centre: np.ndarray = attribute_array("mean time of the envelope", "sqrt(m/k)", HEARD)
    decay: np.ndarray = attribute_array("rate of decay after that", "sqrt(k/m)", HEARD)
    decay_error: np.ndarray = attribute_array(ERROR, "sqrt(k/m)", HEARD)
    time: np.ndarray = array("time", "sqrt(m/k)")
    wall: np.ndarray = array("displacement of the driven wall, or push over its size", "1", "time")
    force: np.ndarray = array("force on the driven wall, or of the push", "k", "time")
    work: np.ndarray = array("work of the drive until then", "k", "time")
    detector: np.ndarray = array(DETECTOR, "1", "detector_number", "axis", dtype=int)
    displacement: np.ndarray = array("displacement of the detectors", "1", *SIGNALS)
    velocity: np.ndarray = array("velocity of the detectors", "sqrt(k/m)", *SIGNALS)
    envelope: np.ndarray = array(
        "sqrt(u^2 + (v / omega)^2), omega^2 the mean of v^2 over that of u^2", "1", *SIGNALS
    )
    energy: np.ndarray | None = array("energy of the balls and springs", "k", "time", optional=True)
    dissipated: np.ndarray | None = array(
        "work taken by damping until then", "k", "time", optional=True
    )
    error_bound: np.ndarray | None = array(BOUND + "displacement", "1", *SIGNALS, optional=True)
    velocity_bound: np.ndarray | None = array(
        BOUND + "velocity", "sqrt(k/m)", *SIGNALS, optional=True
    )
    force_estimate: np.ndarray | None = array(ESTIMATE + "force", "k", "time", optional=True)
    work_estimate: np.ndarray | None = array(ESTIMATE + "work", "k", "time", optional=True)
    energy_estimate: np.ndarray | None = array(ESTIMATE + "energy", "k", "time", optional=True)
    dissipated_estimate: np.ndarray | None = array(
        ESTIMATE + "work taken by damping", "k", "time", optional=True
    )
    error_estimate: np.ndarray | None = array(
        ESTIMATE + "displacement", "1", *SIGNALS, optional=True
    )
    velocity_estimate: np.ndarray | None = array(
        ESTIMATE + "velocity", "sqrt(k/m)", *SIGNALS, optional=True
    )
    field_time: np.ndarray | None = array("times of the field", "sqrt(m/k)", optional=True)
    field: np.ndarray | None = array(
        "displacement of all balls", "1", "field_time", "balls", optional=True
    )

    @property
    def error(self):
        """The bound of the displacement's error, or its estimate."""
        return self.error_estimate if self.error_bound is None else self.error_bound

    @property
    def failures(self):
        """How many detectors' signals miss the accuracy asked for, relative to their largest."""
        largest = np.abs(self.displacement).max(axis=0)
        return int(np.count_nonzero(~(self.error.max(axis=0) <= self.tolerance * largest)))
