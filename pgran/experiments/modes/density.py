"""The density of modes without the modes: how many lie below each of some frequencies."""

import contextlib
import math
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from pgran.errors import InputError
from pgran.experiments.modes.density_options import BY_MOMENTS
from pgran.experiments.modes.record import Density
from pgran.medium.base import AXES, Medium, check_frequency, medium
from pgran.run.crew import Crew
from pgran.run.experiment import PROGRESS, Caution, in_parallel
from pgran.run.numbers import numbers
from pgran.run.task import Task, carry_out
from pgran.store.estimate import with_error
from pgran.store.record import columns_of, row_of
from pgran.store.si import SI

# In mean distances of eigenvalues: how far a count stays clear of them; the second where rounding
# is larger than the first, the others, down to MARGIN of |K|, where one is closer.
CLEARANCES = (0.01, 0.1, 1e-4, 1e-6, 1e-8, 1e-10)
MARGIN = 1e-11  # of |K|: how far a count is moved down at first where an eigenvalue is too close
SMOOTHED = 0.25  # of a bin: from where that may be more than its error
WALLED = 0.1  # of the resolution: where diffusion between walls makes it a tenth too small
ATTEMPTS = 40  # each four times as far down


def frequencies(options, lattice):
    """Return the frequencies to count at."""
    low, high = options.modes_omega_min, options.modes_omega_max
    if low is None:
        scaled, _ = lattice.undamped().in_own_unit()
        low, high = 0.0, math.sqrt(scaled.stiffness_norm / scaled.mass) or 1.0
    return np.linspace(low, high, options.modes_density)


@in_parallel(shares_lattice=True, lattice=medium, omegas=partial(numbers, "omegas"))
def count_modes(
    lattice: Medium,
    omegas: "ArrayLike",
    crew: Crew | None = None,
    *,
    method: str = BY_MOMENTS["method"],
    vectors: int = BY_MOMENTS["vectors"],
    moments: int | None = BY_MOMENTS["moments"],
    diffusivity: str = BY_MOMENTS["diffusivity"],
    progress: str = PROGRESS,
) -> Density | None:
    """Count the normal modes below each of some frequencies; no mode is computed.

    As many eigenvalues of K lie below m omega^2 as K - m omega^2 = L D L^T has negative entries in
    D (Sylvester's law of inertia).

    Collective. One rank counts at each frequency, on its own copy of the lattice.

    Parameters
    ----------
    omegas : array_like, shape (N,)
        Angular, increasing, two or more.

    Returns
    -------
    pgran.results.Density or None
        With a crew of the caller's None on all ranks but rank 0.

    Raises
    ------
    InputError
        If the frequencies do not increase, or are too high to compute with.

    Examples
    --------
    >>> pgran.count_modes(pgran.Lattice.random((6, 5), seed=1), [0.3, 0.6, 0.9]).count
    array([ 1, 14, 26])
    """
    # not >: NaN too
    if omegas.ndim != 1 or len(omegas) < 2 or not (omegas[0] >= 0 and np.all(np.diff(omegas) > 0)):
        raise InputError("omegas: two frequencies or more are needed, 0 or higher, that increase")
    check_frequency(lattice, omegas[-1])
    if method == "count":
        if diffusivity not in (None, "none"):
            raise InputError("-modes_density_diffusivity: take -modes_density_method moments")
        return carry_out(Counts(lattice, omegas), crew, progress)
    from pgran.driven.drive import TOGETHER
    from pgran.experiments.modes.density_moments import Traces

    if not lattice.constants.any():
        raise InputError("-modes_density_method moments: no spring is stiff; take count")
    axis = None if diffusivity == "none" else place_of(lattice, diffusivity)
    together = crew.together(lattice.size > TOGETHER)
    with together, Traces(lattice, omegas, crew.group, vectors, moments, axis) as traces:
        return carry_out(traces, crew, progress)


def place_of(lattice, axis):
    """Return the number of an axis along which balls have places, or raise an InputError."""
    number, there = AXES.index(axis), lattice.axes if lattice.is_grid else 0
    if not lattice.is_grid and lattice.position is not None:
        there = lattice.position.shape[1]
    if number >= there:
        places = f"take {' or '.join(AXES[:there])}" if there else "nor any, so leave it out"
        where = f"-modes_density_diffusivity {axis}"
        raise InputError(f"{where}: balls have no place along it; {places}")
    return number


