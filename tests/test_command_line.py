"""The command line: exit codes, messages, results; as a program of its own where it must be."""

import os
import re
import shlex
import signal
import sys
import time

import h5py
import numpy as np
import pytest
from campaigns import inject
from samples import random_lattice

import pgran
import pgran.__main__ as program
from pgran import __version__, load
from pgran.errors import FileError
from pgran.medium.base import record_of
from pgran.medium.network_file import write_network
from pgran.store import file as store

OPENING = "pgran: response of a 6 x 5 lattice, bonds uniform on [0, 0.25], seed 1993, beta 0.003, "


def assert_one_line(done, code, *parts):
    """One line that holds all parts, after what is to be solved if work began; the exit code.

    MPI may add that ranks called for an abort.
    """
    assert done.returncode == code, done.stderr
    lines = re.split(r"^(?:-----|\[|Abort)", done.stderr, flags=re.MULTILINE)[0].splitlines()
    (line,) = (line for line in lines if not line.startswith(OPENING))
    assert line.startswith("pgran")
    assert [part for part in parts if part not in line] == []
    assert "Traceback" not in done.stderr


# Experiments


def test_a_run_and_its_own_options(call, place, shared_path, world):
    """Which repeat it, as do its bonds. A result is replaced only if that is asked for."""
    words = ["run", "a.opts", "-bonds_seed", "5"]
    assert call(*words).returncode == 0
    first = load(shared_path / "results" / "a.h5")
    assert (first.status, first.scene, first.pgran_version) == ("complete", "response", __version__)
    assert first.mpi_size == world.size
    assert first.command == "pgran run a.opts -bonds_seed 5"
    assert np.all(first.response.converged_reason > 0)
    name = 'it\'s a "name"\t#\u00e4;$x\\.h5'
    place("b.opts", first.options)
    assert call("run", "b.opts", "-output_file", name).returncode == 0
    second = load(shared_path / name)
    assert shlex.split(second.command)[-1] == name
    place("c.opts", second.options)
    assert_one_line(call("run", "c.opts"), 4, "exists already")
    bonds = ["-bonds_law", "file", "-bonds_file", "results/a.h5", "-output_file", "c.h5"]
    assert call("run", "a.opts", *bonds).returncode == 0
    for again in (second, load(shared_path / "c.h5")):
        assert np.array_equal(first.response.displacement, again.response.displacement)
        assert first.bonds_sha256 == again.bonds_sha256
    assert_one_line(call(*words), 4, "a.h5: exists already", "-output_overwrite")
    assert load(shared_path / "results" / "a.h5").created == first.created
    assert call(*words, "-output_overwrite", "-sweep_points", "3").returncode == 0
    assert len(load(shared_path / "results" / "a.h5").response.omega) == 3
    if world.size == 1:
        assert call("plot", name).returncode == 0


