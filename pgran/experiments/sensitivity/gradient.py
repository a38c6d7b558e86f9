"""What an amplitude depends on, and where the sound goes: of every spring, ball, and of damping.

With the amplitudes S A = f, the adjoint S z = e_d of a detector, and how far both stretch the
springs, t = B A + w with the driven balls' motion w, and y = B z (they stay at rest),

    dA_d/dk_b = -y_b t_b,    dA_d/dm_p = -s^2 z_p A_p,    dA_d/dbeta = -s sum_b d_b y_b t_b,

d_b being the part of beta that a spring has. Where loss angles and dashpots depend on k_b, the
first is times dkappa_b/dk_b; drag makes s^2 + s alpha_p of s^2. A is homogeneous of degree 0 in all
constants, masses and dashpots: the sum of each derivative times what it is by, (1 - p) beta of
dashpots (k / k_ref)^p, vanishes (Euler).

Where A and z are known to errors a and c in the 2-norm, y_b t_b is wrong by at most
|b| (|y_b| a + |t_b| c) + |b|^2 a c, and likewise for the rest. NumPy only.
"""

from typing import NamedTuple

import numpy as np

from pgran.medium.rounding import EPSILON, SMALLEST_NORMAL


class Gradient(NamedTuple):
    """Derivatives of the amplitudes at nd detectors for n drives, with the bounds of their errors.

    `springs` (n, nd, springs) by the pulls kappa of all springs at s, `masses` (n, nd, free balls),
    `damping` (n, nd) by beta.
    """

    springs: np.ndarray
    springs_bound: np.ndarray
    masses: np.ndarray
    masses_bound: np.ndarray
    damping: np.ndarray
    damping_bound: np.ndarray


def gradient(medium, s, fields, errors):
    """Return the Gradient of steady states at n values of s.

    Fields, shape (n, 1 + nd, unknowns), are the amplitudes of all unknowns, then the adjoints;
    `errors`, shape (n, 1 + nd), bound their errors in the 2-norm.
    """
    springs, s = medium.springs, s[:, None]
    stretch = _applied(springs.B, fields)
    rounding = (springs.columns.shape[1] + 2) * EPSILON
    errors = (errors + rounding * np.linalg.norm(fields, axis=-1))[..., None]
    # shapes (n, 1, springs), (n, nd, springs), (n, 1, unknowns), (n, nd, unknowns)
    t, y, A, z = stretch[:, :1] + springs.drive, stretch[:, 1:], fields[:, :1], fields[:, 1:]
    products, a, c = t * y, errors[:, :1], errors[:, 1:]
    spring_errors = _product_error(_size(y), _size(t), springs.lengths * c, springs.lengths * a)
    mass_errors = _product_error(_size(z), _size(A), c, a)
    # what rounds while the sum over the springs is formed
    summing = (len(springs.damped) + 8) * EPSILON * (_size(products) @ springs.damped)
    inertia = -(s[..., None] ** 2)
    if medium.drags is not None:  # a number a ball
        inertia = inertia - s[..., None] * medium.drags[:: medium.components]
    inertia = inertia * medium.inertia_ratio
    return Gradient(
        -products,
        spring_errors,
        inertia * _per_ball(medium, z * A),
        np.abs(inertia) * _per_ball(medium, mass_errors),
        -s * (products @ springs.damped),
        np.abs(s) * (spring_errors @ springs.damped + summing + SMALLEST_NORMAL),
    )


def energy_flux(medium, s, fields):
    """Return the mean power through each contact, and what it loses, for drives s = i omega.

    The power that the springs of a contact give to one of its balls is
    -(omega/2) Im(kappa t conj(b u)), kappa = k (1 + i eta) + s beta d and b u the ball's part of
    the stretch; both powers sum up to minus the loss (omega/2) Im(kappa) |t|^2. What flows from the
    first ball to the second is half their difference. What all contacts give to a free ball is what
    its drag takes.

    Fields have the shape (n, unknowns), flux and loss (n, contacts), in units of the constants
    times frequency, for a driven motion of amplitude 1.
    """
    springs, beta, s = medium.springs, medium.damping, s[:, None]
    lossy = s.imag * beta * springs.damped
    if medium.losses is not None:
        lossy = lossy + medium.losses
    t = _applied(springs.B, fields) + springs.drive
    moved = t * (_applied(springs.D, fields) + springs.drive_apart).conj()
    # Im(kappa moved)
    tension = springs.constants * moved.imag + lossy * moved.real
    flux = -0.25 * s.imag * tension
    loss = 0.5 * beta * s.imag**2 * springs.damped * (t.real**2 + t.imag**2)
    if medium.losses is not None:
        loss = loss + 0.5 * s.imag * medium.losses * (t.real**2 + t.imag**2)
    return tuple(x.reshape(len(s), -1, medium.bonds).sum(axis=1) for x in (flux, loss))


def _applied(matrix, fields):
    """Return a sparse matrix times fields (..., unknowns)."""
    flat = fields.reshape(-1, fields.shape[-1])
    return np.ascontiguousarray((matrix @ flat.T).T).reshape(*fields.shape[:-1], -1)


def _per_ball(medium, values):
    """Return sums over the components of each ball of values (..., unknowns)."""
    flat = medium.per_ball(values.reshape(-1, values.shape[-1]))
    return flat.reshape(*values.shape[:-1], -1)


def _size(x):
    """Return no less than magnitudes, which take longer, and less than 1.5 times them."""
    return np.abs(x.real) + np.abs(x.imag)


def _product_error(x, y, x_error, y_error):
    """Return how far a product of numbers of these sizes may be off, its rounding included."""
    error = x * (1.01 * y_error + 16 * EPSILON * y) + 1.01 * x_error * (y + y_error)
    return error + SMALLEST_NORMAL
