"""Options files and command lines: read, checked, resolved.

Options files have PETSc's syntax (`-key value`, `#` starts a comment) but are read and checked
here, before PETSc starts: an unknown key, a wrong type or an impossible value is an error that
names the key. A file can choose solvers and set numbers; it cannot make PETSc load code, start
programs or write files. Who gives such keys on the command line means them.
"""

import math
import os
import re
import shlex
from dataclasses import dataclass

from pgran.errors import FileError, InputError
from pgran.files.options import (
    ACCURACY,
    HARMFUL,
    LATTICES_SHARED,
    PETSC_BEGINNINGS,
    PETSC_KEYS,
    PETSC_PRINTS,
    RUN,
    SCENE,
    SCENES,
    SOLVER_PREFIXES,
    nearest,
)
from pgran.files.paths import open_regular
from pgran.physics.lattice import bond_count

LONGEST_FILE = 2**20  # bytes of an options file
SMALLEST_SHIFT = 1e-14  # of pivots, against bond constants of about 1
NO_TEXT = re.compile(r"[^\t\n\r -~\u00a0-\ud7ff\ue000-\U0010ffff]")  # control characters, no UTF-8
KEY = re.compile(r"--?[A-Za-z][\w.-]*", re.ASCII)
# What other programs' files begin a comment with, and what others write instead of a dash.
COMMENTS, DASHES = ("//", "/*", "%", ";", "!"), ("\u2010", "\u2011", "\u2013", "\u2014", "\u2212")
# What a value in a file may be: names and numbers, one or several. No path, no `viewer:file`.
PLAIN = re.compile(r"[\w.+-]+(,[\w.+-]+)*", re.ASCII)
# MUMPS: units of Fortran that it prints to (files fort.N), and factors on disk.
MUMPS_FILES = re.compile(r".*_mumps_icntl_(1|2|3|22)")


@dataclass(frozen=True)
class Given:
    """One key as the user gave it, and where."""

    key: str
    text: str
    where: str

    @property
    def rank(self):
        """What wins: the command line over the file over the environment. Not collective."""
        return 2 if not self.where else 0 if "PETSC_OPTIONS" in self.where else 1


class Options:
    """The resolved options of a run: every physics option by name, and the solver keys given.

    `options.lattice_shape` is the value of `-lattice_shape`. `solver` holds what goes to PETSc.
    """

    def __init__(self, scene, values, solver):
        """Keep the values."""
        self.scene, self._values, self.solver = scene, values, solver

    def __getattr__(self, name):
        """Return the value of an option of this scene."""
        try:
            return self.__dict__["_values"][name]
        except KeyError:
            raise AttributeError(f"scene {self.scene} has no option -{name}") from None

    def text(self):
        """Return a complete options file that reproduces the run.

        Not collective. Leave to replace a result, and the wish for a forecast, were for one run
        only.
        """
        lines = [SCENE.write(self.scene)]
        for option in SCENES[self.scene]:
            value = self._values[option.name]
            if value is not None and option.name not in ("output_overwrite", "dry_run"):
                lines.append(option.write(value))
        for key, text in self.solver.items():
            lines.append(f"-{key} {shlex.quote(text)}" if text else f"-{key}")
        return "\n".join(lines) + "\n"

    def identity(self):
        """Return what decides the run's numbers, {option: text}; how it is carried out does not."""
        found = {"scene": self.scene}
        for option in SCENES[self.scene]:
            value = self._values[option.name]
            if value is not None and option not in RUN:
                found[option.name] = option.kind.write(value)
        prefixes = tuple(SOLVER_PREFIXES)
        return found | {k: text for k, text in self.solver.items() if k.startswith(prefixes)}


