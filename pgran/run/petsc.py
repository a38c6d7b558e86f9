"""The one door to PETSc, and its option database: keys that hold for a while, or go unused.

MPI comes before PETSc, which may have no MPI library of its own; and PETSc reads no file of
options. `pgran run` starts it with the keys of its options file; nobody else has any.
"""

import collections
import contextlib
import ctypes
import functools

import numpy
import petsc4py

from pgran.errors import PgranError, is_petsc
from pgran.run import launch
from pgran.run.agreement import end_together
from pgran.store.estimate import counted

end_together(launch.start())
petsc4py.init(["pgran", "-skip_petscrc", "-no_signal_handler"])  # once: later calls do nothing

from petsc4py import PETSc  # noqa: E402

numpy.linalg.inv([[1.0]])  # takes a buffer for good: OpenBLAS later waits for ever for memory

if PETSc.ScalarType().dtype.kind != "c":
    raise PgranError("this PETSc has real scalars; pgran needs a complex one (pgran doctor)")

work = collections.Counter()  # by a solver's name and what it does how often this rank has
PARTS = {  # of -log_view, registered in the same order on all ranks
    part: (PETSc.Log.Stage(part), PETSc.Log.Event(f"pgran:{part}"))
    for part in ("assembly", "factors", "states", "models", "bounds", "counts", "modes", "windows")
}


def logged(part):
    """Return what makes a function a stage and an event of -log_view, where PETSc logs at all."""

    def decorate(function):
        @functools.wraps(function)
        def shown(*values, **choices):
            stage, event = PARTS[part]
            with stage, event:
                return function(*values, **choices)

        return shown if PETSc.Log.isActive() else function

    return decorate


def note(solver, comm, **done):
    """Note what a solver, by its name, of the ranks `comm` has done: `iteration=3`."""
    for what, number in done.items() if comm.rank == 0 else ():
        work[solver, what] += number


def work_done(world):
    """Return in words what each solver of all ranks has done. Collective."""
    total, told = collections.Counter(), {}
    for some in world.allgather(work):
        total.update(some)
    for (solver, what), number in total.items():
        told.setdefault(solver, []).append(counted(number, what))
    return [f"solved by {solver}: {', '.join(done)}" for solver, done in told.items()]


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
    """Return those of some keys in the database that nothing has acted on."""
    used = _whether_used()
    return [key for key in keys if not used(key)]


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
