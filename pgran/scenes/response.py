"""Scene `response`: amplitude and phase of single balls over a sweep of driving frequencies."""

import time
from dataclasses import astuple, replace

import numpy as np

from pgran.files.options import FLAG, REAL, TEXT, Option
from pgran.parallel.agreement import on_root
from pgran.parallel.task import carry_out
from pgran.physics.accuracy import below_relative_accuracy, is_accurate
from pgran.physics.curve import deviation
from pgran.physics.lattice import detector_sites
from pgran.physics.phase import (
    PhaseLine,
    and_more,
    fit_phase,
    group_delay,
    phase_of_sign,
    phase_velocity,
    unwrap,
)
from pgran.results import LatticeRecord, Response
from pgran.scenes import common
from pgran.scenes.curve import CurvePoints, IntervalSweep, choose_method, stored
from pgran.scenes.interface import in_parallel
from pgran.scenes.scene import Scene
from pgran.scenes.sweeping import FrequencySweep

METHOD = Option(
    "sweep_method", TEXT, "auto",
    "points, each frequency solved for; curve, models of intervals, proven between frequencies too;"
    " auto, what is cheaper for the frequencies asked for",
    choices=("points", "curve", "auto"),
)  # fmt: skip
RESOLVE = Option(
    "sweep_resolve", REAL, None,
    "with models, frequencies are added until straight lines between them are right to this part "
    f"of the amplitude; {common.LINES:g} unless given, 0 = those asked for alone",
    low=0, high=0.5
)  # fmt: skip
PHASE = (
    Option("phase_fit_min", REAL, 0.3, "window of the phase fit", "omega_mx", low=0),
    Option("phase_fit_max", REAL, 1.0, "window of the phase fit", "omega_mx", above=0),
)
FIELDS = Option("output_fields", FLAG, False, "store the whole field at every frequency")
MODELS = Option(
    "output_models", FLAG, None,
    "keep the models, so that response.at(omega) works later; by default where they are few"
)  # fmt: skip
FEW_BYTES = 2**24  # of models that are few
# What is said of the line through a phase, in the order of `phase_velocity` and PhaseLine.
LINE = (
    *("phase_velocity", "phase_velocity_error", "phase_slope", "phase_slope_error"),
    *("phase_intercept", "phase_used_min", "phase_used_max"),
)
GOOD = 2  # the reason of a frequency that a model gives


def check(values, given):
    """Raise where options contradict each other. Not collective."""
    common.check_lattice(values, given)
    common.check_sweep(values, given)
    common.check_ends("phase_fit", values)


def run(options, world, crew):
    """Return the lattice and its response, on rank 0; None on the others.

    Collective. Parameters are those of `pgran.scenes.scene.Scene`.
    """
    lattice = common.make_lattice(options, world)
    with crew(common.ranks_per_lattice(options, lattice, world)) as workers:
        response = sweep(
            lattice,
            common.driving_frequencies(options),
            options.detectors,
            workers,
            method=options.sweep_method,
            resolve=options.sweep_resolve,
            keep_models=options.output_models,
            fields=options.output_fields,
            phase_window=(options.phase_fit_min, options.phase_fit_max),
            progress=options.output_progress,
            **common.steady_of(options),
        )
    return response and [LatticeRecord.of(lattice), response]


def summary(result):
    """Return in words what a run found. Not collective."""
    lattice, response = result.lattice, result.response
    nw, asked = len(response.omega), np.count_nonzero(response.requested)
    added = f", {nw - asked} of them added to resolve the curve," if nw > asked else ""
    yield (
        f"{nw} frequencies{added} with {response.factorizations} factorizations in "
        f"{response.solve_seconds:.2f} s"
    )
    yield from common.reached_accuracy(response, response.converged_reason > 0)
    yield from unresolved(response)
    for site, line, velocity, error in zip(
        response.detector.tolist(),
        phase_lines(lattice, response),
        response.phase_velocity,
        response.phase_velocity_error,
        strict=True,
    ):
        if line.why_not:
            yield f"ball {tuple(site)}: no phase velocity: {line.why_not}"
        else:
            yield (
                f"ball {tuple(site)}: phase slope {line.slope:.4g} +- {line.slope_error:.1g} rad "
                f"per omega_mx, phase velocity {velocity:.4g} +- {error:.1g} spacings x omega_mx"
            )


