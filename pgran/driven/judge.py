"""How good a solution is: its bounds, and whether they meet what is asked."""

import math
from functools import cached_property
from typing import NamedTuple

import numpy as np

from pgran.driven.accurate import is_accurate
from pgran.driven.bounds import ErrorBounds
from pgran.driven.comparison import Comparison
from pgran.driven.linear import LEAST_NORM
from pgran.driven.operators import Owner
from pgran.medium.base import EPSILON, SMALLEST_NORMAL
from pgran.run.petsc import PETSc

# Where no bound is known the residual must be of the size of rounding, and so must be what this
# many times as much rounding does to the amplitudes.
BACKWARD_ERROR, ROUNDING_TRIED = 1e-12, 10.0
GOOD = int(PETSc.KSP.ConvergedReason.CONVERGED_ATOL)  # where no KSP had to iterate


class SteadyState(NamedTuple):
    """The lattice driven at one s = sigma + i omega; NaN is unknown, or was not asked for."""

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


class Detectors(Owner):
    """Balls (nd, dim) whose entries are read out of distributed vectors. Collective."""

    owns = ("_scatter", "_readings")

    def __init__(self, operators, sites):
        self._like, self._alone = operators.f_stiffness, operators.comm.size == 1
        self._numbers, self._weights = operators.layout.readings(sites)
        numbers = self._numbers.ravel()
        self._readings = PETSc.Vec().createSeq(len(numbers), comm=PETSc.COMM_SELF)
        where = PETSc.IS().createGeneral(numbers, comm=PETSc.COMM_SELF)
        self._scatter = PETSc.Scatter().create(self._like, where, self._readings, None)
        where.destroy()

    def __len__(self):
        return len(self._numbers)

    def read(self, x):
        """Return what is read of a vector, on every rank. Collective."""
        return (self._weights * self._entries(x)).sum(axis=1)

    def read_errors(self, v):
        """Return bounds of what is read of a vector whose entries are no larger than v's.

        Collective. Errors need not cancel where the readings of v do.
        """
        return np.abs(self._weights * self._entries(v)).sum(axis=1)

    def _entries(self, x):
        """Return the entries that are read, shape (nd, axes). Collective."""
        if self._alone:
            return x.getArray(readonly=True)[self._numbers]
        self._scatter.scatter(x, self._readings)
        return self._readings.getArray().reshape(self._weights.shape)

    def unit_vectors(self):
        """Return what each detector reads, e_d; the caller destroys them. Collective."""
        vectors = [self._like.duplicate() for _ in self._numbers]
        first, last = self._like.getOwnershipRange()
        for vector, numbers, weights in zip(vectors, self._numbers, self._weights, strict=True):
            mine = (numbers >= first) & (numbers < last)
            vector.getArray()[numbers[mine] - first] = weights[mine]  # S^T = S: e_d is a source
        return vectors


