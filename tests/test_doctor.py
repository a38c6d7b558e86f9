"""What `pgran doctor` finds: each finding is made to fire, by fakes of what it looks at."""

import os
import re
import subprocess
import sys
import types
from pathlib import Path

import numpy as np
import pytest

from pgran.command import doctor
from pgran.parallel import launch

PROJECT = Path(doctor.__file__).parents[2]
LAUNCHED = (*launch.RANKS, *launch.SIZES)


@pytest.fixture(autouse=True)
def alone(monkeypatch, tmp_path):
    """A folder of its own, and nothing of how the tests were launched."""
    for name in (*LAUNCHED, *doctor.THREADS):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.chdir(tmp_path)


def verdicts(check, text):
    """The verdict and the cure of each finding that holds a text."""
    return [(good, cure) for good, said, cure in doctor.guarded(check) if text in said]


def fake(name, **members):
    module = types.ModuleType(name)
    vars(module).update(members)
    return module


def program(folder, name, output):
    """An executable that only prints, in a folder that is put first on PATH."""
    path = folder / name
    path.write_text(f"#!/bin/sh\necho '{output}'\n")
    path.chmod(0o755)
    return f"{folder}{os.pathsep}{os.environ['PATH']}"


def test_nothing_is_wrong_here(monkeypatch, capsys):
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    assert doctor.examine() == 0
    assert "WRONG" not in capsys.readouterr().out


def test_old_python(monkeypatch):
    monkeypatch.setattr(doctor.sys, "version_info", (3, 10, 4))
    ((good, cure),) = verdicts(doctor.python, "Python 3.10.4")
    assert good is False
    assert "3.11" in cure


@pytest.mark.parametrize(("version", "good"), [("1.23.5", False), ("1.24.0", True), ("2.4", True)])
def test_numpy_version(monkeypatch, version, good):
    monkeypatch.setattr(np, "__version__", version)
    assert verdicts(doctor.numpy, f"numpy {version}")[0][0] is good


@pytest.mark.parametrize(
    ("check", "module"),
    [
        (doctor.mpi, "mpi4py"),
        (doctor.petsc, "petsc4py"),
        (doctor.slepc, "slepc4py"),
        (doctor.numpy, "numpy"),
        (doctor.scipy, "scipy"),
        (doctor.h5py, "h5py"),
    ],
)
def test_missing_modules(monkeypatch, check, module):
    monkeypatch.setitem(sys.modules, module, None)
    ((good, cure),) = verdicts(check, f"{module} cannot be imported")
    assert good is False
    assert "setup.sh" in cure or "activate" in cure


@pytest.mark.parametrize("module", ["matplotlib", "tqdm"])
def test_pgran_runs_without_extras(monkeypatch, module):
    monkeypatch.setitem(sys.modules, module, None)
    ((good, cure),) = verdicts(doctor.extras, f"{module} cannot be imported")
    assert good is None
    assert module in cure


def test_a_python_that_has_what_this_one_lacks(monkeypatch, tmp_path):
    """A .venv beside the package that can import the module, and one that cannot."""
    monkeypatch.setattr(doctor, "__file__", str(tmp_path / "pgran" / "command" / "doctor.py"))
    (tmp_path / ".venv" / "bin").mkdir(parents=True)
    python = tmp_path / ".venv" / "bin" / "python"
    python.symlink_to("/bin/true")
    assert f"source {tmp_path}/.venv/bin/activate" in doctor.elsewhere("petsc4py")
    python.unlink()
    python.symlink_to("/bin/false")
    assert "activate" not in doctor.elsewhere("petsc4py")


def test_real_scalars(monkeypatch):
    from petsc4py import PETSc

    monkeypatch.setattr(PETSc, "ScalarType", np.float64)
    good, cure = verdicts(doctor.petsc, "real scalars")[0]
    assert good is False
    assert "complex" in cure


def test_missing_mumps(monkeypatch):
    monkeypatch.setattr(doctor, "has_solver", lambda PETSc, package: package != "mumps")
    assert verdicts(doctor.petsc, "mumps: not found")[0][0] is None


def test_solvers_that_petsc_lacks():
    from petsc4py import PETSc

    assert doctor.has_solver(PETSc, "petsc")
    assert not doctor.has_solver(PETSc, "nonsense")


