"""`pgran doctor`: what is installed: MPI, scalar type, solvers; how to mend what is wrong."""

import importlib
import os
import shutil
import subprocess
import sys

INSTALL = "bash jobs/setup.sh makes .venv, and .venv/bin/pgran has all it needs"
FIGURES = "figures, spectra and progress bars need it: python3-{0} or pip install {0}"


def examine():
    """Print one line for each finding and return 0, or 1 if pgran cannot run as it is."""
    findings = [
        *interpreter(),
        *petsc(),
        *slepc(),
        *mpi(),
        *library("numpy", INSTALL),
        *library("h5py", INSTALL),
        *(f for name in ("matplotlib", "scipy", "tqdm") for f in optional(name)),
        *threads(),
        *folder(),
    ]
    for good, text, cure in findings:
        print(f"{'ok   ' if good else 'WRONG' if good is False else 'note '} {text}")
        if not good and cure:
            print(f"      -> {cure}")
    return int(any(good is False for good, _, _ in findings))


def interpreter():
    """Find the Python that runs this."""
    version = ".".join(map(str, sys.version_info[:3]))
    yield sys.version_info >= (3, 11), f"Python {version}, {sys.executable}", "3.11 or later"


def petsc():
    """Find petsc4py, its scalars, and the factorizations it can call."""
    try:
        import petsc4py

        petsc4py.init(["pgran", "-skip_petscrc"])
        from petsc4py import PETSc
    except ImportError as error:
        yield False, f"petsc4py cannot be imported: {error}", INSTALL
        return
    version = ".".join(map(str, PETSc.Sys.getVersion()))
    is_complex = PETSc.ScalarType().dtype.kind == "c"
    words = "complex" if is_complex else "real"
    where = os.path.dirname(petsc4py.__file__)
    yield (
        is_complex,
        f"petsc4py {version}, {words} scalars, {where}",
        ("pgran needs a complex PETSc: set PETSC_DIR and PETSC_ARCH to one, or " + INSTALL),
    )
    for package, cure in (
        ("mumps", "lattices of more than about 200 x 200 balls, or shared by ranks, need it"),
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
    """Find slepc4py."""
    try:
        import slepc4py

        slepc4py.init([])
        from slepc4py import SLEPc
    except ImportError as error:
        yield None, f"slepc4py cannot be imported: {error}", f"normal modes need it: {INSTALL}"
        return
    yield True, f"slepc4py {'.'.join(map(str, SLEPc.Sys.getVersion()))}", ""


def mpi():
    """Find MPI, and whether mpirun belongs to it."""
    try:
        from mpi4py import MPI
    except ImportError as error:
        yield False, f"mpi4py cannot be imported: {error}", INSTALL
        return
    name = MPI.Get_library_version().splitlines()[0].split(",")[0].strip()
    yield True, f"mpi4py with {name}, {MPI.COMM_WORLD.size} rank(s) here", ""
    launcher = shutil.which("mpirun")
    if launcher is None:
        yield None, "mpirun is not on PATH", "without it pgran runs on one rank only"
        return
    words = [launcher, "--version"]
    said = subprocess.run(words, capture_output=True, text=True, check=False).stdout
    family = "Open MPI" if "Open MPI" in name else "MPICH" if "MPICH" in name else name
    same = (family in said) or (family == "MPICH" and "HYDRA" in said.upper())
    yield (
        same,
        f"{launcher} {'belongs to' if same else 'does not belong to'} {family}",
        (
            "it would start single ranks that do not know of each other: put the mpirun of the MPI "
            "that mpi4py was built with first on PATH"
        ),
    )


def library(name, cure):
    """Find a module that pgran cannot do without."""
    try:
        module = importlib.import_module(name)
    except ImportError as error:
        yield False, f"{name} cannot be imported: {error}", cure
        return
    yield True, f"{name} {module.__version__}", ""


def optional(name):
    """Find a module that only some commands need."""
    return ((good or None, text, FIGURES.format(name)) for good, text, _ in library(name, ""))


def threads():
    """Find how many threads a rank would start."""
    count = os.environ.get("OMP_NUM_THREADS")
    yield (
        (count == "1") or None,
        f"OMP_NUM_THREADS is {count or 'not set'}",
        ("with one rank a core, more threads get in each other's way: export OMP_NUM_THREADS=1"),
    )


def folder():
    """Find whether results can be written here."""
    writable = os.access(".", os.W_OK)
    yield (
        writable,
        f"this folder can{'' if writable else 'not'} be written to",
        ("results go to results/ here unless -output_file says otherwise"),
    )
