"""What `pgran doctor` finds: each finding is made to fire, by fakes of what it looks at."""

import ast
import os
import re
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from pgran.command import doctor
from pgran.run import launch, machine


@pytest.fixture(autouse=True)
def alone(monkeypatch):
    """Nothing of how the tests were launched."""
    for name in (*launch.RANKS, *launch.SIZES, *machine.THREADS):
        monkeypatch.delenv(name, raising=False)


def verdict(check, text):
    """The verdict and the cure of the first finding that holds a text."""
    return next((good, cure) for good, said, cure in doctor.guarded(check) if text in said)


def test_nothing_is_wrong_here(monkeypatch, capsys):
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    assert doctor.examine() == 0
    assert "WRONG" not in capsys.readouterr().out


OLD = SimpleNamespace(getVersion=lambda: (3, 2, 1), hasExternalPackage=lambda package: False)
NO_MUMPS, OTHER_SLEPC = {"petsc4py.PETSc.Sys": OLD}, {"slepc4py.SLEPc.Sys": OLD}
OPEN_MPI = "Open MPI v4.1.4, package: Debian OpenMPI, ident: 4.1.4, repo rev: v4.1.4"
MPICH = "MPICH Version:      5.0.2\nMPICH Release date: Fri Sep 25 20:45:26 UTC 2026\n"


def mpirun_of(library, said):
    """Fakes of an MPI library, and of what an mpirun says of itself."""
    name = launch.library(SimpleNamespace(Get_library_version=lambda: library))
    return {
        "pgran.run.launch.library": lambda MPI: name,
        "shutil.which": lambda program: program,
        "subprocess.run": lambda *words, **how: SimpleNamespace(stdout=said),
    }


def ranks(ranks, **variables):
    """A fake of ranks on four cores."""
    return {"pgran.command.doctor.ranks_and_cores": lambda: (ranks, 4)} | variables


@pytest.mark.parametrize(
    ("check", "fakes", "text", "good", "cure"),
    [
        (doctor.python, {"sys.version_info": (3, 10, 4)}, "Python 3.10.4", False, "3.11 or later"),
        (doctor.packages, {"numpy.__version__": "1.23.5"}, "numpy 1.23.5", False, "1.24 or later"),
        (doctor.petsc, {"petsc4py.PETSc.ScalarType": np.float64}, "real sc", False, "complex"),
        (doctor.petsc, NO_MUMPS, "MUMPS: not found", None, "--download-mumps"),
        (doctor.slepc, OTHER_SLEPC, "slepc4py 3.2.1 on PETSc", False, "SLEPC_DIR"),
        (doctor.mpi, {"shutil.which": lambda program: None}, "not on PATH", None, "one rank only"),
        (doctor.mpi, mpirun_of(OPEN_MPI, "HYDRA"), "not belong to Open MPI", False, "on PATH"),
        (doctor.mpi, mpirun_of(MPICH, "(Open MPI) 4"), "not belong to MPICH", False, "on PATH"),
        (doctor.mpi, mpirun_of(MPICH, "HYDRA"), "belongs to MPICH", True, ""),
        (doctor.threads, ranks(4, OMP_NUM_THREADS="1"), "threads", True, ""),
        (doctor.threads, ranks(5, OMP_NUM_THREADS="1"), "threads", None, "fewer ranks"),
        (doctor.threads, ranks(3, OMP_NUM_THREADS="2"), "threads", None, "OMP_NUM_THREADS=1"),
        (doctor.threads, ranks(2, OMP_NUM_THREADS="1", MKL_NUM_THREADS="4"), "threads", None, "=1"),
        (doctor.threads, ranks(1), "threads", None, "OMP_NUM_THREADS=1"),
        (doctor.mpi, {"mpi4py": None}, "mpi4py cannot be imported", False, "setup.sh|activate"),
        (doctor.petsc, {"petsc4py": None}, "petsc4py cannot be", False, "setup.sh|activate"),
        (doctor.slepc, {"slepc4py": None}, "slepc4py cannot be", False, "setup.sh|activate"),
        (doctor.packages, {"scipy": None}, "scipy cannot be imported", False, "setup.sh|activate"),
        (doctor.packages, {"matplotlib": None}, "matplotlib cannot be", None, "pip install"),
    ],
)
def test_findings(monkeypatch, check, fakes, text, good, cure):
    """Fakes are values of names in modules, variables of the environment, and missing modules."""
    for name, value in fakes.items():
        if value is None:
            monkeypatch.setitem(sys.modules, name, None)
        elif "." in name:
            monkeypatch.setattr(name, value)
        else:
            monkeypatch.setenv(name, value)
    found, said = verdict(check, text)
    assert found is good
    assert re.search(cure, said)


