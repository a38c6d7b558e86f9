"""Experiments of installed packages run, and are read, drawn and listed, as those of pgran."""

import importlib
import sys

import numpy as np
import pytest

import pgran
import pgran.results
from pgran import catalogue

SCENE = '''
import numpy as np
from pgran.medium.base import medium
from pgran.run.experiment import Scene, in_parallel, PROGRESS, option, options_of, run_of
from pgran.run.task import Task, carry_out
from pgran.store.record import columns_of, row_of
from pgran_ladder.record import Rungs

class Climb(Task):
    items, row = "rungs", np.dtype(row_of(Rungs))

    def __init__(self, lattice, rungs):
        self.lattice, self.units = lattice, range(1, rungs + 1)

    def work(self, unit, group):
        rows = np.zeros(1, self.row)
        rows["omega"] = unit * self.lattice.omega_mx
        return rows

    def collect(self, rows, seconds):
        return Rungs(**columns_of(Rungs, rows))

@in_parallel("ladder", lattice=medium)
def climb(lattice, crew=None, *, rungs=option(4, "how many", low=1), progress=PROGRESS) -> Rungs:
    """Climb a ladder whose rungs are omega_mx apart."""
    return carry_out(Climb(lattice, rungs), crew, progress)

def summary(result):
    yield f"{len(result.rungs.omega)} rungs"

SCENE = Scene(options_of(climb), run_of(climb), summary)
'''
RECORD = '''
from dataclasses import dataclass
import numpy as np
from pgran.store.record import Record, array

@dataclass(frozen=True, eq=False, repr=False)
class Rungs(Record):
    """The rungs."""

    group = "rungs"
    omega: np.ndarray = array("height", "sqrt(k/m)", row=True)
'''
FIGURES = """
from pgran.draw import style

def figures(result, **_):
    figure = style.stack([rungs], ["The rungs."], rungs=result.rungs)
    yield "rungs", figure

def rungs(ax, rungs):
    return ax.plot(rungs.omega)
"""
HOME = 'from pgran.catalogue import Home\nHOME = Home("pgran_ladder", {"rungs": "figures"})\n'
LADDER = {"__init__": HOME, "scene": SCENE, "record": RECORD, "figures": FIGURES}
RUN = "-scene ladder -lattice_shape 3,2 -output_progress none"


@pytest.fixture
def install(place, shared_path, world, monkeypatch):
    """Return what installs a package of modules, and the experiments that it declares."""
    tables = catalogue.RECORDS, catalogue.FIGURES
    before = [dict(table) for table in tables]
    monkeypatch.setattr(catalogue.EXPERIMENTS, "_homes", dict(catalogue.OURS))
    monkeypatch.setattr(catalogue.EXPERIMENTS, "_complete", False)
    monkeypatch.syspath_prepend(shared_path)

    def install(modules, **experiments):
        if world.rank == 0:
            for folder in ("pgran_ladder", "ladder-1.dist-info"):
                (shared_path / folder).mkdir()
        for name, text in modules.items():
            place(f"pgran_ladder/{name}.py", text)
        lines = [f"{name} = {value}" for name, value in experiments.items()]
        place("ladder-1.dist-info/METADATA", "Name: ladder\nVersion: 1\n")
        place("ladder-1.dist-info/entry_points.txt", "\n".join(["[pgran.experiments]", *lines, ""]))
        importlib.invalidate_caches()

    yield install
    for table, ours in zip(tables, before, strict=True):
        table.clear()
        table.update(ours)
    for name in [name for name in sys.modules if name.startswith("pgran_ladder")]:
        del sys.modules[name]


def test_an_installed_experiment_is_as_one_of_pgran(install, call, place, world):
    install(LADDER, ladder="pgran_ladder:HOME")
    place("ladder.opts", RUN)
    done = call("run", "ladder.opts", "-ladder_rungs", "3", "-output_file", "a.h5")
    assert (done.returncode, "3 rungs" in done.stderr) == (0, True), done.stderr
    assert "3 rungs" in call("run", "ladder.opts", "-ladder_rungs", "3", "-dry_run").stdout
    assert "-ladder_rungs" in call("options", "ladder").stdout
    assert "ladder" in call("options").stdout
    assert "give another name" not in call("run", "ladder.opts", "-ladder_rung", "3").stderr
    if world.rank == 0:
        result = pgran.load("a.h5")
        assert type(result.rungs) is pgran.results.Rungs
        assert np.array_equal(result.rungs.omega, np.arange(1, 4) * result.medium.omega_mx)
        assert call_alone("verify", "a.h5") == call_alone("export", "a.h5", "a.csv") == 0
        assert list(pgran.plot("a.h5", "a.png")) == ["rungs"]


def call_alone(*words):
    """The exit code of a command that has nothing to do with ranks."""
    from pgran.__main__ import main

    return main([*words])


@pytest.mark.parametrize(
    ("modules", "experiments", "said"),
    [
        (LADDER, {"modes": "pgran_ladder:HOME"}, "there is one of this name already"),
        (LADDER, {"ladder": "pgran_ladder:scene"}, "no attribute 'scene'"),
        (LADDER | {"scene": "import nothing_there"}, {"ladder": "pgran_ladder:HOME"}, "No module"),
        (LADDER | {"__init__": "HOME = 3"}, {"ladder": "pgran_ladder:HOME"}, "no pgran.catalogue"),
        (LADDER | {"record": ""}, {"ladder": "pgran_ladder:HOME"}, "declares no record"),
        (
            LADDER | {"__init__": HOME.replace("rungs", "modes")},
            {"ladder": "pgran_ladder:HOME"},
            "results called modes already",
        ),
    ],
)
def test_what_cannot_be_used_is_said_and_left_out(install, call, place, modules, experiments, said):
    install(modules, **experiments)
    place("ladder.opts", RUN)
    done = call("run", "ladder.opts")
    (name,) = experiments
    assert done.returncode == 2
    assert f"no experiment {name} of ladder: " in done.stderr
    assert said in done.stderr
    assert "-scene ladder" in done.stderr
    assert call("run", "a.opts").returncode == 0


def test_nobody_looks_for_packages_without_need(install, call, monkeypatch):
    install(LADDER | {"__init__": "raise SystemExit"}, ladder="pgran_ladder:HOME")
    monkeypatch.setattr(catalogue.Experiments, "_add_installed", None)
    assert call("run", "a.opts").returncode == 0
    assert call("plot", "results/a.h5").returncode == 0
    assert call("run", "a.opts", "-relax_steps", "3").returncode == 2
