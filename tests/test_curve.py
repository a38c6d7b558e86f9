"""The response between frequencies: models of intervals, their bounds, and the points they add."""

import itertools
from collections import Counter
from functools import partial

import mpmath
import numpy as np
import pytest
from amplitude_faults import curve_faults
from mpi4py import MPI
from network_samples import NetworkReference, as_network, random_network
from petsc4py import PETSc
from reference import exact_amplitudes, uniform_amplitude
from samples import (
    Run,
    assert_same,
    bond_arrays,
    random_lattice,
    reference_of,
    swept,
    uniform_lattice,
)

from pgran import InputError, Lattice, PgranError
from pgran.driven.operators import Operators
from pgran.experiments.response import intervals
from pgran.experiments.response.curve import deviation, hidden_part, normal_frequencies
from pgran.experiments.response.models import evaluate
from pgran.experiments.response.scene import summary
from pgran.medium.record import LatticeRecord
from pgran.store.record import Result

LATTICE, SITES = random_lattice((7, 8), 5, 0.003), [[3, 4], [0, 0]]
OMEGAS = np.linspace(0.06, 1.3, 5)
KINDS = [
    ((1,), 1e-3, "uniform", [[0]]),
    ((25,), 1.0, "wide", [[13], [24]]),
    ((8, 6), 1e-4, "bimodal", [[2, 3], [7, 0], [0, 5]]),
    ((4, 3, 4), 3e-2, "bimodal", [[1, 1, 2], [3, 0, 0]]),
]


def curve(lattice, omegas, sites, comm, **choices):
    """The response by models, which are kept."""
    return swept(lattice, omegas, sites, comm, method="curve", keep_models=True, **choices)


@pytest.mark.parametrize(("shape", "damping", "law", "sites"), KINDS)
def test_curves_against_the_reference(world, shape, damping, law, sites):
    """Anywhere, and across every mode, however narrow: values, derivatives, delays, lines."""
    choices, seen = {"method": "curve", "keep_models": True}, Counter()
    run = Run(1, random_lattice(shape, 3, damping, law=law), sites, choices, 50, omegas=OMEGAS)
    assert list(curve_faults(run, seen, world)) == []
    assert seen["points"] == seen["accurate"] == seen["accurate derivatives"] > 50 / world.size


@pytest.mark.parametrize("place", [(11,), (3, 2), (1, 1, 3)])
def test_group_delay_of_the_uniform_lattice(world, place):
    """From its closed form: sines across, a wave with sinh along."""
    shape = [(30,), (9, 6), (4, 3, 5)][len(place) - 1]
    found = curve(uniform_lattice(shape, 0.25, 0.02), OMEGAS, place, world)
    amplitude = partial(uniform_amplitude, shape, 0.25, 0.02, place)
    with mpmath.workdps(40):
        for n in range(world.rank, len(found.omega), 60 * world.size):
            omega = mpmath.mpf(float(found.omega[n]))
            delay = -mpmath.im(mpmath.diff(amplitude, omega) / amplitude(omega))
            assert abs(found.delay[n, 0] - delay) <= found.delay_bound[n, 0] < 0.05 * abs(delay)


@pytest.mark.parametrize(("moments", "powers"), [(1, (7, 10)), (2, (5, 8)), (3, (5, 6))])
def test_order_of_the_bound(comm, moments, powers, monkeypatch):
    """With m moments of A and z at both ends it falls like the interval's length to the 4 m."""
    monkeypatch.setattr(intervals, "moments_of", lambda medium: moments)
    bounds = []
    with Operators(random_lattice((7, 8), 5, 0.03), comm) as operators:
        for length in 2.0 ** -np.array(powers):
            with intervals.IntervalModels(operators, SITES, 0.5, lambda _, w=length: w) as models:
                (model,) = next(models.cover(0.5 - length / 2, 0.5 + length / 2))
                (point,) = evaluate(model, np.array([0.5]), models.limits)
            assert model["high"] - model["low"] == length
            bounds.append(point["error_bound"] - point["rounding"])
    orders = np.log2(bounds[0] / bounds[1]) / (powers[1] - powers[0])
    assert np.all(np.abs(orders - 4 * moments) < 0.5)


@pytest.mark.parametrize("few", [False, True])
def test_ranks_agree(world, few):
    """On every bit if each has its lattice, within bounds if they share it, a ball a rank too."""
    lattice, sites = (random_lattice((world.size,), 5), [[0]]) if few else (LATTICE, SITES)
    alone, together = (curve(lattice, OMEGAS, sites, comm) for comm in (MPI.COMM_SELF, world))
    assert_same(together, alone)
    shared = curve(lattice, OMEGAS, sites, world, ranks=world.size)
    one, other = (response.at(np.linspace(0.06, 1.3, 99)) for response in (alone, shared))
    for value in (1, 3):
        assert np.all(np.abs(one[value] - other[value]) <= one[value + 1] + other[value + 1])