def read_file(path):
    """Return what an options file gives, in order. Not collective.

    Raises
    ------
    FileError, InputError
        If it cannot be read, is no text of a sensible size, or a line is not `-key value`.
    """
    with open_regular(path) as stream:
        content = stream.read(LONGEST_FILE + 1)
    if len(content) > LONGEST_FILE:
        raise FileError(f"{path}: an options file has at most {LONGEST_FILE} bytes")
    text = content.decode("utf-8-sig", errors="surrogateescape")  # editors may put a mark in front
    if strange := NO_TEXT.search(text):
        line = 1 + text.count("\n", 0, strange.start())
        raise FileError(f"{path}: not a text file (line {line})")
    given = []
    for number, line in enumerate(text.splitlines(), 1):
        where = f" ({path}, line {number})"
        try:
            words = shlex.split(line, comments=True)
        except ValueError as error:
            hint = next((hint for word in line.split() if (hint := _hint(word))), error)
            raise InputError(f"{line.strip()}{where}: {hint}") from None
        given += read_words(words, where)
    return given


def read_words(words, where=""):
    """Return what a command line gives: `-key value`, or `-key` alone. Not collective."""
    given = []
    for word in words:
        check_word(word, where)
        if KEY.fullmatch(word):
            given.append(Given(word.lstrip("-"), "", where))
        elif re.match("--?[A-Za-z]", word):
            key, sign, value = word.partition("=")
            hint = f"write {key} {value}" if sign else "no key has such a name"
            raise InputError(f"{word}{where}: {hint}")
        elif given and not given[-1].text:
            given[-1] = Given(given[-1].key, word, where)
        else:
            hint = _hint(word, given) or "a value without a key (keys look like -key)"
            raise InputError(f"{word}{where}: {hint}")
    return given


def check_word(word, where=""):
    """Raise where a word could not be read again from an options file. Not collective."""
    if NO_TEXT.search(word) or "".join(word.splitlines()) != word:
        raise InputError(
            f"{word}{where}: holds a line break, a control character, or a byte that is no UTF-8"
        )


def _hint(word, given=()):
    """Return what a word may have been meant to be that is no value, or None."""
    if word.startswith(COMMENTS):
        return "a comment begins with #"
    if word.startswith(DASHES):
        return "begins with a long dash; keys begin with -, as in -key"
    if word.lower() in {"scene"}.union(*({o.name for o in its} for its in SCENES.values())):
        return f"a value without a key; did you mean -{word.lower()}?"
    if given:
        last = given[-1]
        both = f"{last.text.strip(',')},{word.strip(',')}"
        return f"a value without a key; a list has no blanks: -{last.key} {both}"
    return None


def read_solver(path, own):
    """Return what the options file of a solver sets.

    Not collective.

    Parameters
    ----------
    path : str
    own : dict of Option
        By name: what it may set besides keys of PETSc's solvers.

    Returns
    -------
    values : dict
        Of options in `own`.
    keys : dict of str
        For PETSc's option database.

    Raises
    ------
    FileError, InputError
        If it cannot be read, or holds anything else.
    """
    values, keys = {}, {}
    for item in read_file(path):
        key = item.key.lower()
        if key in own:
            values[key] = own[key].read(item.text, item.where)
        elif _is_solver_key(key):
            _check_harmless(key, item)
            keys[key] = item.text
        else:
            allowed = [f"-{name}" for name in (*own, *(f"{p}*" for p in SOLVER_PREFIXES))]
            raise InputError(
                f"-{key}{item.where}: the file of a solver holds {', '.join(allowed)} only"
            )
    _check_ends(keys)
    return values, keys


def read_environment():
    """Return what PETSC_OPTIONS gives, and keep PETSc from reading it unchecked. Not collective."""
    if os.environ.pop("PETSC_OPTIONS_YAML", ""):
        raise InputError("PETSC_OPTIONS_YAML: not read; an options file or PETSC_OPTIONS is")
    return read_words(os.environ.pop("PETSC_OPTIONS", "").split(), " (PETSC_OPTIONS)")