def test_slepc_of_another_petsc(monkeypatch):
    def no_init(words):
        pass

    version = fake("Sys", getVersion=lambda: (3, 2, 1))
    foreign = fake("slepc4py", init=no_init, SLEPc=fake("SLEPc", Sys=version))
    monkeypatch.setitem(sys.modules, "slepc4py", foreign)
    good, cure = verdicts(doctor.slepc, "slepc4py 3.2.1 on PETSc")[0]
    assert good is False
    assert "SLEPC_DIR" in cure


OPEN_MPI = "Open MPI v4.1.4, package: Debian OpenMPI, ident: 4.1.4, repo rev: v4.1.4"
MPICH = "MPICH Version:      5.0.2\nMPICH Release date: Fri Sep 25 20:45:26 UTC 2026\n"


@pytest.mark.parametrize(("mpi", "name"), [(OPEN_MPI, "Open MPI v4.1.4"), (MPICH, "MPICH 5.0.2")])
@pytest.mark.parametrize("output", ["HYDRA build details:", "mpirun (Open MPI) 4.1.4"])
def test_whose_mpirun(monkeypatch, tmp_path, mpi, name, output):
    assert launch.library(fake("MPI", Get_library_version=lambda: mpi)) == name
    monkeypatch.setattr(launch, "library", lambda MPI: name)
    monkeypatch.setenv("PATH", program(tmp_path, "mpirun", output))
    found = verdicts(doctor.mpi, str(tmp_path / "mpirun"))
    assert found[0][0] is ((mpi is MPICH) == ("HYDRA" in output))


def test_no_mpirun(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert verdicts(doctor.mpi, "not on PATH")[0][0] is None


@pytest.mark.parametrize("variable", launch.SIZES)
def test_ranks_that_do_not_know_of_each_other(monkeypatch, world, variable):
    if world.size > 1:
        pytest.skip("these do")
    monkeypatch.setenv(variable, "3")
    good, cure = verdicts(doctor.mpi, "3 ranks that do not know of each other")[0]
    assert good is False
    assert "PATH" in cure


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
        ("7f4-7f5 r-xp 00000000 08:01 1  /opt/mpich/lib/libmpi.so.12.1.1\n", "MPI"),
        ("7f4-7f5 r-xp 00000000 08:01 1  /opt/mpich/lib/libmpich.so.12\n", "MPI"),
        ("7f4-7f5 r-xp 00000000 08:01 1  /opt/lib/libpetsc.so.3.21\n", "PETSc"),
    ],
)
def test_mixed_libraries(monkeypatch, more, name):
    monkeypatch.setattr(doctor, "memory_map", lambda: MAP + more)
    found = doctor.guarded(doctor.libraries)
    assert len(found) == (name is not None)
    for good, text, _ in found:
        assert good is False
        assert f"2 different {name} libraries" in text
        assert more.split()[-1] in text


def test_this_process_maps_an_mpi_library():
    """What the check looks at is there to be seen."""
    import mpi4py.MPI  # noqa: F401

    if not Path("/proc/self/maps").exists():
        pytest.skip("no /proc")
    assert "libmpi" in doctor.memory_map()


