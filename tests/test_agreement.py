"""Errors that one rank meets are raised on all of them."""

import pytest
from petsc4py import PETSc

from pgran.__main__ import explain
from pgran.errors import FileError, InputError, PgranError
from pgran.run.agreement import agreeing, on_root


def met_on(world, rank, error):
    with agreeing(world):
        if world.rank == rank:
            raise error


@pytest.mark.parametrize(
    ("error", "here", "there"),
    [
        (InputError("no ball"), InputError, InputError),
        (OSError(2, "none", "a.h5"), FileError, FileError),
        (ZeroDivisionError("of a script"), ZeroDivisionError, PgranError),
    ],
)
def test_what_one_rank_meets_all_raise(world, error, here, there):
    for failing in {0, world.size - 1}:
        with pytest.raises((here, there), match=r"no ball|a\.h5: none|of a script") as caught:
            met_on(world, failing, error)
        assert type(caught.value) is (here if world.rank == failing else there)

    def fail():
        raise error

    with pytest.raises((here, there)) as caught:
        on_root(world, fail)
    assert type(caught.value) is (there if world.rank else here)


def test_ranks_that_ask_for_different_things(world):
    with agreeing(world) as asked:
        asked |= {"lattice": "abc", "omegas": "def"}
    if world.size > 1:
        with (
            pytest.raises(InputError, match="omegas, extra of rank 1 differs from rank 0"),
            agreeing(world) as asked,
        ):
            asked |= {"omegas": "abc"} if world.rank == 0 else {"omegas": "def", "extra": "abc"}


def test_an_error_in_a_callback_is_told():
    """Newer PETSc raises an error of its own, with Python's as its cause."""
    error = PETSc.Error(101)
    error.__cause__ = RuntimeError("planted")
    code, text = explain(error)
    assert code == 1
    assert "RuntimeError: planted" in text
