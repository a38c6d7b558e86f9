"""Which experiment a run is, and its options: all scenes, and what keys mean to one of them."""

import hashlib
import shlex

from pgran import catalogue
from pgran.arguments import meant, nearest
from pgran.errors import InputError
from pgran.run import keys as solver_keys
from pgran.run.options import FILE, FILES, RUN, TEXT, Option, text_of
from pgran.store.paths import open_regular

SCENES = catalogue.EXPERIMENTS  # the facts of each by name, loaded as they are asked for


def scene_option():
    """Return the option of the experiment, whose choices are all that are installed."""
    return Option("scene", TEXT, None, "the experiment", choices=tuple(SCENES))


def options_of(scene, of=None):
    """Return all options of a scene by name, those of every run last.

    One that repeats another scene has the options of `of`, by default of all that it can repeat.
    """
    facts, options = SCENES[scene], []
    if facts.on_medium:
        from pgran.medium import sample

        options += sample.LATTICE
    options += facts.options
    for other in [of] if of else repeated_by(scene):
        options += (o for o in SCENES[other].options if o.name not in facts.decides)
    return {option.name: option for option in (*options, *RUN)}


def repeated_by(scene):
    """Return the scenes that a scene can repeat, of which -SCENE_of says one."""
    return next((o.choices for o in SCENES[scene].options if o.name == f"{scene}_of"), ())


def resolve(given, output_file=None):
    """Return the Options that keys mean, a sequence of `Given`, later ones winning.

    `output_file` is where the result goes unless the options say.
    """
    last = {item.key.lower(): item for item in given}
    if "scene" not in last:
        raise InputError(f"-scene is missing: choose {', '.join(SCENES)}")
    scene, where = last["scene"].text, last["scene"].where
    if scene not in catalogue.OURS:
        scene = scene_option().read(scene, where)
    of = _repeated(scene, last)
    options = options_of(scene, of)
    values = {name: option.default for name, option in options.items()}
    values["output_file"] = output_file
    solver = {}
    for key, item in last.items():
        if key in options:
            values[key] = options[key].read(item.text, item.where)
        elif key != "scene":
            _check_foreign(key, item, scene, of)
            solver[key] = item.text
    solver_keys.check_pivot_shifts(solver)
    computed = SCENES[of or scene]
    if not computed.shares_lattice and values["ranks_per_lattice"] > 1:
        raise InputError(
            f"-ranks_per_lattice: scene {of or scene} has one rank for each lattice only"
        )
    if SCENES[scene].on_medium:
        from pgran.medium.sample import check_lattice

        check_lattice(values, last, computed.draws, several=scene == "ensemble")
    SCENES[scene].check(values, last)
    return Options(scene, options.values(), values, solver)


def _repeated(scene, given):
    """Return the scene that a scene repeats, if it repeats one."""
    for option in SCENES[scene].options:
        if option.name == f"{scene}_of":
            item = given.get(option.name)
            return option.read(item.text, item.where) if item else option.default
    return None


def _check_foreign(key, item, scene, of):
    """Raise unless a key that is no option of the scene, which may repeat `of`, is PETSc's."""
    if solver_keys.is_listed(key):  # and no option's name: no other experiment is loaded for it
        solver_keys.check_in_file(key, item)
        return
    if of and key in options_of(scene):
        raise InputError(f"-{key}{item.where}: -{scene}_of {of} does not use it")
    *others, last = [name for name in catalogue.OURS if key in options_of(name)] or [None]
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


def run_scene(scene, options, world, crew):
    """Carry an experiment out, and return its records on rank 0, None on the others.

    Collective. `crew(ranks, medium)` makes a crew of all ranks, of which so many share the medium.
    """
    if not scene.on_medium:
        with crew(1, None) as workers:
            return scene.run(None, options, workers)
    from pgran.medium.sample import make_lattice, ranks_per_lattice
    from pgran.medium.units import warn_of_damping

    medium = make_lattice(options, world)
    if world.rank == 0 and options.network_file and options.network_damping is None:
        warn_of_damping(medium, "-network_damping")
    ranks = world.size if scene.whole else ranks_per_lattice(scene, options, medium, world)
    with crew(ranks, medium) as workers:
        records = scene.run(medium, options, workers)
    if records is None:
        return None
    from pgran.medium.record import record_of

    return [record_of(medium), *records]