def unresolved(response):
    """Yield in words where straight lines between the points are not the curve. Not collective."""
    wrong = ~np.all(response.line_error[1:] <= (response.resolve or common.LINES), axis=1)
    places, omega = np.flatnonzero(wrong), response.omega
    if places.size:
        first = places[0]
        hint = "" if response.method == "curve" else "; -sweep_method curve resolves it"
        yield (
            f"the curve is not resolved between {omega[first]:.6g} and {omega[first + 1]:.6g}"
            f"{and_more(places.size - 1)}{hint}"
        )


def phase_lines(lattice, response):
    """Return the straight line through each detector's phase, or why there is none.

    Not collective. `lattice` is a `pgran.physics.lattice.Lattice` or its record.
    """
    if lattice.damping == 0:
        why = "without damping amplitudes are real, and their phase is 0 or pi"
        return [PhaseLine(why_not=why) for _ in response.detector]
    window = response.phase_fit_min, response.phase_fit_max
    x = response.omega / lattice.omega_mx
    columns = zip(response.phase.T, response.line_error.T, strict=True)
    return [fit_phase(x, phase, line_error, *window) for phase, line_error in columns]


@in_parallel(shares_lattice=True)
def sweep(
    lattice,
    omegas,
    detectors,
    crew=None,
    *,
    method="auto",
    resolve=None,
    keep_models=None,
    fields=False,
    phase_window=(0.3, 1.0),
    progress="none",
    **steady,
):
    """Solve the driven steady state over a sweep of frequencies (paper: ampeq, freqres).

    Collective.

    Parameters
    ----------
    lattice : pgran.physics.lattice.Lattice
    omegas : array_like of float, shape (nw,)
        Driving frequencies, angular, increasing.
    detectors : array_like of int
        Ball indices, flat or one row a detector.
    crew : pgran.parallel.crew.Crew, optional
        All ranks unless given.
    method : str
        `points`, each frequency solved for; `curve`, models of intervals that are proven between
        the frequencies, too; `auto`, what is cheaper for these frequencies.
    resolve : float, optional
        With models, frequencies are added until straight lines between them are right to this part
        of the amplitude, 1e-2 unless given; 0 adds none.
    keep_models : bool, optional
        Keep the models for `Response.at`; by default where they are few.
    fields : bool
        Keep the amplitudes of all balls, too.
    phase_window : tuple of float
        Where the phase is fitted, in units of omega_mx.
    progress : str
        Style of `pgran.parallel.progress.Progress`.
    **steady
        `error_tolerance` (1e-4) asked of each amplitude, and of each field if they are kept;
        `error_floor` and `refresh_iterations` of `pgran.solve.steady.SteadySolver`.

    Returns
    -------
    pgran.results.Response or None
        With a crew of the caller's None on all ranks but rank 0.

    Raises
    ------
    InputError
        If a detector lies outside the lattice, or a value is impossible.
    """
    started = time.perf_counter()
    common.check_values((METHOD,), sweep_method=method)
    if resolve is not None:
        common.check_values((RESOLVE,), sweep_resolve=resolve)
    ends = dict(zip(("phase_fit_min", "phase_fit_max"), phase_window, strict=True))
    common.check_values(PHASE, **ends)
    common.check_ends("phase_fit", ends)
    task = ResponseSweep(lattice, omegas, detectors, fields, steady)
    method, models = choose_method(method, task.scaled, task.omegas, resolve, fields), None
    if method == "points":
        resolve, points = 0.0, carry_out(task, crew, progress)
    else:
        resolve = common.LINES if resolve is None else resolve
        points, models = _curve(task, crew, resolve, keep_models, progress)

    def respond():
        seconds = time.perf_counter() - started
        return task.response(points, models, (method, resolve), phase_window, seconds)

    return on_root(crew.world, respond, keep=True)


def _curve(task, crew, resolve, keep_models, progress):
    """Return the points of the curve, and the record of its models if they are kept, on rank 0.

    Where no model is proven the frequencies asked for are solved for one by one, and so are points
    of the curve that a proven model misses, as where the amplitude almost vanishes.
    """
    intervals = IntervalSweep(task.scaled, task.omegas, task.sites, task.choices["error_tolerance"])
    models = crew.world.bcast(carry_out(intervals, crew, progress))
    if crew.dry:
        found, models["proven"] = np.zeros(0, task.row), 1
    else:
        found = carry_out(CurvePoints(models, intervals.limits, task.omegas, resolve), crew)
    kept, missing = None, None
    if crew.world.rank == 0:
        wanted = np.union1d(task.omegas, found["omega"])
        found = task.accurate(found)
        missing = np.setdiff1d(wanted, found["omega"])
        few = models.nbytes <= FEW_BYTES if keep_models is None else keep_models
        kept = stored(models, intervals.limits) if few else None
    missing = crew.world.bcast(missing)
    if crew.dry:
        found = np.zeros(len(missing), task.row)
    elif len(missing):
        others = carry_out(task.at(missing), crew, progress)
        if crew.world.rank == 0:
            found = np.concatenate([found, others])
            found = found[np.argsort(found["omega"], kind="stable")]
    if crew.world.rank == 0:
        found["factorizations"][:1] += models["factorizations"].sum()
    return found, kept


