"""The Python interface, in a script and under mpirun, with the messages of the command line."""

import inspect
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from samples import random_lattice

import pgran
import pgran.results
from pgran.command.resolve import resolve
from pgran.experiments.response import scene as response
from pgran.medium.base import record_of
from pgran.run.crew import Crew
from pgran.run.options import read_words

pytestmark = pytest.mark.usefixtures("world")  # what all ranks call alike

LATTICE = random_lattice((6, 5))
PACKING = Path(__file__).parents[1] / "options" / "packings" / "discs.h5"
OMEGAS, LAW = [0.2, 0.5, 0.8], pgran.BondLaw("uniform")


def test_a_record_on_every_rank(world):
    found = pgran.sweep(LATTICE, OMEGAS, [(3, 2), (5, 1)])
    with Crew(world, 1) as crew:
        mine = response.sweep(LATTICE, np.array(OMEGAS), np.array([3, 2, 5, 1]), crew)
    assert (mine is None) == (world.rank > 0)
    expected = world.bcast(mine)
    assert isinstance(found, pgran.experiments.response.record.Response)
    assert np.array_equal(found.displacement, expected.displacement)


def test_all_functions_agree_with_each_other():
    """The response is the sum over modes of the projection's coefficients times their shapes."""
    found = pgran.sweep(LATTICE, OMEGAS, [3, 2], fields=True)
    modes = pgran.find_modes(LATTICE, shapes=True)
    projection = pgran.project(LATTICE, tuple(OMEGAS))
    rebuilt = np.einsum("wi,ixy->wxy", projection.coefficient, modes.vector)
    np.testing.assert_allclose(rebuilt, found.field, rtol=0, atol=1e-10)
    steps = pgran.relax(LATTICE, LAW, OMEGAS[1], [3, 2], steps=20)
    assert steps.displacement[0, 0, 0] == pytest.approx(found.displacement[1, 0], rel=1e-9)
    box = pgran.continuum([1.0, 2.0], (0.47, 0.52), damping=0.1)
    assert box.displacement.shape == (2,)


def test_the_unit_of_frequency_is_that_of_all_balls():
    """Whatever is held, and of a file before version 5 what it was then: of the free balls."""
    masses, held = np.array([9.0, 4.0, 1.0, 1.0]), np.array([2, 0, 0, 1])
    bond = [[0, 1], [1, 2], [2, 3]]
    for other in (held, held[::-1]):
        network = pgran.Network(bond, [1.0, 2.0, 1.0], other, masses)
        assert network.omega_mx == pytest.approx(np.sqrt(2 * 2 / 2.5), rel=1e-15)
    network = pgran.Network(bond, [1.0, 2.0, 1.0], held, masses * [0, 1, 1, 0])
    assert network.mass == 2.5  # walls that are given no mass do not count
    record = record_of(pgran.Network(bond, [1.0, 2.0, 1.0], held, masses[::-1], median_mass=3.0))
    assert record.built.mass == 3.0
    assert replace(record, median_mass=None).built.mass == np.median(masses[::-1][held == 0])


def test_a_network_is_loaded_and_said_in_a_line():
    network = pgran.load(PACKING)
    assert isinstance(network, pgran.Network)
    assert repr(network) == (
        "Network(381 balls, 343 of them free, 835 contacts, vector in 2 dimensions, "
        f"beta 0.003, omega_mx={network.omega_mx:.6g})"
    )
    assert repr(LATTICE) == f"Lattice(6 x 5, mass=1, beta {LATTICE.damping:g}, omega_mx=1)"


@pytest.mark.parametrize(
    ("call", "option"),
    [
        (lambda: pgran.sweep(LATTICE, OMEGAS, [3, 2], error_tolerance=2), "error_tolerance 2"),
        (lambda: pgran.sweep(LATTICE, OMEGAS, [3, 2], error_floor=-1.0), "error_floor -1.0"),
        (lambda: pgran.sweep(LATTICE, OMEGAS[::-1], [3, 2]), "sweep_omega .8,.5,.2"),
        (lambda: pgran.relax(LATTICE, LAW, 0.5, [3, 2], steps=0), "relax_steps 0"),
        (lambda: pgran.relax(LATTICE, LAW, 0.5, [3, 2], steps=2, method="x"), "relax_method x"),
    ],
)
def test_wrong_values_have_the_messages_of_the_command_line(call, option):
    scene = "relaxation" if option.startswith("relax") else "response"
    with pytest.raises(pgran.InputError) as there:
        resolve(read_words(f"-scene {scene} -{option}".split()))
    with pytest.raises(pgran.InputError) as here:
        call()
    assert str(here.value) == str(there.value)