BETA = "beta 0.003, omega_mx 1, "
SMALL = "-lattice_shape 4,3"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (f"response {SMALL} -detectors 2,1 -bonds_law constant -sweep_omega .3 -lattice_damping .1",
         "response of a 4 x 3 lattice, bonds all 0.25, beta 0.1, omega_mx 1, "),
        (f"modes {SMALL} -bonds_law bimodal -bonds_kmax 1",
         "modes of a 4 x 3 lattice, bonds 1 with probability 0.5, else 0, seed 1993, "
         "beta 0.003, omega_mx 2, "),
        (f"modes {SMALL} -bonds_law hertz -bonds_force 2 -bonds_hertz 4 -bonds_kmax .25",
         "modes of a 4 x 3 lattice, bonds by Hertz's law with c = 4, of exponential "
         "forces of mean 2, seed 1993, beta 0.003, omega_mx 1, "),
        ("modes -network_file a.h5", "modes of the network a.h5, 2 free balls, 3 contacts, "
         "scalar displacements, beta 0.003, omega_mx 1, "),
        (f"ensemble -ensemble_of modes {SMALL} -ensemble_samples 3 -bonds_seed 7",
         "ensemble of modes of 3 lattices of 4 x 3, bonds uniform on [0, 0.25], seeds 7 to 9, "
         "omega_mx 1, "),
        (f"ensemble {SMALL} -detectors 2,1 -ensemble_samples 3 -sweep_points 2",
         "ensemble of response of 3 lattices of 4 x 3, bonds uniform on [0, 0.25], "
         f"seeds 1993 to 1995, {BETA}"),
        ("continuum -sweep_points 3", "continuum of a homogeneous box of 1 x 1, beta 0.003, "),
    ],
)  # fmt: skip
def test_a_run_begins_with_what_it_solves(call, place, world, words, said):
    """In a line, once, however many samples there are; so does a dry run."""
    chain = {"bond": [[0, 1], [1, 2], [2, 3]], "held": [2, 0, 0, 1]}
    chain |= {"stiffness": [0.25, 0.5, 0.125], "mass": np.ones(4)}
    place("a.h5", write_network, chain, {"displacement": "scalar", "damping": 0.003})
    place("b.opts", f"-scene {words} -output_progress none")
    ranks = "1 rank" if world.size == 1 else f"{world.size} ranks"
    done = call("run", "b.opts")
    assert done.stderr.splitlines()[0] == f"pgran: {said}{ranks}"
    assert done.stderr.count(f"{said}{ranks}") == 1
    assert done.stderr.count("omega_mx") + done.stderr.count("box") < 3
    dry = call("run", "b.opts", "-dry_run", "-output_file", "c.h5")
    assert dry.stdout.splitlines()[0] == f"run       {said}{ranks}"
    assert dry.stdout.count(said) == 1
    assert said not in dry.stderr


def test_results_do_not_depend_on_the_number_of_ranks(call, start, shared_path):
    """Nor is a .petscrc read, or SLEPc loaded, by a program of its own."""
    assert call("run", "a.opts", "-output_fields").returncode == 0
    (shared_path / ".petscrc").write_text("-steady_ksp_type nonsense\n")
    done = start("run", "a.opts", "-output_fields", "-output_file", "n.h5", ranks=3)
    assert done.returncode == 0, done.stderr
    one, several = load(shared_path / "results" / "a.h5"), load(shared_path / "n.h5")
    assert (several.mpi_size, several.slepc_version) == (3, "not loaded")
    assert several.bonds_sha256 == one.bonds_sha256
    for name in ("displacement", "error_bound", "iterations", "field", "phase", "phase_slope"):
        np.testing.assert_array_equal(
            getattr(several.response, name), getattr(one.response, name), name
        )


def test_a_hopeless_solver_is_reported_and_marked(call, shared_path):
    """And a key that nothing used."""
    words = "-steady_ksp_type gmres -steady_pc_type none -steady_ksp_max_it 1 -steady_ksp_typo 1"
    done = call("run", "a.opts", *words.split())
    assert done.returncode == 3, done.stderr
    opening, *lines = done.stderr.splitlines()
    wrong = [line.startswith("pgran: warning: ") for line in lines]
    assert wrong == sorted(wrong, reverse=True)  # before all figures
    assert opening.startswith(OPENING)
    assert "miss the accuracy" in lines[0]
    unused = [line for line in done.stderr.splitlines() if "not used" in line]
    assert ["-steady_ksp_typo" in line for line in unused] == [True]
    result = load(shared_path / "results" / "a.h5")
    assert result.status == "unconverged"
    assert np.all(result.response.converged_reason <= 0)


def test_inaccurate_results_have_an_exit_code(start):
    """Which mpirun passes on; -log_view is still written."""
    words = "-steady_ksp_type gmres -steady_pc_type none -steady_ksp_max_it 1 -log_view"
    done = start("run", "a.opts", *words.split(), ranks=2)
    assert done.returncode == 3, done.stderr
    assert "PETSc Performance Summary" in done.stdout


