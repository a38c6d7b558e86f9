"""An accuracy study: a certified reference, and runs that are timed and compared with it."""

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pgran.errors import PgranError, is_foreseen
from pgran.experiments.accuracy import errors
from pgran.experiments.accuracy.errors import ENTRY, relative_bounds
from pgran.experiments.accuracy.record import Accuracy
from pgran.run.task import Task
from pgran.store.record import columns_of, row_of

log = logging.getLogger("pgran")


@dataclass(frozen=True)
class Study:
    """The experiment that is repeated.

    `solve` takes a crew and keywords and returns its result on rank 0; `read` returns the numbers
    of that result as an array of ENTRY. `exact` are the keywords for the reference, of which
    numbers count whose relative bounds are `certified` or less.
    """

    name: str
    solve: Callable
    read: Callable
    exact: dict
    certified: float


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
            for key, why in unused(configuration.keys).items():
                self._warn(f"-{key} of {configuration.solver} was not used: {why}")
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
                numbers = errors.matched(numbers, self.reference)
        good = numbers["good"]
        compared = good & self.reference["good"]
        missed = errors.relative_errors(numbers[compared], self.reference[compared])
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
            on_front=errors.front(*(measured[x] for x in ("seconds", "error_max", "failures"))),
            **measured,
        )
