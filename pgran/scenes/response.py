"""Scene `response`: amplitude and phase of single balls over a sweep of driving frequencies."""

import numpy as np

from pgran.files.options import FLAG, REAL, Option
from pgran.machine import check_memory
from pgran.parallel.task import carry_out
from pgran.physics.accuracy import below_relative_accuracy
from pgran.physics.lattice import detector_sites
from pgran.physics.phase import fit_phase, phase_of_sign, phase_velocity, unwrap
from pgran.results import LatticeRecord, Response
from pgran.scenes.common import (
    DETECTORS,
    FLOOR,
    LATTICE,
    REUSE,
    SWEEP,
    TOLERANCE,
    check_ends,
    check_lattice,
    check_sweep,
    check_values,
    driving_frequencies,
    make_lattice,
    ranks_per_lattice,
    reached_accuracy,
)
from pgran.scenes.interface import in_parallel
from pgran.scenes.scene import Scene
from pgran.scenes.sweeping import FrequencySweep

PHASE = (
    Option("phase_fit_min", REAL, 0.3, "window of the phase fit", "omega_mx", low=0),
    Option("phase_fit_max", REAL, 1.0, "window of the phase fit", "omega_mx", above=0),
)
FIELDS = Option("output_fields", FLAG, False, "store the whole field at every frequency")


def check(values, given):
    """Raise where options contradict each other. Not collective."""
    check_lattice(values, given)
    check_sweep(values, given)
    check_ends("phase_fit", values)


def run(options, world, crew):
    """Return the lattice and its response, on rank 0; None on the others.

    Collective. Parameters are those of `pgran.scenes.scene.Scene`.
    """
    lattice = make_lattice(options, world)
    with crew(ranks_per_lattice(options, lattice, world)) as workers:
        response = sweep(
            lattice,
            driving_frequencies(options),
            options.detectors,
            workers,
            error_tolerance=options.error_tolerance,
            error_floor=options.error_floor,
            refresh_iterations=options.steady_refresh_iterations,
            fields=options.output_fields,
            phase_window=(options.phase_fit_min, options.phase_fit_max),
            progress=options.output_progress,
        )
    return response and [LatticeRecord.of(lattice), response]


def summary(result):
    """Return in words what a run found. Not collective."""
    lattice, response = result.lattice, result.response
    nw = len(response.omega)
    yield (
        f"{nw} frequencies with {response.factorizations} factorizations in "
        f"{response.solve_seconds:.2f} s"
    )
    yield from reached_accuracy(response, response.converged_reason > 0)
    if lattice.damping == 0:
        yield "no phase velocity: without damping amplitudes are real, and their phase is 0 or pi"
        return
    for site, slope, velocity in zip(
        response.detector.tolist(), response.phase_slope, response.phase_velocity, strict=True
    ):
        if np.isfinite(slope):
            yield (
                f"ball {tuple(site)}: phase slope {slope:.4g} rad per omega_mx, "
                f"phase velocity {velocity:.4g} spacings x omega_mx"
            )
    turn = np.fmax.reduce(np.abs(np.diff(response.phase, axis=0)), axis=None, initial=0.0)
    if turn > 3.0:
        yield (
            f"the phase turns by up to {turn:.2f} rad from one frequency to the next: the grid is "
            "too coarse to follow it with certainty (more -sweep_points)"
        )


