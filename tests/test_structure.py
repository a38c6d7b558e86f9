"""What may import what: no import runs upward, and none in a circle, within functions neither."""

import ast
import graphlib
from pathlib import Path

BELOW = {  # of each package and module at the top: what it may import
    "blas": "", "errors": "", "arguments": "errors", "record": "errors", "machine": "errors",
    "results": "errors record physics", "physics": "errors arguments machine results",
    "parallel": "errors", "solve": "errors physics parallel",
    "files": "errors arguments record results machine physics",
    "figures": "errors record results files",
    "scenes": "errors arguments results machine physics solve parallel files",
    "command": "blas errors arguments record results machine physics solve parallel files figures "
    "scenes",
    "__main__": "errors parallel files command", "__init__": "blas",
}  # fmt: skip


def test_imports_run_downward():
    house, graph = Path(__file__).parents[1] / "pgran", {}
    for path in house.rglob("*.py"):
        module = ".".join(path.relative_to(house).with_suffix("").parts)
        nodes = list(ast.walk(ast.parse(path.read_text())))
        names = {alias.name for n in nodes if isinstance(n, ast.Import) for alias in n.names}
        for node in (n for n in nodes if isinstance(n, ast.ImportFrom)):
            names |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
        graph[module] = {n.removeprefix("pgran.") for n in names if n.startswith("pgran.")}
        home = module.split(".")[0]
        upward = {n for n in graph[module] if n.split(".")[0] not in {home, *BELOW[home].split()}}
        assert not upward, f"{module} imports {upward}"
    assert list(graphlib.TopologicalSorter(graph).static_order())
