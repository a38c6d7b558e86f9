"""An accuracy study: a certified reference, and runs that are timed and compared with it."""

import time
from dataclasses import dataclass

import numpy as np

from pgran.catalogue import EXPERIMENTS
from pgran.errors import PgranError, is_foreseen, log
from pgran.experiments.accuracy.record import Accuracy
from pgran.experiments.modes.shapes import RESIDUAL
from pgran.run.experiment import call
from pgran.run.task import Task
from pgran.store.record import columns_of, row_of

# A number of an experiment, a bound of its absolute error, what errors are relative to, and whether
# the number is as accurate as was asked for.
ENTRY = np.dtype([("value", complex), ("bound", float), ("size", float), ("good", bool)])
REFERENCE = 1e-10  # what the reference of driven amplitudes asks for, or a tenth of the smallest
MODES_REFERENCE = 1e-6  # how well a mode must be known to be compared with


class Study:
    """The experiment that is repeated, of the options' `-accuracy_of`. Collective.

    `exact` are the keywords for the reference, of which numbers count whose relative bounds are
    `certified` or less.
    """

    def __init__(self, options, lattice, world):
        self.name, self.options, self.lattice = options.accuracy_of, options, lattice
        self.function = EXPERIMENTS[self.name].function
        self.reader, self.fixed, self.exact = REPEATED[self.name]
        self.certified = 0.1 * min(options.accuracy_tolerances)
        if self.name == "modes":
            self.certified = MODES_REFERENCE
        else:
            self.exact = self.exact | {"error_tolerance": min(REFERENCE, self.certified)}
        if self.name == "pulse":  # the file of a wall is read once
            wall = self.function.declared["wall"].of_run(options, world, lattice)
            self.fixed = self.fixed | {"wall": wall}

    def solve(self, crew, **choices):
        """Return the result on rank 0, None on the others. Collective."""
        choices = self.fixed | choices
        return call(self.function, self.options, crew, self.lattice, progress="none", **choices)

    def read(self, result):
        """Return the numbers of a result, an array of ENTRY."""
        return self.reader(result, self.lattice)


@dataclass(frozen=True)
class Configuration:
    """A solver and what is asked of it: keywords of `Study.solve`, and PETSc's keys.

    Its text is part of a unit, by which a journal tells one study from another.
    """

    solver: str
    tolerance: float
    choices: dict
    keys: dict

    @property
    def label(self):
        """What to call it."""
        return f"{self.solver} {self.tolerance:g}"


class Reference(Task):
    """The experiment once, as exactly as it can be had.

    `workers`, an AgreeingCrew, shares out the work of a run: all ranks work on a unit together.
    """

    items = "runs"
    row = ENTRY  # how many there are is not known before

    def __init__(self, study, workers):
        self.study, self.workers, self.units = study, workers, [[study.exact]]

    def work(self, unit, group):
        """See `Task`."""
        result = self.study.solve(self.workers, **unit[0])
        return self.study.read(result) if result else None

    def collect(self, rows, seconds):
        """Return the numbers; those are good whose relative bounds are small enough."""
        reference, allowed = rows.copy(), self.study.certified
        reference["good"] = relative_bounds(reference) <= allowed
        good = np.count_nonzero(reference["good"])
        if good == 0:
            raise PgranError(
                f"no reference to compare with: none of {len(reference)} numbers has an error "
                f"certified below {allowed:g}; change its solver keys or raise -accuracy_tolerances"
            )
        if good < len(reference):
            log.warning(
                "%d of %d numbers are not compared: the reference's own error is not certified to "
                "be below %g there", len(reference) - good, len(reference), allowed,
            )  # fmt: skip
        return reference


class Comparison(Task):
    """The experiment by every configuration in turn, repeated, each compared with the reference.

    The reference, an array of ENTRY, is on rank 0 only; `workers` are as of `Reference`.
    """

    items = "runs"
    row = np.dtype(row_of(Accuracy))

    def __init__(self, study, configurations, repeats, reference, workers):
        self.study, self.configurations, self.repeats = study, configurations, repeats
        self.reference, self.workers = reference, workers
        self.units = [[configuration] for _ in range(repeats) for configuration in configurations]
        self._broken, self._warned = set(), set()

    def work(self, unit, group):
        """See `Task`."""
        (configuration,) = unit
        result, seconds = None, np.nan
        if configuration.label not in self._broken:
            try:
                result, seconds = self._timed(configuration)
            except Exception as error:  # on all ranks alike
                if not is_foreseen(error):
                    raise
                self._broken.add(configuration.label)
                reason = str(error).splitlines()[-1]
                self._warn(f"{configuration.solver} does not work: {reason}")
        return self._judged(result, seconds) if group.rank == 0 else None

    def _timed(self, configuration):
        """Return the result of a run, and how long the slowest rank took. Collective."""
        from mpi4py import MPI

        from pgran.run.petsc import holding, unused

        world = self.workers.world
        with holding(configuration.keys):
            world.Barrier()
            started = time.perf_counter()
            result = self.study.solve(self.workers, **configuration.choices)
            seconds = world.allreduce(time.perf_counter() - started, MPI.MAX)
            for key in unused(configuration.keys):
                self._warn(f"-{key} of {configuration.solver} was not used")
        return result, seconds

    def _warn(self, line):
        """Warn once, on rank 0."""
        if self.workers.world.rank == 0 and line not in self._warned:
            self._warned.add(line)
            log.warning(line)

    def _judged(self, result, seconds):
        """Return a run's row; numbers that failed, or have no result, are in no error."""
        numbers = np.zeros(len(self.reference), ENTRY)
        if result is not None:
            numbers = self.study.read(result)
            if self.study.name == "modes":
                numbers = matched(numbers, self.reference)
        good = numbers["good"]
        compared = good & self.reference["good"]
        missed = relative_errors(numbers[compared], self.reference[compared])
        bounds = relative_bounds(numbers[good])
        row = np.zeros(1, self.row)
        row["seconds"], row["failures"] = seconds, np.count_nonzero(~good)
        row["error_max"] = missed.max() if len(missed) else np.nan
        row["error_median"] = np.median(missed) if len(missed) else np.nan
        row["error_bound_max"] = bounds.max() if len(bounds) else np.nan
        row["iterations"] = result.iterations.sum() if hasattr(result, "iterations") else -1
        return row

    def collect(self, rows, seconds):
        """See `Task`."""
        rows, configurations = rows.reshape(self.repeats, -1), self.configurations
        times, measured = rows["seconds"], columns_of(Accuracy, rows[0])
        measured["seconds"] = np.median(times, axis=0)  # all else is the same in all repeats
        compared = self.reference[self.reference["good"]]
        return Accuracy(
            experiment=self.study.name,
            repeats=self.repeats,
            values=len(self.reference),
            compared=len(compared),
            reference_bound=float(relative_bounds(compared).max()),
            label=np.array([c.label for c in configurations]),
            solver=np.array([c.solver for c in configurations]),
            tolerance=np.array([c.tolerance for c in configurations]),
            seconds_min=times.min(axis=0),
            seconds_max=times.max(axis=0),
            on_front=front(*(measured[x] for x in ("seconds", "error_max", "failures"))),
            **measured,
        )


