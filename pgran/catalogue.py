"""Which experiments there are: of pgran a folder in `pgran.experiments` and its line here each.

Others come with installed packages, which name a `Home` by an entry point:

    [project.entry-points."pgran.experiments"]
    probe = "pgran_probe:HOME"    # HOME = pgran.catalogue.Home("pgran_probe", {"probe": "figures"})

Nothing here imports an experiment of pgran: who asks for its facts, its records or its figures
loads these alone. Installed ones are looked for when a name is none of ours, or all are asked for.
"""

from collections.abc import Mapping
from importlib import import_module
from typing import NamedTuple

from pgran.errors import PgranError, log

ENTRY_POINTS = "pgran.experiments"


class Home(NamedTuple):
    """Where an experiment lives: a package, whose module `record` has the records of its results.

    It has the facts of its SCENE, too, which is loaded for them.
    """

    package: str
    groups: dict  # of each group of its results the module that draws it, or None
    scene: str = "scene"  # the module of its SCENE

    def __getattr__(self, fact):
        return getattr(import_module(f"{self.package}.{self.scene}").SCENE, fact)


def _ours(folder, scene="scene", **groups):
    """Return the home of an experiment of pgran; its results are drawn by `figures` as a rule."""
    return Home(f"pgran.experiments.{folder}", groups or {folder: "figures"}, scene)


OURS = {
    "accuracy": _ours("accuracy"),
    "continuum": _ours("continuum"),
    "ensemble": _ours(
        "ensemble",
        **dict.fromkeys(("ensemble", "statistics", "transport", "diffusion"), "figures"),
    ),
    "green": _ours("green"),
    "loud": _ours("loud"),
    "modes": _ours(
        "modes", modes="figures", density="figures_density", damped_modes="figures_damped"
    ),
    "projection": _ours("modes", "projection", projection="figures_projection"),
    "pulse": _ours("pulse"),
    "relaxation": _ours("relaxation", relaxation="figures", spectrum=None, memory=None),
    "response": _ours("response"),
    "sensitivity": _ours("sensitivity", sensitivity="figures", heat="figures_heat"),
    "structure": _ours("structure"),
}
MEASURES = _ours("likeness", "compare")  # what results are measured by, which no run does
POINTS = ("sensitivity",)  # of their results a figure of several has points, which need no labels

# The modules of records and of figures by group; the medium, whose axes others share, comes first.
RECORDS = {"lattice": "pgran.medium.record", "network": "pgran.medium.network"}
FIGURES = {"network": "pgran.draw.network"}


def _add(home):
    """Add the groups of an experiment's results to those that are read and drawn."""
    for group, module in home.groups.items():
        RECORDS[group] = f"{home.package}.record"
        if module:
            FIGURES[group] = f"{home.package}.{module}"


class Experiments(Mapping):
    """All experiments by name; see above when those of installed packages are among them."""

    def __init__(self):
        self._homes, self._looked = dict(OURS), False

    def __getitem__(self, name):
        if name not in self._homes:
            self.complete()
        return self._homes[name]

    def __iter__(self):
        self.complete()
        return iter(self._homes)

    def __len__(self):
        return len(list(iter(self)))

    def complete(self):
        """Look, once, for what installed packages have; what cannot be used is said, left out."""
        from importlib import metadata

        found = () if self._looked else metadata.entry_points(group=ENTRY_POINTS)
        self._looked = True
        for entry in sorted(found, key=lambda entry: entry.name):
            try:
                self._homes[entry.name] = self._loaded(entry)
            except (Exception, SystemExit) as error:  # whatever a package raises
                why = error if isinstance(error, PgranError) else f"{type(error).__name__}: {error}"
                log.warning("no experiment %s of %s: %s", entry.name, entry.dist.name, why)

    def _loaded(self, entry):
        """Return the home that an entry point names, once its facts and records are loaded."""
        if entry.name in self._homes:
            raise PgranError("there is one of this name already")
        home = entry.load()
        if not isinstance(home, Home):
            raise PgranError(f"{entry.value} is no pgran.catalogue.Home")
        records = import_module(f"{home.package}.record")
        for group in home.groups:
            if group in RECORDS:
                raise PgranError(f"there are results called {group} already")
            _kind(records, group)
        home.options  # noqa: B018
        _add(home)
        return home


def code_of(scene):
    """Return what of its code decides an installed experiment's numbers, {package: checksum}."""
    if scene in OURS:
        return {}
    import hashlib
    from pathlib import Path

    package = EXPERIMENTS[scene].package
    folder = Path(import_module(package).__file__).parent
    code = b"".join(path.read_bytes() for path in sorted(folder.rglob("*.py")))
    return {package: f"code {hashlib.sha256(code).hexdigest()[:16]}"}


def without(scene):
    """Return in words that no package has the experiment that a result is of, if that is so."""
    known = scene in RECORDS or scene in EXPERIMENTS  # a lattice or a network by itself
    return "" if known else "; no package that is installed has this experiment"


def groups_of(scene):
    """Return the groups that results of a scene can have, those of all other scenes among them."""
    if scene not in RECORDS:
        EXPERIMENTS.get(scene)  # of an installed package
    return list(RECORDS)


def record_kind(group):
    """Return the record that a group of a result is read as."""
    return _kind(import_module(RECORDS[group]), group)


def _kind(records, group):
    """Return the record of a group in a module; raise a PgranError if there is none."""
    for kind in vars(records).values():
        if getattr(kind, "group", None) == group and not kind.within:
            return kind
    raise PgranError(f"{records.__name__} declares no record of the group {group}")


def figures(group):
    """Return the module that draws a group of a result."""
    return import_module(FIGURES[group])


for _home in (*OURS.values(), MEASURES):
    _add(_home)
EXPERIMENTS = Experiments()
