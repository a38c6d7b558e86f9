"""Signals by PETSc's integrators, repeated until two integrations agree."""

import contextlib
import math
from functools import partial

import numpy as np

from pgran.experiments.pulse.signals import FIELDS, interpolated
from pgran.run.agreement import on_root
from pgran.run.task import Task, carry_out

COARSE, FINER = 0.3, 0.1  # tolerance of the first integration, and of each against the one before
LEAST = 1e-13  # tolerance of an integration
MOTION = ("displacement", "velocity")
WALL = ("force", "work", "energy", "dissipated")  # of the wall, and what became of it


class Integration(Task):
    """The signals of a Recording by PETSc's integrators: `tolerances` by their number, from 0."""

    items = "times"

    def __init__(self, recording, tolerances):
        self.recording = recording
        end = float(recording.time[-1])
        self.units = [(number, tolerance, None, end) for number, tolerance in tolerances]
        times, detectors = len(recording.time), len(recording.sites)
        row = [
            *((name, float, (times, detectors)) for name in MOTION),
            *((name, float, (times,)) for name in (*WALL, "rough")),
            ("steps", np.int64),
            ("complete", bool),
        ]
        if recording.fields:
            shape = (FIELDS, *recording.lattice.shape)
            row += [("field_time", float, (FIELDS,)), ("field", float, shape)]
        self.row = np.dtype(row)

    @contextlib.contextmanager
    def open(self, group):
        """See `Task`."""
        from pgran.driven.operators import Operators
        from pgran.experiments.pulse.integrator import Integrator

        recording = self.recording
        keep_at = recording.field_time if recording.fields else ()
        with (
            Operators(recording.scaled, group) as operators,
            Integrator(operators, recording.sites, recording.sent, recording.highest) as integrator,
        ):

            def work(unit):
                number, tolerance, begin, end = unit
                return self.read(integrator.run(end, tolerance, number, keep_at, begin))

            yield work

    def read(self, history):
        """Return a row: the history at the times that are wanted."""
        row, recording = np.zeros(1, self.row), self.recording
        row["steps"], row["complete"] = len(history.time) - 1, history.complete
        if history.complete:

            def at(values, slopes, time=recording.time):
                return interpolated(history.time, values, slopes, time)

            row["displacement"] = at(history.displacement, history.velocity)
            row["velocity"] = at(history.velocity, history.acceleration)
            force = at(*history.force.T, recording.fine)
            row["force"] = recording.coarse(force)
            row["work"], row["rough"] = recording.integral(force * recording.taken)
            row["energy"] = at(*history.energy.T)
            row["dissipated"] = row["work"] - row["energy"]
            for number, (time, field) in enumerate(history.fields):
                row["field_time"][0, number] = time
                if field is not None:
                    row["field"][0, number] = recording.scaled.displacements(field.real)
        return row

    def length(self, unit):
        """See `Task`: times."""
        *_, begin, end = unit
        time = self.recording.time
        return np.count_nonzero((time >= (begin or 0.0)) & (time <= end))

    def blank(self, unit):
        """See `Task`."""
        return np.zeros(1, self.row)

    def sample(self, unit):
        """See `Task`: a little after the middle of the pulse, where steps are short."""
        number, tolerance, _, end = unit
        begin = self.recording.sent.centre
        length = max(0.02 * (end - begin), 2 * self.recording.time[1])
        return number, tolerance, begin, begin + length

    def collect(self, rows, seconds):
        """Return the rows, and what they took."""
        return rows, seconds


def integrate(recording, crew, progress):
    """Return the Signals by integrations at ever smaller tolerances, until two of them agree.

    Collective. The error of the last one is estimated, too large by about a power of ten, by its
    difference from the one before.
    """
    tolerance = COARSE * recording.tolerance
    tolerances, rows, seconds = [(0, tolerance), (1, FINER * tolerance)], [], 0.0
    while tolerances:
        results = carry_out(Integration(recording, tolerances), crew, progress)
        if results:
            rows, seconds = [*rows, *results[0]][-2:], seconds + results[1]
        smaller = partial(_next_tolerances, recording.tolerance, rows, tolerances[-1])
        tolerances = on_root(crew.world, smaller)
    if crew.world.rank > 0:
        return None
    before, last = rows
    unknown = 0.0 if before["complete"] and last["complete"] else np.inf
    errors = {
        name: np.maximum.accumulate(np.abs(last[name] - before[name]), axis=0) + unknown
        for name in (*MOTION, *WALL)
    }
    for name in ("work", "dissipated"):
        errors[name] += last["rough"]
    fields = ("field_time", "field") if recording.fields else ()
    return recording.record(
        "integrate",
        [last[name] for name in MOTION],
        [errors[name] for name in MOTION],
        {name: (last[name], errors[name]) for name in WALL},
        sigma=0.0,
        period=0.0,
        solves=int(last["steps"]),
        factorizations=0,
        solve_seconds=seconds,
        error_estimate=errors["displacement"],
        velocity_estimate=errors["velocity"],
        **{name: last[name] for name in fields},
    )


def _next_tolerances(wanted, rows, last):
    """Return at which tolerances to integrate once more, none if that is no use.

    `wanted` is relative to a signal's largest; `rows` are of the last two integrations, `last` the
    number and the tolerance of the last one.
    """
    (number, tolerance), (coarse, fine) = last, rows
    error = np.abs(fine["displacement"] - coarse["displacement"]).max(axis=0)
    allowed = wanted * np.abs(fine["displacement"]).max(axis=0)
    missed = ~(error <= allowed)
    if not (coarse["complete"] and fine["complete"]) or not missed.any():
        return []
    # what is left is the error of the last: may it serve as the coarser one of the next pair?
    missing = np.min(allowed[missed] / (FINER * error[missed]))
    smaller = tolerance * (FINER if missing > 1 else np.clip(0.5 * missing, 1e-6, FINER))
    even = 2.0 ** math.floor(math.log2(smaller))  # the last bits of errors change no step
    return [(number + 1, max(even, LEAST))] if smaller >= LEAST else []
