"""Scene `response`: amplitude and phase of single balls over a sweep of driving frequencies."""

import numpy as np

from pgran.files.options import FLAG, REAL, Option
from pgran.parallel.task import carry_out
from pgran.physics.accuracy import below_relative_accuracy
from pgran.physics.lattice import detector_sites
from pgran.physics.phase import fit_phase, phase_of_sign, phase_velocity, unwrap
from pgran.results import LatticeRecord, Response
from pgran.scenes import common
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
            fields=options.output_fields,
            phase_window=(options.phase_fit_min, options.phase_fit_max),
            progress=options.output_progress,
            **common.steady_of(options),
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
    yield from common.reached_accuracy(response, response.converged_reason > 0)
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
    task = ResponseSweep(lattice, omegas, detectors, fields, phase_window, steady)
    return carry_out(task, crew, progress)


class ResponseSweep(FrequencySweep):
    """The amplitudes at the detectors, with their bounds, and the whole field if it is wanted.

    Parameters are those of `sweep`.
    """

    def __init__(self, lattice, omegas, detectors, fields, phase_window, steady):
        """Say what a frequency's results travel in."""
        self.fields, self.phase_window = fields, phase_window
        ends = dict(zip(("phase_fit_min", "phase_fit_max"), phase_window, strict=True))
        common.check_values(PHASE, **ends)
        common.check_ends("phase_fit", ends)
        sites = detector_sites(lattice.shape, detectors)
        kept = [
            ("displacement", complex, (len(sites),)),
            ("error_bound", float, (len(sites),)),
            ("backward_error", float),
            ("iterations", np.int64),
            ("converged_reason", np.int64),
            *([("field", complex, lattice.shape)] if fields else []),
        ]
        choices = common.steady_choices(steady) | {"whole_field": fields}
        super().__init__(lattice, omegas, sites, kept, choices)

    def keep(self, point, solver):
        """See `FrequencySweep`; the field comes to the first rank of a group."""
        if self.fields:
            field = solver.operators.field(solver.field)
            point["field"] = 0.0 if field is None else field

    def collect(self, rows, seconds):
        """See `Task`."""
        lattice, omegas, sites = self.lattice, self.omegas, self.sites
        displacement = rows["displacement"].copy()
        tolerance = self.choices["error_tolerance"]
        at_floor = below_relative_accuracy(rows["error_bound"], displacement, tolerance)
        failed = rows["converged_reason"] <= 0
        at_floor[failed] = 0
        known = np.where(failed[:, None] | (at_floor > 0), np.nan, displacement)
        phase = unwrap(known) if lattice.damping else phase_of_sign(known)
        low, high = self.phase_window
        inside = (omegas > low * lattice.omega_mx) & (omegas < high * lattice.omega_mx)
        inside &= ~failed & (lattice.damping > 0)
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
    options=(
        *(*common.LATTICE, *common.DETECTORS, *common.SWEEP),
        *(*common.STEADY.values(), *PHASE, FIELDS),
    ),
    run=run,
    summary=summary,
    check=check,
    shares_lattice=True,
)
