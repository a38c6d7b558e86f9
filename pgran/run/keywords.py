"""What an experiment is asked, declared once: the default of a keyword is its option.

    @in_parallel("pulse", lattice=medium)
    def pulse(lattice, detectors, *, omega=option(0.6, "its centre", "angular", above=0)):

declares the keyword `omega` and the option `-pulse_omega`: type, default, unit, range and meaning.
The body sees plain values, checked as the command line checks them; `help` shows all of it.
"""

import dataclasses
import inspect
import textwrap
from collections.abc import Callable

from pgran.errors import InputError
from pgran.run.agreement import on_root
from pgran.run.numbers import numbers
from pgran.run.options import FILE, KINDS, RUN, Option, check_ends, text_of

# In Python no bar is wanted unless somebody asks for it.
PROGRESS = next(option for option in RUN if option.name == "output_progress")
PROGRESS = dataclasses.replace(PROGRESS, default="none")
# What functions take besides keywords that are options, unless their docstrings say it themselves.
SOLVER = """Keys of PETSc's and SLEPc's solvers, {"steady_ksp_type": "gmres"}."""
SHARED = {
    "lattice": ("pgran.Lattice or pgran.Network", ""),
    "omegas": ("array_like of float, shape (nw,)", "Driving frequencies, angular, increasing."),
    "detectors": ("array_like of int", "Ball indices, flat or one row a detector."),
    "crew": ("pgran.run.crew.Crew, optional", "All ranks unless given."),
    "solver": ("dict, optional", SOLVER),
}


def option(default, meaning, unit="", *, key="", kind=None, **limits):
    """Declare a keyword and its option; its type is that of the default, or the `kind`.

    Its name is that of the experiment and the keyword, or the `key`; for limits see `Option`.
    """
    if kind is None:
        several = isinstance(default, tuple)
        kind = KINDS[(type(default[0]),) if several else type(default)]
    return Option(key, kind, default, meaning, unit, **limits)


@dataclasses.dataclass(frozen=True)
class Window:
    """A keyword of two ends, an option each, `-NAME_min` and `-NAME_max`."""

    low: Option
    high: Option

    @property
    def options(self):
        """Both ends."""
        return self.low, self.high

    @property
    def default(self):
        """Both defaults, None where there are none."""
        return None if self.low.default is None else (self.low.default, self.high.default)

    def check(self, value):
        """Return a window that was handed in, two numbers; raise an InputError if it is none."""
        names = [end.name for end in self.options]
        keys = ", ".join(f"-{name}" for name in names)
        ends = numbers(keys, value)
        if ends.shape != (2,):
            raise InputError(f"{keys}: a window has two ends, not {ends.size}")
        low, high = (end.check(x) for end, x in zip(self.options, ends.tolist(), strict=True))
        check_ends(names[0].removesuffix("_min"), dict(zip(names, (low, high), strict=True)))
        return low, high

    def of_run(self, options, world):
        """Return the window that the options of a run say."""
        low, high = (end.of_run(options, world) for end in self.options)
        return None if low is None else (low, high)


@dataclasses.dataclass(frozen=True)
class Columns:
    """A keyword of numbers, which an option reads from a file."""

    options: tuple  # the one that names the file
    read: Callable
    default = None

    def check(self, value):
        """Return numbers that were handed in as an array."""
        return numbers(f"-{self.options[0].name}", value)

    def of_run(self, options, world):
        """Return the numbers in the file that the options of a run name. Collective."""
        path = self.options[0].of_run(options, world)
        return path and on_root(world, lambda: self.read(path))


def columns(key, meaning, read):
    """Declare a keyword of numbers; its option `key` names a file, of which `read` gets them."""
    return Columns((option(None, meaning, key=key, kind=FILE),), read)


def declarations(function, prefix):
    """Return what the defaults of a function declare, by its keywords."""
    declared = {}
    for name, parameter in inspect.signature(function).parameters.items():
        default = parameter.default
        if isinstance(default, Option) and not default.name:
            default = dataclasses.replace(default, name=f"{prefix}_{name}")
        if hasattr(default, "check"):
            declared[name] = default
    return declared


def options_of(*functions, without=()):
    """Return the options that functions declare, but those of every run and some others."""
    others = {option.name for option in (*RUN, *without)}
    declared = [d for function in functions for d in function.declared.values()]
    found = [o for d in declared for o in getattr(d, "options", ()) if o.name not in others]
    return tuple({option.name: option for option in found}.values())


def call(function, options, crew, *arguments, **keywords):
    """Call a function with what a run's options say of its keywords, if anything. Collective."""
    for name, declared in function.declared.items():
        if name not in keywords and hasattr(declared, "of_run"):
            value = declared.of_run(options, crew.world)
            if value is not None:
                keywords[name] = value
    return function(*arguments, crew=crew, **keywords)


def described(docstring, signature, declared):
    """Return a docstring with the parameters that it does not describe itself."""
    head, mark, rest = docstring.partition("\n    Returns\n")
    lines = [] if "    Parameters\n" in head else ["", "    Parameters", "    ----------"]
    for name in signature.parameters:
        if f"\n    {name} :" in head or name not in SHARED.keys() | declared.keys():
            continue
        kind, meaning = SHARED.get(name) or _described(declared[name])
        lines.append(f"    {name} : {kind}")
        lines += textwrap.wrap(meaning, 92, initial_indent=" " * 8, subsequent_indent=" " * 8)
    return "\n".join([head.rstrip(), *lines, ""]) + mark + rest


def _described(declared):
    """Return the type, range, unit and default of a keyword in words, and what it means."""
    first = declared.options[0]
    default = "none" if declared.default is None else text_of(declared.default)
    kind = first.kind.name if isinstance(declared, Option) else "array_like of real"
    facts = [f"{kind} {first.range()}".strip(), first.unit, f"default {default}"]
    return ", ".join(filter(None, facts)), f"{first.meaning}."
