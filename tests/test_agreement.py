"""Which rank reports what has gone wrong, and what it says."""

import pytest
from petsc4py import PETSc

from pgran.__main__ import explain
from pgran.parallel.agreement import who_reports


@pytest.mark.parametrize("same", [True, False])
def test_one_rank_reports_what_several_meet(world, same):
    comm = world.Dup()
    first, alike = who_reports(comm, "no such file" if same else f"rank {comm.rank}")
    assert len(set(world.allgather(first))) == 1
    assert alike == (same or world.size == 1)
    comm.Free()


def test_a_rank_that_fails_alone_does_not_wait_for_ever(world):
    comm, last = world.Dup(), world.size - 1
    if world.rank == last:
        assert who_reports(comm, "mine") == (last, world.size == 1)
    world.Barrier()
    if world.rank != last:  # who fails later leaves the word to the first
        first, alike = who_reports(comm, "mine too")
        assert first == last
        assert not alike
    world.Barrier()
    comm.Free()


def test_an_error_in_a_callback_is_told():
    """Newer PETSc raises an error of its own, with Python's as its cause."""
    error = PETSc.Error(101)
    error.__cause__ = RuntimeError("planted")
    code, text = explain(error)
    assert code == 1
    assert "RuntimeError: planted" in text
