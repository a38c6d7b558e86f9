"""`pgran doctor`: what is installed, what is wrong with it, and how to mend that.

A finding is (good, text, cure): good is True, None for what pgran can do without, or False. This
module and what it imports at once run on Python 3.7 and later.
"""

import glob
import importlib
import os
import re
import shutil
import subprocess
import sys
import tempfile

from pgran.parallel import launch

INSTALL = "bash jobs/setup.sh makes .venv, and .venv/bin/pgran has all it needs"
FIGURES = "figures and progress bars need it: python3-{0} or pip install {0}"
OLDEST_PYTHON, OLDEST_NUMPY = (3, 11), (1, 24)
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
# The libraries of which a program must hold one only.
SINGLE = {"MPI": r"lib(?:mpi|mpich|mpi_cray\w*|mpi_abi)\.so", "PETSc": r"libpetsc\w*\.so"}


def examine(words=()):
    """Print one line for each finding, and return 0, or 1 if pgran cannot run as it is.

    Collective where MPI works: rank 0 prints its own findings, and what is wrong with other ranks.
    """
    found = [finding for check in CHECKS for finding in guarded(check)]
    MPI = sys.modules.get("mpi4py.MPI")
    everyone = MPI.COMM_WORLD.allgather(found) if MPI else [found]
    wrong = [
        (False, f"on rank {rank}: {text}", cure)
        for rank, theirs in enumerate(everyone)
        for good, text, cure in theirs
        if good is False and (good, text, cure) not in found
    ]
    if launch.rank() == 0:
        for good, text, cure in found + wrong:
            print(f"{'ok   ' if good else 'WRONG' if good is False else 'note '} {text}")
            if not good and cure:
                print(f"      -> {cure}")
    return int(any(good is False for good, _, _ in found + wrong))


def guarded(check):
    """Return the findings of a check; an error that it did not foresee is one of them."""
    found = []
    try:
        found.extend(check())
    except Exception as error:
        kind = type(error).__name__
        found.append((False, f"looking for {check.__name__} failed: {kind}: {error}", INSTALL))
    return found


def python():
    """Find the Python that runs this."""
    version = ".".join(map(str, sys.version_info[:3]))
    yield (
        sys.version_info >= OLDEST_PYTHON,
        f"Python {version}, {sys.executable}",
        f"pgran needs {'.'.join(map(str, OLDEST_PYTHON))} or later: {INSTALL}",
    )


def mpi():
    """Find MPI, whether mpirun belongs to it, and whether the ranks know of each other."""
    try:
        from mpi4py import MPI
    except (ImportError, RuntimeError) as error:  # RuntimeError: no MPI library
        yield False, f"mpi4py cannot be imported: {error}", elsewhere("mpi4py")
        return
    name = launch.library(MPI)
    ranks = MPI.COMM_WORLD.size
    yield True, f"mpi4py with {name}, {ranks} rank{'s' if ranks > 1 else ''} here", ""
    cure = "put the mpirun of the MPI that mpi4py was built with first on PATH"
    if launch.size() > 1 and ranks == 1:
        text = f"mpirun started {launch.size()} ranks that do not know of each other: it belongs"
        yield False, f"{text} to another MPI than mpi4py ({name})", cure
    launcher = shutil.which("mpirun")
    if launcher is None:
        yield None, "mpirun is not on PATH", "without it pgran runs on one rank only"
        return
    words = [launcher, "--version"]
    said = subprocess.run(words, capture_output=True, text=True, check=False, timeout=30).stdout
    family = next((f for f in ("Open MPI", "MPICH", "Intel") if f in name), name)
    same = family in said or (family == "MPICH" and "HYDRA" in said.upper())
    text = f"{launcher} {'belongs' if same else 'does not belong'} to {family}"
    yield same, text, "it would start single ranks that do not know of each other: " + cure


def petsc():
    """Find petsc4py, its scalars, and the factorizations it can call."""
    try:
        import petsc4py

        petsc4py.init(["pgran", "-skip_petscrc", "-no_signal_handler"])
        from petsc4py import PETSc
    except ImportError as error:
        yield False, f"petsc4py cannot be imported: {error}", elsewhere("petsc4py")
        return
    version = ".".join(map(str, PETSc.Sys.getVersion()))
    is_complex = PETSc.ScalarType().dtype.kind == "c"
    words = "complex" if is_complex else "real"
    where = os.path.dirname(petsc4py.__file__)
    yield (
        is_complex,
        f"petsc4py {version}, {words} scalars, {where}",
        "pgran needs a complex PETSc: set PETSC_DIR and PETSC_ARCH to one, or " + INSTALL,
    )
    for package, cure in (
        (
            "mumps",
            "lattices of more than about 200 x 200 balls, or shared by ranks, need it: a PETSc "
            "configured with --download-mumps, Debian's and conda-forge's have it",
        ),
        ("superlu_dist", "an alternative to MUMPS; nothing needs it"),
    ):
        found = has_solver(PETSc, package)
        state = "found" if found else "not found"
        yield found or None, f"factorizations by {package}: {state}", cure


def has_solver(PETSc, package):
    """Return whether PETSc can factor a matrix through an outside package."""
    matrix = PETSc.Mat().createAIJ((1, 1), csr=([0, 1], [0], [1.0]), comm=PETSc.COMM_SELF)
    pc = PETSc.PC().create(PETSc.COMM_SELF)
    try:
        pc.setOperators(matrix)
        pc.setType("lu")
        pc.setFactorSolverType(package)
        pc.setUp()
    except PETSc.Error:
        return False
    finally:
        pc.destroy()
        matrix.destroy()
    return True


