"""Signals in time: orders of integrators, energy, identities, exact chains, motions from files."""

import math

import numpy as np
import pytest
from mpi4py import MPI
from samples import (
    TIME,
    listened,
    option_values,
    random_lattice,
    reference_of,
    swept,
    uniform_lattice,
)
from scipy.integrate import quad, solve_ivp, trapezoid
from scipy.special import jv

from pgran.command.resolve import resolve
from pgran.errors import FileError, InputError
from pgran.files.columns import read_columns
from pgran.files.reading import read_words
from pgran.physics.laplace import Line
from pgran.physics.lattice import Lattice
from pgran.physics.pulse import Pulse, Samples
from pgran.physics.signal import codas, envelopes
from pgran.scenes.signals import limits_of
from pgran.solve.integrate import Integrator
from pgran.solve.operators import Operators

SHORT = {"shape": "gauss", "width": 4.0, "time": 100.0, "points": 101}
MOTION = Pulse("gauss", 0.0, 4.0)


class Naive:
    """A lattice after a pulse by DOP853 on dense matrices, and the work that its dashpots take."""

    def __init__(self, lattice, sent, times):
        """Integrate."""
        reference = self.reference = reference_of(lattice)
        K, C = (matrix.astype(float) for matrix in (reference.K, lattice.damping * reference.C))
        drive, damped = reference.drive_K.astype(float), lattice.damping * reference.drive_C
        damped, count, walls = damped.astype(float), len(K), float(damped.sum())
        self.sent, self.times = sent, times

        def slope(t, y):
            u, v = y[:count], y[count:-1]
            U, speed = sent.moves(t, 2)
            taken = v @ C @ v - 2 * speed * (damped @ v) + walls * speed**2
            return np.concatenate([v, (drive * U + damped * speed - K @ u - C @ v) / lattice.mass,
                                   [taken]])  # fmt: skip

        span = min(sent.begin, 0.0), times[-1]
        start = np.zeros(2 * count + 1)
        y = solve_ivp(slope, span, start, "DOP853", times, rtol=1e-12, atol=1e-14, max_step=2.0).y
        shape = (-1, *reference.shape)
        self.u, self.v = y[:count].T.reshape(shape), y[count:-1].T.reshape(shape)
        self.dissipated = y[-1]

    def energy(self, lattice):
        """Bond by bond: walls are balls that move as they are told."""
        energy = 0.5 * lattice.mass * np.sum(self.v.reshape(len(self.v), -1) ** 2, axis=1)
        U = self.sent.moves(self.times)[0].reshape(-1, *[1] * len(lattice.shape))
        for axis, k in enumerate(lattice.stiffness):
            ends = np.zeros_like(np.take(self.u, [0], axis + 1))
            above = ends + U if axis == 0 else ends
            stretched = np.diff(np.concatenate([ends, self.u, above], axis + 1), axis=axis + 1)
            energy += 0.5 * np.sum((k * stretched**2).reshape(len(energy), -1), axis=1)
        return energy


@pytest.mark.parametrize(
    ("options", "step", "order"),
    [
        ("-pulse_ts_rk_type 3", 0.4, 3),
        ("-pulse_ts_rk_type 5dp", 0.8, 5),
        ("-pulse_ts_rk_type 7vr", 1.6, 7),
        ("-pulse_ts_type alpha2", 0.4, 2),
    ],
)
def test_orders_of_integrators(comm, solver_options, options, step, order):
    """Fixed steps, halved twice: displacement, velocity, force and energy."""
    lattice, errors = random_lattice((4, 3), 5, 0.1), []
    naive = Naive(lattice, MOTION, -20 + 1.6 * np.arange(37))
    energy, bonds = naive.energy(lattice), lattice.stiffness[0][-1]
    U, speed = MOTION.moves(naive.times, 2)
    force = (U[:, None] - naive.u[:, -1]) @ bonds
    force += 0.1 * (3 * speed - naive.v[:, -1].sum(axis=1))
    expected = np.stack([naive.u[:, 2, 1], naive.v[:, 2, 1], force, energy], axis=1)
    solver_options(f"{options} -pulse_ts_adapt_type none")
    for h in (step, step / 2, step / 4):
        solver_options(f"-pulse_ts_dt {h}")
        with (
            Operators(lattice, comm) as operators,
            Integrator(operators, [(2, 1)], MOTION) as integrator,
        ):
            found = integrator.run(37.6, 1e-6, begin=-20.0)
        steps = np.arange(37) * round(1.6 / h)
        assert np.abs(found.time[steps] - naive.times).max() < 1e-9
        columns = found.displacement, found.velocity, found.force[:, :1], found.energy[:, :1]
        wrong = np.concatenate(columns, axis=1)[steps] - expected
        errors.append(np.sqrt(np.mean(wrong**2, axis=0)))
    seen = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(seen[-1] > order - 0.6)
    states = np.linalg.norm(np.array(errors)[:, :2], axis=1)
    assert np.log2(states[:-1] / states[1:]) == pytest.approx(order, abs=0.3)


