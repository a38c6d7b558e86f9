"""Scene `response`: amplitude and phase of single balls over a sweep of driving frequencies."""

import time

import numpy as np

from pgran.parallel.progress import Progress
from pgran.physics.lattice import check_frequency, detector_sites
from pgran.results import LatticeRecord, Response
from pgran.scenes.common import (
    below_relative_accuracy,
    driving_frequencies,
    fit_line,
    make_crew,
    make_lattice,
    phase_of_sign,
    reached_accuracy,
)
from pgran.solve.operators import Operators
from pgran.solve.steady import SteadySolver

LONGEST_UNIT = 16  # frequencies that share factorizations


def run(options, world, journal=None):
    """Return the lattice and its response, on rank 0; None on the others. Collective."""
    lattice = make_lattice(options, world)
    omegas = driving_frequencies(options)
    with make_crew(options, lattice, world, journal) as crew:
        response = sweep(
            lattice,
            omegas,
            options.detectors,
            crew,
            error_tolerance=options.error_tolerance,
            error_floor=options.error_floor,
            refresh_iterations=options.steady_refresh_iterations,
            fields=options.output_fields,
            phase_window=(options.phase_fit_min, options.phase_fit_max),
            progress=options.output_progress,
        )
    return response and [LatticeRecord.of(lattice), response]


def summary(records):
    """Return in words what a run found. Not collective."""
    lattice, response = records
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


def sweep(
    lattice,
    omegas,
    detectors,
    crew,
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
    crew : pgran.parallel.crew.Crew
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
        None on all ranks but rank 0.

    Raises
    ------
    InputError
        If a detector lies outside the lattice.
    """
    sites = detector_sites(lattice.shape, detectors)
    scaled, _ = lattice.in_own_unit()
    check_frequency(scaled, omegas[-1])
    row = point_dtype(len(sites), lattice.shape if fields else None)
    root = crew.world.rank == 0
    rows = np.zeros(len(omegas) if root else 0, row)
    started = time.perf_counter()
    with (
        Operators(scaled, crew.group) as operators,
        SteadySolver(
            operators, sites, error_tolerance, refresh_iterations, fields, error_floor
        ) as solver,
        Progress(len(omegas), "frequencies", progress if root else "none") as counter,
    ):

        def work(unit):
            solver.restart()
            points = np.zeros(len(unit), row)
            for point, index in zip(points, unit, strict=True):
                before = solver.factorizations
                state = solver.solve(1j * omegas[index])
                point["index"] = index
                point["factorizations"] = solver.factorizations - before
                for name in row.names[1:6]:
                    point[name] = getattr(state, name)
                if fields:
                    field = operators.field(solver.field)
                    point["field"] = 0.0 if field is None else field
            return points

        def deliver(points):
            rows[points["index"]] = points
            counter.advance(len(points))

        crew.share(units(len(omegas)), work, deliver, row)
    if not root:
        return None
    seconds = time.perf_counter() - started
    return assemble(lattice, omegas, sites, rows, seconds, phase_window, error_tolerance)


def units(count):
    """Cut a sweep into ranges of frequencies; how many ranks there are does not matter.

    Not collective.
    """
    length = min(LONGEST_UNIT, max(1, count // 64))
    return [range(start, min(start + length, count)) for start in range(0, count, length)]


def point_dtype(detectors, field_shape):
    """Return the dtype that a frequency's results travel in. Not collective."""
    fields = [
        ("index", np.int64),
        ("displacement", complex, (detectors,)),
        ("error_bound", float, (detectors,)),
        ("backward_error", float),
        ("iterations", np.int64),
        ("converged_reason", np.int64),
        ("factorizations", np.int64),
    ]
    return np.dtype(fields + ([("field", complex, field_shape)] if field_shape else []))


def assemble(lattice, omegas, sites, rows, seconds, phase_window, tolerance):
    """Return the Response that the solved frequencies make up. Not collective."""
    displacement = rows["displacement"].copy()
    at_floor = below_relative_accuracy(rows["error_bound"], displacement, tolerance)
    at_floor[rows["converged_reason"] <= 0] = 0
    known = np.where(at_floor, np.nan, displacement)
    phase = unwrap(known) if lattice.damping else phase_of_sign(known)
    low, high = phase_window
    inside = (omegas > low * lattice.omega_mx) & (omegas < high * lattice.omega_mx)
    inside &= (rows["converged_reason"] > 0) & (lattice.damping > 0)
    slope, intercept = fit_phase(omegas[inside] / lattice.omega_mx, phase[inside])
    distance = lattice.shape[0] - sites[:, 0]
    with np.errstate(divide="ignore"):
        velocity = distance / np.abs(slope)
    return Response(
        factorizations=int(rows["factorizations"].sum()),
        solve_seconds=seconds,
        phase_slope=slope,
        phase_velocity=velocity,
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
        field=rows["field"] if "field" in rows.dtype.names else None,
    )


def unwrap(displacement):
    """Return the phase along the first axis without its jumps, from the lowest frequency on.

    Not collective. Frequencies that have no amplitude keep NaN and are passed over.
    """
    phase = np.angle(displacement)
    for column in phase.T:
        known = np.isfinite(column)
        column[known] = np.unwrap(column[known])
    return phase


def fit_phase(x, phase):
    """Fit a straight line to the phase of each detector; NaN where there are too few points.

    Not collective.

    Parameters
    ----------
    x : numpy.ndarray, shape (n,)
        Frequency in units of omega_mx.
    phase : numpy.ndarray, shape (n, nd)

    Returns
    -------
    slope, intercept : numpy.ndarray, shape (nd,)
        In rad per omega_mx, and rad.
    """
    return np.transpose([fit_line(x, column) for column in phase.T])
