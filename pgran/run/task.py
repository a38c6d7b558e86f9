"""One way to run a scene: a task is cut into units of work, and one driver carries them out."""

import time

import numpy as np

from pgran.run.agreement import on_root
from pgran.run.progress import Progress


class Task:
    """A computation cut into units, whose results do not depend on which ranks do which of them.

    `units` are shared out; how many ranks there are has no influence on them. `row`, a NumPy dtype,
    is what the results of a unit travel in and the journal keeps: a row an item, as a rule. `items`
    is what an item is, in the plural.
    """

    def open(self, group):
        """Return a context whose value works on one unit and returns its rows.

        Collective over `group`, the ranks that work on a unit together; the first one's rows count.
        """
        raise NotImplementedError

    def length(self, unit):
        """Return how many items a unit has."""
        return len(unit)

    def blank(self, unit):
        """Return rows of zeros for a unit that a dry run does not do."""
        return np.zeros(self.length(unit), self.row)

    def sample(self, unit):
        """Return a small part of a unit, for a dry run to try."""
        return unit

    def collect(self, rows, seconds):
        """Return the record of all rows, an array of `row` in the order of the units, on rank 0.

        `seconds` is what the task took. Without a record of its own these are the rows.
        """
        return rows


def carry_out(task, crew, progress="none"):
    """Return the record of a task on rank 0, None on the others. Collective."""
    started, root = time.perf_counter(), crew.world.rank == 0
    style = progress if root and not crew.dry else "none"
    total, parts = sum(map(task.length, task.units)), {}
    with crew.open(task) as work:
        crew.begin()  # before the progress
        with Progress(total, task.items, style) as counter:

            def deliver(position, rows):
                parts[position] = rows
                counter.advance(task.length(task.units[position]))

            crew.share(task, work, deliver)
    seconds = time.perf_counter() - started
    return on_root(crew.world, lambda: task.collect(_joined(parts, task.row), seconds), keep=True)


def _joined(parts, row):
    """Return the rows of all units in one array."""
    rows, start = np.empty(sum(map(len, parts.values())), row), 0
    for position in sorted(parts):
        part = parts.pop(position)  # which is freed once it is copied
        rows[start : start + len(part)] = part
        start += len(part)
    return rows
