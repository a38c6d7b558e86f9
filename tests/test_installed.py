"""Experiments of installed packages run, and are read, drawn and listed, as those of pgran."""

import importlib
import re
import sys
from pathlib import Path

import numpy as np
import pytest

import pgran
import pgran.figures
import pgran.results
from pgran import catalogue

MANUAL = Path(pgran.__file__).parent / "manual" / "developing.md"
# The modules of the package that the manual writes, by their names.
BLOCKS = re.findall(r"^```python\n# (\S+)\.py\n(.*?)^```", MANUAL.read_text(), re.M | re.S)
WRITTEN = {Path(name).name: text for name, text in BLOCKS}
TEST = WRITTEN.pop("test_spread")
RUN = "-scene spread -lattice_shape 6,5 -output_progress none"


@pytest.fixture
def install(place, shared_path, world, monkeypatch):
    """Return what installs a package of these modules, and an entry point of a name and a value."""
    tables = catalogue.RECORDS, catalogue.FIGURES
    before = [dict(table) for table in tables]
    monkeypatch.setattr(catalogue.EXPERIMENTS, "_homes", dict(catalogue.OURS))
    monkeypatch.setattr(catalogue.EXPERIMENTS, "_looked", False)
    monkeypatch.syspath_prepend(shared_path)

    def install(modules, name="spread", value="pgran_spread:HOME"):
        if world.rank == 0:
            for folder in ("pgran_spread", "spread-1.dist-info"):
                (shared_path / folder).mkdir()
        for module, text in modules.items():
            place(f"pgran_spread/{module}.py", text)
        place("spread-1.dist-info/METADATA", "Name: spread\nVersion: 1\n")
        place("spread-1.dist-info/entry_points.txt", f"[pgran.experiments]\n{name} = {value}\n")
        place("spread.opts", RUN)
        importlib.invalidate_caches()

    yield install
    for table, ours in zip(tables, before, strict=True):
        table.clear()
        table.update(ours)
    for name in [name for name in sys.modules if name.startswith("pgran_spread")]:
        del sys.modules[name]


def test_an_installed_experiment_is_as_one_of_pgran(install, call, world):
    """The one that the manual writes, whose own test passes as well."""
    install(WRITTEN)
    words = "run", "spread.opts", "-sweep_omega", ".3,.7"
    done = call(*words, "-output_file", "a.h5")
    assert (done.returncode, "balls move" in done.stderr) == (0, True), done.stderr
    assert "2 frequencies" in call(*words, "-dry_run").stdout
    assert "-sweep_omega" in call("options", "spread").stdout
    assert "spread" in call("options").stdout
    assert "mean -error_tolerance?" in call(*words, "-error_tolerances", "1").stderr
    test = {}
    exec(TEST, test)
    test["test_the_balls_that_move"]()
    if world.size == 1:
        assert call("verify", "a.h5").returncode == call("export", "a.h5", "a.csv").returncode == 0
        result = pgran.load("a.h5")
        assert type(result.spread) is pgran.results.Spread
        assert np.all((result.spread.balls >= 1) & (result.spread.balls <= 30))
        assert list(pgran.plot(result)) == ["spread"]
        assert pgran.figures.spread.__name__ == "pgran_spread.figures"


def test_a_run_goes_on_with_the_same_code_only(install, start, shared_path, place):
    """A task that failed at its end was wrong before, too: what it has finished is another's."""
    wrong = WRITTEN["scene"].replace("power.sum() ** 2", "9 * power.sum() ** 2")
    install(WRITTEN | {"scene": wrong.replace("work = int(", "work = nothing(")})
    words = "run", "spread.opts", "-sweep_omega", ".3,.7", "-output_file", "a.h5"
    assert "nothing" in start(*words, PYTHONPATH=str(shared_path)).stderr
    place("pgran_spread/scene.py", WRITTEN["scene"])
    done = start(*words, PYTHONPATH=str(shared_path))
    assert (done.returncode, "run with code" in done.stderr) == (2, True), done.stderr
    done = start(*words, "-output_overwrite", PYTHONPATH=str(shared_path))
    assert done.returncode == 0, done.stderr
    (shared_path / "spread-1.dist-info").rename(shared_path / "gone")
    for command in ("plot", "export"):
        done = start(command, "a.h5", *["a.csv"] * (command == "export"))
        assert "no package that is installed has this experiment" in done.stderr


@pytest.mark.parametrize(
    ("modules", "point", "said"),
    [
        ({}, ["modes", "pgran_spread:HOME"], "there is one of this name already"),
        ({}, ["spread", "pgran_spread:PLACE"], "no attribute 'PLACE'"),
        ({"scene": "import nothing_there"}, [], "No module named 'nothing_there'"),
        ({"__init__": "HOME = 3"}, [], "pgran_spread:HOME is no pgran.catalogue.Home"),
        ({"__init__": "raise SystemExit"}, [], "SystemExit"),
        ({"record": ""}, [], "pgran_spread.record declares no record of the group spread"),
        (
            {"__init__": WRITTEN["__init__"].replace('spread": "fig', 'modes": "fig')},
            [],
            "called modes already",
        ),
    ],
)
def test_what_cannot_be_used_is_said_and_left_out(install, call, modules, point, said):
    install(WRITTEN | modules, *point)
    done = call("run", "spread.opts")
    assert done.returncode == 2
    assert f"no experiment {(point or ['spread'])[0]} of spread: " in done.stderr
    assert said in done.stderr
    assert "-scene spread (spread.opts, line 1): choose accuracy, " in done.stderr
    assert call("run", "a.opts").returncode == 0


def test_nobody_looks_for_packages_without_need(install, call, monkeypatch):
    """Nor where a key is one of another scene, or a result of pgran's is read."""
    install(WRITTEN)
    monkeypatch.setattr(catalogue.Experiments, "complete", None)
    assert call("run", "a.opts").returncode == 0
    assert pgran.load("results/a.h5").response
    assert call("run", "a.opts", "-relax_steps", "3").returncode == 2
