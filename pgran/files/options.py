"""Every physics and run option, declared once: type, unit, range, default, meaning."""

import difflib
import math
import shlex
from collections.abc import Callable
from dataclasses import dataclass

from pgran.errors import InputError

SOLVER_PREFIXES = {
    "steady_": "every driven steady state (KSP, PC)",
    "normal_": "normal modes (EPS, ST; count_pc for the factorizations that count them)",
}
# PETSc's own run-time keys, as they are and with these beginnings.
PETSC_KEYS = {
    "citations", "get_total_flops", "history", "info", "log", "log_all", "nox", "objects_dump",
    "on_error_abort", "on_error_attach_debugger", "options_left", "skip_petscrc",
    "start_in_debugger", "stop_for_debugger", "fp_trap",
}  # fmt: skip
PETSC_BEGINNINGS = ("log_", "malloc", "memory_", "options_left", "options_view", "info_", "viewer_")
# Those that only print, as long as they stand alone: a value names a file.
PETSC_PRINTS = {
    "citations", "get_total_flops", "info", "log_view", "log_view_memory", "malloc_view",
    "memory_view", "options_left", "options_view",
}  # fmt: skip
# Words that make PETSc run code, call a program, or write a file or a socket: as a part of a solver
# key, or as the end of its value (PETSc looks at the ends of viewers' names).
HARMFUL = (
    "python", "shell", "exec", "binary", "draw", "socket", "matlab", "saws", "vtk", "hdf5", "glvis",
    "exodusii", "pyvista", "file", "filename", "dir", "tmpdir", "load", "save", "dump", "write",
    "print",
)  # fmt: skip


@dataclass(frozen=True)
class Kind:
    """A type of option: how its text is read and written."""

    name: str
    read: Callable
    write: Callable = str


def _flag(text):
    """Read a flag; a key without a value is true."""
    words = {"": True, "true": True, "yes": True, "1": True, "on": True}
    words |= {"false": False, "no": False, "0": False, "off": False}
    return words[text.lower()]


def _text(text):
    if not text:
        raise ValueError
    return text


def _integer(text):
    value = int(text)
    if abs(value) >= 2**64:
        raise ValueError
    return value


def _real(text):
    value = float(text)
    if not math.isfinite(value):
        raise ValueError
    return value


def _several(read):
    return lambda text: tuple(read(part) for part in text.split(","))


def _joined(values):
    return ",".join(map(repr, values))


INTEGER = Kind("integer", _integer)
REAL = Kind("real", _real, repr)
INTEGERS = Kind("integers", _several(_integer), _joined)
REALS = Kind("reals", _several(_real), _joined)
FLAG = Kind("flag", _flag, lambda value: str(value).lower())
TEXT = Kind("text", _text, shlex.quote)
TEXTS = Kind("texts", _several(_text), lambda values: shlex.quote(",".join(values)))


@dataclass(frozen=True)
class Option:
    """One option: `-name`, and what its value may be.

    `low` and `high` bound every number of a value, `above` from below excluding itself. A default
    of None means that the option need not be given and that nothing stands in for it.
    """

    name: str
    kind: Kind
    default: object
    meaning: str
    unit: str = ""
    low: float | None = None
    above: float | None = None
    high: float | None = None
    choices: tuple = ()

    def read(self, text, where=""):
        """Return the value that `text` means.

        Raises
        ------
        InputError
            If it is of the wrong type or out of range.
        """
        try:
            value = self.kind.read(text.strip())
        except (ValueError, KeyError):
            raise InputError(
                f"-{self.name} {text}{where}: needs a value of the type `{self.kind.name}`"
            ) from None
        numbers = value if isinstance(value, tuple) else (value,)
        if self.choices and value not in self.choices:
            near = nearest(value, self.choices)
            raise InputError(
                f"-{self.name} {text}{where}: choose {', '.join(self.choices)}"
                + (f"; did you mean {near}?" if near else "")
            )
        for number in numbers:
            if (
                (self.low is not None and number < self.low)
                or (self.above is not None and number <= self.above)
                or (self.high is not None and number > self.high)
            ):
                raise InputError(f"-{self.name} {text}{where}: {number} is not {self.range()}")
        return value

    def range(self):
        """Return the range in words."""
        words = []
        if self.above is not None:
            words.append(f"> {self.above:g}")
        if self.low is not None:
            words.append(f">= {self.low:g}")
        if self.high is not None:
            words.append(f"<= {self.high:g}")
        return " and ".join(words)

    def write(self, value):
        """Return the line of an options file that sets this value."""
        return f"-{self.name} {self.kind.write(value)}".rstrip()


