"""What mpirun or srun says of this process in its environment, and how they are left."""

import contextlib
import os
import signal
import time

SIGNALS = (signal.SIGUSR1, signal.SIGTERM)  # that ask a run to stop
RANKS = ("OMPI_COMM_WORLD_RANK", "PMIX_RANK", "PMI_RANK", "SLURM_PROCID")
ALONE = {"OMPI_MCA_ess_singleton_isolated": "1", "OMPI_MCA_pml": "ob1"}
SIZES = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE")
SECONDS_FOR_MPIRUN = 0.1  # to hand on a message: MPICH's loses some that an abort follows at once
SECONDS_TO_BE_ENDED = 5.0  # that a rank waits for another one's abort


def start():
    """Start MPI, and return mpi4py's module.

    Collective, of those that were started together. Where this process was started alone Open MPI
    would start a daemon to launch others with, and look for networks: that takes half a second, and
    ends the process where there is no ssh. What is started from here inherits nothing of this.
    """
    alone = not any(name in os.environ for name in RANKS)
    added = {name: text for name, text in ALONE.items() if alone and name not in os.environ}
    os.environ.update(added)
    try:
        from mpi4py import MPI
    finally:
        for name in added:
            del os.environ[name]
    return MPI


def rank():
    """Return the rank that this process was started as, 0 if it was started alone."""
    return _first(RANKS, 0)


def size():
    """Return with how many ranks it was started, 1 if alone or unknown."""
    return _first(SIZES, 1)


def library(MPI):
    """Return the name and version of the library behind mpi4py's module."""
    first = MPI.Get_library_version().splitlines()[0].split(",")[0]
    return " ".join(first.replace("Version:", "").split())


def abort(world, code):
    """End all ranks with an exit code; what there is to say has been said.

    Not collective. MPI's own words, that ranks have called for an abort, are kept from following it
    where that is possible.
    """
    time.sleep(SECONDS_FOR_MPIRUN)
    _hush()
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # where MPICH would say it
    world.Abort(code)


def leave(world, code):
    """End all ranks in order with an exit code other than 0. Collective.

    Of such a code Open MPI's mpirun would say that the job has been aborted, after all that pgran
    has said, but not if told to be quiet, which only an abort is. Elsewhere this returns.
    """
    if "OMPI_COMM_WORLD_SIZE" in os.environ and _hush():  # of mpirun, of one rank, too
        signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGTERM])
        world.Barrier()
        if world.rank == 0:
            abort(world, code)
        time.sleep(SECONDS_TO_BE_ENDED)


def _hush():
    """Ask Open MPI 4 for what `mpirun -q` does, from here on; return whether it can be asked."""
    import ctypes

    with contextlib.suppress(OSError, ValueError):  # ValueError: no such name
        ctypes.c_bool.in_dll(ctypes.CDLL(None), "orte_execute_quiet").value = True
        return True
    return False


def _first(names, otherwise):
    numbers = (os.environ[name] for name in names if name in os.environ)
    return next((int(number) for number in numbers if number.isdigit()), otherwise)
