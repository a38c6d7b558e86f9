"""Agreement over ranks on what one of them has met.

An error that every rank meets alike (a bad option) is raised on every rank. One that only a single
rank can meet (a file, memory, what a script hands in) is either agreed on before the next
collective call, with `on_root` or `agreeing`, or ends the whole job: in `pgran.__main__`, and in a
script by `end_together` and `ending_all`.
"""

import atexit
import contextlib
import sys
import time

from pgran.errors import (
    FileError,
    InputError,
    PgranError,
    explain,
    is_bad_input,
    is_foreseen,
    is_petsc,
    petsc_message,
    reason_of,
)

SECONDS_FOR_OTHERS = 1.0  # that a rank which fails waits for the others to fail alike
SECONDS_FOR_MPIRUN = 0.1  # to hand on a message: MPICH's loses some that an abort follows at once


def on_root(comm, action, keep=False):
    """Return `action()`, called on rank 0 alone; raise its error on every rank. Collective.

    An OSError becomes a FileError. Where `keep` is true only rank 0 gets the value, others None.
    """
    value, failure = None, None
    if comm.rank == 0:
        try:
            value = action()
        except Exception as error:
            failure = error
    description, shared = comm.bcast((_described(failure), None if keep else value))
    _raise(description, failure)
    return value if keep else shared


@contextlib.contextmanager
def agreeing(comm):
    """Raise on every rank what the first that meets anything has met in the meantime.

    Collective, where it ends. What no one has foreseen is raised as it is where it was met,
    elsewhere as a PgranError. The value is a dict, of what this rank asks for, a checksum by name:
    an InputError is raised if the ranks ask for different things.
    """
    failure, asked = None, {}
    try:
        yield asked
    except Exception as error:
        failure = error
    failures, everyone = zip(*comm.allgather((_described(failure), asked)), strict=True)
    _raise(next(filter(None, failures), None), failure)
    first = everyone[0]
    for rank, other in enumerate(everyone if first else ()):
        names = [name for name in first | other if first.get(name) != other.get(name)]
        if names:
            raise InputError(
                f"the ranks ask for different things: {', '.join(names)} of rank {rank} differs "
                "from rank 0's; under mpirun nothing that is handed in may depend on the rank"
            )


def _described(failure):
    """Return the kind and the message of an error, as other ranks are told of it."""
    if failure is None:
        return None
    if isinstance(failure, PgranError):
        return type(failure), str(failure)
    if isinstance(failure, OSError):
        return FileError, reason_of(failure)
    if is_petsc(failure):
        return InputError if is_bad_input(failure) else PgranError, petsc_message(failure)
    return PgranError, f"{type(failure).__name__}: {failure}"


def _raise(description, failure):
    """Raise what some rank has met, if anything, or what was met here unforeseen."""
    if description is None:
        return
    if failure is not None and not (is_foreseen(failure) or isinstance(failure, OSError)):
        raise failure
    kind, message = description
    raise kind(message) from failure


def met_by_all(comm):
    """Return whether every rank comes here, too, before long. Collective if so.

    For an error that may have been raised on some ranks only, while the others go on or wait.
    """
    # a barrier that need not be waited for: whoever is not there is at work, or waits elsewhere
    request, deadline = comm.Ibarrier(), time.monotonic() + SECONDS_FOR_OTHERS
    while not request.Test():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.001)
    return True


def end_together(MPI):
    """Let what ends a script on one rank end all of them, but under an interactive interpreter.

    PETSc's own end waits for the others, and comes before mpi4py's, which would abort.
    """
    world, shown = MPI.COMM_WORLD, sys.excepthook
    if world.size == 1 or sys.flags.interactive or hasattr(sys, "ps1"):
        return

    def hook(kind, error, trace):
        shown(kind, error, trace)
        _end_all(world, explain(error)[0], f"{kind.__name__} ends this script")

    def note(code):  # of `python -m mpi4py`, which an exception or sys.exit ends
        atexit.register(_end_all, world, code, f"ended with exit code {code}")  # called first

    sys.excepthook, MPI._set_abort_status = hook, note


@contextlib.contextmanager
def ending_all(world):
    """End the job where a rank leaves by no error, as by sys.exit in a function of the user's."""
    try:
        yield
    except BaseException as error:
        if world.size > 1 and not isinstance(error, Exception):
            _end_all(world, *explain(error))
        raise


def _end_all(world, code, text):
    """End the job, and say why, unless all ranks come here."""
    if not met_by_all(world):
        sys.stdout.flush()
        print(
            f"pgran (rank {world.rank}): {text}, and so all ranks end", file=sys.stderr, flush=True
        )
        time.sleep(SECONDS_FOR_MPIRUN)
        world.Abort(code)
