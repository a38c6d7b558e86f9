"""What makes the functions of the scenes a Python interface, in a notebook and under mpirun."""

import functools
import inspect

from pgran.arguments import bound
from pgran.errors import InputError
from pgran.run import launch
from pgran.run.agreement import agreeing
from pgran.run.keywords import declarations, described
from pgran.run.numbers import fingerprint
from pgran.run.streams import saying_once


def in_parallel(prefix="", shares_lattice=False, **checks):
    """Let a function do without a crew: it gets all ranks, and what it returns goes to all.

    With a crew of the caller's its record stays on rank 0. What is handed in is checked here,
    before any work, and reaches the function as plain values: by the options that its keywords
    declare, whose names begin with `prefix`, and by `checks`, which return other arguments plain or
    raise an InputError; None may stay where it is the default. Without a crew the ranks agree on
    what one of them finds wrong, and that all ask for the same; all share the function's lattice if
    it is large and `shares_lattice` says so.
    """

    def decorate(function):
        declared, signature = declarations(function, prefix), inspect.signature(function)
        checking = {name: keyword.check for name, keyword in declared.items()} | checks
        plain = {
            name: p.replace(default=declared[name].default) if name in declared else p
            for name, p in signature.parameters.items()
        }
        signature = signature.replace(parameters=plain.values())

        def check(*arguments, **choices):
            """Return the arguments of a call, checked."""
            call = bound(wrapped, arguments, choices)
            for name, value in call.arguments.items():
                if name in checking and (value is not None or plain[name].default is not None):
                    call.arguments[name] = checking[name](value)
            return call

        def carry_out(call, **crew):
            call.apply_defaults()
            call.arguments |= crew
            return function(*call.args, **call.kwargs)

        @functools.wraps(function)
        def wrapped(*arguments, **choices):
            world = launch.start().COMM_WORLD
            from pgran.run.crew import AgreeingCrew, Crew

            if any(isinstance(value, Crew) for value in (*arguments, *choices.values())):
                return carry_out(check(*arguments, **choices))
            with agreeing(world) as asked:
                call = check(*arguments, **choices)
                if call.arguments.get("crew") is not None:
                    raise InputError(f"{function.__name__}: crew is no pgran.run.crew.Crew")
                if world.size > 1:
                    asked |= {name: fingerprint(v) for name, v in call.arguments.items()}
                    asked["function"] = function.__qualname__
            shared = shares_lattice and call.arguments["lattice"].is_large
            with saying_once(), AgreeingCrew(world, world.size if shared else 1) as crew:
                record = carry_out(call, crew=crew)
            return world.bcast(record)

        wrapped.__signature__, wrapped.check, wrapped.declared = signature, check, declared
        wrapped.__doc__ = described(function.__doc__, signature, declared)
        return wrapped

    return decorate
