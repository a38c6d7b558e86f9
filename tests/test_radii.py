"""Derivatives by the radii of all balls of a packing, against packings at rest.

The bounds of random packings are in test_guarantees.py ("growing balls").
"""

import dataclasses
import functools

import numpy as np
import pytest
from scipy.sparse import csr_matrix, diags, identity
from scipy.sparse.linalg import splu
from sensitivity_samples import heated
from small import OPTIONS

from pgran.experiments.sensitivity.growth import Packing
from pgran.experiments.sensitivity.radii import Radii, Static
from pgran.medium.network_file import read_network

CASES = {  # file, what is otherwise, detector
    "hertz": ("spheres", {}, 78),
    "normal": ("spheres", {"damped": "normal"}, 78),
    "scalar": ("spheres", {"displacement": "scalar"}, 78),
    "harmonic": ("discs", {}, 150),
}
STEPS = 1e-3, 1e-4  # of the mean overlap


@functools.cache
def medium(name):
    """A packing of `options`, and its detector, by the name of a case."""
    file, others, detector = CASES[name]
    return read_network(OPTIONS / "packings" / f"{file}.h5", **others), detector


def states(network, s, detector):
    """Amplitudes and adjoint of all unknowns, and what the detector reads."""
    springs = network.springs
    kappa = springs.constants + s * network.damping * springs.damped
    inertia = s * s * network.mass * identity(network.size, format="csc")
    S = splu((springs.B.T @ diags(kappa) @ springs.B).tocsc() + inertia)
    (place,), (reading,) = network.readings(network.sites([detector]))
    unit = np.zeros(network.size, complex)
    unit[place] = reading
    A = S.solve(-springs.B.T @ (kappa * springs.drive))
    return A, S.solve(unit), unit @ A


@functools.cache
def derived(name):
    """The derivatives by all radii of a case with exact fields: Radii, its arguments, values."""
    net, detector = medium(name)
    s, radii = 0.4j * net.omega_mx, Radii(net, least=1e-3)
    fields = np.stack(states(net, s, detector)[:2])
    return radii, (s, fields), radii.derivatives(s, fields, np.zeros(2))


@functools.cache
def central(name, ball, part):
    """The derivative by a ball's radius, by differences of two packings at rest."""
    net, detector = medium(name)
    size, packing = part * net.overlap.mean(), Packing(net)
    grown = [packing.grown(ball, x).network for x in (size, -size)]
    larger, smaller = (states(each, 0.4j * net.omega_mx, detector)[-1] for each in grown)
    return (larger - smaller) / (2 * size)


@pytest.mark.parametrize("name", CASES)
def test_derivatives_by_radii_are_those_of_packings_at_rest(name):
    """Of second order in the growth, of which contacts may open and close."""
    net, _ = medium(name)
    _, _, (values, bounds) = derived(name)
    assert np.all(bounds < 1e-7 * np.abs(values).max())
    places = np.random.default_rng(2).choice(len(net.free), 6, replace=False)
    errors = np.array([
        [abs(central(name, net.free[n], part) / values[0, n] - 1) for n in places]
        for part in STEPS
    ])  # fmt: skip
    assert errors[1].max() < 1e-5
    assert np.median(errors[1]) < 1e-6
    assert name == "harmonic" or 0.009 < np.median(errors[1] / errors[0]) < 0.011


@pytest.mark.parametrize("term", ["a_F", "a_d", "a_n", "c", "pre-stress", "equilibrium"])
def test_no_term_of_the_derivative_may_be_left_out(monkeypatch, term):
    net, _ = medium("hertz")
    _, arguments, (values, _) = derived("hertz")
    radii = Radii(net)
    if term == "c":
        radii.curvature = 0 * radii.curvature
    elif term == "pre-stress":  # in the static stiffness
        nothing = csr_matrix((len(net.free), net.bonds))
        radii.static = Static(dataclasses.replace(net, force=None, power=None), 0.0, nothing)
    elif term == "equilibrium":
        radii.relax = False
    else:
        slopes, place = Radii._slopes, ["a_k", "a_F", "a_d", "a_n"].index(term)

        def without(*given):
            return [x * (n != place) for n, x in enumerate(slopes(*given))]

        monkeypatch.setattr(Radii, "_slopes", without)
    others, _ = radii.derivatives(*arguments, np.zeros(2))
    at, right = np.searchsorted(net.free, 100), central("hertz", 100, STEPS[1])
    assert abs(others[0, at] - right) > 3e-5 * abs(right)
    assert abs(values[0, at] - right) < 1e-6 * abs(right)


