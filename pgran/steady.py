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
from pgran.reuse import ReusePolicy, factor_price

PASSES = 4  # of iterative refinement with one factorization
SAFETY = 0.3  # aim at this part of what the tolerance allows
TINY = 1e-300
# Without damping no bound holds; then the residual must be of the size of rounding.
BACKWARD_ERROR = 1e-12
# Larger lattices go to MUMPS: it factors faster, but each of its solves is dearer.
PETSC_FACTORS = {1: 10**7, 2: 50_000, 3: 4_000}


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
    """

    omega: float
    displacement: np.ndarray
    error_bound: np.ndarray
    backward_error: float
    iterations: int
    converged_reason: int


class System:
    """One right-hand side of S with its solution and true residual."""

    def __init__(self, rhs):
        """Share `rhs`; own the rest."""
        self.rhs = rhs
        self.solution, self.residual, self.earlier = (rhs.duplicate() for _ in range(3))
        self.norm = math.inf

    def destroy(self):
        """Free what is owned. Collective."""
        for held in (self.solution, self.residual, self.earlier):
            held.destroy()

    def advance(self):
        """Make room for the next solution; this one becomes the earlier one."""
        self.solution, self.earlier = self.earlier, self.solution

    def start_from_zero(self):
        """Guess nothing."""
        self.solution.set(0.0)
        self.rhs.copy(self.residual)
        self.norm = self.residual.norm()

    def start_from_line(self, step, matrix):
        """Guess by a straight line through the last two solutions, `step` of their distance on."""
        self.solution.scale(-step)
        self.solution.axpy(1.0 + step, self.earlier)
        self.update_residual(matrix)

    def update_residual(self, matrix):
        """Compute the true residual and its norm. Collective."""
        matrix.mult(self.solution, self.residual)
        self.residual.aypx(-1.0, self.rhs)
        self.norm = self.residual.norm()


class SteadySolver:
    """Solves for one driving frequency after the other; destroy with `destroy` or `with`.

    Collective.

    Parameters
    ----------
    operators : pgran.operators.Operators
    sites : array_like of int, shape (nd, dim)
        The detectors.
    error_tolerance : float
        Relative accuracy asked of each amplitude.
    refresh_iterations : int
        Refresh the factorization after a frequency that took more iterations; 0 decides by price.
    whole_field : bool
        Ask the same accuracy of the field, in the 2-norm.

    Attributes
    ----------
    factorizations : int
        How many there were so far.
    field : petsc4py.PETSc.Vec
        All amplitudes at the frequency of the last `solve`.
    """

    def __init__(
        self, operators, sites, error_tolerance=1e-4, refresh_iterations=0, whole_field=False
    ):
        """Set up the KSP from its options."""
        self.operators, self.tolerance = operators, error_tolerance
        self.whole_field = whole_field
        self.factorizations = 0
        self._policy = ReusePolicy(refresh_iterations)
        self._correction = operators.f.duplicate()
        self._primal = System(operators.f)
        self._numbers = operators.numbers(sites)
        self._scatter, self._readings = self._make_probe()
        self._bounds, self._adjoints = None, []
        if operators.damping > 0:
            self._bounds = ErrorBounds(operators)
            self._adjoints = [System(self._unit_vector(number)) for number in self._numbers]
        self._systems = [self._primal, *self._adjoints]
        self._make_ksp()
        self.restart()

    @property
    def field(self):
        """The amplitudes of all balls."""
        return self._primal.solution

    def destroy(self):
        """Free all PETSc objects. Collective."""
        for adjoint in self._adjoints:
            adjoint.rhs.destroy()
        held = [*self._systems, self._correction, self._scatter, self._readings, self._ksp]
        for item in held + [self._bounds] * bool(self._bounds):
            item.destroy()

    def __enter__(self):
        """Return the solver."""
        return self

    def __exit__(self, *error):
        """Destroy it."""
        self.destroy()

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
        fresh = self._direct or self._policy.due()
        state = self._attempt(omega, fresh)
        if state.converged_reason <= 0 and not fresh:
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
            if previous and not np.any(state.error_bound < 0.5 * previous.error_bound):
                break
        return state

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
        """Start from zero with a fresh factorization, else from the last two frequencies."""
        step = 0.0
        if len(self._omegas) == 2:
            before, last = self._omegas
            step = (omega - last) / (last - before)
        for system in self._systems:
            if fresh:
                system.start_from_zero()
            else:
                system.start_from_line(step, self.operators.S)

    def _goal(self, omega, size):
        """Return, for each adjoint, the product of the two residual norms to aim at."""
        if self._bounds is None:
            return []
        if size is None:
            return [0.0] * len(self._adjoints)
        return SAFETY * self.tolerance * self._bounds.stability(omega) * size

    def _primal_target(self, omega, goal):
        """Return the residual norm to aim at: half the digits of the product, or rounding."""
        if self._bounds is None:
            return 0.0
        target = math.sqrt(min(goal))
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
        size = primal.solution.norm()
        backward_error = primal.norm / (scale * size + primal.rhs.norm())
        if self._bounds is None:
            good = backward_error <= BACKWARD_ERROR
        else:
            self._bounds.rounding(omega, primal.solution)
            for d, adjoint in enumerate(self._adjoints):
                displacement[d] += adjoint.solution.tDot(primal.residual)
                bound[d] = self._bounds.amplitude(omega, scale, primal, adjoint, displacement[d])
            good = np.all(bound * (1 + self.tolerance) <= self.tolerance * np.abs(displacement))
            if good and self.whole_field:
                good = self._bounds.field(omega, primal) <= self.tolerance * size
        if good and np.all(np.isfinite(displacement)):
            reason = (
                self._reason if self._reason > 0 else int(PETSc.KSP.ConvergedReason.CONVERGED_ATOL)
            )
        else:
            reason = min(self._reason, 0)
        return SteadyState(omega, displacement, bound, backward_error, self._iterations, reason)

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

    def _make_ksp(self):
        """Create the KSP, first with the defaults, then as its options say."""
        operators = self.operators
        self._ksp = ksp = PETSc.KSP().create(operators.comm)
        ksp.setOptionsPrefix("steady_")
        ksp.setOperators(operators.S)
        ksp.setType("bcgs")
        ksp.setTolerances(rtol=1e-13, max_it=1000)
        pc = ksp.getPC()
        pc.setType("cholesky")
        alone = operators.comm.size == 1
        if not (alone and operators.balls <= PETSC_FACTORS[len(operators.shape)]):
            pc.setFactorSolverType("mumps")
        ksp.setFromOptions()
        self._direct = ksp.getType() == "preonly"
        if not self._direct:
            ksp.setInitialGuessKnoll(True)