@in_parallel(shares_lattice=True)
def sweep(
    lattice,
    omegas,
    detectors,
    crew=None,
    *,
    error_tolerance=1e-4,
    error_floor=1e-20,
    refresh_iterations=0,
    fields=False,
    phase_window=(0.3, 1.0),
    progress="none",
):
    """Solve the driven steady state over a sweep of frequencies (paper: ampeq, freqres).

    Collective.

    Parameters
    ----------
    lattice : pgran.physics.lattice.Lattice
    omegas : numpy.ndarray, shape (nw,)
        Driving frequencies, angular, increasing.
    detectors : array_like of int
        Ball indices, flat or one row a detector.
    crew : pgran.parallel.crew.Crew, optional
        All ranks unless given.
    error_tolerance : float
        Relative accuracy asked of each amplitude, and of each field if they are kept.
    error_floor : float
        See `pgran.solve.steady.SteadySolver`.
    refresh_iterations : int
        See `pgran.solve.steady.SteadySolver`.
    fields : bool
        Keep the amplitudes of all balls.
    phase_window : tuple of float
        Where the phase is fitted, in units of omega_mx.
    progress : str
        Style of `pgran.parallel.progress.Progress`.

    Returns
    -------
    pgran.results.Response or None
        With a crew of the caller's None on all ranks but rank 0.

    Raises
    ------
    InputError
        If a detector lies outside the lattice.
    """
    check_values(
        SCENE.options,
        error_tolerance=error_tolerance,
        error_floor=error_floor,
        steady_refresh_iterations=refresh_iterations,
    )
    choices = {
        "error_tolerance": error_tolerance,
        "error_floor": error_floor,
        "refresh_iterations": refresh_iterations,
        "whole_field": fields,
    }
    sites = detector_sites(lattice.shape, detectors)
    task = ResponseSweep(lattice, omegas, sites, choices)
    task.phase_window = phase_window
    return carry_out(task, crew, progress)


class ResponseSweep(FrequencySweep):
    """The amplitudes at the detectors, with their bounds, and the whole field if it is wanted.

    Parameters are those of `FrequencySweep`.
    """

    phase_window = (0.3, 1.0)

    def __init__(self, lattice, omegas, sites, choices):
        """Say what a frequency's results travel in."""
        super().__init__(lattice, omegas, sites, choices)
        self.fields, nd = choices["whole_field"], len(sites)
        kept = [
            ("displacement", complex, (nd,)),
            ("error_bound", float, (nd,)),
            ("backward_error", float),
            ("iterations", np.int64),
            ("converged_reason", np.int64),
        ]
        self.kept = [name for name, *_ in kept]
        field = [("field", complex, lattice.shape)] if self.fields else []
        self.row = np.dtype([*kept, ("factorizations", np.int64), *field])
        check_memory("sweep_points", len(self.omegas) * self.row.itemsize)

    def keep(self, point, state, solver):
        """See `FrequencySweep`; parameters are those of its `keep`."""
        for name in self.kept:
            point[name] = getattr(state, name)
        if self.fields:
            field = solver.operators.field(solver.field)
            point["field"] = 0.0 if field is None else field

    def collect(self, rows, seconds):
        """See `Task`."""
        lattice, omegas, sites = self.lattice, self.omegas, self.sites
        displacement = rows["displacement"].copy()
        tolerance = self.choices["error_tolerance"]
        at_floor = below_relative_accuracy(rows["error_bound"], displacement, tolerance)
        at_floor[rows["converged_reason"] <= 0] = 0
        known = np.where(at_floor, np.nan, displacement)
        phase = unwrap(known) if lattice.damping else phase_of_sign(known)
        low, high = self.phase_window
        inside = (omegas > low * lattice.omega_mx) & (omegas < high * lattice.omega_mx)
        inside &= (rows["converged_reason"] > 0) & (lattice.damping > 0)
        slope, intercept = fit_phase(omegas[inside] / lattice.omega_mx, phase[inside])
        distance = lattice.shape[0] - sites[:, 0]
        return Response(
            factorizations=int(rows["factorizations"].sum()),
            solve_seconds=seconds,
            phase_slope=slope,
            phase_velocity=phase_velocity(slope, distance),
            phase_intercept=intercept,
            phase_fit_min=low,
            phase_fit_max=high,
            omega=omegas,
            detector=sites,
            displacement=displacement,
            amplitude=np.abs(displacement),
            phase=phase,
            backward_error=rows["backward_error"],
            error_bound=rows["error_bound"],
            at_floor=at_floor,
            iterations=rows["iterations"],
            converged_reason=rows["converged_reason"],
            field=rows["field"] if self.fields else None,
        )


SCENE = Scene(
    options=(*LATTICE, *DETECTORS, *SWEEP, *TOLERANCE, *FLOOR, *REUSE, *PHASE, FIELDS),
    run=run,
    summary=summary,
    check=check,
    shares_lattice=True,
)
