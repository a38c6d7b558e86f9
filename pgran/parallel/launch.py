"""What mpirun or srun says of this process in its environment, before MPI has started."""

import os
import signal

SIGNALS = (signal.SIGUSR1, signal.SIGTERM)  # that ask a run to stop
RANKS = ("OMPI_COMM_WORLD_RANK", "PMIX_RANK", "PMI_RANK", "SLURM_PROCID")
SIZES = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE")


def hasten():
    """Let Open MPI start at once if this process was started alone; before it starts.

    It would start a daemon to launch others with, and look for networks: half a second.
    """
    if not any(name in os.environ for name in RANKS):
        os.environ.setdefault("OMPI_MCA_ess_singleton_isolated", "1")
        os.environ.setdefault("OMPI_MCA_pml", "ob1")


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


def _first(names, otherwise):
    numbers = (os.environ[name] for name in names if name in os.environ)
    return next((int(number) for number in numbers if number.isdigit()), otherwise)
