"""What a run will need, said without running it: unknowns, work, memory, time and disk."""

import importlib
import math
import os
import resource
import shutil
import time
from pathlib import Path

from mpi4py import MPI

from pgran.command.costs import FILE_BYTES
from pgran.command.needs import SCENES
from pgran.physics.lattice import bond_count

LAUNCH = 0.3  # seconds that mpirun and the interpreter take to start and to end
COPIES = 2.0  # of the result on rank 0, while it is put together and written


def forecast(options, world, started):
    """Return the lines that say what a run will need, on rank 0; none on the others.

    Collective. Nothing is written.

    Parameters
    ----------
    options : pgran.files.reading.Options
    world : mpi4py.MPI.Comm
    started : float
        When the program started, by `time.perf_counter`.

    Raises
    ------
    PgranError
        If the options are impossible, as the run itself would.
    """
    scene = importlib.import_module(f"pgran.scenes.{options.scene}")
    if options.scene not in SCENES:
        return [f"no forecast for scene {options.scene}"] if world.rank == 0 else []
    startup, program = time.perf_counter() - started, resident_bytes()
    needs = SCENES[options.scene](options, world, scene)
    others = program + needs.memory + needs.sent
    root = program + needs.memory + needs.gathered + COPIES * needs.disk
    machine = world.Split_type(MPI.COMM_TYPE_SHARED)
    together = root + (machine.size - 1) * others
    machine.Free()
    if world.rank > 0:
        return []
    return report(needs, options, world.size, root, others, together, startup)


def report(needs, options, ranks, root, others, together, startup):
    """Return what is needed in words, a line each. Not collective."""
    memory = f"about {size(root)}" + (" a rank" if ranks > 1 else "")
    if ranks > 1 and root > 1.2 * others:
        memory = f"about {size(root)} on rank 0, {size(others)} on each other rank"
    free, folder = free_bytes(), next(p for p in Path(options.output_file).parents if p.exists())
    disk, room = needs.disk + FILE_BYTES, shutil.disk_usage(folder).free
    where = f"on {ranks} rank{'s' if ranks > 1 else ''}"
    duration = "not known: without a factorization, iterations cannot be foreseen"
    if needs.seconds is not None:
        duration = f"about {span(needs.seconds + startup + LAUNCH)} {where}"
    else:
        memory += " beside the preconditioner"
    lines = [
        f"unknowns  {unknowns(needs)}",
        f"work      {needs.work}",
        f"memory    {memory}" + (f"; {size(free)} free" if free else ""),
        f"time      {duration}",
        f"disk      about {size(disk)} in {options.output_file}; {size(room)} free",
    ]
    if free and together > free:
        lines.append(f"WARNING   {size(together)} of memory {where} are more than is free here")
    if disk > room:
        lines.append(f"WARNING   {size(disk)} are more than is free on the disk")
    return lines


def unknowns(needs):
    """Return the unknowns of the matrix in words. Not collective."""
    if needs.shape is None:
        return "none: no matrix"
    shape = " x ".join(map(str, needs.shape))
    words = f"{math.prod(needs.shape)} ({shape} balls, {bond_count(needs.shape)} bonds)"
    return words + (f"; factor about {size(needs.factor)}" if needs.factor else "")


def size(count):
    """Return a number of bytes in words, two digits of it."""
    for unit, name in ((1e12, "TB"), (1e9, "GB"), (1e6, "MB"), (1e3, "kB")):
        if count >= unit:
            return f"{_rounded(count / unit)} {name}"
    return f"{count:.0f} bytes"


def span(seconds):
    """Return a time in words, two digits of it."""
    for unit, name in ((86400, "days"), (3600, "h"), (60, "min")):
        if seconds >= 2 * unit:
            return f"{_rounded(seconds / unit)} {name}"
    return f"{_rounded(seconds)} s"


def _rounded(value):
    return f"{float(f'{value:.2g}'):g}"


def resident_bytes():
    """Return the memory that this process takes now. Not collective."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except (OSError, ValueError, IndexError):  # no Linux: the most it has taken so far
        return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return pages * os.sysconf("SC_PAGE_SIZE")


def free_bytes():
    """Return the memory that programs may still take here, None if unknown. Not collective.

    What the system has available, or less where a container has a limit of its own.
    """
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
        facts = dict(line.split(":") for line in lines)
        free = 1024 * int(facts["MemAvailable"].split()[0])
    except (OSError, ValueError, KeyError):
        return None
    try:
        limit, used = (
            int(Path(f"/sys/fs/cgroup/memory.{name}").read_text()) for name in ("max", "current")
        )
    except (OSError, ValueError):  # no such limit
        return free
    return min(free, limit - used)
