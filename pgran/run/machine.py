"""What this machine has: memory, in bytes, and the BLAS under NumPy, SciPy and PETSc.

Like `pgran.command.doctor` it runs on Python 3.7 and later.
"""

import contextlib
import ctypes
import os
import re
import resource
import sys
from pathlib import Path, PurePath

from pgran.errors import InputError

# Of control groups, version 1 and 2: where, a limit, what is taken, and what of that is mere cache.
GROUPS = {
    "memory": ("/memory", "limit_in_bytes", "usage_in_bytes", "total_inactive_file"),
    "": ("", "max", "current", "inactive_file"),
}
MODEST = 2**20  # bytes that are not worth a look
BUFFER = 128 * 2**20  # bytes that each thread of OpenBLAS takes, and libraries three times
# What says how many threads a BLAS takes.
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
# What OpenBLAS's functions are called: in wheels of NumPy and SciPy with something around.
PREFIXES, SUFFIXES = ("openblas_", "scipy_openblas_"), ("", "64_")


def total_memory():
    """Return the memory of this machine."""
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def check_limits():
    """Raise an InputError where `ulimit` is so strict that OpenBLAS waits for ever for a buffer."""
    words = [os.environ.get(name, "") for name in THREADS]
    threads = min(os.cpu_count(), max((int(word) for word in words if word.isdigit()), default=1))
    for letter, kind, least in (("v", resource.RLIMIT_AS, 3), ("d", resource.RLIMIT_DATA, 1)):
        needed, limit = BUFFER * (least + threads), resource.getrlimit(kind)[0]
        if resource.RLIM_INFINITY != limit < needed:
            raise InputError(
                f"ulimit -{letter} {limit // 1024}: too little memory to begin with; it takes "
                f"{needed // 1024}, or unlimited"
            )


def check_memory(key, size):
    """Raise an InputError where arrays that one rank holds, and one copy, exceed what is free."""
    free = free_memory() if size > MODEST else None
    if 2 * size > (total_memory() if free is None else free):
        here = "" if free is None else f", of which {free / 1e9:.3g} GB are free to this process"
        raise InputError(
            f"-{key}: too much: the arrays of this run alone take {2 * size / 1e9:.3g} GB, and "
            f"this machine has {total_memory() / 1e9:.3g} GB{here}"
        )


def most_resident():
    """Return the largest part of the memory that this process has taken."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def free_memory():
    """Return the memory that this process may still take, under all limits; None if unknown.

    Of what the system has, what `ulimit` leaves, and what control groups do: its own, and those
    around it, as of a container or a job.
    """
    return min((max(0, left) for left in _left()), default=None)


def _left():
    """Yield what each limit leaves."""
    for line in _lines("/proc/meminfo"):
        if line.startswith("MemAvailable:"):
            yield 1024 * int(line.split()[1])
    for pages in map(str.split, _lines("/proc/self/statm")):
        for kind, taken in ((resource.RLIMIT_AS, pages[0]), (resource.RLIMIT_DATA, pages[5])):
            limit = resource.getrlimit(kind)[0]
            if limit != resource.RLIM_INFINITY:
                yield limit - int(taken) * os.sysconf("SC_PAGE_SIZE")
    for _, kind, path in (line.split(":", 2) for line in _lines("/proc/self/cgroup")):
        where, *names, cache = GROUPS.get(kind, GROUPS[""])
        for folder in (path, *map(str, PurePath(path).parents)) if kind in GROUPS else ():
            home = f"/sys/fs/cgroup{where}{folder.rstrip('/')}/memory."
            facts = dict(line.split() for line in _lines(home + "stat"))
            with contextlib.suppress(ValueError):  # "max", or nothing
                limit, used = (int("".join(_lines(home + name))) for name in names)
                yield limit - used + int(facts.get(cache, 0))


def _lines(name):
    """Return the lines of a file, none where there is no such file."""
    try:
        return Path(name).read_text().splitlines()
    except OSError:
        return []


def take_one_thread():
    """Let linear algebra take one thread, unless the environment says how many."""
    if not any(name in os.environ for name in THREADS):
        os.environ["OMP_NUM_THREADS"] = "1"  # which a library that is loaded later reads
        if "numpy" in sys.modules:
            ask_blas("set_num_threads", 1)


def loaded_version(name):
    """Return the version of PETSc or SLEPc, if this process has loaded it."""
    module = sys.modules.get(name)
    return ".".join(map(str, module.Sys.getVersion())) if module else "not loaded"


def blas_kernels():
    """Return for which processors the kernels that run here were written; last bits differ."""
    names = {name.decode() for name in ask_blas("get_corename", restype=ctypes.c_char_p)}
    return ", ".join(sorted(names)) or "unknown"


def ask_blas(name, *arguments, restype=ctypes.c_int):
    """Call a function of every OpenBLAS that is loaded, and return the answers."""
    mapped = "\n".join(_lines("/proc/self/maps"))  # none where this is no Linux
    answers = []
    for file in sorted(set(re.findall(r" (/.*openblas.*\.so.*)$", mapped, re.MULTILINE))):
        for whole in (prefix + name + suffix for prefix in PREFIXES for suffix in SUFFIXES):
            with contextlib.suppress(AttributeError):
                function = getattr(ctypes.CDLL(file), whole)
                function.restype = restype
                answers.append(function(*arguments))
    return answers
