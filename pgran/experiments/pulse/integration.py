"""Signals by PETSc's integrators, repeated until two integrations agree."""

import contextlib
import math
import time
from functools import partial

import numpy as np

from pgran.run.agreement import on_root
from pgran.run.task import Task, carry_out

FIRST_TOLERANCE = 0.3  # of the first integration, in units of the one asked for
REFINEMENT = 0.1  # the tolerance of each integration against the one before
LEAST_TOLERANCE = 1e-13  # tolerance of an integration
NODES = 6  # steps of an integrator that a polynomial goes through
MOTION = ("displacement", "velocity")
WALL = ("force", "work", "energy", "dissipated")  # of the wall, and what became of it


def integrate(recording, crew, progress):
    """Return the Signals by integrations at ever smaller tolerances, until two of them agree.

    Collective. The error of the last one is estimated, too large by about a power of ten, by its
    difference from the one before.
    """
    tolerance = FIRST_TOLERANCE * recording.tolerance
    tolerances, rows = [(0, tolerance), (1, REFINEMENT * tolerance)], []
    started = time.perf_counter()
    while tolerances:
        found = carry_out(Integration(recording, tolerances), crew, progress)
        if crew.world.rank == 0:
            rows = [*rows, *found][-2:]
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
        {name: (last[name], error) for name, error in errors.items()},
        sigma=0.0,
        period=0.0,
        solves=int(last["steps"]),
        factorizations=0,
        solve_seconds=time.perf_counter() - started,
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
    missing = np.min(allowed[missed] / (REFINEMENT * error[missed]))
    smaller = tolerance * (REFINEMENT if missing > 1 else np.clip(0.5 * missing, 1e-6, REFINEMENT))
    even = 2.0 ** math.floor(math.log2(smaller))  # the last bits of errors change no step
    return [(number + 1, max(even, LEAST_TOLERANCE))] if smaller >= LEAST_TOLERANCE else []


class Integration(Task):
    """The signals of a Recording by PETSc's integrators: `tolerances` by their number, from 0."""

    items = "times"

    def __init__(self, recording, tolerances):
        self.recording = recording
        end = float(recording.time[-1])
        self.units = [(number, tolerance, None, end) for number, tolerance in tolerances]
        times, detectors = len(recording.time), len(recording.sites)
        kept = len(recording.field_time)
        row = [
            *((name, float, (times, detectors)) for name in MOTION),
            *((name, float, (times,)) for name in (*WALL, "rough")),
            *(("steps", np.int64), ("complete", bool)),
            *(("field_time", float, (kept,)), ("field", float, (kept, *recording.lattice.shape))),
        ]
        self.row = np.dtype(row)

    @contextlib.contextmanager
    def open(self, group):
        """See `Task`."""
        from pgran.driven.operators import Operators
        from pgran.experiments.pulse.integrator import Integrator

        recording = self.recording
        with (
            Operators(recording.scaled, group) as operators,
            Integrator(operators, recording.sites, recording.sent, recording.highest) as integrator,
        ):
            yield lambda unit: self.read(integrator.run(*unit, recording.field_time))

    def read(self, history):
        """Return a row: the history at the times that are wanted."""
        row, recording = np.zeros(1, self.row), self.recording
        row["steps"], row["complete"] = len(history.time) - 1, history.complete
        if history.complete:
            times = dict.fromkeys(history.functions, recording.time) | {"force": recording.fine}
            found = {
                name: interpolated(history.time, *both, times[name])
                for name, both in history.functions.items()
            }
            row["work"], row["rough"] = recording.integral(found["force"] * recording.taken)
            found["force"] = recording.coarse(found["force"])
            for name, values in found.items():
                row[name] = values
            row["dissipated"] = row["work"] - row["energy"]
            for number, (when, field) in enumerate(history.fields):
                row["field_time"][0, number] = when
                if field is not None:
                    row["field"][0, number] = recording.scaled.displacements(field.real)
        return row

    def length(self, unit):
        """See `Task`: times."""
        *_, begin, end = unit
        recorded = self.recording.time
        return np.count_nonzero((recorded >= (begin or 0.0)) & (recorded <= end))

    def blank(self, unit):
        """See `Task`."""
        return np.zeros(1, self.row)

    def sample(self, unit):
        """See `Task`: a little after the middle of the pulse, where steps are short."""
        number, tolerance, _, end = unit
        begin = self.recording.sent.centre
        length = max(0.02 * (end - begin), 2 * self.recording.time[1])
        return number, tolerance, begin, begin + length


def interpolated(nodes, values, slopes, time):
    """Return functions at any times from their values and slopes at an integrator's steps.

    By Hermite's polynomials of degree 11 through six steps around each time: with Lagrange's
    l_n(t), 1 at the node t_n and 0 at the others,

        f(t) = sum_n l_n(t)^2 ((1 - 2 (t - t_n) l_n'(t_n)) f(t_n) + (t - t_n) f'(t_n)).

    The `nodes` increase and embrace all times; values and slopes have the shape (steps, ...).
    """
    count = min(NODES, len(nodes))
    first = np.searchsorted(nodes, time) - count // 2
    near = np.clip(first, 0, len(nodes) - count)[:, None] + np.arange(count)
    # Factors of l_n are (t - t_m) / (t_n - t_m), m != n, in arrays [time, n, m]; 1 for m = n.
    t = nodes[near]
    apart = t[:, :, None] - t[:, None, :] + np.eye(count)
    away = (time[:, None] - t)[:, None, :] * np.ones((count, 1))
    away[:, np.eye(count, dtype=bool)] = 1.0
    square = np.prod(away / apart, axis=2) ** 2
    turn = np.sum(1 / apart, axis=2) - 1.0  # l_n'(t_n), without the 1 for m = n
    offset = time[:, None] - t
    of_values, of_slopes = (1 - 2 * offset * turn) * square, offset * square
    parts = ((of_values, values), (of_slopes, slopes))
    return sum(np.einsum("tn,tn...->t...", weights, each[near]) for weights, each in parts)
