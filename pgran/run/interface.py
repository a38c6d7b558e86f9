"""What makes the functions of the scenes a Python interface, in a notebook and under mpirun."""

import contextlib
import functools
import inspect

from pgran.arguments import bound, shown
from pgran.errors import InputError
from pgran.run import launch
from pgran.run.agreement import agreeing
from pgran.run.fingerprints import fingerprint
from pgran.run.keys import SOLVER_PREFIXES, check_pivot_shifts, is_solver_key
from pgran.run.options import RUN, nearest, text_of
from pgran.run.streams import saying_once

PROGRESS = next(option for option in RUN if option.name == "output_progress")


def in_parallel(share=None, **declared):
    """Let a function do without a crew: it gets all ranks, and what it returns goes to all.

    Not collective. With a crew of the caller's its record stays on rank 0. The function also takes
    `solver`, a dict of keys for PETSc's and SLEPc's solvers that hold meanwhile.

    What is handed in is checked here, before any work, and reaches the function as plain values.
    Without a crew the ranks agree on what one of them finds wrong, and that all ask for the same.

    Parameters
    ----------
    share : callable, optional
        How many of so many ranks share the function's lattice, `share(lattice, ranks)`.
    **declared : callable
        Of arguments by name: what takes a value, and returns it as a plain one or raises an
        InputError. None is left as it is where it is the default.
    """
    declared = {"progress": PROGRESS.check, "solver": solver_keys_of} | declared

    def decorate(function):
        signature = inspect.signature(function)
        solver = inspect.Parameter("solver", inspect.Parameter.KEYWORD_ONLY, default=None)
        # by kind, because **keywords come last
        shown = sorted([*signature.parameters.values(), solver], key=lambda given: given.kind)
        absent = {parameter.name for parameter in shown if parameter.default is None}

        def check(*arguments, **choices):
            """Return the arguments of a call, checked. Not collective."""
            given = bound(wrapped, arguments, choices)
            for name, value in given.arguments.items():
                if name in declared and not (value is None and name in absent):
                    given.arguments[name] = declared[name](value)
            return given

        def carry_out(given, **crew):
            given.arguments |= crew
            with holding_solver(given.arguments.pop("solver", None)):
                return function(*given.args, **given.kwargs)

        @functools.wraps(function)
        def wrapped(*arguments, **choices):
            world = launch.start().COMM_WORLD
            from pgran.run.crew import AgreeingCrew, Crew

            if any(isinstance(value, Crew) for value in (*arguments, *choices.values())):
                return carry_out(check(*arguments, **choices))
            with agreeing(world) as asked:
                given = check(*arguments, **choices)
                if given.arguments.get("crew") is not None:
                    raise InputError(f"{function.__name__}: crew is no pgran.run.crew.Crew")
                if world.size > 1:
                    asked |= {name: fingerprint(v) for name, v in given.arguments.items()}
                    asked["function"] = function.__qualname__
            ranks = 1
            if share:
                ranks = share(given.arguments["lattice"], world.size)
            with saying_once(), AgreeingCrew(world, ranks) as crew:
                record = carry_out(given, crew=crew)
            return world.bcast(record)

        wrapped.__signature__ = signature.replace(parameters=shown)
        wrapped.check = check
        return wrapped

    return decorate


def solver_keys_of(solver):
    """Return the keys of a dict for solvers, as texts. Not collective.

    Raises
    ------
    InputError
        For a key that belongs to no solver, or pivots that PETSc might shift for ever.
    """
    if not isinstance(solver, dict):
        raise InputError(f"solver: a dict of keys is needed, not {shown(solver)}")
    keys = {}
    for key, value in solver.items():
        key = str(key).lower()
        if not (key.isidentifier() and is_solver_key(key)):
            near = nearest(key, [prefix + key for prefix in SOLVER_PREFIXES])
            hint = f"; did you mean {near!r}?" if near else ""
            raise InputError(f"solver: {key!r} belongs to no solver{hint}")
        keys[key] = "" if value is None or value is True else text_of(value)
        if not keys[key].isprintable():
            raise InputError(f"solver: {keys[key]!r} is no value of {key!r}")
    check_pivot_shifts(keys)
    return keys


@contextlib.contextmanager
def holding_solver(keys):
    """Let keys hold for all solvers that are made meanwhile. Not collective."""
    if not keys:
        yield  # what needs no PETSc does without
        return
    world = launch.start().COMM_WORLD
    from pgran.run.petsc import holding, warn_of_unused

    with holding(keys):
        yield
        if world.rank == 0:
            warn_of_unused(keys)
