"""Pulses and their signals: ranks, energy, exact chains, bounds, fronts and codas."""

import math

import numpy as np
import pytest
from mpi4py import MPI
from samples import (
    POINTS,
    TIME,
    WIDTH,
    Naive,
    assert_same,
    listened,
    random_lattice,
    reference_of,
    uniform_lattice,
)
from scipy.integrate import trapezoid
from scipy.special import jv
from synthetic import fair

import pgran
from pgran.experiments.pulse.laplace import largest_amplitudes, limits_of, line_of
from pgran.experiments.pulse.scene import summary
from pgran.experiments.pulse.signals import Recording, arrivals, codas, envelopes, front_speed
from pgran.experiments.pulse.wall import Pulse
from pgran.medium.base import record_of
from pgran.store.record import Result

SHORT = {"shape": "gauss", "width": 4.0, "time": 100.0, "points": 101}
MOTION = Pulse("gauss", 0.0, 4.0)
WALL = ("force", "work", "energy", "dissipated")
BOTH = pytest.mark.parametrize("method", ["laplace", "moments"])


def recorded(lattice, sent, time, points, tolerance):
    """Return what is recorded at one ball."""
    return Recording(lattice, (1, 1), sent, time, points, tolerance, False)


def known_of_wall(lattice, naive):
    """Force and work of the wall, energy, and what damping took, by a naive computation."""
    energy, bonds = naive.energy(lattice), lattice.stiffness[0][-1].ravel()
    U, speed = MOTION.moves(naive.times, 2)
    u, v = (x[:, -1].reshape(len(U), -1) for x in (naive.u, naive.v))  # next to the wall
    force = (U[:, None] - u) @ bonds
    force += lattice.damping * (len(bonds) * speed - v.sum(axis=1))
    known = force, energy + naive.dissipated, energy, naive.dissipated
    return dict(zip(WALL, known, strict=True))


@BOTH
def test_ranks_agree(world, method):
    """On every bit if each has its lattice, within errors if they share it; so do the fields."""
    lattice, sites = random_lattice((7, 6), 4), (2, 2, 6, 5)
    choices = {"method": method, "fields": True, "error_tolerance": 1e-7}
    alone, together = (listened(lattice, sites, comm, **choices) for comm in (MPI.COMM_SELF, world))
    assert_same(alone, together)
    shared = listened(lattice, sites, world, ranks=world.size, **choices)
    difference = np.abs(shared.displacement - alone.displacement)
    assert np.all(difference <= shared.error_bound + alone.error_bound)
    exact = listened(lattice, sites, world, fields=True, error_tolerance=1e-7)
    assert np.all(alone.field_time >= exact.field_time * (1 - 1e-9))
    for found in (alone, shared):
        assert found.field[-1] == pytest.approx(exact.field[-1], abs=1e-6)


@pytest.mark.parametrize(("size", "damping"), [((12,), 0.0), ((5, 4), 0.003), ((3, 2, 3), 0.5)])
def test_work_is_energy_and_what_damping_takes(alone, size, damping):
    """By independent quadratures, and all three as a naive computation has them."""
    lattice, site = random_lattice(size, 7, damping), [0] * len(size)
    found = listened(lattice, site, alone, **SHORT, error_tolerance=1e-6)
    work = found.work.max()
    assert np.abs(found.work - found.energy - found.dissipated).max() < 1e-8 * work
    assert np.all(np.diff(found.dissipated) >= -1e-9 * work)
    known = known_of_wall(lattice, Naive(lattice, MOTION, found.time))
    if damping < 0.5:  # which is overdamped
        series = listened(lattice, site, alone, **SHORT, method="moments")
        assert np.abs(series.work - found.work).max() < 1e-9 * work
    for name in WALL[1:]:
        assert np.abs(getattr(found, name) - known[name]).max() < 1e-7 * work
    if damping == 0.0:
        assert not np.any(found.dissipated)


