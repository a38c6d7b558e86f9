"""What an experiment is asked, declared once: the default of a keyword is its option.

    @in_parallel("pulse", lattice=medium, detectors=DETECTORS)
    def pulse(lattice, detectors, *, omega=option(0.6, "centre", "angular", above=0)) -> Signals:

declares the keyword `omega` and the option `-pulse_omega`: type, default, unit, range and meaning.
The body sees plain values, checked as the command line checks them; `help` shows all of it.
"""

import dataclasses
import inspect
import re
import textwrap
from collections.abc import Callable

from pgran.errors import InputError
from pgran.run.numbers import numbers
from pgran.run.options import KINDS, RUN, Option, check_ends, text_of

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
# Sections of a docstring, and what those of all functions that are collective have in common.
SECTION = re.compile(r"\n\n(Parameters|Returns|Raises|Examples)\n-+\n")
COLLECTIVE = "Collective: all ranks call it, and share out the work."
RETURNS = """pgran.results.{} or None
    With a crew of the caller's None on all ranks but rank 0."""
RAISES = """InputError
    If a value is impossible, such as a detector outside of the lattice."""
INDENTED = {"initial_indent": 4 * " ", "subsequent_indent": 4 * " "}


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

    def of_run(self, options, *others):
        """Return the window that the options of a run say."""
        low, high = (end.of_run(options) for end in self.options)
        return None if low is None else (low, high)


@dataclasses.dataclass(frozen=True)
class Asked:
    """What options ask in other words than Python: frequencies by a grid, numbers by a file's name.

    `of_run(options, world, medium)` makes it of the options of a run, and is collective; `check`
    makes it of what is handed in.
    """

    options: tuple
    of_run: Callable
    check: Callable = lambda value: value
    default = None


def declarations(function, prefix, arguments):
    """Return what `arguments`, and the defaults of a function, declare, by their names."""
    declared = {name: asked for name, asked in arguments.items() if hasattr(asked, "check")}
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


def asked_of(function, options, world, *medium, without=()):
    """Return what a run's options say, if anything, of what a function declares. Collective."""
    asked = {}
    for name, declared in function.declared.items():
        if name not in without and hasattr(declared, "of_run"):
            value = declared.of_run(options, world, *medium)
            if value is not None or declared.default is None:
                asked[name] = value
    return asked


def call(function, options, crew, *arguments, **keywords):
    """Call a function with what a run's options say of what it declares, if anything.

    Collective. Of the other arguments the medium, if there is one, comes first.
    """
    asked = asked_of(function, options, crew.world, *arguments[:1], without=keywords)
    return function(*arguments, crew=crew, **asked | keywords)


def run_of(function):
    """Return the `run` of a scene that is one call of a function."""

    def run(medium, options, crew):
        record = call(function, options, crew, *([] if medium is None else [medium]))
        return record and [record]

    return run


def described(function, declared):
    """Return the docstring of a collective function, with what it has in common with others.

    That are parameters that it does not describe itself, what it returns by its annotation, what it
    raises, and that it is collective.
    """
    head, *parts = SECTION.split(inspect.cleandoc(function.__doc__))
    own = dict(zip(parts[::2], parts[1::2], strict=True))
    lines, signature = own.pop("Parameters", "").splitlines(), inspect.signature(function)
    told = {line.partition(" :")[0] for line in lines}
    for name in signature.parameters:
        if name in (SHARED.keys() | declared.keys()) - told:
            kind, meaning = SHARED.get(name) or _described(declared[name])
            lines += [f"{name} : {kind}", *textwrap.wrap(meaning, 92, **INDENTED)]
    record = getattr(signature.return_annotation, "__name__", None)
    sections = {"Parameters": "\n".join(lines), "Returns": RETURNS.format(record), "Raises": RAISES}
    texts = [head.strip()] if "Collective" in head else [head.strip(), COLLECTIVE]
    for name, text in (sections | own).items():
        texts.append(f"{name}\n{'-' * len(name)}\n{text.strip()}")
    return "\n\n".join(texts)


def _described(declared):
    """Return the type, range, unit and default of a keyword in words, and what it means."""
    first = declared.options[0]
    default = "none" if declared.default is None else text_of(declared.default)
    kind = first.kind.name if isinstance(declared, Option) else "array_like of real"
    facts = [f"{kind} {first.range()}".strip(), first.unit, f"default {default}"]
    return ", ".join(filter(None, facts)), f"{first.meaning}."
