"""The reference itself, against exact rational arithmetic and the closed form."""

from fractions import Fraction
from itertools import pairwise

import mpmath
import numpy as np
import pytest
from reference import Reference, exact_amplitudes, refined_field, uniform_field
from samples import random_lattice, uniform_lattice


def exact_chain(stiffness, damping, omega):
    """The amplitudes of a chain of unit masses, by elimination in rational arithmetic."""

    def minus(a, b):
        return a[0] - b[0], a[1] - b[1]

    def times(a, b):
        return a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]

    def over(a, b):
        size = b[0] ** 2 + b[1] ** 2
        return times(a, (b[0] / size, -b[1] / size))

    loss, inertia = Fraction(omega) * Fraction(damping), Fraction(omega) ** 2
    springs = [(Fraction(float(k)), loss) for k in stiffness]
    diagonal = [(low[0] + high[0] - inertia, 2 * loss) for low, high in pairwise(springs)]
    for i in range(1, len(diagonal)):
        diagonal[i] = minus(diagonal[i], over(times(springs[i], springs[i]), diagonal[i - 1]))
    amplitude, above = [], (Fraction(1), Fraction(0))
    for i in reversed(range(len(diagonal))):
        above = over(times(springs[i + 1], above), diagonal[i])
        amplitude.append(mpmath.mpc(*(mpmath.mpf(p.numerator) / p.denominator for p in above)))
    return amplitude[::-1]


@pytest.mark.parametrize("damping", [0.0, 0.003])
@pytest.mark.parametrize("omega", [0.05, 0.4, 1.0, 1.6])
def test_chains_equal_rational_arithmetic(omega, damping):
    """Dense, in extended precision, to rounding times the condition; else to nearly all digits."""
    lattice = random_lattice((14,), 3, damping)
    sites = [[i] for i in range(14)]
    reference = Reference(lattice.stiffness, 1.0, damping)
    condition = np.linalg.cond(reference.system(omega)[0].astype(complex))
    rounding = float(8 * condition * np.finfo(np.longdouble).eps)
    assert rounding < 1e-13
    with mpmath.workdps(60):
        exact = exact_chain(lattice.stiffness[0], damping, omega)
        found = exact_amplitudes(lattice.stiffness, 1.0, damping, omega, sites)
        refined = refined_field(lattice.stiffness, 1.0, damping, omega)
        for one, two, three, right in zip(
            found, refined, reference.solve(omega), exact, strict=True
        ):
            parts = (
                mpmath.mpf(np.format_float_scientific(p, 25)) for p in (three.real, three.imag)
            )
            assert abs(one - right) <= 1e-50 * abs(right)
            assert abs(two - right) <= 1e-45 * abs(right)
            assert abs(mpmath.mpc(*parts) - right) <= rounding * abs(right)
        assert omega < 1.6 or abs(exact[0]) < 1e-9  # such amplitudes are what this test is about


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
