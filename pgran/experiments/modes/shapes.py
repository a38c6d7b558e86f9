"""Normal modes as arrays over the balls: Rayleigh-Ritz, residuals, participation."""

import math

import numpy as np

from pgran.medium.base import einstein_frequency

RESIDUAL = 1e-12  # of |K|: what a mode must meet
# A frequency smaller than this part of what the stiffest bonds make is that of a mode at rest, but
# for rounding; omega_mx may be any number that the user gives.
ZERO = 1e-6


def least_frequency(lattice):
    """Return the frequency up to which a mode is at rest."""
    return ZERO * einstein_frequency(lattice.axes, lattice.stiffest, lattice.mass)


def rayleigh_ritz(lattice, vectors):
    """Return the real modes in the span of complex ones: values ascending, vectors a row each.

    With rows X, orthonormal and spanning whole eigenspaces of a real matrix, the projector on their
    span is real: X^H X = Re(X)^T Re(X) + Im(X)^T Im(X). So the singular values of [Re X; Im X] are
    1, as often as there are rows, and 0: a real orthonormal basis comes without loss of accuracy,
    and no cluster of equal eigenvalues needs to be told from its neighbours.
    """
    count, *shape = vectors.shape
    if count == 0:
        return np.zeros(0), np.zeros((0, *shape))
    parts = np.concatenate([vectors.real, vectors.imag]).reshape(2 * count, -1)
    weights, rotation = np.linalg.eigh(parts @ parts.T)
    ones = weights > 0.1  # fewer than `count` if the rows are not what they should be
    basis = (rotation[:, ones] / np.sqrt(weights[ones])).T @ parts
    forces = lattice.restoring_forces(basis.reshape(-1, *shape)).reshape(basis.shape)
    energy = basis @ forces.T
    values, rotation = np.linalg.eigh(0.5 * (energy + energy.T))
    return values, (rotation.T @ basis).reshape(-1, *shape)


def residuals(lattice, values, vectors):
    """Return |K f - lambda f| of each mode f, a row of `vectors`."""
    residual = lattice.restoring_forces(vectors)
    residual -= values.reshape(-1, *[1] * (vectors.ndim - 1)) * vectors
    return np.sqrt(np.sum(residual**2, axis=tuple(range(1, residual.ndim))))


def with_fixed_sign(vectors):
    """Return modes with their entry of largest magnitude positive."""
    flat = vectors.reshape(len(vectors), math.prod(vectors.shape[1:]))
    largest = np.argmax(np.abs(flat), axis=1)
    signs = np.where(flat[np.arange(len(flat)), largest] < 0, -1.0, 1.0)
    return (signs[:, None] * flat).reshape(vectors.shape)


def participation(lattice, vectors):
    """Return 1 / sum |f_p|^4 of each mode: how many balls take part."""
    squares = lattice.per_ball(vectors * vectors)
    return 1.0 / np.sum(squares * squares, axis=1)
