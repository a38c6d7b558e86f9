"""The driven steady state S(omega) A = f(omega), solved until its error bound is met.

One KSP (option prefix `steady_`) serves every frequency. Its factorization is reused for the
frequencies that follow as long as iterating is expected to be cheaper than factoring anew. Beside
the amplitudes A an adjoint z of each detector is solved with the same factorization; the two
together give the amplitude at the detector with a rigorous bound (`pgran.bounds`).
"""

import math
from dataclasses import dataclass

import numpy as np
from petsc4py import PETSc

from pgran.bounds import ErrorBounds
from pgran.linear import TINY, System, make_ksp
from pgran.operators import Owner
from pgran.reuse import FACTORIZATIONS, ReusePolicy, expected_iterations, factor_price

PASSES = 4  # of iterative refinement with one factorization
SAFETY = 0.3  # aim at this part of what the tolerance allows
# Without damping no bound is known: then the residual must be of the size of rounding, and so must
# be what this many times as much rounding does to the amplitudes.
BACKWARD_ERROR, ROUNDING_TRIED = 1e-12, 10.0


@dataclass(frozen=True)
class SteadyState:
    """The lattice driven at one frequency.

    Attributes
    ----------
    omega : float
        Driving frequency, angular.
    displacement : numpy.ndarray, shape (nd,)
        Complex amplitudes at the detectors, relative to the driven wall's.
    error_bound : numpy.ndarray, shape (nd,)
        The error of each is at most this; NaN where no bound is known (no damping).
    backward_error : float
        |f - S A| / (|S| |A| + |f|).
    iterations : int
        Krylov iterations, those of the adjoints included.
    converged_reason : int
        Positive if the accuracy asked for was reached, else 0 or PETSc's negative KSP reason.
    field_bound : float
        The error of the whole field, in the 2-norm, is at most this; NaN where no bound is known,
        or none was asked for.
    """

    omega: float
    displacement: np.ndarray
    error_bound: np.ndarray
    backward_error: float
    iterations: int
    converged_reason: int
    field_bound: float