@pytest.mark.parametrize("damping", [0.0, 0.003, 0.5])
@pytest.mark.parametrize("size", [(12,), (5, 4), (3, 2, 3)])
def test_work_is_energy_and_what_damping_takes(world, size, damping):
    """By independent quadratures, and all three as a naive computation has them."""
    lattice = random_lattice(size, 7, damping)
    site = [0] * len(size)
    found = listened(lattice, site, world, **SHORT, error_tolerance=1e-6)
    work = found.work.max()
    assert np.abs(found.work - found.energy - found.dissipated).max() < 1e-8 * work
    assert np.all(np.diff(found.dissipated) >= -1e-9 * work)
    naive = Naive(lattice, MOTION, found.time)
    assert np.abs(found.energy - naive.energy(lattice)).max() < 1e-7 * work
    assert np.abs(found.dissipated - naive.dissipated).max() < 1e-7 * work
    stepped = listened(lattice, site, world, **SHORT, method="integrate", error_tolerance=1e-9)
    for name in ("work", "energy", "dissipated"):
        assert np.abs(getattr(stepped, name) - getattr(found, name)).max() < 1e-7 * work
    if damping == 0.0:
        assert np.abs(stepped.dissipated).max() < 1e-8 * work
        assert not np.any(found.dissipated)


def test_parseval_along_the_line():
    """The sum of |A U|^2, A by dense inverses, against the signal of a naive integrator."""
    lattice = random_lattice((4, 3), 6, 0.01)
    line = Line(MOTION, 60.0, 121, limits_of(lattice), 1e-8)
    reference = reference_of(lattice)
    A = np.array([np.linalg.solve(*map(np.complex128, reference.system(s / 1j))) for s in line.s])
    weights = np.where(line.number == 0, 1.0, 2.0) / line.period
    total = weights @ np.abs(A * line.transform[:, None]) ** 2
    naive = Naive(lattice, MOTION, np.linspace(0, line.period, 2001))
    squares = (np.exp(-line.sigma * naive.times)[:, None] * naive.u.reshape(2001, -1)) ** 2
    assert total == pytest.approx(trapezoid(squares, naive.times, axis=0), rel=1e-6)
    again = line.at(naive.times, A * line.transform[:, None])
    early = naive.times <= 60
    assert np.abs(again - naive.u.reshape(2001, -1))[early].max() < 1e-7


@pytest.mark.parametrize("size", [(12,), (5, 4), (3, 2, 3)])
def test_the_force_on_the_other_wall_is_the_same_from_both_sides(world, size):
    """A lattice and its mirror image, random bonds, damping: within the sum of all bounds."""
    lattice = random_lattice(size, 9, 0.05)
    turned = Lattice(tuple(np.flip(k, 0) for k in lattice.stiffness), 1.0, 0.05)
    forces, wrong = [], 0.0
    for one in (lattice, turned):
        sites = [(0, *rest) for rest in np.ndindex(*size[1:])]
        found = listened(one, sites, world, **SHORT, error_tolerance=1e-8)
        k = one.stiffness[0][0].ravel()
        forces.append(found.displacement @ k + 0.05 * found.velocity.sum(axis=1))
        wrong = wrong + found.error_bound @ k + 0.05 * found.velocity_bound.sum(axis=1)
    assert np.all(np.abs(forces[0] - forces[1]) <= wrong)
    assert wrong.max() < 1e-4 * np.abs(forces[0]).max()


