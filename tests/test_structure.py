"""What may import what: no import runs upward, and none in a circle, within functions neither."""

import ast
import graphlib
import importlib
import subprocess
import sys
from pathlib import Path

import pgran.figures.response as panels
import pytest
from pgran.figures.pulse import seismogram

import pgran.results
from pgran import catalogue
from pgran.results import Response

HOUSE = Path(__file__).parents[1] / "pgran"
TOP = "errors arguments catalogue"  # files beside the folders; the catalogue is a table of names
BELOW = {  # of each folder and file at the top: what it may import
    "errors": "", "arguments": "errors", "catalogue": "errors", "results": "catalogue",
    "figures": "catalogue", "store": TOP, "run": f"{TOP} store", "medium": f"{TOP} store run",
    "driven": f"{TOP} store run medium", "draw": f"{TOP} store run medium",
    "balance": f"{TOP} run medium", "foreign": f"{TOP} store run medium",
    "experiments": f"{TOP} store run medium balance driven draw",
    "command": f"{TOP} store run medium balance draw foreign",
    "__main__": "errors arguments run store command", "__init__": "run",
}  # fmt: skip
REPEATING = {"ensemble", "accuracy"}  # experiments that know others, because they repeat them


def imports():
    """Return the names that each module of pgran imports, within functions, too."""
    graph = {}
    for path in HOUSE.rglob("*.py"):
        module = ".".join(path.relative_to(HOUSE).with_suffix("").parts)
        nodes = list(ast.walk(ast.parse(path.read_text())))
        names = {alias.name for n in nodes if isinstance(n, ast.Import) for alias in n.names}
        for node in (n for n in nodes if isinstance(n, ast.ImportFrom)):
            names |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
        graph[module] = names
    return graph


IMPORTS = imports()


def inside(module):
    """Return which parts of pgran a module imports."""
    return {n.removeprefix("pgran.") for n in IMPORTS[module] if n.startswith("pgran.")}


def test_imports_run_downward():
    for module in IMPORTS:
        home, *rest = module.split(".")
        upward = {n for n in inside(module) if n.split(".")[0] not in {home, *BELOW[home].split()}}
        assert not upward, f"{module} imports {upward}"
        if home == "experiments" and rest[0] not in REPEATING:
            others = {n for n in inside(module) if n.startswith("experiments.")}
            others = {n for n in others if n.split(".")[1] != rest[0]}
            assert not others, f"{module} imports {others}"
    assert list(graphlib.TopologicalSorter({m: inside(m) for m in IMPORTS}).static_order())


def test_who_knows_petsc_matplotlib_and_scenes():
    for module, names in IMPORTS.items():
        packages = {name.split(".")[0] for name in names}
        if packages & {"petsc4py"}:
            assert module in ("run.petsc", "command.run", "command.doctor"), module
        last = module.rpartition(".")[2]
        if last.startswith("record"):
            assert not {n for n in inside(module) if n.endswith((".scene", ".petsc"))}, module
        if "matplotlib" in packages:
            assert module.startswith("draw.") or last.startswith("figures") or module in (
                "command.doctor", "experiments.sensitivity.maps"), module  # fmt: skip


def test_public_names_of_records_and_panels():
    """Whatever folder they are in."""
    for group, module in catalogue.RECORDS.items():
        kind = catalogue.record_kind(group)
        assert getattr(pgran.results, kind.__name__) is kind
        assert kind.__module__ == module
    assert pgran.results.Models.within == "response"
    for group, module in catalogue.FIGURES.items():
        assert getattr(pgran.figures, group).__name__ == module
    assert pgran.figures.style.applied
    assert panels is catalogue.figures("response") is pgran.figures.response
    assert seismogram is catalogue.figures("pulse").seismogram
    assert Response is catalogue.record_kind("response")
    with pytest.raises(ImportError, match="nothing"):
        importlib.import_module("pgran.figures.nothing")
    for module in (pgran.results, pgran.figures):
        with pytest.raises(AttributeError, match="no attribute 'nothing'"):
            module.nothing  # noqa: B018


def test_what_a_name_loads():
    """Derivatives load nothing of packings: a heater does when one is asked for."""
    code = """
import sys
import pgran
pgran.sensitivity, pgran.heat, pgran.sweep
unneeded = ".heat", ".radii", ".growth"
print(*(name for name in sys.modules if "balance" in name or name.endswith(unneeded)))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []
