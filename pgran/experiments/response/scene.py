"""Scene `response`: amplitude and phase of single balls over a sweep of driving frequencies."""

import time

import numpy as np

from pgran.driven import drive as driven
from pgran.driven.phase import and_more
from pgran.experiments.response.curve import choose_method, solve_curve
from pgran.experiments.response.points import ResponseSweep, phase_lines
from pgran.experiments.response.record import LINES, Response
from pgran.medium.base import medium
from pgran.run.agreement import agreeing, on_root
from pgran.run.experiment import Caution, Scene
from pgran.run.frequencies import SWEEP, check_sweep
from pgran.run.interface import in_parallel
from pgran.run.keys import with_solver
from pgran.run.keywords import PROGRESS, Window, option, options_of, run_of
from pgran.run.options import FLAG, REAL, check_ends
from pgran.run.task import carry_out
from pgran.store.estimate import counted, with_error
from pgran.store.fields import ball_names
from pgran.store.si import SI


def check(values, given):
    """Raise where options contradict each other."""
    check_sweep(values, given)
    check_ends("phase_fit", values)
    if values["sweep_omega"] is not None:
        # how a file resolves its grid is not meant for the few frequencies of a later list
        listed = given["sweep_omega"].rank
        for name, otherwise in (("sweep_method", "auto"), ("sweep_resolve", None)):
            if name in given and given[name].rank < listed:
                values[name] = otherwise


def summary(result):
    """Return in words what a run found."""
    lattice, response, si = result.medium, result.response, SI.of(result)
    nw, asked = len(response.omega), np.count_nonzero(response.requested)
    added = f", {nw - asked} of them added to resolve the curve," if nw > asked else ""
    yield (
        f"{counted(nw, 'frequency')}{added} with "
        f"{counted(response.factorizations, 'factorization')} in {response.solve_seconds:.2f} s"
    )
    yield from driven.reached_accuracy(response, response.converged_reason > 0)
    yield from unresolved(response, lattice.built.dissipates)
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
        helps = damped and response.method == "points"
        hint = "; -sweep_method curve resolves it" if helps else ""
        yield Caution(
            f"the curve is not resolved between {omega[first]:.6g} and {omega[first + 1]:.6g}"
            f"{and_more(places.size - 1)}{hint}"
        )


@in_parallel("sweep", shares_lattice=True, lattice=medium, detectors=driven.DETECTORS, omegas=SWEEP)
@with_solver
def sweep(
    lattice,
    omegas,
    detectors,
    crew=None,
    *,
    method=option(
        "auto",
        "points, each frequency solved for; curve, models of intervals, proven between frequencies "
        "too; auto, what is cheaper for the frequencies asked for",
        choices=("points", "curve", "auto"),
    ),
    resolve=option(
        None,
        "with models, frequencies are added until straight lines between them are right to this "
        f"part of the amplitude; by default {LINES:g}; 0: only those asked for",
        kind=REAL, low=0, high=0.5,
    ),
    error_tolerance=driven.STEADY["error_tolerance"],
    error_floor=driven.STEADY["error_floor"],
    refresh_iterations=driven.STEADY["refresh_iterations"],
    phase_window=Window(
        option(0.3, "window of the phase fit", "omega_mx", key="phase_fit_min", low=0),
        option(1.0, "window of the phase fit", "omega_mx", key="phase_fit_max", above=0),
    ),
    fields=option(False, "store the whole field at every frequency", key="output_fields"),
    keep_models=option(
        None,
        "keep the models, so that response.at(omega) works later; by default where they are few",
        key="output_models", kind=FLAG,
    ),
    progress=PROGRESS,
) -> Response:  # fmt: skip
    """Solve the driven steady state over a sweep of frequencies (paper: ampeq, freqres)."""
    started = time.perf_counter()
    steady = driven.steady(error_tolerance, error_floor, refresh_iterations)
    with agreeing(crew.world):
        task = ResponseSweep(lattice, omegas, detectors, fields, steady)
        method = choose_method(method, task.scaled, task.omegas, resolve, fields)
    driven.check_driven(lattice, crew.world, omegas[0])
    models = None
    if method == "points":
        resolve, points = 0.0, carry_out(task, crew, progress)
    else:
        resolve = LINES if resolve is None else resolve
        points, models = solve_curve(task, crew, resolve, keep_models, progress)

    def respond():
        seconds = time.perf_counter() - started
        return task.response(points, models, method, resolve, phase_window, seconds)

    return on_root(crew.world, respond, keep=True)


SCENE = Scene(options_of(sweep), run_of(sweep), summary, check, shares_lattice=True)
