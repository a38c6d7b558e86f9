"""Balls that grow in a packing: derivatives by all radii, exact changes, and what is refused."""

import dataclasses
import functools

import numpy as np
import pytest
from scipy.sparse import csr_matrix
from sensitivity_samples import assert_same_on_ranks, heated, packing
from small import OPTIONS

from pgran.balance.equilibrium import NotBalancedError
from pgran.errors import InputError
from pgran.experiments.sensitivity import growth
from pgran.experiments.sensitivity.growth import OUTCOMES, Packing
from pgran.experiments.sensitivity.heat import summary
from pgran.experiments.sensitivity.radii import Radii, Static
from pgran.medium.lattice import Lattice
from pgran.medium.network import Network
from pgran.medium.network_file import read_network
from pgran.run.experiment import Caution

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


class Bodies:
    """A packing in dense matrices, as a reference: its rest, none of whose contacts opens."""

    def __init__(self, network):
        """Take overlaps by forces."""
        self.net, (self.i, self.j) = network, network.bond.T
        self.free = network.held == 0
        self.away = network.normal * network.distance[:, None]
        self.h = network.power * network.force / network.stiffness

    def total(self, vectors):
        total = np.zeros((len(self.free), vectors.shape[1]), vectors.dtype)
        np.add.at(total, self.j, vectors)
        np.add.at(total, self.i, -vectors)
        return total

    def curvature(self, radius):
        one, other = radius[self.i], radius[self.j]
        return (one * other / (one + other)) ** (self.net.power - 1)

    def matrix(self, blocks):
        """The sum over contacts of blocks (contacts, c, c), shape (balls, c, balls, c)."""
        balls, width = len(self.free), blocks.shape[1]
        K = np.zeros((balls, balls, width, width), blocks.dtype)
        for one, other, sign in ((0, 0, 1), (1, 1, 1), (0, 1, -1), (1, 0, -1)):
            ends = self.net.bond.T
            np.add.at(K, (ends[one], ends[other]), sign * blocks)
        return K.transpose(0, 2, 1, 3)

    def solved(self, K, f):
        """The solution for the free balls, zero for the others."""
        width, x = K.shape[1], np.zeros(f.shape, np.result_type(K, f))
        inner = K[self.free][:, :, self.free].reshape(self.free.sum() * width, -1)
        x[self.free] = np.linalg.solve(inner, f[self.free].ravel()).reshape(-1, width)
        return x

    def elastic(self, n, d, k, F):
        """The stiffness of contacts, pre-stress in it."""
        across = np.eye(n.shape[1]) - n[:, :, None] * n[:, None, :]
        return k[:, None, None] * (np.eye(n.shape[1]) - across) - (F / d)[:, None, None] * across

    def rest(self, ball, size):
        """Normals, distances, stiffnesses and forces after a ball has grown, by Newton's method."""
        net, radius = self.net, self.net.radius.copy()
        radius[ball] += size
        c = net.force / self.h**net.power * self.curvature(radius) / self.curvature(net.radius)
        gap = self.h + size * np.any(net.bond == ball, axis=1)
        load, u = self.total(net.force[:, None] * net.normal), np.zeros((len(self.free), 3))
        u = u[:, : self.away.shape[1]]
        for _ in range(9):
            moved = u[self.j] - u[self.i]
            d = np.linalg.norm(self.away + moved, axis=1)
            h = gap - np.sum((2 * self.away + moved) * moved, axis=1) / (d + net.distance)
            assert h.min() > 0
            n, F = (self.away + moved) / d[:, None], c * h**net.power
            k = net.power * F / h
            left = self.total(F[:, None] * n) - load
            if np.abs(left[self.free]).max() < 1e-14 * F.mean():
                break
            u = u + self.solved(self.matrix(self.elastic(n, d, k, F)), left)
        return n, d, k, F

    def fields(self, s, detector, contacts):
        """Amplitudes and adjoint of all balls, what is driven not in them, and the amplitude."""
        net, (n, d, k, F) = self.net, contacts
        if net.displacement == "scalar":
            blocks = (k + s * net.damping)[:, None, None]
        else:
            normal = n[:, :, None] * n[:, None, :]
            dashpots = np.eye(n.shape[1]) if net.damped == "all" else normal
            blocks = self.elastic(n, d, k, F) + s * net.damping * dashpots
        S = self.matrix(blocks + 0j)
        inertia = np.arange(len(self.free))
        for axis in range(S.shape[1]):
            S[inertia, axis, inertia, axis] += s * s * net.masses
        driven = (net.held == 2)[:, None] * net.direction
        reading = np.zeros(driven.shape)
        reading[detector] = net.direction
        A = self.solved(S, -np.einsum("pcqd,qd->pc", S * ~self.free[:, None], driven))
        return A, self.solved(S, reading + 0j), np.sum(reading * A)


