"""What makes the functions of the scenes a Python interface, in a notebook and under mpirun."""

import functools
import inspect

from pgran.arguments import bound, saying_once
from pgran.errors import InputError
from pgran.run import launch
from pgran.run.agreement import agreeing, ending_all
from pgran.run.keywords import declarations, described
from pgran.run.numbers import fingerprint


def in_parallel(prefix="", shares_lattice=False, **arguments):
    """Let a function do without a crew: it gets all ranks, and what it returns goes to all.

    With a crew of the caller's its record stays on rank 0. What is handed in is checked here,
    before any work, and reaches the function as plain values: by the options that its keywords
    declare, whose names begin with `prefix`, and by `arguments`, declarations of others or what
    returns them plain or raises an InputError; None may stay where it is the default. Without a
    crew the ranks agree on what one of them finds wrong, and that all ask for the same; all share
    the function's lattice if it is large and `shares_lattice` says so.
    """

    def decorate(function):
        declared, signature = declarations(function, prefix, arguments), inspect.signature(function)
        checking = {name: getattr(a, "check", a) for name, a in (declared | arguments).items()}
        plain = {
            name: p.replace(default=p.default.default) if hasattr(p.default, "check") else p
            for name, p in signature.parameters.items()
        }
        signature = signature.replace(parameters=plain.values())

        def check(*values, **choices):
            """Return the arguments of a call, checked."""
            call = bound(wrapped, values, choices)
            for name, value in call.arguments.items():
                if name in checking and (value is not None or plain[name].default is not None):
                    call.arguments[name] = checking[name](value)
            return call

        def carry_out(call, **crew):
            call.apply_defaults()
            call.arguments |= crew
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
                return world.bcast(record)

        wrapped.__signature__, wrapped.check, wrapped.declared = signature, check, declared
        wrapped.__doc__ = described(function, declared)
        return wrapped

    return decorate
