"""Scene `continuum`: the exact response of the homogeneous box, without PETSc."""

import contextlib

import numpy as np

from pgran.driven.phase import phase_of_sign
from pgran.errors import InputError
from pgran.experiments.continuum.record import ContinuumResponse
from pgran.experiments.continuum.series import Continuum
from pgran.run.experiment import Scene
from pgran.run.frequencies import FREQUENCIES, check_sweep, checked_frequencies, driving_frequencies
from pgran.run.interface import in_parallel
from pgran.run.options import REAL, REALS, Option, checks
from pgran.run.task import Task, carry_out

CONTINUUM = (
    Option("continuum_point", REALS, (0.47, 0.52), "where the amplitude is taken", "length"),
    Option("continuum_size", REALS, (1.0, 1.0), "extent of the box along x, y", "length", above=0),
    Option("continuum_mass", REAL, 1.0, "mass per area", above=0),
    Option("continuum_stiffness", REAL, 1.0, "K0", above=0),
    Option("continuum_damping", REAL, 0.003, "beta", low=0),
)
LONGEST_UNIT = 256  # frequencies


def check(values, given):
    """Raise where options contradict each other. Not collective."""
    check_sweep(values, given)
    if values["units_length"] is not None or values["units_time"] is not None:
        raise InputError("-units_length, -units_time: the box has its own, -continuum_size ...")


def run(options, world, crew):
    """Return the response of the box on rank 0; None on the others.

    Collective. Parameters are those of `pgran.run.experiment.Scene`.
    """
    with crew(1) as workers:
        response = continuum(
            driving_frequencies(options),
            options.continuum_point,
            workers,
            size=options.continuum_size,
            mass=options.continuum_mass,
            stiffness=options.continuum_stiffness,
            damping=options.continuum_damping,
            progress=options.output_progress,
        )
    return response and [response]


def summary(result):
    """Return in words what a run found. Not collective."""
    response = result.continuum
    yield (
        f"{len(response.omega)} frequencies, {len(response.resonance)} driven resonances up to "
        f"{response.omega[-1]:g}"
    )


@in_parallel(omegas=checked_frequencies, **checks(CONTINUUM, "continuum_"))
def continuum(
    omegas,
    point,
    crew=None,
    *,
    size=(1.0, 1.0),
    mass=1.0,
    stiffness=1.0,
    damping=0.003,
    progress="none",
):
    """Evaluate the exact response of the homogeneous box over a sweep (paper: axysol, exactpl).

    Collective.

    Parameters
    ----------
    omegas : array_like of float, shape (nw,)
        Driving frequencies, angular, increasing.
    point : tuple of float
        x and y in the box.
    crew : pgran.run.crew.Crew, optional
        All ranks unless given.
    size, mass, stiffness, damping
        See `series.Continuum`.
    progress : str
        Style of `pgran.run.progress.Progress`.

    Returns
    -------
    pgran.results.ContinuumResponse or None
        With a crew of the caller's None on all ranks but rank 0.

    Raises
    ------
    InputError
        If the point lies outside the box, or a frequency is too high.
    """
    box = Continuum(size, mass, stiffness, damping)
    return carry_out(Series(box, omegas, point), crew, progress)


class Series(Task):
    """The exact series, some frequencies at a time.

    Parameters
    ----------
    box : pgran.experiments.continuum.series.Continuum
    omegas : numpy.ndarray, shape (nw,)
    point : tuple of float
    """

    items = "frequencies"
    row = np.dtype([("displacement", complex)])

    def __init__(self, box, omegas, point):
        """Cut the sweep."""
        self.box, self.omegas, self.point = box, omegas, point
        self.resonances = box.resonances(omegas[-1])
        self.units = [
            range(i, min(i + LONGEST_UNIT, len(omegas)))
            for i in range(0, len(omegas), LONGEST_UNIT)
        ]

    @contextlib.contextmanager
    def open(self, group):
        """See `Task`."""

        def work(unit):
            rows = np.zeros(len(unit), self.row)
            rows["displacement"] = self.box.response(self.omegas[unit], self.point)
            return rows

        yield work

    def collect(self, rows, seconds):
        """See `Task`."""
        displacement, box = rows["displacement"], self.box
        return ContinuumResponse(
            point=tuple(self.point),
            size=box.size,
            mass=box.mass,
            stiffness=box.stiffness,
            damping=box.damping,
            omega=self.omegas,
            displacement=displacement,
            amplitude=np.abs(displacement),
            phase=(
                np.unwrap(np.angle(displacement)) if box.damping else phase_of_sign(displacement)
            ),
            resonance=self.resonances,
        )


SCENE = Scene(
    options=(*CONTINUUM, *FREQUENCIES),
    run=run,
    summary=summary,
    check=check,
    needs_petsc=False,
)
