"""The amplitudes at the detectors, frequency by frequency, and the response that they make up."""

from dataclasses import astuple

import numpy as np

from pgran.driven import phase as phases
from pgran.driven.accurate import below_relative_accuracy, is_accurate
from pgran.driven.sweep import FrequencySweep
from pgran.experiments.response.record import LINES, Response
from pgran.experiments.response.resolution import line_errors
from pgran.medium.rounding import EPSILON
from pgran.store.record import columns_of, row_of

MODELLED = 2  # the reason of a frequency that a model gives


class ResponseSweep(FrequencySweep):
    """The amplitudes at the detectors, with their bounds, and the whole field if it is wanted."""

    def __init__(self, lattice, omegas, detectors, fields, steady):
        self.fields, self.detectors, self.steady = fields, detectors, steady
        sites = lattice.sites(detectors)
        axes = {"detector_number": (len(sites),), "balls": lattice.shape}
        row = row_of(Response, () if fields else ("field",), **axes)
        row += [("reaction", complex), ("reaction_bound", float)]
        choices = steady | {"whole_field": fields, "derivatives": True}
        super().__init__(lattice, omegas, sites, row, choices)

    def at(self, omegas):
        """Return the same task at other frequencies."""
        return ResponseSweep(self.lattice, omegas, self.detectors, self.fields, self.steady)

    def keep(self, point, solver):
        """See `FrequencySweep`; the field comes to the first rank of a group."""
        if self.fields:
            field = solver.operators.layout.field(solver.field)
            point["field"] = 0.0 if field is None else self.scaled.displacements(field)

    def collect(self, rows, seconds):
        """See `Task`."""
        rows["omega"] = self.omegas
        return rows

    def accurate(self, points):
        """Return as rows those points of models that are as accurate as asked."""
        tolerance = self.choices["error_tolerance"]
        good = is_accurate(points["error_bound"], points["displacement"], tolerance).all(axis=1)
        rows = np.zeros(np.count_nonzero(good), self.row)
        for name in set(rows.dtype.names) & set(points.dtype.names):
            rows[name] = points[name][good]
        rows["converged_reason"] = MODELLED
        return rows

    def response(self, rows, models, method, resolve, phase_window, seconds):
        """Return the record of all rows; straight lines were asked to be right to `resolve`."""
        columns = columns_of(Response, rows)
        omega, displacement, bound = (columns[n] for n in ("omega", "displacement", "error_bound"))
        failed = columns["converged_reason"] <= 0
        at_floor = below_relative_accuracy(bound, displacement, self.choices["error_tolerance"])
        at_floor[failed] = 0
        # only what is accurate relative to itself has a phase
        accurate = np.where(failed[:, None] | (at_floor > 0), np.nan, displacement)
        unwrapped = phases.unwrap if self.lattice.dissipates else phases.phase_of_sign
        phase = unwrapped(accurate)
        slope = columns["derivative"]
        delay, delay_bound = phases.group_delay(accurate, slope, bound, columns["derivative_bound"])
        compared = (columns["modelled"][1:] > 0) & (resolve > 0)
        curve = omega, accurate, slope
        line_error = line_errors(self.scaled, *curve, compared, resolve or LINES)
        line_error = np.pad(line_error, ((1, 0), (0, 0)))  # from the frequency before
        force, force_bound, power = self.driving_force(rows)
        return Response(
            **columns,
            **phase_slopes(self.lattice, self.sites, omega, phase, line_error, phase_window),
            factorizations=int(rows["factorizations"].sum()),
            solve_seconds=seconds,
            method=method,
            resolve=resolve,
            requested=np.isin(omega, self.omegas).astype(np.int8),
            detector=self.sites,
            amplitude=np.abs(displacement),
            phase=phase,
            delay=delay,
            delay_bound=delay_bound,
            line_error=line_error,
            force=force,
            force_bound=force_bound,
            power=power,
            at_floor=at_floor,
            models=models,
        )

    def driving_force(self, rows):
        """Return the force F that drives what moves by 1, a bound of its error, and the power.

        It is what the wall takes to move while all balls stay, less what these give way:
        F = sum over driven bonds of (k + i omega beta)(1 - A_p) = pull - f^T A. A push of the size
        P moves its balls by f^T A / P on the mean, so that F = P^2 / f^T A; its power is that of
        the force as it is.
        """
        omega, scaled, unit = rows["omega"], self.scaled, self.unit
        taken, bound = unit * rows["reaction"], unit * rows["reaction_bound"]
        if scaled.push is None:
            pull = unit * scaled.pull(1j * omega)
            force = pull - taken
            rounding = unit * scaled.pull_rounding(omega) + 4 * EPSILON * np.abs(force)
            return force, bound + rounding, 0.5 * omega * force.imag
        square, size = self.lattice.push_sizes.sum() ** 2, np.abs(taken)
        with np.errstate(all="ignore"):
            force = square / taken
            error = np.where(size > bound, square * bound / (size * (size - bound)), np.inf)
        return force, error + 8 * EPSILON * np.abs(force), -0.5 * omega * taken.imag


def phase_slopes(lattice, sites, omega, phase, line_error, window):
    """Return the phase's slopes and velocities at the detectors by their names in a Response."""
    lines = phase_lines(lattice, omega, phase, line_error, window)
    slope, error, intercept, low, high = np.transpose([astuple(line)[:-1] for line in lines])
    velocity = phases.phase_velocity(slope, lattice.depths(sites))
    return {
        "phase_slope": slope,
        "phase_slope_error": error,
        "phase_velocity": velocity,
        "phase_velocity_error": velocity * error / np.abs(slope),
        "phase_intercept": intercept,
        "phase_fit_min": window[0],
        "phase_fit_max": window[1],
        "phase_used_min": low,
        "phase_used_max": high,
    }


def phase_lines(lattice, omega, phase, line_error, window):
    """Return the PhaseLine of each detector, within a window in units of omega_mx."""
    if not lattice.built.dissipates:
        why = "without damping amplitudes are real, and their phase is 0 or pi"
        return [phases.PhaseLine(why_not=why) for _ in phase.T]
    columns = zip(phase.T, line_error.T, strict=True)
    return [phases.fit_phase(omega / lattice.omega_mx, *column, *window) for column in columns]
