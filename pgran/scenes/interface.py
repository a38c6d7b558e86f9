"""What makes the functions of the scenes a Python interface, in a notebook and under mpirun."""

import functools
import inspect

from pgran.errors import InputError
from pgran.files.options import nearest
from pgran.files.solver_keys import SOLVER_PREFIXES, is_solver_key
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

        @functools.wraps(function)
        def wrapped(*arguments, **choices):
            solver = choices.pop("solver", None)
            given = signature.bind_partial(*arguments, **choices).arguments
            if given.get("crew") is not None:
                return function(*arguments, **choices)
            from mpi4py import MPI

            from pgran.parallel.crew import AgreeingCrew

            world = MPI.COMM_WORLD
            ranks = automatic_ranks(given["lattice"].shape, world.size) if shares_lattice else 1
            with solver_options(solver), AgreeingCrew(world, ranks) as crew:
                return world.bcast(function(*arguments, **choices | {"crew": crew}))

        return wrapped

    return decorate


def solver_options(solver):
    """Return a context in which keys of a dict hold for all solvers that are made. Not collective.

    Raises
    ------
    InputError
        For a key that belongs to no solver.
    """
    from pgran.solve.database import holding

    solver = {str(key).lower(): _text(value) for key, value in (solver or {}).items()}
    for key in solver:
        if not is_solver_key(key):
            near = nearest(key, [prefix + key for prefix in SOLVER_PREFIXES])
            raise InputError(
                f"solver: {key!r} belongs to no solver"
                + (f"; did you mean {near!r}?" if near else "")
            )
    return holding(solver, warn=True)


def _text(value):
    """Return a value as an options file has it: None and True stand for a key alone."""
    if value is None or value is True:
        return ""
    return "false" if value is False else str(value)