def resolve(given, output_file=None):
    """Return the Options that keys mean, later ones winning.

    Not collective.

    Parameters
    ----------
    given : sequence of Given
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
    scene = SCENE.read(last["scene"].text, last["scene"].where)
    options = {option.name: option for option in SCENES[scene]}
    values = {option.name: option.default for option in SCENES[scene]}
    values["output_file"] = output_file
    solver = {}
    for key, item in last.items():
        if key in options:
            values[key] = options[key].read(item.text, item.where)
        elif key != "scene":
            _check_foreign(key, item, scene, options)
            solver[key] = item.text
    _check_ends(solver)
    experiment = scene
    if scene == "accuracy":
        experiment = values["accuracy_of"]
        _check_accuracy(experiment, values, last)
    _check_together(experiment, values, last)
    if experiment in ("modes", "projection"):
        _check_modes(experiment, values, last)
    return Options(scene, values, solver)


def _check_foreign(key, item, scene, options):
    """Raise unless a key that is no option of the scene belongs to PETSc."""
    users = [name for name, its in SCENES.items() if any(o.name == key for o in its)]
    if users:
        raise InputError(
            f"-{key}{item.where}: scene {scene} does not use it, but {', '.join(users)} does"
        )
    if _is_solver_key(key) or key in PETSC_KEYS or key.startswith(PETSC_BEGINNINGS):
        _check_harmless(key, item)
        return
    near = nearest(key, ["scene", *options])
    prefixed = next((p + key for p in SOLVER_PREFIXES if key.startswith(("ksp_", "pc_"))), near)
    raise InputError(
        f"-{key}{item.where}: unknown option"
        + (f"; did you mean -{prefixed}?" if prefixed else "")
        + f" (pgran options {scene} lists all)"
    )


def _check_accuracy(experiment, values, last):
    """Raise unless the options of a study are those of its experiment; unset all others."""
    if values["accuracy_solvers"] is None:
        raise InputError("-accuracy_solvers is missing: options files of the solvers to compare")
    used = {option.name for option in (*SCENES[experiment], *ACCURACY)}
    for name in [name for name in values if name not in used]:
        if name in last:
            where = last[name].where
            raise InputError(f"-{name}{where}: -accuracy_of {experiment} does not use it")
        values[name] = None


def _is_solver_key(key):
    """Return whether a key goes to a solver."""
    return key.startswith(tuple(SOLVER_PREFIXES)) and key not in SOLVER_PREFIXES


def _check_harmless(key, item):
    """Raise where a key of PETSc's could do more than it should, unless the command line has it."""
    quiet = key in PETSC_PRINTS and not item.text
    if item.where and not (_harmless(key, item.text) if _is_solver_key(key) else quiet):
        raise InputError(
            f"-{key} {item.text}".rstrip() + f"{item.where}: could load code, start a program "
            "or write a file; give it on the command line if you mean it"
        )


def _check_ends(keys):
    """Raise where PETSc would shift the pivots of a singular matrix by nothing, and never end."""
    for key, text in keys.items():
        if not (key.startswith("steady_") and key.endswith("pc_factor_zeropivot")):
            continue
        pc = key.removesuffix("factor_zeropivot")
        # what a preconditioner inside another one shifts by default depends on both
        plain = pc == "steady_pc_" and keys.get("steady_pc_type", "lu") in ("lu", "cholesky", "ilu")
        shift = keys.get(f"{pc}factor_shift_type", "none" if plain else "unknown").lower()
        try:
            small = float(text) < SMALLEST_SHIFT
        except ValueError:
            continue  # PETSc says so itself
        if small and shift not in ("none", "nonzero"):
            raise InputError(
                f"-{key} {text}: PETSc may shift the pivots of a singular matrix by as little, and "
                f"never end; leave it out, give {SMALLEST_SHIFT:g} or more, or say "
                f"-{pc}factor_shift_type none"
            )


def _harmless(key, text):
    """Return whether a solver key cannot make PETSc load code, start programs or write files."""
    return (
        not set(key.split("_")) & set(HARMFUL)
        and not any(word.endswith(HARMFUL) for word in text.lower().split(","))
        and (not text or PLAIN.fullmatch(text) is not None)
        and (text in ("0", "6") or not MUMPS_FILES.fullmatch(key))
    )


