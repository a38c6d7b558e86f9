"""The force that drives the wall: its value and bound, its power, its limits, its units."""

import dataclasses
import math

import mpmath
import numpy as np
import pytest
from mpi4py import MPI
from mpmath import mp, mpf
from network_samples import NetworkReference, eliminated, random_network
from petsc4py import PETSc
from reference import DRIVEN, bonds, refined_field
from samples import bond_arrays, random_lattice, steady, swept, uniform_lattice

from pgran.driven.judge import Judge
from pgran.medium import crystals as makers
from pgran.medium.lattice import Lattice
from pgran.medium.network import Network

DIGITS = 60
KINDS = [((30,), 0.02), ((9,), 1.0), ((5, 6), 3e-4), ((1, 4), 0.1), ((3, 4, 3), 0.03)]


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


def exact_network_force(network, s):
    """The force on the driven balls, along their motion, of S with no ball left out."""
    whole = NetworkReference(dataclasses.replace(network, held=0 * network.held))
    width, s = whole.axes + whole.turns, exact(s)
    spring = whole.K + s * mpf(network.damping) * whole.C
    motion = np.full((len(network.held), width), mpf(0))
    motion[network.held == 2, : whole.axes] = [mpf(float(x)) for x in network.direction]
    motion, free = motion.ravel(), np.repeat(network.held == 0, width)
    S = spring[np.ix_(free, free)].astype(object)
    S[np.diag_indices_from(S)] += s * s * whole.M[free]
    u = eliminated(S, -(spring @ motion)[free])
    moved = motion + 0
    moved[free] = u
    return motion @ spring @ moved


def crystal(displacement, **others):
    """A crystal of random contacts and masses, driven askew."""
    rng = np.random.default_rng(8)
    net = makers.crystal("triangular", (4, 2), displacement=displacement)
    contacts = len(net.bond)
    given = {
        "stiffness": rng.uniform(0.1, 1, contacts),
        "masses": rng.uniform(0.5, 2, len(net.held)),
    }
    if displacement != "scalar":
        given |= {"tangential": rng.uniform(0.1, 0.5, contacts), "direction": [0.6, 0.8]}
        given |= {"force": rng.uniform(0, 0.02, contacts)}
    return dataclasses.replace(net, **given | others)


def power_in_dashpots(medium, response):
    """Half of beta omega^2 |b^T A + w|^2 over all springs, at each frequency of stored fields."""
    scale = medium.weights if isinstance(medium, Network) else 1.0
    moved = medium.stretched(response.field / scale, np.ones(len(response.omega)))
    rates = sum((np.abs(longer) ** 2) @ damped for longer, _, damped in moved)
    return 0.5 * medium.damping * response.omega**2 * rates


@pytest.mark.parametrize("method", ["points", "curve"])
@pytest.mark.parametrize(("shape", "damping"), KINDS)
def test_forces_of_lattices(world, method, shape, damping):
    """Within their bounds, which are small against the force."""
    lattice, omegas = random_lattice(shape, 3, damping), np.array([0.02, 0.3, 0.31, 0.7, 1.25])
    resolve = 0 if method == "curve" else None
    site = np.subtract(shape, 1)
    response = swept(lattice, omegas, site, world, method=method, resolve=resolve)
    assert np.array_equal(response.omega, omegas)
    with mp.workdps(DIGITS):
        for omega, force, bound in zip(omegas, response.force, response.force_bound, strict=True):
            right = exact_force(lattice, omega)
            assert abs(exact(force) - right) <= bound <= 1e-4 * abs(right)


@pytest.mark.parametrize("method", ["points", "curve"])
@pytest.mark.parametrize("displacement", ["scalar", "vector", "rotations"])
def test_forces_of_networks(world, method, displacement):
    network = crystal(displacement, damping=0.05)
    omegas = np.array([0.03, 0.2, 0.5, 1.0, 2.0])
    resolve = 0 if method == "curve" else None
    response = swept(network, omegas, network.free[3], world, method=method, resolve=resolve)
    with mp.workdps(DIGITS):
        for omega, force, bound in zip(omegas, response.force, response.force_bound, strict=True):
            right = exact_network_force(network, 1j * omega)
            assert abs(exact(force) - right) <= bound <= 1e-4 * abs(right)


