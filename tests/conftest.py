"""What all tests share: PETSc started once, and ranks that agree on every test's outcome.

The same suite runs on one rank and under mpirun (`mpirun -n 2 python -m mpi4py -m pytest -q`).
A test that fails on some ranks only would leave the others waiting in a collective call: so the
ranks compare outcomes after each test, and end the whole run where they differ or one is missing.
"""

# ruff: noqa: E402 (PETSc is started before anything imports it)

import contextlib
import faulthandler
import io
import logging
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

from pgran.run import launch

os.environ.pop("PETSC_OPTIONS", None)
launch.start()  # first: PETSc may have no MPI library of its own

import petsc4py

petsc4py.init(["pytest", "-skip_petscrc"])

import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc
from samples import option_values

import pgran.__main__ as program
from pgran.command import run as running
from pgran.run import streams
from pgran.run.petsc import holding
from pgran.store import file as store

WORLD = MPI.COMM_WORLD
RANKS = {"world", "comm", "shared_path"}  # the fixtures of a test that has to do with ranks
# Files that use these and have not, as those of figures.
ALIKE = {
    *("blas", "import", "import_refused", "jobs", "lammps"),
    *("manual", "network_files", "paper", "si"),
}
SECONDS_PER_TEST = 120  # the slowest takes about ten
SECONDS_FOR_OTHERS = 15  # that a rank whose test has failed waits for the others to finish theirs

_outcomes = WORLD.Dup() if WORLD.size > 1 else None  # apart from the tests' own messages
_reports = []


@pytest.hookimpl(trylast=True)
def pytest_configure(config):
    """Keep the true standard error, and leave pytest's report to rank 0."""
    global _stderr
    _stderr = os.fdopen(os.dup(2), "w")
    config.add_cleanup(_stderr.close)
    reporter = config.pluginmanager.getplugin("terminalreporter")
    if WORLD.rank > 0 and reporter is not None:
        reporter._tw._file = open(os.devnull, "w")  # noqa: SIM115
        config.add_cleanup(reporter._tw._file.close)
    if "PGRAN_TESTS_TAKEN" in os.environ:
        config.pluginmanager.register(Share(Path(os.environ["PGRAN_TESTS_TAKEN"])))


class Share:
    """One of several processes that share out the tests: each takes the next file that is left."""

    def __init__(self, folder):
        """Keep the folder in which they note what is taken."""
        self.folder, self.mine = folder, {}

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_protocol(self, item):
        """Pass over the tests of a file that another process has taken."""
        name = item.path.name
        if name not in self.mine:
            with contextlib.suppress(FileExistsError):
                (self.folder / name).mkdir()
                self.mine[name] = None
        return self.mine.setdefault(name, True)  # None: go on


def pytest_sessionstart(session):
    """Say what is tested, with `-q` too."""
    petsc, python = ".".join(map(str, PETSc.Sys.getVersion())), sys.version.split()[0]
    session.config.pluginmanager.getplugin("terminalreporter").write_line(
        f"PETSc {petsc}, {launch.library(MPI)}, NumPy {np.__version__}, Python {python}, "
        f"ranks {WORLD.size}"
    )


def pytest_collection_modifyitems(config, items):
    """Leave to the run on one rank what would do the same on each of several."""
    if WORLD.size > 1:
        shared = [item for item in items if _has_to_do_with_ranks(item)]
        config.hook.pytest_deselected(items=[item for item in items if item not in shared])
        items[:] = shared


def _has_to_do_with_ranks(item):
    name = item.path.stem.removeprefix("test_")
    return name not in ALIKE and not name.startswith("figures") and RANKS & {*item.fixturenames}


def pytest_collection_finish(session):
    """End unless all ranks found the same tests."""
    if _outcomes is not None:
        tests = [item.nodeid for item in session.items]
        if any(found != tests for found in _outcomes.allgather(tests)):
            _end("the ranks found different tests (an import failed on some?)")


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_protocol(item):
    """Guard a test by a watchdog, and end the run unless it goes alike on all ranks."""
    faulthandler.dump_traceback_later(SECONDS_PER_TEST, exit=True, file=_stderr)
    _reports.clear()
    yield
    if _outcomes is not None:
        failures = [report.longreprtext for report in _reports if report.failed]
        went = 2 if failures else int(any(report.skipped for report in _reports))
        everyone = np.empty(WORLD.size, dtype=np.int64)
        request = _outcomes.Iallgather(np.array([went], dtype=np.int64), everyone)
        deadline = time.monotonic() + SECONDS_FOR_OTHERS
        while not request.Test() and (not failures or time.monotonic() < deadline):
            time.sleep(0.0005)
        if not request.Test() or len(set(everyone)) > 1:
            said = "\n".join([*failures, "skipped" if went == 1 else ""])
            _end(f"{item.nodeid} went differently on the ranks; on rank {WORLD.rank}:\n{said}")
    faulthandler.cancel_dump_traceback_later()


def pytest_runtest_logreport(report):
    """Note how a phase of the present test went."""
    _reports.append(report)


def _end(message):
    print(f"\n{message}", file=_stderr, flush=True)
    sys.stdout.flush()
    time.sleep(1.0)  # all ranks have their say
    WORLD.Abort(1)