def test_what_has_no_curve_is_refused(world, solver_options):
    """In words; `auto` then solves for points, unless lines are to be resolved."""
    undamped, models = random_lattice((6, 5), 3, 0.0), {"method": "curve"}
    for lattice, omegas, choices, why in (
        (undamped, OMEGAS, models, "sweep_method curve: without damping"),
        (undamped, OMEGAS, {"method": "auto", "resolve": 0.1}, "sweep_resolve: without damping"),
        (LATTICE, OMEGAS, models | {"fields": True}, "fields"),
        (LATTICE, OMEGAS[:1], models, "two frequencies"),
        (LATTICE, OMEGAS, {"resolve": 0.1}, "needs models"),
    ):
        with pytest.raises(InputError, match=why):
            swept(lattice, omegas, [2, 2], world, **choices)
    with pytest.raises(PgranError, match="no models"):
        swept(LATTICE, OMEGAS, SITES, world).at(0.5)
    solver_options("-steady_pc_type ilu")
    with pytest.raises(InputError, match="factorization"):
        curve(LATTICE, OMEGAS, SITES, world)


def test_auto_weighs_frequencies_against_intervals(world, solver_options):
    omegas = np.linspace(0.5, 0.51, 300)
    few, many = (swept(LATTICE, w, SITES, world, method="auto") for w in (omegas[::15], omegas))
    solver_options("-steady_pc_type ilu")
    poor = swept(LATTICE, omegas, SITES, world, method="auto")
    assert (few.method, many.method, poor.method) == ("points", "curve", "points")
    assert many.factorizations < few.factorizations


@pytest.mark.parametrize("tiny", [1.0, 1e-100, 1e-165])
def test_what_is_asked_for_is_solved_where_nothing_is_proven(world, tiny):
    """A ball far down a long chain at high frequencies; bonds and dashpots whose squares vanish."""
    bonds = np.random.default_rng(1).uniform(0.1, 0.25, 61)
    bonds[-1] *= tiny
    lattice, asked = Lattice((bonds,), 1.0, 0.02 * tiny), np.array([0.3, 0.5, 1.05, 1.1, 1.2])
    response = curve(lattice, asked, [[8]], world, resolve=0)
    assert np.array_equal(response.omega, asked)
    assert (response.failures, response.factorizations > len(asked)) == (0, True)
    found = response.at(np.array([0.4, 1.07, 1.3]))
    for values, bound in (found[1:3], found[3:]):
        assert np.isinf(bound).ravel().tolist() == [tiny != 1, True, True]
        assert np.array_equal(np.isnan(values), np.isinf(bound))
    with mpmath.workdps(200):
        for n, omega in enumerate(asked):
            (exact,) = exact_amplitudes(lattice.stiffness, 1.0, lattice.damping, omega, [[8]])
            error = abs(mpmath.mpmathify(complex(response.displacement[n, 0])) - exact)
            assert error <= response.error_bound[n, 0] <= max(1e-20, 1e-4 * abs(exact))


@pytest.mark.parametrize("raising", [False, True])
@pytest.mark.parametrize("failing", [{0}, {4}, set(range(1000))])
def test_factorizations_that_fail(monkeypatch, caplog, failing, raising):
    """Intervals beside them are not proven; what was asked for there is solved one by one."""
    calls = itertools.count()

    class Failing(intervals.Krylov):
        def factor(self):
            if next(calls) not in failing:
                return super().factor()
            if raising:
                PETSc.Mat().create(PETSc.COMM_SELF).norm()  # a PETSc.Error
            return False

    monkeypatch.setattr(intervals, "Krylov", Failing)
    asked, reference = np.linspace(0.06, 1.3, 60), reference_of(LATTICE)
    response = curve(LATTICE, asked, SITES, MPI.COMM_SELF, resolve=0)
    found = response.at(asked)
    unproven = np.isinf(found.error_bound).all(axis=1)
    assert 1 <= np.count_nonzero(unproven) <= (20 if len(failing) == 1 else 60)
    exact = np.array([reference.amplitudes(omega, SITES) for omega in asked])
    assert np.all(np.abs(response.displacement - exact) <= response.error_bound)
    assert np.all(response.error_bound <= 1e-4 * np.abs(exact))
    assert ("no model at omega" in caplog.text) == raising
    within = np.linspace(asked[:-1], asked[1:], 41)[1:-1]
    covered = np.isfinite(response.at(within.ravel()).error_bound).all(axis=1).reshape(within.shape)
    assert np.array_equal(response.modelled[1:] > 0, covered.all(axis=0))
    assert 0 < response.unmodelled <= 1


