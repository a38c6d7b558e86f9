"""The command line as users start it: exit codes, messages, ranks that fail. Serial run only."""

import os
import re
import shlex
import subprocess
import sys
import time

import h5py
import numpy as np
import pytest

from pgran import __version__, load
from pgran.command.resolve import SCENES

SMALL = "-scene response -lattice_shape 6,5 -detectors 2,3 -sweep_points 70 -output_progress none\n"
SECONDS = 60  # for a command that takes one or two


@pytest.fixture
def start(clean_environment, tmp_path):
    """Return what runs a command in a folder of its own: `start("run", "a.opts", ranks=2)`."""
    (tmp_path / "a.opts").write_text(SMALL)

    def start(*words, ranks=0, code=None, **variables):
        launcher = ["mpirun", "-n", str(ranks)] if ranks else []
        program = ["-c", code] if code else ["-m", "pgran"]
        return subprocess.run(
            [*launcher, sys.executable, *program, *words],
            cwd=tmp_path,
            env=clean_environment | variables,
            capture_output=True,
            text=True,
            timeout=SECONDS,
        )

    return start


def messages(done):
    """The lines that pgran itself wrote to standard error."""
    return [line for line in done.stderr.splitlines() if line.startswith("pgran")]


def assert_one_line(done, code, *parts):
    """One line that holds all parts, and the exit code."""
    assert done.returncode == code, done.stderr
    lines = messages(done)
    assert len(lines) == 1, done.stderr
    for part in parts:
        assert part in lines[0]
    assert "Traceback" not in done.stderr


def test_run(start, tmp_path):
    done = start("run", "a.opts")
    assert done.returncode == 0, done.stderr
    result = load(tmp_path / "results" / "a.h5")
    assert result.status == "complete"
    assert result.scene == "response"
    assert result.mpi_size == 1
    assert result.pgran_version == __version__
    assert result.command == "pgran run a.opts"
    assert result.slepc_version == "not loaded"
    assert np.all(result.response.converged_reason > 0)


def test_result_repeats_from_its_own_options(start, tmp_path):
    assert start("run", "a.opts", "-bonds_seed", "5").returncode == 0
    first = load(tmp_path / "results" / "a.h5")
    (tmp_path / "b.opts").write_text(first.options)
    assert start("run", "b.opts", "-output_file", "b.h5").returncode == 0
    second = load(tmp_path / "b.h5")
    assert np.array_equal(first.response.displacement, second.response.displacement)
    assert first.bonds_sha256 == second.bonds_sha256


@pytest.mark.parametrize("ranks", [0, 2])
@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (["-sweep_point", "3"], ["-sweep_point", "did you mean -sweep_points?"]),
        (["-detectors", "6,0"], ["detectors", "(6, 0)", "outside the lattice of 6 x 5"]),
        (["-lattice_mass", "0"], ["-lattice_mass 0", "> 0"]),
        (["-ranks_per_lattice", "7"], ["-ranks_per_lattice 7"]),
        (["5"], ["5", "a value without a key"]),
    ],
)
def test_bad_input(start, tmp_path, ranks, words, parts):
    assert_one_line(start("run", "a.opts", *words, ranks=ranks), 2, *parts)
    assert not (tmp_path / "results" / "a.h5").exists()


def test_more_ranks_than_balls(start):
    """PETSc cannot cut two ranks' shares out of one ball: bad input, not a traceback."""
    words = ["-lattice_shape", "1,1", "-detectors", "0,0", "-ranks_per_lattice", "2"]
    assert_one_line(start("run", "a.opts", *words, ranks=2), 2, "-ranks_per_lattice")


def test_bad_line_of_a_file(start, tmp_path):
    (tmp_path / "a.opts").write_text(SMALL + "\n-sweep_max many\n")
    assert_one_line(start("run", "a.opts"), 2, "-sweep_max many", "a.opts, line 3")


@pytest.mark.parametrize("words", [[], ["run"], ["run", "-scene", "response"], ["rum"]])
def test_bad_commands(start, words):
    assert start(*words).returncode == 2


@pytest.mark.parametrize("ranks", [0, 2])
def test_missing_options_file(start, ranks):
    assert_one_line(start("run", "none.opts", ranks=ranks), 4, "none.opts: No such file")


@pytest.mark.parametrize("ranks", [0, 2])
def test_existing_output_is_left_alone(start, tmp_path, ranks):
    words = ["run", "a.opts", "-output_file", "mine.h5"]
    (tmp_path / "mine.h5").write_text("mine")
    done = start(*words, "-output_overwrite", ranks=ranks)
    assert_one_line(done, 4, "mine.h5: exists and is no result of pgran: move it away yourself")
    assert (tmp_path / "mine.h5").read_text() == "mine"
    (tmp_path / "mine.h5").unlink()
    assert start(*words, ranks=ranks).returncode == 0
    first = load(tmp_path / "mine.h5").created
    done = start(*words, ranks=ranks)
    assert_one_line(done, 4, "mine.h5: exists already", "-output_overwrite")
    assert load(tmp_path / "mine.h5").created == first
    assert start(*words, "-output_overwrite", "-sweep_points", "3", ranks=ranks).returncode == 0
    assert len(load(tmp_path / "mine.h5").response.omega) == 3


