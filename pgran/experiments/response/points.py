"""The amplitudes at the detectors, frequency by frequency, and the response that they make up."""

from dataclasses import astuple

import numpy as np

from pgran.driven.accurate import below_relative_accuracy, is_accurate
from pgran.driven.phase import (
    PhaseLine,
    fit_phase,
    group_delay,
    phase_of_sign,
    phase_velocity,
    unwrap,
)
from pgran.driven.sweep import FrequencySweep
from pgran.experiments.response.record import LINES, Response
from pgran.experiments.response.resolution import line_errors
from pgran.medium.rounding import EPSILON

GOOD = 2  # the reason of a frequency that a model gives


class ResponseSweep(FrequencySweep):
    """The amplitudes at the detectors, with their bounds, and the whole field if it is wanted.

    Parameters are those of `scene.sweep`.
    """

    def __init__(self, lattice, omegas, detectors, fields, steady):
        """Say what a frequency's results travel in."""
        self.fields, self.detectors, self.steady = fields, detectors, steady
        sites = lattice.sites(detectors)
        kept = [
            ("omega", float),
            ("displacement", complex, (len(sites),)),
            ("error_bound", float, (len(sites),)),
            ("derivative", complex, (len(sites),)),
            ("derivative_bound", float, (len(sites),)),
            ("reaction", complex),
            ("reaction_bound", float),
            ("backward_error", float),
            ("iterations", np.int64),
            ("converged_reason", np.int64),
            ("modelled", np.int8),
            *([("field", complex, lattice.shape)] if fields else []),
        ]
        choices = steady | {"whole_field": fields, "derivatives": True}
        super().__init__(lattice, omegas, sites, kept, choices)

    def at(self, omegas):
        """Return the same task at other frequencies. Not collective."""
        return ResponseSweep(self.lattice, omegas, self.detectors, self.fields, self.steady)

    def keep(self, point, solver):
        """See `FrequencySweep`; the field comes to the first rank of a group."""
        if self.fields:
            field = solver.operators.layout.field(solver.field)
            point["field"] = 0.0 if field is None else self.scaled.displacements(field)

    def collect(self, rows, seconds):
        """See `Task`."""
        rows = rows.copy()
        rows["omega"] = self.omegas
        return rows

    def accurate(self, points):
        """Return as rows those points of models that are as accurate as asked. Not collective."""
        tolerance = self.choices["error_tolerance"]
        good = is_accurate(points["error_bound"], points["displacement"], tolerance).all(axis=1)
        rows = np.zeros(np.count_nonzero(good), self.row)
        for name in set(rows.dtype.names) & set(points.dtype.names):
            rows[name] = points[name][good]
        rows["converged_reason"] = GOOD
        return rows

    def driving_force(self, rows):
        """Return the force F that drives the wall when it moves by 1, and a bound of its error.

        Not collective. It is what the wall takes to move while all balls stay, less what these give
        way: F = sum over driven bonds of (k + i omega beta)(1 - A_p) = pull - f^T A.
        """
        omega, scaled = rows["omega"], self.scaled
        force = scaled.pull(1j * omega) - rows["reaction"]
        rounding = scaled.pull_rounding(omega) + 4 * EPSILON * np.abs(force)
        return self.unit * force, self.unit * (rows["reaction_bound"] + rounding)

    def response(self, rows, models, method, resolve, phase_window, seconds):
        """Return the record that all rows make up.

        Not collective.

        Parameters
        ----------
        rows : numpy.ndarray of `row`
        models : pgran.results.Models or None
        method : str
        resolve : float
            What straight lines were asked to be right to.
        phase_window : tuple of float
        seconds : float
            What it took.
        """
        lattice, omega, displacement = self.lattice, rows["omega"], rows["displacement"].copy()
        tolerance = self.choices["error_tolerance"]
        at_floor = below_relative_accuracy(rows["error_bound"], displacement, tolerance)
        failed = rows["converged_reason"] <= 0
        at_floor[failed] = 0
        known = np.where(failed[:, None] | (at_floor > 0), np.nan, displacement)
        derivative, bounds = rows["derivative"].copy(), rows["derivative_bound"]
        phase = unwrap(known) if lattice.damping else phase_of_sign(known)
        modelled = rows["modelled"] > 0
        looked_at = modelled[1:] & (resolve > 0)
        line_error = line_errors(self.scaled, omega, known, derivative, looked_at, resolve or LINES)
        line_error = np.pad(line_error, ((1, 0), (0, 0)))
        delay, delay_bound = group_delay(known, derivative, rows["error_bound"], bounds)
        force, force_bound = self.driving_force(rows)
        lines = phase_lines(lattice, omega, phase, line_error, phase_window)
        slope, slope_error, intercept, low, high = np.transpose(
            [astuple(line)[:-1] for line in lines]
        )
        velocity = phase_velocity(slope, lattice.depths(self.sites))
        return Response(
            factorizations=int(rows["factorizations"].sum()),
            solve_seconds=seconds,
            method=method,
            resolve=resolve,
            phase_slope=slope,
            phase_slope_error=slope_error,
            phase_velocity=velocity,
            phase_velocity_error=velocity * slope_error / np.abs(slope),
            phase_intercept=intercept,
            phase_fit_min=phase_window[0],
            phase_fit_max=phase_window[1],
            phase_used_min=low,
            phase_used_max=high,
            omega=omega,
            requested=np.isin(omega, self.omegas).astype(np.int8),
            detector=self.sites,
            displacement=displacement,
            amplitude=np.abs(displacement),
            phase=phase,
            backward_error=rows["backward_error"],
            error_bound=rows["error_bound"],
            derivative=derivative,
            derivative_bound=bounds,
            delay=delay,
            delay_bound=delay_bound,
            line_error=line_error,
            modelled=rows["modelled"],
            force=force,
            force_bound=force_bound,
            power=0.5 * omega * force.imag,
            at_floor=at_floor,
            iterations=rows["iterations"],
            converged_reason=rows["converged_reason"],
            field=rows["field"] if self.fields else None,
            models=models,
        )


def phase_lines(lattice, omega, phase, line_error, window):
    """Return the straight line through each detector's phase, or why there is none.

    Not collective.

    Parameters
    ----------
    lattice : pgran.medium.lattice.Lattice or pgran.results.LatticeRecord
    omega, phase, line_error : numpy.ndarray
        As in `pgran.results.Response`.
    window : tuple of float
        In units of omega_mx.
    """
    if lattice.damping == 0:
        why = "without damping amplitudes are real, and their phase is 0 or pi"
        return [PhaseLine(why_not=why) for _ in phase.T]
    columns = zip(phase.T, line_error.T, strict=True)
    return [fit_phase(omega / lattice.omega_mx, *column, *window) for column in columns]
