"""How far off driven amplitudes are: rigorous bounds of their errors, rounding included.

S(s) = K + i L + s beta C + s^2 m with C and L positive definite and K semidefinite; drag is a part
of C. For s = sigma + i omega

    Re(conj(s) x^H S x) = sigma x^H K x + omega x^H L x + |s|^2 (beta x^H C x + sigma m x^H x),

so that |S x|_2 >= c |x|_2 with c = |s| (beta lambda_min(C) + sigma m) + omega lambda_min(L) / |s|
wherever sigma >= 0; where springs of negative constants may make K indefinite, c loses
sigma |lambda_min(K)| / |s|. Where all dashpots are alike C is the Laplacian of the uniform lattice,
whose smallest eigenvalue is known. Without damping, at s = i omega, |x|_2 <= |S x|_2 / delta, delta
the distance of m omega^2 to the nearest eigenvalue of K; with very little damping delta - omega
beta |C| still does better than damping alone. That no eigenvalue is nearer than delta is certified
by counting those below m omega^2 - delta and below m omega^2 + delta (`counting`). Where all this
proves nothing, or too little, S itself is counted, whatever damps (`factors`).

Take approximate solutions A~ of S A = f and z~ of S z = e_d with residuals r and q. Because S is
symmetric, A_d - (A~_d + z~^T r) = q^T S^-1 r, and so the corrected amplitude A~_d + z~^T r is wrong
by at most |r|_2 |q|_2 / c: a product of two residuals, each of which needs half the digits only.
They are known up to rounding; what that can change is bounded in terms of |f| + |S| |A~|, ball by
ball, because amplitudes fall by many orders across a lattice. What is lost below the smallest
normal double, of a square above all, is counted too.

Where the product of norms says too little, `comparison` bounds the errors ball by ball.
"""

import logging
import math
from functools import cached_property
from typing import NamedTuple

import numpy as np
from mpi4py import MPI

from pgran.driven.amplitudes import is_accurate
from pgran.driven.counting import (
    ModeCounter,
    complex_matrix,
    smallest_damping,
    smallest_loss,
    smallest_stiffness,
)
from pgran.driven.linear import FACTORIZATIONS, LEAST_NORM
from pgran.driven.operators import Owner
from pgran.medium.base import EPSILON, SMALLEST_NORMAL
from pgran.medium.law import unit_numbers
from pgran.run.petsc import PETSc, logged
from pgran.store.record import ball_names

log = logging.getLogger("pgran")

# Where no bound is known the residual must be of the size of rounding, and so must be what this
# many times as much rounding does to the amplitudes.
BACKWARD_ERROR, ROUNDING_TRIED = 1e-12, 10.0
WORTHWHILE = 2.0  # times as sharp a bound of |S^-1| is worth a count
SOLVED = int(PETSc.KSP.ConvergedReason.CONVERGED_ATOL)  # where no KSP had to iterate


class SteadyState(NamedTuple):
    """A medium driven at one s = sigma + i omega; NaN is unknown, or was not asked for."""

    s: complex
    # Of each detector, shape (nd,), the complex amplitude relative to the driven wall's, NaN where
    # PETSc fails, and a bound of its error: unknown for an undamped lattice that ranks share at
    # sigma = 0, where rounding is tried instead.
    displacement: np.ndarray
    error_bound: np.ndarray
    backward_error: float  # |f - S A| / (|S| |A| + |f|)
    iterations: int  # of Krylov's method, those of the adjoints included
    # Positive if every amplitude is as accurate as asked, or is below the floor with its bound;
    # else 0 or PETSc's negative KSP reason.
    converged_reason: int
    field_bound: float  # of the error of the whole field, in the 2-norm
    # If derivatives are asked for: d displacement / d omega, shape (nd,), and f^T A, the force that
    # balls take off what moves the wall by 1; each with a bound of its error.
    derivative: np.ndarray | None = None
    derivative_bound: np.ndarray | None = None
    reaction: complex | None = None
    reaction_bound: float | None = None


