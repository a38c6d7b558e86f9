"""The log beside the result, on all ranks."""

import logging
import re
import shlex
import sys

import pytest
from campaigns import inject

from pgran.errors import FileError
from pgran.run import streams

STAMP = r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d[+-]\d{4} "


UNRESOLVED = ("-sweep_method", "points")


def lines_of(path):
    """The lines of a log without their stamps, which all of them have."""
    lines = path.read_text().splitlines()
    assert all(re.match(STAMP + "pgran", line) for line in lines)
    return [re.sub(STAMP, "", line) for line in lines]


def test_a_log_says_what_the_terminal_says(call, place, shared_path, world):
    """And goes on below what it held before."""
    place("a.log", "2020-01-01T00:00:00+0000 pgran: earlier\n")
    done = call("run", "a.opts", "-output_log", "a.log", *UNRESOLVED)
    assert done.returncode == 0, done.stderr
    assert "pgran: warning: the curve is not resolved" in done.stderr
    earlier, first, *logged = lines_of(shared_path / "a.log")
    ranks = "1 rank" if world.size == 1 else f"{world.size} ranks"
    assert earlier == "pgran: earlier"
    assert first == f"pgran: pgran run a.opts -output_log a.log {shlex.join(UNRESOLVED)} on {ranks}"
    assert logged == done.stderr.splitlines() != []


def test_errors_are_logged(start, shared_path):
    fault = [sys.executable, *inject.words(inject.UNIT, "raise RuntimeError('planted')", rank=1)]
    done = start("run", "a.opts", "-output_log", "logs/a.log", ranks=2, program=fault)
    assert done.returncode == 1
    last = lines_of(shared_path / "logs" / "a.log")[-1]
    assert last == "pgran (rank 1): error: RuntimeError: planted"


def test_a_log_is_refused_before_any_work(call, place, shared_path, world):
    place("notes.txt", "2020-01-01 shopping")
    for path, code, message in (
        ("notes.txt", 4, "notes.txt: exists already and is no log"),
        ("notes.txt/a.log", 4, "cannot be written"),
        (".", 4, "is a folder"),
        ("b.h5", 2, "is the -output_file"),
    ):
        done = call("run", "a.opts", "-output_log", path, "-output_file", "b.h5")
        assert done.returncode == code
        assert message in done.stderr
    streams.check_log(shared_path / "new" / "a.log", make=False)
    world.Barrier()  # each rank tries with a file of its own
    assert sorted(path.name for path in shared_path.iterdir()) == ["a.opts", "notes.txt"]
    with pytest.raises(FileError, match=r"aa\.log: cannot be written: File name too long"):
        streams.check_log(shared_path / f"{'a' * 250}.log")


def test_ranks_append_whole_messages(shared_path, world, capsys):
    """Many messages of several lines from all ranks at once do not mix; a full disk ends no run."""
    handler = streams.LogFile(shared_path / "a.log", world.rank)
    for number in range(200):
        text = "\n".join(f"{world.rank} {number} {'x' * 100}" for _ in range(5))
        handler.emit(logging.makeLogRecord({"levelno": logging.WARNING, "msg": text}))
    world.Barrier()
    lines = lines_of(shared_path / "a.log")
    assert lines[::5] == lines[4::5]
    assert len(lines) == 5 * len(set(lines)) == 1000 * world.size
    handler.setStream(open("/dev/full", "w")).close()  # noqa: SIM115
    handler.emit(logging.makeLogRecord({"levelno": logging.INFO}))
    assert "a.log: cannot be written: [Errno 28] No space" in capsys.readouterr().err
    with pytest.raises(FileError, match=r"b\.log: cannot be written: No such file"):
        streams.LogFile(shared_path / "missing" / "b.log", 0)