@functools.cache
def derived(name):
    """The derivatives by all radii of a case with exact fields: Radii, its arguments, values."""
    net, detector = medium(name)
    s, bodies = 0.4j * net.omega_mx, Bodies(net)
    contacts = net.normal, net.distance, net.stiffness, net.force
    A, z, _ = bodies.fields(s, detector, contacts)
    fields = np.stack([x[net.free].ravel() / net.weights for x in (A, z)])
    radii = Radii(net, least=1e-3)
    return radii, (s, fields), radii.derivatives(s, fields, np.zeros(2))


@functools.cache
def central(name, ball, part):
    """The derivative by a ball's radius, by differences of two rests."""
    net, detector = medium(name)
    s, bodies = 0.4j * net.omega_mx, Bodies(net)
    size = part * bodies.h.mean()
    ends = [bodies.fields(s, detector, bodies.rest(ball, x))[-1] for x in (size, -size)]
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
    print(
        "RATIO",
        np.median(bound) / np.median(error),
        bound.max() / np.median(error),
        np.median(bound) / np.abs(right).max(),
    )
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


# Exact changes


def test_what_a_packing_does(monkeypatch):
    """One returns when the ball shrinks again, others do not, or fall apart."""
    net, _ = medium("hertz")
    packing, size = Packing(net), 0.3 * net.overlap.mean()
    grown = [packing.grown(ball, size) for ball in (184, 285)]
    assert [OUTCOMES[found.outcome] for found in grown] == ["opened or closed", "rearranged"]
    assert (grown[0].opened, grown[0].closed) == (0, 3)
    assert all(found.balance < 1e-12 for found in grown)
    back = packing.grown(184, 0.0)
    assert OUTCOMES[back.outcome] == "smooth"
    assert np.allclose(back.network.overlap, net.overlap, rtol=1e-9, atol=0)
    grow = growth.grown

    def falls_apart(balls, contacts, radius):
        if radius[184] < balls.radius[184]:
            raise NotBalancedError("no rest")
        return grow(balls, contacts, radius)

    monkeypatch.setattr(growth, "grown", falls_apart)
    assert OUTCOMES[packing.grown(184, size).outcome] == "rearranged"


def test_forces_that_do_not_balance_are_a_load(caplog):
    """It is said, and a packing stays where it is while no ball grows."""
    net, detector = medium("hertz")
    force = net.force * np.where(np.arange(net.bonds) == 5, 2, 1)
    loaded = dataclasses.replace(net, force=force, stiffness=net.stiffness * force / net.force)
    found = heated(loaded, [0.3], [detector], radius=0.0, balls=[100])
    assert abs(found.warmed[0, 0, 0] - found.displacement[0, 0]) <= 1e-10
    assert f"leave {net.force[5] / force.mean():.1e} of the mean one unbalanced" in caplog.text


def test_heat_of_a_packing():
    """Amplitudes are those of the packing at rest; `heat` differentiates as is tested above."""
    net, detector = medium("hertz")
    s, bodies = 0.4j * net.omega_mx, Bodies(net)
    size = 1e-3 * bodies.h.mean()
    found = heated(net, [s.imag], [detector], radius=size, balls=[200, 100])
    assert found.ball.tolist() == [100, 200]
    assert found.outcome.tolist() == ["smooth", "smooth"]
    right = [bodies.fields(s, detector, bodies.rest(b, size))[-1] for b in found.ball]
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
    assert np.isclose(found.growth_least[0], size / bodies.h[touching].min(), rtol=1e-12)


@pytest.mark.parametrize("name", ["hertz", "scalar"])
def test_heat_with_neighbours_frozen(name):
    """A little growth is the derivative; of kelvins it is a part of each radius."""
    net, detector = medium(name)
    by = {"kelvin": 1e-5 * Bodies(net).h.mean(), "expansion": 0.1, "relax": False}
    found = heated(net, [0.4 * net.omega_mx], [detector], **by)
    assert np.allclose(found.growth, 0.1 * found.kelvin * net.radius[net.free], rtol=1e-13)
    slopes = (found.warmed - found.displacement[..., None]) / found.growth
    assert np.abs(slopes - found.by_radius).max() <= 1e-4 * np.abs(slopes).max()
    assert not found.relaxed
    same = heated(net, [0.4 * net.omega_mx], [detector], radius=1e-3, relax=False, balls=[100])
    other = heated(net, [0.4 * net.omega_mx], [detector], overlap=1e-3, balls=[100])
    assert np.allclose(same.warmed, other.warmed, rtol=1e-12, atol=0)


