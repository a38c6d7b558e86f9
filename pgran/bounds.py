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
        Of a damped lattice.
    """

    def __init__(self, operators):
        """Make the work vectors."""
        self.operators = operators
        self.lambda_min = smallest_damping_eigenvalue(operators.shape)
        # Unit roundoffs in a residual: a product and a sum for each entry of a row, and the
        # combination of the entry itself, all complex.
        self.unit = 2 * (2 * len(operators.shape) + 8) * EPSILON
        self._diagonal = operators.K.getDiagonal()
        self._magnitude, self._terms, self._work = (operators.f.duplicate() for _ in range(3))

    def destroy(self):
        """Free the work vectors. Collective."""
        for held in (self._diagonal, self._magnitude, self._terms, self._work):
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
        x.copy(a)
        a.abs()
        operators.f.copy(terms)
        terms.abs()
        self._work.pointwiseMult(self._diagonal, a)
        terms.axpy(2.0, self._work)
        operators.K.mult(a, self._work)
        terms.axpy(-1.0, self._work)
        damping = omega * operators.damping
        operators.C.mult(a, self._work)
        terms.axpy(-damping, self._work)
        terms.axpy(4 * len(operators.shape) * damping + operators.mass * omega**2, a)
        return terms

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
