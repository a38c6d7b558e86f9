"""Green's functions: symmetry, energy, sum rules, closed forms; test_guarantees.py has bounds."""

import numpy as np
import pytest
from network_samples import NetworkReference
from reference import uniform_frequencies
from samples import random_lattice, uniform_lattice
from sensitivity_samples import packing

import pgran
from pgran.experiments.green.scene import SCENE
from pgran.medium.base import record_of
from pgran.run.crew import Crew
from pgran.store.record import Result


@pytest.mark.parametrize("kind", ["scalar", "vector", "rotations"])
def test_unequal_masses_symmetry_and_losses(kind):
    """Against a dense inverse; what a force puts in is what all dashpots take, to every digit."""
    network = packing(kind, damping=0.2)
    balls, omega = network.free, 0.7
    direction = "drive" if kind == "scalar" else (0.6, -0.8)
    found = pgran.green(network, [omega], balls, direction=direction)
    reference = NetworkReference(network)
    inverse = np.linalg.inv(reference.system(1j * omega).astype(complex))
    places = np.searchsorted(network.free, balls)[:, None] * network.components
    forces = np.zeros((len(balls), network.size))
    forces[np.arange(3)[:, None], places + np.arange(network.axes)] = found.direction
    fields = forces @ inverse
    exact = fields @ forces.T
    assert np.all(np.abs(found.green[0] - exact) <= found.error_bound[0] + 1e-13)
    assert np.all(found.error_bound < 1e-9 * np.abs(found.green))
    assert found.green[0] == pytest.approx(found.green[0].T, rel=1e-13)
    C = network.damping * reference.C.astype(float)
    losses = 0.5 * omega**2 * np.einsum("pi,ij,pj->p", fields.conj(), C, fields).real
    assert found.power[0] == pytest.approx(losses, rel=1e-12)
    assert np.all(found.local_density > 0)
    assert found.mass == pytest.approx(network.masses[balls])


def test_a_density_integrates_to_1_but_for_a_tail():
    """Up to W it is 1 - 2 C_pp / (pi m W) + O(W^-3); C_pp = 4 beta of a ball with four bonds."""
    lattice = random_lattice((4, 4), 2, damping=0.3, mass=2.0)
    nodes, weights = np.polynomial.legendre.leggauss(24)
    missed = []
    for top in (20.0, 40.0):
        edges = np.concatenate([np.linspace(0, 1.2, 7), np.geomspace(2.4, top, 5)])
        half = np.diff(edges)[:, None] / 2
        omegas = (edges[:-1, None] + half * (nodes + 1)).ravel()
        found = pgran.green(lattice, omegas, [(1, 2)])
        integral = (half * weights).ravel() @ found.local_density[:, 0]
        missed.append(integral - 1 + 2 * 1.2 / (np.pi * 2.0 * top))
    assert abs(missed[0]) < 1e-4
    assert missed[0] / missed[1] == pytest.approx(8, rel=0.02)


def test_the_response_to_the_wall_is_that_to_forces():
    """A_d = sum over the driven bonds of (k + i omega beta) G_dp."""
    lattice, omegas = random_lattice((5, 4), 6, damping=0.01), np.array([0.2, 0.5, 1.5])
    wall, detectors = [(4, j) for j in range(4)], [(1, 2), (3, 0)]
    found = pgran.green(lattice, omegas, wall, detectors)
    forces = lattice.stiffness[0][-1] + 1j * omegas[:, None] * lattice.damping
    swept = pgran.sweep(lattice, omegas, detectors, method="points", error_tolerance=1e-10)
    total = np.einsum("wdp,wp->wd", found.green, forces)
    assert total == pytest.approx(swept.displacement, rel=1e-10)


