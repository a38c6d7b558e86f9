"""The force that drives the wall: its value and bound, its power, its limits, its units."""

import dataclasses

import mpmath
import numpy as np
import pytest
from mpi4py import MPI
from mpmath import mp, mpf
from network_samples import exact_network_force
from petsc4py import PETSc
from reference import DRIVEN, bonds, refined_field
from samples import assert_same, bond_arrays, random_lattice, steady, swept, uniform_lattice

from pgran import Lattice, Network
from pgran.driven.accuracy import Accuracy
from pgran.medium import crystals as makers

DIGITS = 60
LATTICES = [((30,), 0.02), ((5, 6), 3e-4), ((3, 4, 3), 0.03)]


def exact(number):
    return mpmath.mpmathify(complex(number))


def exact_force(lattice, omega):
    """Sum over the driven wall's bonds of (k + i omega beta)(1 - A_p)."""
    A = refined_field(lattice.stiffness, lattice.mass, lattice.damping, omega)
    loss = mpmath.mpc(0, mpf(float(omega)) * mpf(lattice.damping))
    return sum(
        (mpf(float(lattice.stiffness[axis][index])) + loss) * (1 - A[one])
        for axis, index, one, other in bonds(lattice.shape)
        if other is DRIVEN
    )


def power_in_dashpots(medium, response):
    """Half of beta omega^2 |b^T A + w|^2 over all springs, at each frequency of stored fields."""
    scale = medium.weights if isinstance(medium, Network) else 1.0
    moved = medium.stretched(response.field / scale, np.ones(len(response.omega)))
    rates = sum((np.abs(longer) ** 2) @ damped for longer, _, damped in moved)
    return 0.5 * medium.damping * response.omega**2 * rates


def force_errors(medium, response):
    """Yield the error of each force, its bound, and the magnitude of the exact force."""
    with mp.workdps(DIGITS):
        columns = response.omega, response.force, response.force_bound
        for omega, force, bound in zip(*columns, strict=True):
            if isinstance(medium, Network):
                right = exact_network_force(medium, 1j * omega)
            else:
                right = exact_force(medium, omega)
            yield abs(exact(force) - right), bound, abs(right)


def sample_of(kind, damping, **others):
    """A lattice, or a crystal of random contacts and masses that is driven askew; one ball."""
    if kind == "lattice":
        return random_lattice((6, 5), 4, damping), (2, 3)
    rng, net = np.random.default_rng(8), makers.crystal("triangular", (4, 2), displacement=kind)
    others |= {"stiffness": rng.uniform(0.1, 1, net.bonds), "damping": damping}
    others["masses"] = rng.uniform(0.5, 2, len(net.held))
    if kind != "scalar":
        others |= {"tangential": rng.uniform(0.1, 0.5, net.bonds), "direction": [0.6, 0.8]}
        others["force"] = rng.uniform(0, 0.02, net.bonds)
    return dataclasses.replace(net, **others), net.free[2]


@pytest.mark.parametrize("method", ["points", "curve"])
@pytest.mark.parametrize("kind", [*LATTICES, "rotations"])
def test_forces_are_within_their_bounds(alone, method, kind):
    """Which are small against the force."""
    if kind in LATTICES:
        (shape, damping), site = kind, np.subtract(kind[0], 1)
        medium = random_lattice(shape, 3, damping)
    else:
        medium, site = sample_of(kind, 0.05)
    omegas = np.array([0.02, 0.3, 0.31, 0.7, 1.25])
    resolve = 0 if method == "curve" else None
    response = swept(medium, omegas, site, alone, method=method, resolve=resolve)
    assert np.array_equal(response.omega, omegas)
    for error, bound, size in force_errors(medium, response):
        assert error <= bound <= 1e-4 * size


def test_the_error_is_of_second_order(solver_options):
    """A residual that is no rounding costs the force its square, without it more than the bound."""
    solver_options("-steady_pc_type ilu")
    lattice, plain = random_lattice((9, 8), 3, 0.3), []
    with (
        mp.workdps(DIGITS),
        steady(lattice, (4, 3), MPI.COMM_SELF, 1e-3, derivatives=True) as (operators, solver),
    ):
        for omega in (0.3, 0.6, 0.9):
            state = solver.solve(1j * omega)
            reaction = exact(lattice.pull(1j * omega)) - exact_force(lattice, omega)
            assert state.converged_reason > 0
            assert solver.primal.norm > 1e-9
            assert abs(exact(state.reaction) - reaction) <= state.reaction_bound
            assert state.reaction_bound <= 1e-2 * abs(reaction)
            without = operators.f.tDot(solver.field)
            plain.append(abs(exact(without) - reaction) / state.reaction_bound)
    assert max(plain) > 1


