"""The BLAS under NumPy, SciPy and PETSc, where it is OpenBLAS: one thread a rank, and its kernel.

Like `pgran.command.doctor` it runs on Python 3.7 and later.
"""

import contextlib
import ctypes
import os
import re
import sys

CHOICES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
# What its functions are called: in wheels of NumPy and SciPy with something before and after.
PREFIXES, SUFFIXES = ("openblas_", "scipy_openblas_"), ("", "64_")


def take_one_thread():
    """Let linear algebra take one thread, unless the environment says how many."""
    if not any(name in os.environ for name in CHOICES):
        os.environ["OMP_NUM_THREADS"] = "1"  # which a library that is loaded later reads
        if "numpy" in sys.modules:
            ask("set_num_threads", 1)


def kernels():
    """Return for which processors the kernels that run here were written; last bits differ."""
    names = {name.decode() for name in ask("get_corename", restype=ctypes.c_char_p)}
    return ", ".join(sorted(names)) or "unknown"


def ask(name, *arguments, restype=ctypes.c_int):
    """Call a function of every OpenBLAS that is loaded, and return the answers."""
    try:
        with open("/proc/self/maps") as stream:
            files = set(re.findall(r" (/.*openblas.*\.so.*)$", stream.read(), re.MULTILINE))
    except OSError:  # no Linux
        return []
    answers = []
    for library in map(ctypes.CDLL, sorted(files)):
        for whole in (prefix + name + suffix for prefix in PREFIXES for suffix in SUFFIXES):
            with contextlib.suppress(AttributeError):
                function = getattr(library, whole)
                function.restype = restype
                answers.append(function(*arguments))
    return answers