@pytest.mark.parametrize("method", ["laplace", "integrate"])
def test_a_uniform_chain_against_bessel_functions(world, method):
    """Images on both walls: before a reflection is back they add nothing, later they are exact."""
    balls, omega0, far = 20, 0.5, (1, 5, 15)
    lattice = uniform_lattice((balls,), damping=0.0)
    sites = [balls - n for n in far]
    found = listened(lattice, sites, world, **SHORT, method=method, error_tolerance=1e-6)
    x, weight = np.polynomial.legendre.leggauss(300)

    def moves(n, t):
        begin = MOTION.centre - 9 * MOTION.width
        past = 0.5 * (t - begin) * (1 + x)
        answer = 2 * n / past * jv(2 * n, 2 * omega0 * past)
        return 0.5 * (t - begin) * (MOTION.moves(t - past, 2) @ (weight * answer))

    for place, t in enumerate(found.time):
        if place % 8:
            continue
        for d, n in enumerate(far):
            once = moves(n, t)
            back = sum(moves(2 * j * (balls + 1) + n, t) - moves(2 * j * (balls + 1) - n, t)
                       for j in range(1, 4))  # fmt: skip
            if t < (2 * balls + 2 - n) / (2 * omega0) * 0.5:
                assert np.abs(back).max() < 1e-9
            u, v = once + back
            errors = (found.error_bound, found.velocity_bound)
            if method == "integrate":
                errors = (found.error_estimate.max(axis=0), found.velocity_estimate.max(axis=0))
                errors = tuple(np.broadcast_to(e, found.velocity.shape) for e in errors)
            assert abs(found.displacement[place, d] - u) <= errors[0][place, d] + 1e-12
            assert abs(found.velocity[place, d] - v) <= errors[1][place, d] + 1e-12


def test_the_spectrum_of_a_long_signal_is_the_steady_response(world):
    """A damped lattice, listened to until it is quiet."""
    lattice, sites = random_lattice((5, 4), 3, 0.5), (3, 1, 1, 2)
    choices = {"shape": "gauss", "width": 2.0, "time": 300.0, "points": 301}
    found = listened(lattice, sites, world, **choices, error_tolerance=1e-8)
    assert np.abs(found.displacement[-1]).max() < 1e-9
    omegas = 2 * np.pi / 301 * np.arange(3, 60, 4)
    turning = np.exp(-1j * np.outer(omegas, found.time))
    moved = turning @ found.wall
    response = swept(lattice, omegas, sites, world, error_tolerance=1e-8)
    wrong = np.abs(turning @ found.displacement / moved[:, None] - response.displacement)
    allowed = (found.error_bound.sum(axis=0) + 1e-7) / np.abs(moved)[:, None]
    assert np.all(wrong <= allowed + response.error_bound)
    assert allowed.max() < 1e-3 * np.abs(response.displacement).max()


# Motions that are given by numbers


def test_a_motion_goes_through_its_numbers():
    """Any numbers; at rest before them, and after them too; derivatives and transform of itself."""
    values = np.random.default_rng(3).normal(size=30)
    values[0] = 0.0
    sent, width = Samples(values, 0.7), 0.7
    t = width * np.arange(30)
    assert np.abs(sent.moves(t)[0] - values).max() < 1e-12
    assert np.abs(sent.moves(-width * np.arange(1, 30))[0]).max() < 1e-12
    assert not sent.moves(np.array([-60.0])).any()
    assert np.abs(sent.moves(sent.end + t)[0] - values[-1]).max() < 1e-12
    after = np.linspace(sent.end + 30, sent.end + 300, 999)
    assert np.abs(sent.moves(after)[0] - values[-1]).max() < 1e-7 * np.abs(values).max()
    h, inner = 1e-4, np.linspace(-3, 25, 57)
    for order in (1, 2):
        before, later = sent.moves(inner - h, 3)[order - 1], sent.moves(inner + h, 3)[order - 1]
        slope = sent.moves(inner, 3)[order]
        assert np.abs((later - before) / (2 * h) - slope).max() < 1e-6 * np.abs(slope).max()
    end = sent.end + 60
    for s in (0.3 + 0.1j, 0.2 - 2.0j, 0.05 + 4j):

        def part(t, which, s=s):
            return getattr(sent.moves(t)[0] * np.exp(-s * t), which)

        whole = (
            sum(
                unit * quad(part, *ends, args=(name,), limit=900, epsabs=1e-11)[0]
                for unit, name in ((1, "real"), (1j, "imag"))
                for ends in ((-35, 0), (0, 10), (10, sent.end), (sent.end, end))
            )
            + values[-1] * np.exp(-s * end) / s
        )
        assert abs(sent.transform(np.array(s)) - whole) < 1e-7 * abs(whole) + 1e-9
    moved, turned = (size[0] for size in sent.sizes(np.array([end])))
    fine = np.abs(sent.moves(np.linspace(-35, end, 9999), 2)).mean(axis=1) * (end + 35)
    assert fine[0] <= moved
    assert fine[1] <= turned


