"""Every script of jobs/ runs, in small, in a copy of the project without the installation."""

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from small import copy_options

from pgran.draw import pages

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
sys.path.append(str(ROOT / "jobs"))

import benchmark  # noqa: E402

# Instead of jobs/setup.sh: these tests' own environment.
INSTALLED = 'cd "$(dirname "${BASH_SOURCE[0]}")/.."\n'
# The scripts, in words of their own that make little of them, and what they leave behind.
SCRIPTS = {
    "manual.sh": ("", "results/manual_modes.h5 pgran/manual/response.png"),
    "packing.sh": ("--modes --forces", "options/packings/discs.h5 options/packings/spheres.h5"),
    "stability.sh": ("continuum_resonance", ""),
    "faults.sh": ("0", ""),  # what it starts the tests of campaigns try out
    "slurm/pgran.sbatch": ("options/response.opts", "results/response.h5"),
}
# Started by tests below or elsewhere, or by .ci/run; and what is part of a script.
ELSEWHERE = {"benchmark.sh", "geometry.py", "paper.sh", "quickstart.sh", "setup.sh", "test.sh"}
ELSEWHERE |= {"cost.py", "gallery.sh", "waves.py", "slurm/study.sbatch"}
PARTS = {"benchmark.py", "gallery.py", "peers.py", "tables.py"}
PARTS |= {f"paper_{part}.py" for part in ("beads", "loud", "measures", "modes", "rows", "sweeps")}
PARTS |= {"paper.py", "paper_table.py"}
# Instead of a venv with LAMMPS: one whose lmp writes the matrix of the packing that there is, or
# the contacts of one that pgran has exported.
VENV = """
mkdir -p "$3/bin"
printf '#!/bin/sh\\n' >"$3/bin/pip"
printf '#!/bin/sh\\nexec python %s/lmp.py "$@"\\n' "$PWD" >"$3/bin/lmp"
chmod +x "$3/bin/pip" "$3/bin/lmp"
"""
LMP = """
import sys
from pathlib import Path
import numpy as np
import pgran
from pgran.command import imports
from pgran.medium.network_file import read_network
name, words = sys.argv[2].removesuffix(".in"), ["--law", "harmonic"]
if "matrix" not in sys.argv:
    sys.path.append(str(Path(__file__).parent / "tests"))
    import lammps_like
    sys.exit(lammps_like.main(sys.argv[2]))
if name == "spheres":
    words = ["--law", "hertz", "--rest", "type==3", "--drive", "type==4"]
imports.run([f"{name}.atoms", f"{name}.contacts", "-o", sys.argv[-1] + "_lmp.h5", *words])
network = read_network(sys.argv[-1] + "_lmp.h5")
K = network.restoring_forces(np.eye(network.size)) / network.mass
axes, balls = network.axes, network.size // network.axes
whole = np.zeros((balls, 3, balls, 3))
whole[:, :axes, :, :axes] = K.reshape(balls, axes, balls, axes)
whole.tofile(sys.argv[-1])
"""


@pytest.fixture
def project(clean_environment, tmp_path):
    """Return what starts a script of jobs/: `project("benchmark.sh", "--small")`."""
    shutil.copytree(ROOT / "jobs", tmp_path / "jobs", ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "jobs" / "setup.sh").write_text(INSTALLED)
    copy_options(tmp_path)
    (tmp_path / "tests").symlink_to(ROOT / "tests")
    shutil.copytree(ROOT / "pgran" / "manual", tmp_path / "pgran" / "manual")
    (tmp_path / "bin").mkdir()
    (tmp_path / "lmp.py").write_text(LMP)

    def stand_in(name, lines):
        program = tmp_path / "bin" / name
        program.write_text(f"#!/bin/sh\n{lines}\n")
        program.chmod(0o755)

    stand_in("python3", VENV)
    for name, words in (("python", []), ("pgran", ["-m", "pgran"])):
        stand_in(name, f'exec {shlex.join([sys.executable, *words])} "$@"')
    environment = clean_environment | {"PYTHONPATH": str(ROOT)}
    environment["PATH"] = f"{tmp_path / 'bin'}:{environment['PATH']}"

    def start(name, *words, **others):
        return subprocess.run(
            ["bash", f"jobs/{name}", *words],
            cwd=tmp_path, env=environment | others, capture_output=True, text=True, timeout=180,
        )  # fmt: skip

    start.path, start.stand_in = tmp_path, stand_in
    return start