class Judge(Owner):
    """Bounds the errors of solutions and judges them, for a `steady.SteadySolver`. Collective."""

    owns = ("bounds", "detectors", "comparison", "_bent")

    def __init__(self, operators, sites, tolerance, floor, whole_field):
        self.operators, self.detectors = operators, Detectors(operators, sites)
        self.tolerance, self.floor, self.whole_field = tolerance, floor, whole_field
        self.bounds = ErrorBounds(operators)
        self._missed = np.zeros(len(self.detectors))  # bounds of the adjoints' last residuals

    @cached_property
    def _bent(self):
        """A vector for `with_derivatives`. Collective when first asked for."""
        return self.operators.f.duplicate()

    @cached_property
    def comparison(self):
        """What bounds ball by ball. Collective when first asked for."""
        return Comparison(self.operators)

    def forget_factors(self):
        """Free what PETSc may have marked as failed for good. Collective."""
        if "comparison" in vars(self):
            self.comparison.forget_factor()

    def assess(self, s, systems, krylov):
        """Return the state reached, its bounds, and whether they meet the tolerance.

        Collective. `systems` are that of the amplitudes, then each detector's adjoint, none where
        no bound is known; `krylov` has solved them, and the bounds are prepared for s.
        """
        bounds, (primal, *adjoints) = self.bounds, systems
        displacement = self.detectors.read(primal.solution)
        bound = np.full(len(displacement), math.nan)
        size, field_bound = primal.solution.norm(), math.nan
        backward_error = primal.norm / max(bounds.scale * size + primal.rhs.norm(), LEAST_NORM)
        terms = bounds.rounding(primal.solution)
        if not bounds.proven:
            good = backward_error <= BACKWARD_ERROR
            good = good and self._withstands_rounding(displacement, terms, size, krylov)
        else:
            residual = self._residual = bounds.primal_residual(primal, terms)
            for d, adjoint in enumerate(adjoints):
                displacement[d] += adjoint.solution.tDot(primal.residual)
                missed = self._missed[d] = bounds.adjoint_residual(adjoint)
                bound[d] = bounds.amplitude(residual, missed, terms, adjoint, displacement[d])
            good = is_accurate(bound, displacement, self.tolerance).all()
            if self.whole_field:
                field_bound = 1.01 * residual * bounds.inverse_norm
                good = good and is_accurate(field_bound, size, self.tolerance)
        reason = _reason(good and np.isfinite(displacement).all(), krylov.reason)
        return SteadyState(
            s, displacement, bound, backward_error, krylov.iterations, reason, field_bound
        )

    def compared(self, state, primal, krylov):
        """Return a state that misses its accuracy with bounds ball by ball; judge by the floor.

        Collective. `primal` is the system of the amplitudes.
        """
        if not math.isfinite(state.backward_error) or not np.all(np.isfinite(state.displacement)):
            return state
        bounds, bound, field_bound = self.bounds, state.error_bound, state.field_bound
        errors = None
        if self.comparison.prepare():
            errors = self.comparison.verified(bounds.residuals(primal), bounds)
        if errors is not None:
            corrected = np.abs(state.displacement - self.detectors.read(primal.solution))
            bound = np.fmin(bound, 1.01 * (self.detectors.read_errors(errors) + corrected))
            if self.whole_field:
                field_bound = np.fmin(field_bound, 1.01 * errors.norm() + bounds.lost)
        state = state._replace(error_bound=bound, field_bound=field_bound)
        return self.by_floor(state, primal, krylov)

    def by_floor(self, state, primal, krylov):
        """Return a state judged by its accuracy or the floor. Collective."""
        bound, field_bound = state.error_bound, state.field_bound
        good = is_accurate(bound, state.displacement, self.tolerance) | (bound <= self.floor)
        good = np.all(good)
        if self.whole_field:
            good = good and is_accurate(field_bound, primal.solution.norm(), self.tolerance)
        return state._replace(converged_reason=_reason(good, krylov.reason))

    def with_derivatives(self, state, systems):
        """Return a state with the derivatives dA_d/domega, the reaction f^T A, and their bounds.

        Collective; `assess` has looked at these systems last. With S' = C + 2 s M, all damping in
        C, and g = f' - S' A~ (derivatives along s),

            dA_d/ds - z~^T g = q^T S^-1 g - z~^T S' S^-1 r - q^T S^-1 S' S^-1 r.
        """
        reaction = self._reaction(state, systems[0])
        if not self.bounds.proven or not math.isfinite(state.backward_error):
            unknown = np.full(state.displacement.shape, math.nan)
            return state._replace(derivative=unknown + 0j, derivative_bound=unknown, **reaction)
        bounds, operators, (primal, *adjoints) = self.bounds, self.operators, systems
        s, bent, force = state.s, self._bent, 0.0
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
        rounding = bounds.unit * (force + slope * primal.solution.norm())
        g, r = bent.norm() + rounding, self._residual
        derivative, bound = np.empty(len(adjoints), complex), np.empty(len(adjoints))
        inverse = bounds.inverse_norm
        for d, adjoint in enumerate(adjoints):
            q, z = self._missed[d], adjoint.solution.norm()
            derivative[d] = 1j * adjoint.solution.tDot(bent)
            theory = inverse * (q * g + slope * r * (z + q * inverse))
            sums = z * (rounding + (operators.size + 8) * EPSILON * g)
            bound[d] = 1.01 * (theory + sums)
        return state._replace(derivative=derivative, derivative_bound=bound, **reaction)

    def _reaction(self, state, primal):
        """Return f^T A = A~^T (f + r) + r^T S^-1 r and its bound, by name: A is its own adjoint."""
        value, bound, bounds = math.nan, math.nan, self.bounds
        if math.isfinite(state.backward_error):
            A = primal.solution
            value = A.tDot(primal.rhs) + A.tDot(primal.residual)
            if bounds.proven:
                bound = bounds.reaction(self._residual, primal, value)
        return {"reaction": value, "reaction_bound": bound}

    def _withstands_rounding(self, displacement, terms, size, krylov):
        """Return whether rounding of random signs leaves the amplitudes as they are."""
        moved = krylov.roughly_solved(self.bounds.random_rounding(terms))
        if moved is None:
            return False
        allowed = self.tolerance / ROUNDING_TRIED
        # an amplitude may have vanished
        differences = np.abs(self.detectors.read(moved)) + SMALLEST_NORMAL
        good = np.all(differences <= allowed * np.abs(displacement))
        return bool(good and (not self.whole_field or moved.norm() <= allowed * size))


def _reason(good, reason):
    """Return the reason to give for a state that is good, or is not, after a KSP's last reason."""
    if good:
        return reason if reason > 0 else GOOD
    return min(reason, 0)
