"""Scene `projection`: the driven lattice in terms of its normal modes, over a sweep."""

import math
import time

import numpy as np

from pgran.parallel.crew import Crew
from pgran.parallel.progress import Progress
from pgran.physics.lattice import check_frequency
from pgran.results import LatticeRecord, Projection
from pgran.scenes.common import driving_frequencies, fit_line, make_lattice
from pgran.scenes.modes import certificate, chosen, find_modes
from pgran.scenes.response import units
from pgran.solve.operators import Operators
from pgran.solve.steady import SteadySolver

ALL_MODES = 3600  # balls; of a larger lattice only the modes near each driving frequency
NEAR = 60  # so many


def run(options, world, journal=None):
    """Return the lattice and its projection, on rank 0; None on the others. Collective."""
    lattice = make_lattice(options, world)
    omegas = driving_frequencies(options)
    which = which_modes(options, lattice.balls, omegas)
    with Crew(world, 1, journal) as crew:
        projection = project(
            lattice,
            omegas,
            crew,
            which,
            error_tolerance=options.error_tolerance,
            refresh_iterations=options.steady_refresh_iterations,
            progress=options.output_progress,
        )
    return projection and [LatticeRecord.of(lattice), projection]


def which_modes(options, balls, omegas):
    """Return which modes to project on, as `find_modes` takes it. Not collective."""
    which = chosen(options)
    if not which and (options.modes_count or balls > ALL_MODES):
        which = {"targets": omegas, "count": options.modes_count or NEAR}
    return which


def summary(records):
    """Return in words what a run found. Not collective."""
    lattice, projection = records
    nm = len(projection.mode_omega)
    yield (
        f"{len(projection.omega)} frequencies on {nm} modes in {projection.solve_seconds:.2f} s, "
        f"with {projection.factorizations} factorizations"
    )
    yield certificate(projection, nm)
    omega, modes, unit = projection.omega, projection.mode_omega, lattice.omega_mx
    inside = (omega > 0.1 * unit) & (omega < 0.9 * unit) & (projection.converged_reason > 0)
    if nm > 3:
        inside &= (omega >= modes[0]) & (omega <= modes[-1])
        slope, _ = fit_line(omega[inside], modes[projection.dominant[inside]])
        if np.isfinite(slope):
            yield f"the dominant mode follows the drive with slope {slope:.3f} (.1 to .9 omega_mx)"


def project(
    lattice,
    omegas,
    crew,
    which=None,
    *,
    error_tolerance=1e-4,
    refresh_iterations=0,
    progress="none",
):
    """Project driven steady states on normal modes: c_i = sum_p A_p f_i(p) (paper: cidef).

    Collective. The modes are computed once; a field lives until it is projected.

    Parameters
    ----------
    lattice : pgran.physics.lattice.Lattice
    omegas : numpy.ndarray, shape (nw,)
        Driving frequencies, angular, increasing.
    crew : pgran.parallel.crew.Crew
        Of groups of one rank.
    which : dict, optional
        Which modes: arguments of `pgran.scenes.modes.find_modes`; all by default.
    error_tolerance : float
        Relative accuracy asked of each field, in the 2-norm; a coefficient is no more in error than
        the field.
    refresh_iterations : int
        See `pgran.solve.steady.SteadySolver`.
    progress : str
        Style of `pgran.parallel.progress.Progress`.

    Returns
    -------
    pgran.results.Projection or None
        None on all ranks but rank 0.
    """
    scaled, _ = lattice.in_own_unit()
    check_frequency(scaled, omegas[-1])
    started, root = time.perf_counter(), crew.world.rank == 0
    modes = find_modes(lattice, crew, **(which or {}), shapes=True, progress=progress)
    vectors = _on_all_ranks(modes.vector if root else None, crew.world)
    row = np.dtype(
        [
            ("index", np.int64),
            ("coefficient", complex, (len(vectors),)),
            ("field_bound", float),
            ("converged_reason", np.int64),
            ("factorizations", np.int64),
        ]
    )
    rows = np.zeros(len(omegas) if root else 0, row)
    nowhere = np.empty((0, len(lattice.shape)), dtype=np.int64)
    with (
        Operators(scaled, crew.group) as operators,
        SteadySolver(
            operators, nowhere, error_tolerance, refresh_iterations, whole_field=True
        ) as solver,
        Progress(len(omegas), "frequencies", progress if root else "none") as counter,
    ):

        def work(unit):
            solver.restart()
            points = np.zeros(len(unit), row)
            for point, index in zip(points, unit, strict=True):
                before = solver.factorizations
                state = solver.solve(1j * omegas[index])
                field = operators.field(solver.field).ravel()
                point["index"] = index
                point["coefficient"] = vectors @ field.real + 1j * (vectors @ field.imag)
                point["field_bound"] = state.field_bound
                point["converged_reason"] = state.converged_reason
                point["factorizations"] = solver.factorizations - before
            return points

        def deliver(points):
            rows[points["index"]] = points
            counter.advance(len(points))

        crew.share(units(len(omegas)), work, deliver, row)
    if not root:
        return None
    coefficient = rows["coefficient"].copy()  # in one piece: see pgran.solve.windows.SHORTEST
    return Projection(
        count_expected=modes.count_expected,
        count_certified=modes.count_certified,
        factorizations=int(rows["factorizations"].sum()),
        solve_seconds=time.perf_counter() - started,
        omega=omegas,
        mode_omega=modes.omega,
        coefficient=coefficient,
        dominant=_dominant(coefficient),
        error_bound=rows["field_bound"],
        converged_reason=rows["converged_reason"],
    )


def _dominant(coefficient):
    """Return the index of the largest coefficient at each frequency; -1 where there is none."""
    nw, nm = coefficient.shape
    return np.argmax(np.abs(coefficient), axis=1) if nm else np.full(nw, -1)


def _on_all_ranks(vectors, world):
    """Return rank 0's mode shapes, a row a mode, on every rank."""
    shape = world.bcast(vectors.shape if world.rank == 0 else None)
    if world.rank > 0:
        vectors = np.empty(shape)
    vectors = np.ascontiguousarray(vectors)
    world.Bcast(vectors)
    return vectors.reshape(shape[0], math.prod(shape[1:]))