@BOTH
def test_errors_of_force_and_work_are_no_larger_than_estimated(alone, method):
    """Judged by a naive computation; estimates themselves are small."""
    lattice = random_lattice((5, 4), 7, 0.1)
    found = listened(lattice, [2, 1], alone, **SHORT, method=method)
    known = known_of_wall(lattice, Naive(lattice, MOTION, found.time))
    for name in WALL if method == "laplace" else WALL[:2]:  # the others are not computed
        exact = known[name]
        estimate, largest = getattr(found, f"{name}_estimate"), np.abs(exact).max()
        assert np.all(np.abs(getattr(found, name) - exact) <= estimate + 1e-8 * largest)
        assert np.all(np.diff(estimate) >= 0)
        assert 0 < estimate[-1] < 1e-4 * largest


@pytest.mark.parametrize("spacing", [1.0, 4.0])
def test_work_before_the_first_sample_counts(alone, spacing):
    """A motion from a file that starts and stops with kinks, where balls have moved before."""
    lattice, samples = random_lattice((4, 3), 3, 0.03), np.arange(25)
    wall = np.stack([spacing * samples, 0.01 + np.sin(np.pi * samples / 8)], axis=1)
    time = {"wall": wall, "time": 40 * spacing, "points": 193, "error_tolerance": 1e-6}
    found = listened(lattice, [1, 1], alone, **time, fields=True)
    largest = np.abs(found.work).max()
    assert found.energy[0] > 1e-5 * largest
    assert np.abs(found.work - found.energy - found.dissipated).max() < 2e-9 * largest
    stepped = listened(lattice, [1, 1], alone, **time, method="moments")
    for name in WALL[:2]:
        one, other = getattr(found, name), getattr(stepped, name)
        wrong = getattr(found, f"{name}_estimate") + getattr(stepped, f"{name}_estimate")
        assert np.all(np.abs(one - other) <= wrong + 1e-9 * np.abs(one).max())


def test_what_bounds_the_motion():
    """|A| by dense inverses along a line, and the frequencies left out by all of them."""
    lattice = random_lattice((4, 3), 6, 0.01)
    limits, sent = limits_of(lattice), Pulse("burst", 0.6, WIDTH)
    reference = reference_of(lattice)
    line, size = line_of(recorded(lattice, sent, TIME, POINTS, 1e3)), 0.0
    every = np.arange(math.ceil(sent.highest * line.period / (2 * np.pi)) + 1)
    for k in every[::7]:
        s = line.sigma + 2j * np.pi / line.period * k
        A = np.linalg.solve(*map(np.complex128, reference.system(s / 1j)))
        assert np.linalg.norm(A) <= largest_amplitudes(limits, np.array([s]))[0]
        left = k not in line.number
        size += left * 2 / line.period * np.abs(A).max() * abs(sent.transform(s))
    assert size * math.exp(line.sigma * TIME) <= 1e-6
    assert size <= line.left_out
    assert len(line.s) < 0.7 * len(every)


def test_parseval_along_the_line():
    """The sum of |A U|^2, A by dense inverses, against the signal of a naive integrator."""
    lattice = random_lattice((4, 3), 6, 0.01)
    line, reference = line_of(recorded(lattice, MOTION, 60.0, 121, 1e-8)), reference_of(lattice)
    A = np.array([np.linalg.solve(*map(np.complex128, reference.system(s / 1j))) for s in line.s])
    weights = np.where(line.number == 0, 1.0, 2.0) / line.period
    total = weights @ np.abs(A * line.transform[:, None]) ** 2
    naive = Naive(lattice, MOTION, np.linspace(0, line.period, 2001))
    u = naive.u.reshape(2001, -1)
    squares = (np.exp(-line.sigma * naive.times)[:, None] * u) ** 2
    assert total == pytest.approx(trapezoid(squares, naive.times, axis=0), rel=1e-6)
    again = np.concatenate([*line.at(naive.times, A * line.transform[:, None])])
    assert np.abs(again - u)[naive.times <= 60].max() < 1e-7


