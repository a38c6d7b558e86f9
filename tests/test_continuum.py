"""The exact series against mpmath, the differential equation, and the lattice it is limit of."""

import itertools
import subprocess
import sys

import mpmath
import numpy as np
import pytest
from mpmath import mp, mpf
from reference import continuum_amplitude

from pgran.errors import InputError
from pgran.physics.continuum import HALF_WAVES, PI, PI_SQUARED, Continuum

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


def brute_force(box, omega, x, y):
    """Sum the paper's series in extended precision, however many terms it takes."""
    lx, ly = (np.longdouble(length) for length in box.size)
    z = (
        box.mass
        * np.longdouble(omega) ** 2
        / (box.stiffness + 1j * np.longdouble(omega) * box.damping)
    )
    nu = np.arange(1, 16 * int(ly / (lx - x)) + 200, 2)
    gamma = np.sqrt((nu * PI / ly) ** 2 - z)
    ratio = np.exp(-gamma * (lx - x)) * np.expm1(-2 * gamma * x) / np.expm1(-2 * gamma * lx)
    return complex(4 / PI * np.sum(np.sin(nu * (PI * y / ly)) / nu * ratio))


def test_pi():
    with mpmath.workdps(60):
        assert abs(mpf(str(PI_SQUARED)) - mp.pi**2) < mpf(10) ** -48
    assert (
        abs(float(PI - np.longdouble(np.pi)) - float(mp.pi - mpf(np.pi)))
        < np.finfo(np.longdouble).eps
    )


@pytest.mark.parametrize("damping", [0.0, 1e-4, 0.003, 0.1, 1.0])
def test_agrees_with_mpmath_next_to_every_wall(damping):
    box = Continuum(damping=damping)
    across = (1e-6, 1e-3, 0.3, 0.52, 1 - 1e-3, 1 - 1e-6)
    along = (1e-6, 1e-3, 0.47, 1 - 1e-3, 1 - 1e-6, 1 - 1e-9)
    points = [p for p in itertools.product(along, across) if p[0] < 0.5 or 0.1 < p[1] < 0.9]
    omegas = np.random.default_rng(3).uniform(0, 200, (len(points), 2))
    for point, pair in zip(points, omegas, strict=True):
        for omega in pair:
            assert relative_error(box, omega, point) < TOLERANCE, (point, omega)


@pytest.mark.parametrize("size", [(0.01, 1.0), (1.0, 0.01), (13.0, 0.7), (0.37, 20.0)])
def test_agrees_with_mpmath_in_other_boxes(size):
    box = Continuum(size=size, mass=2.7, stiffness=0.31, damping=0.02)
    for omega in (0.0, 1.1, 3.0):
        for point in ((0.9 * size[0], 0.4 * size[1]), (1e-5 * size[0], 0.01 * size[1])):
            if abs(continuum_amplitude(box, omega, point)) > 1e-290:
                assert relative_error(box, omega, point) < TOLERANCE


