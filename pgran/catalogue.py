"""Which experiments there are: a new one is its folder in `pgran.experiments`, and its line here.

Nothing here imports one: who asks for an experiment, a record or its figures loads that alone.
"""

from importlib import import_module
from typing import NamedTuple


class Home(NamedTuple):
    """Where an experiment lives, below `pgran.experiments`.

    Attributes
    ----------
    scene : str
        The module of its SCENE.
    groups : dict of str: str or None
        Of each group of its results the module that draws it; the records are in `record`.
    """

    scene: str
    groups: dict


EXPERIMENTS = {
    "accuracy": Home("accuracy.scene", {"accuracy": "figures"}),
    "continuum": Home("continuum.scene", {"continuum": "figures"}),
    "ensemble": Home(
        "ensemble.scene",
        {
            "ensemble": "figures",
            "statistics": "figures_statistics",
            "transport": "figures_transport",
        },
    ),
    "modes": Home("modes.scene", {"modes": "figures", "density": "figures_density"}),
    "projection": Home("modes.projection", {"projection": "figures_projection"}),
    "pulse": Home("pulse.scene", {"pulse": "figures"}),
    "relaxation": Home(
        "relaxation.scene", {"relaxation": "figures", "spectrum": None, "memory": None}
    ),
    "response": Home("response.scene", {"response": "figures"}),
    "sensitivity": Home("sensitivity.scene", {"sensitivity": "figures", "heat": "figures_heat"}),
}


def _folder(home):
    """Return the package of an experiment."""
    return f"pgran.experiments.{home.scene.partition('.')[0]}"


# Where records and figures of each group are; the medium, whose axes the others share, comes first.
RECORDS = dict.fromkeys(("lattice", "network"), "pgran.medium.record") | {
    group: f"{_folder(home)}.record" for home in EXPERIMENTS.values() for group in home.groups
}
FIGURES = {"network": "pgran.draw.network"} | {
    group: f"{_folder(home)}.{module}"
    for home in EXPERIMENTS.values()
    for group, module in home.groups.items()
    if module
}


def scene(name):
    """Return the facts of an experiment."""
    return import_module(f"pgran.experiments.{EXPERIMENTS[name].scene}").SCENE


def record_kind(group):
    """Return the record that a group of a result is read as."""
    declared = vars(import_module(RECORDS[group])).values()
    return next(k for k in declared if getattr(k, "group", None) == group and not k.within)


def figures(group):
    """Return the module that draws a group of a result."""
    return import_module(FIGURES[group])