class ResponseSweep(FrequencySweep):
    """The amplitudes at the detectors, with their bounds, and the whole field if it is wanted.

    Parameters are those of `sweep`.
    """

    def __init__(self, lattice, omegas, detectors, fields, steady):
        """Say what a frequency's results travel in."""
        self.fields, self.detectors, self.steady = fields, detectors, steady
        sites = detector_sites(lattice.shape, detectors)
        kept = [
            ("omega", float),
            ("displacement", complex, (len(sites),)),
            ("error_bound", float, (len(sites),)),
            ("derivative", complex, (len(sites),)),
            ("derivative_bound", float, (len(sites),)),
            ("backward_error", float),
            ("iterations", np.int64),
            ("converged_reason", np.int64),
            *([("field", complex, lattice.shape)] if fields else []),
        ]
        choices = common.steady_choices(steady) | {"whole_field": fields, "derivatives": True}
        super().__init__(lattice, omegas, sites, kept, choices)

    def at(self, omegas):
        """Return the same task at other frequencies. Not collective."""
        return ResponseSweep(self.lattice, omegas, self.detectors, self.fields, self.steady)

    def keep(self, point, solver):
        """See `FrequencySweep`; the field comes to the first rank of a group."""
        if self.fields:
            field = solver.operators.field(solver.field)
            point["field"] = 0.0 if field is None else field

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

    def response(self, rows, models, how, phase_window, seconds):
        """Return the record that all rows make up.

        Not collective.

        Parameters
        ----------
        rows : numpy.ndarray of `row`
        models : pgran.results.Models or None
        how : tuple of str and float
            The method, and what straight lines were asked to be right to.
        phase_window : tuple of float
        seconds : float
            What it took.
        """
        lattice, displacement = self.lattice, rows["displacement"].copy()
        tolerance = self.choices["error_tolerance"]
        at_floor = below_relative_accuracy(rows["error_bound"], displacement, tolerance)
        failed = rows["converged_reason"] <= 0
        at_floor[failed] = 0
        known = np.where(failed[:, None] | (at_floor > 0), np.nan, displacement)
        derivative, bounds = rows["derivative"].copy(), rows["derivative_bound"]
        line_error = deviation(rows["omega"], known, derivative)
        delay, delay_bound = group_delay(known, derivative, rows["error_bound"], bounds)
        response = Response(
            factorizations=int(rows["factorizations"].sum()),
            solve_seconds=seconds,
            method=how[0],
            resolve=how[1],
            **dict.fromkeys(LINE, np.full(len(self.sites), np.nan)),
            phase_fit_min=phase_window[0],
            phase_fit_max=phase_window[1],
            omega=rows["omega"],
            requested=np.isin(rows["omega"], self.omegas).astype(np.int8),
            detector=self.sites,
            displacement=displacement,
            amplitude=np.abs(displacement),
            phase=unwrap(known) if lattice.damping else phase_of_sign(known),
            backward_error=rows["backward_error"],
            error_bound=rows["error_bound"],
            derivative=derivative,
            derivative_bound=bounds,
            delay=delay,
            delay_bound=delay_bound,
            line_error=np.pad(line_error, ((1, 0), (0, 0))),
            at_floor=at_floor,
            iterations=rows["iterations"],
            converged_reason=rows["converged_reason"],
            field=rows["field"] if self.fields else None,
            models=models,
        )
        lines = phase_lines(lattice, response)
        velocities = [
            phase_velocity(line, lattice.shape[0] - site[0])
            for line, site in zip(lines, self.sites, strict=True)
        ]
        fitted = [
            (*velocity, *astuple(line)[:-1])
            for velocity, line in zip(velocities, lines, strict=True)
        ]
        return replace(response, **dict(zip(LINE, np.transpose(fitted), strict=True)))


SCENE = Scene(
    options=(
        *(*common.LATTICE, *common.DETECTORS, *common.SWEEP),
        *(METHOD, RESOLVE, *common.STEADY.values(), *PHASE, FIELDS, MODELS),
    ),
    run=run,
    summary=summary,
    check=check,
    shares_lattice=True,
)
