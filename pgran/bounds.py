"""Rigorous error bounds of driven amplitudes, rounding included.

S = (K - m omega^2) + i omega beta C with C positive definite, so |x|_C <= |S x|_{C^-1} / (omega
beta) for every x. Take approximate solutions A~ of S A = f and z~ of S z = e_d with residuals r and
s. Because S is symmetric, A_d - (A~_d + z~^T r) = s^T S^-1 r, and so the corrected amplitude
A~_d + z~^T r is wrong by at most |r|_{C^-1} |s|_{C^-1} / (omega beta): a product of two residuals,
each of which needs half the digits only. C is the Laplacian of the uniform lattice, whose smallest
eigenvalue is known, and |r|_{C^-1} <= |r|_2 / sqrt(lambda_min(C)).

Residuals are known up to rounding only; what rounding can change is bounded in terms of
|f| + |S| |A~|, ball by ball, because amplitudes fall by many orders across a lattice.
"""

import math

import numpy as np

from pgran.stiffness import unit_numbers

EPSILON = np.finfo(float).eps


def smallest_damping_eigenvalue(shape):
    """Return lambda_min(C), C the Laplacian of the uniform lattice with walls. Not collective."""
    return sum(4 * math.sin(math.pi / (2 * (n + 1))) ** 2 for n in shape)


class ErrorBounds:
    """Bounds for the steady states of one lattice; destroy with `destroy`.

    Collective.

    Parameters
    ----------
    operators : pgran.operators.Operators

    Attributes
    ----------
    proven : bool
        Whether there is a bound: without damping there is none, but what rounding does to the
        amplitudes can be tried (`random_rounding`).
    """

    def __init__(self, operators):
        """Make the work vectors."""
        self.operators = operators
        self.proven = operators.damping > 0
        self.lambda_min = smallest_damping_eigenvalue(operators.shape)
        # Roundings in a ball's residual, with d axes: 2d - 1 in the diagonal of K, 3 in S, 2d + 4
        # in a row of complex products and its difference from f; each at most EPSILON / 2.
        self.unit = (2 * len(operators.shape) + 4) * EPSILON
        vectors = [operators.f.duplicate() for _ in range(4)]
        self._diagonal, self._magnitude, self._terms, self._work = vectors
        self._signs = None
        if not self.proven:
            signs = np.where(unit_numbers(0, 0, operators.balls) < 0.5, -1.0, 1.0)
            self._signs = operators.vector(signs.reshape(operators.shape))

    def destroy(self):
        """Free the work vectors. Collective."""
        for held in (self._diagonal, self._magnitude, self._terms, self._work, self._signs):
            if held is not None:
                held.destroy()

    def stability(self, omega):
        """Return the c > 0 with |S x|_2 >= c |x|_2 for every x. Not collective."""
        return self.lambda_min * omega * self.operators.damping

    def rounding(self, omega, x):
        """Return |f| + |S| |x|, ball by ball, in a vector that the next call overwrites.

        Collective. The diagonal of a Laplacian holds the sum of its row's magnitudes, so that
        |K| |x| = 2 diag(K) |x| - K |x|, and likewise for C.
        """
        operators, a, terms = self.operators, self._magnitude, self._terms
        operators.K.getDiagonal(self._diagonal)
        x.copy(a)
        a.abs()
        operators.f.copy(terms)
        terms.abs()
        self._work.pointwiseMult(self._diagonal, a)
        terms.axpy(2.0, self._work)
        operators.K.mult(a, self._work)
        terms.axpy(-1.0, self._work)
        damping = omega * operators.damping
        if operators.C is not None:
            operators.C.mult(a, self._work)
            terms.axpy(-damping, self._work)
        terms.axpy(4 * len(operators.shape) * damping + operators.mass * omega**2, a)
        return terms

    def random_rounding(self):
        """Return a residual as rounding leaves it, of random signs; the next call overwrites it.

        Collective; `rounding` must have been called for the primal solution.
        """
        self._work.pointwiseMult(self._terms, self._signs)
        self._work.scale(self.unit)
        return self._work

    def amplitude(self, omega, scale, primal, adjoint, value):
        """Return the bound of one corrected amplitude, relative to the driven wall's.

        Collective; `rounding` must have been called for the primal solution.

        Parameters
        ----------
        omega : float
        scale : float
            |S|_inf.
        primal, adjoint : pgran.steady.System
            A~ with r, and z~ with s.
        value : complex
            The corrected amplitude A~_d + z~^T r.
        """
        terms, z = self._terms, self._magnitude
        adjoint.solution.copy(z)
        size = z.norm()
        z.abs()
        r = primal.norm + self.unit * terms.norm()
        s = adjoint.norm + self.unit * (1.0 + scale * size)
        evaluation = self.unit * abs(z.dot(terms)) + self.operators.balls * EPSILON * size * r
        # The last digits cover the rounding of this very formula.
        return 1.01 * (r * s / self.stability(omega) + evaluation) + 4 * EPSILON * abs(value)

    def field(self, omega, primal):
        """Return a bound of the error of the whole field, in the 2-norm.

        Collective; `rounding` must have been called for the primal solution.
        """
        residual = primal.norm + self.unit * self._terms.norm()
        return 1.01 * residual / self.stability(omega)
