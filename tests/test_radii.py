"""Derivatives by the radii of all balls of a packing, against packings at rest."""

import dataclasses
import functools

import numpy as np
import pytest
from packing_samples import pushes
from scipy.sparse import csr_matrix, diags, identity
from scipy.sparse.linalg import splu
from sensitivity_samples import heated
from small import OPTIONS

from pgran.experiments.sensitivity.growth import Packing
from pgran.experiments.sensitivity.radii import Radii, Static
from pgran.medium.network_file import read_network

CASES = {  # file, what is otherwise, detector, a ball that grows, steps in mean overlaps
    "hertz": ("spheres", {}, 78, 100, (1e-3, 1e-4, 1e-5)),
    "normal": ("spheres", {"damped": "normal"}, 78, 100, (1e-3, 1e-4)),
    "scalar": ("spheres", {"displacement": "scalar"}, 78, 100, (1e-3, 1e-4)),
    "harmonic": ("discs", {}, 150, 30, (1e-3,)),
}


@functools.cache
def medium(name):
    """A packing of `options`, and its detector, by the name of a case."""
    file, others, detector, *_ = CASES[name]
    return read_network(OPTIONS / "packings" / f"{file}.h5", **others), detector


def stiffness(network, s=0.0):
    """K + s C of mass-weighted unknowns."""
    springs = network.springs
    return (springs.B.T @ diags(springs.constants + s * network.damping * springs.damped)
            @ springs.B).tocsc()  # fmt: skip


def rest(net, ball, size):
    """The network after a ball has grown, none of whose contacts opens, by Newton's method."""
    (i, j), radius, away = net.bond.T, net.radius.copy(), net.normal * net.distance[:, None]
    radius[ball] += size
    bent = [(r[i] * r[j] / (r[i] + r[j])) ** (net.power - 1) for r in (net.radius, radius)]
    c = net.force / net.overlap**net.power * bent[1] / bent[0]
    gap = net.overlap + size * np.any(net.bond == ball, axis=1)
    now, u = net, np.zeros(net.position.shape)
    for _ in range(9):
        moved = u[j] - u[i]
        d = np.linalg.norm(away + moved, axis=1)
        h = gap - np.sum((2 * away + moved) * moved, axis=1) / (d + net.distance)
        assert h.min() > 0
        F, n = c * h**net.power, (away + moved) / d[:, None]
        now = dataclasses.replace(net, force=F, stiffness=net.power * F / h, normal=n, distance=d)
        left = (pushes(now) - pushes(net))[net.free]
        if np.abs(left).max() < 1e-14 * F.mean():
            break
        solid = dataclasses.replace(now, displacement="vector", direction=None)
        weights = solid.weights.reshape(left.shape)
        u[net.free] += weights * splu(stiffness(solid)).solve((weights * left).ravel()).reshape(
            left.shape
        )
    return now


def states(network, s, detector):
    """Amplitudes and adjoint of all unknowns, and what the detector reads."""
    springs = network.springs
    kappa = springs.constants + s * network.damping * springs.damped
    S = splu(stiffness(network, s) + s * s * network.mass * identity(network.size, format="csc"))
    (place,), (reading,) = network.readings(network.sites(detector))
    unit = np.zeros(network.size, complex)
    unit[place] = reading
    A = S.solve(-springs.B.T @ (kappa * springs.drive))
    return A, S.solve(unit), unit @ A


@functools.cache
def derived(name):
    """The derivatives by all radii of a case with exact fields: Radii, its arguments, values."""
    net, detector = medium(name)
    s, radii = 0.4j * net.omega_mx, Radii(net, least=1e-3)
    fields = np.stack(states(net, s, [detector])[:2])
    return radii, (s, fields), radii.derivatives(s, fields, np.zeros(2))


@functools.cache
def central(name, ball, part):
    """The derivative by a ball's radius, by differences of two rests."""
    net, detector = medium(name)
    size = part * net.overlap.mean()
    networks = [rest(net, ball, x) for x in (size, -size)]
    ends = [states(network, 0.4j * net.omega_mx, [detector])[-1] for network in networks]
    return (ends[0] - ends[1]) / (2 * size)


@pytest.mark.parametrize("name", CASES)
def test_derivatives_by_radii_are_those_of_packings_at_rest(name):
    """To 1e-6, and to the second order of the growth."""
    (net, _), (*_, ball, parts) = medium(name), CASES[name]
    _, _, (values, bounds) = derived(name)
    assert np.all(bounds < 1e-7 * np.abs(values).max())
    right = values[0, np.searchsorted(net.free, ball)]
    errors = [abs(central(name, ball, part) - right) / abs(right) for part in parts]
    assert errors[-1] <= 1e-6
    assert len(parts) == 1 or 0.008 < errors[1] / errors[0] < 0.012


def test_derivatives_by_any_radius_are_of_second_order():
    """Against exact changes, whose contacts may open and close."""
    net, detector = medium("hertz")
    _, (s, _), (values, _) = derived("hertz")
    packing, places = Packing(net), np.random.default_rng(2).choice(len(net.free), 6, replace=False)
    errors = []
    for part in (1e-3, 1e-4):
        size = part * net.overlap.mean()
        for place in places:
            ends = [packing.grown(net.free[place], x).network for x in (size, -size)]
            larger, smaller = (states(network, s, [detector])[-1] for network in ends)
            slope = (larger - smaller) / (2 * size)
            errors.append(abs(slope - values[0, place]) / abs(values[0, place]))
    ratios = np.divide(errors[6:], errors[:6])
    assert 0.009 < np.median(ratios) < 0.011
    assert max(errors[6:]) < 1e-5


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
    at, right = np.searchsorted(net.free, 100), central("hertz", 100, 1e-5)
    assert abs(others[0, at] - right) > 3e-5 * abs(right)
    assert abs(values[0, at] - right) < 1e-6 * abs(right)


@pytest.mark.parametrize("relax", [True, False])
@pytest.mark.parametrize("size", [1e-3, 1e-6, 1e-9])
@pytest.mark.parametrize("name", ["hertz", "scalar", "normal"])
def test_bounds_of_derivatives_hold(name, size, relax):
    """Where the field and the adjoint are off, by so much."""
    _, (s, fields), _ = derived(name)
    radii = derived(name)[0]
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
    found = heated(net, [s.imag], [detector], radius=size, balls=[200, 100])
    assert found.ball.tolist() == [100, 200]
    assert found.outcome.tolist() == ["smooth", "smooth"]
    right = [states(rest(net, ball, size), s, [detector])[-1] for ball in found.ball]
    errors = np.abs(found.warmed[0, 0] - right)
    assert np.all(errors <= found.warmed_bound[0, 0] + 1e-11 * np.abs(right))
    assert np.all(found.warmed_bound <= 1e-6 * np.abs(found.warmed))
    values, bounds = derived("hertz")[2]
    error = np.abs(found.by_radius[0] - values)
    assert np.all(error <= found.by_radius_bound[0] + bounds)
    assert found.by_radius_bound.max() <= 1e-3 * np.abs(values).max()
    still = heated(net, [s.imag], [detector], radius=size, balls=[200, 100], relax=False)
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