def test_bonds_file(start, tmp_path):
    assert start("run", "a.opts").returncode == 0
    with h5py.File(tmp_path / "results" / "a.h5") as file, h5py.File(tmp_path / "k.h5", "w") as k:
        for name in ("stiffness_x", "stiffness_y"):
            k[f"lattice/{name}"] = file[f"lattice/{name}"][()]
    text = re.sub("-lattice_shape 6,5", "-bonds_law file -bonds_file k.h5", SMALL)
    (tmp_path / "b.opts").write_text(text)
    assert start("run", "b.opts").returncode == 0
    first, second = (load(tmp_path / "results" / f"{name}.h5") for name in "ab")
    assert np.array_equal(first.response.displacement, second.response.displacement)
    (tmp_path / "k.h5").write_text("no")
    done = start("run", "b.opts", "-output_overwrite", ranks=2)
    assert_one_line(done, 4, "k.h5: not an HDF5 file")


@pytest.mark.parametrize("ranks", [0, 2])
def test_a_hopeless_solver_is_reported_and_marked(start, tmp_path, ranks):
    solver = ["-steady_ksp_type", "gmres", "-steady_pc_type", "none", "-steady_ksp_max_it", "1"]
    done = start("run", "a.opts", *solver, ranks=ranks)
    assert done.returncode == 3, done.stderr
    assert "miss the accuracy" in done.stderr
    result = load(tmp_path / "results" / "a.h5")
    assert result.status == "unconverged"
    assert np.all(result.response.converged_reason <= 0)


@pytest.mark.parametrize("ranks", [0, 2])
@pytest.mark.parametrize(
    ("words", "code", "parts"),
    [
        (["-steady_ksp_type", "nonsense"], 2, ["PETSc: ", "nonsense (KSPSetFromOptions())"]),
        (["-steady_ksp_max_it", "many"], 2, ["PETSc: ", "many", "(KSPSetFromOptions())"]),
        (["-steady_pc_factor_mat_solver_type", "nonsense"], 2, ["PETSc: ", "(KSPSetUp())"]),
    ],
)
def test_a_solver_that_petsc_does_not_know(start, tmp_path, ranks, words, code, parts):
    assert_one_line(start("run", "a.opts", *words, ranks=ranks), code, *parts)
    assert not (tmp_path / "results" / "a.h5").exists()


def test_slepc_does_not_crash_after_an_error(start, tmp_path):
    """Shut down after a wrong type of its ST, SLEPc 3.18 does."""
    (tmp_path / "modes.opts").write_text("-scene modes -lattice_shape 4,4 -normal_st_type nonsense")
    assert_one_line(start("run", "modes.opts"), 2, "nonsense (EPSSetFromOptions())")


def test_an_unused_solver_key_is_a_warning(start):
    done = start("run", "a.opts", "-steady_ksp_typo", "gmres", "-steady_ksp_type", "gmres")
    assert done.returncode == 0
    warnings = [line for line in messages(done) if "not used" in line]
    assert len(warnings) == 1
    assert "-steady_ksp_typo" in warnings[0]


@pytest.mark.parametrize("ranks", [2, 3])
def test_results_do_not_depend_on_the_number_of_ranks(start, tmp_path, ranks):
    assert start("run", "a.opts", "-output_fields").returncode == 0
    done = start("run", "a.opts", "-output_fields", "-output_file", "n.h5", ranks=ranks)
    assert done.returncode == 0, done.stderr
    one, several = load(tmp_path / "results" / "a.h5"), load(tmp_path / "n.h5")
    assert several.mpi_size == ranks
    assert several.bonds_sha256 == one.bonds_sha256
    for name in ("displacement", "error_bound", "iterations", "field", "phase", "phase_slope"):
        found, expected = getattr(several.response, name), getattr(one.response, name)
        assert np.array_equal(found, expected), name


def test_petscrc_is_not_read(start, tmp_path):
    (tmp_path / ".petscrc").write_text("-steady_ksp_type nonsense\n")
    assert start("run", "a.opts").returncode == 0


def test_petsc_options_are_checked(start):
    done = start("run", "a.opts", PETSC_OPTIONS="-sweep_point 3")
    assert_one_line(done, 2, "-sweep_point", "PETSC_OPTIONS")