@pytest.mark.parametrize("seed", range(2))
def test_forces_without_damping(comm, seed):
    """Real; where ranks share the lattice no bound is known."""
    lattice, omegas = random_lattice((4, 3), seed, 0.0), np.linspace(0.05, 1.3, 9)
    response = swept(lattice, omegas, (1, 1), comm, ranks=comm.size)
    assert response.failures == 0
    assert not response.force.imag.any()
    assert not response.power.any()
    assert np.all(np.isnan(response.force_bound)) == (comm.size > 1)
    for error, bound, size in force_errors(lattice, response):
        assert error <= (1e-8 * size if comm.size > 1 else bound)


@pytest.mark.parametrize("medium", ["lattice", "vector", "rotations"])
def test_power_is_what_dashpots_dissipate(alone, medium):
    """At omega Im F / 2, spring by spring."""
    sample, site = sample_of(medium, 0.1, damped="normal" if medium == "vector" else "all")
    omegas = np.linspace(0.2, 1.3, 12)
    response = swept(
        sample, omegas, site, alone, fields=True, error_tolerance=1e-12, error_floor=1e-15
    )
    dissipated = power_in_dashpots(sample, response)
    assert np.allclose(response.power, dissipated, rtol=1e-12, atol=0)
    assert np.array_equal(response.power, 0.5 * omegas * response.force.imag)
    assert np.allclose(response.dynamic_mass * omegas**2, -response.force, rtol=1e-15, atol=0)


def test_limits_of_the_force(alone):
    """Static, that of springs; of a stiff body its inertia; above all modes that of driven bonds.

    Springs are in series in a chain, and add up in chains side by side that are not joined.
    """
    k = np.random.default_rng(2).uniform(0.1, 1.0, (13, 3))
    series, unjoined = 1 / np.sum(1 / k, axis=0), np.zeros((12, 4))
    (force,) = swept(Lattice((k[:, 0],), 1.0, 0.01), [1e-6], [5], alone).force
    assert force.real == pytest.approx(series[0], rel=1e-9)
    (force,) = swept(Lattice((k, unjoined), 1.0, 0.01), [1e-6], (5, 1), alone).force
    assert force.real == pytest.approx(series.sum(), rel=1e-9)

    # balls that only the driven wall holds follow it
    stiff = bond_arrays((4, 3), lambda size: np.full(size, 1.0))
    stiff[0][0] = 0.0
    stiff[1][:, [0, -1]] = 0.0
    body = swept(Lattice(stiff, 1.7, 0.0), np.array([1e-4, 1e-3]), (1, 1), alone)
    assert np.allclose(body.dynamic_mass, 12 * 1.7, rtol=1e-4, atol=0)

    # balls stay where they are: F = sum (k + i omega beta), but for the part 1 / omega^2
    (force,) = swept(uniform_lattice((4, 5), 0.25, 1e-4), [1e3], (3, 2), alone).force
    assert force == pytest.approx(5 * (0.25 + 0.1j), rel=1e-5)

    loose = [k.copy() for k in uniform_lattice((3, 2)).stiffness]
    loose[0][-1] = 0.0  # the driven wall stretches nothing
    assert swept(Lattice(tuple(loose), 1.0, 0.0), [0.3], (1, 1), alone).force.tolist() == [0]


@pytest.mark.parametrize(("medium", "damping"), [("lattice", 0.0), ("vector", 0.02)])
def test_the_number_of_ranks_does_not_matter(world, medium, damping):
    (sample, site), omegas = sample_of(medium, damping), np.linspace(0.1, 1.2, 9)
    alone, each, shared = (
        swept(sample, omegas, site, comm, ranks=ranks, error_tolerance=1e-10)
        for comm, ranks in ((MPI.COMM_SELF, 1), (world, 1), (world, world.size))
    )
    assert_same(each, alone)
    assert np.allclose(shared.force, alone.force, rtol=1e-9, atol=0)
    bound = shared.force_bound + alone.force_bound
    assert damping == 0 or np.all(np.abs(shared.force - alone.force) <= bound)


def test_a_failed_frequency_is_marked(world, monkeypatch):
    """It has no force; of the others each has its own."""
    lattice, omegas, bad = random_lattice((5, 4), 2), np.linspace(0.2, 1.1, 7), 0.5
    right, assess = swept(lattice, omegas, (2, 2), world), Accuracy.assess

    def failing(self, s, *others):
        if abs(s.imag - bad) < 1e-9:
            raise PETSc.Error(76)  # an error in an outside package
        return assess(self, s, *others)

    monkeypatch.setattr(Accuracy, "assess", failing)
    response = swept(lattice, omegas, (2, 2), world)
    failed = np.arange(7) == 2
    assert np.array_equal(response.converged_reason <= 0, failed)
    for values in (response.force, response.power, response.dynamic_mass):
        assert np.array_equal(np.isnan(values), failed)
    assert not np.isfinite(response.force_bound[2])
    assert np.array_equal(response.force[~failed], right.force[~failed])