def test_solver_options(world, caplog):
    default = pgran.sweep(LATTICE, OMEGAS, [3, 2])
    solver = {"steady_ksp_type": "gmres", "steady_pc_type": "jacobi", "steady_ksp_typ": "cg"}
    other = pgran.sweep(LATTICE, OMEGAS, [3, 2], solver=solver)
    assert other.iterations.sum() > default.iterations.sum()
    np.testing.assert_allclose(other.displacement, default.displacement, rtol=1e-4)
    said = "-steady_ksp_typ was not used: no solver of this run has such an option; did you mean -s"
    assert (said in caplog.text) == (world.rank == 0)
    with pytest.raises(pgran.InputError, match="did you mean 'steady_ksp_type'"):
        pgran.sweep(LATTICE, OMEGAS, [3, 2], solver={"ksp_type": "gmres"})
    again = pgran.sweep(LATTICE, OMEGAS, [3, 2])
    assert np.array_equal(again.displacement, default.displacement)


def by_rank(world, mine, others):
    """What the last rank hands in, and all others."""
    return mine if world.rank == world.size - 1 else others


@pytest.mark.parametrize(
    ("mine", "said"),
    [
        ({"lattice": random_lattice((6, 5), 9)}, "lattice of rank"),
        ({"omegas": OMEGAS[:2]}, "omegas of rank"),
        ({"detectors": [2, 2]}, "detectors of rank"),
        ({"detectors": [3, 9]}, "detectors of rank"),
        ({"error_tolerance": 1e-5}, "error_tolerance of rank"),
        ({"tolerance": 1e-5}, "did you mean error_tolerance"),
        ({"solver": {"steady_ksp_type": "cg"}}, "solver of rank"),
        ({"solver": {"ksp_type": "cg"}}, "belongs to no solver"),
    ],
)
def test_ranks_that_differ_are_all_told(world, mine, said):
    if world.size > 1:
        common = {"lattice": LATTICE, "omegas": OMEGAS, "detectors": [3, 2]}
        with pytest.raises(pgran.InputError, match=said):
            pgran.sweep(**common | by_rank(world, mine, {}))


def sampling(missing=0, shift=0):
    """A function of the seed that has no sample of one seed, or others than it should."""

    def sample(seed):
        if seed == missing:
            raise KeyError("no such sample")
        return pgran.Lattice.random((4, 3), seed=seed + shift)

    return sample


def times(factor):
    return lambda u: factor * u


def test_what_fails_on_one_rank_leaves_none_waiting(world):
    """A function of the user's for samples, at once or later, a law, another experiment."""
    if world.size > 1:
        for mine, said in (
            (sampling(1993), "KeyError"),
            (sampling(1993 + world.size - 1), "KeyError"),  # of a sample of this rank's own
            (sampling(shift=1), "lattice of rank"),
        ):
            with pytest.raises(pgran.InputError, match=said):
                pgran.ensemble("modes", 6, lattice=by_rank(world, mine, sampling()))
        for mine, said in ((-1, "not negative"), (2, "law of rank")):
            with pytest.raises(pgran.InputError, match=said):
                pgran.relax(LATTICE, by_rank(world, times(mine), times(1)), 0.5, [3, 2], steps=4)
        with pytest.raises(pgran.InputError, match="function of rank"):
            by_rank(world, pgran.count_modes, pgran.project)(LATTICE, OMEGAS)
    assert len(pgran.ensemble("modes", 3, lattice=sampling()).seed) == 3


def test_names():
    assert set(pgran.__all__) <= set(dir(pgran))
    assert all(getattr(pgran, name).__doc__ for name in pgran.__all__)
    with pytest.raises(AttributeError, match="nothing"):
        pgran.nothing  # noqa: B018


def test_help_of_a_function_has_each_thing_once():
    """Its parameters in words, what it returns, what it raises, and that it is collective."""
    collective = [getattr(pgran, name) for name in pgran.__all__]
    collective = [function for function in collective if hasattr(function, "declared")]
    assert len(collective) >= 10
    for function in collective:
        text = function.__doc__
        names = inspect.signature(function).parameters.keys() - {"experiment"}
        told = [f"\n{name} :" for name in names]
        told += ["\nParameters\n---", "\nReturns\n---", "\nRaises\n---", "\nCollective"]
        assert {part: text.count(part) for part in told} == dict.fromkeys(told, 1), function
        kind = re.search(r"\npgran\.results\.(\w+) or None\n", text)[1]
        assert issubclass(getattr(pgran.results, kind), pgran.store.record.Record)
    assert "omega : real > 0, angular, default 0.6\n    burst, ricker:" in pgran.pulse.__doc__