@pytest.mark.parametrize("size", [(12,), (3, 2, 3)])
def test_the_force_on_the_other_wall_is_the_same_from_both_sides(alone, size):
    """A lattice and its mirror image, random bonds, damping: within the sum of all bounds."""
    lattice = random_lattice(size, 9, 0.05)
    turned = pgran.Lattice(tuple(np.flip(k, 0) for k in lattice.stiffness), 1.0, 0.05)
    forces, wrong = [], 0.0
    for one in (lattice, turned):
        sites = [(0, *rest) for rest in np.ndindex(*size[1:])]
        found = listened(one, sites, alone, **SHORT, error_tolerance=1e-8)
        k = one.stiffness[0][0].ravel()
        forces.append(found.displacement @ k + 0.05 * found.velocity.sum(axis=1))
        wrong = wrong + found.error_bound @ k + 0.05 * found.velocity_bound.sum(axis=1)
    assert np.all(np.abs(forces[0] - forces[1]) <= wrong)
    assert wrong.max() < 1e-4 * np.abs(forces[0]).max()


@BOTH
def test_a_uniform_chain_against_bessel_functions(alone, method):
    """Images on both walls: before a reflection is back they add nothing, later they are exact."""
    balls, omega0, far = 20, 0.5, (1, 5, 15)
    lattice = uniform_lattice((balls,), damping=0.0)
    sites = [balls - n for n in far]
    found = listened(lattice, sites, alone, **SHORT, method=method, error_tolerance=1e-6)
    x, weight = np.polynomial.legendre.leggauss(300)

    def moves(n, t):
        begin = MOTION.centre - 9 * MOTION.width
        past = 0.5 * (t - begin) * (1 + x)
        answer = 2 * n / past * jv(2 * n, 2 * omega0 * past)
        return 0.5 * (t - begin) * (MOTION.moves(t - past, 2) @ (weight * answer))

    errors = found.error_bound, found.velocity_bound
    for place, t in list(enumerate(found.time))[::8]:
        for d, n in enumerate(far):
            once = moves(n, t)
            back = sum(moves(2 * j * (balls + 1) + n, t) - moves(2 * j * (balls + 1) - n, t)
                       for j in range(1, 4))  # fmt: skip
            if t < (2 * balls + 2 - n) / (2 * omega0) * 0.5:
                assert np.abs(back).max() < 1e-9
            u, v = once + back
            assert abs(found.displacement[place, d] - u) <= errors[0][place, d] + 1e-12
            assert abs(found.velocity[place, d] - v) <= errors[1][place, d] + 1e-12


# What is slow, refused, or fails


def test_what_cannot_be_solved_is_not_passed(world, solver_options):
    """Infinite bounds, failures, no arrival."""
    lattice = random_lattice((5, 4), 2)
    solver_options("-steady_ksp_type gmres -steady_pc_type none -steady_ksp_max_it 1")
    found = listened(lattice, (2, 2), world)
    assert found.failures == 1
    assert np.all(found.error_bound > 1e-4 * np.abs(found.displacement).max())
    assert np.isnan(found.arrival[0])


def test_a_wall_that_drives_nothing(world):
    """No spring and no dashpot at the driven wall: nothing moves, and that is proven."""
    bonds = random_lattice((4, 3), 1).stiffness
    still = pgran.Lattice((np.vstack([bonds[0][:-1], 0 * bonds[0][-1:]]), bonds[1]), damping=0.0)
    found = listened(still, (2, 2), world)
    assert not found.displacement.any()
    assert found.error_bound.max() < 1e-10


# Fronts, envelopes and codas


def test_arrival_of_a_front():
    """Of a motion of constant speed from 4 to 6 a thousandth has passed at 4.002."""
    time = np.linspace(0, 10, 10001)
    speed = np.where((time >= 4) & (time < 6), -3.0, 0.0)[:, None]
    assert arrivals(time, speed, 0 * speed) == pytest.approx([4.002], abs=1e-3)
    for hidden in ((speed, 0 * speed + 0.05), (0 * speed, 0 * speed), (speed, 0 * speed, 4.1)):
        assert np.isnan(arrivals(time, *hidden))


def test_a_front_that_shares_of_energy_cannot_tell_is_none():
    """The wall's slow motion gets to the balls, its buzz beyond all modes does not."""
    time = np.linspace(0, 100, 1001)
    wall = np.exp(-0.5 * ((time - 25) / 6) ** 2)
    wall += 10 * np.exp(-0.5 * ((time - 75) / 5) ** 2) * np.cos(3.0 * time)
    sent = {"wall": np.column_stack([time, wall]), "time": 100.0, "points": 501}
    lattice = pgran.Lattice.random((3, 3))
    found = pgran.pulse(lattice, [(0, 2)], method="laplace", **sent)
    assert found.wall_arrival > 50
    assert np.isnan(found.arrival[0])
    said = "".join(summary(Result([record_of(lattice), found])))
    assert "when its front arrives is not certain" in said


