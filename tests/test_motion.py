"""Motions of the wall, by shape or by numbers: transforms, sizes, derivatives, what is refused."""

import math
from pathlib import Path

import numpy as np
import pytest
from samples import TIME, listened, random_lattice
from scipy.integrate import quad

from pgran.command.resolve import resolve
from pgran.errors import InputError
from pgran.experiments.pulse.wall import SHAPES, Pulse, Samples
from pgran.run.options import read_file, read_words


def transformed(moves, s, pieces):
    """Integrals of moves(t) e^(-s t) over pieces of time, by quadrature."""

    def integrand(t, which):
        return getattr(moves(t) * np.exp(-s * t), which)

    return sum(
        unit * quad(integrand, *ends, args=(name,), limit=900, epsabs=1e-13)[0]
        for unit, name in ((1, "real"), (1j, "imag"))
        for ends in pieces
    )


@pytest.mark.parametrize("shape", SHAPES)
def test_transforms_and_sizes_of_pulses(shape):
    """Against quadrature of the wall's motion itself, and of its velocity."""
    sent = Pulse(shape, 0.7, 3.0)
    ends = sent.centre - 20 * sent.width, sent.centre + 20 * sent.width
    t = np.linspace(*ends, 20001)
    for s in (0.3 + 0.1j, 0.2 - 0.8j, 0.05 + 1.2j):
        U = transformed(lambda t: sent.moves(t)[0], s, [ends])
        if shape == "step":
            U += np.exp(-s * ends[1]) / s  # U = 1 from there on
        assert abs(sent.transform(s) - U) < 1e-10 * abs(U) + 1e-12
        speed = transformed(lambda t: sent.moves(t, 2)[1], s, [ends])
        assert abs(s * sent.transform(s) - speed) < 1e-10 * abs(speed) + 1e-12
    moved, turned = (size[-1] for size in sent.sizes(t))
    U = sent.moves(t)[0]
    way = np.sum(np.abs(np.diff(U)))
    assert way <= turned * (1 + 1e-9) <= 4 * way
    assert np.sum(np.abs(U[1:] + U[:-1]) / 2 * np.diff(t)) <= moved * (1 + 1e-9)


VALUES = np.append(0.0, np.random.default_rng(3).normal(size=29))
VALUES /= np.abs(VALUES).max()
SENT = [*(Pulse(shape, 0.7, 3.0) for shape in SHAPES), Samples(VALUES, 0.7)]


@pytest.mark.parametrize("sent", SENT, ids=lambda sent: sent.shape)
def test_derivatives(sent):
    h, t = 1e-4, np.linspace(-3, sent.end + 5, 57)
    slopes = (sent.moves(t + h, 3) - sent.moves(t - h, 3))[:2] / (2 * h)
    for slope, exact in zip(slopes, sent.moves(t, 3)[1:], strict=True):
        assert np.abs(slope - exact).max() < 1e-6 * np.abs(exact).max()


def test_a_motion_goes_through_its_numbers():
    """At rest before them, and after them too; its transform is that of itself."""
    sent, width = SENT[-1], 0.7
    t = width * np.arange(30)
    assert np.abs(sent.moves(t)[0] - VALUES).max() < 1e-12
    assert np.abs(sent.moves(-width * np.arange(1, 30))[0]).max() < 1e-12
    assert not sent.moves(np.array([-60.0])).any()
    assert np.abs(sent.moves(sent.end + t)[0] - VALUES[-1]).max() < 1e-12
    after = np.linspace(sent.end + 30, sent.end + 300, 999)
    assert np.abs(sent.moves(after)[0] - VALUES[-1]).max() < 1e-7 * np.abs(VALUES).max()
    end = sent.end + 60
    for s in (0.3 + 0.1j, 0.2 - 2.0j, 0.05 + 4j):
        pieces = (-35, 0), (0, 10), (10, sent.end), (sent.end, end)
        U = transformed(lambda t: sent.moves(t)[0], s, pieces) + VALUES[-1] * np.exp(-s * end) / s
        assert abs(sent.transform(np.array(s)) - U) < 1e-7 * abs(U) + 1e-9
    moved, turned = (size[0] for size in sent.sizes(np.array([end])))
    fine = np.abs(sent.moves(np.linspace(-35, end, 9999), 2)).mean(axis=1) * (end + 35)
    assert fine[0] <= moved
    assert fine[1] <= turned


@pytest.mark.parametrize(
    ("shape", "columns", "size", "method"),
    [
        *(("gauss", 1, 1.0, "laplace"), ("step", 2, 1e-9, "laplace")),
        *(("burst", 1, 1e100, "moments"), ("step", 2, 3e-13, "moments")),
    ],
)
def test_a_shape_by_numbers_gives_the_same_signals(alone, shape, columns, size, method):
    """At the recorded times, or at its own in two columns; whatever the unit of displacements."""
    lattice, sent = random_lattice((5, 4), 5, 0.01), Pulse(shape, 0.6, 8.0)
    choices = {"width": 8.0, "time": TIME, "error_tolerance": 1e-6, "points": 201}
    expected = listened(lattice, (2, 2), alone, **choices, shape=shape, omega=0.6)
    time = expected.time[:120] if columns == 1 else np.linspace(0.0, 118.0, 150)
    wall = size * sent.moves(time)[0]
    if columns == 2:
        wall = np.stack([time + 5, wall], axis=1)  # where they begin does not matter
    found = listened(lattice, (2, 2), alone, **choices, wall=wall, method=method)
    assert found.shape == "file"
    assert found.failures == 0
    wrong = np.abs(found.displacement / size - expected.displacement)
    assert np.all(wrong <= found.error.max(axis=0) / size + expected.error_bound + 1e-7)
    for name, unit in (("wall", size), ("velocity", size), ("force", size), ("work", size**2)):
        as_expected = pytest.approx(getattr(expected, name), rel=1e-5, abs=1e-6)
        assert getattr(found, name) / unit == as_expected, name


REFUSED = {
    "lasts until 3; listen longer": {"wall": [[0, 0], [1, 1], [2, 1], [3, 0]], "time": 2.0},
    "lasts until 96; listen longer, or take a shorter pulse": {"time": 90.0},
    "record 64 times or more": {"points": 20},
    "real numbers are needed": {"wall": ["a", "b"]},
    "one column of numbers, or times and numbers": {"wall": np.zeros((5, 3))},
    "increase by equal steps, and do not at 2": {"wall": [[0, 0], [1, 1], [2, 1], [4, 0]]},
    "equal steps, and do not at 3": {"wall": [[3, 0], [2, 1], [1, 0]]},
    "equal steps, and do not at 0": {"wall": [[0, 0], [math.nan, 1], [2, 1]]},
    "two finite numbers or more": {"wall": [0.0, math.nan, 1.0]},
    "not all zero": {"wall": np.zeros(5)},
    "two finite numbers": {"wall": [1.0]},
    "the largest of them between 1e-140 and 1e+140": {"wall": [0.0, 1e308, -1e308, 0.0]},
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


def test_a_shape_on_the_command_line_replaces_the_one_of_a_file():
    shipped = Path(__file__).parents[1] / "options" / "pulse.opts"
    given = read_file(shipped) + read_words(["-pulse_shape", "gauss"])
    assert resolve(given).pulse_shape == "gauss"
