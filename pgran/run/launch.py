"""How MPI is started, and what mpirun or srun says of this process in its environment."""

import os
import signal

from pgran.run import machine

SIGNALS = (signal.SIGUSR1, signal.SIGTERM)  # that ask a run to stop
HELD = (*SIGNALS, signal.SIGINT)  # while a run starts
RANKS = ("OMPI_COMM_WORLD_RANK", "PMIX_RANK", "PMI_RANK", "SLURM_PROCID")
SIZES = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE")
ALONE = {"OMPI_MCA_ess_singleton_isolated": "1", "OMPI_MCA_pml": "ob1"}


def start():
    """Start MPI, and return mpi4py's module.

    Collective, of those that were started together. Where this process was started alone Open MPI
    would start a daemon to launch others with, and look for networks: that takes half a second, and
    ends the process where there is no ssh. What is started from here inherits nothing of this.
    """
    alone = not any(name in os.environ for name in RANKS)
    added = {name: text for name, text in ALONE.items() if alone and name not in os.environ}
    os.environ.update(added)
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])  # half a start has no end
    try:
        from mpi4py import MPI
    finally:
        for name in added:
            del os.environ[name]
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
    machine.check_limits()
    return MPI


def rank():
    """Return the rank that this process was started as, 0 if it was started alone."""
    return _number(RANKS, 0)


def size():
    """Return with how many ranks it was started, 1 if alone or unknown."""
    return _number(SIZES, 1)


def _number(names, otherwise):
    """Return the first of these variables that holds a number."""
    texts = (os.environ.get(name, "") for name in names)
    return next((int(text) for text in texts if text.isdigit()), otherwise)


def library(MPI):
    """Return the name and version of the library behind mpi4py's module."""
    first = MPI.Get_library_version().splitlines()[0].split(",")[0]
    return " ".join(first.replace("Version:", "").split())


def strangers(MPI):
    """Return in words that ranks do not know of each other; nothing if they do."""
    if MPI.COMM_WORLD.size > 1 or size() == 1:
        return ""
    return (
        f"mpirun started {size()} ranks that do not know of each other: it belongs to another MPI "
        f"than mpi4py ({library(MPI)})"
    )
