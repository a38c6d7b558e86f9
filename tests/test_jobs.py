"""Every script of jobs/ runs, in small, in a copy of the project without the installation."""

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
sys.path.append(str(ROOT / "jobs"))

import benchmark  # noqa: E402

# Instead of jobs/setup.sh: these tests' own environment.
INSTALLED = 'cd "$(dirname "${BASH_SOURCE[0]}")/.."\n'


@pytest.fixture
def project(clean_environment, tmp_path):
    """Return what starts a script of jobs/: `project("benchmark.sh", "--small")`."""
    shutil.copytree(ROOT / "jobs", tmp_path / "jobs", ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "jobs" / "setup.sh").write_text(INSTALLED)
    (tmp_path / "bin").mkdir()
    for name, words in (("python", []), ("pgran", ["-m", "pgran"])):
        program = tmp_path / "bin" / name
        program.write_text(f'#!/bin/sh\nexec {shlex.join([sys.executable, *words])} "$@"\n')
        program.chmod(0o755)
    environment = clean_environment | {"PYTHONPATH": str(ROOT)}
    environment["PATH"] = f"{tmp_path / 'bin'}:{environment['PATH']}"

    def start(name, *words, **others):
        return subprocess.run(
            ["bash", f"jobs/{name}", *words],
            cwd=tmp_path, env=environment | others, capture_output=True, text=True, timeout=90,
        )  # fmt: skip

    start.path = tmp_path
    return start


def test_the_benchmark(project):
    """Every row, in small: what is compared is alike, and nothing misses its accuracy."""
    done = project("benchmark.sh", "--small")
    assert done.returncode == 0, done.stderr
    head, _, *rows = [line[2:-2].split(" | ") for line in done.stdout.splitlines()]
    assert head[0] == "workload"
    assert [row[0] for row in rows] == list(benchmark.ROWS)
    for row in rows:
        assert len(row) == len(head), row
        assert float(row[-2]) < 1e-8, row
        assert row[-1] == "0", row


def test_the_readme_shows_rows_of_the_benchmark():
    _, _, table = README.partition("| workload | peer |")
    rows = re.findall(r"^\| ([^|]+) \|.* s \|.*$", table, re.MULTILINE)
    assert len(rows) > 5
    assert [row for row in rows if row not in benchmark.ROWS] == []


def test_a_rank_that_fails_ends_the_benchmark(project):
    """Instead of leaving the other one waiting."""
    script = project.path / "jobs" / "benchmark.py"
    planted = (
        "def all_modes(side):\n"
        "    if WORLD.rank == 1:\n"
        "        raise RuntimeError('planted')\n"
        "    return Pair(dict, lambda comm: comm.Barrier(), dict)\n\n\n"
    )
    before, mark, after = script.read_text().partition("PAPER = ")
    assert mark
    script.write_text(before + planted + mark + after)
    done = project("benchmark.sh", "--small", "all modes of 20")
    assert done.returncode == 1
    assert "RuntimeError: planted" in done.stderr


def test_the_tests_end_without_a_word(start):
    """They leave no file open."""
    words = ["-X", "dev", "-m", "pytest", "-q", str(ROOT / "tests" / "test_progress.py")]
    done = start(program=[sys.executable, *words])
    assert (done.returncode, done.stderr) == (0, "")


def test_rows_that_there_are_not(project):
    done = project("benchmark.sh", "--small", "nonsense")
    assert done.returncode == 2
    assert "no row's name holds nonsense; they are 20 x 20, " in done.stderr
