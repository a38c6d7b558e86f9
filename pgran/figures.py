"""The panels of figures, `pgran.figures.response.amplitude(ax, result.response, result.medium)`.

By the group of a result that they draw, each in its experiment's folder; besides their `style`,
and `together`, which lays several results over each other.
"""

import sys
from importlib import import_module

from pgran.catalogue import EXPERIMENTS, FIGURES

__path__ = []  # a package, of modules that are loaded: `import pgran.figures.response`
MODULES = {"style": "pgran.draw.style", "together": "pgran.draw.together"} | FIGURES

for _name, _module in MODULES.items():
    if _module.startswith("pgran."):
        globals()[_name] = sys.modules[f"{__name__}.{_name}"] = import_module(_module)


def __getattr__(name):
    EXPERIMENTS.complete()
    if name not in FIGURES:
        raise AttributeError(f"module pgran.figures has no attribute {name!r}")
    return import_module(FIGURES[name])  # of an installed package
