"""Bounds ball by ball, the floor of amplitudes, and numbers whose squares vanish.

tests/campaigns/comparison.py takes long sweeps.
"""

import math

import numpy as np
import pytest
from campaigns.relaxation import relaxed
from mpmath import mp
from reference import exact_amplitudes
from samples import bond_arrays, random_lattice, reference_of, steady, swept

from pgran.physics.bondlaw import BondLaw
from pgran.physics.lattice import Lattice
from pgran.results import LatticeRecord, Result
from pgran.scenes.response import summary
from pgran.solve.comparison import Comparison


def compared(lattice, omegas, site, digits=60, **choices):
    """The response, its amplitudes' errors and true sizes, by elimination with many digits."""
    found, constants = swept(lattice, omegas, site, **choices), (lattice.mass, lattice.damping)
    with mp.workdps(digits):
        exact = [exact_amplitudes(lattice.stiffness, *constants, w, [site]) for w in omegas]
        missed = np.vectorize(mp.mpmathify, otypes=[object])(found.displacement) - exact
        return found, np.abs(missed).astype(float), np.abs(exact).astype(float)


@pytest.mark.parametrize("damping", [0.003, 0.0, 1e-9])
@pytest.mark.parametrize(
    ("shape", "site"),
    [((100,), (8,)), ((30, 6), (2, 3)), ((1, 30), (0, 1)), ((12, 3, 2), (0, 1, 1))],
)
def test_tiny_amplitudes_above_the_highest_mode(shape, site, damping):
    """Far below what norms can prove each amplitude has its relative bound."""
    lattice = random_lattice(shape, 5, damping)
    highest = math.sqrt(reference_of(lattice).eigenvalues()[-1])
    omegas = highest * np.array([1.05, 2.0, 6.0])
    found, wrong, _ = compared(lattice, omegas, site, error_tolerance=1e-9, error_floor=0.0)
    assert np.all(found.converged_reason > 0)
    assert np.all(wrong <= found.error_bound)
    assert np.all(found.error_bound <= 1e-9 * found.amplitude)
    assert not found.at_floor.any()


@pytest.mark.parametrize("damping", [0.003, 0.0])
def test_no_error_of_the_field_exceeds_its_bound(comm, damping):
    """The vector bounds all balls; inside the band of frequencies there is none."""
    lattice = random_lattice((9, 7), 2, damping)
    reference = reference_of(lattice)
    highest = math.sqrt(reference.eigenvalues()[-1])
    with (
        steady(lattice, [1, 1], comm, 1e-3) as (operators, solver),
        Comparison(operators) as comparison,
    ):
        for omega, known in ((1.2 * highest, True), (0.5 * highest, False), (0.9 * highest, False)):
            solver.solve(1j * omega)
            v = comparison.errors(solver.bounds.residuals(solver.primal), solver.bounds)
            assert (v is not None) == known
            if known:
                bound, field = operators.field(v), operators.field(solver.field)
                if comm.rank == 0:
                    missed = np.abs(field - reference.field(omega))
                    assert np.all(missed <= bound.real)
                    assert np.all(bound.real <= 1e-11 * np.abs(field))


def test_amplitudes_that_vanish_are_not_good(comm):
    """What no double can hold is known to nothing but the floor, however the lattice is shared."""
    for floor in (0.0, 1e-20):
        lattice = random_lattice((12, 12), 3, damping=0.0)
        with steady(lattice, [[1, 5]], comm, error_floor=floor) as (_, solver):
            for omega in (1e15, 1e20):
                state = solver.solve(1j * omega)
                assert (state.converged_reason > 0) == (floor > 0)
                assert not floor or 0 < state.error_bound[0] <= floor


def test_the_floor():
    """Far behind strong damping, inside the band: good with a floor, marked without one."""
    lattice = random_lattice((120,), 4, damping=0.3)
    omegas, site = [0.55, 0.6], (1,)
    without = swept(lattice, omegas, site, error_floor=0.0)
    assert np.all(without.converged_reason <= 0)
    assert not without.at_floor.any()
    found, wrong, _ = compared(lattice, omegas, site)
    assert np.all(found.converged_reason > 0)
    assert np.all(found.at_floor == 1)
    assert np.all(wrong <= found.error_bound)
    assert np.all(found.error_bound <= 1e-20)
    assert np.isnan(found.phase).all()  # nothing is known of it
    text = "\n".join(summary(Result([LatticeRecord.of(lattice), found])))
    assert "2 of 2 amplitudes are known to -error_floor of the wall's only" in text


@pytest.mark.parametrize("method", ["window", "krylov", "direct"])
def test_the_floor_of_a_relaxation(method):
    """By every method; and above the highest mode windows are as accurate as their start."""
    choices = {"steps": 20, "method": method}
    chain, square = random_lattice((120,), 4, damping=0.3), random_lattice((12, 12), 2)
    found = relaxed(chain, (1,), omega=0.6, **choices)
    assert np.all(found.at_floor == 1)
    assert found.failures == 0
    assert relaxed(chain, (1,), omega=0.6, error_floor=0.0, **choices).failures == 21
    above = relaxed(square, (1, 5), omega=6.0, **choices)
    assert not above.at_floor.any()
    assert np.all(above.error_bound <= 1e-4 * above.amplitude)


CASES = [
    # law, smallest and largest constant, shape, mass, frequencies, detector
    ("bimodal", 6.2e-231, 0.25, (2, 2, 2), 1.0, [0.0755, 0.5778], (0, 0, 0)),
    ("loguniform", 2.34e-208, 0.25, (3, 1), 1.0, [0.05, 0.1, 0.5], (1, 0)),
    ("loguniform", 1e-300, 1.0, (5,), 1.0, [0.05, 0.3, 1.5, 30.0], (1,)),
    ("bimodal", 1e-150, 1.0, (4, 3), 1.0, [0.02, 0.4, 1.1], (0, 1)),
    ("uniform", 0.0, 1e-250, (4, 3), 1e-250, [0.3, 1.0, 2.9], (1, 1)),
    ("uniform", 0.0, 1e-250, (4, 3), 1.0, [3e-126, 1e-125], (1, 1)),
    ("uniform", 0.0, 1e250, (4, 3), 1e250, [0.3, 1.0, 2.9], (1, 1)),
]


@pytest.mark.parametrize("solver", ["", "-steady_pc_type ilu -steady_ksp_type preonly"])
@pytest.mark.parametrize("damping", [0.0, 1e-3])
@pytest.mark.parametrize("case", CASES, ids=str)
def test_what_vanishes_is_counted(case, damping, solver, solver_options):
    """Constants and amplitudes down to 1e-300: no bound is broken, nothing wrong passes."""
    solver_options(solver)
    law, kmin, kmax, shape, mass, omegas, site = case
    law, rng, marked = BondLaw(law, kmin=kmin, kmax=kmax), np.random.default_rng(1), []
    beta = damping * math.sqrt(kmax) * math.sqrt(mass)
    for _ in range(4):
        stiffness = bond_arrays(shape, lambda size: law(rng.random(size)))
        lattice = Lattice(stiffness, mass, beta, kmax=kmax)
        found, wrong, size = compared(lattice, omegas, site, 700)
        good, known = found.converged_reason > 0, ~np.isnan(found.error_bound)
        assert np.all(wrong[known] <= found.error_bound[known])
        assert np.all(found.error_bound[good] > 0)
        assert np.all(wrong[good] <= np.maximum(1e-4 * size[good], 1e-20))
        marked.append(~good)
    assert solver or np.mean(marked) < 0.2
