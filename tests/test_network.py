"""Any network: its matrices and modes against lattices, energies and elimination."""

import dataclasses
import itertools

import mpmath
import numpy as np
import pytest
from mpmath import mp, mpf
from network_samples import NetworkReference, exact_network_force
from samples import steady

from pgran import InputError, Network, find_modes, pulse, sweep
from pgran.command.resolve import SCENES
from pgran.driven.counting import smallest_damping
from pgran.driven.operators import Operators
from pgran.medium import crystals as makers
from pgran.medium.base import record_of
from pgran.medium.graph import without_floating
from pgran.run.petsc import PETSc
from pgran.store.record import Result


def of_each_kind():
    """Random networks, under pre-stress and with contacts that join the same two balls."""
    for displacement, axes in itertools.product(("scalar", "vector", "rotations"), (2, 3)):
        rng = np.random.default_rng(axes)
        network = makers.random_geometric(40, axes, displacement=displacement, damped="normal")
        count, twice = len(network.bond), rng.integers(0, len(network.bond), 9)
        again = np.append(np.arange(count), twice)
        bond = network.bond[again]
        bond[count:] = bond[count:, ::-1]
        normal = network.normal[again]
        normal[count:] *= -1
        constants = {
            name: rng.standard_normal(len(again)) for name in ("stiffness", "force", "tangential")
        }
        distance = network.distance[again]
        yield dataclasses.replace(network, bond=bond, normal=normal, distance=distance, **constants)


def test_matrices_are_sums_over_springs(world):
    """K x = B^T diag(k) B x, and the magnitudes alike; symmetric to the bit on one rank."""
    for network in of_each_kind():
        springs, k = network.springs, network.springs.constants
        x = np.random.default_rng(1).standard_normal(network.size)
        B = abs(springs.B)
        expected = network.restoring_forces(x[None])[0], B.T @ (np.abs(k) * (B @ x))
        with Operators(network, world) as operators:
            vector = operators.layout.vector(x)
            for matrix, force in zip((operators.K, operators.sizes[0]), expected, strict=True):
                found = operators.layout.field(matrix * vector)
                if world.rank == 0:
                    assert np.abs(found - force).max() <= 1e-13 * np.abs(expected[1]).max()
            if world.size == 1:
                assert operators.K.equal(operators.K.transpose(PETSc.Mat()))


@pytest.mark.parametrize("s", [0.8, 0.8j])
def test_rounding_is_told_from_the_magnitudes_of_all_parts(world, s):
    """|f| + (|K| + |s| beta |C| + |s|^2 m) |x|, by springs; `scale` is no less than their norm."""
    rng = np.random.default_rng(7)
    light = makers.random_geometric(40, 2)
    light = dataclasses.replace(light, masses=rng.uniform(0.1, 10, len(light.held)))
    for network in (light, *of_each_kind()):
        springs, x = network.springs, rng.standard_normal(network.size)
        B, damping = abs(springs.B), abs(s) * network.damping
        parts = np.abs(springs.constants) + damping * springs.damped
        drive = springs.constants + s * network.damping * springs.damped
        least = np.abs(springs.B.T @ (drive * springs.drive))
        most = B.T @ (parts * np.abs(springs.drive))
        matrix = (B.T @ B.multiply(parts[:, None])).toarray()
        matrix += abs(s) ** 2 * network.mass * np.eye(network.size)
        sites = network.free[:1, None]
        with steady(network, sites, world) as (operators, solver):
            solver.solve(s)
            terms = operators.f.duplicate()
            terms.setArray(solver.bounds.rounding(operators.layout.vector(x)))
            found = operators.layout.field(terms)
            assert np.linalg.norm(matrix, 2) <= solver.bounds.scale
            if world.rank == 0:
                room = 1e-12 * np.abs(found).max()
                others = matrix @ np.abs(x)
                assert np.all(found >= least + others - room)
                assert np.all(found <= most + others + room)
            terms.destroy()


# Springs


@pytest.mark.parametrize("axes", [2, 3])
def test_rigid_motions_and_rolling_stretch_nothing(axes):
    """On a random tree of balls of different sizes that touch."""
    rng, count = np.random.default_rng(axes), 12
    radius = rng.uniform(0.3, 2, count)
    position, parent = np.zeros((count, axes)), rng.integers(0, np.arange(1, count))
    for ball, other in enumerate(parent, 1):
        n = rng.standard_normal(axes)
        reach = radius[ball] + radius[other]
        position[ball] = position[other] + reach * n / np.linalg.norm(n)
    bond = np.stack([parent, np.arange(1, count)], axis=1)
    network = Network(
        bond, np.ones(count - 1), np.zeros(count), rng.uniform(0.1, 10, count),
        displacement="rotations", position=position, tangential=np.ones(count - 1), radius=radius
    )  # fmt: skip

    def stretches(u, theta):
        turned = np.broadcast_to(theta, (count, network.turns))
        moved = np.concatenate([np.broadcast_to(u, (count, axes)), turned], axis=1)
        return np.abs(network.springs.B @ (moved.ravel() / network.weights)).max()

    turn = rng.standard_normal(3) if axes == 3 else np.array([0, 0, rng.standard_normal()])
    around = np.cross(turn, np.pad(position, ((0, 0), (0, 3 - axes))))[:, :axes]
    theta = turn[-network.turns :]
    assert stretches(rng.standard_normal(axes), 0) < 1e-14
    assert stretches(around, theta) < 1e-13
    assert stretches(around, 0) > 0.1
    sign = np.ones(count)
    for ball, other in enumerate(parent, 1):
        sign[ball] = -sign[other]
    assert stretches(0, np.outer(sign / radius, theta)) < 1e-14
    assert stretches(0, np.outer(1 / radius, theta)) > 0.1