def test_a_relaxation_too_short_for_a_spectrum(start, tmp_path):
    (tmp_path / "b.opts").write_text("-scene relaxation -lattice_shape 4,3 -detectors 2,1")
    words = ["-relax_steps", "50", "-output_progress", "none"]
    assert "50 steps" in start("run", "b.opts", *words, "-dry_run").stdout
    done = start("run", "b.opts", *words, ranks=2)
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("no spectrum: relax_steps: 51 amplitudes") == 1
    result = load(tmp_path / "results" / "b.h5")
    assert result.status == "complete"
    assert result.relaxation.displacement.shape == (1, 51, 1)
    assert not hasattr(result, "spectrum")
    assert start("plot", "results/b.h5").returncode == 0
    window = ["-spectrum_fit_min", ".2", "-spectrum_fit_max", ".3", "-output_overwrite"]
    done = start("run", "b.opts", *words, *window)
    assert_one_line(done, 2, "spectrum_fit_max: must be at least twice spectrum_fit_min")


# Odd names, help


def test_a_byte_that_is_no_utf8_is_refused_at_once(start, tmp_path):
    """No result could name it; nothing is computed in vain."""
    odd = os.fsdecode(b"a\xff.opts")
    (tmp_path / odd).write_text(SMALL)
    assert_one_line(start("run", odd), 2, "no UTF-8")
    assert_one_line(start("run", "a.opts", "-output_file", odd), 2, "no UTF-8")
    done = start("run", "a.opts", PETSC_OPTIONS=os.fsdecode(b"-bonds_seed \xff"))
    assert_one_line(done, 2, "no UTF-8", "PETSC_OPTIONS")
    assert not (tmp_path / "results").exists()


def test_a_result_of_an_odd_name(start, tmp_path):
    name = 'it\'s a "name"\t#\u00e4;$x\\.h5'
    assert start("run", "a.opts", "-output_file", name).returncode == 0
    first = load(tmp_path / name)
    assert shlex.split(first.command)[-1] == name
    (tmp_path / "b.opts").write_text(first.options, encoding="utf-8")
    assert_one_line(start("run", "b.opts"), 4, "exists already")
    assert start("plot", name).returncode == 0


@pytest.mark.parametrize("words", [["-h"], ["a.opts", "--help"], ["a.opts", "-sweep_point", "-h"]])
def test_help_of_a_run(start, words):
    done = start("run", *words)
    assert (done.returncode, done.stderr) == (0, "")
    assert "pgran run FILE" in done.stdout
    assert ("pgran options response lists the options of a.opts" in done.stdout) == (
        words[0] == "a.opts"
    )


def test_help_of_the_other_commands(start):
    for command in ("options", "doctor", "plot"):
        done = start(command, "-h")
        assert (done.returncode, done.stderr) == (0, "")
        assert "pgran" in done.stdout


# Standard streams


@pytest.fixture
def shell(clean_environment, tmp_path):
    """Return what runs a line of bash, in which $pgran is pgran."""
    (tmp_path / "a.opts").write_text(SMALL)
    environment = clean_environment | {"pgran": f"{sys.executable} -m pgran"}

    def shell(line):
        return subprocess.run(
            ["bash", "-o", "pipefail", "-c", line],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            timeout=SECONDS,
        )

    return shell


@pytest.mark.parametrize(
    "words", ["options", "doctor", "--help", "plot -h", "run a.opts -dry_run", "--version"]
)
def test_output_that_cannot_be_written(shell, words):
    """A full device is an error in a line; a pipe that nobody reads any more is none."""
    assert_one_line(
        shell(f"$pgran {words} >/dev/full"), 4, "standard output: cannot be written: No"
    )
    done = shell(f"$pgran {words} | true")
    assert (done.returncode, done.stderr) == (0, "")
    assert shell(f"$pgran {words} >&-").returncode == 0


@pytest.mark.parametrize("stream", ["2>&-", "2>/dev/full", "<&- >&- 2>&-", "2> >(true)"])
@pytest.mark.parametrize("progress", ["bar", "lines"])
def test_a_run_that_nobody_listens_to(shell, tmp_path, stream, progress):
    done = shell(f"$pgran run a.opts -output_progress {progress} {stream}")
    assert done.returncode == 0
    assert load(tmp_path / "results" / "a.h5").status == "complete"
    assert shell(f"$pgran run a.opts {stream}").returncode == 4


# Nothing that happens after the result is written ends a run


