"""The one door to PETSc, and its option database: keys that hold for a while, or go unused.

MPI comes before PETSc, which may have no MPI library of its own; and PETSc reads no file of
options. `pgran run` starts it with the keys of its options file; nobody else has any.
"""

import contextlib
import ctypes
import logging

import numpy
import petsc4py

from pgran.errors import PgranError, is_petsc
from pgran.run import launch
from pgran.run.agreement import end_together

end_together(launch.start())
petsc4py.init(["pgran", "-skip_petscrc", "-no_signal_handler"])  # once: later calls do nothing

from petsc4py import PETSc  # noqa: E402

numpy.linalg.inv([[1.0]])  # takes a buffer for good: OpenBLAS later waits for ever for memory

if PETSc.ScalarType().dtype.kind != "c":
    raise PgranError("this PETSc has real scalars; pgran needs a complex one (pgran doctor)")

log = logging.getLogger("pgran")
solved = {}  # of prefixes of KSPs whether these have solved anything


@contextlib.contextmanager
def plain_errors():
    """Raise PETSc's errors as they are: a slepc4py from PyPI hides them behind a SystemError."""
    try:
        yield
    except SystemError as error:
        hidden = error.__cause__
        if not is_petsc(hidden):
            raise
        raise hidden from hidden.__cause__


@contextlib.contextmanager
def holding(keys):
    """Let solver keys, the same on every rank, hold meanwhile; one whose text is None is hidden."""
    before = PETSc.Options().getAll()
    solved.clear()
    _set(keys)
    try:
        yield
    finally:
        _set({key: before.get(key) for key in keys})


def _set(keys):
    """Put keys into the database, or take away those whose text is None."""
    database = PETSc.Options()
    for key, text in keys.items():
        if text is None:
            database.delValue(key)
        else:
            database.setValue(key, text)


def unused(keys):
    """Return {key: why} of those of some keys in the database that nothing has acted on."""
    used, idle = _whether_used(), tuple(f"{prefix}ksp_" for prefix in solved if not solved[prefix])
    why = {key: "no solver of this run has such an option" for key in keys if not used(key)}
    alone = "factorizations alone solved all; -sweep_method points, or no factorization, uses a KSP"
    return why | {key: alone for key in keys if key.startswith(idle)}


def warn_of_unused(keys):
    """Warn of those of some keys in the database that nothing has acted on."""
    for key, why in unused(keys).items():
        log.warning("-%s was not used: %s", key, why)


def _whether_used():
    """Return what says whether any object has asked for a key; true where nothing can tell."""
    database = PETSc.Options()
    if hasattr(database, "used"):  # from petsc4py 3.19 on
        return database.used
    try:
        ask = ctypes.CDLL(PETSc.__file__).PetscOptionsUsed
    except (OSError, AttributeError):
        return lambda key: True
    ask.argtypes = ctypes.c_void_p, ctypes.c_char_p, ctypes.POINTER(ctypes.c_int)
    ask.restype = ctypes.c_int

    def used(key):
        answer = ctypes.c_int(0)
        return ask(None, key.encode(), answer) != 0 or answer.value != 0

    return used