@pytest.mark.parametrize(("axes", "power"), [(2, 2), (3, 2), (2, 2.5), (3, 2.5)])
def test_stiffness_is_the_second_derivative_of_the_energy(axes, power):
    """Of contacts V = c h^p, h how far two balls overlap: harmonic and Hertz, under pre-stress."""
    rng, c = np.random.default_rng(5), 0.8
    position = rng.uniform(0, 1, (5, axes))
    bond = np.array([[0, 1], [1, 2], [3, 1], [2, 3], [0, 4], [4, 2]])
    distance = np.linalg.norm(position[bond[:, 0]] - position[bond[:, 1]], axis=1)
    overlap = rng.uniform(0.05, 0.3, len(bond))
    masses = 10 ** rng.uniform(-1, 1, 5)
    network = Network(
        bond, c * power * (power - 1) * overlap ** (power - 2), [0, 0, 0, 0, 1], masses,
        displacement="vector", position=position, force=c * power * overlap ** (power - 1)
    )  # fmt: skip
    with mp.workdps(50):
        reach = [mpf(float(d)) + mpf(float(h)) for d, h in zip(distance, overlap, strict=True)]
        start, step = [mpf(float(x)) for x in position.ravel()], mpf(10) ** -12

        def energy(*moved):
            x = list(start)
            for unknown, sign in moved:
                x[unknown] += sign * step
            return sum(
                mpf(c) * (r - mp.sqrt(sum((x[axes * j + a] - x[axes * i + a]) ** 2
                          for a in range(axes)))) ** mpf(power)
                for (i, j), r in zip(bond.tolist(), reach, strict=True)
            )  # fmt: skip

        signs = list(itertools.product((1, -1), repeat=2))
        H = [[float(sum(a * b * energy((p, a), (q, b)) for a, b in signs) / (4 * step**2))
              for p in range(4 * axes)] for q in range(4 * axes)]  # fmt: skip
    found = network.restoring_forces(np.eye(network.size))
    assert network.size == 4 * axes
    expected = np.array(H) * np.outer(network.weights, network.weights)
    assert np.abs(found - expected).max() < 1e-12 * np.abs(expected).max()


# Modes


@pytest.mark.parametrize("kmax", [None, 1e-20, 1e20])
def test_modes_of_unstable_networks_have_negative_frequencies(world, kmax):
    """A force that buckles a chain makes K indefinite; all modes are counted, and said.

    What counts as rounding belongs to the bonds, not to the omega_mx that the user gives.
    """
    chain = makers.square((9, 1), 1.0, force=np.full(8, 0.4), kmax=kmax)
    eigenvalues = np.linalg.eigvalsh(chain.restoring_forces(np.eye(chain.size)))
    modes = find_modes(chain)
    assert modes.count_certified
    assert np.count_nonzero(modes.omega < 0) == 7
    squares = np.sign(modes.omega) * modes.omega**2
    assert np.allclose(squares, eigenvalues, rtol=1e-12, atol=1e-13)
    said = " ".join(SCENES["modes"].summary(Result([record_of(chain), modes])))
    assert "UNSTABLE: 7 modes" in said
    modes = find_modes(chain, interval=(0.1, 3.0))
    assert modes.count_certified
    assert np.allclose(modes.omega**2, eigenvalues[eigenvalues > 0], rtol=1e-12)
    with pytest.raises(InputError, match="unstable"):
        pulse(chain, [3], width=2.0, time=60.0, points=121)
    afloat = find_modes(makers.square((4, 3), 1.0, held=np.zeros(12), kmax=kmax))
    assert np.abs(afloat.omega[0]) < 1e-6
    assert np.all(afloat.omega >= 0)


# Driven networks


def test_errors_along_a_diagonal_do_not_cancel():
    """Where x and y components are alike, a reading along (1, -1) cancels, and errors need not."""
    sample = makers.square(
        (20, 1), lambda u: 0.5 + u / 2, tangential=np.zeros(19),
        direction=(1, -1), damping=0.01
    )  # fmt: skip
    network = Network(
        sample.bond, sample.stiffness, sample.held, damping=0.01, displacement="vector",
        normal=sample.normal, tangential=sample.stiffness, direction=(1, -1)
    )  # fmt: skip
    with mp.workdps(50), steady(network, [1, 2]) as (_, solver):
        reference = NetworkReference(network)
        for omega in np.linspace(3, 12, 10):
            state = solver.solve(1j * omega)
            for found, exact, bound in zip(
                state.displacement,
                reference.amplitudes(1j * omega, [1, 2]),
                state.error_bound,
                strict=True,
            ):
                assert abs(mpmath.mpmathify(complex(found)) - exact) <= bound


