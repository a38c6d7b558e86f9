"""Scene `continuum`: the exact response of the homogeneous box, without PETSc."""

import numpy as np
from numpy.typing import ArrayLike

from pgran.errors import InputError
from pgran.experiments.continuum.record import ContinuumResponse
from pgran.experiments.continuum.series import Continuum
from pgran.run.experiment import PROGRESS, Scene, in_parallel, option, options_of, run_of
from pgran.run.frequencies import FREQUENCIES, check_sweep
from pgran.run.task import Task, carry_out
from pgran.store.record import columns_of, row_of

LONGEST_UNIT = 256  # frequencies
POSITIVE = {"low": 1e-100, "high": 1e100}  # no square of it overflows or underflows


def check(values, given):
    """Raise where options contradict each other."""
    check_sweep(values, given)
    if values["units_length"] is not None or values["units_time"] is not None:
        raise InputError("-units_length, -units_time: the box has units by -continuum_size ...")


def subject(options):
    """Yield in words what the options describe."""
    yield f"a homogeneous box of {' x '.join(f'{length:g}' for length in options.continuum_size)}"
    yield f"beta {options.continuum_damping:g}"


def summary(result):
    """Return in words what a run found."""
    omega, driven = result.continuum.omega, len(result.continuum.resonance)
    yield f"{len(omega)} frequencies, {driven} driven resonances up to {omega[-1]:g}"


@in_parallel("continuum", omegas=FREQUENCIES)
def continuum(
    omegas: "ArrayLike",
    point=option((0.47, 0.52), "where the amplitude is taken", "length"),
    crew=None,
    *,
    size=option((1.0, 1.0), "extent of the box along x, y", "length", **POSITIVE),
    mass=option(1.0, "mass per area", **POSITIVE),
    stiffness=option(1.0, "stiffness K0", **POSITIVE),
    damping=option(0.003, "damping beta", low=0, high=1e100),
    progress=PROGRESS,
) -> ContinuumResponse:
    """Evaluate the exact response of the homogeneous box over a sweep (paper: axysol, exactpl).

    The wall x = Lx is shaken, the others are at rest. With z = m omega^2 / (K0 + i omega beta) and
    gamma^2 = (nu pi / Ly)^2 - z,

        A(x, y) = 4/pi sum_(nu odd) sin(nu pi y / Ly) / nu  sinh(gamma x) / sinh(gamma Lx)

    Examples
    --------
    >>> found = pgran.continuum([0.001, 3.0], point=(0.5, 0.5), damping=0.0)
    >>> found.amplitude.round(3)  # at rest, the mean of the four walls
    array([0.25 , 0.568])
    """
    box = Continuum(size, mass, stiffness, damping)
    return carry_out(Series(box, omegas, point), crew, progress)


class Series(Task):
    """The exact series at a point of a box, some frequencies at a time."""

    items = "frequencies"
    row = np.dtype(row_of(ContinuumResponse))

    def __init__(self, box, omegas, point):
        self.box, self.omegas, self.point = box, omegas, point
        self.resonances = box.resonances(omegas[-1])
        numbers = range(len(omegas))
        self.units = [numbers[i : i + LONGEST_UNIT] for i in numbers[::LONGEST_UNIT]]

    def work(self, unit, group):
        """See `Task`."""
        rows = np.zeros(len(unit), self.row)
        rows["displacement"] = self.box.response(self.omegas[unit], self.point)
        return rows

    def collect(self, rows, seconds):
        """See `Task`."""
        displacement = rows["displacement"]
        # without damping 0 or pi
        phase = np.angle(displacement if self.box.damping else displacement.real)
        return ContinuumResponse(
            point=self.point,
            **vars(self.box),
            omega=self.omegas,
            amplitude=np.abs(displacement),
            phase=np.unwrap(phase) if self.box.damping else phase,
            resonance=self.resonances,
            **columns_of(ContinuumResponse, rows),
        )


SCENE = Scene(options_of(continuum), run_of(continuum), summary, check, False, subject=subject)
