"""What `pgran doctor` finds: each finding is made to fire, by fakes of what it looks at."""

import os
import re
import sys
import types
from pathlib import Path

import numpy as np
import pytest

from pgran.command import doctor
from pgran.parallel import launch


@pytest.fixture(autouse=True)
def alone(monkeypatch):
    """Nothing of how the tests were launched."""
    for name in (*launch.RANKS, *launch.SIZES, *doctor.THREADS):
        monkeypatch.delenv(name, raising=False)


def verdict(check, text):
    """The verdict and the cure of the first finding that holds a text."""
    return next((good, cure) for good, said, cure in doctor.guarded(check) if text in said)


def fake(name, **members):
    module = types.ModuleType(name)
    vars(module).update(members)
    return module


def test_nothing_is_wrong_here(monkeypatch, capsys):
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    assert doctor.examine() == 0
    assert "WRONG" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("owner", "name", "version", "good"),
    [
        (sys, "version_info", (3, 10, 4), False),
        (np, "__version__", "1.23.5", False),
        (np, "__version__", "1.24.0", True),
        (np, "__version__", "2.4", True),
    ],
)
def test_old_versions(monkeypatch, owner, name, version, good):
    monkeypatch.setattr(owner, name, version)
    check = doctor.python if owner is sys else doctor.packages
    found, cure = verdict(check, "Python 3.10.4" if owner is sys else f"numpy {version}")
    assert found is good
    assert "or later" in cure


@pytest.mark.parametrize(
    ("check", "module"),
    [
        (doctor.mpi, "mpi4py"),
        (doctor.petsc, "petsc4py"),
        (doctor.slepc, "slepc4py"),
        *((doctor.packages, name) for name in doctor.NEEDED + doctor.EXTRAS),
    ],
)
def test_missing_modules(monkeypatch, check, module):
    """Which a .venv beside the package may have, or not."""
    extra = module in doctor.EXTRAS
    monkeypatch.setitem(sys.modules, module, None)
    good, cure = verdict(check, f"{module} cannot be imported")
    assert good is (None if extra else False)
    assert f"pip install {module}" in cure if extra else "setup.sh" in cure or "activate" in cure


def test_a_python_that_has_what_this_one_lacks(monkeypatch, tmp_path):
    monkeypatch.setattr(doctor, "__file__", str(tmp_path / "pgran" / "command" / "doctor.py"))
    python = tmp_path / ".venv" / "bin" / "python"
    python.parent.mkdir(parents=True)
    for program, said in (("true", True), ("false", False)):
        python.symlink_to(f"/bin/{program}")
        cure = doctor.missing("petsc4py", "")[2]
        assert (f"source {tmp_path}/.venv/bin/activate" in cure) is said
        python.unlink()


def test_what_petsc_lacks(monkeypatch):
    from petsc4py import PETSc

    assert doctor.has_solver(PETSc, "petsc")
    assert not doctor.has_solver(PETSc, "nonsense")
    monkeypatch.setattr(PETSc, "ScalarType", np.float64)
    monkeypatch.setattr(doctor, "has_solver", lambda PETSc, package: False)
    version = fake("Sys", getVersion=lambda: (3, 2, 1))
    foreign = fake("slepc4py", init=lambda words: None, SLEPc=fake("SLEPc", Sys=version))
    monkeypatch.setitem(sys.modules, "slepc4py", foreign)
    for check, text, good, cure in (
        (doctor.petsc, "real scalars", False, "complex"),
        (doctor.petsc, "MUMPS: not found", None, "--download-mumps"),
        (doctor.slepc, "slepc4py 3.2.1 on PETSc", False, "SLEPC_DIR"),
    ):
        found, said = verdict(check, text)
        assert found is good
        assert cure in said


OPEN_MPI = "Open MPI v4.1.4, package: Debian OpenMPI, ident: 4.1.4, repo rev: v4.1.4"
MPICH = "MPICH Version:      5.0.2\nMPICH Release date: Fri Sep 25 20:45:26 UTC 2026\n"