def test_any_number_of_ranks(world):
    net, detector = medium("hertz")
    choices = {"radius": 3e-4, "balls": net.free[[3, 50, 90]]}
    names = "warmed", "by_radius", "displacement"
    assert_same_on_ranks(world, heated, net, [0.3], [detector], names, **choices)


def test_packings_without_rest_are_counted(monkeypatch):
    """Their amplitudes are not known, and the summary says so first."""
    net, detector = medium("hertz")
    grown = growth.grown

    def lost(balls, contacts, radius):
        if radius[100] != net.radius[100]:
            raise NotBalancedError("no rest")
        return grown(balls, contacts, radius)

    monkeypatch.setattr(growth, "grown", lost)
    found = heated(net, [0.3], [detector], radius=5e-3, balls=[100, 200])
    assert found.failures == 1
    assert found.outcome[0] == "not balanced"
    assert np.isnan(found.warmed[0, 0, 0])
    assert np.isinf(found.warmed_bound[0, 0, 0])
    assert np.isfinite(found.warmed[0, 0, 1])
    cautions = [line for line in summary(found) if isinstance(line, Caution)]
    assert "1 of 2 packings found no rest" in cautions[0]
    assert "grow by 0.391 of the mean overlap" in cautions[1]


def test_a_detector_that_loses_its_contacts_is_at_rest():
    """One of two discs, each between three held ones, shrinks."""
    angles = 2 * np.pi * np.arange(3) / 3
    cell = np.append(np.zeros((1, 2)), 0.99 * np.stack([np.cos(angles), np.sin(angles)], axis=1), 0)
    bond = np.array([[0, 1], [0, 2], [0, 3]])
    network = Network(
        np.append(bond, bond + 4, axis=0), np.ones(6), [0, 2, 1, 1, 0, 2, 1, 1], damping=0.1,
        displacement="vector", position=np.append(cell, cell + 10, axis=0),
        force=np.full(6, 0.01), radius=np.full(8, 0.5), power=1.0,
    )  # fmt: skip
    found = heated(network, [0.3], [0, 4], radius=-0.02, balls=[0])
    assert found.opened.tolist() == [3]
    assert found.warmed[0, 0] == found.warmed_bound[0, 0] == 0
    assert np.abs(found.warmed[0, 1, 0] - found.displacement[0, 1]) <= 1e-12


# What is refused

REFUSED = {
    "lattice": (Lattice((np.ones(3),), 1.0, 0.1), {"radius": 0.1}, "of a network"),
    "rotations": (packing("rotations", power=1.0), {"relax": True}, "balls that turn .* false"),
    "rubbing": (packing("vector", power=1.0, radius=np.ones(5)), {"relax": True}, "friction"),
    "law": (packing("vector"), {"relax": True}, "does not know its contact law"),
    "radii": (packing("vector"), {"radius": None, "kelvin": 1.0}, "-heat_kelvin: .* not known"),
    "too small": (packing("vector", radius=np.ones(5)), {"radius": -1.0}, "no radius left"),
    "both": (packing("vector"), {"kelvin": 1.0}, "one of these ways"),
    "relax": (
        packing("vector"),
        {"radius": None, "factor": 2, "relax": True},
        "of balls that grow",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_grow(name):
    network, choices, said = REFUSED[name]
    with pytest.raises(InputError, match=said) as caught:
        heated(network, [0.3], [1], **{"radius": 0.01} | choices)
    assert "\n" not in str(caught.value)


def test_contacts_that_pull_are_refused():
    net, detector = medium("hertz")
    pulling = dataclasses.replace(net, force=net.force * np.where(np.arange(net.bonds) == 5, -1, 1))
    with pytest.raises(InputError, match="contact 5 bears no repulsive force"):
        heated(pulling, [0.3], [detector], radius=1e-3, relax=True)


def test_neighbours_are_frozen_where_the_law_is_not_known():
    """The summary says so, and there is no derivative by radii."""
    found = heated(packing("vector"), [0.6], [1], radius=1e-3)
    assert found.by_radius is None
    assert not found.relaxed
    assert any("neighbours frozen" in line for line in summary(found))
