"""Normal modes as arrays over the balls: forces, Rayleigh-Ritz, residuals, participation."""

import math

import numpy as np

from pgran.physics.lattice import spread, stretch

RESIDUAL = 1e-12  # of |K|: what a mode must meet


def restoring_forces(stiffness, fields):
    """Return K f = B^T diag(k) B f for fields of shape (count, *shape). Not collective."""
    stretches = stretch(fields, len(stiffness))
    return spread(k * t for k, t in zip(stiffness, stretches, strict=True))


def rayleigh_ritz(stiffness, vectors):
    """Return the real modes in the span of complex ones.

    Not collective. With rows X, orthonormal and spanning whole eigenspaces of a real matrix, the
    projector on their span is real: X^H X = Re(X)^T Re(X) + Im(X)^T Im(X). So the singular values
    of [Re X; Im X] are 1, as often as there are rows, and 0: a real orthonormal basis comes without
    loss of accuracy, and no cluster of equal eigenvalues needs to be told from its neighbours.

    Returns
    -------
    values : numpy.ndarray, shape (count,)
        Ascending.
    vectors : numpy.ndarray of float, shape (count, *shape)
    """
    count, *shape = vectors.shape
    if count == 0:
        return np.zeros(0), np.zeros((0, *shape))
    parts = np.concatenate([vectors.real, vectors.imag]).reshape(2 * count, -1)
    weights, rotation = np.linalg.eigh(parts @ parts.T)
    kept = weights > 0.1  # fewer than `count` if the rows are not what they should be
    basis = (rotation[:, kept] / np.sqrt(weights[kept])).T @ parts
    forces = restoring_forces(stiffness, basis.reshape(-1, *shape)).reshape(basis.shape)
    energy = basis @ forces.T
    values, rotation = np.linalg.eigh(0.5 * (energy + energy.T))
    return values, (rotation.T @ basis).reshape(-1, *shape)


def residuals(stiffness, values, vectors):
    """Return |K f - lambda f| of each mode.

    Not collective.

    Parameters
    ----------
    stiffness : tuple of numpy.ndarray
    values : numpy.ndarray, shape (nm,)
        lambda.
    vectors : numpy.ndarray, shape (nm, *shape)
    """
    missed = restoring_forces(stiffness, vectors)
    missed -= values.reshape(-1, *[1] * len(stiffness)) * vectors
    return np.sqrt(np.sum(missed**2, axis=tuple(range(1, missed.ndim))))


def with_fixed_sign(vectors):
    """Return modes with their entry of largest magnitude positive. Not collective."""
    flat = vectors.reshape(len(vectors), math.prod(vectors.shape[1:]))
    largest = np.argmax(np.abs(flat), axis=1)
    signs = np.where(flat[np.arange(len(flat)), largest] < 0, -1.0, 1.0)
    return (signs[:, None] * flat).reshape(vectors.shape)


def participation(vectors):
    """Return 1 / sum f^4 of each mode: how many balls take part. Not collective."""
    squares = vectors * vectors
    return 1.0 / np.sum(squares * squares, axis=tuple(range(1, vectors.ndim)))