def test_the_speed_of_fronts():
    """By noisy arrivals within its error; of a soft push down a chain that of long waves."""
    rng, depth = np.random.default_rng(3), np.arange(1.0, 13)
    noise = 0.4 * rng.standard_normal((200, 12))
    fair([front_speed(depth, 5 + depth / 0.3 + row) for row in noise], 0.3)
    for arrival in (np.where(depth < 3, depth, np.nan), -depth):
        assert np.isnan(front_speed(depth, arrival).value)
    lattice = uniform_lattice((60,), damping=0.0)
    found = pgran.pulse(lattice, [10, 20, 30, 40, 50], shape="gauss", width=12.0, time=300.0)
    speed = front_speed(lattice.depths(found.detector), found.arrival)
    assert speed.value == pytest.approx(pgran.sound(lattice).longitudinal.speed, rel=0.02)
    result = Result([record_of(lattice), found])
    (line,) = (line for line in summary(result) if line.startswith("fronts run"))
    assert line.startswith(f"fronts run at {speed.value:.4g} +- ")
    assert line.endswith("from 10 to 50 spacings deep")


def test_the_rate_of_a_noisy_decay_is_within_its_standard_error():
    """Many oscillations of random amplitude: deviations follow Student's law, 14 degrees."""
    rng, rate = np.random.default_rng(1), 0.004
    time = np.linspace(0, 600, 1201)[:, None]
    noise = np.exp(0.5 * rng.normal(size=(1201, 400)))
    envelope = noise * np.exp(-rate * time) * (time > 20)
    found, error = codas(time[:, 0], envelope, 0 * envelope)
    off = np.abs(found - rate) / error
    assert 0.60 < np.mean(off < 1) < 0.74
    assert 0.90 < np.mean(off < 2) < 0.97
    found, _ = codas(time[:, 0], envelope, 0 * envelope + 1.0)
    assert np.all(np.isnan(found))


@pytest.mark.parametrize(("size", "mode"), [((1,), (1,)), ((3, 2), (2, 1))])
def test_a_single_mode_decays_at_its_own_rate(alone, size, mode):
    """Damping is proportional to equal bonds k: each mode decays at beta omega^2 / (2 k)."""
    k, beta = 0.25, 0.002
    lattice = uniform_lattice(size, k, beta)
    modes = zip(mode, size, strict=True)
    square = k * sum(2 - 2 * math.cos(p * math.pi / (n + 1)) for p, n in modes)
    rate = beta * square / (2 * k)
    choices = {"shape": "burst", "omega": math.sqrt(square), "width": 60.0, "time": 3 / rate}
    found = listened(lattice, [0] * len(size), alone, **choices, points=2501)
    assert found.decay[0] == pytest.approx(rate, abs=4 * found.decay_error[0])
    assert found.decay[0] == pytest.approx(rate, rel=0.02)


def test_before_a_front_there_is_nothing(alone):
    """Nor an envelope, which begins with its signal and is no smaller than the displacement."""
    lattice = uniform_lattice((60,), damping=0.0)
    found = listened(lattice, (40, 10), alone, shape="burst", width=8.0)
    envelope = envelopes(found.displacement, found.velocity)
    assert np.array_equal(envelope, found.envelope)
    assert np.all(envelope >= np.abs(found.displacement))
    early = found.time < 12.0
    assert np.all(np.abs(found.displacement[early, 1]) <= found.error_bound[early, 1])
    ratio = np.sqrt(np.sum(found.displacement**2, axis=0) / np.sum(found.velocity**2, axis=0))
    allowed = np.hypot(found.error_bound, 1.01 * ratio * found.velocity_bound)
    assert np.all(envelope[early, 1] <= allowed[early, 1])
    assert envelope[:, 1].max() > 1e3 * allowed[early, 1].max()
