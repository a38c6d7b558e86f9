"""Rigorous error bounds of driven amplitudes, rounding included.

S(s) = K + i L + s beta C + s^2 m with C and L positive definite and K semidefinite; drag is a part
of C. For s = sigma + i omega

    Re(conj(s) x^H S x) = sigma x^H K x + omega x^H L x + |s|^2 (beta x^H C x + sigma m x^H x),

so that |S x|_2 >= c |x|_2 with c = |s| (beta lambda_min(C) + sigma m) + omega lambda_min(L) / |s|
wherever sigma >= 0; where springs of negative constants may make K indefinite, c loses
sigma |lambda_min(K)| / |s|. Where all dashpots are alike C is the Laplacian of the uniform lattice,
whose smallest eigenvalue is known.

Take approximate solutions A~ of S A = f and z~ of S z = e_d with residuals r and q. Because S is
symmetric, A_d - (A~_d + z~^T r) = q^T S^-1 r, and so the corrected amplitude A~_d + z~^T r is wrong
by at most |r|_2 |q|_2 / c: a product of two residuals, each of which needs half the digits only.

Without damping, at s = i omega, |x|_2 <= |S x|_2 / delta, delta the distance of m omega^2 to the
nearest eigenvalue of K; with very little damping delta - omega beta |C| still does better than
damping alone. That no eigenvalue is nearer than delta is certified by counting those below
m omega^2 - delta and below m omega^2 + delta (`counting`). Where all this proves nothing, or too
little, `sharpen` counts how near to singular S itself is, whatever damps (`singular`).

Residuals are known up to rounding only; what rounding can change is bounded in terms of
|f| + |S| |A~|, ball by ball, because amplitudes fall by many orders across a lattice. What is lost
below the smallest normal double, of a square above all, is counted too.

Where the product of norms says too little, `comparison` bounds the errors ball by ball.
"""

import logging
import math
from functools import cached_property

import numpy as np

from pgran.driven.certify import smallest_damping, smallest_loss, smallest_stiffness
from pgran.driven.counting import ModeCounter
from pgran.driven.inertia import complex_matrix
from pgran.driven.linear import FACTORIZATIONS
from pgran.driven.operators import Owner
from pgran.driven.singular import least_estimate, proven_least
from pgran.medium.base import EPSILON, SMALLEST_NORMAL
from pgran.medium.law import unit_numbers

log = logging.getLogger("pgran")

WORTHWHILE = 2.0  # times as sharp a bound of |S^-1| is worth a count


