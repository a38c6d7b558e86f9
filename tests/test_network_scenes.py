"""Every scene on a network: a lattice written as one gives the lattice's own numbers."""

import numpy as np
import pytest
from network_samples import as_network
from samples import random_lattice

import pgran
from pgran.run.crew import Crew

SIZE, BALL = (6, 5), (2, 3)
OMEGAS = np.linspace(0.1, 1.1, 9)


@pytest.fixture(params=["alone", "shared"])
def crew(world, request):
    """What shares out the work: each rank has the network, or all share it."""
    with Crew(world, world.size if request.param == "shared" else 1) as made:
        yield made


def both(crew, compute, damping=0.01):
    """What is computed of a lattice and of the same network, on every rank."""
    lattice = random_lattice(SIZE, 4, damping, mass=0.7)
    network, ball = as_network(lattice), np.ravel_multi_index(BALL, SIZE)
    found = compute(lattice, [BALL], crew), compute(network, [ball], crew)
    return crew.world.bcast(found)


def assert_close(one, other, *names, tolerance=1e-12):
    """Arrays of two records are equal to a tolerance of their largest entries."""
    for name in names:
        a, b = (np.ravel(getattr(record, name)) for record in (one, other))
        assert np.abs(a - b).max() <= tolerance * np.abs(a).max(), name


def assert_agree(one, other):
    """Displacements agree within their bounds, and none of the network's has failed."""
    difference = np.abs(one.displacement - other.displacement)
    assert np.all(difference <= one.error_bound + other.error_bound)
    assert other.failures == 0


@pytest.mark.parametrize("method", ["points", "curve"])
def test_response(crew, method):
    choices = {"method": method, "resolve": 0.0}
    one, other = both(crew, lambda m, ball, c: pgran.sweep(m, OMEGAS, ball, c, **choices))
    assert_agree(one, other)
    if method == "points":
        assert_close(one, other, "displacement", "derivative", "delay")


@pytest.mark.parametrize("damping", [0.01, 0.0])
def test_fields(crew, damping):
    if damping or crew.group.size == 1:
        compute = lambda m, ball, c: pgran.sweep(m, OMEGAS, ball, c, fields=True)  # noqa: E731
        one, other = both(crew, compute, damping)
        assert other.failures == one.failures == 0
        if damping:
            assert_close(one, other, "field")


def test_modes_and_projection(crew):
    if crew.group.size > 1:
        pytest.skip("modes are each rank's own")
    modes, others = both(crew, lambda m, ball, c: pgran.find_modes(m, c, shapes=True))
    assert others.count_certified
    assert_close(modes, others, "omega", "participation")
    one, other = both(crew, lambda m, ball, c: pgran.project(m, OMEGAS, c))
    assert np.abs(np.abs(one.coefficient) - np.abs(other.coefficient)).max() < 1e-9


@pytest.mark.parametrize("method", ["window", "krylov"])
def test_relaxation(crew, method):
    law, choices = pgran.BondLaw("uniform"), {"steps": 40, "method": method}
    one, other = both(crew, lambda m, ball, c: pgran.relax(m, law, 0.5, ball, c, **choices))
    assert_close(one, other, "stiffness")
    assert_agree(one, other)


@pytest.mark.parametrize("method", ["laplace", "moments"])
def test_pulse(crew, method):
    choices = {"width": 6.0, "time": 120.0, "points": 121, "method": method, "fields": True}
    one, other = both(crew, lambda m, ball, c: pgran.pulse(m, ball, c, **choices))
    assert_close(one, other, "wall")
    assert np.all(np.abs(one.displacement - other.displacement) <= one.error + other.error + 1e-12)
    if method == "laplace":  # steps of an integrator depend on what bounds the frequencies
        names = ("displacement", "force", "work", "energy", "dissipated", "field")
        assert_close(one, other, *names, tolerance=1e-9)
    assert other.failures == 0


def test_a_network_of_its_own_constants_relaxes():
    network = as_network(random_lattice(SIZE, 4, 0.01))
    found = pgran.relax(network, None, 0.5, [9], steps=40)
    assert np.all(np.isin(found.stiffness, network.stiffness))
    assert found.failures == 0


def test_what_no_drive_reaches_is_refused(world):
    chain = [[0, 1], [1, 2], [3, 4]]
    for held, said in (
        ([1, 0, 2, 0, 0], "2 of the balls float, ball 3 first"),
        ([1, 0, 0, 0, 1], "no ball is driven"),
    ):
        network = pgran.Network(chain, np.ones(3), held)
        with Crew(world, 1) as crew, pytest.raises(pgran.InputError, match=said):
            pgran.sweep(network, OMEGAS, [1], crew)


@pytest.mark.parametrize(
    ("damped", "kind", "said"),
    [("normal", "rotations", True), ("all", "rotations", False), ("normal", "vector", False)],
)
def test_dashpots_that_damp_no_rotation_are_spoken_of_where_ranks_share(
    damped, kind, said, caplog, world
):
    """The smallest eigenvalue of C is 0 where balls turn undamped: bounds take counts of S."""
    position = np.array([[0, 0], [1, 0], [0.5, 0.8], [1.5, 0.8], [1.0, 1.6]])
    bond = [[0, 2], [1, 2], [1, 3], [2, 3], [2, 4], [3, 4]]
    more = {"radius": [0.5] * 5, "tangential": [0.5] * 6} if kind == "rotations" else {}
    network = pgran.Network(
        bond, [1.0] * 6, [1, 1, 0, 0, 2], displacement=kind, position=position, damped=damped,
        damping=0.1, **more,
    )  # fmt: skip
    said = said and world.size > 1
    with Crew(world, world.size) as crew:
        found = pgran.sweep(network, [0.3, 0.5], [2], crew)
    if world.rank == 0:
        assert ("no error bound is proven" in caplog.text) == said
        assert (found.failures > 0) == said
