"""The panels of figures, `pgran.figures.response.amplitude(ax, result.response, result.medium)`.

By the group of a result that they draw, each in its experiment's folder; besides their `style`,
and `together`, which lays several results over each other.
"""

import sys
from importlib import import_module
from importlib.machinery import ModuleSpec

from pgran.catalogue import FIGURES

MODULES = {"style": "pgran.draw.style", "together": "pgran.draw.together"} | FIGURES
__path__ = []  # a package, of whose modules `Panels` knows where they are


def __getattr__(name):
    if name not in MODULES:
        raise AttributeError(f"module pgran.figures has no attribute {name!r}")
    return import_module(MODULES[name])


class Panels:
    """What `import pgran.figures.response` finds the module by, and loads it with."""

    @classmethod
    def find_spec(cls, name, path, target=None):
        """Return where a module is from, if it is one of panels."""
        package, _, group = name.rpartition(".")
        return ModuleSpec(name, cls) if package == __name__ and group in MODULES else None

    @staticmethod
    def create_module(spec):
        """Let Python make an empty module."""

    @staticmethod
    def exec_module(module):
        """Put the module of the experiment in place of the empty one."""
        group = module.__name__.rpartition(".")[2]
        sys.modules[module.__name__] = import_module(MODULES[group])


sys.meta_path.append(Panels)