@pytest.mark.parametrize(
    ("variables", "ranks", "good", "cure"),
    [
        ({"OMP_NUM_THREADS": "1"}, 4, True, ""),
        ({"OMP_NUM_THREADS": "1"}, 5, None, "fewer ranks"),
        ({"OMP_NUM_THREADS": "2"}, 2, True, ""),
        ({"OMP_NUM_THREADS": "2"}, 3, None, "OMP_NUM_THREADS=1"),
        ({"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "4"}, 2, None, "OMP_NUM_THREADS=1"),
        ({"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "4"}, 2, None, "OMP_NUM_THREADS=1"),
        ({}, 1, None, "OMP_NUM_THREADS=1"),
    ],
)
def test_threads(monkeypatch, variables, ranks, good, cure):
    for name, text in variables.items():
        monkeypatch.setenv(name, text)
    monkeypatch.setattr(doctor, "ranks_and_cores", lambda: (ranks, 4))
    ((found, _, said),) = doctor.guarded(doctor.threads)
    assert found is good
    assert cure in said


def test_cores_of_all_ranks_here(world):
    """Ranks that mpirun ties to a core each have as many together."""
    ranks, cores = doctor.ranks_and_cores()
    assert ranks == world.size
    assert cores >= len(os.sched_getaffinity(0))


def test_folder(tmp_path):
    assert doctor.guarded(doctor.folder)[0][0] is True
    (tmp_path / "results").write_text("no folder")
    ((good, text, cure),) = doctor.guarded(doctor.folder)
    assert good is False
    assert str(tmp_path / "results") in text
    assert "-output_file" in cure


def test_unforeseen_errors_are_findings(monkeypatch, capsys):
    def broken():
        yield True, "before", ""
        raise OSError("no such luck")

    monkeypatch.setattr(doctor, "CHECKS", (broken,))
    assert doctor.examine() == 1
    out = capsys.readouterr().out
    assert "ok    before" in out
    assert "WRONG looking for broken failed: OSError: no such luck" in out


@pytest.mark.parametrize("variable", launch.RANKS)
def test_only_the_first_rank_speaks(monkeypatch, capsys, variable):
    monkeypatch.setattr(doctor, "CHECKS", (doctor.python,))
    monkeypatch.setenv(variable, "1")
    assert doctor.examine() == 0
    assert capsys.readouterr().out == ""
    monkeypatch.setenv(variable, "0")
    doctor.examine()
    assert "Python" in capsys.readouterr().out


def test_what_is_wrong_with_another_rank(monkeypatch, capsys, world):
    def uneven():
        yield (world.rank < 1, "a disk", "mend it")

    monkeypatch.setattr(doctor, "CHECKS", (uneven,))
    monkeypatch.setenv("PMI_RANK", str(world.rank))
    assert doctor.examine() == (world.size > 1)
    lines = [f"WRONG on rank {rank}: a disk" for rank in range(1, world.size)]
    lines = ["ok    a disk", *(words for line in lines for words in (line, "      -> mend it"))]
    assert capsys.readouterr().out.splitlines() == (lines if world.rank == 0 else [])


def test_without_any_package(clean_environment):
    """A bare interpreter: every package is named, none is a traceback."""
    done = subprocess.run(
        [sys.executable, "-S", "-m", "pgran", "doctor"],
        env=clean_environment | {"PYTHONPATH": str(PROJECT)}, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 1
    for name in ("mpi4py", "petsc4py", "numpy", "h5py"):
        assert f"WRONG {name} cannot be imported" in done.stdout
    assert "Traceback" not in done.stdout + done.stderr


def test_a_run_without_packages_says_so(clean_environment, tmp_path):
    (tmp_path / "a.opts").write_text("-scene response\n")
    done = subprocess.run(
        [sys.executable, "-S", "-m", "pgran", "run", "a.opts"],
        env=clean_environment | {"PYTHONPATH": str(PROJECT)}, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 1
    assert re.search(r"No module named '\w+': pgran doctor", done.stderr)
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("words", "code", "beginning"), [(["doctor"], 0, "ok    Python"), (["rnu"], 2, "pgran: rnu")]
)
def test_ranks_speak_with_one_voice(clean_environment, tmp_path, words, code, beginning):
    done = subprocess.run(
        ["mpirun", "-n", "2", sys.executable, "-m", "pgran", *words],
        cwd=tmp_path, env=clean_environment, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == code
    lines = (done.stdout + done.stderr).splitlines()
    assert sum(line.startswith(beginning) for line in lines) == 1


def test_singletons_of_a_foreign_mpirun(clean_environment, tmp_path):
    """As Open MPI's mpirun starts a program of another MPI: n copies, each on its own."""
    (tmp_path / "a.opts").write_text("-scene response\n")
    variables = clean_environment | {"PMI_SIZE": "2", "PMI_RANK": "0"}
    for rank, said in (("0", 1), ("1", 0)):
        done = subprocess.run(
            [sys.executable, "-m", "pgran", "run", "a.opts"],
            cwd=tmp_path, env=variables | {"PMI_RANK": rank}, capture_output=True, text=True,
        )  # fmt: skip
        assert done.returncode == 2
        assert done.stderr.count("2 ranks that do not know of each other") == said