LAWS = ("uniform", "constant", "loguniform", "bimodal", "hertz", "file")

LATTICE = (
    Option("lattice_shape", INTEGERS, (20, 20), "balls along each axis, 1 to 3 numbers", low=1),
    Option("lattice_mass", REAL, 1.0, "mass m of a ball", above=0),
    Option("lattice_damping", REAL, 0.003, "damping beta of every bond", "mass x frequency", low=0),
    Option(
        "bonds_law", TEXT, "uniform",
        "uniform on [kmin, kmax]; constant kmax; loguniform on [kmin, kmax]; bimodal, kmin or "
        "kmax; hertz, 3/2 c^(2/3) F^(1/3) with exponential forces F; file",
        choices=LAWS,
    ),
    Option("bonds_kmin", REAL, 0.0, "smallest bond constant", "mass x frequency^2", low=0),
    Option("bonds_kmax", REAL, 0.25, "largest bond constant", "mass x frequency^2", above=0),
    Option("bonds_fraction", REAL, 0.5, "bimodal: part of the bonds that is kmax", low=0, high=1),
    Option("bonds_force", REAL, 1.0, "hertz: mean contact force", "force", above=0),
    Option("bonds_hertz", REAL, 1.0, "hertz: c in F = c h^(3/2)", "force / length^(3/2)", above=0),
    Option("bonds_seed", INTEGER, 1993, "which sample", low=0, high=2**63 - 1),
    Option("bonds_file", TEXT, None, "law file: HDF5 file with /lattice/stiffness_x ..."),
    Option(
        "detectors", INTEGERS, (8, 10), "ball indices from 0, flat: 8,10 or 8,10,3,4",
        low=0, high=2**63 - 1
    ),
)  # fmt: skip
SWEEP = (
    Option("sweep_min", REAL, 0.01, "lowest driving frequency", "angular", above=0),
    Option("sweep_max", REAL, 1.3, "highest driving frequency", "angular", above=0),
    Option("sweep_points", INTEGER, 1291, "frequencies of the linear grid", low=1),
    Option(
        "sweep_omega", REALS, None, "driving frequencies, instead of a grid", "angular", above=0
    ),
)
STEADY = (
    Option(
        "error_tolerance", REAL, 1e-4, "relative accuracy asked of each amplitude",
        above=0, high=0.5
    ),
    Option(
        "steady_refresh_iterations", INTEGER, 0,
        "factor anew after a frequency that took more Krylov iterations; 0 = when it pays", low=0
    ),
)  # fmt: skip
FLOOR = (
    Option(
        "error_floor", REAL, 1e-20,
        "an amplitude whose error bound is below this part of the wall's amplitude is good without "
        "relative accuracy",
        low=0
    ),
)  # fmt: skip
PHASE = (
    Option("phase_fit_min", REAL, 0.3, "window of the phase fit", "omega_mx", low=0),
    Option("phase_fit_max", REAL, 1.0, "window of the phase fit", "omega_mx", above=0),
)
RUN = (
    Option(
        "ranks_per_lattice", INTEGER, 0,
        "ranks that share one lattice, the rest share out the work; 0 = automatic", low=0
    ),
    Option(
        "output_file", TEXT, None, "result (default: results/<name of the options file>.h5)"
    ),
    Option("output_overwrite", FLAG, False, "replace an existing result"),
    Option(
        "output_progress", TEXT, "auto", "auto = a bar on a terminal, lines elsewhere",
        choices=("auto", "bar", "lines", "none"),
    ),
    Option("output_log", TEXT, None, "log file; a log that is there already goes on"),
    Option("dry_run", FLAG, False, "say what the run will need, and stop"),
)  # fmt: skip
CONTINUUM = (
    Option("continuum_point", REALS, (0.47, 0.52), "where the amplitude is taken", "length"),
    Option("continuum_size", REALS, (1.0, 1.0), "extent of the box along x, y", "length", above=0),
    Option("continuum_mass", REAL, 1.0, "mass per area", above=0),
    Option("continuum_stiffness", REAL, 1.0, "K0", above=0),
    Option("continuum_damping", REAL, 0.003, "beta", low=0),
)
RELAXATION = (
    Option("relax_steps", INTEGER, 20000, "steps, one bond each", low=1),
    Option("relax_omega", REAL, 0.6, "driving frequency", "angular", above=0),
    Option("relax_seed", INTEGER, 1, "which sequence of changes", low=0, high=2**63 - 1),
    Option(
        "relax_method", TEXT, "window",
        "window: many known changes on one factorization; krylov: iterate from the last step; "
        "direct: factor at each step",
        choices=("window", "krylov", "direct"),
    ),
    Option("relax_window", INTEGER, 0, "steps to a window; 0 = by cost", low=0, high=4096),
    Option(
        "relax_trajectories", INTEGER, 1, "independent trajectories, all from the same bonds", low=1
    ),
)  # fmt: skip
SPECTRUM = (
    Option("spectrum_fit_min", REAL, 0.01, "window of the exponent's fit", "cycles/step", above=0),
    Option("spectrum_fit_max", REAL, 0.3, "window of the exponent's fit", "cycles/step", above=0),
)
MODES = (
    Option("modes_omega_min", REAL, None, "interval of modes: its lower end", "angular", low=0),
    Option("modes_omega_max", REAL, None, "interval of modes: its upper end", "angular", above=0),
    Option("modes_target", REAL, None, "the modes nearest to this frequency", "angular", low=0),
    Option(
        "modes_count", INTEGER, None,
        "how many nearest modes; a projection without target: nearest to each driving frequency",
        low=1
    ),
)  # fmt: skip
ACCURACY = (
    Option(
        "accuracy_of", TEXT, "response", "the experiment that is repeated",
        choices=("response", "modes", "relaxation"),
    ),
    Option(
        "accuracy_solvers", TEXTS, None,
        "options files of the solvers to compare: a.opts,b.opts; each holds solver keys alone"
    ),
    Option(
        "accuracy_tolerances", REALS, (1e-2, 1e-4, 1e-6, 1e-8),
        "accuracies to ask each solver for; of modes, its -normal_eps_tol", above=0, high=0.5
    ),
    Option("accuracy_repeats", INTEGER, 5, "repeats of each timing", low=1),
)  # fmt: skip
# Modes are seen by no detector.
MODES_LATTICE = tuple(option for option in LATTICE if option.name != "detectors")
SHAPES = Option("output_fields", FLAG, False, "store the shapes of the modes")
FIELDS = Option("output_fields", FLAG, False, "store the whole field at every frequency")
REUSE = tuple(option for option in STEADY if option.name != "error_tolerance")