def test_no_script_is_forgotten():
    """Each is run by a test here, or is named above with what runs it."""
    files = [path for path in (ROOT / "jobs").rglob("*.*") if path.is_file()]
    names = {str(p.relative_to(ROOT / "jobs")) for p in files if p.suffix != ".pyc"}
    assert names == {*SCRIPTS, *ELSEWHERE, *PARTS}
    assert "bash jobs/test.sh" in (ROOT / ".ci" / "run").read_text()


def test_the_quick_start(project, call, monkeypatch):
    """In this process, which is quicker: the words of each pgran go into a file.

    Of the figures, which other tests draw, one is saved, as others cost most of the time.
    """
    save = pages.save
    monkeypatch.setattr(pages, "save", lambda made, path: save(dict([*made.items()][:1]), path))
    project.stand_in("mpirun", 'shift 2; exec "$@"')
    project.stand_in("pgran", 'echo "$@" >>words')
    done = project("quickstart.sh")
    assert done.returncode == 0, done.stderr
    for line in Path("words").read_text().splitlines():
        done = call(*line.split())
        assert done.returncode == 0, done.stderr
    for name in ("response-amplitude.png", "modes.h5", "relaxation.h5"):
        assert (project.path / "results" / name).exists()


@pytest.mark.parametrize("name", SCRIPTS)
def test_a_script_in_small(project, name):
    words, left = SCRIPTS[name]
    if name == "manual.sh":
        project.stand_in("mpirun", 'shift 2; exec "$@"')
    done = project(name, *words.split())
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    differences = re.findall(r"difference from LAMMPS is (.+)", done.stdout)
    assert all(float(text) < 1e-9 for text in differences)
    assert len(differences) == 4 * (name == "packing.sh")
    assert [path for path in left.split() if not (project.path / path).is_file()] == []


def test_the_gallery(project):
    """Each group of results is drawn, of a few files; what is complete is not run again."""
    more = "packing|experiment|undamped|velocity|dominant|three|ensemble_modes|sensitivity"
    for path in (project.path / "options").glob("*.opts"):
        if re.search(more, path.stem):
            path.unlink()
    done = project("gallery.sh", "made")
    assert done.returncode == 0, done.stderr
    page = (project.path / "made" / "index.html").read_text("utf-8")
    pictures = re.findall(r'src="(.+?)"', page)
    assert len(pictures) == len(set(pictures)) == page.count("<figcaption>") > 30
    for path in [*project.path.glob("options/*.opts"), *project.path.glob("made/*.h5")]:
        if path.stem not in ("response", "likeness"):
            path.unlink()
    done = project("gallery.sh", "made")
    assert "no figures of accuracy, continuum, damped_modes, density," in done.stderr
    assert "written after" not in done.stderr


def test_the_benchmark(project):
    """Every row, in small: what is compared is alike, and nothing misses its accuracy."""
    done = project("benchmark.sh", "--small")
    assert done.returncode == 0, done.stderr
    head, _, *rows = [line[2:-2].split(" | ") for line in done.stdout.splitlines()]
    assert head[0] == "workload"
    assert [row[0] for row in rows] == list(benchmark.ROWS)
    for row in rows:
        assert len(row) == len(head), row
        asked = benchmark.LOUD if "contacts open" in row[0] else 1e-8
        assert float(row[-2]) < asked, row
        assert row[-1] == "0", row


def test_the_readme_shows_rows_of_the_benchmark():
    _, _, table = README.partition("| workload | peer |")
    rows = re.findall(r"^\| ([^|]+) \|.* s \|.*$", table, re.MULTILINE)
    assert len(rows) > 5
    assert [row for row in rows if row not in benchmark.ROWS] == []


def test_the_cost_of_moments_and_of_factorizations(start, tmp_path):
    """Of each lattice and method as many balls as asked for."""
    path = tmp_path / "cost.png"
    done = start(program=[sys.executable, str(ROOT / "jobs" / "cost.py"), str(path), "1000"])
    assert done.returncode == 0, done.stderr
    found = re.findall(r"^\| (..) \| (\w+) \| (\d+) ", done.stdout, re.MULTILINE)
    assert [balls for _, _, balls in found] == ["1024", "1024", "1000", "1000"]
    assert path.is_file()


def test_a_rank_that_fails_ends_the_benchmark(project):
    """Instead of leaving the other one waiting."""
    script = project.path / "jobs" / "benchmark.py"
    planted = (
        "def all_modes(side, method):\n"
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