@pytest.fixture(scope="session")
def world():
    """All ranks."""
    return WORLD


@pytest.fixture
def comm():
    """The ranks that share a lattice: all of them."""
    return WORLD


@pytest.fixture
def alone():
    """This rank, in tests of physics that other tests show to depend on no number of ranks."""
    return MPI.COMM_SELF


@pytest.fixture
def shared_path(tmp_path):
    """Rank 0's temporary folder, on all ranks."""
    WORLD.Barrier()
    yield Path(WORLD.bcast(str(tmp_path)))
    WORLD.Barrier()


@pytest.fixture
def written(tmp_path):
    """Return what writes a text file in a folder of this rank's."""

    def write(text, name="a.opts"):
        (tmp_path / name).write_text(text, encoding="utf-8")
        return tmp_path / name

    return write


@pytest.fixture(autouse=True)
def option_database():
    """Hold every test to leaving PETSc's options as it has found them."""
    before = PETSc.Options().getAll()
    yield
    left = PETSc.Options().getAll()
    for key in left.keys() - before.keys():
        PETSc.Options().delValue(key)  # the next test must not have it
    assert left == before


@pytest.fixture
def solver_options():
    """Return what sets PETSc options for one test: `solver_options("-steady_ksp_type gmres")`."""
    with contextlib.ExitStack() as held:
        yield lambda text: held.enter_context(holding(option_values(text)))


@pytest.fixture
def place(shared_path, world):
    """Return what lets rank 0 write a file of the shared folder: `place("a.opts", text)`.

    Instead of a text there may be a function that writes, and what it takes after the path.
    """

    def place(name, content, *words):
        world.Barrier()
        if world.rank == 0:
            write, given = (content, words) if callable(content) else (Path.write_text, [content])
            write(shared_path / name, *given)
        world.Barrier()
        return shared_path / name

    return place


@pytest.fixture
def experiment(place):
    """A small experiment, `a.opts`."""
    text = "-scene response -lattice_shape 6,5 -detectors 2,3 -sweep_points 70"
    place("a.opts", f"{text} -output_progress none")


@pytest.fixture
def call(experiment, shared_path, monkeypatch, capsys):
    """Return what carries out a command in this process, on all ranks: `call("run", "a.opts")`.

    It tells what `subprocess.run` would, on every rank what rank 0 has said. Nothing that a command
    leaves in its process outlasts it.
    """
    monkeypatch.chdir(shared_path)
    monkeypatch.setattr(faulthandler, "enable", lambda: None)
    log = logging.getLogger("pgran")

    def call(*words):
        said, mask = io.StringIO(), signal.pthread_sigmask(signal.SIG_BLOCK, ())
        log.handlers, level = [logging.StreamHandler(said)], log.level
        log.handlers[0].setFormatter(streams.Messages("pgran"))
        log.setLevel(logging.INFO)
        with contextlib.ExitStack() as held:
            held.callback(signal.pthread_sigmask, signal.SIG_SETMASK, mask)
            held.callback(log.setLevel, level)
            held.callback(log.handlers.clear)
            # PETSc has started: what it would be started with is set
            keys_of = lambda options: held.enter_context(holding(options.solver))  # noqa: E731
            monkeypatch.setattr(running, "start_petsc", keys_of)
            try:
                code = program.main([*words])
            except SystemExit as ended:  # after a help text
                code = ended.code
            except Exception as error:
                code, text = program.explain(error)
                log.error("%s", text)
        out, err = WORLD.bcast((capsys.readouterr().out, said.getvalue()))
        return SimpleNamespace(returncode=code, stdout=out, stderr=err)

    return call


@pytest.fixture
def here(monkeypatch):
    """Let files be read without the trial by another process, which is quicker."""
    monkeypatch.setattr(store, "try_apart", lambda *words: None)


@pytest.fixture
def clean_environment():
    """Return the environment for a `pgran` or `mpirun` that a serial test starts."""
    if WORLD.size > 1:
        pytest.skip("starts programs of its own: serial run only")
    foreign = ("OMPI_COMM", "OMPI_UNIVERSE", "OMPI_APP", "OMPI_FILE", "PMIX_", "PMI_", "PRTE_")
    environment = {k: v for k, v in os.environ.items() if not k.startswith(foreign)}
    here = os.path.dirname(sys.executable)  # with the mpirun of this stack, if it is a wheel's
    environment["PATH"] = f"{here}{os.pathsep}{environment['PATH']}"
    root = ("OMPI_ALLOW_RUN_AS_ROOT", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM")
    one = ("OMP_NUM_THREADS", *root, "OMPI_MCA_rmaps_base_oversubscribe")
    return environment | dict.fromkeys(one, "1")


@pytest.fixture
def start(clean_environment, experiment, shared_path):
    """Return what starts pgran as a program: `start("run", "a.opts", ranks=2)`."""

    def start(*words, ranks=0, program=(sys.executable, "-m", "pgran"), **variables):
        launcher = ["mpirun", "-n", str(ranks)] if ranks else []
        return subprocess.run(
            [*launcher, *program, *words],
            cwd=shared_path, env=clean_environment | variables,
            capture_output=True, text=True, timeout=60,
        )  # fmt: skip

    return start