@pytest.mark.parametrize("relax", [True, False])
@pytest.mark.parametrize("size", [1e-3, 1e-6, 1e-9])
@pytest.mark.parametrize("name", ["hertz", "scalar", "normal"])
def test_bounds_of_derivatives_hold(name, size, relax):
    """Where the field and the adjoint are off, by so much."""
    radii, (s, fields), _ = derived(name)
    if not relax:
        radii = Radii(medium(name)[0], relax=False)
    right, own = radii.derivatives(s, fields, np.zeros(2))
    rng = np.random.default_rng(1)
    noise = rng.standard_normal(fields.shape) + 1j * rng.standard_normal(fields.shape)
    errors = size * np.linalg.norm(fields, axis=1)
    noise *= (errors / np.linalg.norm(noise, axis=1))[:, None]
    found, bound = radii.derivatives(s, fields + noise, errors)
    error = np.abs(found - right)
    assert np.all(error <= bound + own)
    assert np.median(bound) <= 1e5 * np.median(error)  # at random they mostly cancel


def test_work_of_one_ball_on_another_and_back():
    """Betti: how a ball that grows presses on another is as that one presses on it."""
    (net, _), balls = medium("hertz"), (100, 200)
    packing, step = Packing(net), 1e-4 * net.overlap.mean()

    def press(network, ball):  # dE/dR, E = F h / (power + 1) in each contact
        one, other = network.radius[network.bond].T
        pressed, curved = 0.0, (net.power - 1) * np.stack([other / one, one / other])
        for end, by_radius in zip(network.bond.T, curved / (one + other), strict=True):
            own = network.force * (1 + network.overlap * by_radius / (net.power + 1))
            pressed += own[end == ball].sum()
        return pressed

    def pressing(one, other):
        ends = [press(packing.grown(one, x).network, other) for x in (step, -step)]
        return (ends[0] - ends[1]) / (2 * step)

    there, back = pressing(*balls), pressing(*balls[::-1])
    assert abs(there - back) <= 1e-5 * abs(there)


# Exact changes beside them


def test_heat_of_a_packing():
    """Amplitudes are those of the packing at rest; `heat` differentiates as is tested above."""
    net, detector = medium("hertz")
    s, size = 0.4j * net.omega_mx, 1e-3 * net.overlap.mean()
    choices = {"radius": size, "balls": [200, 100]}
    found = heated(net, [s.imag], [detector], **choices)
    assert found.ball.tolist() == [100, 200]
    assert found.outcome.tolist() == ["smooth", "smooth"]
    grown = [Packing(net).grown(ball, size).network for ball in found.ball]
    right = np.array([states(each, s, detector)[-1] for each in grown])
    errors = np.abs(found.warmed[0, 0] - right)
    assert np.all(errors <= found.warmed_bound[0, 0] + 1e-11 * np.abs(right))
    assert np.all(found.warmed_bound <= 1e-6 * np.abs(found.warmed))
    values, bounds = derived("hertz")[2]
    assert np.all(np.abs(found.by_radius[0] - values) <= found.by_radius_bound[0] + bounds)
    assert found.by_radius_bound.max() <= 1e-3 * np.abs(values).max()
    still = heated(net, [s.imag], [detector], relax=False, **choices)
    assert np.array_equal(found.frozen, still.warmed)
    assert np.allclose(found.growth_overlap, 1e-3, rtol=1e-12)
    touching = np.any(net.bond == 100, axis=1)
    assert np.isclose(found.growth_least[0], size / net.overlap[touching].min(), rtol=1e-12)


@pytest.mark.parametrize("name", ["hertz", "scalar"])
def test_heat_with_neighbours_frozen(name):
    """A little growth is the derivative; of kelvins it is a part of each radius."""
    net, detector = medium(name)
    by = {"kelvin": 1e-5 * net.overlap.mean(), "expansion": 0.1, "relax": False}
    found = heated(net, [0.4 * net.omega_mx], [detector], **by)
    assert np.allclose(found.growth, 0.1 * found.kelvin * net.radius[net.free], rtol=1e-13)
    slopes = (found.warmed - found.displacement[..., None]) / found.growth
    assert np.abs(slopes - found.by_radius).max() <= 1e-4 * np.abs(slopes).max()
    assert not found.relaxed
    same = heated(net, [0.4 * net.omega_mx], [detector], radius=1e-3, relax=False, balls=[100])
    other = heated(net, [0.4 * net.omega_mx], [detector], overlap=1e-3, balls=[100])
    assert np.allclose(same.warmed, other.warmed, rtol=1e-12, atol=0)