@pytest.mark.filterwarnings("error:.*unclosed")
@pytest.mark.filterwarnings("error::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize(
    ("name", "replacement"),
    [
        ("pgran.run.petsc.unused", None),
        ("pgran.experiments.response.scene.summary", lambda records: [1 / 0]),
        ("pathlib.Path.unlink", lambda path, missing_ok: os.remove("/proc/version")),
    ],
)
def test_trouble_after_the_result(call, shared_path, monkeypatch, name, replacement):
    """Nothing that happens after the result is written ends a run."""
    write = store.write

    def late(*arguments):
        write(*arguments)
        monkeypatch.setattr(name, replacement)

    monkeypatch.setattr(store, "write", late)
    done = call("run", "a.opts", "-steady_ksp_typo", "3")
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    assert load(shared_path / "results" / "a.h5").status == "complete"


# What is refused


@pytest.mark.parametrize(
    ("words", "ranks", "parts"),
    [
        ("run a.opts -steady_ksp_type nonsense", 2, ["PETSc: ", "nonsense (KSPSetFromOptions())"]),
        ("run a.opts -steady_pc_factor_mat_solver_type nonsense", 0, ["PETSc: ", "(KSPSetUp())"]),
    ],
)
def test_bad_input_is_told_once(start, shared_path, words, ranks, parts):
    """As programs: PETSc, too, ends in order after an error of its own, and nothing is left."""
    assert_one_line(start(*words.split(), ranks=ranks), 2, *parts)
    assert not [*shared_path.glob("results/*")]


def test_bad_lines_and_names(call, place, shared_path, monkeypatch):
    """Refused before any work, as is a name that is no UTF-8, which no result could hold."""
    for words, said in (
        ("-detectors 6,0", "-detectors: ball (6, 0) is outside the lattice of 6 x 5"),
        ("-lattice_shape 1,1 -detectors 0,0 -ranks_per_lattice 2", "-ranks_per_lattice"),
    ):
        assert_one_line(call("run", "a.opts", *words.split()), 2, said)
    place("b.opts", "-scene response\n\n-sweep_max many\n")
    assert_one_line(call("run", "b.opts"), 2, "-sweep_max many", "b.opts, line 3")
    odd = os.fsdecode(b"a\xff.opts")
    assert_one_line(call("run", odd), 2, "no UTF-8")
    assert_one_line(call("run", "a.opts", "-output_file", odd), 2, "no UTF-8")
    monkeypatch.setenv("PETSC_OPTIONS", os.fsdecode(b"-bonds_seed \xff"))
    assert_one_line(call("run", "a.opts"), 2, "no UTF-8", "PETSC_OPTIONS")
    assert not [*shared_path.glob("results/*")]


def test_a_missing_scipy_is_said_at_the_start(start, shared_path):
    code = "import sys; sys.modules['scipy'] = None; import pgran.__main__ as m; m.console()"
    (shared_path / "b.opts").write_text("-scene relaxation")
    done = start("run", "b.opts", program=[sys.executable, "-c", code])
    assert_one_line(done, 1, "scipy", "pgran doctor says how to mend it")
    assert [*shared_path.glob("results/*")] == []


# Standard streams


@pytest.fixture
def shell(start):
    """Return what runs a line of bash, in which $pgran is pgran."""
    pgran = f"{sys.executable} -m pgran"
    return lambda line: start("-o", "pipefail", "-c", line, program=["bash"], pgran=pgran)


@pytest.mark.parametrize("words", ["plot -h", "run a.opts -dry_run"])
def test_output_that_cannot_be_written(shell, words):
    """A full device is an error in a line; a pipe that nobody reads any more is none."""
    full = shell(f"$pgran {words} >/dev/full")
    assert_one_line(full, 4, "standard output: cannot be written: No")
    done = shell(f"$pgran {words} | true")
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize(
    ("stream", "progress"),
    [("2>&-", "bar"), ("<&- >&- 2>/dev/full", "lines"), ("2> >(true)", "lines")],
)
def test_a_run_that_nobody_listens_to(shell, shared_path, stream, progress):
    assert shell(f"$pgran run a.opts -output_progress {progress} {stream}").returncode == 0
    assert load(shared_path / "results" / "a.h5").status == "complete"
    if stream == "2>&-":
        assert shell(f"$pgran run a.opts {stream}").returncode == 4


