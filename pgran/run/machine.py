"""The memory that this machine has, that is free, and that this process takes, in bytes."""

import os
import resource
from pathlib import Path

from pgran.errors import InputError


def total_memory():
    """Return the memory of this machine."""
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def check_memory(key, size):
    """Raise an InputError where arrays that one rank holds, and one copy, exceed the memory."""
    if 2 * size > total_memory():
        raise InputError(
            f"-{key}: too much: the arrays of this run alone take {2 * size / 1e9:.3g} GB, and "
            f"this machine has {total_memory() / 1e9:.3g} GB"
        )


def most_resident():
    """Return the largest part of the memory that this process has taken."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def free_memory():
    """Return the memory that programs may still take here, in a container too; None if unknown."""
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
