"""The records of a response: its curve at some frequencies, and the models of it in between."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pgran.errors import PgranError
from pgran.experiments.response.models import ModelLimits, evaluate, point_dtype
from pgran.store.record import (
    BOUND,
    DETECTOR,
    ERROR,
    FLOOR,
    PHASE,
    Frequencies,
    Record,
    array,
    attribute,
    attribute_array,
    error_of,
    part,
    row_of,
)

HEARD = "detector_number"
LINES = 1e-2  # of the amplitude, that straight lines between neighbours should be right to


class Curve(NamedTuple):
    """The response at some frequencies: arrays of shape (n, nd), but for `omega`.

    `displacement` and `derivative` are wrong by at most `error_bound` and `derivative_bound`.
    """

    omega: np.ndarray
    displacement: np.ndarray
    error_bound: np.ndarray
    derivative: np.ndarray
    derivative_bound: np.ndarray


def of_intervals(meaning, units, *axes, dtype=float):
    """Declare an array of a model, one for each interval."""
    return array(meaning, units, "interval", *axes, dtype=dtype, row=True)


@dataclass(frozen=True, eq=False, repr=False)
class Models(ModelLimits, Record):
    """Models of the response, an interval of frequencies each; `models` says what.

    The plain values, its limits, bound their errors. All are in the unit that the lattice was
    solved in, which amplitudes and frequencies do not depend on.
    """

    group, within = "models", "response"
    low: np.ndarray = of_intervals("lower end of the interval, angular", "sqrt(k/m)")
    high: np.ndarray = of_intervals("upper end of the interval, angular", "sqrt(k/m)")
    own: np.ndarray = of_intervals(
        "X^T W of each system: that of A, then one a detector",
        "k", "system", "column", "place", dtype=complex,
    )  # fmt: skip
    cross: np.ndarray = of_intervals(
        "Z^T W with the W of A", "k", "detector_number", "column", "place", dtype=complex
    )
    triangle: np.ndarray = of_intervals(
        "R of W = Q R", "k", "system", "row", "place", dtype=complex
    )
    reading: np.ndarray = of_intervals("e_d^T X", "1", "detector_number", "column", dtype=complex)
    sizes: np.ndarray = of_intervals("|Z|^T |S| |X|", "k", "detector_number", "column", "other")
    drive_sizes: np.ndarray = of_intervals("|Z|^T |f|", "k", "detector_number", "column")

    def at(self, omega):
        """Return the Curve at some frequencies: NaN, bounds infinite, where no model is proven."""
        points = np.zeros(omega.shape, point_dtype(self.reading.shape[1]))
        points["omega"] = omega
        points["displacement"] = points["derivative"] = np.nan
        points["error_bound"] = points["derivative_bound"] = np.inf
        interval = np.searchsorted(self.low, omega, side="right") - 1  # -1: below all
        covered = omega <= np.append(self.high, -np.inf)[interval]
        for number in np.unique(interval[covered]):
            here = covered & (interval == number)
            model = {name: a[number] for name, a in vars(self).items() if np.ndim(a)}
            points[here] = evaluate(model, omega[here], self)
        return Curve(*(points[name] for name in Curve._fields))


def model_dtype(columns, detectors, balls):
    """Return the dtype of a model that ranks send: X and each Z have so many columns, p."""
    row = row_of(
        Models,
        detector_number=(detectors,),
        system=(1 + detectors,),
        column=(columns,),
        other=(columns,),
        place=(2 + 3 * columns,),  # columns of W
        row=(columns + min(2 + 2 * columns, balls),),
    )
    row += [("proven", np.int8), ("factorizations", np.int64)]
    row.append(("poles", float, (2 * columns,)))  # the frequencies above those of system 0
    return np.dtype(row)


@dataclass(frozen=True, eq=False, repr=False)
class Response(Frequencies):
    """The frequency response of single balls (paper: freqres, phaseres).

    `nw` frequencies, `nd` detectors. A point whose `converged_reason` is not positive failed or
    missed the accuracy asked for. Straight lines between neighbours are to be right to `resolve`.
    """

    group = "response"
    method: str = attribute(
        "points, each solved for; curve, models of intervals; moments, one recurrence", since=3
    )
    resolve: float = attribute("part of the amplitude; 0: no frequency was added", "1", since=3)
    phase_slope: np.ndarray = attribute_array("slope of the phase", "rad per omega_mx", HEARD)
    phase_slope_error: np.ndarray = attribute_array(ERROR, "rad per omega_mx", HEARD, since=3)
    phase_velocity: np.ndarray = attribute_array("distance over slope", "length x omega_mx", HEARD)
    phase_velocity_error: np.ndarray = attribute_array(ERROR, "length x omega_mx", HEARD, since=3)
    phase_intercept: np.ndarray = attribute_array("phase at omega = 0", "rad", HEARD)
    phase_fit_min: float = attribute("lower end of the window asked for", "omega_mx")
    phase_fit_max: float = attribute("upper end of the window asked for", "omega_mx")
    phase_used_min: np.ndarray = attribute_array("where the fit begins", "omega_mx", HEARD, since=3)
    phase_used_max: np.ndarray = attribute_array("where the fit ends", "omega_mx", HEARD, since=3)
    omega: np.ndarray = array("driving frequency, angular", "sqrt(k/m)", row=True)
    requested: np.ndarray = array(
        "1: this frequency was asked for, 0: added to resolve the curve", "1", "omega",
        dtype=np.int8, since=3,
    )  # fmt: skip
    detector: np.ndarray = array(DETECTOR, "1", "detector_number", "axis", dtype=int)
    displacement: np.ndarray = array(
        "amplitude at the detectors relative to the driven wall, or to F / kmax of a force F that "
        "drives; convention exp(+i omega t)",
        "1", "omega", "detector_number", dtype=complex, row=True,
    )  # fmt: skip
    amplitude: np.ndarray = array("magnitude of the displacement", "1", "omega", "detector_number")
    phase: np.ndarray = array(PHASE, "rad", "omega", "detector_number")
    backward_error: np.ndarray = array(
        "normwise backward error of the field", "1", "omega", row=True
    )
    error_bound: np.ndarray = array(BOUND, "1", "omega", "detector_number", row=True)
    derivative: np.ndarray = array(
        "derivative of the displacement along omega", "sqrt(m/k)", "omega", "detector_number",
        dtype=complex, since=3, row=True,
    )  # fmt: skip
    derivative_bound: np.ndarray = error_of(
        derivative, "bound of the error of the derivative; NaN: none is known"
    )
    delay: np.ndarray = array(
        "group delay, minus the derivative of the phase along omega; NaN: the amplitude may vanish",
        "sqrt(m/k)", "omega", "detector_number", since=3,
    )  # fmt: skip
    delay_bound: np.ndarray = error_of(delay, "bound of the error of the delay")
    line_error: np.ndarray = array(
        "how far the curve may leave the straight line from the frequency before, relative to the "
        "amplitude, by the derivatives at both; infinite: unknown",
        "1", "omega", "detector_number", since=3,
    )  # fmt: skip
    modelled: np.ndarray = array(
        "1: proven models cover the curve from the frequency before", "1", "omega",
        dtype=np.int8, since=5, row=True,
    )  # fmt: skip
    force: np.ndarray = array(
        "force that drives the wall, or the driven balls along their motion, when they move by 1, "
        "under a push on average; NaN: no solution",
        "k", "omega", dtype=complex, since=4,
    )  # fmt: skip
    force_bound: np.ndarray = error_of(force, "bound of the error of the force; NaN: none is known")
    power: np.ndarray = array(
        "mean power that the drive of amplitude 1 puts in, and dashpots dissipate: of a wall omega "
        "/ 2 times the imaginary part of the force, its error that part of the bound",
        "k sqrt(k/m)", "omega", since=4,
    )  # fmt: skip
    at_floor: np.ndarray = array(FLOOR, "1", "omega", "detector_number", dtype=np.int8, since=2)
    iterations: np.ndarray = array(
        "Krylov iterations, adjoints included", "1", "omega", dtype=int, row=True
    )
    opening: np.ndarray | None = array(
        "amplitude of the drive at which it opens its first contact, by the linear field: no less "
        "and no more; times displacement it is that of balls; NaN: no bound is known, or a model "
        "gives this frequency",
        "length", "omega", "bound", optional=True, row=True,
    )  # fmt: skip
    opening_part: np.ndarray | None = array(
        "like opening: at which 1 % of the contacts open", "length", "omega", "bound",
        optional=True, row=True,
    )  # fmt: skip
    opening_contact: np.ndarray | None = array(
        "number of the contact that opens first, as the field says; -1: opening is NaN",
        "1", "omega", dtype=int, optional=True, row=True,
    )  # fmt: skip
    field: np.ndarray | None = array(
        "amplitudes of all balls relative to the driven wall",
        "1", "omega", "balls", dtype=complex, optional=True, row=True,
    )  # fmt: skip
    models: Models | None = part(Models)
    moments: int | None = attribute(
        "how many moments of each source gave it; 0 or none: factorizations alone",
        optional=True,
    )

    @property
    def dynamic_mass(self):
        """The force over the acceleration of what is driven, -F / omega^2; None in older files."""
        return None if self.force is None else -self.force / self.omega**2

    @property
    def unmodelled(self):
        """What part of the sweep no proven model covers; 1 of points, 0 of older files' curves."""
        if self.modelled is None or len(self.omega) < 2:
            return float(self.method != "curve")
        width = np.diff(self.omega)
        return float(width @ (self.modelled[1:] == 0) / width.sum())

    @property
    def unresolved(self):
        """Which straight lines to the next frequency are not the curve, shape (nw - 1,)."""
        if self.line_error is None:
            return np.zeros(len(self.omega) - 1, dtype=bool)
        return ~np.all(self.line_error[1:] <= (self.resolve or LINES), axis=1)

    def at(self, omega):
        """Return the curve at any frequencies of the sweep, without PETSc.

        Parameters
        ----------
        omega : array_like of float, shape (n,)
            Driving frequencies, angular.

        Returns
        -------
        Curve
            NaN, with infinite bounds, where no interval's model is proven.

        Raises
        ------
        PgranError
            If the result holds no models.
        InputError
            If the frequencies are no numbers.
        """
        if self.models is None:
            raise PgranError(
                "the response holds no models: -sweep_method curve and -output_models keep them"
            )
        from pgran.run.numbers import numbers

        return self.models.at(numbers("omega", omega))
