"""Which experiment a run is, and its options: all scenes, and what keys mean to one of them."""

from collections.abc import Mapping

from pgran import catalogue
from pgran.errors import InputError
from pgran.run import keys as solver_keys
from pgran.run.options import RUN, TEXT, Option, Options, nearest


class Scenes(Mapping):
    """The facts of each experiment by name; none is loaded before it is asked for."""

    def __getitem__(self, name):
        """Load one."""
        return catalogue.scene(name)

    def __iter__(self):
        """Name all."""
        return iter(catalogue.EXPERIMENTS)

    def __len__(self):
        """Count them."""
        return len(catalogue.EXPERIMENTS)


SCENES = Scenes()
SCENE_OPTION = Option("scene", TEXT, None, "the experiment", choices=tuple(SCENES))


def options_of(scene):
    """Return all options of a scene by name, those of every run last. Not collective."""
    return {option.name: option for option in (*SCENES[scene].options, *RUN)}


def resolve(given, output_file=None):
    """Return the Options that keys mean, later ones winning.

    Not collective.

    Parameters
    ----------
    given : sequence of pgran.run.reading.Given
    output_file : str, optional
        Where the result goes unless the options say.

    Raises
    ------
    InputError
        For an unknown key, one that the scene does not use, a wrong type or an impossible value.
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
    if not SCENES[scene].shares_lattice and values["ranks_per_lattice"] > 1:
        raise InputError(f"-ranks_per_lattice: scene {scene} has one rank for each lattice only")
    SCENES[scene].check(values, last)
    return Options(scene, options.values(), values, solver)


def _check_foreign(key, item, scene):
    """Raise unless a key that is no option of the scene belongs to PETSc."""
    users = [name for name in SCENES if key in options_of(name)]
    if users:
        raise InputError(
            f"-{key}{item.where}: scene {scene} does not use it, but "
            f"{' and '.join(filter(None, [', '.join(users[:-1]), users[-1]]))} "
            f"{'do' if len(users) > 1 else 'does'}"
        )
    if solver_keys.is_solver_key(key) or solver_keys.is_petsc_key(key):
        solver_keys.check_in_file(key, item)
        return
    near = nearest(key, ["scene", *options_of(scene)])
    if key in ("n", "np"):
        raise InputError(f"-{key}{item.where}: ranks are started by mpirun -n N pgran run ...")
    if key == "o":
        near = "output_file"
    if key.startswith(("ksp_", "pc_")):
        near = f"steady_{key}"
    elif key.startswith(("eps_", "st_")):
        near = f"normal_{key}"
    hint = f"; did you mean -{near}?" if near else ""
    raise InputError(f"-{key}{item.where}: unknown option{hint} (pgran options {scene} lists all)")
