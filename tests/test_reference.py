"""The reference itself, against exact rational arithmetic and the closed form."""

from fractions import Fraction
from itertools import pairwise

import mpmath
import numpy as np
import pytest
from reference import Reference, bonds, exact_amplitudes, refined_field, uniform_field
from samples import random_lattice, uniform_lattice


def exact_chain(stiffness, mass, damping, omega):
    """The amplitudes of a chain, by elimination in rational arithmetic from the same doubles."""

    def minus(a, b):
        return a[0] - b[0], a[1] - b[1]

    def times(a, b):
        return a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]

    def over(a, b):
        size = b[0] ** 2 + b[1] ** 2
        return times(a, (b[0] / size, -b[1] / size))

    w, loss = Fraction(omega), Fraction(omega) * Fraction(damping)
    springs = [(Fraction(float(k)), loss) for k in stiffness]
    inertia = Fraction(mass) * w**2
    diagonal = [(low[0] + high[0] - inertia, low[1] + high[1]) for low, high in pairwise(springs)]
    for i in range(1, len(diagonal)):
        below = over(times(springs[i], springs[i]), diagonal[i - 1])
        diagonal[i] = minus(diagonal[i], below)
    amplitude, above = [], (Fraction(1), Fraction(0))
    for i in reversed(range(len(diagonal))):
        above = over(times(springs[i + 1], above), diagonal[i])
        amplitude.append(above)
    return amplitude[::-1]


@pytest.mark.parametrize("omega", [0.05, 0.4, 1.0, 1.6])
def test_reference_equals_rational_arithmetic(omega):
    lattice = random_lattice((14,), seed=3)
    exact = exact_chain(lattice.stiffness[0], 1.0, 0.003, omega)
    reference = Reference(lattice.stiffness)
    found = reference.solve(omega)
    # The conditioning times a roundoff of extended precision (times a few), for each component.
    condition = np.linalg.cond(reference.system(omega)[0].astype(complex))
    rounding = float(8 * condition * np.finfo(np.longdouble).eps)
    assert rounding < 1e-13
    for value, (re, im) in zip(found, exact, strict=True):
        parts = [Fraction(np.format_float_scientific(p, 25)) for p in (value.real, value.imag)]
        error = abs(complex(float(parts[0] - re), float(parts[1] - im)))
        assert error <= rounding * abs(complex(float(re), float(im)))
    if omega == 1.6:
        assert abs(found[0]) < 1e-9  # such amplitudes are what this test is about


@pytest.mark.parametrize("shape", [(9,), (1,), (6, 7), (1, 5), (5, 1), (3, 4, 5), (2, 1, 3)])
@pytest.mark.parametrize("omega", [0.03, 0.7, 1.9])
def test_reference_equals_the_closed_form(shape, omega):
    lattice = uniform_lattice(shape)
    found = Reference(lattice.stiffness).field(omega)
    exact = uniform_field(shape, 0.25, 1.0, 0.003, omega)
    assert np.abs(found - exact).max() <= 1e-16 * np.abs(exact).max()


def test_bonds_of_the_paper():
    ends = [(one, other) for *_, one, other in bonds((20, 20))]
    assert len(ends) == 840
    assert sum(other == "driven" for _, other in ends) == 20
    assert sum("at rest" in pair for pair in ends) == 60


@pytest.mark.parametrize("damping", [0.0, 0.003])
def test_elimination_with_many_digits(damping):
    """A chain agrees with rational arithmetic; a box with sums over its own waves."""
    with mpmath.workdps(60):
        lattice = random_lattice((40,), 3, damping)
        sites = [[i] for i in range(40)]
        found = exact_amplitudes(lattice.stiffness, 1.0, damping, 2.0, sites)
        exact = exact_chain(lattice.stiffness[0], 1.0, damping, 2.0)
        for one, parts in zip(found, exact, strict=True):
            real, imaginary = (mpmath.mpf(p.numerator) / p.denominator for p in parts)
            assert abs(one - mpmath.mpc(real, imaginary)) <= 1e-55 * abs(one)
        lattice = uniform_lattice((3, 5, 2), damping=damping)
        sites = list(np.ndindex(3, 5, 2))
        found = exact_amplitudes(lattice.stiffness, 1.0, damping, 0.9, sites)
    waves = uniform_field((3, 5, 2), 0.25, 1.0, damping, 0.9).ravel()
    assert np.abs(np.array([complex(one) for one in found]) / waves - 1).max() < 1e-13


def test_elimination_on_a_resonance():
    (found,) = exact_amplitudes((np.array([0.5, 0.5]),), 1.0, 0.0, 1.0, [[0]])
    assert mpmath.isinf(found)


@pytest.mark.parametrize("shape", [(40,), (12, 5), (4, 3, 3)])
@pytest.mark.parametrize("omega", [0.4, 1.4])
def test_refinement_agrees_with_elimination(shape, omega):
    """All digits, also of amplitudes of 1e-50."""
    lattice, site = random_lattice(shape, 2), (1,) * len(shape)
    with mpmath.workdps(50):
        field = refined_field(lattice.stiffness, 1.0, lattice.damping, omega)
        (exact,) = exact_amplitudes(lattice.stiffness, 1.0, lattice.damping, omega, [site])
        assert abs(field[site] - exact) <= 1e-45 * abs(exact)
