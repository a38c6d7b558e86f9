"""Ranks in groups: who does what, and that results do not depend on it."""

from types import SimpleNamespace

import numpy as np
import pytest
from mpi4py import MPI
from samples import random_lattice

from pgran.command.resolve import resolve
from pgran.errors import InputError
from pgran.files.reading import read_words
from pgran.parallel.crew import LARGE, Crew, automatic_ranks
from pgran.scenes.common import make_crew
from pgran.scenes.projection import project
from pgran.scenes.response import sweep, units

OMEGAS = np.linspace(0.05, 1.3, 150)
NUMBERS = ("displacement", "error_bound", "backward_error", "iterations", "converged_reason")


@pytest.fixture(scope="module")
def lattice():
    return random_lattice((9, 8), 12)


@pytest.fixture(scope="module")
def alone(lattice):
    """The sweep that each rank makes for itself."""
    with Crew(MPI.COMM_SELF, 1) as crew:
        return sweep(lattice, OMEGAS, (4, 3, 0, 7), crew, fields=True)


def test_groups(world):
    for size in range(1, world.size + 1):
        if world.size % size:
            continue
        with Crew(world, size) as crew:
            assert crew.group.size == size
            assert crew.groups == world.size // size
            everyone = world.allgather((crew.number, crew.group.rank))
            assert everyone == [divmod(rank, size) for rank in range(world.size)]


def test_groups_that_do_not_divide(world):
    with pytest.raises(InputError, match=r"-ranks_per_lattice.*cannot be cut"):
        Crew(world, world.size + 1)
    if world.size == 3:
        with pytest.raises(InputError, match="-ranks_per_lattice 2"):
            Crew(world, 2)


@pytest.mark.parametrize("together", [False, True])
def test_groups_that_options_ask_for(world, lattice, together):
    size = world.size if together else 1
    options = resolve(read_words(f"-scene response -ranks_per_lattice {size}".split()))
    with make_crew(options, lattice, world) as crew:
        assert crew.group.size == size


def test_automatic_ranks():
    """One rank a lattice, unless it is large."""
    assert automatic_ranks((20, 20), 8) == 1
    for axes, balls in LARGE.items():
        assert automatic_ranks((balls,) + (1,) * (axes - 1), 8) == 1
        assert automatic_ranks((balls + 1,) + (1,) * (axes - 1), 8) == 8
    assert automatic_ranks((2**31, 2**31, 2**31), 2) == 2  # no overflow


@pytest.mark.parametrize("count", [1, 2, 5, 63, 64, 150, 1291, 5000])
def test_units_cover_a_sweep_once(count):
    cut = units(count)
    assert [index for unit in cut for index in unit] == list(range(count))
    assert max(map(len, cut)) <= 16


def test_units_share_no_factorization(lattice):
    """So that it does not matter which of them a group has done before."""
    omegas = np.linspace(0.6, 0.6001, 150)
    with Crew(MPI.COMM_SELF, 1) as crew:
        response = sweep(lattice, omegas, (4, 3), crew, refresh_iterations=1000)
        projection = project(lattice, omegas, crew, refresh_iterations=1000)
    assert response.factorizations == projection.factorizations == len(units(150)) == 75


ROW = np.dtype([("unit", int), ("rank", int), ("value", complex, (3,))])


@pytest.mark.parametrize("count", [0, 1, 2, 7, 40])
def test_share_delivers_every_unit_once(world, count):
    """Units of unequal sizes, more or fewer than there are groups."""
    units = [(number, 1 + number * 37 % 11) for number in range(count)]
    delivered = []

    def work(unit):
        number, size = unit
        rows = np.zeros(size, ROW)
        rows["unit"], rows["rank"] = number, world.rank
        rows["value"] = number + 1j * np.arange(3)
        return rows

    with Crew(world, 1) as crew:
        crew.share(
            SimpleNamespace(units=units, row=ROW), work, lambda rows: delivered.append(rows.copy())
        )
        if world.rank > 0:
            assert delivered == []
            return
        assert sorted(rows["unit"][0] for rows in delivered) == list(range(count))
        for rows in delivered:
            number = rows["unit"][0]
            assert len(rows) == units[number][1]
            assert np.all(rows["unit"] == number)
            assert len(set(rows["rank"])) == 1
            assert np.array_equal(rows["value"], [number + 1j * np.arange(3)] * len(rows))
        shares = np.bincount(
            np.array([rows["rank"][0] for rows in delivered], dtype=int), minlength=world.size
        )
        assert shares.max() - shares.min() <= 1


def test_share_of_large_units(world):
    """Messages beyond MPI's eager limit neither deadlock nor lose anything."""
    total = 0

    def deliver(rows):
        nonlocal total
        total += int(rows["unit"].sum())

    def work(unit):
        rows = np.zeros(50_000, ROW)
        rows["unit"] = unit
        return rows

    with Crew(world, 1) as crew:
        crew.share(SimpleNamespace(units=list(range(6)), row=ROW), work, deliver)
    assert total == (750_000 if world.rank == 0 else 0)


def test_results_do_not_depend_on_the_number_of_ranks(world, lattice, alone):
    """Bit for bit, as long as every lattice belongs to one rank."""
    with Crew(world, 1) as crew:
        shared = sweep(lattice, OMEGAS, (4, 3, 0, 7), crew, fields=True)
    if world.rank > 0:
        assert shared is None
        return
    for name in (*NUMBERS, "field", "amplitude", "phase", "phase_slope", "phase_velocity"):
        assert np.array_equal(getattr(shared, name), getattr(alone, name)), name
    assert shared.factorizations == alone.factorizations


def test_one_lattice_on_all_ranks(world, lattice):
    """Another solver and another order of sums: to 1e-12 of the wall's amplitude."""
    results = []
    for comm in (world, MPI.COMM_SELF):
        with Crew(comm, comm.size) as crew:
            results.append(sweep(lattice, OMEGAS[::6], (4, 3), crew, error_tolerance=1e-13))
    if world.rank == 0:
        together, alone = results
        # The bound of either may be 1e-13 of the amplitude or, near resonances, of rounding.
        scale = np.maximum(1.0, np.abs(alone.displacement))
        assert np.all(np.abs(together.displacement - alone.displacement) <= 1e-12 * scale)


def test_an_error_leaves_the_crew_without_waiting(world):
    """Free is collective: it must not be called while other ranks may be elsewhere."""
    crew = Crew(world, 1)
    with pytest.raises(ZeroDivisionError), crew:
        raise ZeroDivisionError
    assert crew.group != MPI.COMM_NULL
    crew.group.Free()
