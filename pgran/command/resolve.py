"""Which experiment a run is, and its options: what keys mean to one scene, and what that solves."""

import hashlib
import shlex

from pgran import catalogue
from pgran.arguments import meant, nearest
from pgran.errors import InputError
from pgran.run.options import FILE, FILES, RUN, TEXT, Option, text_of
from pgran.store.estimate import counted
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
    repeated = _repeating_option(scene)
    for other in [of] if of else repeated.choices if repeated else ():
        options += (o for o in SCENES[other].options if o.name not in facts.decides)
    return {option.name: option for option in (*options, *RUN)}


def _repeating_option(scene):
    """Return the option that says which scene is repeated; None where a scene repeats none."""
    return next((o for o in SCENES[scene].options if o.name == f"{scene}_of"), None)


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
    of, repeating = None, _repeating_option(scene)
    if repeating:
        item = last.get(repeating.name)
        of = repeating.read(item.text, item.where) if item else repeating.default
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
    if solver:
        from pgran.run import keys

        keys.check_pivot_shifts(solver)
    computed = of or scene
    if not SCENES[computed].shares_lattice and values["ranks_per_lattice"] > 1:
        raise InputError(f"-ranks_per_lattice: scene {computed} has one rank for each lattice only")
    if SCENES[scene].on_medium:
        from pgran.medium import sample

        draws = SCENES[computed].draws
        sample.check_lattice(values, last, draws, several=scene == "ensemble")
    SCENES[scene].check(values, last)
    return Options(scene, options.values(), values, solver)


def _check_foreign(key, item, scene, of):
    """Raise unless a key that is no option of the scene, which may repeat `of`, is PETSc's."""
    from pgran.run import keys

    if keys.is_listed(key):  # and no option's name: no other experiment is loaded for it
        return keys.check_in_file(key, item)
    known = options_of(scene)
    if key in known:
        raise InputError(f"-{key}{item.where}: -{scene}_of {of} does not use it")
    *others, last = [name for name in catalogue.OURS if key in options_of(name)] or [None]
    if last:
        do = f"{', '.join(others)} and {last} do" if others else f"{last} does"
        raise InputError(f"-{key}{item.where}: scene {scene} does not use it, but {do}")
    if keys.is_solver_key(key) or keys.is_petsc_key(key):
        return keys.check_in_file(key, item)
    if key in ("n", "np"):
        raise InputError(f"-{key}{item.where}: ranks are started by mpirun -n N pgran run ...")
    from pgran.run.gone import check_gone

    check_gone(key, item.where)
    hint = meant(_key_meant(key, known))
    raise InputError(f"-{key}{item.where}: unknown option{hint} (pgran options {scene} lists all)")


def _key_meant(key, known):
    """Return which of the keys that are known, or of a solver's, is meant by another, or None."""
    if key.startswith(("ksp_", "pc_")):
        return f"-steady_{key}"
    if key.startswith(("eps_", "st_")):
        return f"-normal_{key}"
    name = "output_file" if key in ("o", "out", "output") else key
    ends = [whole for whole in known if whole.endswith(f"_{name}")]
    near = min(ends, key=len, default=None) or nearest(name, ["scene", *known])
    return near and f"-{near}"


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

    @property
    def solver_keys(self):
        """The keys that go to solvers, {key: text}: not those by which PETSc prints."""
        if not self.solver:
            return {}
        from pgran.run.keys import is_solver_key

        return {key: text for key, text in self.solver.items() if is_solver_key(key)}

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

        texts = {"scene": self.scene}
        for option, value in self._known():
            if option in RUN:
                continue
            texts[option.name] = text_of(value)
            if option.kind in (FILE, FILES):
                paths = value if isinstance(value, tuple) else (value,)
                texts[option.name] += f" ({', '.join(map(contents, paths))})"
        return texts | self.solver_keys

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
    from pgran.medium.dissipation import warn_of_damping
    from pgran.medium.sample import make_lattice, ranks_per_lattice

    medium = make_lattice(options, world)
    if world.rank == 0 and options.network_file and options.network_damping is None:
        warn_of_damping(medium, "-network_damping")
    ranks = world.size if scene.whole else ranks_per_lattice(scene, options, medium, world)
    with crew(ranks, medium) as workers:
        records = scene.run(medium, options, workers)
    if records is None:
        return None
    from pgran.medium.base import record_of

    return [record_of(medium), *records]


def opening(options, ranks, medium=None):
    """Return in words what a run solves, on which medium if on any, and on how many ranks."""
    of = getattr(options, f"{options.scene}_of", None)
    if medium is None:
        facts = SCENES[options.scene].subject(options)
    else:
        from pgran.command.medium import facts_of

        facts = facts_of(options, medium)
    what = f"{options.scene} of {f'{of} of ' if of else ''}"
    return what + ", ".join([*facts, counted(ranks, "rank")])
