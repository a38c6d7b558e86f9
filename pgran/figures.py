"""The panels of figures, `pgran.figures.response.amplitude(ax, result.response, result.medium)`.

By the group of a result that they draw, each in its experiment's folder; besides their `style`,
and `together`, which lays several results over each other.
"""

from importlib import import_module

from pgran.catalogue import FIGURES

SHARED = {"style": "pgran.draw.style", "together": "pgran.draw.together"}


def __getattr__(name):
    """Return the module of a group's panels."""
    modules = SHARED | FIGURES
    if name not in modules:
        raise AttributeError(f"module pgran.figures has no attribute {name!r}")
    return import_module(modules[name])
