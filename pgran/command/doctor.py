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

from pgran.parallel import launch

INSTALL = "bash jobs/setup.sh makes .venv, and .venv/bin/pgran has all it needs"
OLDEST_PYTHON, OLDEST_NUMPY = (3, 11), (1, 24)
FIGURES = "figures and progress bars need it: python3-{0} or pip install {0}"
NEEDED, EXTRAS = ("numpy", "scipy", "h5py"), ("matplotlib", "tqdm")
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
            if not good:
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
    yield (
        sys.version_info >= OLDEST_PYTHON,
        f"Python {dotted(sys.version_info[:3])}, {sys.executable}",
        f"pgran needs {dotted(OLDEST_PYTHON)} or later: {INSTALL}",
    )


def dotted(version):
    """Return a version as text."""
    return ".".join(map(str, version))


def mpi():
    """Find MPI, whether mpirun belongs to it, and whether the ranks know of each other."""
    try:
        from mpi4py import MPI
    except (ImportError, RuntimeError) as error:  # RuntimeError: no MPI library
        yield missing("mpi4py", error)
        return
    name, ranks = launch.library(MPI), MPI.COMM_WORLD.size
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
    """Find petsc4py, its scalars, and MUMPS."""
    try:
        import petsc4py

        petsc4py.init(["pgran", "-skip_petscrc", "-no_signal_handler"])
        from petsc4py import PETSc
    except ImportError as error:
        yield missing("petsc4py", error)
        return
    version, where = dotted(PETSc.Sys.getVersion()), os.path.dirname(petsc4py.__file__)
    is_complex = PETSc.ScalarType().dtype.kind == "c"
    yield (
        is_complex,
        f"petsc4py {version}, {'complex' if is_complex else 'real'} scalars, {where}",
        "pgran needs a complex PETSc: set PETSC_DIR and PETSC_ARCH to one, or " + INSTALL,
    )
    found = has_solver(PETSc, "mumps")
    yield (
        found or None,
        f"factorizations by MUMPS: {'found' if found else 'not found'}",
        "lattices of more than about 200 x 200 balls, or shared by ranks, need it: a PETSc "
        "configured with --download-mumps, Debian's and conda-forge's have it",
    )


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
    PETSc = sys.modules.get("petsc4py.PETSc")
    if PETSc is None:
        return  # it comes first
    try:
        import slepc4py

        slepc4py.init([])
        from slepc4py import SLEPc
    except ImportError as error:
        yield missing("slepc4py", error)
        return
    version, here = SLEPc.Sys.getVersion(), PETSc.Sys.getVersion()
    yield (
        version[:2] == here[:2],
        f"slepc4py {dotted(version)} on PETSc {dotted(here)}",
        "set SLEPC_DIR to the SLEPc of this PETSc, or " + INSTALL,
    )


def packages():
    """Find the other modules, those that only some commands need among them."""
    for name in NEEDED + EXTRAS:
        try:
            version = importlib.import_module(name).__version__
        except ImportError as error:
            good, text, cure = missing(name, error)
            if name in EXTRAS:
                good, cure = None, FIGURES.format(name)
            yield good, text, cure
            continue
        old = name == "numpy" and tuple(map(int, re.findall(r"\d+", version)[:2])) < OLDEST_NUMPY
        yield (
            not old,
            f"{name} {version}",
            f"pgran needs {dotted(OLDEST_NUMPY)} or later: {INSTALL}",
        )


def missing(module, error):
    """Return the finding of a module that is not here, but may be in the .venv of this folder."""
    here = os.path.abspath(os.path.join(os.path.dirname(__file__), "..", ".."))
    activate = os.path.join(here, ".venv", "bin", "activate")
    python = os.path.join(here, ".venv", "bin", "python")
    cure = INSTALL
    if os.path.exists(python) and python != sys.executable:
        environment = {key: text for key, text in os.environ.items() if key != "PYTHONPATH"}
        words = [python, "-c", f"import {module}"]
        if not subprocess.run(words, env=environment, capture_output=True, check=False).returncode:
            cure = f"this python3 has no {module}, that of .venv has: source {activate}"
    return False, f"{module} cannot be imported: {error}", cure


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


def threads():
    """Find whether the threads of the ranks on this machine are more than the cores they have."""
    given = {name: os.environ[name] for name in THREADS if name in os.environ}
    ranks, cores = ranks_and_cores()
    each = max((int(text) for text in given.values() if text.isdigit()), default=cores)
    said = ", ".join(f"{name} is {text}" for name, text in given.items())
    yield (
        (ranks * each <= cores and "OMP_NUM_THREADS" in given) or None,
        f"ranks: {ranks}, threads of each: up to {each}, cores: {cores} "
        f"({said or 'OMP_NUM_THREADS is not set'})",
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


CHECKS = (python, mpi, petsc, slepc, packages, libraries, threads)
