"""The algebra of a window of changes among its bonds alone, with what rounding does to it.

NumPy only; the formulas are those of `pgran.experiments.relaxation.windows`.
"""

import numpy as np

from pgran.medium.base import EPSILON, SMALLEST_NORMAL


def march(G, delta):
    """Change one bond after the other; return T (s, s) and c (s,): how each deforms the lattice.

    G (s, s) is b^T S0^-1 b' of the bonds before any change, `delta` (s,) by how much each changes.
    S^-1 b_t = S0^-1 B T[:, t] once the bonds before t have changed; c is delta / (1 + delta b^T
    S^-1 b). T is the inverse, column by column, of the factor L^T in the L D L^T factorization of
    diag(1/delta) + G, whose leading blocks are the networks after each step.
    """
    steps = len(delta)
    T, (c, row) = np.eye(steps, dtype=complex), np.zeros((2, steps), dtype=complex)
    with np.errstate(all="ignore"):  # what is not finite has no bound
        for t in range(steps):  # b_t^T S_t^-1 b_t follows from the changes before t
            before = T[:t, :t]
            row[:t] = G[t, :t] @ before
            along = -c * row
            T[:t, t] = before @ along[:t]
            c[t] = delta[t] / (1.0 + delta[t] * (G[t, t] + row @ along))
    return T, c


class Deformation:
    """How a field x, of amplitudes or an adjoint, follows the changes: x = x0 + Y a.

    T, c, G and delta are those of `march`. `start` (s,) is b^T x0 with all walls at rest, and
    `wall` is how far what is driven lengthens each bond. `rows` are the largest |b|_2 of a bond,
    and what rounding adds to b^T x in units of |x|_2; `sizes` are no less than |x0|_2, and than the
    norms of Y's columns.

    Of each bond after each step, (s, s), `coefficients` are a (gamma of the amplitudes, eta of an
    adjoint), `stretch` is t = b^T x = b^T x0 + G a, a moving wall counted, and `missed` is
    a + Delta t (h of the amplitudes, g of an adjoint), zero but for the errors of the algebra.
    """

    def __init__(self, T, c, G, delta, start, rows, sizes, wall=0.0):
        self.start, steps = start + wall, len(delta)
        upper = np.tri(steps).T  # bonds change one after the other
        self.coefficients = np.cumsum(T * (-c * (self.start @ T)), axis=1)
        self.coefficient_sizes = np.abs(self.coefficients)
        self.stretch = self.start[:, None] + G @ self.coefficients
        self.missed = upper * (self.coefficients + delta[:, None] * self.stretch)
        self.missed_sizes = np.abs(self.missed)
        self._changes = np.abs(delta)[:, None] * upper
        self._norm = np.sqrt(squares(self.coefficients)) + np.sqrt(2 * steps * SMALLEST_NORMAL)
        # Displacements of bonds are differences, rounded once; then come s products and sums.
        self._rounding = (steps + 8) * EPSILON * np.sqrt(squares(G.T))
        self._rounding_of_start = EPSILON * (4 * np.abs(self.start) + np.abs(wall))
        self._bond, loose = rows
        self._loose = loose * (sizes[0] + sizes[1] @ self.coefficient_sizes)

    def stretch_rounding(self, weights):
        """Bound, step by step, the rounding of a sum of weights times stretches."""
        rounding = (self._rounding @ weights) * self._norm + self._rounding_of_start @ weights
        return rounding + self._loose * weights.sum(axis=0)

    def missed_rounding(self, weights):
        """Bound the same for weights times `missed`."""
        changed = self.stretch_rounding(self._changes * weights)
        return changed + 2 * EPSILON * _column_sums(weights, self.coefficient_sizes)

    def residual(self, start, columns):
        """Return bounds of a residual after each step, by those at the start and of Y's columns."""
        rounding = self.missed_rounding(np.ones(self.missed.shape))
        missed = np.sum(self.missed_sizes, axis=0) + rounding
        return start + columns @ self.coefficient_sizes + self._bond * missed


def amplitudes(before, primal, adjoint):
    """Return A_d + q^T gamma - (q + G eta)^T h after each step, and bounds of its rounding.

    `before` is A_d; the deformations are those of the amplitudes and of the adjoint.
    """
    missed = np.sum(adjoint.stretch * primal.missed, axis=0)
    amplitude = before + adjoint.start @ primal.coefficients - missed
    sizes = np.abs(adjoint.stretch)
    products = np.abs(adjoint.start) @ primal.coefficient_sizes
    products = products + _column_sums(sizes, primal.missed_sizes)
    rounding = EPSILON * (len(products) + 6) * products
    rounding += primal.missed_rounding(sizes) + adjoint.stretch_rounding(primal.missed_sizes)
    return amplitude, rounding + 4 * EPSILON * np.abs(amplitude)


def squares(columns):
    """Return the sum of squares of each column of this rank's part of a block."""
    rows = np.ascontiguousarray(columns.T).view(float)
    return np.einsum("ij,ij->i", rows, rows)


def _column_sums(a, b):
    """Return the sum of products down each column."""
    return np.einsum("it,it->t", a, b)
