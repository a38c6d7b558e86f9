"""Which experiments there are: a new one is its folder in `pgran.experiments`, and its line here.

Nothing here imports one: who asks for an experiment, a record or its figures loads that alone.
"""

from importlib import import_module
from typing import NamedTuple


class Home(NamedTuple):
    """Where an experiment lives, below `pgran.experiments`; its records are in `record`.

    It has the facts of its SCENE, too, which is loaded for them.
    """

    scene: str  # the module of its SCENE
    groups: dict  # of each group of its results the module that draws it, or None

    @property
    def folder(self):
        """Its package."""
        return f"pgran.experiments.{self.scene.partition('.')[0]}"

    def __getattr__(self, fact):
        return getattr(import_module(f"pgran.experiments.{self.scene}").SCENE, fact)


EXPERIMENTS = {
    "accuracy": Home("accuracy.scene", {"accuracy": "figures"}),
    "continuum": Home("continuum.scene", {"continuum": "figures"}),
    "ensemble": Home(
        "ensemble.scene",
        {
            "ensemble": "figures",
            "statistics": "figures_statistics",
            "transport": "figures_transport",
            "diffusion": "figures_transport",
        },
    ),
    "green": Home("green.scene", {"green": "figures"}),
    "modes": Home(
        "modes.scene",
        {"modes": "figures", "density": "figures_density", "damped_modes": "figures_damped"},
    ),
    "projection": Home("modes.projection", {"projection": "figures_projection"}),
    "pulse": Home("pulse.scene", {"pulse": "figures"}),
    "relaxation": Home(
        "relaxation.scene", {"relaxation": "figures", "spectrum": None, "memory": None}
    ),
    "response": Home("response.scene", {"response": "figures"}),
    "sensitivity": Home("sensitivity.scene", {"sensitivity": "figures", "heat": "figures_heat"}),
    "structure": Home("structure.scene", {"structure": "figures"}),
}

# what results of experiments are measured by, which no run does
MEASURES = {"likeness": Home("likeness.compare", {"likeness": "figures"})}

POINTS = ("sensitivity",)  # of their results a figure of several has points, which need no labels

HOMES = [*EXPERIMENTS.values(), *MEASURES.values()]
# Where records and figures of each group are; the medium, whose axes the others share, comes first.
RECORDS = dict.fromkeys(("lattice", "network"), "pgran.medium.record") | {
    group: f"{home.folder}.record" for home in HOMES for group in home.groups
}
FIGURES = {"network": "pgran.draw.network"} | {
    group: f"{home.folder}.{module}"
    for home in HOMES
    for group, module in home.groups.items()
    if module
}


def record_kind(group):
    """Return the record that a group of a result is read as."""
    declared = vars(import_module(RECORDS[group])).values()
    return next(k for k in declared if getattr(k, "group", None) == group and not k.within)


def figures(group):
    """Return the module that draws a group of a result."""
    return import_module(FIGURES[group])