def slepc():
    """Find slepc4py, and whether it was built for the PETSc at hand."""
    if "petsc4py.PETSc" not in sys.modules:
        return  # petsc4py comes first
    PETSc = sys.modules["petsc4py.PETSc"]
    cure = "set SLEPC_DIR to the SLEPc of this PETSc, or " + INSTALL
    try:
        import slepc4py

        slepc4py.init([])
        from slepc4py import SLEPc
    except ImportError as error:
        yield False, f"slepc4py cannot be imported: {error}", f"normal modes need it: {cure}"
        return
    versions = [".".join(map(str, module.Sys.getVersion())) for module in (SLEPc, PETSc)]
    same = SLEPc.Sys.getVersion()[:2] == PETSc.Sys.getVersion()[:2]
    yield same, f"slepc4py {versions[0]}" + ("" if same else f" on PETSc {versions[1]}"), cure


def numpy():
    """Find NumPy."""
    for good, text, cure in library("numpy"):
        if good:
            numbers = re.findall(r"\d+", sys.modules["numpy"].__version__)
            good = tuple(map(int, numbers[:2])) >= OLDEST_NUMPY
            cure = f"pgran needs {'.'.join(map(str, OLDEST_NUMPY))} or later: {INSTALL}"
        yield good, text, cure


def h5py():
    """Find h5py."""
    return library("h5py")


def scipy():
    """Find SciPy."""
    return library("scipy")


def library(name):
    """Find a module that pgran cannot do without."""
    try:
        module = importlib.import_module(name)
    except ImportError as error:
        yield False, f"{name} cannot be imported: {error}", elsewhere(name)
        return
    yield True, f"{name} {module.__version__}", ""


def elsewhere(module):
    """Return how to get at a missing module: in another interpreter, if one of them has it."""
    here = os.path.abspath(os.path.join(os.path.dirname(__file__), "..", ".."))
    venv = os.path.join(here, ".venv", "bin", "python")
    debian = glob.glob("/usr/lib/petscdir/*-complex") + glob.glob("/usr/lib/petscdir/*/*-complex")
    environment = dict(os.environ)
    environment.pop("PYTHONPATH", None)
    if debian:
        environment.setdefault("PETSC_DIR", debian[0])
    cures = {
        venv: f"this python3 has no {module}, that of .venv has: source {venv[:-6]}activate",
        "/usr/bin/python3": f"this python3 has no {module}, /usr/bin/python3 has: {INSTALL}",
    }
    for interpreter, cure in cures.items():
        if os.path.exists(interpreter) and interpreter != sys.executable:
            words = [interpreter, "-c", f"import {module}"]
            done = subprocess.run(words, env=environment, capture_output=True, check=False)
            if done.returncode == 0:
                return cure
    return INSTALL


def libraries():
    """Find whether all modules that are loaded by now share one MPI, and one PETSc."""
    for name, pattern in SINGLE.items():
        files = sorted(set(re.findall(rf"(?<= )/\S*/{pattern}\S*", memory_map())))
        if len(files) > 1:
            yield (
                False,
                f"the modules bring {len(files)} different {name} libraries: {', '.join(files)}",
                "mpi4py, petsc4py, slepc4py and h5py must come from one source (all from Debian, "
                "all from conda-forge, or all built here): " + INSTALL,
            )


def memory_map():
    """Return what files this process has in memory, where the system tells."""
    try:
        with open("/proc/self/maps") as stream:
            return stream.read()
    except OSError:
        return ""


def extras():
    """Find modules that only some commands need."""
    for name in ("matplotlib", "tqdm"):
        for good, text, _ in library(name):
            yield good or None, text, FIGURES.format(name)


def threads():
    """Find whether the threads of the ranks on this machine are more than the cores they have."""
    given = {name: os.environ[name] for name in THREADS if name in os.environ}
    ranks, cores = ranks_and_cores()
    each = max((int(text) for text in given.values() if text.isdigit()), default=cores)
    said = ", ".join(f"{name} is {text}" for name, text in given.items())
    yield (
        (ranks * each <= cores and "OMP_NUM_THREADS" in given) or None,
        f"{ranks} rank{'s' if ranks > 1 else ''} of up to {each} thread{'s' if each > 1 else ''} "
        f"on {cores} core{'s' if cores > 1 else ''} ({said or 'OMP_NUM_THREADS is not set'})",
        "more threads than cores get in each other's way: "
        + ("start fewer ranks" if each == 1 else "export OMP_NUM_THREADS=1"),
    )


def ranks_and_cores():
    """Return how many ranks share this machine, and how many cores. Collective where MPI works."""
    mine = set(range(os.cpu_count() or 1))
    if hasattr(os, "sched_getaffinity"):  # mpirun may tie each rank to a core of its own
        mine = os.sched_getaffinity(0)
    MPI = sys.modules.get("mpi4py.MPI")
    if MPI is None:
        return launch.size(), len(mine)
    machine = MPI.COMM_WORLD.Split_type(MPI.COMM_TYPE_SHARED)
    everyone = machine.allgather(mine)
    machine.Free()
    return len(everyone), len(set().union(*everyone))


def folder():
    """Find whether results can be written here."""
    where = "results" if os.path.exists("results") else "."
    try:
        with tempfile.TemporaryFile(dir=where):
            pass
    except OSError as error:
        text = f"{os.path.abspath(where)}: cannot be written to: {error.strerror}"
        yield False, text, "go to another folder, or say -output_file"
    else:
        yield True, f"{os.path.abspath(where)} can be written to", ""


CHECKS = (python, mpi, petsc, slepc, numpy, scipy, h5py, libraries, extras, threads, folder)
