"""What an accuracy study is made of: a reference, and runs that are timed and compared with it."""

import contextlib
import logging
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pgran.errors import PgranError, is_foreseen
from pgran.experiments.accuracy.errors import (
    ENTRY,
    front,
    matched,
    relative_bounds,
    relative_errors,
)
from pgran.experiments.accuracy.record import Accuracy
from pgran.run.task import Task

log = logging.getLogger("pgran")


@dataclass(frozen=True)
class Study:
    """The experiment that is repeated.

    `solve` takes a crew and keywords and returns its result on rank 0; `read` returns the numbers
    of that result as an array of ENTRY.
    """

    name: str
    solve: Callable
    read: Callable
    exact: dict  # keywords for the reference
    certified: float  # relative bound of the reference's numbers that others are compared with


@dataclass(frozen=True)
class Configuration:
    """A solver and what is asked of it."""

    solver: str
    tolerance: float
    choices: dict  # keywords of `Study.solve`
    keys: dict  # for PETSc's option database

    @property
    def label(self):
        """What to call it."""
        return f"{self.solver} {self.tolerance:g}"


class Reference(Task):
    """The experiment once, as exactly as it can be had.

    Parameters
    ----------
    study : Study
    workers : AgreeingCrew
        What shares out the work of a run; all its ranks work on a unit together.
    """

    items = "runs"
    row = ENTRY

    def __init__(self, study, workers):
        """Plan one run."""
        self.study, self.workers, self.units = study, workers, [study.exact]

    @contextlib.contextmanager
    def open(self, group):
        """See `Task`."""

        def work(choices):
            found = self.study.solve(self.workers, **choices)
            return self.study.read(found) if found else None

        yield work

    def length(self, unit):
        """See `Task`; how many numbers there are is not known before."""
        return 1

    def collect(self, rows, seconds):
        """Return the numbers; those are good whose relative error bounds are small enough.

        Raises
        ------
        PgranError
            If none is.
        """
        reference, allowed = rows.copy(), self.study.certified
        reference["good"] = relative_bounds(reference) <= allowed
        good = np.count_nonzero(reference["good"])
        if good == 0:
            raise PgranError(
                f"no reference to compare with: of its {len(reference)} numbers none has an error "
                f"certified to be below {allowed:g}; the experiment's own solver keys, or larger "
                "-accuracy_tolerances, may help"
            )
        if good < len(reference):
            log.warning(
                "%d of %d numbers are not compared: the reference's own error is not certified to "
                "be below %g there", len(reference) - good, len(reference), allowed,
            )  # fmt: skip
        return reference


class Comparison(Task):
    """The experiment by every configuration in turn, repeated, each compared with the reference.

    Parameters
    ----------
    study : Study
    configurations : sequence of Configuration
    repeats : int
    reference : numpy.ndarray of pgran.experiments.accuracy.errors.ENTRY, or None
        On rank 0.
    workers : AgreeingCrew
        As of `Reference`.
    """

    items = "runs"
    row = np.dtype(
        [(name, float) for name in ("seconds", "error_max", "error_median", "error_bound_max")]
        + [(name, np.int64) for name in ("iterations", "failures")]
    )

    def __init__(self, study, configurations, repeats, reference, workers):
        """Plan all runs."""
        self.study, self.configurations, self.repeats = study, configurations, repeats
        self.reference, self.workers = reference, workers
        # With the configuration itself, by which a journal tells one study from another.
        self.units = [
            (repeat, *pair) for repeat in range(repeats) for pair in enumerate(configurations)
        ]
        self._broken, self._said = set(), set()

    @contextlib.contextmanager
    def open(self, group):
        """See `Task`."""

        def work(unit):
            _, number, configuration = unit
            result, seconds = None, np.nan
            if number not in self._broken:
                try:
                    result, seconds = _timed(self.study, configuration, self.workers, self.say)
                except Exception as error:  # on all ranks alike
                    if not is_foreseen(error):
                        raise
                    self._broken.add(number)
                    reason = str(error).splitlines()[-1]
                    self.say(f"{configuration.solver} does not work: {reason}")
            return self.judged(result, seconds) if group.rank == 0 else None

        yield work

    def say(self, line):
        """Warn once, on rank 0."""
        if self.workers.world.rank == 0 and line not in self._said:
            self._said.add(line)
            log.warning(line)

    def length(self, unit):
        """See `Task`."""
        return 1

    def judged(self, result, seconds):
        """Return a run's row; a run that did not work has no result. Not collective.

        Numbers that failed count as failures, and in no error.
        """
        found = np.zeros(len(self.reference), ENTRY)
        if result is not None:
            found = self.study.read(result)
            if self.study.name == "modes":
                found = matched(found, self.reference)
        good = found["good"]
        bounds = relative_bounds(found[good])
        compared = good & self.reference["good"]
        errors = relative_errors(found[compared], self.reference[compared])
        row = np.zeros(1, self.row)
        row["seconds"], row["failures"] = seconds, np.count_nonzero(~good)
        row["error_max"] = errors.max() if len(errors) else np.nan
        row["error_median"] = np.median(errors) if len(errors) else np.nan
        row["error_bound_max"] = bounds.max() if len(bounds) else np.nan
        row["iterations"] = result.iterations.sum() if hasattr(result, "iterations") else -1
        return row

    def collect(self, rows, seconds):
        """See `Task`."""
        rows, configurations = rows.reshape(self.repeats, -1), self.configurations
        times, first = rows["seconds"], rows[0]  # what is not time is the same in all repeats
        compared = self.reference[self.reference["good"]]
        median = np.median(times, axis=0)
        return Accuracy(
            experiment=self.study.name,
            repeats=self.repeats,
            values=len(self.reference),
            compared=len(compared),
            reference_bound=float(relative_bounds(compared).max()),
            label=np.array([c.label for c in configurations]),
            solver=np.array([c.solver for c in configurations]),
            tolerance=np.array([c.tolerance for c in configurations]),
            seconds=median,
            seconds_min=times.min(axis=0),
            seconds_max=times.max(axis=0),
            **{name: first[name] for name in self.row.names if name != "seconds"},
            on_front=front(median, first["error_max"], first["failures"]),
        )


def _timed(study, configuration, crew, say):
    """Return the result of a run, and how long the slowest rank took.

    Collective. Solver keys that nothing used are said.
    """
    from mpi4py import MPI

    from pgran.run.petsc import holding, unused

    with holding(configuration.keys):
        crew.world.Barrier()
        started = time.perf_counter()
        result = study.solve(crew, **configuration.choices)
        seconds = crew.world.allreduce(time.perf_counter() - started, MPI.MAX)
        for key in unused(configuration.keys):
            say(f"-{key} of {configuration.solver} was not used: its solver has no such option")
    return result, seconds
