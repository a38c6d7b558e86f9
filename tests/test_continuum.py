"""The exact series against mpmath, and against the lattice that it is the limit of."""

import itertools

import mpmath
import numpy as np
import pytest
from reference import continuum_amplitude, uniform_field
from scipy.optimize import brentq

from pgran import InputError, continuum
from pgran.experiments.continuum.series import HALF_WAVES, PI, Continuum

POINT = (0.47, 0.52)
EXTENDED = np.finfo(np.longdouble).eps < 1e-18
TOLERANCE = 1e-12  # what the module promises


@pytest.fixture(autouse=True)
def _digits():
    with mpmath.workdps(45):
        yield


def relative_error(box, omega, point):
    exact = continuum_amplitude(box, omega, point)
    return float(abs(mpmath.mpc(complex(box.response(omega, point))) - exact) / abs(exact))


@pytest.mark.parametrize("damping", [0.0, 0.003, 1.0])
def test_agrees_with_mpmath_next_to_every_wall(damping):
    across = (1e-6, 1e-3, 0.52, 1 - 1e-3, 1 - 1e-6)
    along = (1e-6, 1e-3, 0.47, 1 - 1e-3, 1 - 1e-6, 1 - 1e-9)
    points = [p for p in itertools.product(along, across) if p[0] < 0.5 or 0.1 < p[1] < 0.9]
    omegas = np.random.default_rng(3).uniform(0, 200, len(points))
    for point, omega in zip(points, omegas, strict=True):
        assert relative_error(Continuum(damping=damping), omega, point) < TOLERANCE


@pytest.mark.parametrize("size", [(1.0, 0.01), (13.0, 0.7), (0.37, 20.0)])
def test_agrees_with_mpmath_in_other_boxes(size):
    box = Continuum(size=size, mass=2.7, stiffness=0.31, damping=0.02)
    for omega in (0.0, 3.0):
        for point in ((0.9 * size[0], 0.4 * size[1]), (1e-5 * size[0], 0.01 * size[1])):
            if abs(continuum_amplitude(box, omega, point)) > 1e-290:
                assert relative_error(box, omega, point) < TOLERANCE


@pytest.mark.skipif(not EXTENDED, reason="promised for machines with extended precision only")
@pytest.mark.parametrize("point", [(0.5, 1 / 3), (1e-6, 0.5), (0.4, 1e-6)])
def test_agrees_with_mpmath_next_to_resonances(point):
    resonances = Continuum().resonances(200)
    for resonance in resonances[[0, len(resonances) // 2, -1]]:
        for distance, damping in ((0, 0.0), (0, 1e-9), (1e-15, 0.0), (-1e-9, 1e-9), (1e-6, 0.0)):
            omega = resonance * (1 + distance)
            assert relative_error(Continuum(damping=damping), omega, point) < TOLERANCE


@pytest.mark.parametrize(
    ("omega", "damping", "distance"), [(0.0, 0.0, 1e-4), (190.0, 0.0, 1e-3), (200.0, 1.0, 1e-2)]
)
def test_agrees_with_brute_force_in_the_corners(omega, damping, distance):
    """The paper's series, summed in extended precision however many terms it takes."""
    nu = np.arange(1, int(16 / distance) + 200, 2)
    z = np.longdouble(omega) ** 2 / (1 + 1j * np.longdouble(omega) * damping)
    gamma, x = np.sqrt((nu * PI) ** 2 - z), 1 - distance
    ratio = np.exp(-gamma * (1 - x)) * np.expm1(-2 * gamma * x) / np.expm1(-2 * gamma)
    # Both sides of where the contour changes its kernel, y = (Lx - x)/10.
    for y in (1e-12, 1e-6, 0.0999 * distance, 0.1001 * distance, distance, 10 * distance):
        exact = complex(4 / PI * np.sum(np.sin(nu * (PI * y)) / nu * ratio))
        found = Continuum(damping=damping).response(omega, (x, y))
        assert abs(found - exact) < TOLERANCE * abs(exact)


def test_next_to_a_zero_the_error_is_small_against_the_terms():
    box = Continuum(damping=0.0)
    zero = brentq(lambda omega: box.response(omega, POINT).real, 100.1935, 100.1937, xtol=1e-10)
    exact = continuum_amplitude(box, zero, POINT)
    assert abs(exact) < 1e-5
    error = abs(mpmath.mpc(complex(box.response(zero, POINT))) - exact)
    assert error < (1e-16 if EXTENDED else 1e-12)


def test_walls():
    box, omega = Continuum(size=(1.5, 0.7)), [0.0, 3.0, 180.0]
    np.testing.assert_allclose(box.response(omega, (1.5, 0.3)), 1, rtol=1e-15)
    for point in ((0, 0.3), (0.4, 0), (0.4, 0.7), (0, 0), (1.5, 0), (1.5, 0.7)):
        np.testing.assert_array_equal(box.response(omega, point), 0)


def test_a_long_box_neither_overflows_nor_warns():
    """exp(-499.5 pi) is below any double; above the cut-off frequency pi the wave passes."""
    with np.errstate(all="raise", under="ignore"):
        faint = Continuum((500.0, 1.0), damping=0.0).response([0.0, 1.0, 5.0], (0.5, 0.5))
    assert faint[0] == 0
    assert np.isfinite(faint[1])
    assert 1e-3 < abs(faint[2]) < np.inf


@pytest.mark.parametrize(("damping", "omega"), [(0.0, 5.5), (0.3, 8.0)])
def test_the_uniform_lattice_converges_at_second_order(damping, omega):
    """Spacing 1/n, stiffness n^2 and damping n^2 beta."""
    limit, errors = Continuum(damping=damping).response(omega, (0.45, 0.55)), []
    for n in (20, 40, 80):
        field = uniform_field((n - 1, n - 1), n**2, 1.0, damping * n**2, omega)
        errors.append(abs(field[9 * n // 20 - 1, 11 * n // 20 - 1] - limit))
    orders = np.log2(np.divide(errors[:-1], errors[1:])).astype(float)
    assert orders == pytest.approx([2, 2], abs=0.1)


def test_frequencies_of_the_driven_modes():
    find = Continuum(size=(1.5, 0.7), mass=2.0, stiffness=0.3).resonances
    pairs = itertools.product(range(1, 60), range(1, 60, 2))
    expected = sorted(np.pi * np.sqrt(0.15 * ((i / 1.5) ** 2 + (j / 0.7) ** 2)) for i, j in pairs)
    np.testing.assert_allclose(find(20.0), [w for w in expected if w <= 20], rtol=1e-14)
    assert find(0.0).size == 0


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("size", bad) for bad in ((1.0, 0.0), (1.0, np.nan), (1.0,), (1.0, 1e-200))),
        ("mass", 0.0), ("mass", np.inf), ("stiffness", -1.0), ("damping", -1e-9),
        *(("point", bad) for bad in ((1.1, 0.5), (0.5, -1e-9), (np.nan, 0.5), (0.1, 0.2, 0.3))),
    ],
)  # fmt: skip
def test_impossible_boxes_and_points_are_refused(name, value):
    with pytest.raises(InputError, match=rf"continuum_{name}"):
        continuum([1.0], **{"point": POINT} | {name: value})


@pytest.mark.parametrize("omega", [-1.0, np.nan, np.inf, 1.01 * np.pi * HALF_WAVES, 1e300])
def test_impossible_frequencies_are_refused(omega):
    box = Continuum(damping=0.0)
    for function in (lambda w: box.response([1.0, w], POINT), box.resonances):
        with pytest.raises(InputError, match=r"^omega: "):
            function(omega)
