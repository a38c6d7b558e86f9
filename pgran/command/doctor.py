"""`pgran doctor`: what is installed, what is wrong with it, and how to mend that.

A finding is (good, text, cure): good is True, None for what pgran can do without, or False. This
module and what it imports at once run on Python 3.7 and later.
"""

import importlib
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

from pgran.command.words import Parser
from pgran.run import launch, machine

INSTALL = "bash jobs/setup.sh makes .venv, and .venv/bin/pgran has all it needs"
if not (Path(__file__).parents[2] / "jobs").exists():  # installed without the scripts
    INSTALL = "pgran manual installing says how to get it"
OLDEST_PYTHON, OLDEST_NUMPY = (3, 11), (1, 24)
NEEDED, EXTRAS = ("numpy", "scipy", "h5py"), ("matplotlib", "tqdm")


def examine(words=()):
    """Print one line for each finding, and return 0, or 1 if pgran cannot run as it is.

    Collective where MPI works: rank 0 prints its own findings, and what is wrong with other ranks.
    """
    does = "Say what is installed, what is wrong with it, and how to mend that."
    Parser("doctor", does, "pgran doctor", "mpirun -n 2 pgran doctor").parse_args(words)
    findings = [finding for check in CHECKS for finding in guarded(check)]
    MPI = sys.modules.get("mpi4py.MPI")
    for rank, theirs in enumerate(MPI.COMM_WORLD.allgather(findings) if MPI else ()):
        for good, text, cure in theirs:
            if good is False and (good, text, cure) not in findings:
                findings.append((good, f"on rank {rank}: {text}", cure))
    if launch.rank() == 0:
        for good, text, cure in findings:
            print(f"{'ok   ' if good else 'WRONG' if good is False else 'note '} {text}")
            if not good:
                print(f"      -> {cure}")
    return int(any(good is False for good, _, _ in findings))


def guarded(check):
    """Yield the findings of a check; a module it lacks, or another error, is one of them."""
    name = check.__name__
    try:
        yield from check()
    except ImportError as error:
        yield missing(name + "4py", error)
    except Exception as error:
        yield False, f"looking for {name} failed: {type(error).__name__}: {error}", INSTALL


def missing(module, error):
    """Return the finding of a module that is not here, but may be in the .venv of this folder."""
    activate, cure = Path(__file__).resolve().parents[2] / ".venv" / "bin" / "activate", INSTALL
    if activate.exists() and sys.prefix != str(activate.parents[1]):
        cure = f"source {activate}: .venv is not active; or {INSTALL}"
    return False, f"{module} cannot be imported: {error}", cure


def dotted(version):
    """Return a version as text."""
    return ".".join(map(str, version))


def python():
    """Find the Python that runs this."""
    text = f"Python {dotted(sys.version_info[:3])}, {sys.executable}"
    cure = f"pgran needs {dotted(OLDEST_PYTHON)} or later: {INSTALL}"
    yield sys.version_info >= OLDEST_PYTHON, text, cure


def mpi():
    """Find MPI, whether the ranks know of each other, and whether mpirun belongs to it."""
    try:
        MPI = launch.start()
    except RuntimeError as error:  # mpi4py without an MPI library
        raise ImportError(error) from None
    name, ranks = launch.library(MPI), MPI.COMM_WORLD.size
    yield True, f"mpi4py with {name}, {ranks} rank{'s' if ranks > 1 else ''} here", ""
    cure = "put the mpirun of the MPI that mpi4py was built with first on PATH"
    if launch.strangers(MPI):
        yield False, launch.strangers(MPI), cure
    launcher = shutil.which("mpirun")
    if launcher is None:
        yield None, "mpirun is not on PATH", "without it pgran runs on one rank only"
        return
    words = [launcher, "--version"]
    version = subprocess.run(words, capture_output=True, text=True, check=False, timeout=30).stdout
    family = next((f for f in ("Open MPI", "MPICH", "Intel") if f in name), name)
    same = family in version or (family == "MPICH" and "HYDRA" in version.upper())
    text = f"{launcher} {'belongs' if same else 'does not belong'} to {family}"
    yield same, text, "it would start single ranks that do not know of each other: " + cure


def petsc():
    """Find petsc4py, its scalars, and MUMPS."""
    import petsc4py

    petsc4py.init(["pgran", "-skip_petscrc", "-no_signal_handler"])
    from pgran.run.petsc import PETSc

    good = PETSc.ScalarType().dtype.kind == "c"
    text = f"petsc4py {dotted(PETSc.Sys.getVersion())}, {'complex' if good else 'real'} scalars, "
    cure = "pgran needs a complex PETSc: set PETSC_DIR and PETSC_ARCH to one, or " + INSTALL
    yield good, text + os.path.dirname(petsc4py.__file__), cure
    good = PETSc.Sys.hasExternalPackage("mumps") or None
    cure = "large and shared lattices need it: a PETSc configured with --download-mumps has it"
    yield good, f"factorizations by MUMPS: {'found' if good else 'not found'}", cure


def slepc():
    """Find slepc4py, and whether it was built for the PETSc at hand, if there is one."""
    if "petsc4py.PETSc" in sys.modules:
        from slepc4py import SLEPc

        from pgran.run.petsc import PETSc

        version, here = SLEPc.Sys.getVersion(), PETSc.Sys.getVersion()
        text = f"slepc4py {dotted(version)} on PETSc {dotted(here)}"
        yield version[:2] == here[:2], text, "set SLEPC_DIR to that of this PETSc, or " + INSTALL


def packages():
    """Find the other modules, those that only some commands need among them."""
    for name in NEEDED + EXTRAS:
        try:
            version = importlib.import_module(name).__version__
        except ImportError as error:
            needed, cure = missing(name, error), "figures and progress bars need it: pip install "
            yield needed if name in NEEDED else (None, needed[1], cure + name)
        else:
            number = tuple(map(int, re.findall(r"\d+", version)[:2]))
            cure = f"pgran needs {dotted(OLDEST_NUMPY)} or later: {INSTALL}"
            yield name != "numpy" or number >= OLDEST_NUMPY, f"{name} {version}", cure


def threads():
    """Find whether the threads of the ranks on this machine are more than the cores they have."""
    chosen = {name: os.environ[name] for name in machine.THREADS if name in os.environ}
    ranks, cores = ranks_and_cores()
    each = max((int(text) for text in chosen.values() if text.isdigit()), default=cores)
    choices = ", ".join(f"{name} is {text}" for name, text in chosen.items())
    text = f"ranks: {ranks}, threads of each: up to {each}, cores: {cores} "
    cure = "more threads than cores get in each other's way: "
    cure += "start fewer ranks" if each == 1 else "export OMP_NUM_THREADS=1"
    good = (ranks * each <= cores and "OMP_NUM_THREADS" in chosen) or None
    yield good, text + f"({choices or 'OMP_NUM_THREADS is not set'})", cure


def ranks_and_cores():
    """Return how many ranks share this machine, and how many cores. Collective where MPI works."""
    # mpirun may tie each rank to a core of its own
    mine = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else range(os.cpu_count())
    MPI = sys.modules.get("mpi4py.MPI")
    if MPI is None:
        return launch.size(), len(mine)
    together = MPI.COMM_WORLD.Split_type(MPI.COMM_TYPE_SHARED)
    everyone = together.allgather(mine)
    together.Free()
    return len(everyone), len(set().union(*everyone))


CHECKS = (python, mpi, petsc, slepc, packages, threads)