@pytest.mark.parametrize("seed", range(8))
def test_a_contact_nearly_across_the_drive(seed):
    """How far it is stretched cancels to a few digits, and what these miss is in the bounds."""
    rng = np.random.default_rng(seed)
    along, across = np.linalg.qr(rng.standard_normal((3, 2)))[0].T
    normal = across + 10 ** -rng.uniform(3, 9) * along
    network = Network(
        [[0, 1]], [1.0], [2, 0], [2.0, 2.0], 0.0, displacement="vector", direction=along,
        normal=[normal / np.linalg.norm(normal)]
    )  # fmt: skip
    with mp.workdps(50):
        reference = NetworkReference(network)
        response = sweep(network, [0.5, 4000.0], [1])
        for n, omega in enumerate(response.omega):
            (exact,) = reference.amplitudes(1j * omega, [1])
            found = mpmath.mpmathify(complex(response.displacement[n, 0]))
            assert abs(found - exact) <= response.error_bound[n, 0]
            force = mpmath.mpmathify(complex(response.force[n]))
            exact = exact_network_force(network, 1j * omega)
            assert abs(force - exact) <= response.force_bound[n]


@pytest.mark.parametrize("damping", [0.01, 0.0])
def test_what_floats_is_never_passed_as_good(world, damping):
    """C is singular; no amplitude without a finite bound is good, and at rest S is singular."""
    triangle = [[0, 1], [2, 3], [3, 4], [4, 2]]
    network = Network(
        triangle, [1, 0.3, 0.7, 0.1], [2, 0, 0, 0, 0], [1, 1, 0.7, 1.3, 1e-3], damping
    )
    with steady(network, [1, 2], world) as (operators, solver):
        assert not damping or smallest_damping(operators.lattice) == 0
        assert solver.solve(0j).converged_reason <= 0
        state = solver.solve(0.3j)
        exact = (1 + 0.3j * damping) / (1 + 0.3j * damping - 0.09)
        errors = np.abs(state.displacement - [exact, 0])
        assert not np.any(errors > state.error_bound)
        assert state.converged_reason <= 0
    anchored, kept = without_floating(network)
    assert kept.tolist() == [0, 1]
    with steady(anchored, [1]) as (_, solver):
        state = solver.solve(0.3j)
    assert state.converged_reason > 0
    assert abs(state.displacement[0] - exact) <= state.error_bound[0]


def test_few_balls_and_many_ranks(world):
    """One ball, two alike contacts, and springs that cancel; some ranks have no ball.

    Of springs without stiffness S is zero altogether at rest.
    """
    for bond, constants, k in (([[0, 1]], [2.0], 2), ([[0, 1], [1, 0]], [1.5, -1], 0.5)):
        network = Network(bond, constants, [2, 0], 1.5, 0.1)
        with steady(network, [1], world, 1e-10) as (_, solver):
            for omega in (0.2, 1.1):
                state = solver.solve(1j * omega)
                drive = k + 0.1j * omega * len(bond)
                exact = drive / (drive - 1.5 * omega**2)
                assert state.converged_reason > 0
                assert abs(state.displacement[0] - exact) <= state.error_bound[0]
    with steady(Network([[0, 1]], [0.0], [2, 0]), [1], world) as (_, solver):
        assert solver.solve(0j).converged_reason <= 0
        assert solver.solve(1j).converged_reason > 0


@pytest.mark.parametrize(
    ("said", "change"),
    [
        ("touches itself", {"bond": [[0, 0]], "normal": [[1, 0]]}),
        ("no contacts", {"bond": np.zeros((0, 2)), "stiffness": []}),
        ("no free ball has", {"held": [1, 2, 0]}),
        ("every ball is held", {"held": [1, 2, 1]}),
        ("no balls", {"bond": [[0, 3]]}),
        ("whole numbers", {"bond": [[0, 1.5]]}),
        ("whole numbers", {"held": [2, 0.5, 0]}),
        ("masses", {"masses": [1, 0, 1]}),
        ("radii", {"radius": [1, 0, 1]}),
        ("finite", {"stiffness": [np.nan]}),
        ("same place", {"position": np.zeros((3, 2))}),
    ],
)
def test_impossible_networks_are_refused(said, change):
    given = {
        "bond": [[0, 1]], "stiffness": [1.0], "held": [2, 0, 0], "displacement": "rotations",
        "position": [[0, 0], [1, 0], [2, 0]], "radius": [1, 1, 1],
    }  # fmt: skip
    Network(**given)
    with pytest.raises(InputError, match=said):
        Network(**(given | change))
