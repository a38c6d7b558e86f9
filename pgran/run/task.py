"""One way to run a scene: a task is cut into units of work, and one driver carries them out.

It shows on the standard error of rank 0 how far it is, and the time that is left.
"""

import contextlib
import sys
import time
from importlib import import_module
from importlib.util import find_spec

import numpy as np

from pgran.run.agreement import on_root


class Task:
    """A computation cut into `units`, whose results do not depend on which ranks do which of them.

    `row`, a NumPy dtype, is what the results of a unit travel in and the journal keeps: a row an
    item, as a rule. `items` is what an item is, in the plural. `untried` are the bytes that a unit
    takes at rank 0 beyond what a dry run tries of it.
    """

    untried = 0

    def open(self, group):
        """Return a context whose value works on one unit and returns its rows.

        Collective over `group`, the ranks that work on a unit together; the first one's rows count.
        A task that needs nothing for its units has a method `work(unit, group)` instead.
        """
        return contextlib.nullcontext(lambda unit: self.work(unit, group))

    def length(self, unit):
        """Return how many items a unit has, one if it is a number."""
        return len(unit) if hasattr(unit, "__len__") else 1

    def blank(self, unit):
        """Return rows of zeros for a unit that a dry run does not do."""
        return np.zeros(self.length(unit), self.row)

    def sample(self, unit):
        """Return a small part of a unit, for a dry run to try."""
        return unit

    def collect(self, rows, seconds):
        """Return the record of all rows, in the order of the units, on rank 0; `seconds` it took.

        Without a record of its own these are the rows.
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


class Progress(contextlib.AbstractContextManager):
    """Shows how many items are done: `bar`, `lines`, `none`, or `auto`, a bar on a terminal."""

    seconds_between_lines = 10.0

    def __init__(self, total, what, style="auto"):
        self.total, self.what, self.done = total, what, 0
        self.last_time, self.last_done, self.bar = time.monotonic(), 0, None
        widgets = "ipykernel" in sys.modules and find_spec("ipywidgets")
        if style == "auto":
            style = "bar" if widgets or sys.stderr.isatty() else "lines"
        self.lines = style == "lines"
        if style == "bar":
            try:
                tqdm = import_module("tqdm.notebook" if widgets else "tqdm").tqdm
                self.bar = tqdm(total=total, unit=f" {what}", leave=False)
            except ImportError:
                self.lines = True

    def __exit__(self, *error):
        if self.bar is not None:
            self.bar.close()

    def advance(self, count):
        """Note that `count` more items are done."""
        self.done += count
        if self.bar is not None:
            self.bar.update(count)
        now = time.monotonic()
        if self.lines and count and now - self.last_time >= self.seconds_between_lines:
            # by the pace since the last line: what an earlier run had finished came at once
            left = (now - self.last_time) * (self.total - self.done) / (self.done - self.last_done)
            self.last_time, self.last_done = now, self.done
            text = f"{self.done} of {self.total} {self.what}, about {in_time(left)} left"
            print(f"pgran: {text}", file=sys.stderr, flush=True)


def in_time(seconds):
    """Return a time in words, in the largest unit that suits it, two digits of it."""
    for size, unit in ((86400, "days"), (3600, "h"), (60, "min")):
        if seconds >= 2 * size:
            return f"{float(f'{seconds / size:.2g}'):g} {unit}"
    return f"{float(f'{seconds:.2g}'):g} s"