@pytest.mark.skipif(not EXTENDED, reason="promised for machines with extended precision only")
@pytest.mark.parametrize("damping", [0.0, 1e-9])
@pytest.mark.parametrize("point", [POINT, (0.5, 1 / 3), (1e-6, 0.5), (0.4, 1e-6), (1 - 1e-6, 0.25)])
def test_agrees_with_mpmath_next_to_resonances(damping, point):
    box = Continuum(damping=damping)
    resonances = box.resonances(200)
    for resonance in resonances[[0, 5, len(resonances) // 2, -1]]:
        for distance in (0, 1e-15, -1e-12, 1e-9, -1e-6, 1e-3):
            omega = resonance * (1 + distance)
            assert relative_error(box, omega, point) < TOLERANCE


@pytest.mark.parametrize("distance", [1e-2, 1e-3])
@pytest.mark.parametrize(
    ("omega", "damping"), [(7.0, 0.0), (190.0, 0.0), (25.0, 0.003), (200.0, 1.0)]
)
def test_agrees_with_brute_force_in_the_corners(distance, omega, damping):
    box, x = Continuum(damping=damping), 1 - distance
    # Both sides of where the contour changes its kernel, y = (Lx - x)/10.
    for y in (1e-12, 1e-6, 0.0999 * distance, 0.1001 * distance, distance, 10 * distance):
        exact = brute_force(box, omega, x, y)
        assert abs(box.response(omega, (x, y)) - exact) < TOLERANCE * abs(exact)


def test_static_corner_is_an_arc_tangent():
    """sum sin(nu t)/nu exp(-nu s) = arctan(sin t / sinh s)/2; the wall x = 0 adds a little."""
    box = Continuum()
    for d, y in itertools.product((1e-3, 1e-6, 1e-9), (1e-12, 1e-9, 1e-7, 1e-3)):
        x = 1 - d
        s, t = mp.pi * (1 - mpf(x)), mp.pi * mpf(y)
        exact = 2 / mp.pi * mpmath.atan(mpmath.sin(t) / mpmath.sinh(s))
        for nu in range(1, 22, 2):
            wall = mpmath.sinh(nu * mp.pi * mpf(x)) / mpmath.sinh(nu * mp.pi)
            exact += 4 / mp.pi * mpmath.sin(nu * t) / nu * (wall - mpmath.exp(-nu * s))
        assert abs(box.response(0.0, (x, y)) - float(exact)) < TOLERANCE * abs(exact)


def test_next_to_a_zero_the_error_is_small_against_the_terms():
    box = Continuum(damping=0.0)
    low, high = 100.1935, 100.1937
    assert box.response(low, POINT).real * box.response(high, POINT).real < 0
    while high - low > 1e-10:
        middle = (low + high) / 2
        same = box.response(low, POINT).real * box.response(middle, POINT).real > 0
        low, high = (middle, high) if same else (low, middle)
    exact = continuum_amplitude(box, low, POINT)
    assert abs(exact) < 1e-5
    error = abs(mpmath.mpc(complex(box.response(low, POINT))) - exact)
    assert error < (1e-16 if EXTENDED else 1e-12)


def test_walls():
    box, omega = Continuum(size=(1.5, 0.7)), [0.0, 3.0, 180.0]
    np.testing.assert_allclose(box.response(omega, (1.5, 0.3)), 1, rtol=1e-15)
    for point in ((0, 0.3), (0.4, 0), (0.4, 0.7), (0, 0), (1.5, 0), (1.5, 0.7)):
        np.testing.assert_array_equal(box.response(omega, point), 0)


@pytest.mark.parametrize("x", [0.3, 0.97])
def test_satisfies_the_differential_equation(x):
    box, omega, step = Continuum(size=(1.0, 0.8), damping=0.05), 7.3, 1e-3
    here = box.response(omega, (x, 0.31))
    stencil = {-2: -1 / 12, -1: 4 / 3, 0: -5 / 2, 1: 4 / 3, 2: -1 / 12}  # fourth order
    laplacian = sum(
        c * (box.response(omega, (x + i * step, 0.31)) + box.response(omega, (x, 0.31 + i * step)))
        for i, c in stencil.items()
    )
    left = box.mass * omega**2 * here
    right = (box.stiffness + 1j * omega * box.damping) * laplacian / step**2
    assert abs(left + right) < 1e-6 * abs(left)


def test_mirror_symmetry():
    box, omega = Continuum(size=(1.0, 0.75), damping=0.01), np.linspace(0, 100, 50)
    upper, lower = (box.response(omega, (0.3, y)) for y in (0.625, 0.125))
    np.testing.assert_array_equal(upper, lower)


def test_scaling():
    omega = np.linspace(0.1, 60, 200)
    plain = Continuum(damping=0.02).response(omega, POINT)
    stiff = Continuum(stiffness=9, damping=3 * 0.02).response(3 * omega, POINT)
    heavy = Continuum(mass=7, stiffness=7, damping=7 * 0.02).response(omega, POINT)
    large = Continuum(size=(3, 3), stiffness=9, damping=9 * 0.02)
    np.testing.assert_allclose(stiff, plain, rtol=1e-12)
    np.testing.assert_allclose(heavy, plain, rtol=1e-12)
    point = tuple(3 * s for s in POINT)
    np.testing.assert_allclose(large.response(omega, point), plain, rtol=1e-12)


def test_frequencies_do_not_influence_one_another():
    box, omega = Continuum(), np.linspace(0.01, 200, 301)
    alone = [box.response(w, POINT) for w in omega]
    np.testing.assert_allclose(box.response(omega, POINT), alone, rtol=1e-15)
    assert box.response(omega.reshape(7, 43), POINT).shape == (7, 43)
    assert box.response([], POINT).shape == (0,)


def test_a_long_box_neither_overflows_nor_warns():
    box = Continuum(size=(500.0, 1.0), damping=0.0)
    with np.errstate(all="raise", under="ignore"):
        faint = box.response([0.0, 1.0, 5.0], (0.5, 0.5))
    assert np.all(np.isfinite(faint))
    assert faint[0] == 0  # exp(-499.5 pi), below any double
    assert abs(faint[2]) > 1e-3  # above the cut-off frequency pi the wave passes


def uniform_lattice(box, n, omega, x, y):
    """Amplitude of the n x n lattice of uniform bonds that the box is the limit of (its solution
    by separation of variables), spacing 1/(n+1), at the ball at (x, y)."""
    stiffness, damping = box.stiffness * (n + 1) ** 2, box.damping * (n + 1) ** 2
    i, j = round(x * (n + 1)), round(y * (n + 1))
    assert (i / (n + 1), j / (n + 1)) == (x, y)
    angle = np.arange(1, n + 1) * np.pi / (n + 1)
    weight = 2 / (n + 1) * np.sin(np.outer(angle, np.arange(1, n + 1))).sum(axis=1)
    drive = box.mass * omega**2 / (stiffness + 1j * omega * damping)
    alpha = np.arccosh(2 - np.cos(angle) - drive / 2)
    ratio = np.exp(-alpha * (n + 1 - i)) * np.expm1(-2 * alpha * i) / np.expm1(-2 * alpha * (n + 1))
    return np.sum(weight * np.sin(angle * j) * ratio)


@pytest.mark.parametrize("damping", [0.0, 0.003, 0.3])
@pytest.mark.parametrize("omega", [0.0, 2.0, 5.5, 8.0])
@pytest.mark.parametrize("point", [(0.45, 0.55), (0.2, 0.85)])
def test_the_uniform_lattice_converges_at_second_order(damping, omega, point):
    box = Continuum(damping=damping)
    limit = box.response(omega, point)
    errors = [abs(uniform_lattice(box, n - 1, omega, *point) - limit) for n in (20, 40, 80, 160)]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert np.mean(orders) == pytest.approx(2, abs=0.05)
    assert orders[-1] == pytest.approx(2, abs=0.02)


def test_peaks_stand_at_the_driven_resonances_only():
    box = Continuum(damping=1e-4)
    driven, every = box.resonances(15), box.eigenvalues(15)
    grid = np.linspace(1, 15, 28001)
    amplitude = np.abs(box.response(grid, (0.43, 0.38)))
    peaks = grid[1:-1][(amplitude[1:-1] > amplitude[:-2]) & (amplitude[1:-1] > amplitude[2:])]
    np.testing.assert_allclose(peaks, np.unique(driven), rtol=2e-4)
    assert len(np.setdiff1d(every, driven)) > 0


def test_undamped_amplitude_is_a_simple_pole_at_a_resonance():
    box = Continuum(damping=0.0)
    resonance = box.resonances(10)[1]
    below, above = (box.response(resonance * (1 + s * 1e-9), POINT) for s in (-1, 1))
    assert above == pytest.approx(-below, rel=1e-6)
    assert abs(above) > 1e6
    assert 1e12 < abs(box.response(resonance, POINT)) < np.inf


@pytest.mark.parametrize(("method", "stride"), [("resonances", 2), ("eigenvalues", 1)])
def test_mode_frequencies(method, stride):
    box = Continuum(size=(1.5, 0.7), mass=2.0, stiffness=0.3)
    expected = sorted(
        np.pi * np.sqrt(0.15 * ((n1 / 1.5) ** 2 + (n2 / 0.7) ** 2))
        for n1 in range(1, 60)
        for n2 in range(1, 60, stride)
    )
    found = getattr(box, method)(20.0)
    np.testing.assert_allclose(found, [w for w in expected if w <= 20], rtol=1e-14)
    assert np.all(np.diff(found) >= 0)
    assert getattr(box, method)(0.0).size == 0


def test_lowest_modes_of_the_unit_box():
    box, top = Continuum(), np.pi * np.sqrt(10.5)
    np.testing.assert_allclose(box.resonances(top), np.pi * np.sqrt([2, 5, 10, 10]))
    np.testing.assert_allclose(box.eigenvalues(top), np.pi * np.sqrt([2, 5, 5, 8, 10, 10]))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("size", (1.0, 0.0)),
        ("size", (-1.0, 1.0)),
        ("size", (1.0, np.nan)),
        ("size", (1.0,)),
        ("size", (1.0, 1e-200)),
        ("mass", 0.0),
        ("mass", np.inf),
        ("stiffness", -1.0),
        ("damping", -1e-9),
        ("damping", np.nan),
    ],
)
def test_impossible_boxes_are_refused(name, value):
    with pytest.raises(InputError, match=rf"^continuum_{name}: "):
        Continuum(**{name: value})


@pytest.mark.parametrize(
    "point", [(1.1, 0.5), (0.5, -1e-9), (np.nan, 0.5), (0.5,), (0.1, 0.2, 0.3)]
)
def test_points_outside_the_box_are_refused(point):
    with pytest.raises(InputError, match=r"^continuum_point: "):
        Continuum().response(1.0, point)


@pytest.mark.parametrize("omega", [-1.0, np.nan, np.inf, 1.01 * np.pi * HALF_WAVES, 1e300])
def test_impossible_frequencies_are_refused(omega):
    box = Continuum(damping=0.0)
    for function in (lambda w: box.response([1.0, w], POINT), box.resonances, box.eigenvalues):
        with pytest.raises(InputError, match=r"^omega: "):
            function(omega)


def test_needs_neither_petsc_nor_mpi():
    code = (
        "import sys, pgran.physics.continuum as c; print({'petsc4py', 'mpi4py'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["set()"]
