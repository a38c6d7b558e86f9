"""What makes the functions of the scenes a Python interface, in a notebook and under mpirun."""

import functools
import inspect

from pgran.arguments import bound
from pgran.errors import InputError
from pgran.run import launch
from pgran.run.agreement import agreeing
from pgran.run.fingerprints import fingerprint
from pgran.run.keywords import declarations, described
from pgran.run.streams import saying_once


def in_parallel(prefix="", shares_lattice=False, **checks):
    """Let a function do without a crew: it gets all ranks, and what it returns goes to all.

    With a crew of the caller's its record stays on rank 0. What is handed in is checked here,
    before any work, and reaches the function as plain values. Without a crew the ranks agree on
    what one of them finds wrong, and that all ask for the same.

    Parameters
    ----------
    prefix : str
        What the names of the options begin with that its keywords declare.
    shares_lattice : bool
        Whether all ranks share the function's lattice, if it is large.
    **checks : callable
        Of arguments that declare no option, by name: what takes a value, and returns it as a plain
        one or raises an InputError. None is left as it is where it is the default.
    """

    def decorate(function):
        declared, signature = declarations(function, prefix), inspect.signature(function)
        checking = {name: keyword.check for name, keyword in declared.items()} | checks
        plain = [
            p.replace(default=declared[p.name].default) if p.name in declared else p
            for p in signature.parameters.values()
        ]
        signature = signature.replace(parameters=plain)
        absent = {parameter.name for parameter in plain if parameter.default is None}

        def check(*arguments, **choices):
            """Return the arguments of a call, checked."""
            given = bound(wrapped, arguments, choices)
            for name, value in given.arguments.items():
                if name in checking and not (value is None and name in absent):
                    given.arguments[name] = checking[name](value)
            return given

        def carry_out(given, **crew):
            given.apply_defaults()
            given.arguments |= crew
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
            shared = shares_lattice and given.arguments["lattice"].is_large
            ranks = world.size if shared else 1
            with saying_once(), AgreeingCrew(world, ranks) as crew:
                record = carry_out(given, crew=crew)
            return world.bcast(record)

        wrapped.__signature__, wrapped.check, wrapped.declared = signature, check, declared
        wrapped.__doc__ = described(function.__doc__, signature, declared)
        return wrapped

    return decorate