def entries(values, bounds, good, sizes=None):
    """Return numbers in one flat array of ENTRY; bounds, good and sizes broadcast to the values.

    Errors are relative to the numbers themselves unless sizes are given.
    """
    numbers = np.zeros(np.size(values), ENTRY)
    sizes = np.abs(values) if sizes is None else sizes
    for name, column in zip(ENTRY.names, (values, bounds, sizes, good), strict=True):
        numbers[name] = np.broadcast_to(column, np.shape(values)).ravel()
    return numbers


def read_response(response, lattice):
    """Return the amplitudes of a sweep."""
    good = response.converged_reason[:, None] > 0
    return entries(response.displacement, response.error_bound, good)


def read_relaxation(relaxation, lattice):
    """Return the amplitudes of a relaxation, which are NaN where they miss the tolerance."""
    amplitudes = relaxation.displacement
    return entries(amplitudes, relaxation.error_bound, np.isfinite(amplitudes))


def read_pulse(signals, lattice):
    """Return the displacements of a pulse, relative to the largest of each ball's signal."""
    largest = np.abs(signals.displacement).max(axis=0)
    good = signals.error.max(axis=0) <= signals.tolerance * largest
    return entries(signals.displacement, signals.error, good, largest)


def read_modes(modes, lattice):
    """Return the frequencies of accurate modes, and zeros that are not good for missing ones."""
    accurate = modes.residual <= RESIDUAL
    omega = modes.omega[accurate]
    numbers = entries(omega, mode_bounds(lattice, omega, modes.residual[accurate]), True)
    missing = np.zeros(max(modes.count_expected - len(omega), 0), ENTRY)
    return np.concatenate([numbers, missing])


# Of each experiment what reads its numbers, keywords of all runs, and those of the reference alone.
REPEATED = {
    "response": (read_response, {"resolve": 0.0, "error_floor": 0.0}, {"method": "points"}),
    "modes": (read_modes, {}, {}),
    "relaxation": (read_relaxation, {"error_floor": 0.0}, {"method": "direct"}),
    "pulse": (read_pulse, {}, {"method": "laplace"}),
}


def mode_bounds(lattice, omega, residual):
    """Return bounds of the errors of modes' frequencies, by their residuals, in units of |K|.

    K is symmetric, so a residual |K f - lambda f| of a unit vector is no smaller than the distance
    of lambda = m omega^2 from an eigenvalue.
    """
    missed = (residual + lattice.rounding) * lattice.stiffness_norm / lattice.mass
    # |omega - omega'| (omega + omega') = |omega^2 - omega'^2| <= missed
    with np.errstate(divide="ignore"):
        return np.minimum(missed / omega, np.sqrt(missed))


def relative_bounds(numbers):
    """Return the bound of each number's relative error, inf for none."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = numbers["bound"] / numbers["size"]
    return np.where(np.isfinite(ratio), ratio, np.inf)


def relative_errors(numbers, reference):
    """Return the relative error of each number, at least the bound of the reference's own error."""
    difference = np.abs(numbers["value"] - reference["value"])
    return np.maximum(difference, reference["bound"]) / reference["size"]


def matched(modes, reference):
    """Return modes in the places of the reference's; where one is missing, it is not good.

    Both ascend. Two can be the same mode if they are no further apart than their bounds allow.
    """
    placed, place = np.zeros(len(reference), ENTRY), 0
    for mode in modes[modes["good"]]:
        allowed = mode["bound"] + reference["bound"]
        distance = (reference["value"] - mode["value"]).real
        while place < len(reference) and distance[place] < -allowed[place]:
            place += 1  # the mode at this place is missing
        if place < len(reference) and distance[place] <= allowed[place]:
            placed[place] = mode
            place += 1
    return placed


def front(seconds, error, failures):
    """Return which of n configurations no other one beats, of those without failures.

    One beats another if it is as fast and as accurate, and better in one of both.
    """
    eligible = (failures == 0) & np.isfinite(error)
    # [i, j]: whether i beats j
    faster, closer = seconds[:, None] < seconds, error[:, None] < error
    beats = (faster & (error[:, None] <= error)) | (closer & (seconds[:, None] <= seconds))
    return eligible & ~np.any(beats[eligible], axis=0)