@pytest.mark.parametrize("seed", range(30))
def test_forces_of_random_networks(seed):
    """Parts that dangle, double contacts, negative constants, no damping: the bound holds."""
    case = random_network(seed, balls=7)
    network = case.network
    with (
        mp.workdps(DIGITS),
        steady(network, case.sites, MPI.COMM_SELF, case.tolerance, derivatives=True) as (_, solver),
    ):
        for s in case.points:
            state = solver.solve(s)
            if not math.isfinite(state.reaction_bound):
                continue
            force = exact(network.pull(s)) - exact(state.reaction)
            bound = state.reaction_bound + network.pull_rounding(abs(s))
            assert abs(force - exact_network_force(network, s)) <= bound


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


@pytest.mark.parametrize("seed", range(4))
def test_forces_without_damping(comm, seed):
    """Real; where ranks share the lattice no bound is known."""
    lattice, omegas = random_lattice((4, 3), seed, 0.0), np.linspace(0.05, 1.3, 9)
    response = swept(lattice, omegas, (1, 1), comm, ranks=comm.size)
    assert response.failures == 0
    assert not response.force.imag.any()
    assert not response.power.any()
    assert np.all(np.isnan(response.force_bound)) == (comm.size > 1)
    with mp.workdps(DIGITS):
        for omega, force, bound in zip(omegas, response.force, response.force_bound, strict=True):
            right = exact_force(lattice, omega)
            allowed = 1e-8 * abs(right) if comm.size > 1 else bound
            assert abs(exact(force) - right) <= allowed


@pytest.mark.parametrize("medium", ["lattice", "scalar", "vector", "rotations"])
def test_power_is_what_dashpots_dissipate(world, medium):
    """At omega Im F / 2, spring by spring."""
    if medium == "lattice":
        sample, site = random_lattice((6, 5), 4, 0.02), (2, 3)
    else:
        sample = crystal(medium, damping=0.1, damped="normal" if medium == "vector" else "all")
        site = sample.free[2]
    omegas = np.linspace(0.2, 1.3, 12)
    response = swept(
        sample, omegas, site, world, fields=True, error_tolerance=1e-12, error_floor=1e-15
    )
    dissipated = power_in_dashpots(sample, response)
    assert np.allclose(response.power, dissipated, rtol=1e-12, atol=0)
    assert np.array_equal(response.power, 0.5 * omegas * response.force.imag)
    assert np.allclose(response.dynamic_mass * omegas**2, -response.force, rtol=1e-15, atol=0)


def test_the_static_force_is_the_stiffness(world):
    """Of a chain that of springs in series; of chains side by side, not joined, their sum."""
    k = np.random.default_rng(2).uniform(0.1, 1.0, (13, 3))
    series = 1 / np.sum(1 / k, axis=0)
    (force,) = swept(Lattice((k[:, 0],), 1.0, 0.01), [1e-6], [5], world).force
    assert force.real == pytest.approx(series[0], rel=1e-9)
    (force,) = swept(Lattice((k, np.zeros((12, 4))), 1.0, 0.01), [1e-6], (5, 1), world).force
    assert force.real == pytest.approx(series.sum(), rel=1e-9)


def test_the_force_on_a_stiff_body_is_its_inertia(world):
    """Balls that only the driven wall holds follow it, if slowly: their masses are its own."""
    bonds_of = bond_arrays((4, 3), lambda size: np.full(size, 1.0))
    bonds_of[0][0] = 0.0
    bonds_of[1][:, [0, -1]] = 0.0
    lattice, omegas = Lattice(bonds_of, 1.7, 0.0), np.array([1e-4, 1e-3])
    response = swept(lattice, omegas, (1, 1), world)
    assert np.allclose(response.dynamic_mass, 12 * 1.7, rtol=1e-4, atol=0)


