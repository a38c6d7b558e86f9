"""Scene `projection`: the driven lattice in terms of its normal modes, over a sweep."""

import numpy as np
from numpy.typing import ArrayLike

from pgran.arguments import shown
from pgran.driven import drive as driven
from pgran.driven.amplitudes import fit_line
from pgran.driven.drive import FrequencySweep
from pgran.errors import InputError
from pgran.experiments.modes.record import Projection
from pgran.experiments.modes.scene import SITES, certificate, check_modes, find_modes
from pgran.medium.base import Medium, check_frequency, medium
from pgran.run.crew import Crew
from pgran.run.experiment import PROGRESS, Scene, call, in_parallel, options_of
from pgran.run.frequencies import SWEEP, check_sweep, checked_frequencies, driving_frequencies
from pgran.run.task import carry_out
from pgran.store.estimate import counted
from pgran.store.record import columns_of, row_of

ALL_MODES = 3600  # balls; of a larger lattice only the modes near each driving frequency
NEAR = 60  # so many


def check(values, given):
    """Raise where options contradict each other."""
    check_sweep(values, given)
    check_modes(values, given)


def which_modes(options, balls, omegas):
    """Return which modes `find_modes` is to find: of a large lattice those near the drives."""
    if options.modes_omega_min is not None:
        return {"interval": (options.modes_omega_min, options.modes_omega_max)}
    count = options.modes_count or (NEAR if balls > ALL_MODES else None)
    return {"targets": options.modes_target or omegas, "count": count} if count else {}


def _which(which):
    """Return the arguments of `find_modes` that were handed in, or raise an InputError."""
    if not isinstance(which, dict) or not which.keys() <= {"interval", "targets", "count"}:
        raise InputError(
            f"which: a dict of interval, or of targets and count is needed, not {shown(which)}"
        )
    return which


@in_parallel("project", lattice=medium, omegas=checked_frequencies, which=_which)
def project(
    lattice: Medium,
    omegas: "ArrayLike",
    crew: Crew | None = None,
    which: dict | None = None,
    *,
    method: str = find_modes.declared["method"],
    error_tolerance: float = driven.STEADY["error_tolerance"],
    error_floor: float = driven.STEADY["error_floor"],
    refresh_iterations: int = driven.STEADY["refresh_iterations"],
    progress: str = PROGRESS,
) -> Projection | None:
    """Project driven steady states on normal modes: c_i = sum_p A_p f_i(p) (paper: cidef).

    Collective. The modes are computed once; fields are not kept. The error of a coefficient is at
    most that of the field, in the 2-norm.

    Parameters
    ----------
    which : dict, optional
        Which modes: arguments of `find_modes`; all by default.

    Returns
    -------
    pgran.results.Projection or None
        With a crew of the caller's None on all ranks but rank 0.

    Examples
    --------
    >>> found = pgran.project(pgran.Lattice.random((6, 5), seed=1), [0.3, 0.6])
    >>> found.mode_omega[found.dominant].round(3)  # the drive moves a mode of its frequency
    array([0.306, 0.599])
    """
    scaled, _ = lattice.in_own_unit()
    check_frequency(scaled, omegas[-1])  # before any work
    driven.check_driven(lattice, crew.world, omegas[0])
    modes = find_modes(
        lattice, crew, **(which or {}), method=method, shapes=True, progress=progress
    )
    choices = driven.steady(error_tolerance, error_floor, refresh_iterations)
    vectors = _on_all_ranks(modes and modes.vector, crew.world)
    return carry_out(ProjectedSweep(lattice, omegas, modes, vectors, choices), crew, progress)


class ProjectedSweep(FrequencySweep):
    """The projection of each field on mode shapes: `vectors`, orthonormal, shape (nm, balls).

    `modes` is their record, on rank 0.
    """

    def __init__(self, lattice, omegas, modes, vectors, choices):
        self.modes, self.vectors = modes, vectors
        columns = row_of(Projection, mode_omega=(len(vectors),))
        nowhere = np.empty((0, len(lattice.shape)), dtype=np.int64)
        choices = choices | {"whole_field": True}
        super().__init__(lattice, omegas, nowhere, [*columns, ("field_bound", float)], choices)

    def keep(self, point, solver):
        """Project: c_i = sum over balls p of A_p f_i(p) (paper: cidef)."""
        field = solver.operators.layout.field(solver.field).ravel()
        point["coefficient"] = self.vectors @ field.real + 1j * (self.vectors @ field.imag)

    def collect(self, rows, seconds):
        """See `Task`."""
        columns = columns_of(Projection, rows)
        size = np.abs(columns["coefficient"])
        return Projection(
            count_expected=self.modes.count_expected,
            count_certified=self.modes.count_certified,
            factorizations=int(rows["factorizations"].sum()),
            solve_seconds=self.modes.solve_seconds + seconds,
            omega=self.omegas,
            mode_omega=self.modes.omega,
            mode_omega_bound=self.modes.omega_bound,
            dominant=size.argmax(axis=1) if size.shape[1] else np.full(len(rows), -1),
            error_bound=rows["field_bound"],
            **columns,
        )


def _on_all_ranks(vectors, world):
    """Return rank 0's mode shapes, a row a mode, on every rank. Collective."""
    shape = world.bcast(vectors.shape if world.rank == 0 else None)
    vectors = np.ascontiguousarray(vectors) if world.rank == 0 else np.empty(shape)
    world.Bcast(vectors)
    return vectors.reshape(shape[0], np.prod(shape[1:], dtype=int))


def run(lattice, options, crew):
    """Return the projection; see `pgran.run.experiment.Scene`."""
    omegas = driving_frequencies(options, lattice)
    which = which_modes(options, lattice.size, omegas)
    projection = call(project, options, crew, lattice, omegas, which=which)
    return projection and [projection]


def summary(result):
    """Yield in words what a run found."""
    lattice, projection = result.medium, result.projection
    nm, number = projection.count_found, counted(len(projection.omega), "frequency")
    factored = counted(projection.factorizations, "factorization")
    yield f"{number} on {counted(nm, 'mode')} in {projection.solve_seconds:.2f} s, with {factored}"
    yield certificate(projection)
    omega, modes, unit = projection.omega, projection.mode_omega, lattice.omega_mx
    inside = (omega > 0.1 * unit) & (omega < 0.9 * unit) & (projection.converged_reason > 0)
    if nm > 3:
        inside &= (omega >= modes[0]) & (omega <= modes[-1])
        slope, _ = fit_line(omega[inside], modes[projection.dominant[inside]])
        if np.isfinite(slope):
            yield f"the dominant mode follows the drive with slope {slope:.3f} (.1 to .9 omega_mx)"


ALONE = [find_modes.declared[name] for name in ("shapes", "damped", "certificate")]
OPTIONS = (
    *SWEEP.options,
    *options_of(find_modes, without=[SITES, *ALONE]),
    *(driven.STEADY["error_tolerance"], driven.STEADY["refresh_iterations"]),
)
SCENE = Scene(OPTIONS, run, summary, check)