SCENES = {
    "response": (*LATTICE, *SWEEP, *STEADY, *FLOOR, *PHASE, *RUN, FIELDS),
    "continuum": (*CONTINUUM, *SWEEP, *RUN),
    "modes": (*MODES_LATTICE, *MODES, *RUN, SHAPES),
    "relaxation": (*LATTICE, *RELAXATION, *SPECTRUM, *STEADY, *FLOOR, *RUN),
    "projection": (*MODES_LATTICE, *SWEEP, *STEADY, *MODES, *RUN),
    # Of these, only what the scene that it repeats has.
    "accuracy": (*ACCURACY, *LATTICE, *SWEEP, *REUSE, *RELAXATION, *MODES, *RUN),
}
WITHOUT_PETSC = ("continuum",)
LATTICES_SHARED = ("response", "relaxation")  # where several ranks may share a lattice
SCENE = Option("scene", TEXT, None, "the experiment", choices=tuple(SCENES))


def describe_options(scene=None):
    """Return a table of the options of one scene, or of all. Not collective."""
    rows = []
    scenes = [scene] if scene else SCENES
    for option in dict.fromkeys([SCENE, *(option for name in scenes for option in SCENES[name])]):
        default = "" if option.default is None else option.kind.write(option.default)
        facts = [
            option.kind.name,
            option.unit,
            option.range(),
            f"default {default}" if default else "",
        ]
        rows.append(
            f"-{option.name}\n    {option.meaning}\n    ({'; '.join(filter(None, facts))})\n"
        )
        if option.choices:
            rows.append(f"    choices: {', '.join(option.choices)}\n")
    rows += [
        f"-{prefix}*\n    PETSc options of {what}\n" for prefix, what in SOLVER_PREFIXES.items()
    ]
    return "".join(rows)


def nearest(word, words):
    """Return the word most like `word`, or None. Not collective."""
    return next(iter(difflib.get_close_matches(word, words, n=1, cutoff=0.5)), None)
