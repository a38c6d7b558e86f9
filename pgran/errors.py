"""Exceptions, exit codes, and agreement over ranks.

An error that every rank meets alike (a bad option) is raised on every rank. One that only a single
rank can meet (a file, memory) is either agreed on with `on_root` before the next collective call,
or ends the whole job in `pgran.__main__`.
"""

import os
import signal
import stat
import time

DONE, BAD_INPUT, INACCURATE, BAD_FILE, STOPPED = 0, 2, 3, 4, 75
LONGEST = 1010  # characters of a message
# What PETSc's errors hold where an option of the user's is to blame.
WRONG_OPTION = ("SetFromOptions()", "Could not locate solver type")
SIGNALS = (signal.SIGUSR1, signal.SIGTERM)  # that ask a run to stop
SECONDS_FOR_OTHERS = 1.0  # that a rank which fails waits for the others to fail alike
SECONDS_FOR_MPIRUN = 0.1  # to hand on a message: MPICH's loses some that an abort follows at once
FAILED = 0  # tag of the message in which it tells them


class PgranError(Exception):
    """An error whose message is meant for the user, without a traceback.

    One line of bounded length without control characters, whatever a file put into it.
    """

    exit_code = 1

    def __init__(self, message):
        """Keep the message, made fit for a terminal."""
        text = "".join(c if c.isprintable() else "?" for c in str(message))
        super().__init__(text if len(text) <= LONGEST else f"{text[:500]} ... {text[-500:]}")


class InputError(PgranError):
    """Bad input: nothing was computed."""

    exit_code = BAD_INPUT


def is_petsc(error):
    """Return whether PETSc or SLEPc raised an error. Not collective."""
    return type(error).__module__.startswith("petsc4py")


def is_bad_input(error):
    """Return whether an error is to blame on the user's options. Not collective."""
    blamed = is_petsc(error) and any(sign in str(error) for sign in WRONG_OPTION)
    return blamed or isinstance(error, InputError)


def petsc_message(error):
    """Return in one line what went wrong in PETSc, and in which call. Not collective."""
    # Its text: a number, the calls, a kind of error, and what it was in particular.
    lines = [line.split("] ", 1)[-1] for line in str(error).splitlines()]
    calls = [line.split(" at ")[0] for line in lines if "() at " in line]
    said = [line for line in lines[1:] if "() at " not in line]
    return str(PgranError(f"PETSc: {(said[1:] or said or lines)[0]} ({', '.join(calls[:1])})"))


class FileError(PgranError):
    """A file that cannot be read or written, or is not what it should be."""

    exit_code = BAD_FILE


class StoppedError(PgranError):
    """A signal has stopped the run; what is finished is kept."""

    exit_code = STOPPED


def on_root(comm, action, keep=False):
    """Return `action()`, called on rank 0 alone; raise its error on every rank.

    Collective.

    Parameters
    ----------
    comm : mpi4py.MPI.Comm
    action : callable
        Called without arguments.
    keep : bool
        Keep what it returns on rank 0, None on the others, instead of broadcasting it.

    Raises
    ------
    PgranError
        The error that `action` raised on rank 0; an OSError becomes a FileError.
    """
    value, failure = None, None
    if comm.rank == 0:
        try:
            value = action()
        except PgranError as error:
            failure = (type(error), str(error))
        except OSError as error:
            failure = (FileError, describe(error))
    failure, shared = comm.bcast((failure, None if keep else value))
    if failure:
        kind, message = failure
        raise kind(message)
    return value if keep else shared


def agree(comm, failure):
    """Raise, on every rank, the error that the first of the ranks has met, if any has.

    Collective.

    Parameters
    ----------
    comm : mpi4py.MPI.Comm
    failure : Exception or None
        What this rank has met.

    Raises
    ------
    PgranError
        With the last line of that error's message.
    """
    met = comm.allgather(failure and (str(failure).splitlines() or [repr(failure)])[-1])
    message = next(filter(None, met), None)
    if message:
        raise PgranError(message)


def met_by_all(comm):
    """Return whether every rank comes here, too, before long. Collective if so.

    For an error that may have been raised on some ranks only, while the others go on or wait.
    """
    request, deadline = comm.Ibarrier(), time.monotonic() + SECONDS_FOR_OTHERS
    while not request.Test():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.001)
    return True


def describe(error):
    """Return an OSError as `path: reason`. Not collective."""
    reason = error.strerror or str(error)
    return f"{error.filename}: {reason}" if error.filename else reason


def open_regular(path):
    """Return a file opened for reading bytes, refusing what could block or never end.

    Not collective.

    Raises
    ------
    FileError
        If it cannot be opened, or is a folder, a pipe or a device.
    """
    try:
        mode = os.stat(path).st_mode
        if not stat.S_ISREG(mode):
            kind = "directory" if stat.S_ISDIR(mode) else "pipe or a device, not a file"
            raise FileError(f"{path}: is a {kind}")
        return open(path, "rb")
    except OSError as error:
        raise FileError(describe(error)) from None
    except ValueError as error:
        raise FileError(f"{path!r}: no name of a file: {error}") from None


def who_reports(comm, failure):
    """Return which rank is to report a failure, and whether all ranks have met it alike.

    Not collective: the other ranks may be at work, or wait for this one for ever. The first rank
    to fail reports; of those that failed before they heard of another, the lowest.

    Parameters
    ----------
    comm : mpi4py.MPI.Comm
    failure : object
        Says what has happened on this rank.
    """
    others = [rank for rank in range(comm.size) if rank != comm.rank]
    late = any(comm.Iprobe(rank, FAILED) for rank in others)
    failures = {comm.rank: (failure, late)}
    # never waited for: who does not fail does not receive
    requests = [comm.isend((failure, late), rank, tag=FAILED) for rank in others]
    deadline = time.monotonic() + SECONDS_FOR_OTHERS
    while len(failures) < comm.size and time.monotonic() < deadline:
        for rank in others:
            if comm.Iprobe(rank, FAILED):
                failures[rank] = comm.recv(source=rank, tag=FAILED)
        time.sleep(0.01)
    del requests
    first = min((rank for rank, (_, late) in failures.items() if not late), default=0)
    alike = len(failures) == comm.size and len({failure for failure, _ in failures.values()}) == 1
    return first, alike