class Accuracy(Owner):
    """Bounds the errors of the steady states of one lattice, and judges them. Collective.

    Amplitudes of the detectors at `sites` are to have the relative `tolerance` or a bound below the
    `floor`, with `whole_field` the field the tolerance in the 2-norm. At the s of the last
    `prepare`, |S^-1|_2 is at most `inverse_norm`, NaN where unknown, and the 2-norm of |S|, taken
    entry by entry, at most `scale`; rounding changes a residual by `unit` times the magnitudes that
    it is summed from. `proven` says that there is a bound: proven by damping or sigma, or certified
    by counts. Without damping there is none at s = i omega where ranks share the lattice, because
    eigenvalues are counted serially; but what rounding does to the amplitudes can be tried.
    """

    owns = ("_product", "_work", "_counter", "comparison")

    def __init__(self, operators, sites, tolerance, floor=0.0, whole_field=False):
        self.operators, self.detectors = operators, Detectors(operators, sites)
        self.tolerance, self.floor, self.whole_field = tolerance, floor, whole_field
        self._alone = operators.comm.size == 1
        self._always = self.proven = self._alone or operators.lattice.dissipates
        self.unit, self._told = operators.rounding, False
        self._residual = self.inverse_norm = math.nan  # until something is solved
        # What a 2-norm may miss because the squares of small numbers are lost.
        self.lost = 2 * math.sqrt(2 * operators.size * SMALLEST_NORMAL)
        self._product, self._work = operators.f.duplicate(), operators.f.duplicate()

    @cached_property
    def _counter(self):
        """What counts eigenvalues of K."""
        return ModeCounter(self.operators.K, self.operators.lattice)

    @cached_property
    def comparison(self):
        """What bounds ball by ball. Collective when first asked for."""
        from pgran.driven.comparison import Comparison

        return Comparison(self.operators)

    def forget_factors(self):
        """Free what PETSc may have marked as failed for good. Collective."""
        if "comparison" in vars(self):
            self.comparison.forget("_ksp", "_matrix")

    # How near to singular S is.

    @logged("bounds")
    def prepare(self, s):
        """Bound the norms of S(s), which must be combined, and of its inverse. Collective."""
        operators, size = self.operators, abs(s)
        self.proven, self._residual = self._always or s.real > 0, math.nan
        inertia = operators.mass * size * size
        spread = size * operators.damping  # |s beta C| is at most this
        spread *= operators.lattice.damping_norm if spread else 0.0
        self.scale = 1.01 * (operators.stiffness_norm + spread + inertia)
        self._combine_sizes(s)
        stability = self.stability(s) if self.proven else math.nan
        if self._alone and s.real == 0 and np.isrealobj(operators.constants):
            stability = max(stability, self._distance(inertia, spread) - spread)
        self.inverse_norm = 1.0 / stability if stability else math.inf
        if not self._alone and not stability and not self._told:
            self._told = True
            log.warning(
                "some motions are undamped: where ranks share a medium no error bound is proven, "
                "and amplitudes are marked; -ranks_per_lattice 1 and damped = all give bounds"
            )

    def stability(self, s):
        """Return a c with |S x|_2 >= c |x|_2 for every x; 0 if none is certain."""
        operators, size = self.operators, abs(s)
        least = 0.0
        if operators.damping:
            least = operators.damping * (size * smallest_damping(operators.lattice))
        least += size * s.real * operators.mass
        if s:
            least += s.imag / size * smallest_loss(operators.lattice)
        if s.real > 0:
            least += s.real / size * smallest_stiffness(operators)
        return max(least, 0.0)

    def _distance(self, shift, spread):
        """Return how far all eigenvalues of K are from a shift, at least; 0 if it is no use."""
        # It is none where damping spreads eigenvalues as far, or rounding S moves amplitudes by
        # more than the tolerance. The first guess is a tenth of the eigenvalues' mean distance.
        least = max(EPSILON / self.tolerance, 10 * self.unit) * self.scale + 10 * spread
        delta = 0.1 * self.scale / self.operators.size
        while 0 < least <= delta < math.inf:  # S may be zero
            if self._counter.below(shift, delta) is not None:
                # Each count is of a matrix nearer to K - shift than delta / 10; K is rounded, too.
                return 0.8 * delta
            delta *= 0.1
        return 0.0

    @logged("bounds")
    def sharpen(self, krylov, needed):
        """Bound |S^-1| by a count of S itself, where no rank shares it; say if that helps.

        Only where it may become `needed` times as sharp, about 1.2 times |S^-1|; `krylov` has
        factored S.
        """
        if not self._alone or krylov.pc.getType() not in FACTORIZATIONS:
            return False
        from pgran.driven.factors import least_estimate, proven_least

        x, y = self._work, self._product

        def solve(b):
            x.setArray(b)
            krylov.pc.apply(x, y)
            return y.getArray(readonly=True).copy()

        wanted = max(needed, WORTHWHILE) / self.inverse_norm
        guess = 0.9 * least_estimate(solve, self.operators.size, wanted)
        if not guess > wanted:
            return False
        least = proven_least(complex_matrix(self.operators.S), guess, self.unit * self.scale)
        if least * self.inverse_norm > 1:
            self.inverse_norm = 1.0 / least
            return True
        return False

    # What rounding changes.

    def _combine_sizes(self, s):
        """Combine |f|, and what `rounding` multiplies |x| by besides matrices."""
        operators, size = self.operators, abs(s)
        damping, inertia = size * operators.damping, operators.mass * size * size
        self._imaginary = s.imag / (size + s.real) if s else 0.0
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

    def rounding(self, x):
        """Return |f| + (|K| + |s| beta |C| + |s|^2 m) |x| of this rank's rows. Collective."""
        return self._force + self.product_sizes(x)

    def product_sizes(self, x):
        """Return (|K| + |s| beta |C| + |s|^2 m) |x| of this rank's rows. Collective."""
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

    @property
    def field_error(self):
        """A bound of the error of the whole field last assessed, in the 2-norm; NaN: unknown."""
        return 1.01 * self._residual * self.inverse_norm if self.proven else math.nan

    # What residuals tell.

    @logged("bounds")
    def assess(self, s, systems, krylov):
        """Return the state reached, its bounds, and whether they meet the tolerance. Collective.

        `krylov` has solved the `systems`: that of the amplitudes, then each detector's adjoint,
        none where no bound is known.
        """
        primal, *adjoints = systems
        displacement, size = self.detectors.read(primal.solution), primal.solution.norm()
        bound, field_bound = np.full(len(displacement), math.nan), math.nan
        backward_error = primal.norm / max(self.scale * size + primal.rhs.norm(), LEAST_NORM)
        terms = self.rounding(primal.solution)
        if self.proven:
            self._residual = self.primal_residual(primal, terms)
            self._missed = [self.adjoint_residual(adjoint) for adjoint in adjoints]
            for d, adjoint in enumerate(adjoints):
                displacement[d] += adjoint.solution.tDot(primal.residual)
                # The last digits cover the rounding of this very formula.
                theory = 1.01 * self._residual * self._missed[d] * self.inverse_norm
                rounding = self.evaluation(self._residual, terms, adjoint, displacement[d])
                bound[d] = theory + rounding
            if self.whole_field:
                field_bound = self.field_error
        numbers = displacement, bound, backward_error, krylov.iterations
        state = SteadyState(s, *numbers, converged_reason=0, field_bound=field_bound)
        if self.proven:
            return self.judged(state, primal, krylov)
        good = backward_error <= BACKWARD_ERROR and np.isfinite(displacement).all()
        good = good and self._withstands_rounding(displacement, terms, size, krylov)
        return state._replace(converged_reason=_reason(good, krylov.reason))

    def judged(self, state, primal, krylov, floor=0.0):
        """Return a state judged by its accuracy, or by a floor of its bounds. Collective."""
        bound, displacement = state.error_bound, state.displacement
        good = is_accurate(bound, displacement, self.tolerance) | (bound <= floor)
        good = np.all(good & np.isfinite(displacement))
        if self.whole_field:
            size = primal.solution.norm()
            good = good and is_accurate(state.field_bound, size, self.tolerance)
        return state._replace(converged_reason=_reason(good, krylov.reason))

    def primal_residual(self, primal, terms):
        """Return a bound of |f - S A~|_2; `terms` is the `rounding` of A~. Collective."""
        return primal.norm + self.unit * math.sqrt(self._total(terms @ terms)) + self.lost

    def adjoint_residual(self, adjoint):
        """Return a bound of |e_d - S z~|_2, rounding included. Collective."""
        size = adjoint.solution.norm() + self.lost
        return adjoint.norm + self.unit * (adjoint.rhs.norm() + self.scale * size) + self.lost

    def evaluation(self, residual, terms, adjoint, value):
        """Return a bound of what rounding does to A~_d + z~^T r, the `value`. Collective."""
        z = np.abs(adjoint.solution.getArray(readonly=True))
        sums = self.unit * self._total(z @ terms)
        product = (self.operators.size + 2) * EPSILON * residual * adjoint.solution.norm()
        # What a product loses; what residuals lose, times z, `product` holds by their own `lost`.
        lost = 16 * self.operators.size * SMALLEST_NORMAL
        return 1.01 * (sums + product) + 4 * EPSILON * abs(value) + lost

    def _withstands_rounding(self, displacement, terms, size, krylov):
        """Return whether a residual as rounding leaves it, of random signs, changes too little."""
        # by sizes that differ, too: plain signs may be orthogonal to a mode of a uniform lattice
        draws = unit_numbers(0, 0, self.operators.size) - 0.5
        draws = (np.copysign(0.5, draws) + 2 * draws).reshape(self.operators.shape)
        self._work.setArray(self.unit * terms * self.operators.layout.free_values(draws))
        moved = krylov.roughly_solved(self._work)
        if moved is None:
            return False
        allowed = self.tolerance / ROUNDING_TRIED
        # an amplitude may have vanished
        differences = np.abs(self.detectors.read(moved)) + SMALLEST_NORMAL
        good = np.all(differences <= allowed * np.abs(displacement))
        return bool(good and (not self.whole_field or moved.norm() <= allowed * size))

    def with_derivatives(self, state, systems):
        """Return a state with the derivatives dA_d/domega, the reaction f^T A, and their bounds.

        After `assess`. Collective. With S' = C + 2 s M, all damping in C, and g = f' - S' A~,

            dA_d/ds - z~^T g = q^T S^-1 g - z~^T S' S^-1 r - q^T S^-1 S' S^-1 r.
        """
        primal, *adjoints = systems
        reaction = self._reaction(state, primal)
        if not self.proven or not math.isfinite(state.backward_error):
            unknown = np.full(state.displacement.shape, math.nan)
            return state._replace(derivative=unknown + 0j, derivative_bound=unknown, **reaction)
        operators, s, bent, force = self.operators, state.s, self._work, 0.0
        if operators.C is None:
            bent.set(0.0)
        else:
            operators.C.mult(primal.solution, bent)
            bent.aypx(-1.0, operators.f_damping)
            bent.scale(operators.damping)
            force = operators.damping * operators.f_damping.norm()
        bent.axpy(-2 * s * operators.mass, primal.solution)
        slope = 2 * abs(s) * operators.mass
        slope += operators.damping and operators.lattice.damping_norm * operators.damping
        rounding = self.unit * (force + slope * primal.solution.norm())
        g, r = bent.norm() + rounding, self._residual
        derivative, bound = np.empty(len(adjoints), complex), np.empty(len(adjoints))
        inverse = self.inverse_norm
        for d, adjoint in enumerate(adjoints):
            q, z = self._missed[d], adjoint.solution.norm()
            derivative[d] = 1j * adjoint.solution.tDot(bent)
            theory = inverse * (q * g + slope * r * (z + q * inverse))
            sums = z * (rounding + (operators.size + 8) * EPSILON * g)
            bound[d] = 1.01 * (theory + sums)
        return state._replace(derivative=derivative, derivative_bound=bound, **reaction)

    def _reaction(self, state, primal):
        """Return f^T A = A~^T (f + r) + r^T S^-1 r and its bound, by name: A is its own adjoint."""
        value, bound, r = math.nan, math.nan, primal.residual
        if math.isfinite(state.backward_error):
            A = primal.solution
            value = A.tDot(primal.rhs) + A.tDot(r)
            if self.proven:
                # the residual's bound holds, as a norm, what rounding does to r and f, too
                residual, force, size = self._residual, primal.rhs.norm(), self.operators.size
                theory = residual * residual * self.inverse_norm
                rounded = 2 * (residual - primal.norm) + (size + 8) * EPSILON * (force + residual)
                bound = 1.01 * (theory + A.norm() * rounded) + 4 * EPSILON * abs(value)
                bound += 32 * size * SMALLEST_NORMAL
        return {"reaction": value, "reaction_bound": bound}

    def _total(self, number):
        """Return the sum of a number over the ranks of the lattice. Collective."""
        return number if self._alone else self.operators.comm.allreduce(number)

    # Ball by ball.

    def compared(self, state, primal, krylov):
        """Return a state with bounds ball by ball, judged by the floor, too. Collective."""
        if not math.isfinite(state.backward_error) or not np.all(np.isfinite(state.displacement)):
            return state
        errors = None
        if self.comparison.prepare():
            residual = np.abs(primal.residual.getArray(readonly=True))
            residual = self.at_each_ball(residual, self.rounding(primal.solution))
            errors = self.comparison.verified(residual, self)
        if errors is not None:
            corrected = np.abs(state.displacement - self.detectors.read(primal.solution))
            bound = 1.01 * (self.detectors.read_errors(errors) + corrected)
            state = state._replace(error_bound=np.fmin(state.error_bound, bound))
            if self.whole_field:
                bound = 1.01 * errors.norm() + self.lost
                state = state._replace(field_bound=np.fmin(state.field_bound, bound))
        return self.judged(state, primal, krylov, self.floor)

    def at_each_ball(self, residual, terms):
        """Return positive bounds of |f - S x| row by row, from it as computed and `rounding`."""
        return residual + self.unit * terms + 64 * SMALLEST_NORMAL


