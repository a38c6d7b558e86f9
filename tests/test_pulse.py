"""Pulses of the wall: their signals against an integrator, and what bounds them."""

import math

import numpy as np
import pytest
from mpi4py import MPI
from samples import (
    POINTS,
    TIME,
    WIDTH,
    assert_same,
    listened,
    random_lattice,
    reference_of,
    uniform_lattice,
)

import pgran
from pgran.errors import InputError
from pgran.experiments.pulse import scene as pulse
from pgran.experiments.pulse.laplace import Line, largest_amplitudes, limits_of
from pgran.experiments.pulse.signals import arrivals
from pgran.experiments.pulse.wall import Pulse
from pgran.medium.lattice import Lattice
from pgran.medium.record import record_of
from pgran.store.record import Result


def test_nothing_arrives_before_the_front(world):
    """Down a chain: beyond the bound nothing, then the front, later the farther away."""
    lattice = uniform_lattice((60,), damping=0.0)
    found = listened(lattice, (55, 45, 35), world, shape="gauss", width=2.0)
    early = found.time < 2.0
    assert np.all(np.abs(found.displacement[early]) <= found.error_bound[early])
    assert np.all(np.diff(found.arrival) > 0)


@pytest.mark.parametrize("method", ["laplace", "integrate"])
def test_ranks_agree(world, method):
    """On every bit if each has its lattice, within errors if they share it; so do the fields."""

    def error(found):
        return found.error_estimate.max(axis=0) if method == "integrate" else found.error_bound

    lattice, sites = random_lattice((7, 6), 4), (2, 2, 6, 5)
    choices = {"method": method, "fields": True, "error_tolerance": 1e-7}
    alone, together = (listened(lattice, sites, comm, **choices) for comm in (MPI.COMM_SELF, world))
    assert_same(alone, together)
    shared = listened(lattice, sites, world, ranks=world.size, **choices)
    difference = np.abs(shared.displacement - alone.displacement)
    assert np.all(difference <= error(shared) + error(alone))
    exact = listened(lattice, sites, world, fields=True, error_tolerance=1e-7)
    assert np.all(alone.field_time >= exact.field_time * (1 - 1e-9))
    for found in (alone, shared):
        assert found.field[-1] == pytest.approx(exact.field[-1], abs=1e-6)


def test_what_cannot_be_solved_is_not_passed(world, solver_options):
    """Infinite bounds, failures, no arrival; and a time too short for the pulse is refused."""
    lattice = random_lattice((5, 4), 2)
    with pytest.raises(InputError, match="pulse_time 70: the pulse lasts until 96; listen longer"):
        listened(lattice, (2, 2), world, time=70.0)
    solver_options("-steady_ksp_type gmres -steady_pc_type none -steady_ksp_max_it 1")
    found = listened(lattice, (2, 2), world)
    assert found.failures == 1
    assert np.all(found.error_bound > 1e-4 * np.abs(found.displacement).max())
    assert np.isnan(found.arrival[0])


def test_a_wall_that_drives_nothing(world):
    """No spring and no dashpot at the driven wall: nothing moves, and that is proven."""
    bonds = random_lattice((4, 3), 1).stiffness
    still = Lattice((np.vstack([bonds[0][:-1], 0 * bonds[0][-1:]]), bonds[1]), damping=0.0)
    found = listened(still, (2, 2), world)
    assert not found.displacement.any()
    assert found.error_bound.max() < 1e-10


def test_arrival_of_a_front():
    """Of a motion of constant speed from 4 to 6 a thousandth has passed at 4.002."""
    time = np.linspace(0, 10, 10001)
    speed = np.where((time >= 4) & (time < 6), -3.0, 0.0)[:, None]
    assert arrivals(time, speed, 0 * speed) == pytest.approx([4.002], abs=1e-3)
    assert np.isnan(arrivals(time, speed, 0 * speed + 0.05))
    assert np.isnan(arrivals(time, 0 * speed, 0 * speed))
    assert np.isnan(arrivals(time, speed, 0 * speed, 4.1))


@pytest.mark.parametrize(
    ("shape", "omega", "width"),
    [("burst", 0.6, 12.0), ("burst", 1.2, 6.0), ("gauss", 0.6, 4.0), ("ricker", 0.3, 4.0)],
)
def test_no_front_is_before_the_walls_own(shape, omega, width):
    """Next to the wall, too, where balls move less than the wall and as early."""
    lattice = pgran.Lattice.random((8, 6))
    near = [(7, j) for j in range(6)] + [(6, 2), (4, 2), (0, 0)]
    sent = {"shape": shape, "omega": omega, "width": width, "time": 200.0, "points": 801}
    found = pgran.pulse(lattice, near, **sent)
    assert np.all(found.arrival >= found.wall_arrival)
    ahead = np.argmax(np.abs(found.displacement) > 0.1 * np.abs(found.displacement).max(0), axis=0)
    wall = np.argmax(np.abs(found.wall) > 0.1 * np.abs(found.wall).max())
    assert (ahead < wall).any() == (shape == "burst")  # as a part of the largest has it


def test_a_front_that_shares_of_energy_cannot_tell_is_none():
    """The wall's slow motion gets to the balls, its buzz beyond all modes does not."""
    time = np.linspace(0, 100, 1001)
    wall = np.exp(-0.5 * ((time - 25) / 6) ** 2)
    wall += 10 * np.exp(-0.5 * ((time - 75) / 5) ** 2) * np.cos(3.0 * time)
    sent = {"wall": np.column_stack([time, wall]), "time": 100.0, "points": 501}
    found = pgran.pulse(pgran.Lattice.random((3, 3)), [(0, 2)], method="integrate", **sent)
    assert found.wall_arrival > 50
    assert np.isnan(found.arrival[0])
    result = Result([record_of(pgran.Lattice.random((3, 3))), found])
    assert "when its front arrives is not certain" in "".join(pulse.summary(result))


def test_what_bounds_the_motion():
    """|A| by dense inverses along a line, and the frequencies left out by all of them."""
    lattice = random_lattice((4, 3), 6, 0.01)
    limits, sent = limits_of(lattice), Pulse("burst", 0.6, WIDTH)
    reference = reference_of(lattice)
    line, size = Line(sent, TIME, POINTS, limits, 1e3), 0.0
    every = np.arange(math.ceil(sent.highest * line.period / (2 * np.pi)) + 1)
    for k in every[::7]:
        s = line.sigma + 2j * np.pi / line.period * k
        S, f = reference.system(s / 1j)
        A = np.linalg.solve(S.astype(complex), f.astype(complex))
        assert np.linalg.norm(A) <= largest_amplitudes(limits, np.array([s]))[0]
        left = k not in line.number
        size += left * 2 / line.period * np.abs(A).max() * abs(sent.transform(s))
    assert size * math.exp(line.sigma * TIME) <= 1e-6
    assert size <= line.left_out
    assert len(line.s) < 0.7 * len(every)