@pytest.mark.parametrize("shape", ["gauss", "step", "burst"])
@pytest.mark.parametrize("method", ["laplace", "integrate"])
@pytest.mark.parametrize("columns", [1, 2])
def test_a_shape_by_numbers_gives_the_same_signals(world, shape, method, columns):
    """At the recorded times, or at its own in two columns, until the motion has ended."""
    lattice, sent = random_lattice((5, 4), 5, 0.01), Pulse(shape, 0.6, 8.0)
    choices = {"width": 8.0, "time": TIME, "error_tolerance": 1e-6, "points": 201}
    expected = listened(lattice, (2, 2), world, **choices, shape=shape, omega=0.6)
    time = expected.time[:120] if columns == 1 else np.linspace(0.0, 118.0, 150)
    wall = sent.moves(time)[0]
    if columns == 2:
        wall = np.stack([time + 5, wall], axis=1)  # where they begin does not matter
    found = listened(lattice, (2, 2), world, **choices, wall=wall, method=method)
    assert found.shape == "file"
    assert found.failures == 0
    wrong = np.abs(found.displacement - expected.displacement)
    assert np.all(wrong <= found.error.max(axis=0) + expected.error_bound + 1e-7)


REFUSED = {
    "lasts until 3; listen longer": {"wall": [[0, 0], [1, 1], [2, 1], [3, 0]], "time": 2.0},
    "lasts until 96; listen longer, or take a shorter pulse": {"time": 90.0},
    "record 64 times or more": {"points": 20},
    "a list of numbers": {"wall": ["a", "b"]},
    "one column of numbers, or times and numbers": {"wall": np.zeros((5, 3))},
    "increase by equal steps, and do not at 2": {"wall": [[0, 0], [1, 1], [2, 1], [4, 0]]},
    "equal steps, and do not at 3": {"wall": [[3, 0], [2, 1], [1, 0]]},
    "equal steps, and do not at 0": {"wall": [[0, 0], [math.nan, 1], [2, 1]]},
    "two finite numbers or more": {"wall": [0.0, math.nan, 1.0]},
    "not all zero": {"wall": np.zeros(5)},
    "two finite numbers": {"wall": [1.0]},
    "let the motion begin smoothly": {"wall": [1.0, 2.0, 1.0]},
    "pulse_shape": {"shape": "square"},
    "pulse_width": {"width": 0.0},
    "pulse_points": {"points": 1},
    "pulse_method": {"method": "guess"},
    "is outside the lattice": {"sites": (9, 9)},
}  # fmt: skip


@pytest.mark.parametrize("said", REFUSED)
def test_what_is_refused_says_what_to_change(world, said):
    choices = {"sites": (2, 2)} | REFUSED[said]
    with pytest.raises(InputError) as refused:
        listened(random_lattice((5, 4), 2), choices.pop("sites"), world, **choices)
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("0\n1\n\n# end\n2 three\n", "a.txt:5: '2 three' is no number; begin comments with #"),
        ("0 0\n1\n", "a.txt:2: 1 numbers; each line has one, or a time and one"),
        ("0 0 0\n", "a.txt:1: 3 numbers"),
        ("0\nnan\n1\n", "a.txt:2: 'nan' is not finite; fill the gap"),
        ("0,1\n1,1e999", "a.txt:2: '1,1e999' is not finite"),
        ("# nothing\n\n", "a.txt: holds no numbers"),
    ],
)
def test_files_that_hold_no_motion(written, text, said):
    with pytest.raises(FileError) as refused:
        read_columns(written(text, "a.txt"))
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


def test_columns_of_a_file(written):
    """Comments, empty lines, a mark of the encoding, any of three separators."""
    content = "\ufeff# t u\n0, 1\n\n 1;2 # note\n2\t3e-1\n"
    assert read_columns(written(content)).tolist() == [[0, 1], [1, 2], [2, 0.3]]


