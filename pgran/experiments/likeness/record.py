"""The record of how alike two responses, or two pulses, are."""

from dataclasses import dataclass

import numpy as np

from pgran.store.record import DETECTOR, Record, array, attribute, error_of

EACH = "window", "detector_number", "signal"
UNIT = "sqrt(k/m); of a pulse sqrt(m/k)"


@dataclass(frozen=True, eq=False, repr=False)
class Likeness(Record):
    """How alike the curves or codas of two results, A and B, are in windows.

    The `stretch` is how much faster B is: A_b(omega (1 + stretch)) = A_a(omega), or u_b(t) =
    u_a(t (1 + stretch)), t from the middle of each one's drive; x / 2 where all springs are 1 + x
    times as stiff. It is NaN where signals are too little alike, its error infinite where the best
    is at the end of what was tried, up to `reach`, or beyond.
    """

    group = "likeness"
    origin = (), {}  # of no medium
    of: str = attribute("the scene of both: response or pulse")
    label_a: str = attribute("what A is called")
    label_b: str = attribute("what B is called")
    omega_mx: float = attribute("that of A's medium; NaN: not known", "sqrt(k/m)")
    reach: float = attribute("largest stretch that was tried", "1")
    signal: np.ndarray = array("u; ln|A| less its line, A over exp of it", "1", dtype=str)
    detector: np.ndarray = array(DETECTOR, "1", "detector_number", "axis", dtype=int)
    low: np.ndarray = array("lower end of the window, angular frequency or time", UNIT, "window")
    high: np.ndarray = array("upper end of the window", UNIT, "window")
    correlation: np.ndarray = array("correlation of A and B as they are", "1", *EACH)
    correlation_error: np.ndarray = error_of(correlation)
    stretch: np.ndarray = array("relative change of frequencies, or of speeds", "1", *EACH)
    stretch_error: np.ndarray = error_of(stretch)
    stretched: np.ndarray = array("correlation under that stretch, the largest", "1", *EACH)
    shift: np.ndarray | None = array("or one shift of all", "sqrt(k/m)", *EACH, optional=True)
    shift_error: np.ndarray | None = error_of(shift)
