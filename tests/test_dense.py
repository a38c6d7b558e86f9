"""Whole spectra by LAPACK: proven radii against many digits, planted faults prove nothing."""

import mpmath
import numpy as np
import pytest
from scipy.sparse import csr_matrix

from pgran.experiments.modes.dense import enclosure, stiffness_matrix, whole_spectrum


def exact_eigenvalues(K, digits=60):
    """All eigenvalues of a matrix as it is stored, ascending."""
    with mpmath.workdps(digits):
        return sorted(mpmath.eigsy(mpmath.matrix(K.toarray().tolist()), eigvals_only=True))


def stored(matrix):
    return csr_matrix(0.5 * (matrix + matrix.T))


def random_matrices(count):
    """Degenerate, zero and unstable modes, contrasts of 1e12, masses over 16 decades."""
    rng = np.random.default_rng(27)
    for number in range(count):
        n = rng.integers(2, 12)
        constants = 10 ** rng.uniform(-12 * (number % 2), 0, 2 * n)
        constants *= rng.choice([1, 0, -1], 2 * n, p=[0.8, 0.1, 0.1])
        B = rng.choice([-1.0, 0.0, 1.0], (2 * n, n)) * 10 ** rng.uniform(
            -8 * (number % 3 == 0), 0, n
        )
        yield stored(B.T @ np.diag(constants) @ B)
    yield stored(np.eye(7))
    yield stored(np.zeros((5, 5)))
    yield stored(np.kron(np.eye(3), [[2.0, -1.0], [-1.0, 2.0]]))


def test_each_eigenvalue_lies_within_the_radius():
    for K in random_matrices(60):
        found, exact = whole_spectrum(K), exact_eigenvalues(K)
        errors = [abs(mpmath.mpf(w) - x) for w, x in zip(found.values, exact, strict=True)]
        assert max(errors) <= found.radius
        assert found.radius <= 1e-11 * max(abs(K).sum(axis=1).max(), 1e-300)


def planted(fault, values, vectors):
    """A spectrum with one mode missing, doubled, turned or misplaced."""
    values, vectors = values.copy(), vectors.copy()
    if fault == "missing":  # another one stands in its place
        values[3], vectors[:, 3] = values[4], vectors[:, 4]
    elif fault == "turned":
        vectors[:, 3] = np.cos(0.02) * vectors[:, 3] + np.sin(0.02) * vectors[:, 7]
    elif fault == "misplaced":
        values[3] += 0.01
    elif fault == "not finite":
        vectors[2, 3] = np.nan
    return values, vectors


@pytest.mark.parametrize("fault", ["missing", "turned", "misplaced", "not finite"])
def test_a_planted_fault_proves_little(fault):
    """The radius grows beyond what is wrong, or nothing is proven."""
    rng = np.random.default_rng(1)
    matrix = rng.standard_normal((20, 20))
    K = stored(matrix)
    good = whole_spectrum(K)
    _, radius = enclosure(K, *planted(fault, good.values, good.vectors))
    assert good.radius < 1e-12
    assert radius > 1e-3


@pytest.mark.parametrize("kind", ["lattice", "network"])
def test_the_matrix_is_that_of_the_medium(kind):
    from network_samples import random_network
    from samples import random_lattice

    medium = random_lattice((4, 3)) if kind == "lattice" else random_network(3).network
    K = stiffness_matrix(medium)
    assert (K != K.T).nnz == 0
    units = np.eye(medium.balls).reshape(-1, *medium.shape)
    forces = medium.restoring_forces(units).reshape(medium.balls, -1)
    np.testing.assert_allclose(K.toarray(), forces, rtol=0, atol=1e-15 * abs(K).sum(axis=1).max())