def test_a_file_and_a_shape_are_alternatives():
    words = "-scene pulse -pulse_file a.txt -pulse_shape gauss"
    with pytest.raises(InputError, match="pulse_file") as refused:
        resolve(read_words(words.split()))
    assert "pulse_shape" in str(refused.value)


# Integrations


PULSE = "-scene pulse -lattice_shape 5,4 -detectors 2,2 -pulse_time 250 -pulse_points 101"


@pytest.mark.parametrize("more", ["-pulse_ts_max_steps 3", "-pulse_ts_max_time 100"])
def test_an_integration_that_gives_up_is_not_passed(place, call, world, more):
    """It is said, estimates are infinite, and a run ends as other inaccurate ones do."""
    place("p.opts", f"{PULSE} -pulse_method integrate -output_progress none")
    ended = call("run", "p.opts", *more.split())
    assert ended.returncode == 3
    assert "an integration has ended at time" in ended.stderr
    from pgran.scenes.interface import holding_solver

    with holding_solver(option_values(more)):
        found = listened(random_lattice((5, 4)), (2, 2, 1, 1), world, method="integrate")
    assert found.failures == 2
    assert np.all(np.isinf(found.error_estimate))
    assert np.all(np.isnan(found.arrival))
    assert np.all(np.isnan(found.decay))


def test_no_other_integrators(world, solver_options):
    solver_options("-pulse_ts_type bdf")
    with pytest.raises(InputError, match=r"pulse_ts_type bdf: .* by rk or alpha2"):
        listened(random_lattice((5, 4)), (2, 2), world, method="integrate")


def test_ranks_that_share_a_lattice_integrate_alike(world):
    """With the one that each has to itself, within estimates; so do the fields."""
    lattice, sites = random_lattice((7, 6), 4), (2, 2, 6, 5)
    choices = {"method": "integrate", "fields": True, "error_tolerance": 1e-7}
    alone = listened(lattice, sites, MPI.COMM_SELF, **choices)
    shared = listened(lattice, sites, world, ranks=world.size, **choices)
    wrong = np.abs(alone.displacement - shared.displacement)
    assert np.all(wrong <= alone.error_estimate.max(axis=0) + shared.error_estimate.max(axis=0))
    exact = listened(lattice, sites, world, fields=True, error_tolerance=1e-7)
    assert np.all(alone.field_time >= exact.field_time * (1 - 1e-9))
    assert alone.field[-1] == pytest.approx(exact.field[-1], abs=1e-6)
    assert shared.field[-1] == pytest.approx(exact.field[-1], abs=1e-6)


# Codas and envelopes


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


@pytest.mark.parametrize(("size", "mode"), [((1,), (1,)), ((4,), (1,)), ((3, 2), (2, 1))])
def test_a_single_mode_decays_at_its_own_rate(world, size, mode):
    """Damping is proportional to equal bonds k: each mode decays at beta omega^2 / (2 k)."""
    k, beta = 0.25, 0.002
    lattice = uniform_lattice(size, k, beta)
    modes = zip(mode, size, strict=True)
    square = k * sum(2 - 2 * math.cos(p * math.pi / (n + 1)) for p, n in modes)
    rate = beta * square / (2 * k)
    choices = {"shape": "burst", "omega": math.sqrt(square), "width": 60.0, "time": 3 / rate}
    found = listened(lattice, [0] * len(size), world, **choices, points=2501)
    assert found.decay[0] == pytest.approx(rate, abs=4 * found.decay_error[0])
    assert found.decay[0] == pytest.approx(rate, rel=0.02)


def test_an_envelope_begins_with_its_signal(world):
    """It is no smaller than the displacement, and before a front no larger than errors allow."""
    lattice = uniform_lattice((60,), damping=0.0)
    found = listened(lattice, (40, 10), world, shape="burst", width=8.0)
    envelope = envelopes(found.displacement, found.velocity)
    assert np.array_equal(envelope, found.envelope)
    assert np.all(envelope >= np.abs(found.displacement))
    early = found.time < 12.0
    ratio = np.sqrt(np.sum(found.displacement**2, axis=0) / np.sum(found.velocity**2, axis=0))
    allowed = np.hypot(found.error_bound, 1.01 * ratio * found.velocity_bound)
    assert np.all(envelope[early, 1] <= allowed[early, 1])
    assert envelope[:, 1].max() > 1e3 * allowed[early, 1].max()
