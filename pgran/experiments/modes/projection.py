"""Scene `projection`: the driven lattice in terms of its normal modes, over a sweep."""

import math
import time
from dataclasses import replace

import numpy as np

from pgran.arguments import shown
from pgran.driven import drive as driven
from pgran.driven.phase import fit_line
from pgran.driven.sweep import FrequencySweep
from pgran.errors import InputError
from pgran.experiments.modes.record import Projection
from pgran.experiments.modes.scene import WHICH, certificate, check_modes, chosen, find_modes
from pgran.medium.base import medium
from pgran.medium.units import check_frequency
from pgran.run.experiment import Scene
from pgran.run.frequencies import SWEEP, check_sweep, checked_frequencies, driving_frequencies
from pgran.run.interface import in_parallel
from pgran.run.keys import with_solver
from pgran.run.keywords import PROGRESS, call
from pgran.run.task import carry_out
from pgran.store.estimate import counted

ALL_MODES = 3600  # balls; of a larger lattice only the modes near each driving frequency
NEAR = 60  # so many


def check(values, given):
    """Raise where options contradict each other. Not collective."""
    check_sweep(values, given)
    check_modes(values, given)


def which_modes(options, balls, omegas):
    """Return which modes to project on, as `find_modes` takes it.

    Not collective.

    Parameters
    ----------
    options : pgran.run.options.Options
    balls : int
        Of the lattice: of a large one only modes near the drives are wanted, unless options say.
    omegas : numpy.ndarray, shape (nw,)
    """
    which = chosen(options)
    if not which and (options.modes_count or balls > ALL_MODES):
        which = {"targets": omegas, "count": options.modes_count or NEAR}
    return which


def summary(result):
    """Return in words what a run found. Not collective."""
    lattice, projection = result.medium, result.projection
    nm = projection.count_found
    yield (
        f"{counted(len(projection.omega), 'frequency')} on {counted(nm, 'mode')} in "
        f"{projection.solve_seconds:.2f} s, with "
        f"{counted(projection.factorizations, 'factorization')}"
    )
    yield certificate(projection)
    omega, modes, unit = projection.omega, projection.mode_omega, lattice.omega_mx
    inside = (omega > 0.1 * unit) & (omega < 0.9 * unit) & (projection.converged_reason > 0)
    if nm > 3:
        inside &= (omega >= modes[0]) & (omega <= modes[-1])
        slope, _ = fit_line(omega[inside], modes[projection.dominant[inside]])
        if np.isfinite(slope):
            yield f"the dominant mode follows the drive with slope {slope:.3f} (.1 to .9 omega_mx)"


def modes_chosen(which):
    """Return the arguments of `find_modes` that were handed in. Not collective."""
    if not isinstance(which, dict) or not which.keys() <= {"interval", "targets", "count"}:
        raise InputError(
            f"which: a dict of interval, or of targets and count is needed, not {shown(which)}"
        )
    return which


@in_parallel("project", lattice=medium, omegas=checked_frequencies, which=modes_chosen)
@with_solver
def project(
    lattice,
    omegas,
    crew=None,
    which=None,
    *,
    error_tolerance=driven.STEADY["error_tolerance"],
    error_floor=driven.STEADY["error_floor"],
    refresh_iterations=driven.STEADY["refresh_iterations"],
    progress=PROGRESS,
):
    """Project driven steady states on normal modes: c_i = sum_p A_p f_i(p) (paper: cidef).

    Collective. The modes are computed once; a field lives until it is projected. A coefficient is
    no more in error than the field, in the 2-norm.

    Parameters
    ----------
    crew : pgran.run.crew.Crew, optional
        All ranks unless given; of groups of one rank.
    which : dict, optional
        Which modes: arguments of `find_modes`; all by default.

    Returns
    -------
    pgran.results.Projection or None
        With a crew of the caller's None on all ranks but rank 0.
    """
    started = time.perf_counter()
    choices = {
        "error_tolerance": error_tolerance,
        "error_floor": error_floor,
        "refresh_iterations": refresh_iterations,
    }
    scaled, _ = lattice.in_own_unit()
    check_frequency(scaled, omegas[-1])  # before any work
    driven.check_driven(lattice, crew.world, omegas[0])
    modes = find_modes(lattice, crew, **(which or {}), shapes=True, progress=progress)
    vectors = _on_all_ranks(modes.vector if modes else None, crew.world)
    projection = carry_out(ProjectedSweep(lattice, omegas, vectors, choices), crew, progress)
    return projection and replace(
        projection,
        count_expected=modes.count_expected,
        count_certified=modes.count_certified,
        mode_omega=modes.omega,
        solve_seconds=time.perf_counter() - started,
    )


class ProjectedSweep(FrequencySweep):
    """The projection of each field on mode shapes.

    Parameters
    ----------
    lattice, omegas
        As in `project`.
    vectors : numpy.ndarray, shape (nm, balls)
        The shapes of the modes, a row a mode, orthonormal.
    choices : dict
        Keywords of `pgran.driven.steady.SteadySolver`.
    """

    def __init__(self, lattice, omegas, vectors, choices):
        """Say what a frequency's results travel in."""
        self.vectors, kept = vectors, [
            ("coefficient", complex, (len(vectors),)),
            ("field_bound", float),
            ("converged_reason", np.int64),
        ]  # fmt: skip
        nowhere = np.empty((0, len(lattice.shape)), dtype=np.int64)
        super().__init__(lattice, omegas, nowhere, kept, choices | {"whole_field": True})

    def keep(self, point, solver):
        """Project: c_i = sum over balls p of A_p f_i(p) (paper: cidef)."""
        field = solver.operators.layout.field(solver.field).ravel()
        point["coefficient"] = self.vectors @ field.real + 1j * (self.vectors @ field.imag)

    def collect(self, rows, seconds):
        """See `Task`; what belongs to the modes is added by `project`."""
        coefficient = rows["coefficient"].copy()  # in one piece, on which sums depend
        return Projection(
            count_expected=len(self.vectors),
            count_certified=False,
            factorizations=int(rows["factorizations"].sum()),
            solve_seconds=seconds,
            omega=self.omegas,
            mode_omega=np.full(len(self.vectors), np.nan),
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


def run(lattice, options, crew):
    """Return the projection; see `pgran.run.experiment.Scene`."""
    omegas = driving_frequencies(options, lattice)
    which = which_modes(options, lattice.balls, omegas)
    projection = call(project, options, crew, lattice, omegas, which=which)
    return projection and [projection]


SCENE = Scene(
    options=(
        *(*SWEEP, *WHICH),
        *(driven.STEADY["error_tolerance"], driven.STEADY["refresh_iterations"]),
    ),
    run=run,
    summary=summary,
    check=check,
)
