"""What an experiment is: the facts of a scene, and a function whose keywords are its options.

    @in_parallel("pulse", lattice=medium, detectors=DETECTORS)
    def pulse(lattice, detectors, *, omega=option(0.6, "centre", "angular", above=0)) -> Signals:

declares the keyword `omega` and the option `-pulse_omega`: type, default, unit, range and meaning.
The body sees plain values, checked as the command line checks them; `help` shows all of it.
"""

import dataclasses
import functools
import inspect
import re
import textwrap
from collections.abc import Callable
from dataclasses import dataclass

import pgran
from pgran.arguments import bound, saying_once
from pgran.errors import InputError
from pgran.run import launch, machine
from pgran.run.agreement import agreeing, ending_all
from pgran.run.numbers import fingerprint, numbers
from pgran.run.options import KINDS, RUN, Option, check_ends, text_of
from pgran.store.record import Result, Shown


class Caution(str):
    """A line of a summary that says what is wrong with a result: told first, as a warning."""


@dataclass(frozen=True)
class Scene:
    """The facts of an experiment. Its module has the task, and this under the name SCENE.

    `run(medium, options, crew)` returns a list of records on rank 0, None on the others, and is
    collective. `summary` takes the `pgran.store.record.Result` and returns in words, line by line,
    what a run found. `check` takes the values of the options and what was given: it raises an
    InputError where values that are possible one by one contradict each other, and unsets what an
    alternative replaces.
    """

    options: tuple  # besides those of the medium and of every run
    run: Callable
    summary: Callable
    check: Callable = lambda values, given: None
    on_medium: bool = True  # whether it is on a lattice or another network, which takes PETSc
    draws: bool = False  # whether it draws bond constants itself, by the law
    shares_lattice: bool = False  # whether several ranks may share a lattice
    whole: bool = False  # whether all ranks work on each unit together
    subject: Callable = lambda options: ()  # in words what a scene on no medium is about
    function: Callable | None = None  # what scenes that repeat it call
    decides: tuple = ()  # options of the scene that it repeats, by -NAME_of, which it has not


# What keywords declare


def option(default, meaning, unit="", *, key="", kind=None, **limits):
    """Declare a keyword and its option; its type is that of the default, or the `kind`.

    Its name is that of the experiment and the keyword, or the `key`; for limits see `Option`.
    """
    if kind is None:
        several = isinstance(default, tuple)
        kind = KINDS[(type(default[0]),) if several else type(default)]
    return Option(key, kind, default, meaning, unit, **limits)


@dataclass(frozen=True)
class Asked:
    """A keyword that is no single option: a window of two, frequencies by a grid, a file's numbers.

    `of_run(options, world, medium)` makes it of the options of a run, and is collective; `check`
    makes it of what is handed in.
    """

    options: tuple
    of_run: Callable
    check: Callable = lambda value: value
    default: object = None


def window(low, high):
    """Declare a keyword of two ends, an option each, `-NAME_min` and `-NAME_max`."""
    keys = f"-{low.name}, -{high.name}"

    def of_run(options, *others):
        ends = low.of_run(options), high.of_run(options)
        return None if ends[0] is None else ends

    def check(value):
        ends = numbers(keys, value)
        if ends.shape != (2,):
            raise InputError(f"{keys}: a window has two ends, not {ends.size}")
        checked = low.check(float(ends[0])), high.check(float(ends[1]))
        check_ends(low.name.removesuffix("_min"), {low.name: checked[0], high.name: checked[1]})
        return checked

    default = None if low.default is None else (low.default, high.default)
    return Asked((low, high), of_run, check, default)


# In Python no bar is wanted unless somebody asks for it.
PROGRESS = next(option for option in RUN if option.name == "output_progress")
PROGRESS = dataclasses.replace(PROGRESS, default="none")


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
        if name not in without:
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


# The function of an experiment, in a notebook and under mpirun


