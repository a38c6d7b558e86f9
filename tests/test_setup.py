"""The set-up script, in a copy of the project: what a user's own environment must not spoil."""

import shutil
import subprocess
import sys
import tarfile
import zipfile
from functools import partial
from pathlib import Path

import pytest

import pgran

PROJECT = Path(__file__).parents[1]


@pytest.fixture
def setup(clean_environment, tmp_path):
    """Return what starts jobs/setup.sh in a copy, without a package index."""
    ignore = shutil.ignore_patterns("__pycache__")  # another process may be at work in one
    clone = tmp_path / "pgran"
    for name in ("jobs", "options", "pgran"):
        shutil.copytree(PROJECT / name, clone / name, symlinks=True, ignore=ignore)
    for name in ("pyproject.toml", "README.md"):
        shutil.copy(PROJECT / name, clone / name)

    def start(**variables):
        kept = clean_environment.keys() - {"PYTHONPATH", "PGRAN_STACK"}
        environment = {name: clean_environment[name] for name in kept} | variables
        environment["PIP_NO_INDEX"] = "1"
        return subprocess.run(
            ["bash", clone / "jobs" / "setup.sh"],
            env=environment, capture_output=True, text=True,
        )  # fmt: skip

    start.clone = clone
    return start


@pytest.mark.skipif(sys.prefix == sys.base_prefix, reason="these tests run in no venv")
def test_in_an_active_venv(setup, tmp_path):
    """That of these tests: what is made from its python3 works, and is another one.

    Activated it needs nothing else in the environment, not even as root, nor does the clone's
    folder, which is called pgran, get in the way of a script beside it.
    """
    done = setup(PETSC_DIR="", SLEPC_DIR="")
    assert done.returncode == 0, done.stderr
    venv = setup.clone / ".venv"
    (tmp_path / "script.py").write_text("import pgran\nprint(pgran.Lattice.__module__)\n")
    lines = f"source {venv}/bin/activate; mpirun -n 2 pgran doctor; python script.py"
    found = subprocess.run(
        ["env", "-i", "bash", "-e", "-c", lines], cwd=tmp_path, capture_output=True, text=True
    )
    assert found.returncode == 0, found.stdout + found.stderr
    assert f"{venv}/bin/python" in found.stdout
    assert found.stdout.endswith("\npgran.medium.lattice\n")
    (paths,) = venv.glob("lib/python*/site-packages/pgran_petsc.pth")
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
    assert not (setup.clone / ".venv-wheel").exists()


def test_a_wheel(setup, clean_environment, tmp_path):
    """Made of the source archive it holds every file, and options files run where they are put."""
    run, folder = partial(subprocess.run, capture_output=True, text=True), setup.clone
    for kind, unpack in (("sdist", tarfile.open), ("wheel", zipfile.ZipFile)):
        build = f"from setuptools import build_meta; build_meta.build_{kind}('{tmp_path / kind}')"
        built = run([sys.executable, "-c", build], cwd=folder)
        assert built.returncode == 0, built.stderr
        (archive,) = (tmp_path / kind).iterdir()
        assert archive.name.startswith(f"pgran-{pgran.__version__}")
        unpack(archive).extractall(tmp_path / f"from_{kind}")
        folder = tmp_path / "from_sdist" / f"pgran-{pgran.__version__}"
    installed = tmp_path / "from_wheel"
    for folder in ("pgran", "pgran/options"):  # which is a link
        files = [p.relative_to(setup.clone) for p in (setup.clone / folder).rglob("*.*")]
        assert len(files) > 5
        assert [path for path in files if not (installed / path).exists()] == []
    environment = clean_environment | {"PYTHONPATH": str(installed)}
    modes = "packing_modes"
    for line in ("options --copy mine", f"run mine/{modes}.opts"):
        done = run([sys.executable, "-m", "pgran", *line.split()], cwd=tmp_path, env=environment)
        assert done.returncode == 0, done.stderr
    assert (tmp_path / "results" / f"{modes}.h5").exists()