def test_lines_are_looked_at_where_they_pass_zero():
    t, ends = np.linspace(0, 1, 4001), [0, -1]
    for zero in np.linspace(0.02, 0.98, 13):
        curved, slope = t - zero + 1e-3j + 1e-3 * t**2, 1 + 2e-3 * t
        missed = np.max(np.abs(np.interp(t, t[ends], curved[ends]) - curved) / np.abs(curved))
        found = deviation(t[ends], curved[ends, None], slope[ends, None])
        assert found[0, 0] == pytest.approx(missed, rel=0.1)


# What may hide between points that no model covers


@pytest.mark.parametrize("method", ["points", "curve"])
def test_no_resonance_hides(world, method):
    """Damping too weak for any model; modes hardly driven, as all is almost symmetric."""
    rng = np.random.default_rng(1)
    bonds = bond_arrays((2, 3), lambda size: rng.uniform(0.25 - 1e-5, 0.25, size))
    lattice = Lattice(bonds, 1.0, 1e-9)
    modes = np.sqrt(reference_of(lattice).eigenvalues())
    asked = np.linspace(0.2, 1.3, 1500)
    response = swept(lattice, asked, [[0, 1]], world, method=method, resolve=None)
    straight = deviation(asked, response.displacement, response.derivative)[:, 0] <= 1e-2
    hidden = np.unique(np.searchsorted(asked, modes[(modes > 0.2) & (modes < 1.3)])) - 1
    assert straight[hidden].any()
    assert response.unresolved[hidden].all()
    assert np.count_nonzero(~response.unresolved) > 1300
    assert response.unmodelled == 1
    assert np.isnan(response.phase_slope[0])
    text = "\n".join(summary(Result([LatticeRecord.of(lattice), response])))
    assert "not resolved" in text
    assert ("no model could be proven for 100 % of the sweep" in text) == (method == "curve")


def test_many_balls_and_little_damping_leave_every_line_in_doubt(world):
    """Whose modes are not looked for; where damping is strong, no pole is near enough to hide."""
    for damping, resolved in (1e-9, False), (0.5, True):
        lattice = random_lattice((1001,), 2, damping)
        found = swept(lattice, np.linspace(0.3, 0.3 + 1e-4, 3), [[1000]], world)
        assert np.all(~found.unresolved == resolved)


def test_no_pole_is_nearer_than_damping_allows():
    """Of a pole as near as that, halfway between neighbours, the cubic shows that part."""
    lattices = [as_network(random_lattice(shape, 3, 0.05)) for shape in ((9,), (5, 4), (3, 2, 3))]
    networks, tested = [random_network(seed).network for seed in range(30)], 0
    for medium in (*lattices, *networks):
        rate, n, naive = medium.relaxation_rate, medium.size, NetworkReference(medium)
        if not n or rate >= 1e3:
            continue
        K, C = (x.astype(float) for x in (naive.K, naive.C * float(medium.damping)))
        M = naive.M.astype(float)[:, None]
        system = np.block([[np.zeros((n, n)), np.eye(n)], [-K / M, -C / M]])
        poles = np.linalg.eigvals(system)
        # the others swing no more, or are zero but for rounding
        poles = poles[poles.imag > np.maximum(1e-3 * np.abs(poles), 1e-4 * np.abs(poles).max())]
        assert np.all(np.abs(poles + rate) <= rate * (1 + 1e-9))
        assert np.all(-poles.real >= (np.hypot(rate, poles.imag) - rate) * (1 - 1e-6))
        tested += len(poles)
    assert tested > 100
    for distance in (0.01, 0.1, 1.0):
        ends = 1.5 + np.array([-0.5, 0.5]) * distance
        pole = 1.5 + 1j * (np.hypot(2.0, ends[0]) - 2.0)
        values, slopes = 1 / (ends - pole), -1 / (ends - pole) ** 2
        shown = distance / 8 * abs(slopes[0] - slopes[1])
        missed = abs(1 / (1.5 - pole) - values.mean())
        assert hidden_part(ends, 2.0) == pytest.approx(missed / shown, rel=1e-6)


def test_normal_frequencies_enclose_the_modes():
    for seed in range(20):
        network = random_network(seed).network.in_own_unit()[0]
        exact = NetworkReference(network).eigenvalues()
        low, high = normal_frequencies(network)
        square = np.maximum(exact, 0) / network.mass
        assert np.all((low**2 <= square * (1 + 1e-9)) & (square <= high**2 * (1 + 1e-9)))
        assert np.all(high**2 - low**2 <= 1e-12 * network.stiffness_norm / network.mass)