def test_a_venv_that_is_not_active(monkeypatch, tmp_path):
    """Beside the package."""
    monkeypatch.setattr(doctor, "__file__", str(tmp_path / "pgran" / "command" / "doctor.py"))
    assert doctor.missing("petsc4py", "")[2] == doctor.INSTALL
    activate = tmp_path / ".venv" / "bin" / "activate"
    activate.parent.mkdir(parents=True)
    activate.touch()
    assert doctor.missing("petsc4py", "")[2].startswith(f"source {activate}")


SWEEP = "import pgran; pgran.sweep(pgran.Lattice.random((3, 3)), [0.3], [(1, 1)])"
MPI_SEEN = "; import os; assert 'OMPI_MCA_pml' not in os.environ"


@pytest.mark.parametrize("words", [["-m", "pgran", "doctor"], ["-c", SWEEP + MPI_SEEN]])
def test_open_mpi_starts_no_daemon_where_a_process_is_alone(start, shared_path, words):
    """For which it would need ssh; nor does a process inherit that it is alone."""
    for name in ("sh", "env"):
        (shared_path / name).symlink_to(shutil.which(name))
    done = start(program=[sys.executable, *words], PATH=str(shared_path))
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("variable", launch.RANKS)
def test_what_is_wrong_with_another_rank(monkeypatch, capsys, world, variable):
    """Only the first rank speaks, for the others as well; no error goes unnoticed.

    Ranks that mpirun ties to a core each have as many together.
    """

    def uneven():
        yield (world.rank < 1, "a disk", "mend it")
        raise OSError("no such luck")

    ranks, cores = doctor.ranks_and_cores()
    assert ranks == world.size
    assert cores >= len(os.sched_getaffinity(0))
    monkeypatch.setenv(variable, str(world.rank))
    monkeypatch.setattr(doctor, "CHECKS", (uneven,))
    assert doctor.examine() == 1
    failed = "WRONG looking for uneven failed: OSError: no such luck"
    lines = [f"WRONG on rank {rank}: a disk" for rank in range(1, world.size)]
    said = [line for line in capsys.readouterr().out.splitlines() if "      -> " not in line]
    assert said == (["ok    a disk", failed, *lines] if world.rank == 0 else [])


# Programs


def test_without_any_package(start):
    """A bare interpreter: every package is named, and nothing ends in a traceback."""
    bare = [sys.executable, "-S", "-m", "pgran"]
    project = str(Path(doctor.__file__).parents[2])
    done = start("doctor", program=bare, PYTHONPATH=project)
    assert done.returncode == 1
    for name in ("mpi4py", "petsc4py", "numpy", "h5py"):
        assert f"WRONG {name} cannot be imported" in done.stdout
    run = start("run", "a.opts", program=bare, PYTHONPATH=project)
    assert run.returncode == 1
    assert re.search(r"No module named '\w+': pgran doctor", run.stderr)
    assert "Traceback" not in done.stdout + done.stderr + run.stderr


def test_old_pythons_can_read_what_the_doctor_loads(start):
    """Which tells them that they are too old."""
    code = "import sys; from pgran.command import doctor; import pgran.__main__; "
    code += "print(*(m.__file__ for n, m in sys.modules.items() if n.startswith('pgran')))"
    for path in start(program=[sys.executable, "-c", code]).stdout.split():
        ast.parse(Path(path).read_text(), feature_version=(3, 7))


def test_ranks_that_do_not_know_of_each_other(start, call, monkeypatch):
    """As Open MPI's mpirun starts a program of another MPI: n copies, each on its own."""
    said = "3 ranks that do not know of each other"
    done = start("run", "a.opts", PMI_SIZE="3", PMI_RANK="1")  # the first one says it
    assert (done.returncode, done.stderr) == (2, "")
    for variable in launch.SIZES:
        with monkeypatch.context() as launched:
            launched.setenv(variable, "3")
            assert verdict(doctor.mpi, said)[0] is False
            done = call("run", "a.opts")
        assert done.returncode == 2
        assert said in done.stderr
