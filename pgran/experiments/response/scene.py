"""Scene `response`: amplitude and phase of single balls over a sweep of driving frequencies."""

import contextlib
import time
from dataclasses import astuple

import numpy as np
from numpy.typing import ArrayLike

from pgran.driven import amplitudes, drive
from pgran.driven.amplitudes import PhaseLine, and_more, is_accurate
from pgran.errors import InputError
from pgran.experiments.response.curve import choose_method, line_errors, solve_curve
from pgran.experiments.response.record import LINES, Response
from pgran.medium.base import EPSILON, Medium, medium
from pgran.run.agreement import agreeing, on_root
from pgran.run.crew import Crew
from pgran.run.experiment import (
    PROGRESS,
    Caution,
    Scene,
    in_parallel,
    option,
    options_of,
    run_of,
    window,
)
from pgran.run.frequencies import SWEEP, check_sweep
from pgran.run.options import FLAG, REAL, check_ends
from pgran.run.task import carry_out
from pgran.store.estimate import counted, with_error
from pgran.store.record import ball_names, columns_of, row_of
from pgran.store.si import SI

MODELLED = 2  # the reason of a frequency that a model gives
WORTH = 5.0  # seconds of a sweep from which it is said what would be quicker
# What there is where overlaps are known, and what it is where nothing was solved or proven.
OPENING = {"opening": np.nan, "opening_part": np.nan, "opening_contact": -1}


@in_parallel("sweep", shares_lattice=True, lattice=medium, detectors=drive.DETECTORS, omegas=SWEEP)
def sweep(
    lattice: Medium,
    omegas: "ArrayLike",
    detectors: "ArrayLike",
    crew: Crew | None = None,
    *,
    method: str = option(
        "auto",
        "points, each frequency solved for; curve, models of intervals, proven between frequencies "
        "too; auto, the cheaper one of these for the frequencies asked for; moments, one "
        "recurrence for all frequencies but those that it misses",
        choices=("points", "curve", "moments", "auto"),
    ),
    resolve: float | None = option(
        None,
        "with models, frequencies are added until straight lines between them are right to this "
        f"part of the amplitude; by default {LINES:g}; 0: only those asked for",
        kind=REAL, low=0, high=0.5,
    ),
    error_tolerance: float = drive.STEADY["error_tolerance"],
    error_floor: float = drive.STEADY["error_floor"],
    refresh_iterations: int = drive.STEADY["refresh_iterations"],
    phase_window: "ArrayLike" = window(
        option(0.3, "window of the phase fit", "omega_mx", key="phase_fit_min", low=0),
        option(1.0, "window of the phase fit", "omega_mx", key="phase_fit_max", above=0),
    ),
    fields: bool = option(False, "store the whole field at every frequency", key="output_fields"),
    keep_models: bool | None = option(
        None,
        "keep the models, so that response.at(omega) works later; by default where they are few",
        key="output_models", kind=FLAG,
    ),
    progress: str = PROGRESS,
) -> Response:  # fmt: skip
    """Solve the driven steady state over a sweep of frequencies (paper: ampeq, freqres).

    (K + i omega C - omega^2 M) A = f, with all damping in C, gives the amplitudes A of all balls
    while the wall moves like exp(i omega t): see `pgran manual accuracy` for their bounds.

    Examples
    --------
    >>> import pgran
    >>> lattice = pgran.Lattice.random((6, 5), seed=1)
    >>> response = pgran.sweep(lattice, [0.2, 0.4, 0.6], [(2, 3)], method="points")
    >>> response.amplitude.shape
    (3, 1)
    >>> bool((response.error_bound <= 1e-4 * response.amplitude).all())
    True
    """
    started = time.perf_counter()
    steady = drive.steady(error_tolerance, error_floor, refresh_iterations)
    with agreeing(crew.world):
        task = ResponseSweep(lattice, omegas, detectors, fields, steady)
        method = choose_method(method, task.scaled, task.omegas, resolve, fields, keep_models)
    drive.check_driven(lattice, crew.world, omegas[0])
    models, moments = None, None
    if method == "points":
        resolve, points = 0.0, carry_out(task, crew, progress)
    elif method == "moments":
        from pgran.driven.sweeps import carry_out_sweep

        resolve, (points, moments) = 0.0, carry_out_sweep(task, method, crew, progress)
    else:
        resolve = LINES if resolve is None else resolve
        points, models = solve_curve(task, crew, resolve, keep_models, progress)

    def respond():
        seconds = time.perf_counter() - started
        more = {"models": models, "moments": moments}
        return task.response(points, method, resolve, phase_window, seconds, **more)

    return on_root(crew.world, respond, keep=True)


