"""What makes the functions of the scenes a Python interface, in a notebook and under mpirun."""

import contextlib
import functools
import inspect

from pgran.errors import InputError
from pgran.files.options import nearest, text_of
from pgran.files.solver_keys import SOLVER_PREFIXES, check_pivot_shifts, is_solver_key
from pgran.scenes.common import automatic_ranks


def in_parallel(shares_lattice=False):
    """Let a function do without a crew: it gets all ranks, and what it returns goes to all.

    Not collective. With a crew of the caller's its record stays on rank 0. The function also takes
    `solver`, a dict of keys for PETSc's and SLEPc's solvers that hold meanwhile.

    Parameters
    ----------
    shares_lattice : bool
        Whether several ranks may share the function's lattice, if it is large.
    """

    def decorate(function):
        signature = inspect.signature(function)
        solver = inspect.Parameter("solver", inspect.Parameter.KEYWORD_ONLY, default=None)
        # by kind, because **keywords come last
        shown = sorted([*signature.parameters.values(), solver], key=lambda given: given.kind)

        @functools.wraps(function)
        def wrapped(*arguments, **choices):
            with holding_solver(choices.pop("solver", None)):
                bound = signature.bind(*arguments, **choices)
                given = bound.arguments
                if "lattice" in given:  # a result's own can be computed on
                    given["lattice"] = getattr(given["lattice"], "built", given["lattice"])
                arguments, choices = bound.args, bound.kwargs
                if given.get("crew") is not None:
                    return function(*arguments, **choices)
                from mpi4py import MPI

                from pgran.parallel.crew import AgreeingCrew

                world = MPI.COMM_WORLD
                ranks = automatic_ranks(given["lattice"], world.size) if shares_lattice else 1
                with AgreeingCrew(world, ranks) as crew:
                    record = function(*arguments, **choices | {"crew": crew})
                return world.bcast(record)

        wrapped.__signature__ = signature.replace(parameters=shown)
        return wrapped

    return decorate


@contextlib.contextmanager
def holding_solver(solver):
    """Let the keys of a dict hold for all solvers that are made meanwhile. Not collective.

    Raises
    ------
    InputError
        For a key that belongs to no solver, or pivots that PETSc might shift for ever.
    """
    keys = {}
    for key, value in (solver or {}).items():
        key = str(key).lower()
        if not is_solver_key(key):
            near = nearest(key, [prefix + key for prefix in SOLVER_PREFIXES])
            hint = f"; did you mean {near!r}?" if near else ""
            raise InputError(f"solver: {key!r} belongs to no solver{hint}")
        keys[key] = "" if value is None or value is True else text_of(value)
    check_pivot_shifts(keys)
    if not keys:
        yield  # what needs no PETSc does without
        return
    from mpi4py import MPI

    from pgran.solve.database import holding, warn_of_unused

    with holding(keys):
        yield
        if MPI.COMM_WORLD.rank == 0:
            warn_of_unused(keys)