@pytest.mark.parametrize(("mpi", "name"), [(OPEN_MPI, "Open MPI v4.1.4"), (MPICH, "MPICH 5.0.2")])
@pytest.mark.parametrize("output", ["HYDRA build details:", "mpirun (Open MPI) 4.1.4", None])
def test_whose_mpirun(monkeypatch, tmp_path, mpi, name, output):
    assert launch.library(fake("MPI", Get_library_version=lambda: mpi)) == name
    monkeypatch.setattr(launch, "library", lambda MPI: name)
    monkeypatch.setenv("PATH", str(tmp_path))
    if output is None:
        assert verdict(doctor.mpi, "not on PATH")[0] is None
        return
    program = tmp_path / "mpirun"
    program.write_text(f"#!/bin/sh\necho '{output}'\n")
    program.chmod(0o755)
    assert verdict(doctor.mpi, str(program))[0] is ((mpi is MPICH) == ("HYDRA" in output))


MAP = """
7f0-7f1 r-xp 00000000 08:01 1  /usr/lib/libmpi.so.40.30.4
7f1-7f2 rw-p 00000000 08:01 1  /usr/lib/libmpi.so.40.30.4
7f2-7f3 r-xp 00000000 08:01 1  /usr/lib/libmpi_mpifh.so.40.30.0
7f2-7f3 r-xp 00000000 08:01 1  /usr/lib/libpetsc_complex.so.3.18.5
"""


@pytest.mark.parametrize(
    ("more", "name"),
    [
        ("", None),
        ("/opt/mpich/lib/libmpi.so.12.1.1", "MPI"),
        ("/opt/mpich/lib/libmpich.so.12", "MPI"),
        ("/opt/lib/libpetsc.so.3.21", "PETSc"),
    ],
)
def test_mixed_libraries(monkeypatch, more, name):
    assert "libmpi" in doctor.memory_map() or not Path("/proc/self/maps").exists()
    monkeypatch.setattr(doctor, "memory_map", lambda: f"{MAP}7f4-7f5 r-xp 00000000 08:01 1  {more}")
    found = doctor.guarded(doctor.libraries)
    assert len(found) == (name is not None)
    for good, text, _ in found:
        assert good is False
        assert f"2 different {name} libraries" in text
        assert more in text


@pytest.mark.parametrize(
    ("variables", "ranks", "good", "cure"),
    [
        ({"OMP_NUM_THREADS": "1"}, 4, True, ""),
        ({"OMP_NUM_THREADS": "1"}, 5, None, "fewer ranks"),
        ({"OMP_NUM_THREADS": "2"}, 2, True, ""),
        ({"OMP_NUM_THREADS": "2"}, 3, None, "OMP_NUM_THREADS=1"),
        ({"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "4"}, 2, None, "OMP_NUM_THREADS=1"),
        ({}, 1, None, "OMP_NUM_THREADS=1"),
    ],
)
def test_threads(monkeypatch, world, variables, ranks, good, cure):
    """Ranks that mpirun ties to a core each have as many together."""
    assert doctor.ranks_and_cores()[0] == world.size
    assert doctor.ranks_and_cores()[1] >= len(os.sched_getaffinity(0))
    for name, text in variables.items():
        monkeypatch.setenv(name, text)
    monkeypatch.setattr(doctor, "ranks_and_cores", lambda: (ranks, 4))
    ((found, _, said),) = doctor.guarded(doctor.threads)
    assert found is good
    assert cure in said


@pytest.mark.parametrize("variable", launch.RANKS)
def test_what_is_wrong_with_another_rank(monkeypatch, capsys, world, variable):
    """Only the first rank speaks, for the others as well; no error goes unnoticed."""

    def uneven():
        yield (world.rank < 1, "a disk", "mend it")

    def broken():
        raise OSError("no such luck")
        yield

    monkeypatch.setenv(variable, str(world.rank))
    monkeypatch.setattr(doctor, "CHECKS", (uneven,))
    assert doctor.examine() == (world.size > 1)
    lines = [f"WRONG on rank {rank}: a disk" for rank in range(1, world.size)]
    lines = ["ok    a disk", *(words for line in lines for words in (line, "      -> mend it"))]
    assert capsys.readouterr().out.splitlines() == (lines if world.rank == 0 else [])
    monkeypatch.setattr(doctor, "CHECKS", (broken,))
    assert doctor.examine() == 1
    said = "WRONG looking for broken failed: OSError: no such luck"
    assert (said in capsys.readouterr().out) == (world.rank == 0)


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


@pytest.mark.parametrize(
    ("word", "code", "beginning"), [("doctor", 0, "ok    Python"), ("rnu", 2, "pgran: rnu")]
)
def test_ranks_speak_with_one_voice(start, word, code, beginning):
    done = start(word, ranks=2)
    assert done.returncode == code
    lines = (done.stdout + done.stderr).splitlines()
    assert sum(line.startswith(beginning) for line in lines) == 1


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