def machine_memory():
    """Return the bytes of memory that this machine has. Not collective."""
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def _check_size(scene, values):
    """Raise where the arrays that rank 0 must hold, and one copy, exceed this machine's memory."""
    values = {name: value for name, value in values.items() if value is not None}
    shape = values.get("lattice_shape") or (1,)  # None: a file says
    balls, axes = math.prod(shape), len(shape)
    detectors = len(values.get("detectors") or ()) // axes
    points = values.get("sweep_points") or len(values.get("sweep_omega") or ())
    modes = values.get("modes_count") or (balls if values.get("modes_omega_min") is None else 0)
    field = 8 * balls * values.get("output_fields", False)
    results = {
        "response": ("sweep_points", points * (32 + 40 * detectors + 2 * field)),
        "continuum": ("sweep_points", points * 40),
        "modes": ("output_fields", min(modes, balls) * (24 + field)),
        "projection": ("sweep_points", points * (40 + 16 * min(modes, balls))),
        "relaxation": (
            "relax_steps",
            values.get("relax_trajectories", 0)
            * (100 + values.get("relax_steps", 0) * (16 + 8 * axes + 16 * detectors)),
        ),
    }
    there = machine_memory()
    for key, size in [("lattice_shape", 8 * bond_count(shape)), results.get(scene, ("", 0))]:
        if 2 * size > there:
            raise InputError(
                f"-{key}: too much: the arrays of this run alone take {2 * size / 1e9:.3g} GB, and "
                f"this machine has {there / 1e9:.3g} GB"
            )


def _check_together(scene, values, last):
    """Raise where options that are possible one by one contradict each other, or ask too much."""
    if len(values.get("lattice_shape", (1,))) > 3:
        raise InputError("-lattice_shape: a lattice has 1 to 3 axes")
    if scene not in LATTICES_SHARED and values["ranks_per_lattice"] > 1:
        raise InputError(f"-ranks_per_lattice: scene {scene} has one rank for each lattice only")
    from_file = values.get("bonds_law") == "file"
    if from_file != (values.get("bonds_file") is not None):
        raise InputError("-bonds_file and -bonds_law file belong together: give both or neither")
    if from_file and scene == "relaxation":
        raise InputError(
            "-bonds_law file: a relaxation draws new constants and needs a law for them"
        )
    if from_file:
        _alternatives(("bonds_file",), ("lattice_shape", "bonds_kmin", "bonds_kmax"), values, last)
    _alternatives(("sweep_omega",), ("sweep_min", "sweep_max", "sweep_points"), values, last)
    omega = values.get("sweep_omega")
    if omega and list(omega) != sorted(set(omega)):
        raise InputError("-sweep_omega: the frequencies must increase")
    for name in ("sweep", "phase_fit", "spectrum_fit"):
        low, high = f"{name}_min", f"{name}_max"
        if values.get(low) is not None and values[low] >= values[high]:
            raise InputError(f"-{low}: {values[low]:g} is not below -{high}, {values[high]:g}")
    _check_size(scene, values)


def _alternatives(some, others, values, last):
    """Let one of two ways to say the same stand: what was given, and of both the winning source.

    `some` stand only where given; without any, `others` have their defaults.
    """
    given = [max((last[k].rank for k in keys if k in last), default=-1) for keys in (some, others)]
    if given[0] >= 0 and given[0] == given[1]:
        one, other = (next(last[k] for k in keys if k in last) for keys in (some, others))
        raise InputError(
            f"-{other.key}{other.where}: contradicts -{one.key}{one.where}; give one of them"
        )
    if max(given) >= 0 or values.get(some[0]) is not None:
        for key in others if given[0] > given[1] else some:
            if key in values:
                values[key] = None


def _check_modes(scene, values, last):
    """Raise where the options that choose modes contradict each other."""
    _alternatives(
        ("modes_omega_min", "modes_omega_max"), ("modes_target", "modes_count"), values, last
    )
    low, high, target, count = (
        values[f"modes_{name}"] for name in ("omega_min", "omega_max", "target", "count")
    )
    if (low is None) != (high is None):
        raise InputError("-modes_omega_min and -modes_omega_max belong together: give both")
    if low is not None and low >= high:
        raise InputError(f"-modes_omega_min: {low:g} is not below -modes_omega_max, {high:g}")
    if target is not None and count is None:
        raise InputError("-modes_target: -modes_count must say how many modes")
    if scene == "modes" and count is not None and target is None:
        raise InputError("-modes_count: -modes_target must say where")