def test_a_plot_without_a_folder_for_matplotlib(start, call, shared_path):
    assert call("run", "a.opts").returncode == 0
    code = "import resource as r; r.setrlimit(r.RLIMIT_FSIZE, (0, r.RLIM_INFINITY)); "
    code += "import pgran.__main__ as m; m.console()"
    program = [sys.executable, "-c", code]
    done = start("plot", "results/a.h5", program=program, MPLCONFIGDIR="/proc/nothing")
    assert done.returncode == 4
    assert "let MPLCONFIGDIR name one" in done.stderr.splitlines()[-1]  # after matplotlib's own
    assert "Traceback" not in done.stderr


def test_a_signal_while_a_network_is_read(start, place, shared_path):
    """It stops the run in order; the process that tries the file does not hear of it."""
    write_network(
        shared_path / "net.h5",
        {"bond": [[0, 1], [1, 2]], "stiffness": [1.0, 2.0], "held": [2, 0, 1], "mass": np.ones(3)},
        {"displacement": "scalar", "damping": 0.1},
    )
    place("b.opts", "-scene response -network_file net.h5 -detectors 1 -sweep_points 3")
    tell = "import os, threading; threading.Timer(.1, os.killpg, (os.getpgrp(), 10)).start()"
    fault = inject.words("before pgran.store.file:try_apart", tell)
    done = start("run", "b.opts", program=["setsid", "--wait", sys.executable, *fault])
    assert done.returncode == 75, done.stderr
    assert "stopped by SIGUSR1 before any work was finished" in done.stderr


def test_a_stop_that_meets_the_trial_of_a_file_says_nothing_of_it(tmp_path, monkeypatch):
    """Whoever stops all processes of a job tells the run, which ends in order."""
    (tmp_path / "asked.py").write_text("import os\nfor n in (10, 15): os.kill(os.getpid(), n)")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    store.try_apart(tmp_path / "asked.py", "asked")
    assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) == before


@pytest.mark.parametrize(
    ("words", "array"),
    [
        ("plot a.h5", "pulse/displacement"),
        ("plot a.h5", "lattice/stiffness_x"),
        ("compare a.h5 a.h5 -o b.png", "pulse/displacement"),
    ],
)
def test_results_that_were_edited(call, shared_path, world, words, array):
    """What nobody could foresee in them, or what is impossible, is said to be theirs, in a line."""
    if world.size > 1:
        pytest.skip("one rank reads results")
    found = pgran.pulse(random_lattice((4, 3)), [2, 1], width=3.0, time=90.0, points=91)
    facts = {"scene": "pulse", "status": "complete", "bonds_sha256": ""}
    store.write(shared_path / "a.h5", facts, [record_of(random_lattice((4, 3))), found])
    assert call(*words.split()).returncode == 0
    with h5py.File(shared_path / "a.h5", "r+") as file:
        file[array][:] = np.nan
    assert_one_line(call(*words.split()), 4, "a.h5: ", "changed since (no seal)")


# Errors that nobody foresaw: tests/test_faults.py has more of them


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (MemoryError(), 1, "MemoryError"),
        (RuntimeError("sabotage"), 1, "RuntimeError: sabotage"),
        (KeyboardInterrupt("interrupted; told"), 130, "interrupted; told"),
        (SystemExit(7), 7, "sys.exit(7)"),
        (FileError("lost"), 4, "lost"),
    ],
)
def test_exit_codes_of_errors(error, code, said):
    found, text = program.explain(error)
    assert found == code
    assert said in text


def test_ranks_of_a_script_start_petsc_together(start):
    """Which method finds modes of a network rank 0 decides alone, and it is the first to ask."""
    code = (
        "import pgran; from pgran.medium.crystals import random_geometric\n"
        "modes = pgran.find_modes(random_geometric(700, 2), targets=[0.2], count=3)\n"
        "print(modes.count_certified)"
    )
    done = start("-c", code, ranks=2, program=[sys.executable])
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("True") == 2


def test_one_failing_rank_ends_all(start, shared_path):
    began = time.monotonic()
    statement = f"import os; os.kill(os.getpid(), {signal.SIGINT:d})"
    fault = [sys.executable, *inject.words(inject.UNIT, statement, 1, 2)]
    done = start("run", "a.opts", "-ranks_per_lattice", "1", ranks=2, program=fault)
    assert_one_line(done, 130, "(rank 1): interrupted; what is finished is kept", "same command")
    assert time.monotonic() - began < 15
    assert not (shared_path / "results" / "a.h5").exists()


