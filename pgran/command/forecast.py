"""What a run will need, found by trying a little of it: work, memory, time and disk.

A dry run is the run itself, with a few units of each task done and zeros in place of the others,
and without a journal or a result. What it takes is measured; only whether a lattice fits into
memory at all is foreseen by a formula, before anything is tried.
"""

import dataclasses
import math
import shutil
import time
from pathlib import Path

import numpy as np

from pgran.command.medium import is_factored, lattice_memory
from pgran.command.resolve import opening, run_scene
from pgran.medium.sample import make_lattice, ranks_per_lattice
from pgran.run.crew import Crew
from pgran.run.machine import free_memory, most_resident
from pgran.run.task import in_time
from pgran.store.estimate import counted
from pgran.store.record import Record

WARNING = "warning"  # begins a line that tells of what is wrong; such lines come first
GOLDEN = 0.6180339887498949
LAUNCH = 0.3  # seconds that mpirun and the interpreter take to start and to end
FILE_BYTES = 20_000  # of HDF5 itself: names, attributes, tables of datasets
# Trials of a task go on for so many seconds; whole units are tried if one takes no longer than
# that, parts of them else, and a single part if that takes longer still.
TRIAL, UNIT, PART = 0.3, 1.0, 10.0
TRIED = 0.75  # of the free memory; what is needed is an estimate, and can be too low


def forecast(scene, options, world, started):
    """Return the lines that say what a run will need, on rank 0; none on the others. Collective.

    `started` is when the program started, by `time.perf_counter`.
    """
    medium = make_lattice(options, world) if scene.on_medium else None
    lines = [f"run       {opening(options, world.size, medium)}"]
    if medium is not None:
        balls = " x ".join(map(str, medium.shape)) if medium.is_grid else medium.free_balls
        lines.append(f"unknowns  {medium.size} ({balls} balls, {medium.bonds} bonds)")
        ranks = ranks_per_lattice(scene, options, medium, world)
        needed = lattice_memory(medium, ranks, is_factored(options, medium))
        needed = _on_this_machine(world, needed)
        free = free_memory()
        if any(world.allgather(free and needed > TRIED * free)):  # on one machine of several
            warning = (
                f"{WARNING}   matrices and factors take about {in_bytes(needed)} of memory on this "
                f"machine, where {in_bytes(free or 0)} are free: nothing was tried"
            )
            return [warning, *lines] if world.rank == 0 else []
    crews = []

    def rehearse(ranks, _=None):
        crews.append(Rehearsal(world, ranks))
        return crews[-1]

    records = run_scene(scene, options, world, rehearse)
    memory = world.allgather(most_resident() + max(crew.untried for crew in crews))
    together = _on_this_machine(world, memory[world.rank])
    if world.rank > 0:
        return []
    trials = [trial for crew in crews for trial in crew.trials]
    seconds = time.perf_counter() - started - sum(crew.spent for crew in crews) + LAUNCH
    seconds += sum(expected for _, expected in trials)
    lines.append(f"work      {'; '.join(work for work, _ in trials)}")
    lines += report(options, memory, together, seconds, stored_bytes(records))
    return sorted(lines, key=lambda line: not line.startswith(WARNING))


class Rehearsal(Crew):
    """A crew that tries a few units of each task, and delivers zeros for all others.

    `trials` are, of each task, its size in words and the seconds that all of it takes; `spent` are
    the seconds that the trials themselves took, `untried` the most bytes that none of them took.
    """

    dry = True

    def __init__(self, world, ranks_per_lattice):
        super().__init__(world, ranks_per_lattice)
        self.trials, self.spent, self.untried = [], 0.0, 0

    def share(self, task, work, deliver):
        """Try some units, from all over the task; see `Crew.share`. Collective."""
        began = time.perf_counter()
        tried = self._try(task, work) if task.units else {}
        if self.world.rank == 0:
            for position, unit in enumerate(task.units):
                deliver(position, tried[position] if position in tried else task.blank(unit))
            self.untried = max(self.untried, task.untried)
        self.spent += time.perf_counter() - began

    def _try(self, task, work):
        """Time some units; return the rows of those that were done whole. Collective."""
        done, seconds, items, factorizations, whole = {}, [], [], [], False
        # units from all over the task first
        for position, unit in sorted(enumerate(task.units), key=lambda pair: pair[0] * GOLDEN % 1):
            part = unit if whole else task.sample(unit)
            self.world.Barrier()
            started = time.perf_counter()
            rows = work(part)
            took = max(self.world.allgather(time.perf_counter() - started))
            seconds.append(took)
            items.append(task.length(part))
            if self.world.rank == 0:
                counts = "factorizations" in task.row.names
                factorizations.append(int(rows["factorizations"].sum()) if counts else 0)
                if part == unit:
                    done[position] = rows
            whole = sum(seconds) * task.length(unit) <= UNIT * sum(items)
            if took > PART or sum(seconds[1:]) > TRIAL:
                break
        total = sum(map(task.length, task.units))
        later = slice(1 if len(items) > 1 else 0, None)  # the first does what others need not again
        tried, work_in_words = sum(items[later]), f"{total} {task.items}"
        if count := sum(factorizations[later]):
            work_in_words += f", about {max(1, round(count / tried * total))} factorizations"
        mine = total * math.ceil(len(task.units) / self.groups) / len(task.units)
        expected = seconds[0] + sum(seconds[later]) / tried * max(0.0, mine - items[0])
        self.trials.append((work_in_words, expected))
        return done


def report(options, memory, together, seconds, disk):
    """Return memory, time and disk in words, a line each, and warnings.

    `memory` are the bytes that each rank takes, `together` those of the ranks of this machine,
    `disk` those of the result.
    """
    first, *others = memory
    free, words = free_memory(), f"about {in_bytes(max(memory))}" + " a rank" * bool(others)
    if others and first > 1.2 * max(others):
        words = f"about {in_bytes(first)} on rank 0, {in_bytes(max(others))} on others"
    folder = next(p for p in Path(options.output_file).absolute().parents if p.exists())
    room = shutil.disk_usage(folder).free
    lines = [
        f"memory    {words}" + (f"; {in_bytes(free)} free" if free else ""),
        f"time      about {in_time(seconds)} on {counted(len(memory), 'rank')}",
        f"disk      about {in_bytes(disk)} in {options.output_file}; {in_bytes(room)} free",
    ]
    if free and together > free:
        lines.append(f"{WARNING}   {in_bytes(together)} of memory are more than is free here")
    if disk > room:
        lines.append(f"{WARNING}   {in_bytes(disk)} are more than is free on the disk")
    return lines


def stored_bytes(records):
    """Return the size of records in a file."""
    values = [getattr(record, f.name) for record in records for f in dataclasses.fields(record)]
    parts = [value for value in values if isinstance(value, Record)]
    size = sum(value.nbytes for value in values if isinstance(value, np.ndarray))
    return size + (stored_bytes(parts) if parts else FILE_BYTES)


def _on_this_machine(world, size):
    """Return the sum of a number over the ranks of this machine. Collective."""
    from mpi4py import MPI

    machine = world.Split_type(MPI.COMM_TYPE_SHARED)
    total = machine.allreduce(int(size))
    machine.Free()
    return total


def in_bytes(count):
    """Return a number of bytes in words, two digits of it."""
    for unit, name in ((1e12, "TB"), (1e9, "GB"), (1e6, "MB"), (1e3, "kB")):
        if count >= unit:
            return f"{float(f'{count / unit:.2g}'):g} {name}"
    return f"{count:.0f} bytes"