class Counts(Task):
    """How many modes lie below some frequencies, one of them a unit; unstable ones below 0."""

    items = "frequencies"
    row = np.dtype(row_of(Density))

    def __init__(self, lattice, omegas):
        self.lattice, self.omegas = lattice, omegas
        self.scaled, _ = lattice.undamped().in_own_unit()
        self.at_zero = not lattice.semidefinite and omegas[0] > 0
        self.units = [*([0.0] if self.at_zero else []), *omegas.tolist()]

    @contextlib.contextmanager
    def open(self, group):
        """See `Task`."""
        from mpi4py import MPI

        from pgran.driven.counting import ModeCounter
        from pgran.driven.operators import Operators

        with (
            Operators(self.scaled, MPI.COMM_SELF) as own,
            ModeCounter(own.K, own.lattice) as counter,
        ):
            yield lambda omega: self._count(counter, omega)

    def _count(self, counter, omega):
        """Return the row of a frequency."""
        shift = self.scaled.mass * omega**2
        count, margin = count_below(counter, shift)
        rows = np.zeros(1, self.row)
        rows["certified"] = count is not None
        rows["count"] = -1 if count is None else count
        moved = (shift - margin) / self.scaled.mass  # of an unstable mode's omega below 0
        if margin:
            rows["margin"] = omega - math.copysign(math.sqrt(abs(moved)), moved)
        return rows

    def collect(self, rows, seconds):
        """See `Task`."""
        unstable = 0 if self.lattice.semidefinite else rows["count"][0]
        columns = columns_of(Density, rows[1:] if self.at_zero else rows)
        certified, omega, unit = columns["certified"], self.omegas, self.lattice.omega_mx
        balls = self.lattice.free_balls
        widths = np.diff(omega) / unit if unit > 0 else math.nan
        density = np.diff(columns["count"]) / (balls * widths)
        return Density(
            balls=balls,
            omega_mx=unit,
            solve_seconds=seconds,
            unstable=int(unstable),
            omega=omega,
            middle=0.5 * (omega[1:] + omega[:-1]),
            density=np.where(certified[1:] & certified[:-1], density, math.nan),
            **columns,
        )


def count_below(counter, shift):
    """Return how many eigenvalues lie below a shift, and by what margin less it was counted at.

    Where an eigenvalue is so close that it is open on which side it lies, the shift is moved down,
    below 0 where K may be indefinite: that eigenvalue, and those equal to it, are not counted. The
    count is certain for shift - margin, None if none is.
    """
    if shift <= 0 and counter.semidefinite:
        return 0, 0.0
    if shift > (1 + 1e-12) * counter.norm:  # which is rounded itself
        return counter.order, 0.0
    unit, margin = counter.norm / counter.order, MARGIN * counter.norm
    for part in CLEARANCES:
        count = counter.below(shift, part * unit) if part * unit > margin else None
        if count is not None:
            return count, 0.0
    for _ in range(ATTEMPTS):
        if shift <= margin and counter.semidefinite:
            return 0, shift
        count = counter.below(shift - margin, 0.5 * margin)
        if count is not None:
            return count, margin
        margin *= 4
    return None, margin


def summary(result):
    """Yield in words what a run found."""
    density, si = result.density, SI.of(result)
    low, high = density.omega[[0, -1]]
    first, last = density.count[[0, -1]]
    frequencies, took = len(density.omega), f"in {density.solve_seconds:.2f} s"
    if density.method == "moments":
        yield (
            f"modes below {frequencies} frequencies estimated by {density.moments} moments of "
            f"{density.vectors} random vectors {took}"
        )
        yield from _estimates(density, result.medium)
        first, last = (f"about {density.count[n]} +- {density.count_error[n]:.1g}" for n in (0, -1))
    else:
        yield f"modes counted below {frequencies} frequencies {took}"
    if density.failures:
        yield Caution(f"NOT CERTIFIED: {density.failures} of the counts")
    elif density.method != "moments":
        yield "all counts certified"
    moved = np.count_nonzero(density.margin)
    if moved:
        below = f"counted at most {density.margin.max():.1e} below these"
        yield f"a mode is too close to {moved} of the frequencies: {below}"
    if density.unstable and density.method == "moments":
        yield Caution(
            "pre-stress may make modes unstable, omega^2 < 0: -modes_density_method count says "
            "how many are"
        )
    elif density.unstable:
        number = density.unstable if density.unstable > 0 else "unknown"
        yield Caution(f"UNSTABLE: modes with omega^2 < 0, their number is {number}")
    first = f"modes below omega = {low:.6g}{si.say('Hz', low)}: {first}"
    yield f"{first}; below {high:.6g}{si.say('Hz', high)}: {last}"


def _estimates(density, medium):
    """Yield in words how good estimates are."""
    known = density.density > 0
    if not known.any():
        yield "no mode was seen between these frequencies"
        return
    error = np.median(density.density_error[known] / density.density[known])
    smoothed = np.median(density.resolution / np.diff(density.omega))
    words = f"steps smoothed by {smoothed:.2g} of a bin"
    yield f"standard error of a density {error:.1e} of it, {words} (medians)"
    if smoothed > SMOOTHED:
        yield Caution(f"{words}, of which no error tells: take more -modes_density_moments")
    if density.diffusivity is None:
        return
    known, axis = np.flatnonzero(density.diffuses), density.diffusivity_axis
    if not len(known):
        yield Caution(
            "no diffusivity is twice its error, of ten modes or more within the resolution: take "
            "more -modes_density_vectors, fewer -modes_density_moments, or more balls"
        )
    for n in known[:: max(len(known) - 1, 1)]:  # the ends
        found = with_error(density.diffusivity[n], density.diffusivity_error[n])
        yield (
            f"energy diffusivity along {axis} at omega = {density.middle[n]:.4g}: {found} "
            f"length^2 x frequency, in {medium.length}"
        )
    # between walls nothing gets further than their distance, which takes a time of L^2 / pi^2 d
    long = medium.shape[AXES.index(axis)] + 1 if medium.group == "lattice" else math.inf
    walled = density.diffusivity * (math.pi / long) ** 2 > WALLED * density.resolution
    if few := np.count_nonzero(walled[known]):
        yield Caution(
            f"{few} of {len(known)} diffusivities are too small, as walls are nearer than the "
            "resolution tells: take fewer -modes_density_moments, or more balls"
        )
