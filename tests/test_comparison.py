"""Bounds ball by ball, the floor of amplitudes, and numbers whose squares vanish.

tests/campaigns/comparison.py takes long sweeps.
"""

import numpy as np
import pytest
from mpi4py import MPI
from mpmath import mp
from reference import exact_amplitudes
from samples import random_lattice, reference_of, relaxed, steady, swept

from pgran.experiments.response.scene import summary
from pgran.medium.record import LatticeRecord
from pgran.store.record import Result


def compared(lattice, omegas, site, comm=MPI.COMM_SELF, **choices):
    """The response, and its amplitudes' errors, by elimination with many digits."""
    found = swept(lattice, omegas, site, comm, comm.size, **choices)
    constants = lattice.mass, lattice.damping
    with mp.workdps(60):
        exact = [exact_amplitudes(lattice.stiffness, *constants, w, [site]) for w in omegas]
        missed = np.vectorize(mp.mpmathify, otypes=[object])(found.displacement) - exact
        return found, np.abs(missed).astype(float)


CHAIN = random_lattice((120,), 4, damping=0.3)
SITES = [((100,), (8,)), ((30, 6), (2, 3)), ((1, 30), (0, 1)), ((12, 3, 2), (0, 1, 1))]


@pytest.mark.parametrize("damping", [0.003, 0.0, 1e-9])
@pytest.mark.parametrize(("shape", "site"), SITES)
def test_tiny_amplitudes_outside_the_band(comm, shape, site, damping):
    """Where norms prove little each amplitude has its relative bound; without damping S is definite
    below the lowest and above the highest mode, and nothing is proven where ranks share it."""
    lattice = random_lattice(shape, 5, damping)
    lowest, highest = np.sqrt(reference_of(lattice).eigenvalues()[[0, -1]])
    omegas = np.array([lowest / 2, 1.05 * highest, 2 * highest, 6 * highest])
    choices = {"error_floor": 0.0}
    found, wrong = compared(lattice, omegas, site, comm, error_tolerance=1e-9, **choices)
    assert np.all(found.converged_reason > 0)
    assert np.all(wrong <= 1e-9 * found.amplitude)
    assert np.all(np.isnan(found.error_bound)) == (damping == 0 and comm.size > 1)
    if damping or comm.size == 1:
        assert np.all(wrong <= found.error_bound)
        assert np.all(found.error_bound <= 1e-9 * found.amplitude)
    assert not found.at_floor.any()


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
    omegas, site = [0.55, 0.6], (1,)
    without = swept(CHAIN, omegas, site, error_floor=0.0)
    assert np.all(without.converged_reason <= 0)
    assert not without.at_floor.any()
    found, wrong = compared(CHAIN, omegas, site)
    assert np.all(found.converged_reason > 0)
    assert np.all(found.at_floor == 1)
    assert np.all(wrong <= found.error_bound)
    assert np.all(found.error_bound <= 1e-20)
    assert np.isnan(found.phase).all()  # nothing is known of it
    text = "\n".join(summary(Result([LatticeRecord.of(CHAIN), found])))
    assert "2 of 2 amplitudes are tiny" in text


@pytest.mark.parametrize("method", ["window", "krylov", "direct"])
def test_the_floor_of_a_relaxation(method):
    """By every method; and above the highest mode windows are as accurate as their start."""
    choices = {"steps": 20, "method": method}
    found = relaxed(CHAIN, (1,), omega=0.6, **choices)
    assert np.all(found.at_floor == 1)
    assert found.failures == 0
    assert relaxed(CHAIN, (1,), omega=0.6, error_floor=0.0, **choices).failures == 21
    above = relaxed(random_lattice((12, 12), 2), (1, 5), omega=6.0, **choices)
    assert not above.at_floor.any()
    assert np.all(above.error_bound <= 1e-4 * above.amplitude)