class SteadySolver(Owner):
    """Solves for one driving frequency after the other; destroy with `destroy` or `with`.

    Collective.

    Parameters
    ----------
    operators : pgran.operators.Operators
    sites : array_like of int, shape (nd, dim)
        The detectors; none (nd = 0) where only the whole field is wanted.
    error_tolerance : float
        Relative accuracy asked of each amplitude.
    refresh_iterations : int
        Refresh the factorization after a frequency that took more iterations; 0 decides by price.
    whole_field : bool
        Ask the same accuracy of the field, in the 2-norm.
    adjoints : bool
        Solve for the adjoints without damping too, where they prove nothing.

    Attributes
    ----------
    factorizations : int
        How many there were so far.
    field : petsc4py.PETSc.Vec
        All amplitudes at the frequency of the last `solve`.
    """

    def __init__(
        self,
        operators,
        sites,
        error_tolerance=1e-4,
        refresh_iterations=0,
        whole_field=False,
        adjoints=False,
    ):
        """Set up the KSP from its options."""
        self.operators, self.comm = operators, operators.comm
        self.tolerance = error_tolerance
        self.whole_field = whole_field
        self.factorizations = 0
        self._correction = operators.f.duplicate()
        self._primal = System(operators.f)
        self._numbers = operators.numbers(sites)
        self._scatter, self._readings = self._make_probe()
        self._bounds = ErrorBounds(operators)
        self._adjoints = []
        if self._bounds.proven or adjoints:
            self._adjoints = [System(self._unit_vector(number)) for number in self._numbers]
        self._systems = [self._primal, *self._adjoints]
        self._policy = ReusePolicy(refresh_iterations)
        self._ksp = make_ksp(operators)
        self._longest = self._ksp.getTolerances()[3]
        self._direct = self._ksp.getType() == "preonly"
        self.restart()

    @property
    def field(self):
        """The amplitudes of all balls."""
        return self._primal.solution

    @property
    def solutions(self):
        """The amplitudes of all balls, and the adjoint of each detector."""
        return [system.solution for system in self._systems]

    @property
    def factor(self):
        """The factorization of S, or None if the preconditioner is none."""
        pc = self._ksp.getPC()
        return pc.getFactorMatrix() if pc.getType() in FACTORIZATIONS else None

    def destroy(self):
        """Free all PETSc objects. Collective."""
        for adjoint in self._adjoints:
            adjoint.rhs.destroy()
        held = [self._correction, self._scatter, self._readings, self._ksp, self._bounds]
        for item in [*self._systems, *held]:
            item.destroy()

    def restart(self):
        """Forget earlier frequencies: what follows depends on nothing that came before."""
        self._policy.restart()
        self._omegas, self._size = [], None

    def solve(self, omega):
        """Return the steady state at one frequency.

        Collective. A point that misses its accuracy with a reused factorization is solved again
        with a fresh one, and marked if it still does.

        Parameters
        ----------
        omega : float
            Positive.

        Returns
        -------
        SteadyState
        """
        self.operators.combine(omega)
        for system in self._systems:
            system.advance()
        fresh = self._direct or self._policy.due(self._expected(omega))
        state = self._attempt(omega, fresh)
        if state.converged_reason <= 0 and not fresh:
            self._policy.count_failure()
            fresh = True
            state = self._attempt(omega, fresh)
        self._policy.count(fresh, state.iterations)
        self._omegas, self._size = [*self._omegas[-1:], omega], np.abs(state.displacement)
        if state.converged_reason <= 0:
            self.restart()
        return state

    def _attempt(self, omega, fresh):
        """Solve at `omega` with a fresh or the present factorization."""
        if fresh:
            self._factor()
        self._guess(omega, fresh)
        scale = self.operators.S.norm(PETSc.NormType.INFINITY)
        self._ksp.setTolerances(max_it=self._longest if fresh else self._policy.patience())
        self._iterations, self._reason = 0, 0
        state, size = None, self._size
        for _ in range(PASSES):
            previous = state
            goal = self._goal(omega, size)
            self._improve(self._primal, self._primal_target(omega, goal))
            for adjoint, product in zip(self._adjoints, goal, strict=True):
                half = math.sqrt(product)
                self._improve(adjoint, half * min(1.0, half / max(self._primal.norm, TINY)))
            state = self._assess(omega, scale)
            size = np.abs(state.displacement)
            if state.converged_reason > 0 or not np.all(np.isfinite(size)):
                break
            if self._reason < 0 and not fresh:
                break
            if previous and not (
                np.any(state.error_bound < 0.5 * previous.error_bound)
                or state.field_bound < 0.5 * previous.field_bound
            ):
                break
        return state

    def _expected(self, omega):
        """Return how many iterations all systems are expected to take if nothing is factored."""
        if not self._omegas:
            return math.inf
        lattice = self.operators
        return len(self._systems) * expected_iterations(
            self._omegas[-1], omega, len(lattice.shape), lattice.mass, lattice.damping
        )

    def _factor(self):
        """Set up the preconditioner for the present S; later solves keep it."""
        pc = self._ksp.getPC()
        pc.setReusePreconditioner(False)
        self._ksp.setOperators(self.operators.S)  # without it a KSP overlooks new values
        self._ksp.setUp()
        pc.setReusePreconditioner(True)
        self.factorizations += 1
        if self.factorizations == 1:
            self._policy.price = factor_price(pc, self.operators.balls)

    def _guess(self, omega, fresh):
        """Start from zero with a fresh factorization, else from the last states."""
        step = 0.0
        if len(self._omegas) == 2 and self._omegas[0] != self._omegas[1]:
            before, last = self._omegas
            step = (omega - last) / (last - before)
        for system in self._systems:
            if fresh:
                system.start_from_zero()
            else:
                system.start_from_line(step, self.operators.S)

    def _goal(self, omega, size):
        """Return, for each adjoint, the product of the two residual norms to aim at."""
        if not self._bounds.proven or size is None:
            return [0.0] * len(self._adjoints)
        return SAFETY * self.tolerance * self._bounds.stability(omega) * size

    def _primal_target(self, omega, goal):
        """Return the residual norm to aim at: half the digits of the product, or rounding."""
        if not self._bounds.proven:
            return 0.0
        target = math.sqrt(min(goal, default=math.inf))
        if self.whole_field:
            field = self._bounds.stability(omega) * self._primal.solution.norm()
            target = min(target, SAFETY * self.tolerance * field)
        return target

    def _improve(self, system, target):
        """Reduce a residual to the target, or as far as the KSP gets. Collective."""
        if system.norm <= target:
            return
        ksp, before = self._ksp, system.norm
        ksp.setTolerances(atol=max(target, TINY))
        ksp.solve(system.residual, self._correction)
        self._iterations += ksp.getIterationNumber()
        self._reason = ksp.getConvergedReason()
        system.solution.axpy(1.0, self._correction)
        system.update_residual(self.operators.S)
        if not math.isfinite(system.norm):
            self._reason = min(self._reason, int(PETSc.KSP.ConvergedReason.DIVERGED_NANORINF))
            system.start_from_zero()
        elif system.norm > before:
            system.solution.axpy(-1.0, self._correction)
            system.update_residual(self.operators.S)

    def _assess(self, omega, scale):
        """Return the state reached, its bounds, and whether they meet the tolerance."""
        primal = self._primal
        self._scatter.scatter(primal.solution, self._readings)
        displacement = self._readings.getArray().copy()
        bound = np.full(len(displacement), math.nan)
        size, field_bound = primal.solution.norm(), math.nan
        backward_error = primal.norm / max(scale * size + primal.rhs.norm(), TINY)
        for d, adjoint in enumerate(self._adjoints):
            displacement[d] += adjoint.solution.tDot(primal.residual)
        self._bounds.rounding(omega, primal.solution)
        if not self._bounds.proven:
            good = backward_error <= BACKWARD_ERROR and self._withstands_rounding(displacement)
        else:
            for d, adjoint in enumerate(self._adjoints):
                bound[d] = self._bounds.amplitude(omega, scale, primal, adjoint, displacement[d])
            good = np.all(bound * (1 + self.tolerance) <= self.tolerance * np.abs(displacement))
            if self.whole_field:
                field_bound = self._bounds.field(omega, primal)
                good = good and field_bound <= self.tolerance * size
        if good and np.all(np.isfinite(displacement)):
            reason = (
                self._reason if self._reason > 0 else int(PETSc.KSP.ConvergedReason.CONVERGED_ATOL)
            )
        else:
            reason = min(self._reason, 0)
        return SteadyState(
            omega, displacement, bound, backward_error, self._iterations, reason, field_bound
        )

    def _withstands_rounding(self, displacement):
        """Return whether rounding of random signs leaves the amplitudes as they are. Collective."""
        residual = self._bounds.random_rounding()
        self._ksp.setTolerances(atol=0.01 * residual.norm())
        self._ksp.solve(residual, self._correction)
        self._iterations += self._ksp.getIterationNumber()
        if self._ksp.getConvergedReason() <= 0:
            return False
        self._scatter.scatter(self._correction, self._readings)
        allowed = self.tolerance / ROUNDING_TRIED
        good = np.all(np.abs(self._readings.getArray()) <= allowed * np.abs(displacement))
        if self.whole_field:
            good = good and self._correction.norm() <= allowed * self.field.norm()
        return bool(good)

    def _make_probe(self):
        """Return what copies the amplitudes at the detectors to every rank."""
        readings = PETSc.Vec().createSeq(len(self._numbers), comm=PETSc.COMM_SELF)
        where = PETSc.IS().createGeneral(self._numbers, comm=PETSc.COMM_SELF)
        scatter = PETSc.Scatter().create(self.operators.f, where, readings, None)
        where.destroy()
        return scatter, readings

    def _unit_vector(self, number):
        """Return e_d for the ball with PETSc's number `number`."""
        vector = self.operators.f.duplicate()
        vector.set(0.0)
        first, last = vector.getOwnershipRange()
        if first <= number < last:
            vector.setValue(number, 1.0)
        vector.assemble()
        return vector
