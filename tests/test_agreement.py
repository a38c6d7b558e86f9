"""Errors that one rank meets are raised on all of them."""

import sys
from types import SimpleNamespace

import pytest
from petsc4py import PETSc

from pgran.__main__ import explain
from pgran.errors import FileError, InputError, PgranError
from pgran.run import agreement
from pgran.run.agreement import agreeing, ending_all, on_root


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


def test_sys_exit_on_all_ranks_is_none_of_our_business(world):
    with pytest.raises(SystemExit), ending_all(world):
        sys.exit(3)


@pytest.mark.parametrize(("size", "interactive"), [(1, False), (2, True), (2, False)])
def test_who_shows_an_uncaught_error(monkeypatch, size, interactive):
    """First whoever did; then all ranks end, unless one is alone, or somebody types."""
    MPI, told = SimpleNamespace(COMM_WORLD=SimpleNamespace(size=size)), []
    monkeypatch.setattr(agreement, "_end_all", lambda world, code, text: told.append(code))
    monkeypatch.setattr(sys, "excepthook", lambda kind, error, trace: told.append(kind))
    monkeypatch.delattr(sys, "ps1", raising=False)
    if interactive:
        monkeypatch.setattr(sys, "ps1", ">>> ", raising=False)
    agreement.end_together(MPI)
    sys.excepthook(InputError, InputError("no ball"), None)
    assert told == ([InputError, 2] if size > 1 and not interactive else [InputError])
