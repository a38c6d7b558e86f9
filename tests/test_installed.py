"""Experiments of installed packages run, and are read, drawn and listed, as those of pgran."""

import importlib
import sys

import numpy as np
import pytest

import pgran
import pgran.figures
import pgran.results
from pgran import catalogue

LADDER = {
    "__init__": """
from pgran.catalogue import Home
HOME = Home("pgran_ladder", {"rungs": "figures"})
""",
    "scene": """
import numpy as np
from pgran.medium.base import medium
from pgran.run.experiment import PROGRESS, Scene, in_parallel, option, options_of, run_of
from pgran.run.task import Task, carry_out
from pgran.store.record import columns_of, row_of
from pgran_ladder.record import Rungs

class Climb(Task):
    items, row = "rungs", np.dtype(row_of(Rungs))

    def __init__(self, lattice, rungs):
        self.lattice, self.units = lattice, range(1, rungs + 1)

    def work(self, unit, group):
        return np.full(1, unit * self.lattice.omega_mx).astype(self.row)

    def collect(self, rows, seconds):
        return Rungs(**columns_of(Rungs, rows))

@in_parallel("ladder", lattice=medium)
def climb(lattice, crew=None, *, rungs=option(4, "how many", low=1), progress=PROGRESS) -> Rungs:
    '''Climb a ladder whose rungs are omega_mx apart.'''
    return carry_out(Climb(lattice, rungs), crew, progress)

SCENE = Scene(options_of(climb), run_of(climb), lambda found: [f"{len(found.rungs.omega)} rungs"])
""",
    "record": """
from dataclasses import dataclass
import numpy as np
from pgran.store.record import Record, array

@dataclass(frozen=True, eq=False, repr=False)
class Rungs(Record):
    group = "rungs"
    omega: np.ndarray = array("height", "sqrt(k/m)", row=True)
""",
    "figures": """
from pgran.draw import style

def figures(result, **_):
    draw = lambda ax, rungs: ax.plot(rungs.omega)
    yield "rungs", style.stack([draw], ["The rungs."], rungs=result.rungs)
""",
}
RUN = "-scene ladder -lattice_shape 3,2 -output_progress none"


@pytest.fixture
def install(place, shared_path, world, monkeypatch):
    """Return what installs a package of these modules, and an entry point of a name and a value."""
    tables = catalogue.RECORDS, catalogue.FIGURES
    before = [dict(table) for table in tables]
    monkeypatch.setattr(catalogue.EXPERIMENTS, "_homes", dict(catalogue.OURS))
    monkeypatch.setattr(catalogue.EXPERIMENTS, "_looked", False)
    monkeypatch.syspath_prepend(shared_path)

    def install(modules, name="ladder", value="pgran_ladder:HOME"):
        if world.rank == 0:
            for folder in ("pgran_ladder", "ladder-1.dist-info"):
                (shared_path / folder).mkdir()
        for module, text in modules.items():
            place(f"pgran_ladder/{module}.py", text)
        place("ladder-1.dist-info/METADATA", "Name: ladder\nVersion: 1\n")
        place("ladder-1.dist-info/entry_points.txt", f"[pgran.experiments]\n{name} = {value}\n")
        place("ladder.opts", RUN)
        importlib.invalidate_caches()

    yield install
    for table, ours in zip(tables, before, strict=True):
        table.clear()
        table.update(ours)
    for name in [name for name in sys.modules if name.startswith("pgran_ladder")]:
        del sys.modules[name]


def test_an_installed_experiment_is_as_one_of_pgran(install, call, world):
    install(LADDER)
    words = "run", "ladder.opts", "-ladder_rungs", "3"
    done = call(*words, "-output_file", "a.h5")
    assert (done.returncode, "3 rungs" in done.stderr) == (0, True), done.stderr
    assert "3 rungs" in call(*words, "-dry_run").stdout
    assert "-ladder_rungs" in call("options", "ladder").stdout
    assert "only of ladder" in call("options").stdout
    assert "mean -ladder_rungs?" in call("run", "ladder.opts", "-ladder_rung", "3").stderr
    if world.size == 1:
        assert call("verify", "a.h5").returncode == call("export", "a.h5", "a.csv").returncode == 0
        result = pgran.load("a.h5")
        assert type(result.rungs) is pgran.results.Rungs
        assert np.array_equal(result.rungs.omega, np.arange(1, 4) * result.medium.omega_mx)
        assert list(pgran.plot(result)) == ["rungs"]
        assert pgran.figures.rungs.__name__ == "pgran_ladder.figures"


@pytest.mark.parametrize(
    ("modules", "point", "said"),
    [
        ({}, ["modes", "pgran_ladder:HOME"], "there is one of this name already"),
        ({}, ["ladder", "pgran_ladder:PLACE"], "no attribute 'PLACE'"),
        ({"scene": "import nothing_there"}, [], "No module named 'nothing_there'"),
        ({"__init__": "HOME = 3"}, [], "pgran_ladder:HOME is no pgran.catalogue.Home"),
        ({"__init__": "raise SystemExit"}, [], "SystemExit"),
        ({"record": ""}, [], "pgran_ladder.record declares no record of the group rungs"),
        ({"__init__": LADDER["__init__"].replace("rungs", "modes")}, [], "called modes already"),
    ],
)
def test_what_cannot_be_used_is_said_and_left_out(install, call, modules, point, said):
    install(LADDER | modules, *point)
    done = call("run", "ladder.opts")
    assert done.returncode == 2
    assert f"no experiment {(point or ['ladder'])[0]} of ladder: " in done.stderr
    assert said in done.stderr
    assert "-scene ladder (ladder.opts, line 1): choose accuracy, " in done.stderr
    assert call("run", "a.opts").returncode == 0


def test_nobody_looks_for_packages_without_need(install, call, monkeypatch):
    """Nor where a key is one of another scene, or a result of pgran's is read."""
    install(LADDER)
    monkeypatch.setattr(catalogue.Experiments, "complete", None)
    assert call("run", "a.opts").returncode == 0
    assert pgran.load("results/a.h5").response
    assert call("run", "a.opts", "-relax_steps", "3").returncode == 2