def test_closed_forms_of_uniform_media():
    """A chain, along which G falls by 40 orders; all balls together have the modes' density."""
    k, beta, m, n = 0.25, 0.01, 2.0, 40
    omegas = np.array([0.1, 0.5, 1.2])
    found = pgran.green(uniform_lattice((n,), k, beta, m), omegas, [0, 17], [0, 5, 17, 39])
    stiff = (k + 1j * omegas * beta)[:, None, None]
    alpha = np.arccosh(1 - m * omegas[:, None, None] ** 2 / (2 * stiff))
    low, high = (f.outer([0, 5, 17, 39], [0, 17]) for f in (np.minimum, np.maximum))
    exact = np.sinh(alpha * (low + 1)) * np.sinh(alpha * (n - high))
    exact /= stiff * np.sinh(alpha) * np.sinh(alpha * (n + 1))
    assert np.abs(exact).min() < 1e-38
    assert found.green == pytest.approx(exact, rel=1e-10, abs=0)
    assert np.all(found.error_bound < 1e-5 * np.abs(found.green))
    shape = (4, 3)
    box = pgran.green(uniform_lattice(shape, k, beta, m), omegas, [*np.ndindex(shape)])
    modes = uniform_frequencies(shape, k, m)
    width = beta / k * modes**2  # C is K beta / k
    peaks = width * omegas[:, None] ** 2
    peaks /= (modes**2 - omegas[:, None] ** 2) ** 2 + (width * omegas[:, None]) ** 2
    assert box.local_density.sum(axis=1) == pytest.approx(2 / np.pi * peaks.sum(axis=1), rel=1e-11)


@pytest.mark.parametrize("damping", [0.0, 0.02])
def test_ranks_that_share_a_lattice(world, damping):
    """More pairs than a block has columns; undamped, only one rank alone can count eigenvalues."""
    lattice, sites = random_lattice((7, 5), 4, damping), [*np.ndindex(7, 5)]
    with Crew(world, world.size) as crew:
        found = world.bcast(pgran.green(lattice, [0.4, 2.0], sites, [(1, 2)], crew))
        alone = pgran.green(lattice, [0.4, 2.0], [(1, 2)], sites)
    assert found.green[:, 0] == pytest.approx(alone.green[:, :, 0], rel=1e-9)
    bounded = damping > 0 or world.size == 1
    assert np.isfinite(found.error_bound).all() == bounded
    assert found.failures == (not bounded)  # above the highest mode there is a bound always
    said = " ".join(SCENE.summary(Result([record_of(lattice), found])))
    assert ("1 of 2 frequencies failed" in said) != bounded


def test_nothing_is_good_at_a_resonance_because_a_residual_is_small():
    """Undamped, S is singular but for rounding: G is wrong by orders, or of the other sign."""
    for seed in range(6):
        lattice = random_lattice((6,), seed, damping=0.0)
        omega = pgran.find_modes(lattice, method="dense").omega[seed]
        found = pgran.green(lattice, [0.99 * omega, omega, omega * (1 + 1e-14)], [0, 3])
        assert np.all(found.backward_error < 1e-12)
        assert list(found.converged_reason > 0) == [True, False, False]


def test_what_misses_its_accuracy_is_marked(solver_options):
    """Beyond all digits, unless a floor lets displacements pass; where a solver gets nowhere."""
    lattice, choices = random_lattice((5, 4), 1), {"error_tolerance": 1e-16, "error_floor": 1e-9}
    found = pgran.green(lattice, [0.3], [1, 2], **choices)
    assert found.at_floor.tolist() == [[[1]]]
    assert not found.failures
    assert pgran.green(lattice, [0.3], [1, 2], **choices | {"error_floor": 0.0}).failures == 1
    solver_options("-steady_ksp_type preonly -steady_pc_type jacobi")
    found = pgran.green(lattice, [0.3], [1, 2])
    assert found.failures == 1
    said = " ".join(SCENE.summary(Result([record_of(lattice), found])))
    assert "1 of 1 frequencies failed" in said


NETWORK = packing("vector")
LATTICE = random_lattice((4, 3))
REFUSED = [
    (LATTICE, [4, 3], {}, r"green_sources: ball \(4, 3\) is outside"),
    (LATTICE, [1, 1], {"receivers": [1]}, "green_receivers: needs 2 indices"),
    (LATTICE, [1, 1], {"direction": "x"}, "balls of this medium have one displacement"),
    *((NETWORK, NETWORK.free[:1], {"direction": along}, "drive, x, y, or 2 components")
      for along in ("z", "1,2,3", "up", (0.0, 0.0), [[1.0, 0.0]])),
]  # fmt: skip


@pytest.mark.parametrize(("medium", "sources", "choices", "said"), REFUSED)
def test_what_is_refused(medium, sources, choices, said):
    with pytest.raises(pgran.InputError, match=said):
        pgran.green(medium, [0.3], sources, **choices)
