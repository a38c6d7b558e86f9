"""Which experiment a run is, and its options: all scenes, and what keys mean to one of them."""

import hashlib
import shlex

from pgran import catalogue
from pgran.arguments import meant, nearest
from pgran.errors import InputError
from pgran.medium.sample import LATTICE, check_lattice
from pgran.run import keys as solver_keys
from pgran.run.options import FILE, FILES, RUN, TEXT, Option, text_of
from pgran.store.paths import open_regular

SCENES = catalogue.EXPERIMENTS  # the facts of each by name, loaded as they are asked for
SCENE_OPTION = Option("scene", TEXT, None, "the experiment", choices=tuple(SCENES))


def options_of(scene):
    """Return all options of a scene by name, those of every run last."""
    facts = SCENES[scene]
    medium = LATTICE if facts.on_medium else ()
    return {option.name: option for option in (*medium, *facts.options, *RUN)}


def resolve(given, output_file=None):
    """Return the Options that keys mean, a sequence of `Given`, later ones winning.

    `output_file` is where the result goes unless the options say.
    """
    last = {item.key.lower(): item for item in given}
    if "scene" not in last:
        raise InputError(f"-scene is missing: choose {', '.join(SCENES)}")
    scene = SCENE_OPTION.read(last["scene"].text, last["scene"].where)
    options = options_of(scene)
    values = {name: option.default for name, option in options.items()}
    values["output_file"] = output_file
    solver = {}
    for key, item in last.items():
        if key in options:
            values[key] = options[key].read(item.text, item.where)
        elif key != "scene":
            _check_foreign(key, item, scene)
            solver[key] = item.text
    solver_keys.check_pivot_shifts(solver)
    of = values.get(f"{scene}_of", scene)  # the experiment that is repeated
    if not SCENES[of].shares_lattice and values["ranks_per_lattice"] > 1:
        raise InputError(f"-ranks_per_lattice: scene {of} has one rank for each lattice only")
    if SCENES[scene].on_medium:
        check_lattice(values, last, SCENES[of].draws, several=scene == "ensemble")
    if of != scene:
        _check_repeated(scene, of, values, last)
    SCENES[scene].check(values, last)
    return Options(scene, options.values(), values, solver)


def _check_repeated(scene, of, values, given):
    """Raise where options are given of other experiments than the one that is repeated; unset them.

    Options that no experiment has which the scene could repeat are its own.
    """
    possible = options_of(scene)[f"{scene}_of"].choices
    others = {name for each in possible for name in options_of(each)} - options_of(of).keys()
    for name in [name for name in values if name in others]:
        if name in given:
            raise InputError(f"-{name}{given[name].where}: -{scene}_of {of} does not use it")
        values[name] = None


def _check_foreign(key, item, scene):
    """Raise unless a key that is no option of the scene belongs to PETSc."""
    if solver_keys.is_listed(key):  # and no option's name: no other experiment is loaded for it
        solver_keys.check_in_file(key, item)
        return
    *others, last = [name for name in SCENES if key in options_of(name)] or [None]
    if last:
        do = f"{', '.join(others)} and {last} do" if others else f"{last} does"
        raise InputError(f"-{key}{item.where}: scene {scene} does not use it, but {do}")
    if solver_keys.is_solver_key(key) or solver_keys.is_petsc_key(key):
        solver_keys.check_in_file(key, item)
        return
    if key in ("n", "np"):
        raise InputError(f"-{key}{item.where}: ranks are started by mpirun -n N pgran run ...")
    name = "output_file" if key in ("o", "out", "output") else key
    ends = [known for known in options_of(scene) if known.endswith(f"_{name}")]
    near = min(ends, key=len, default=None) or nearest(name, ["scene", *options_of(scene)])
    if key.startswith(("ksp_", "pc_")):
        near = f"steady_{key}"
    elif key.startswith(("eps_", "st_")):
        near = f"normal_{key}"
    hint = meant(near and f"-{near}")
    raise InputError(f"-{key}{item.where}: unknown option{hint} (pgran options {scene} lists all)")


class Options:
    """The resolved options of a run: `options.lattice_shape` is the value of `-lattice_shape`.

    `values` are those of the declared options by name, `solver` holds the keys that go to PETSc.
    """

    def __init__(self, scene, declared, values, solver):
        self.scene, self._declared, self._values, self.solver = scene, declared, values, solver

    def __getattr__(self, name):
        if name not in self.__dict__["_values"]:
            raise AttributeError(f"scene {self.scene} has no option -{name}")
        return self._values[name]

    def changed(self, **values):
        """Return the same options with other values."""
        return Options(self.scene, self._declared, self._values | values, self.solver)

    def text(self):
        """Return an options file that reproduces the run, whether or not that was a dry one."""
        lines = [f"-scene {self.scene}"]
        for option, value in self._known():
            if option.name not in ("output_overwrite", "dry_run"):
                lines.append(option.write(value))
        for key, text in self.solver.items():
            lines.append(f"-{key} {shlex.quote(text)}" if text else f"-{key}")
        return "\n".join(lines) + "\n"

    def identity(self):
        """Return what decides the run's numbers, {option: text}, the contents of files, too."""

        def contents(path):
            with open_regular(path) as stream:
                return f"{path} holds {hashlib.file_digest(stream, 'sha256').hexdigest()[:16]}"

        texts = {option.name: text_of(v) for option, v in self._known() if option not in RUN}
        for option, value in self._known():
            if option.kind in (FILE, FILES):
                paths = value if isinstance(value, tuple) else (value,)
                texts[option.name] += f" ({', '.join(map(contents, paths))})"
        solver = {key: text for key, text in self.solver.items() if solver_keys.is_solver_key(key)}
        return {"scene": self.scene} | texts | solver

    def _known(self):
        """Return pairs of the options that have a value, and it."""
        pairs = [(option, self._values[option.name]) for option in self._declared]
        return [(option, value) for option, value in pairs if value is not None]
