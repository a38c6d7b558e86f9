"""Scene `continuum`: the exact response of the homogeneous box, without PETSc."""

import contextlib

import numpy as np

from pgran.errors import InputError
from pgran.experiments.continuum.record import ContinuumResponse
from pgran.experiments.continuum.series import Continuum
from pgran.run.experiment import Scene
from pgran.run.frequencies import FREQUENCIES, check_sweep, checked_frequencies, driving_frequencies
from pgran.run.interface import in_parallel
from pgran.run.keywords import PROGRESS, call, option, options_of
from pgran.run.task import Task, carry_out

LONGEST_UNIT = 256  # frequencies


def check(values, given):
    """Raise where options contradict each other. Not collective."""
    check_sweep(values, given)
    if values["units_length"] is not None or values["units_time"] is not None:
        raise InputError("-units_length, -units_time: the box has its own, -continuum_size ...")


def summary(result):
    """Return in words what a run found. Not collective."""
    response = result.continuum
    yield (
        f"{len(response.omega)} frequencies, {len(response.resonance)} driven resonances up to "
        f"{response.omega[-1]:g}"
    )


@in_parallel("continuum", omegas=checked_frequencies)
def continuum(
    omegas,
    point=option((0.47, 0.52), "where the amplitude is taken", "length"),
    crew=None,
    *,
    size=option((1.0, 1.0), "extent of the box along x, y", "length", above=0),
    mass=option(1.0, "mass per area", above=0),
    stiffness=option(1.0, "K0", above=0),
    damping=option(0.003, "beta", low=0),
    progress=PROGRESS,
):
    """Evaluate the exact response of the homogeneous box over a sweep (paper: axysol, exactpl).

    Collective.

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
            # without damping 0 or pi
            phase=np.unwrap(np.angle(displacement)) if box.damping else np.angle(displacement.real),
            resonance=self.resonances,
        )


def run(medium, options, crew):
    """Return the response of the box; see `pgran.run.experiment.Scene`."""
    response = call(continuum, options, crew, driving_frequencies(options))
    return response and [response]


SCENE = Scene(
    options=(*options_of(continuum), *FREQUENCIES),
    run=run,
    summary=summary,
    check=check,
    on_medium=False,
)
