"""Balls that grow in a packing: what it does, what is a load, and what is refused."""

import dataclasses
import functools

import numpy as np
import pytest
from packing_samples import cells
from sensitivity_samples import assert_same_on_ranks, heated, packing
from small import OPTIONS

from pgran import InputError, pack, with_source
from pgran.balance.equilibrium import NotBalancedError
from pgran.experiments.sensitivity import growth
from pgran.experiments.sensitivity.growth import Packing
from pgran.experiments.sensitivity.heat import summary
from pgran.experiments.sensitivity.record import OUTCOMES
from pgran.medium.network_file import read_network
from pgran.run.experiment import Caution


@functools.cache
def spheres():
    """The packing of `options`, and a detector."""
    return read_network(OPTIONS / "packings" / "spheres.h5"), 78


def test_what_a_packing_does(monkeypatch):
    """One returns when the ball shrinks again, others do not, or fall apart."""
    net, _ = spheres()
    packing, size, grow = Packing(net), 0.3 * net.overlap.mean(), growth.grown
    grown = [packing.grown(ball, size) for ball in (184, 285)]
    assert [OUTCOMES[found.outcome] for found in grown] == ["opened or closed", "rearranged"]
    assert (grown[0].opened, grown[0].closed) == (0, 3)
    assert all(found.balance < 1e-12 for found in grown)
    back = packing.grown(184, 0.0)
    assert OUTCOMES[back.outcome] == "smooth"
    assert np.allclose(back.network.overlap, net.overlap, rtol=1e-9, atol=0)

    def unless(fails):  # balls find no rest where it does
        def grown(balls, contacts, radius, *step):
            tried.append(step)
            if fails(radius[184] < balls.radius[184], step):
                raise NotBalancedError("no rest")
            return grow(balls, contacts, radius, *step)

        return grown

    for fails, outcome in (
        (lambda shrinks, step: step == (np.inf,), "opened or closed"),
        (lambda shrinks, step: shrinks, "rearranged"),
    ):
        tried = []
        monkeypatch.setattr(growth, "grown", unless(fails))
        assert OUTCOMES[packing.grown(184, size).outcome] == outcome
        assert tried == [(), (np.inf,), (growth.GROWTH,)]


def test_forces_that_do_not_balance_are_a_load(caplog):
    """It is said, and a packing stays where it is while no ball grows."""
    net, detector = spheres()
    force = net.force * np.where(np.arange(net.bonds) == 5, 2, 1)
    loaded = dataclasses.replace(net, force=force, stiffness=net.stiffness * force / net.force)
    found = heated(loaded, [0.3], [detector], radius=0.0, balls=[100])
    assert abs(found.warmed[0, 0, 0] - found.displacement[0, 0]) <= 1e-10
    assert f"leave {net.force[5] / force.mean():.1e} of the mean one unbalanced" in caplog.text


def test_any_number_of_ranks(world):
    net, detector = spheres()
    choices = {"radius": 3e-4, "balls": net.free[[3, 50, 90]]}
    names = "warmed", "by_radius", "displacement"
    assert_same_on_ranks(world, heated, net, [0.3], [detector], names, **choices)


@pytest.mark.parametrize("why", [NotBalancedError, InputError])
def test_packings_without_rest_are_counted(monkeypatch, why):
    """Their amplitudes are not known, and the summary says so first; or the box is too narrow."""
    net, detector = spheres()
    grown = growth.grown

    def lost(balls, contacts, radius, *step):
        if radius[100] != net.radius[100]:
            raise why("no rest")
        return grown(balls, contacts, radius, *step)

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


def test_bounds_hold_what_a_balance_leaves():
    """A disc that grows between three alike stays where it is: S = 3/2 (k - F/d) + 3 s beta + s^2.

    At the resonance its amplitude turns by what the overlap rounds, a part of 1e-12, times Q.
    """
    network = cells(1e-5, power=1.5, damping=1e-7)
    h, d = (np.longdouble(x[0]) for x in (network.overlap, network.distance))
    for dR in np.longdouble([1e-7, 3e-7, 2e-6]):
        F = np.sqrt((1 + 2 * dR) / (1 + dR)) * (h + dR) ** 1.5  # R grows, of 1/2 both
        K = 1.5 * (1.5 * F / (h + dR) - F / d)
        s = 1j * np.sqrt(float(K))
        exact = (1.5 * F / (h + dR) + s * 1e-7) / (K + 3e-7 * s + s**2)
        found = heated(network, [s.imag], [0], radius=float(dR), balls=[0])
        bound = found.warmed_bound[0, 0, 0]
        assert abs(found.warmed[0, 0, 0] - exact) <= bound < 1e-5 * abs(exact)


def test_packings_that_float_have_bounds_too():
    """Whichever of their balls is kept in place."""
    net = pack(40, pressure=1e-3)
    order = np.random.default_rng(1).permutation(len(net.held))  # new numbers of balls
    old = np.argsort(order)
    other = dataclasses.replace(
        net, bond=order[net.bond], held=net.held[old], masses=net.masses[old],
        radius=net.radius[old], position=net.position[old],
    )  # fmt: skip
    found, three = [], net.free[[3, 12, 30]]
    for each, (ball, source, detector) in ((net, three), (other, order[three])):
        pushed = with_source(each, balls=[source], direction="x")
        found.append(heated(pushed, [0.1, 0.3], [detector], radius=1e-5, balls=[ball]))
    bounds = sum(one.warmed_bound for one in found)
    assert np.all(np.abs(found[0].warmed - found[1].warmed) <= bounds)
    assert np.all(bounds < 1e-5 * np.abs(found[0].warmed))


def test_where_rounding_decides_who_bears_forces_nothing_is_known():
    for least, known in ((0.01, True), (1e-15, False)):
        found = heated(cells(0.01, 0.01, least), [0.3], [0], radius=1e-4, balls=[0])
        assert np.isfinite(found.warmed_bound).all() == known


def test_scalar_displacements_with_loss_angles_have_derivatives_by_radii():
    network = dataclasses.replace(cells(0.01), displacement="scalar", direction=None, loss=0.1)
    assert np.isfinite(heated(network, [0.3], [0], radius=1e-4).by_radius_bound).all()


def test_a_detector_that_loses_its_contacts_is_at_rest():
    """One of two discs, each between three held ones, shrinks."""
    found = heated(cells(0.01, 0.01), [0.3], [0, 4], radius=-0.02, balls=[0])
    assert found.opened.tolist() == [3]
    assert found.warmed[0, 0] == found.warmed_bound[0, 0] == 0
    assert np.abs(found.warmed[0, 1, 0] - found.displacement[0, 1]) <= 1e-12


def test_neighbours_are_frozen_where_the_law_is_not_known():
    """The summary says so, and there is no derivative by radii."""
    found = heated(packing("vector"), [0.6], [1], radius=1e-3)
    assert found.by_radius is None
    assert not found.relaxed
    assert any("neighbours frozen" in line for line in summary(found))


def test_contacts_made_anew_have_no_dashpots_of_their_own():
    """Where dashpots differ a packing does not relax; with neighbours frozen they stay."""
    network = dataclasses.replace(cells(0.01, power=1.5), dashpot=[1.0, 2.0, 3.0])
    with pytest.raises(InputError, match=r"dashpot differs.* -heat_relax false keeps neighbours"):
        heated(network, [0.3], [0], radius=1e-6)
    found = heated(network, [0.3], [0], radius=1e-7, relax=False)
    slopes = (found.warmed - found.displacement[..., None]) / found.growth
    assert np.abs(slopes - found.by_radius).max() <= 1e-4 * np.abs(slopes).max()
