"""The reference itself, against marching along a chain and the closed form."""

from itertools import pairwise

import mpmath
import numpy as np
import pytest
from mpmath import mpf
from reference import Reference, exact_amplitudes, refined_field, uniform_field
from samples import random_lattice, uniform_lattice

exactly = np.vectorize(mpmath.mpmathify, otypes=[object])


def marched(stiffness, damping, omega):
    """A chain of unit masses, from the wall at rest ball by ball to the driven one."""
    springs = [mpf(float(k)) + 1j * mpf(omega) * mpf(damping) for k in stiffness]
    A = [mpf(0), mpf(1)]
    for low, high in pairwise(springs):
        A.append(A[-1] + (low * (A[-1] - A[-2]) - mpf(omega) ** 2 * A[-1]) / high)
    return np.array([a / A[-1] for a in A[1:-1]])


@pytest.mark.parametrize("damping", [0.0, 0.003])
@pytest.mark.parametrize("omega", [0.05, 0.4, 1.0, 1.6])
def test_chains(omega, damping):
    """Dense, in extended precision, to rounding times the condition; else to nearly all digits."""
    lattice, sites = random_lattice((14,), 3, damping), [[i] for i in range(14)]
    dense = Reference(lattice.stiffness, 1.0, damping)
    condition = np.linalg.cond(dense.system(omega)[0].astype(complex))
    rounding = float(8 * condition * np.finfo(np.longdouble).eps)
    assert rounding < 1e-13
    with mpmath.workdps(60):
        right = marched(lattice.stiffness[0], damping, omega)
        found = exact_amplitudes(lattice.stiffness, 1.0, damping, omega, sites)
        assert max(abs(found / right - 1)) < 1e-45
        refined = refined_field(lattice.stiffness, 1.0, damping, omega)
        assert max(abs(refined / right - 1)) < 1e-45
        solved = dense.solve(omega)
        first = solved.astype(complex)
        solved = exactly(first) + exactly((solved - first).astype(complex))
        assert max(abs(solved / right - 1)) <= rounding


@pytest.mark.parametrize("shape", [(9,), (1,), (6, 7), (1, 5), (5, 1), (3, 4, 5), (2, 1, 3)])
@pytest.mark.parametrize("omega", [0.03, 0.7, 1.9])
def test_boxes_equal_the_closed_form(shape, omega):
    stiffness, sites = uniform_lattice(shape).stiffness, list(np.ndindex(*shape))
    waves = uniform_field(shape, 0.25, 1.0, 0.003, omega)
    assert np.abs(Reference(stiffness).field(omega) - waves).max() <= 1e-16 * np.abs(waves).max()
    with mpmath.workdps(30):
        found = np.array(exact_amplitudes(stiffness, 1.0, 0.003, omega, sites), complex)
        refined = refined_field(stiffness, 1.0, 0.003, omega).astype(complex)
    assert np.abs(found.reshape(shape) / waves - 1).max() < 1e-13
    assert np.abs(refined / waves - 1).max() < 1e-13


def test_elimination_on_a_resonance():
    (found,) = exact_amplitudes((np.array([0.5, 0.5]),), 1.0, 0.0, 1.0, [[0]])
    assert mpmath.isinf(found)