class ResponseSweep(drive.FrequencySweep):
    """The amplitudes at the detectors, with their bounds, and the whole field if it is wanted."""

    def __init__(self, lattice, omegas, detectors, fields, steady):
        self.fields, self.detectors, self.steady = fields, detectors, steady
        sites = lattice.sites(detectors)
        axes = {"detector_number": (len(sites),), "balls": lattice.shape, "bound": (2,)}
        self.overlaps = None
        if lattice.has_overlaps:
            from pgran.medium.overlaps import overlaps_of

            with contextlib.suppress(InputError):  # the summary says why
                self.overlaps = overlaps_of(lattice)
        without = () if fields else ("field",)
        without += () if self.overlaps else tuple(OPENING)
        row = row_of(Response, without, **axes)
        row += [("reaction", complex), ("reaction_bound", float)]
        choices = steady | {"whole_field": fields, "derivatives": True}
        super().__init__(lattice, omegas, sites, row, choices)

    def at(self, omegas):
        """Return the same task at other frequencies."""
        return ResponseSweep(self.lattice, omegas, self.detectors, self.fields, self.steady)

    by, sources = "-sweep_method", ("the drive",)

    def by_moments(self, group):
        """Return the same by moments. Collective."""
        from pgran.driven.moment_sweep import DriveMoments

        return DriveMoments(self, group)

    def prepare(self, operators):
        """See `FrequencySweep`."""
        if self.overlaps is not None:
            from pgran.driven.opening import Openings

            self.openings = Openings(operators, self.overlaps)

    def keep(self, point, solver):
        """See `FrequencySweep`; the field comes to the first rank of a group."""
        if self.overlaps is not None:
            found, error = OPENING.values(), solver.bounds.field_error
            if point["converged_reason"] > 0 and not np.isnan(error):
                found = self.openings.at(solver.field, error)
            for name, value in zip(OPENING, found, strict=True):
                point[name] = value
        if self.fields:
            field = solver.operators.layout.field(solver.field)
            point["field"] = 0.0 if field is None else self.scaled.displacements(field)

    def collect(self, rows, seconds):
        """See `Task`."""
        rows["omega"] = self.omegas
        for name in OPENING.keys() & set(rows.dtype.names):  # of series there is no field
            rows[name][np.isnan(rows["backward_error"])] = OPENING[name]
        return rows

    def accurate(self, points):
        """Return as rows those points of models that are as accurate as asked."""
        tolerance = self.choices["error_tolerance"]
        good = is_accurate(points["error_bound"], points["displacement"], tolerance).all(axis=1)
        rows = np.zeros(np.count_nonzero(good), self.row)
        for name in set(rows.dtype.names) & set(points.dtype.names):
            rows[name] = points[name][good]
        for name in OPENING.keys() & set(rows.dtype.names):
            rows[name] = OPENING[name]
        rows["converged_reason"] = MODELLED
        return rows

    def response(self, rows, method, resolve, phase_window, seconds, **more):
        """Return the record of all rows; straight lines were asked to be right to `resolve`."""
        columns = columns_of(Response, rows)
        omega, displacement, bound = (columns[n] for n in ("omega", "displacement", "error_bound"))
        failed = columns["converged_reason"] <= 0
        at_floor = amplitudes.below_relative_accuracy(
            bound, displacement, self.choices["error_tolerance"]
        )
        at_floor[failed] = 0
        # only what is accurate relative to itself has a phase
        accurate = np.where(failed[:, None] | (at_floor > 0), np.nan, displacement)
        phase = amplitudes.phase_of(accurate, self.lattice.dissipates)
        slope = columns["derivative"]
        delay, delay_bound = amplitudes.group_delay(
            accurate, slope, bound, columns["derivative_bound"]
        )
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
            **more,
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
    # In spacings times omega_mx (paper: phsvel). It is no speed of sound: absorbing diffusion makes
    # the slope fall like 1 / sqrt(beta), seen from .003 to .03, and a pulse arrives far earlier.
    with np.errstate(divide="ignore"):
        velocity = lattice.depths(sites) / np.abs(slope)
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
        return [PhaseLine(why_not=why) for _ in phase.T]
    columns = zip(phase.T, line_error.T, strict=True)
    return [amplitudes.fit_phase(omega / lattice.omega_mx, *column, *window) for column in columns]


