"""Agreement over ranks on what one of them has met.

An error that every rank meets alike (a bad option) is raised on every rank. One that only a single
rank can meet (a file, memory) is either agreed on with `on_root` before the next collective call,
or ends the whole job in `pgran.__main__`.
"""

import time

from pgran.errors import (
    FileError,
    InputError,
    PgranError,
    is_bad_input,
    petsc_message,
    reason_of,
)

SECONDS_FOR_OTHERS = 1.0  # that a rank which fails waits for the others to fail alike
FAILED = 0  # tag of the message in which it tells them


def on_root(comm, action, keep=False):
    """Return `action()`, called on rank 0 alone; raise its error on every rank.

    Collective. Raises the PgranError that `action` raised; an OSError becomes a FileError.

    Parameters
    ----------
    comm : mpi4py.MPI.Comm
    action : callable
        Called without arguments.
    keep : bool
        Keep what it returns on rank 0, None on the others, instead of broadcasting it.
    """
    value, failure = None, None
    if comm.rank == 0:
        try:
            value = action()
        except PgranError as error:
            failure = (type(error), str(error))
        except OSError as error:
            failure = (FileError, reason_of(error))
    failure, shared = comm.bcast((failure, None if keep else value))
    if failure:
        kind, message = failure
        raise kind(message)
    return value if keep else shared


def agree(comm, failure):
    """Raise a PgranError on every rank if `failure`, what one has met, is not None on some rank.

    Collective. It is of the kind that the first of these ranks has met, or says what PETSc did.
    """
    told = None
    if isinstance(failure, PgranError):
        told = type(failure), str(failure)
    elif failure is not None:  # of PETSc
        told = InputError if is_bad_input(failure) else PgranError, petsc_message(failure)
    met = next(filter(None, comm.allgather(told)), None)
    if met:
        kind, message = met
        raise kind(message)


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


def who_reports(comm, failure):
    """Return which rank is to report a failure, and whether all ranks have met it alike.

    Not collective: the other ranks may be at work, or wait for this one for ever. The first rank
    to fail reports; of those that failed before they heard of another, the lowest. `failure` says
    what has happened on this rank.
    """
    others = [rank for rank in range(comm.size) if rank != comm.rank]
    late = any(comm.Iprobe(rank, FAILED) for rank in others)
    failures = {comm.rank: (failure, late)}
    requests = [comm.isend((failure, late), rank, tag=FAILED) for rank in others]
    deadline = time.monotonic() + SECONDS_FOR_OTHERS
    while len(failures) < comm.size and time.monotonic() < deadline:
        for rank in others:
            if comm.Iprobe(rank, FAILED):
                failures[rank] = comm.recv(source=rank, tag=FAILED)
        time.sleep(0.01)
    del requests  # not waited for: who does not fail does not receive
    first = min((rank for rank, (_, late) in failures.items() if not late), default=0)
    alike = len(failures) == comm.size and len({failure for failure, _ in failures.values()}) == 1
    return first, alike
