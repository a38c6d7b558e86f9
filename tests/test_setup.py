"""The set-up script, in a copy of the project: what a user's own environment must not spoil."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

PROJECT = Path(__file__).parents[1]


@pytest.fixture
def setup(clean_environment, tmp_path):
    """Return what starts jobs/setup.sh in a copy, without a package index."""
    ignore = shutil.ignore_patterns("__pycache__")  # another process may be at work in one
    for name in ("jobs", "pgran"):
        shutil.copytree(PROJECT / name, tmp_path / name, ignore=ignore)
    for name in ("pyproject.toml", "README.md"):
        shutil.copy(PROJECT / name, tmp_path / name)

    def start(**variables):
        kept = clean_environment.keys() - {"PYTHONPATH", "PGRAN_STACK"}
        environment = {name: clean_environment[name] for name in kept} | variables
        environment["PIP_NO_INDEX"] = "1"
        return subprocess.run(
            ["bash", tmp_path / "jobs" / "setup.sh"],
            env=environment, capture_output=True, text=True,
        )  # fmt: skip

    return start


@pytest.mark.skipif(sys.prefix == sys.base_prefix, reason="these tests run in no venv")
def test_in_an_active_venv(setup, tmp_path):
    """That of these tests: what is made from its python3 works, and is another one."""
    done = setup(PETSC_DIR="", SLEPC_DIR="")
    assert done.returncode == 0, done.stderr
    python = tmp_path / ".venv" / "bin" / "python"
    words = [python, "-m", "pgran", "doctor"]
    bare = {"PATH": f"{python.parent}:/usr/bin:/bin", "OMP_NUM_THREADS": "1"}
    found = subprocess.run(words, cwd=tmp_path, env=bare, capture_output=True, text=True)
    assert found.returncode == 0, found.stdout
    assert str(python) in found.stdout
    (paths,) = tmp_path.glob(".venv/lib/python*/site-packages/pgran_petsc.pth")
    assert "/lib/python3/dist-packages" not in paths.read_text().splitlines()


@pytest.mark.parametrize(
    ("stack", "words"), [("wheel", "needs Python 3.12 to 3.14"), ("nonsense", "PGRAN_STACK is")]
)
def test_what_cannot_be_is_said(setup, tmp_path, stack, words):
    (tmp_path / "bin").mkdir()
    for name in ("bash", "dirname", "cat"):
        (tmp_path / "bin" / name).symlink_to(shutil.which(name))
    done = setup(PGRAN_STACK=stack, PATH=str(tmp_path / "bin"), HOME=str(tmp_path), PYENV_ROOT="")
    assert done.returncode == 2
    assert words in done.stderr
    assert not (tmp_path / ".venv-wheel").exists()