def in_parallel(prefix="", shares_lattice=False, solver=True, **arguments):
    """Let a function do without a crew: it gets all ranks, and what it returns goes to all.

    With a crew of the caller's its record stays on rank 0. What is handed in is checked here,
    before any work, and reaches the function as plain values: by the options that its keywords
    declare, whose names begin with `prefix`, and by `arguments`, declarations of others or what
    returns them plain or raises an InputError; None may stay where it is the default. Without a
    crew the ranks agree on what one of them finds wrong, and that all ask for the same; all share
    the function's lattice if it is large and `shares_lattice` says so. With `solver` it takes a
    keyword of this name, too: keys that hold for PETSc's solvers meanwhile.
    """

    def decorate(function):
        declared = {name: asked for name, asked in arguments.items() if hasattr(asked, "of_run")}
        signature, parameters = inspect.signature(function), []
        for name, parameter in signature.parameters.items():
            asked = parameter.default
            if isinstance(asked, Option) and not asked.name:
                asked = dataclasses.replace(asked, name=f"{prefix}_{name}")
            if hasattr(asked, "of_run"):
                declared[name] = asked
                parameter = parameter.replace(default=asked.default)
            parameters.append(parameter)
        checks = {name: getattr(d, "check", d) for name, d in (declared | arguments).items()}
        if solver:
            checks["solver"] = _solver_keys
            keyword = inspect.Parameter.KEYWORD_ONLY
            parameters.append(inspect.Parameter("solver", keyword, default=None))
            parameters.sort(key=lambda p: p.kind)  # **keywords come last

        def check(*values, **choices):
            """Return the arguments of a call, checked."""
            call = bound(wrapped, values, choices)
            for name, value in call.arguments.items():
                by_default = value is None and call.signature.parameters[name].default is None
                if name in checks and not by_default:
                    call.arguments[name] = checks[name](value)
            return call

        def carry_out(call, **crew):
            call.apply_defaults()
            call.arguments |= crew
            keys = call.arguments.pop("solver", None)
            if not keys:  # what has none does without PETSc
                return function(*call.args, **call.kwargs)
            from pgran.run.keys import holding_solver

            with holding_solver(keys):
                return function(*call.args, **call.kwargs)

        @functools.wraps(function)
        def wrapped(*values, **choices):
            world = launch.start().COMM_WORLD
            from pgran.run.crew import AgreeingCrew, Crew

            if any(isinstance(value, Crew) for value in (*values, *choices.values())):
                return carry_out(check(*values, **choices))
            with ending_all(world):
                with agreeing(world) as asked:
                    call = check(*values, **choices)
                    if call.arguments.get("crew") is not None:
                        raise InputError(f"{function.__name__}: crew is no pgran.run.crew.Crew")
                    if world.size > 1:
                        asked |= {name: fingerprint(v) for name, v in call.arguments.items()}
                        asked["function"] = function.__qualname__
                if world.size > 1:  # PETSc starts on all ranks together, even if one needs it first
                    from pgran.run import petsc  # noqa: F401
                shared = shares_lattice and call.arguments["lattice"].is_large
                with saying_once(), AgreeingCrew(world, world.size if shared else 1) as crew:
                    record = carry_out(call, crew=crew)
                record, medium = world.bcast(record), call.arguments.get("lattice")
                if not isinstance(medium, Shown):  # none, or samples: the record knows the first
                    medium = Result(record.origin[0] if record.origin else ())
                return record.computed_on(medium, **facts_of_run(record.failures, world.size))

        wrapped.__signature__ = signature.replace(parameters=parameters)
        wrapped.check, wrapped.declared = check, declared
        wrapped.__doc__ = _described(function, wrapped.__signature__, declared)
        return wrapped

    return decorate


def facts_of_run(failures, ranks):
    """Return what a result says of its run, {attribute: value}: how it went, by which libraries."""
    import numpy

    return {
        "pgran_version": pgran.__version__,
        "status": "unconverged" if failures else "complete",
        "petsc_version": machine.loaded_version("petsc4py.PETSc"),
        "slepc_version": machine.loaded_version("slepc4py.SLEPc"),
        "numpy_version": numpy.__version__,
        "mpi_size": ranks,
        "time_convention": "exp(+i omega t)",
    }


def _solver_keys(keys):
    """Return the keys of a dict for solvers, checked."""
    from pgran.run.keys import solver_keys_of

    return solver_keys_of(keys)


# What `help` shows

# What functions take besides keywords that are options, unless their docstrings say it themselves.
SHARED = {
    "lattice": ("pgran.Lattice or pgran.Network", ""),
    "omegas": ("array_like of float, shape (nw,)", "Driving frequencies, angular, increasing."),
    "detectors": ("array_like of int", "Ball indices, flat or one row a detector."),
    "crew": ("pgran.run.crew.Crew, optional", "All ranks unless given."),
    "solver": (
        "dict, optional",
        """Keys of PETSc's and SLEPc's solvers, {"steady_ksp_type": "gmres"}.""",
    ),
}
# Sections of a docstring, and what those of all functions that are collective have in common.
SECTION = re.compile(r"\n\n(Parameters|Returns|Raises|Examples)\n-+\n")
COLLECTIVE = "Collective: all ranks call it, and share out the work."
RETURNS = """pgran.results.{} or None
    With a crew of the caller's None on all ranks but rank 0."""
RAISES = """InputError
    If a value is impossible, such as a detector outside of the lattice."""


def _described(function, signature, declared):
    """Return the docstring of a collective function, with what it has in common with others."""
    head, *parts = SECTION.split(inspect.cleandoc(function.__doc__))
    own = dict(zip(parts[::2], parts[1::2], strict=True))
    lines = own.pop("Parameters", "").splitlines()
    told = {line.partition(" :")[0] for line in lines}
    for name in signature.parameters:
        if name in (SHARED.keys() | declared.keys()) - told:
            kind, meaning = SHARED.get(name) or _in_words(declared[name])
            lines += [f"{name} : {kind}", textwrap.indent(textwrap.fill(meaning, 92), 4 * " ")]
    record = function.__annotations__.get("return")
    returned = RETURNS.format(getattr(record, "__name__", record))
    sections = {"Parameters": "\n".join(lines), "Returns": returned, "Raises": RAISES} | own
    texts = [head.strip()] + [COLLECTIVE] * ("Collective" not in head)
    texts += (f"{name}\n{'-' * len(name)}\n{text.strip()}" for name, text in sections.items())
    return "\n\n".join(texts)


def _in_words(declared):
    """Return the type, range, unit and default of a keyword in words, and what it means."""
    first = declared.options[0]
    default = "none" if declared.default is None else text_of(declared.default)
    kind = first.kind.name if isinstance(declared, Option) else "array_like of real"
    facts = [f"{kind} {first.range()}".strip(), first.unit, f"default {default}"]
    return ", ".join(filter(None, facts)), f"{first.meaning}."