@pytest.mark.parametrize(
    "statement",
    [
        "import ctypes; ctypes.CDLL = None",
        "import pgran.solve.database; pgran.solve.database.unused = None",
        "import pgran.scenes.response as scene; scene.summary = lambda records: [1 / 0]",
        "Path.unlink = lambda path, missing_ok: os.remove('/proc/version')",
    ],
)
def test_trouble_after_the_result(start, tmp_path, statement):
    code = f"""
import os
from pathlib import Path
import pgran.__main__
start, write = pgran.command.run.start_petsc, None
def start_petsc(options):
    start(options)
    from pgran.files import store
    global write
    write, store.write = store.write, late
def late(*arguments):
    write(*arguments)
    {statement}
pgran.command.run.start_petsc = start_petsc
pgran.__main__.console()
"""
    done = start("run", "a.opts", "-steady_ksp_typo", "3", code=code)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    assert "written to results/a.h5" in done.stderr
    assert load(tmp_path / "results" / "a.h5").status == "complete"


def test_warnings_of_libraries_are_one_line(start):
    code = """
import warnings
import pgran.__main__
main = pgran.__main__.main
def warn(words):
    warnings.warn("a first line\\nand another", RuntimeWarning)
    return main(words)
pgran.__main__.main = warn
pgran.__main__.console()
"""
    done = start("--version", code=code)
    assert done.stderr == "pgran: RuntimeWarning: a first line and another\n"


def test_a_missing_scipy_is_said_at_the_start(start, tmp_path):
    code = "import sys; sys.modules['scipy'] = None; import pgran.__main__ as m; m.console()"
    (tmp_path / "c.opts").write_text("-relax_method krylov")
    for words in ("relaxation", "accuracy -accuracy_of relaxation -accuracy_solvers c.opts"):
        (tmp_path / "b.opts").write_text(f"-scene {words}")
        done = start("run", "b.opts", code=code)
        assert_one_line(done, 1, "scipy", "pgran doctor says how to mend it")
    assert os.listdir(tmp_path / "results") == []


# One rank fails


def sabotage(statement, rank=1):
    """A program that is pgran, but executes a statement at the third frequency on one rank."""
    return f"""
import sys
from mpi4py import MPI
import pgran.__main__
start = pgran.command.run.start_petsc
def start_petsc(options):
    start(options)
    from pgran.solve.steady import SteadySolver
    solve, calls = SteadySolver.solve, []
    def fail(self, omega):
        calls.append(omega)
        if MPI.COMM_WORLD.rank == {rank} and len(calls) == 3:
            {statement}
        return solve(self, omega)
    SteadySolver.solve = fail
pgran.command.run.start_petsc = start_petsc
pgran.__main__.console()
"""


@pytest.mark.parametrize(
    ("statement", "code", "message", "rank", "together"),
    [
        ("raise RuntimeError('sabotage')", 1, "RuntimeError: sabotage", 0, 2),
        ("raise MemoryError", 1, "MemoryError", 1, 1),
        ("raise KeyboardInterrupt", 130, "interrupted", 0, 2),
        ("sys.exit(7)", 7, "sys.exit(7)", 1, 1),
        ("sys.exit('words')", 1, "words", 0, 2),
        ("from pgran.errors import FileError; raise FileError('lost')", 4, "lost", 1, 1),
    ],
)
def test_one_failing_rank_ends_all(start, tmp_path, statement, code, message, rank, together):
    began = time.monotonic()
    done = start(
        "run", "a.opts", "-ranks_per_lattice", str(together),
        ranks=2, code=sabotage(statement, rank),
    )  # fmt: skip
    assert done.returncode == code, done.stderr
    assert time.monotonic() - began < 15
    assert message in done.stderr
    assert not (tmp_path / "results" / "a.h5").exists()


# Other commands


def test_version_and_help(start):
    assert start("--version").stdout == f"pgran {__version__}\n"
    for word in ("--help", "-h", "help"):
        done = start(word)
        assert done.returncode == 0
        assert "pgran run FILE" in done.stdout


def test_options(start):
    done = start("options")
    assert done.returncode == 0
    for scene in SCENES:
        assert scene in done.stdout
        assert start("options", scene).stdout
    done = start("options", "respons")
    assert_one_line(done, 2, "did you mean response?")


MODULES = """
import atexit, sys
def tell():
    heavy = "petsc4py.PETSc slepc4py matplotlib scipy mpi4py.MPI h5py numpy".split()
    print("LOADED", *[name for name in heavy if name in sys.modules])
atexit.register(tell)
from pgran.__main__ import console
console()
"""


def loaded(done):
    assert done.returncode == 0, done.stderr
    return re.search("LOADED(.*)", done.stdout).group(1).split()


def test_a_sweep_loads_only_what_it_needs(start):
    names = loaded(start("run", "a.opts", code=MODULES))
    assert names == ["petsc4py.PETSc", "mpi4py.MPI", "h5py", "numpy"]


@pytest.mark.parametrize("words", [["options"], ["--help"], ["--version"]])
def test_questions_load_nothing(start, words):
    assert loaded(start(*words, code=MODULES)) == []