HIT = """
import os, signal, sys
from pgran.__main__ import console
from pgran.run import launch
def hit(event, words):
    if event == "import" and words[0] == "mpi4py.MPI" and launch.rank() == 1:
        os.system(f"(sleep DELAY; kill -NUMBER {os.getpid()}) &")
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.addaudithook(hit)
console()
"""


@pytest.mark.parametrize(("number", "delay", "code"), [(2, 0, 130), (15, 0.03, 75)])
def test_a_signal_to_one_rank_while_mpi_starts(start, number, delay, code):
    """Before it is known to the others, and when they wait for it."""
    hit = HIT.replace("NUMBER", str(number)).replace("DELAY", str(delay))
    words = ["timeout", "-k", "1", "20", sys.executable, "-c", hit]
    done = start("run", "a.opts", ranks=2, program=words)
    assert done.returncode == code, done.stderr
    assert done.stderr.count("pgran") <= 2, done.stderr


CALL = """
import sys, numpy, pgran
from mpi4py import MPI
rank, asked = MPI.COMM_WORLD.rank, {"omegas": [0.1, 0.2], "detectors": [(2, 2)]}
def make(seed=0):
    if rank == 1 and seed > 1993: PLANTED
    return pgran.Lattice.random((4, 4), seed)
pgran.sweep(make(), **asked)
"""
AFTER, WITHIN = (
    "make(1994); pgran.sweep(make(), **asked)",
    "pgran.ensemble('response', 8, lattice=make, **asked)",
)
SHARED = """
from pgran.driven.operators import Operators
from pgran.medium.lattice import Lattice
def combine(self, s):
    PLANTED
Lattice.is_large = True
if rank == 1: Operators.combine = combine
pgran.sweep(make(), method="points", **asked)
"""


@pytest.mark.parametrize(
    ("planted", "where", "launcher", "code", "said"),
    [
        ("1 / 0", AFTER, [], 1, "ZeroDivisionError ends this script"),
        ("1 / 0", SHARED, [], 1, "ZeroDivisionError ends this script"),
        ("sys.exit(3)", AFTER, ["-m", "mpi4py"], 3, "ended with exit code 3"),
        ("sys.exit(3)", WITHIN, [], 3, r"ended by sys\.exit\(3\)"),
    ],
)
def test_what_ends_a_script_on_one_rank_ends_all(start, planted, where, launcher, code, said):
    """Outside pgran, after a call, in a function that is handed in, and on a shared lattice."""
    words = ["timeout", "-k", "1", "20", sys.executable, *launcher, "-c"]
    done = start((CALL + where).replace("PLANTED", planted), ranks=2, program=words)
    assert done.returncode == code, done.stderr
    lines = re.findall(rf"^.*{said}.*, and so all ranks end$", done.stderr, re.MULTILINE)
    assert len(lines) == 1, done.stderr
    assert ("Traceback" in done.stderr) == ("sys.exit" not in planted)


def test_a_strict_ulimit_is_refused(start):
    strict = ["sh", "-c", 'ulimit -v 400000; exec timeout -k 1 20 "$@"', "sh"]
    done = start("run", "a.opts", program=[*strict, sys.executable, "-m", "pgran"])
    assert_one_line(done, 2, "ulimit -v 400000: too little memory", "it takes 524288, or unlimited")


def test_linear_algebra_needs_no_memory_later(start):
    """OpenBLAS waits for ever for its buffer where there is no room for one."""
    code = (
        "import numpy, resource as r; from pgran.run import petsc\n"
        "used = 4096 * int(open('/proc/self/statm').read().split()[0])\n"
        "r.setrlimit(r.RLIMIT_AS, (used + 2**25, used + 2**25))\n"
        "print(numpy.linalg.inv(numpy.eye(3))[0, 0])"
    )
    done = start(program=["timeout", "-k", "1", "20", sys.executable, "-c", code])
    assert done.stdout == "1.0\n", done.stderr
