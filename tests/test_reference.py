"""The reference itself, against the closed form, and its three ways against each other."""

import mpmath
import numpy as np
import pytest
from reference import Reference, exact_amplitudes, refined_field, uniform_field
from samples import random_lattice, uniform_lattice


@pytest.mark.parametrize("shape", [(9,), (1,), (6, 7), (1, 5), (5, 1), (3, 4, 5), (2, 1, 3)])
@pytest.mark.parametrize("omega", [0.03, 0.7, 1.9])
def test_boxes_equal_the_closed_form(shape, omega):
    """To rounding; and 60 digits are the same by elimination as by refinement."""
    uniform, uneven, sites = uniform_lattice(shape), random_lattice(shape), np.ndindex(*shape)
    waves = uniform_field(shape, 0.25, 1.0, 0.003, omega)
    field = Reference(uniform.stiffness).field(omega)
    assert np.abs(field - waves).max() <= 1e-16 * np.abs(waves).max()
    with mpmath.workdps(60):
        found = refined_field(uniform.stiffness, 1.0, 0.003, omega).astype(complex)
        assert np.abs(found / waves - 1).max() < 1e-13
        found = refined_field(uneven.stiffness, 1.0, 0.003, omega).ravel()
        exact = exact_amplitudes(uneven.stiffness, 1.0, 0.003, omega, list(sites))
        assert max(abs(found / np.array(exact) - 1)) < 1e-45


def test_elimination_on_a_resonance():
    (found,) = exact_amplitudes((np.array([0.5, 0.5]),), 1.0, 0.0, 1.0, [[0]])
    assert mpmath.isinf(found)