def test_high_above_all_modes_only_the_driven_bonds_act(world):
    """Balls stay where they are: F = sum (k + i omega beta), but for the part 1 / omega^2."""
    lattice = uniform_lattice((4, 5), 0.25, 1e-4)
    (force,) = swept(lattice, [1e3], (3, 2), world).force
    assert force == pytest.approx(5 * (0.25 + 0.1j), rel=1e-5)


@pytest.mark.parametrize("medium", ["lattice", "vector"])
@pytest.mark.parametrize("damping", [0.0, 0.02])
def test_the_number_of_ranks_does_not_matter(world, medium, damping):
    sample = random_lattice((7, 5), 4, damping) if medium == "lattice" else crystal(medium)
    site = (2, 3) if medium == "lattice" else sample.free[2]
    sample, omegas = dataclasses.replace(sample, damping=damping), np.linspace(0.1, 1.2, 9)
    alone, shared = (
        swept(sample, omegas, site, comm, ranks=comm.size, error_tolerance=1e-10)
        for comm in (MPI.COMM_SELF, world)
    )
    assert np.allclose(shared.force, alone.force, rtol=1e-9, atol=0)
    assert damping == 0 or np.all(
        np.abs(shared.force - alone.force) <= shared.force_bound + alone.force_bound
    )
    each = swept(sample, omegas, site, world, error_tolerance=1e-10)
    assert np.array_equal(each.force, alone.force)
    assert np.array_equal(each.force_bound, alone.force_bound)


@pytest.mark.parametrize("medium", ["lattice", "rotations"])
@pytest.mark.parametrize("method", ["points", "curve"])
def test_another_unit(world, medium, method):
    """Springs, dashpots and masses a million times as large take a force as much larger."""
    scale = 1e6
    if medium == "lattice":
        one, site = random_lattice((5, 4), 2, 0.01), (2, 2)
        other = Lattice(tuple(scale * k for k in one.stiffness), scale, scale * 0.01)
    else:
        one = crystal(medium, damping=0.05)
        names = ("stiffness", "tangential", "force", "masses", "damping", "kmax")
        names += ("median_mass",)
        larger = {name: scale * getattr(one, name) for name in names}
        other, site = dataclasses.replace(one, **larger), one.free[2]
    resolve, omegas = 0 if method == "curve" else None, np.linspace(0.1, 1.0, 6)
    found = [swept(x, omegas, site, world, method=method, resolve=resolve) for x in (one, other)]
    assert found[1].force_bound == pytest.approx(scale * found[0].force_bound, rel=0.5)
    assert np.all(
        np.abs(found[1].force - scale * found[0].force)
        <= scale * found[0].force_bound + found[1].force_bound
    )
    assert found[1].power == pytest.approx(scale * found[0].power, rel=1e-4)


def test_a_failed_frequency_is_marked(world, monkeypatch):
    """It has no force; of the others each has its own."""
    lattice, omegas, bad = random_lattice((5, 4), 2), np.linspace(0.2, 1.1, 7), 0.5
    right, assess = swept(lattice, omegas, (2, 2), world), Judge.assess

    def failing(self, s, systems, krylov):
        if abs(s.imag - bad) < 1e-9:
            raise PETSc.Error(76)  # an error in an outside package
        return assess(self, s, systems, krylov)

    monkeypatch.setattr(Judge, "assess", failing)
    found = swept(lattice, omegas, (2, 2), world)
    failed = found.converged_reason <= 0
    assert np.flatnonzero(failed).tolist() == [2]
    for values in (found.force, found.power, found.dynamic_mass):
        assert np.array_equal(np.isnan(values), failed)
    assert not np.any(np.isfinite(found.force_bound[failed]))
    good = np.isfinite(found.force)
    assert np.array_equal(found.force[good], right.force[good])


def test_a_drive_that_stretches_nothing_takes_no_force(world):
    """Bonds of constant 0 at the driven wall, no damping."""
    stiffness = [k.copy() for k in uniform_lattice((3, 2)).stiffness]
    stiffness[0][-1] = 0.0
    response = swept(Lattice(tuple(stiffness), 1.0, 0.0), [0.3], (1, 1), world)
    assert response.force.tolist() == [0]