def _reason(good, reason):
    """Return the reason to give for a state that is good, or is not, after a KSP's last reason."""
    if good:
        return reason if reason > 0 else SOLVED
    return min(reason, 0)


class Detectors:
    """Balls (nd, dim) whose entries are read out of distributed vectors."""

    def __init__(self, operators, sites):
        self._comm, self._like = operators.comm, operators.f_stiffness
        self.names = [f"adjoint of {ball}" for ball in ball_names(sites)]
        numbers, self._weights = operators.layout.readings(sites)
        self._mine = (operators.first <= numbers) & (numbers < operators.last)
        self._rows = numbers[self._mine] - operators.first  # of the entries that this rank has

    def __len__(self):
        return len(self._weights)

    def read(self, x):
        """Return what is read of a vector, on every rank. Collective."""
        return self._sums(self._entries(x))

    def read_errors(self, v):
        """Return bounds of what is read of errors no larger, entry by entry, than v. Collective."""
        # signs that cancel in a reading of v need not cancel in the errors: magnitudes add up
        return self._sums(np.abs(self._entries(v)))

    def unit_vectors(self):
        """Return what each detector reads, e_d; the caller destroys them. Collective."""
        vectors = [self._like.duplicate() for _ in self._weights]
        detectors, _ = self._mine.nonzero()
        entries = zip(detectors, self._rows, self._weights[self._mine], strict=True)
        for detector, row, weight in entries:
            vectors[detector].getArray()[row] = weight  # S^T = S: e_d is a source
        return vectors

    def _entries(self, x):
        """Return this rank's entries that are read, weighted, shape (nd, axes)."""
        entries = np.zeros(self._weights.shape, complex)
        entries[self._mine] = x.getArray(readonly=True)[self._rows]
        return self._weights * entries

    def _sums(self, entries):
        """Return the sum of the entries of each detector. Collective."""
        total = entries.sum(axis=1)
        if self._comm.size > 1:
            self._comm.Allreduce(MPI.IN_PLACE, total)
        return total