def check(values, given):
    """Raise where options contradict each other."""
    check_sweep(values, given)
    check_ends("phase_fit", values)
    if values["sweep_omega"] is not None:
        # how a file resolves its grid is not meant for the few frequencies of a later list
        listed = given["sweep_omega"].rank
        for name in ("sweep_method", "sweep_resolve", "output_models"):
            if name in given and given[name].rank < listed:
                values[name] = "auto" if name == "sweep_method" else None


def summary(result):
    """Return in words what a run found."""
    lattice, response, si = result.medium, result.response, SI.of(result)
    nw, asked = len(response.omega), np.count_nonzero(response.requested)
    added = f", {nw - asked} of them added to resolve the curve," if nw > asked else ""
    yield f"{counted(nw, 'frequency')}{added} with {drive.work_of(response)}"
    yield from drive.reached_accuracy(response, response.converged_reason > 0)
    yield from unresolved(response, lattice.built.dissipates)
    if response.method != "moments" and response.solve_seconds > WORTH:
        from pgran.experiments.response.quicker import by_moments

        yield from by_moments(response, lattice.built, result.attributes.get("options", ""))
    if response.method == "curve" and "-steady_ksp_" in result.attributes.get("options", ""):
        yield "the KSP solves at the ends of intervals; by -sweep_method points at each frequency"
    window = response.phase_fit_min, response.phase_fit_max
    lines = phase_lines(lattice, response.omega, response.phase, response.line_error, window)
    for d, (ball, line) in enumerate(zip(ball_names(response.detector), lines, strict=True)):
        if line.why_not:
            yield f"{ball}: no phase velocity: {line.why_not}"
            continue
        velocity, error = response.phase_velocity[d], response.phase_velocity_error[d]
        yield (
            f"{ball}: phase slope {with_error(line.slope, line.slope_error)} rad "
            f"per omega_mx, phase velocity {with_error(velocity, error)} "
            f"{lattice.length} x omega_mx{si.say('m/s', velocity * lattice.omega_mx)}"
        )
    if lattice.built.has_overlaps:
        from pgran.experiments.response.opened import in_words

        yield from in_words(response, lattice, si)


def unresolved(response, damped):
    """Yield in words where straight lines between the points are not the curve."""
    places, omega = np.flatnonzero(response.unresolved), response.omega
    if response.method == "curve" and response.unmodelled:
        first = np.flatnonzero(response.modelled[1:] == 0)[0]
        yield (
            f"no model could be proven for {100 * response.unmodelled:.3g} % of the sweep, first "
            f"above {omega[first]:.6g}: there the frequencies asked for were solved one by one"
        )
    if places.size:
        first = places[0]
        helps = {"points": "-sweep_method curve resolves it", "moments": "take more -sweep_points"}
        hint = f"; {helps[response.method]}" if damped and response.method in helps else ""
        yield Caution(
            f"the curve is not resolved between {omega[first]:.6g} and {omega[first + 1]:.6g}"
            f"{and_more(places.size - 1)}{hint}"
        )


SCENE = Scene(options_of(sweep), run_of(sweep), summary, check, shares_lattice=True, function=sweep)
