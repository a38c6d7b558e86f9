"""The density of modes without the modes: how many lie below each of some frequencies."""

import contextlib
import math
import time
from functools import partial

import numpy as np

from pgran.errors import InputError
from pgran.experiments.modes.record import Density
from pgran.medium.base import medium
from pgran.medium.units import check_frequency
from pgran.run.experiment import Caution
from pgran.run.interface import in_parallel
from pgran.run.keys import with_solver
from pgran.run.keywords import PROGRESS
from pgran.run.numbers import numbers
from pgran.run.options import INTEGER, Option, alternatives
from pgran.run.task import Task, carry_out
from pgran.store.si import SI

DENSITY = Option(
    "modes_density", INTEGER, None,
    "no modes: count those below so many frequencies, from -modes_omega_min (0) to "
    "-modes_omega_max (above all modes)",
    low=2, high=10**6
)  # fmt: skip


def check(values, given):
    """Let counts stand for modes, or the other way round, whichever is asked for later.

    Not collective. Raises InputError where both are asked for at the same place.
    """
    if values.get("modes_density") is None:  # an accuracy study has no such option
        return
    alternatives(("modes_density",), ("modes_target", "modes_count"), values, given)
    if values["modes_density"] is not None and values["output_fields"]:
        fields = given["output_fields"]
        if fields.rank >= given["modes_density"].rank:
            raise InputError(
                f"-output_fields{fields.where}: -modes_density counts modes and computes no "
                "shapes; give one of them"
            )
        values["output_fields"] = False


def frequencies(options, lattice):
    """Return the frequencies to count at. Not collective."""
    low, high = options.modes_omega_min, options.modes_omega_max
    if low is None:
        scaled, _ = lattice.in_own_unit()
        low, high = 0.0, math.sqrt(scaled.stiffness_norm / scaled.mass) or 1.0
    return np.linspace(low, high, options.modes_density)


@in_parallel(lattice=medium, omegas=partial(numbers, "omegas"))
@with_solver
def count_modes(lattice, omegas, crew=None, *, progress=PROGRESS):
    """Count the normal modes below each of some frequencies; no mode is computed.

    Collective. Each frequency is counted at by one rank, on a copy of its own.

    Parameters
    ----------
    omegas : array_like, shape (N,)
        Angular, increasing, two or more.
    crew : pgran.run.crew.Crew, optional
        All ranks unless given; of groups of one rank.

    Returns
    -------
    pgran.results.Density or None
        With a crew of the caller's None on all ranks but rank 0.

    Raises
    ------
    InputError
        If the frequencies do not increase, or are too high to compute with.
    """
    # not >: NaN too
    if omegas.ndim != 1 or len(omegas) < 2 or not (omegas[0] >= 0 and np.all(np.diff(omegas) > 0)):
        raise InputError("omegas: two frequencies or more are needed, 0 or higher, that increase")
    started = time.perf_counter()
    check_frequency(lattice, omegas[-1])
    at = omegas if lattice.semidefinite or omegas[0] == 0 else np.append(0.0, omegas)
    found = carry_out(Counts(lattice, at), crew, progress)
    if found is None:
        return None
    unstable = 0 if lattice.semidefinite else _certain(found)[0]
    found = found[-len(omegas) :]
    known, count = found["certified"], _certain(found)
    widths = np.diff(omegas) / lattice.omega_mx if lattice.omega_mx > 0 else math.nan
    balls = lattice.free_balls
    density = np.where(known[1:] & known[:-1], np.diff(count) / (balls * widths), math.nan)
    return Density(
        balls=balls,
        omega_mx=lattice.omega_mx,
        solve_seconds=time.perf_counter() - started,
        unstable=int(unstable),
        omega=omegas,
        count=count,
        certified=known,
        margin=np.ascontiguousarray(found["margin"]),
        middle=0.5 * (omegas[1:] + omegas[:-1]),
        density=density,
    )


def _certain(found):
    """Return the counts of rows of `Counts`, -1 where one is not certain."""
    return np.where(found["certified"], found["count"], -1)


class Counts(Task):
    """How many modes lie below some frequencies.

    Parameters
    ----------
    lattice : pgran.medium.lattice.Lattice or pgran.medium.network.Network
    omegas : numpy.ndarray, shape (N,)
    """

    items = "frequencies"
    row = np.dtype([("count", int), ("certified", bool), ("margin", float)])

    def __init__(self, lattice, omegas):
        """A frequency is a unit."""
        self.lattice, _ = lattice.in_own_unit()
        self.units = omegas.tolist()

    @contextlib.contextmanager
    def open(self, group):
        """See `Task`."""
        from pgran.experiments.modes.staircase import count_below, counter_of

        mass = self.lattice.mass
        with counter_of(self.lattice) as counter:

            def work(omega):
                shift = mass * omega**2
                count, margin = count_below(counter, shift)
                rows = np.zeros(1, self.row)
                rows["certified"] = count is not None
                rows["count"] = count or 0
                moved = (shift - margin) / mass  # of an unstable mode's omega below 0
                if margin:
                    rows["margin"] = omega - math.copysign(math.sqrt(abs(moved)), moved)
                return rows

            yield work

    def length(self, unit):
        """See `Task`."""
        return 1

    def collect(self, rows, seconds):
        """See `Task`."""
        return rows


def summary(result):
    """Return in words what a run found. Not collective."""
    density, si = result.density, SI.of(result)
    yield f"modes counted below {len(density.omega)} frequencies in {density.solve_seconds:.2f} s"
    if density.failures:
        yield Caution(f"NOT CERTIFIED: {density.failures} of the counts")
    else:
        yield "all counts certified"
    moved = np.count_nonzero(density.margin)
    if moved:
        yield (
            f"modes too close to {moved} of the frequencies are not counted there; they are less "
            f"than {density.margin.max():.1e} below"
        )
    if density.unstable:
        number = density.unstable if density.unstable > 0 else "an unknown number of"
        yield Caution(f"UNSTABLE: {number} modes have omega^2 < 0")
    low, high = density.omega[[0, -1]]
    yield (
        f"modes below omega = {low:.6g}{si.say('Hz', low)}: {density.count[0]}; below "
        f"{high:.6g}{si.say('Hz', high)}: {density.count[-1]}"
    )