class ErrorBounds(Owner):
    """Bounds for the steady states of one lattice; destroy with `destroy`. Collective.

    At the s of the last `prepare`, at first for s = i omega, |S^-1|_2 is at most `inverse_norm`,
    NaN where unknown, and the 2-norm of |S|, taken entry by entry, at most `scale`. `proven` says
    that there is a bound: proven by damping or sigma, or certified by counts. Without damping there
    is none at s = i omega where ranks share the lattice, because eigenvalues are counted serially;
    but what rounding does to the amplitudes can be tried (`random_rounding`).
    """

    owns = ("_product", "_work", "_counter")

    def __init__(self, operators):
        self.operators = operators
        self._alone = operators.comm.size == 1
        self._always = self.proven = self._alone or operators.lattice.dissipates
        self.unit, self._told = operators.rounding, False
        # What a 2-norm may miss because the squares of small numbers are lost.
        self.lost = 2 * math.sqrt(2 * operators.size * SMALLEST_NORMAL)
        self._product, self._work = operators.f.duplicate(), operators.f.duplicate()

    @cached_property
    def _counter(self):
        """What counts eigenvalues of K."""
        return ModeCounter(self.operators.K, self.operators.lattice)

    @cached_property
    def _signs(self):
        """A random sign for each of this rank's balls."""
        signs = np.where(unit_numbers(0, 0, self.operators.size) < 0.5, -1.0, 1.0)
        return self.operators.layout.free_values(signs.reshape(self.operators.shape))

    def stability(self, s):
        """Return a c with |S x|_2 >= c |x|_2 for every x; 0 if none is certain."""
        damping = self.operators.damping and self.operators.damping * (
            abs(s) * smallest_damping(self.operators.lattice)
        )
        least = damping + abs(s) * s.real * self.operators.mass
        if s:
            least += s.imag / abs(s) * smallest_loss(self.operators.lattice)
        if s.real > 0:
            least += s.real / abs(s) * smallest_stiffness(self.operators)
        return max(least, 0.0)

    def prepare(self, s, tolerance):
        """Bound the norms of S(s), which must be combined, and of its inverse.

        Collective; `tolerance` is the relative accuracy that will be asked of amplitudes.
        """
        operators, size = self.operators, abs(s)
        self.proven = self._always or s.real > 0
        inertia = operators.mass * size * size
        spread = size * operators.damping  # |s beta C| is at most this
        spread *= operators.lattice.damping_norm if spread else 0.0
        self.scale = 1.01 * (operators.stiffness_norm + spread + inertia)
        self._combine_sizes(s)
        self._imaginary = s.imag / (size + s.real) if s else 0.0
        stability = self.stability(s) if self.proven else math.nan
        if self._alone and s.real == 0 and np.isrealobj(operators.constants):
            stability = max(stability, self._distance(inertia, spread, tolerance) - spread)
        self.inverse_norm = 1.0 / stability if stability else math.inf
        if not self._alone and not stability and not self._told:
            self._told = True
            log.warning(
                "some motions are undamped: where ranks share a medium no error bound is proven, "
                "and amplitudes are marked; -ranks_per_lattice 1 and damped = all give bounds"
            )

    def sharpen(self, krylov, needed):
        """Bound |S^-1| by a count of S itself, where no rank shares it; say if that helps.

        `krylov` has factored S. The bound is about 1.2 times |S^-1|; what cannot become `needed`
        times as sharp by it is left as it is.
        """
        if not self._alone or krylov.pc.getType() not in FACTORIZATIONS:
            return False
        x, y = self._work, self._product

        def solve(b):
            x.setArray(b)
            krylov.pc.apply(x, y)
            return y.getArray(readonly=True).copy()

        wanted = max(needed, WORTHWHILE) / self.inverse_norm
        guess = 0.9 * least_estimate(solve, self.operators.size, wanted)
        if not guess > wanted:
            return False
        S = complex_matrix(self.operators.S)
        least = proven_least(S, guess, self.unit * self.scale)
        if least * self.inverse_norm > 1:
            self.inverse_norm = 1.0 / least
            return True
        return False

    def _combine_sizes(self, s):
        """Combine |f|, and what `rounding` multiplies |x| by besides matrices."""
        operators, size = self.operators, abs(s)
        damping, inertia = size * operators.damping, operators.mass * size * size
        if operators.laplacian:
            stiff, damped = operators.doubled_diagonals
            self._weights = stiff + damping * damped
            if s.real:
                self._weights += 2 * s.real * size * operators.mass
            self._force = np.abs(operators.f.getArray(readonly=True))
            return
        K, drive, *damped = operators.sizes
        self._weights, self._force = inertia, drive.getArray(readonly=True).real.copy()
        self._sizes = [(1.0, K)]
        if damped:
            self._sizes.append((damping, damped[0]))
            self._force += damping * damped[1].getArray(readonly=True).real

    def _distance(self, shift, spread, tolerance):
        """Return how far all eigenvalues of K are from a shift, at least; 0 if it is no use.

        The first guess is a tenth of their mean distance. It is no use where damping spreads
        eigenvalues as far, or rounding S moves amplitudes by more than the tolerance.
        """
        least = max(EPSILON / tolerance, 10 * self.unit) * self.scale + 10 * spread
        delta = 0.1 * self.scale / self.operators.size
        while 0 < least <= delta < math.inf:  # S may be zero
            if self._counter.below(shift, delta) is not None:
                # Each count is of a matrix nearer to K - shift than delta / 10; K is rounded, too.
                return 0.8 * delta
            delta *= 0.1
        return 0.0

    def rounding(self, x):
        """Return |f| + (|K| + |s| beta |C| + |s|^2 m) |x| for each of this rank's balls.

        Collective.
        """
        return self._force + self.product_sizes(x)

    def product_sizes(self, x):
        """Return (|K| + |s| beta |C| + |s|^2 m) |x| for each of this rank's balls. Collective."""
        a = np.abs(x.getArray(readonly=True))
        self._work.setArray(a)

        def times_a(matrix):
            matrix.mult(self._work, self._product)
            return self._product.getArray(readonly=True)

        return self.magnitudes(a, times_a)

    def magnitudes(self, a, times_a):
        """Return (|K| + |s| beta |C| + |s|^2 m) a for this rank's rows of nonnegative numbers a.

        Collective; a has one column, or several, and `times_a` returns a matrix times a. With
        |K| a = 2 diag(K) a - K a of a Laplacian, and likewise for C, one product gives both: with
        t = omega / (|s| + sigma), which is 1 for s = i omega,

            Re(S a) + t Im(S a) = K a + |s| beta C a + (2 sigma |s| - |s|^2) m a.
        """
        terms = (self._weights * a.T).T  # row by row
        if not self.operators.laplacian:
            for factor, sizes in self._sizes:
                terms += factor * times_a(sizes).real
            return terms
        product = times_a(self.operators.S)
        return terms - product.real - self._imaginary * product.imag

    def random_rounding(self, terms):
        """Return a residual as rounding leaves it, of random signs, from the `rounding` of A~.

        Collective; the next call overwrites it.
        """
        self._work.setArray(self.unit * terms * self._signs)
        return self._work

    def primal_residual(self, primal, terms):
        """Return a bound of |f - S A~|_2; `terms` is the `rounding` of A~. Collective."""
        return primal.norm + self.unit * math.sqrt(self._total(terms @ terms)) + self.lost

    def residuals(self, primal):
        """Return a positive bound of |f - S A~| at each of this rank's balls. Collective."""
        size = np.abs(primal.residual.getArray(readonly=True))
        return size + self.unit * self.rounding(primal.solution) + 64 * SMALLEST_NORMAL

    def adjoint_residual(self, adjoint):
        """Return a bound of |e_d - S z~|_2, rounding included. Collective."""
        size = adjoint.solution.norm() + self.lost
        return adjoint.norm + self.unit * (adjoint.rhs.norm() + self.scale * size) + self.lost

    def evaluation(self, residual, terms, adjoint, value):
        """Return a bound of what rounding does to A~_d + z~^T r, the `value`, in evaluating it.

        Collective. `residual` and `terms` are the `primal_residual` and the `rounding` of A~;
        `adjoint` is the system of z~.
        """
        z = np.abs(adjoint.solution.getArray(readonly=True))
        sums = self.unit * self._total(z @ terms)
        product = (self.operators.size + 2) * EPSILON * residual * adjoint.solution.norm()
        # What a product loses; what residuals lose, times z, `product` holds by their own `lost`.
        lost = 16 * self.operators.size * SMALLEST_NORMAL
        return 1.01 * (sums + product) + 4 * EPSILON * abs(value) + lost

    def amplitude(self, residual, missed, terms, adjoint, value):
        """Return the bound of a corrected amplitude, from what `evaluation` takes. Collective.

        `missed` is the `adjoint_residual`.
        """
        # The last digits cover the rounding of this very formula.
        theory = 1.01 * residual * missed * self.inverse_norm
        return theory + self.evaluation(residual, terms, adjoint, value)

    def reaction(self, residual, primal, value):
        """Return the bound of f^T A, evaluated as f^T A~ + A~^T r, which misses r^T S^-1 r.

        Collective. What rounding does to r and f, ball by ball, `residual` holds as a norm.
        """
        theory = residual * residual * self.inverse_norm
        force, rounded = primal.rhs.norm(), 2 * (residual - primal.norm)
        rounded += (self.operators.size + 8) * EPSILON * (force + residual)
        lost = 32 * self.operators.size * SMALLEST_NORMAL
        return 1.01 * (theory + primal.solution.norm() * rounded) + 4 * EPSILON * abs(value) + lost

    def _total(self, number):
        """Return the sum of a number over the ranks of the lattice. Collective."""
        return number if self._alone else self.operators.comm.allreduce(number)
