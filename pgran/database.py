"""PETSc's option database: keys that hold for a while, and keys that nothing has asked for."""

import contextlib
import ctypes

from mpi4py import MPI  # noqa: F401 (first: PETSc may have no MPI library of its own)
from petsc4py import PETSc


@contextlib.contextmanager
def holding(keys):
    """Let solver keys hold for the objects that are made meanwhile, on top of those there are.

    Not collective, but every rank must hold the same.

    Parameters
    ----------
    keys : dict of str
        Names without the leading dash.
    """
    database = PETSc.Options()
    before = database.getAll()
    for key, text in keys.items():
        database.setValue(key, text)
    try:
        yield
    finally:
        for key in keys:
            if key in before:
                database.setValue(key, before[key])
            else:
                database.delValue(key)


def unused(keys):
    """Return those of some keys in the database that no object has asked for. Not collective."""
    library, found = ctypes.CDLL(PETSc.__file__), []
    for key in keys:  # petsc4py itself has no call for this before PETSc 3.19
        used = ctypes.c_int(0)
        library.PetscOptionsUsed(None, key.encode(), ctypes.byref(used))
        if not used.value:
            found.append(key)
    return found
