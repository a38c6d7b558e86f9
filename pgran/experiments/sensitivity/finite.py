"""Amplitudes after finite changes of a few springs, exact, from one steady state.

With the rows U = B_J of r springs J whose kappa = k + s beta d change by Delta, A the amplitudes
before and z a detector's adjoint,

    A'_d = A_d - y^T Delta P^-1 t,    P = I + G Delta,    G = U S^-1 U^T,

t and y being how far A and z stretch these springs, what is driven counted in t. Nothing is
expanded: Delta may be as large as one likes.

Let Q be P^-1 as computed. If F = I - P Q, with what G is wrong by, is at most phi < 1, the true
P^-1 is Q (I - F)^-1, and with v = y^T Delta Q the last term is wrong by at most

    |v| (phi |t| + dt) / (1 - phi) + dy |Delta| |Q| (|t| + dt) / (1 - phi),

dt and dy bounding the errors of t and y in the 2-norm. NumPy only.
"""

import numpy as np

from pgran.medium.rounding import EPSILON


def changed_amplitudes(before, stretched, flexibility, delta):
    """Return the amplitudes after each of many changes, one at a time, and their bounds.

    `before` are the amplitudes without any change and their bounds (nd,); `stretched` t (count, r)
    and its rows' errors (count,), y (nd, count, r) and its rows' errors (nd, count); `flexibility`
    G (count, r, r) and its errors in Frobenius' norm (count,). `delta`, shape (count, r), is zero
    for springs that only fill up a row. Both results have the shape (nd, count), and a bound is
    infinite where P is singular but for rounding.
    """
    (amplitude, amplitude_bound), (G, G_error) = before, flexibility
    t, t_error, y, y_error = stretched
    r, one = delta.shape[-1], np.eye(delta.shape[-1])
    with np.errstate(all="ignore"):
        P = one + G * delta[:, None, :]
        Q, possible = _inverses(P)
        sizes = np.abs(Q)
        rounding = (2 * r + 12) * EPSILON * (_norm(P) + np.sqrt(r)) * _norm(sizes)
        # phi, then the two terms of the bound above
        missed = _norm(one - P @ Q) + rounding + 1.01 * G_error * _norm(delta[:, :, None] * Q)
        v = np.einsum("dnr,nrq->dnq", y * delta, Q)
        after = amplitude[:, None] - np.einsum("dnq,nq->dn", v, t)
        amplified = 1.01 / (1 - missed)
        sizes_t = np.linalg.norm(t, axis=-1)
        theory = np.linalg.norm(v, axis=-1) * (missed * sizes_t + t_error)
        theory += y_error * np.abs(delta).max(axis=-1) * _norm(sizes) * (sizes_t + t_error)
        terms = np.einsum("dnr,nrq,nq->dn", np.abs(y * delta), sizes, np.abs(t))
        bound = amplitude_bound[:, None] + amplified * theory
        bound += 1.01 * EPSILON * ((2 * r + 12) * terms + 4 * np.abs(after))
        bound[:, ~((missed < 1) & possible)] = np.inf
        bound[np.isnan(bound)] = np.inf
    return after, bound


def _norm(matrices):
    """Return the Frobenius norm of each matrix."""
    return np.linalg.norm(matrices, axis=(-2, -1))


def _inverses(P):
    """Return the inverse of each matrix, and which ones have one."""
    try:
        return np.linalg.inv(P), np.ones(len(P), dtype=bool)
    except np.linalg.LinAlgError:  # NumPy gives up all if one is singular
        inverses, possible = np.zeros_like(P), np.linalg.slogdet(P)[0] != 0
        inverses[possible] = np.linalg.inv(P[possible])
        return inverses, possible
