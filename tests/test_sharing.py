"""Ranks in groups: who does what, and that results do not depend on it."""

from types import SimpleNamespace

import numpy as np
import pytest
from mpi4py import MPI
from network_samples import as_network
from samples import assert_same, random_lattice, swept

from pgran.command.resolve import SCENES, resolve
from pgran.errors import InputError
from pgran.medium import graph, lattice
from pgran.medium.sample import ranks_per_lattice
from pgran.run.crew import Crew
from pgran.run.options import read_words

LATTICE = random_lattice((9, 8), 12)


def test_groups(world):
    for size in (size for size in range(1, world.size + 1) if world.size % size == 0):
        options = resolve(read_words(f"-scene response -ranks_per_lattice {size}".split()))
        with Crew(world, ranks_per_lattice(SCENES["response"], options, LATTICE, world)) as crew:
            assert crew.group.size == size
            assert crew.groups == world.size // size
            everyone = world.allgather((crew.number, crew.group.rank))
            assert everyone == [divmod(rank, size) for rank in range(world.size)]
    with pytest.raises(InputError, match=r"-ranks_per_lattice .: does not divide"):
        Crew(world, world.size + 1)
    if world.size == 3:
        with pytest.raises(InputError, match="-ranks_per_lattice 2"):
            Crew(world, 2)


def test_what_is_large(monkeypatch):
    """One rank a lattice, unless it has many balls; a network, unless its factors take long."""
    assert not LATTICE.is_large
    monkeypatch.setitem(lattice.SHARED_ABOVE, 2, 71)
    assert LATTICE.is_large
    chain = as_network(LATTICE)
    assert not chain.is_large
    monkeypatch.setattr(graph, "LARGE_WORK", 0.99 * chain.graph.work)
    assert chain.is_large


ROW = np.dtype([("rank", int), ("value", complex, (3,))])


@pytest.mark.parametrize(("count", "rows"), [(0, 1), (1, 1), (7, 11), (40, 11), (6, 50_000)])
def test_share_delivers_every_unit_once(world, count, rows):
    """Of unequal sizes, more or fewer than there are groups, beyond MPI's eager limit too."""
    delivered, task = {}, SimpleNamespace(units=range(count), row=ROW)

    def work(number):
        found = np.zeros(1 + number * 37 % rows, ROW)
        found["rank"], found["value"] = world.rank, number + 1j * np.arange(3)
        return found

    def deliver(number, rows):
        assert number not in delivered
        delivered[number] = rows.copy()

    with Crew(world, 1) as crew:
        crew.share(task, work, deliver)
    if world.rank > 0:
        assert not delivered
        return
    assert sorted(delivered) == list(range(count))
    for number, found in delivered.items():
        assert len(found) == 1 + number * 37 % rows
        assert len(set(found["rank"])) == 1
        assert np.all(found["value"] == number + 1j * np.arange(3))
    ranks = [found["rank"][0] for found in delivered.values()]
    shares = [ranks.count(rank) for rank in range(world.size)]
    assert max(shares) - min(shares) <= 1


def test_results_do_not_depend_on_the_number_of_ranks(world):
    """Bit for bit, as long as every lattice belongs to one rank."""
    choices = {"fields": True, "refresh_iterations": 1000}
    arguments = LATTICE, np.linspace(0.6, 0.601, 150), (4, 3, 0, 7)
    alone, shared = (swept(*arguments, comm, **choices) for comm in (MPI.COMM_SELF, world))
    assert shared.factorizations == 75  # units share none
    assert_same(shared, alone)


def test_an_error_leaves_the_crew_without_waiting(world):
    """Free is collective: it must not be called while other ranks may be elsewhere."""
    with pytest.raises(ZeroDivisionError), Crew(world, 1) as crew:
        raise ZeroDivisionError
    assert crew.group != MPI.COMM_NULL
    crew.group.Free()
