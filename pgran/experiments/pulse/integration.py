"""Signals by PETSc's integrators, repeated until two integrations agree."""

import contextlib
from functools import partial

import numpy as np

from pgran.experiments.pulse import signal
from pgran.experiments.pulse.listening import FIELDS
from pgran.run.agreement import on_root
from pgran.run.task import Task, carry_out

COARSE, FINER = 0.3, 0.1  # tolerance of the first integration, and of each against the one before
LEAST = 1e-13  # tolerance of an integration
TAKEN = ("force", "work", "energy", "dissipated")  # of the wall, and what became of it


class Integration(Task):
    """The signals by PETSc's integrators, at each of some tolerances.

    Parameters
    ----------
    listening : Listening
    tolerances : sequence of (int, float)
        How many coarser integrations there are, and the tolerance.
    """

    items = "times"

    def __init__(self, listening, tolerances):
        """Plan an integration at each tolerance."""
        self.listening = listening
        end = float(listening.time[-1])
        self.units = [(number, tolerance, None, end) for number, tolerance in tolerances]
        times, detectors = len(listening.time), len(listening.sites)
        kept = [
            ("displacement", float, (times, detectors)),
            ("velocity", float, (times, detectors)),
            *((name, float, (times,)) for name in TAKEN),
            ("rough", float, (times,)),
            ("steps", np.int64),
            ("complete", bool),
        ]
        if listening.fields:
            kept.append(("field_time", float, (FIELDS,)))
            kept.append(("field", float, (FIELDS, *listening.lattice.shape)))
        self.row = np.dtype(kept)

    @contextlib.contextmanager
    def open(self, group):
        """See `Task`."""
        from pgran.driven.operators import Operators
        from pgran.experiments.pulse.integrate import Integrator

        listening = self.listening
        keep_at = listening.field_time if listening.fields else ()
        with (
            Operators(listening.scaled, group) as operators,
            Integrator(operators, listening.sites, listening.sent, listening.highest) as integrator,
        ):

            def work(unit):
                number, tolerance, begin, end = unit
                return self.read(integrator.run(end, tolerance, number, keep_at, begin))

            yield work

    def read(self, history):
        """Return a row: the history at the times that are wanted. Not collective."""
        row, listening = np.zeros(1, self.row), self.listening
        row["steps"], row["complete"] = len(history.time) - 1, history.complete
        if history.complete:

            def at(values, slopes, time=listening.time):
                return signal.interpolated(history.time, values, slopes, time)

            row["displacement"] = at(history.displacement, history.velocity)
            row["velocity"] = at(history.velocity, history.acceleration)
            force = at(*history.force.T, listening.fine)
            row["force"] = listening.coarse(force)
            row["work"], row["rough"] = listening.integral(force * listening.speed)
            row["energy"] = at(*history.energy.T)
            row["dissipated"] = row["work"] - row["energy"]
            for number, (time, field) in enumerate(history.fields):
                row["field_time"][0, number] = time
                if field is not None:
                    row["field"][0, number] = listening.scaled.displacements(field.real)
        return row

    def length(self, unit):
        """See `Task`: times."""
        *_, begin, end = unit
        time = self.listening.time
        return np.count_nonzero((time >= (begin or 0.0)) & (time <= end))

    def blank(self, unit):
        """See `Task`."""
        return np.zeros(1, self.row)

    def sample(self, unit):
        """See `Task`: a little after the middle of the pulse, where steps are short."""
        number, tolerance, _, end = unit
        begin = self.listening.sent.centre
        part = max(0.02 * (end - begin), 2 * self.listening.time[1])
        return number, tolerance, begin, begin + part

    def collect(self, rows, seconds):
        """Return the rows, and what they took."""
        return rows, seconds


def integrate(listening, crew, progress):
    """Return the signals by integrations at ever smaller tolerances, until two of them agree.

    Collective. The record comes to rank 0, None to the others. The error of the last one is
    estimated, too large by about a power of ten, by its difference from the one before.

    Parameters
    ----------
    listening : Listening
    crew : pgran.run.crew.Crew
    progress : str
        Style of `pgran.run.progress.Progress`.
    """
    tolerance = COARSE * listening.tolerance
    tolerances, rows, seconds = [(0, tolerance), (1, FINER * tolerance)], [], 0.0
    while tolerances:
        found = carry_out(Integration(listening, tolerances), crew, progress)
        if found:
            rows, seconds = [*rows, *found[0]][-2:], seconds + found[1]
        smaller = partial(next_tolerance, listening, rows, tolerances[-1])
        tolerances = on_root(crew.world, smaller)
    if crew.world.rank > 0:
        return None
    before, last = rows
    errors = {
        name: np.maximum.accumulate(np.abs(last[name] - before[name]), axis=0)
        if before["complete"] and last["complete"]
        else np.full_like(last[name], np.inf)
        for name in ("displacement", "velocity", *TAKEN)
    }
    for name in ("work", "dissipated"):
        errors[name] += last["rough"]
    return listening.signals(
        "integrate",
        (last["displacement"], last["velocity"]),
        (errors["displacement"], errors["velocity"]),
        {name: (last[name], errors[name]) for name in TAKEN},
        sigma=0.0,
        period=0.0,
        solves=int(last["steps"]),
        factorizations=0,
        solve_seconds=seconds,
        error_estimate=errors["displacement"],
        velocity_estimate=errors["velocity"],
        field_time=last["field_time"] if listening.fields else None,
        field=last["field"] if listening.fields else None,
    )


def next_tolerance(listening, rows, last):
    """Return at which tolerances to integrate once more, none if that is no use.

    Not collective.

    Parameters
    ----------
    listening : Listening
    rows : list of numpy.void
        What the last two integrations found.
    last : (int, float)
        Number and tolerance of the last one.
    """
    (number, tolerance), (before, last) = last, rows
    largest = np.abs(last["displacement"]).max(axis=0)
    wrong = np.abs(last["displacement"] - before["displacement"]).max(axis=0)
    allowed = listening.tolerance * largest
    if not (before["complete"] and last["complete"]) or np.all(wrong <= allowed):
        return []
    # what is left is the error of `last`: may it serve as the coarser one of the next pair?
    missing = np.min(allowed[wrong > allowed] / (FINER * wrong[wrong > allowed]))
    smaller = tolerance * (FINER if missing > 1 else np.clip(0.5 * missing, 1e-6, FINER))
    return [(number + 1, smaller)] if smaller >= LEAST else []
