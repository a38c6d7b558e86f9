"""The log beside the result. Serial run only, but for the file's own checks."""

import logging
import re
import subprocess
import sys

import pytest

from pgran.errors import FileError
from pgran.files import logfile

SMALL = "-scene response -lattice_shape 6,5 -detectors 2,3 -sweep_points 70 -output_progress none\n"
STAMP = r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d[+-]\d{4} "


@pytest.fixture
def start(clean_environment, tmp_path):
    """Return what runs a small experiment: `start("-output_log", "a.log", ranks=2)`."""
    (tmp_path / "a.opts").write_text(SMALL)

    def start(*words, ranks=1, code=None):
        program = ["-c", code] if code else ["-m", "pgran"]
        return subprocess.run(
            ["mpirun", "-n", str(ranks), sys.executable, *program, "run", "a.opts", *words],
            cwd=tmp_path, env=clean_environment, capture_output=True, text=True, timeout=60,
        )  # fmt: skip

    return start


def lines_of(path):
    """The lines of a log without their stamps, which all of them have."""
    lines = path.read_text().splitlines()
    for line in lines:
        assert re.match(STAMP + "pgran", line), line
    return [re.sub(STAMP, "", line) for line in lines]


@pytest.mark.parametrize("ranks", [1, 3])
def test_a_log_says_what_the_terminal_says(start, tmp_path, ranks):
    done = start("-output_log", "logs/a.log", ranks=ranks)
    assert done.returncode == 0, done.stderr
    first, *logged = lines_of(tmp_path / "logs" / "a.log")
    assert first == f"pgran: pgran run a.opts -output_log logs/a.log on {ranks} rank" + "s" * (
        ranks > 1
    )
    assert logged == done.stderr.splitlines()
    assert len(logged) > 1


def test_a_log_goes_on(start, tmp_path):
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "a.h5").write_text("mine")
    (tmp_path / "a.log").write_text("2020-01-01T00:00:00+0000 pgran: earlier\n")
    done = start("-output_log", "a.log", ranks=2)
    assert done.returncode == 4
    first, _, last = lines_of(tmp_path / "a.log")
    assert first == "pgran: earlier"
    assert last.startswith("pgran error: results/a.h5: exists and is no result")


FAILING = """
from mpi4py import MPI
import pgran.__main__
start = pgran.command.run.start_petsc
def start_petsc(options):
    start(options)
    from petsc4py import PETSc
    from pgran.solve.steady import SteadySolver
    def fail(self, omega):
        if MPI.COMM_WORLD.rank == {rank}:
            {statement}
        MPI.COMM_WORLD.Barrier()
    SteadySolver.solve = fail
pgran.command.run.start_petsc = start_petsc
pgran.__main__.console()
"""


@pytest.mark.parametrize(
    ("rank", "statement", "message"),
    [
        (
            0,
            "self.operators.K.getValue(10**6, 0)",
            "PETSc: Row too large: row 1000000 max 29 (MatGetValues())",
        ),
        (2, "raise RuntimeError('sabotage')", "RuntimeError: sabotage"),
    ],
)
def test_errors_are_logged(start, tmp_path, rank, statement, message):
    code = FAILING.format(rank=rank, statement=statement)
    done = start("-output_log", "a.log", ranks=3, code=code)
    assert done.returncode == 1
    who = f" (rank {rank})" if rank else ""
    last = lines_of(tmp_path / "a.log")[-1]
    assert last.startswith(f"pgran{who} error: {message}")


@pytest.mark.parametrize(
    ("path", "code", "message"),
    [("a.opts", 4, "a.opts: exists already and is no log"), ("b.h5", 2, "is the -output_file")],
)
def test_a_log_is_refused_before_any_work(start, tmp_path, path, code, message):
    done = start("-output_log", path, "-output_file", "b.h5", ranks=2)
    assert done.returncode == code
    (said,) = (line for line in done.stderr.splitlines() if line.startswith("pgran"))
    assert message in said
    assert (tmp_path / "a.opts").read_text() == SMALL
    assert [p.name for p in tmp_path.iterdir()] == ["a.opts"]


def test_what_cannot_be_a_log(tmp_path):
    (tmp_path / "notes.txt").write_text("2020-01-01 shopping")
    for path, message in (
        (tmp_path, "is a folder"),
        (tmp_path / "notes.txt", "exists already and is no log"),
        (tmp_path / "notes.txt" / "a.log", "cannot be written"),
    ):
        with pytest.raises(FileError, match=message):
            logfile.check(path)
    logfile.check(tmp_path / "new" / "a.log", make=False)
    assert [p.name for p in tmp_path.iterdir()] == ["notes.txt"]


def test_an_unwritable_folder(monkeypatch, tmp_path):
    def refuse(dir):
        raise PermissionError(13, "Permission denied", str(dir))

    monkeypatch.setattr(logfile.tempfile, "TemporaryFile", refuse)
    with pytest.raises(FileError, match=r"a\.log: cannot be written: .*Permission denied"):
        logfile.check(tmp_path / "a.log")


def test_ranks_append_whole_messages(tmp_path, shared_path, world):
    """Many messages of several lines from all ranks at once never mix."""
    handler = logfile.LogFile(shared_path / "a.log", world.rank)
    for number in range(200):
        text = "\n".join(f"{world.rank} {number} {'x' * 100}" for _ in range(5))
        handler.emit(logging.LogRecord("pgran", logging.WARNING, "", 0, text, (), None))
    world.Barrier()
    lines = lines_of(shared_path / "a.log")
    assert len(lines) == 1000 * world.size
    for first in range(0, len(lines), 5):
        assert len(set(lines[first : first + 5])) == 1
    assert len(set(lines)) == 200 * world.size
    world.Barrier()


def test_a_lost_disk_does_not_end_the_run(tmp_path, capsys):
    handler = logfile.LogFile(tmp_path / "missing" / "a.log", 0)
    handler.emit(logging.LogRecord("pgran", logging.INFO, "", 0, "words", (), None))
    assert "a.log: cannot be written: No such file" in capsys.readouterr().err
