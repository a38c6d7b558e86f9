"""The driven steady state S(omega) A = f(omega), solved until its error bound is met.

One KSP (option prefix `steady_`) serves every frequency. Its factorization is reused for the
frequencies that follow as long as iterating is expected to be cheaper than factoring anew. Beside
the amplitudes A an adjoint z of each detector is solved with the same factorization; the two
together give the amplitude at the detector with a rigorous bound (`pgran.solve.bounds`).
"""

import logging
import math
from dataclasses import dataclass, replace

import numpy as np
from petsc4py import PETSc

from pgran.errors import is_bad_input, petsc_message
from pgran.parallel.agreement import met_by_all
from pgran.physics.accuracy import is_accurate
from pgran.solve.bounds import TINIEST, ErrorBounds
from pgran.solve.comparison import Comparison
from pgran.solve.linear import NO_PRECONDITIONER, TINY, System, make_ksp, set_up
from pgran.solve.operators import Owner
from pgran.solve.reuse import FACTORIZATIONS, ReusePolicy, expected_iterations, factor_price

log = logging.getLogger(__name__)

PASSES = 20  # of iterative refinement with one factorization, if each halves a bound
SAFETY = 0.3  # aim at this part of what the tolerance allows
# Where no bound is known the residual must be of the size of rounding, and so must be what this
# many times as much rounding does to the amplitudes.
BACKWARD_ERROR, ROUNDING_TRIED = 1e-12, 10.0
REACHED = int(PETSc.KSP.ConvergedReason.CONVERGED_ATOL)
NO_NUMBER = int(PETSc.KSP.ConvergedReason.DIVERGED_NANORINF)


@dataclass(frozen=True)
class SteadyState:
    """The lattice driven at one frequency.

    Attributes
    ----------
    omega : float
        Driving frequency, angular.
    displacement : numpy.ndarray, shape (nd,)
        Complex amplitudes at the detectors, relative to the driven wall's; NaN where PETSc fails.
    error_bound : numpy.ndarray, shape (nd,)
        The error of each is at most this; NaN where no bound is known (an undamped lattice that
        ranks share, where rounding is tried instead).
    backward_error : float
        |f - S A| / (|S| |A| + |f|).
    iterations : int
        Krylov iterations, those of the adjoints included.
    converged_reason : int
        Positive if every amplitude is as accurate as asked, or is below the floor with its bound;
        else 0 or PETSc's negative KSP reason.
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
    operators : pgran.solve.operators.Operators
    sites : array_like of int, shape (nd, dim)
        The detectors; none (nd = 0) where only the whole field is wanted.
    error_tolerance : float
        Relative accuracy asked of each amplitude.
    refresh_iterations : int
        Refresh the factorization after a frequency that took more iterations; 0 decides by price.
    whole_field : bool
        Ask the same accuracy of the field, in the 2-norm.
    error_floor : float
        An amplitude whose bound is below this part of the wall's is good without it.

    Attributes
    ----------
    factorizations : int
        How many there were so far.
    primal, adjoints : pgran.solve.linear.System, list of pgran.solve.linear.System
        The amplitudes of all balls at the last frequency, and the adjoint of each detector; no
        adjoints where they prove nothing.
    bounds : pgran.solve.bounds.ErrorBounds
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
        error_floor=0.0,
    ):
        """Make the systems and their bounds."""
        self.operators, self.comm = operators, operators.comm
        self.tolerance, self.floor = error_tolerance, error_floor
        self.whole_field = whole_field
        self.factorizations = 0
        self._ksp = self._rtol = self._longest = self._comparison = None
        self._spoilt, self._works, self._said = False, False, set()
        self._numbers = operators.numbers(sites)
        self._scatter, self._readings = self._make_probe()
        self.bounds = ErrorBounds(operators)
        self._make_systems()
        self._policy = ReusePolicy(refresh_iterations)
        self.restart()

    @property
    def field(self):
        """The amplitudes of all balls. Not collective."""
        return self.primal.solution

    @property
    def factor(self):
        """The factorization of S, or None if the preconditioner is none. Not collective."""
        self._need_ksp()
        pc = self._ksp.getPC()
        return pc.getFactorMatrix() if pc.getType() in FACTORIZATIONS else None

    def destroy(self):
        """Free all PETSc objects. Collective."""
        self._forget()
        for system in self.adjoints:
            system.rhs.destroy()
        for item in (*self._systems, self._correction, self._scatter, self._readings, self.bounds):
            item.destroy()

    def _make_systems(self):
        """Make what is solved, and for which right-hand sides."""
        self._correction = self.operators.f.duplicate()
        self.primal, self.adjoints = System(self.operators.f), []
        if self.bounds.proven:
            self.adjoints = [System(self._unit_vector(number)) for number in self._numbers]
        self._systems = [self.primal, *self.adjoints]

    def _forget(self):
        """Free what PETSc may have marked as failed for good: its solvers and S. Collective."""
        for solver in (self._ksp, self._comparison):
            if solver is not None:
                solver.destroy()
        self._ksp = self._comparison = None
        self.operators.forget("S")

    def _renew_systems(self):
        """Make all vectors anew that an error inside PETSc may have left locked. Collective.

        It may also take some for its own, and free them with the solver that was interrupted: so
        they are held until that is gone.
        """
        if self._comparison is not None:
            for vector in self._comparison.owned:
                vector.incRef()  # for good: its own `destroy` comes before that of what was kept
        mine = [self._correction, *(adjoint.rhs for adjoint in self.adjoints)]
        mine += [vector for system in self._systems for vector in system.owned]
        held = [self.operators.f, *self.bounds.owned, *mine]
        for vector in held:
            vector.incRef()
            vector.incRef()
        self._forget()
        for vector in held:
            while vector.refcount > 1:
                vector.decRef()
        for vector in mine:
            vector.destroy()
        self.operators.forget("f")
        self.bounds.destroy()
        self.bounds = ErrorBounds(self.operators)
        self._make_systems()

    def _prepare(self, omega):
        """Combine S and f, and make the KSP where there is none, or none to rely on."""
        if self._spoilt:
            self._forget()
        self.operators.combine(omega)
        self._need_ksp()

    def _need_ksp(self):
        """Make the KSP where there is none: SuperLU_DIST cannot free what it never factored."""
        if self._ksp is None:
            self._ksp = make_ksp(self.operators, self.operators.S)
            self._rtol, _, _, self._longest = self._ksp.getTolerances()

    def restart(self):
        """Forget earlier frequencies: what follows depends on nothing that came before.

        Not collective.
        """
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
        state = None
        try:
            with np.errstate(all="ignore"):  # what is not finite has no bound
                state = self._solve(float(omega))
        except PETSc.Error as error:
            self._tell(omega, error)
        if state is None:  # the error is gone, and with it what it kept alive
            self._renew_systems()
            state = self._nothing(omega)
        self._spoilt = state.converged_reason <= 0
        if self._spoilt:
            self.restart()
        return state

    def _solve(self, omega):
        """Solve for one frequency by what may help, the cheapest first."""
        self._prepare(omega)
        self.bounds.prepare(omega, self.tolerance)
        for system in self._systems:
            system.advance()
        fresh = self._ksp.getType() == "preonly" or self._policy.due(self._expected(omega))
        state = self._attempt(omega, fresh)
        if state.converged_reason <= 0 and not fresh:
            self._policy.count_failure()
            self._spoilt = state.converged_reason == NO_PRECONDITIONER
            self._prepare(omega)
            fresh = True
            state = self._attempt(omega, fresh)
        if state.converged_reason <= 0:
            state = self._compared(state)
        self._policy.count(fresh, state.iterations)
        self._omegas, self._size = [*self._omegas[-1:], omega], np.abs(state.displacement)
        return state

    def _tell(self, omega, error):
        """Say why PETSc fails at a frequency, each reason once.

        Raises
        ------
        PETSc.Error
            Where an option or a callback is to blame, or not all ranks of the lattice have met it.
        """
        wrong = is_bad_input(error) and not self._works
        if error.__cause__ or wrong or not met_by_all(self.comm):
            raise error
        message = petsc_message(error)
        if message not in self._said:
            self._said.add(message)
            log.warning("omega = %g is marked: %s", omega, message)

    def _nothing(self, omega):
        """Return the state of a frequency without a solution."""
        self.primal.solution.set(math.nan)
        missing = np.full(len(self._numbers), math.nan)
        unknown = math.inf if self.bounds.proven else math.nan
        bound = np.full(missing.shape, unknown)
        return SteadyState(omega, missing + 0j, bound, math.nan, 0, NO_PRECONDITIONER, unknown)

    def _attempt(self, omega, fresh):
        """Solve at `omega` with a fresh or the present factorization."""
        self._iterations, self._reason = 0, 0
        if fresh and not self._factor():
            return self._nothing(omega)
        self._guess(omega, fresh)
        self._ksp.setTolerances(max_it=self._longest if fresh else self._policy.patience())
        state, size = None, self._size
        for attempt in range(PASSES):
            previous = state
            if attempt or not fresh:
                self._improve_all(size)
            state = self._assess(omega)
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
        """Set up the preconditioner for the present S; later solves keep it. Return if it works."""
        pc = self._ksp.getPC()
        pc.setReusePreconditioner(False)
        self.factorizations += 1
        if not set_up(self._ksp, self.operators.S, self.comm):
            return False
        self._works = True
        pc.setReusePreconditioner(True)
        if not self._policy.price:
            self._policy.price = factor_price(pc, self.operators.balls)
        return True

    def _guess(self, omega, fresh):
        """Start from one application of a fresh preconditioner, else from the last states."""
        step = 0.0
        if len(self._omegas) == 2 and self._omegas[0] != self._omegas[1]:
            before, last = self._omegas
            step = (omega - last) / (last - before)
        for system in self._systems:
            if fresh:
                system.start_from_preconditioner(self._ksp.getPC(), self.operators.S)
            else:
                system.start_from_line(step, self.operators.S)

    def _improve_all(self, size):
        """Reduce all residuals until their products are small enough for amplitudes of that size.

        Without a bound, as far as the KSP gets. Of the digits a product needs each residual
        contributes half, relative to its right-hand side.
        """
        goal, field = np.zeros(len(self.adjoints)), 0.0
        if self.bounds.proven:
            share = SAFETY * self.tolerance / self.bounds.inverse_norm
            goal = share * size
            field = share * self.primal.solution.norm() if self.whole_field else math.inf
        force = self.primal.rhs.norm()
        target = math.sqrt(goal.min(initial=math.inf) * force) if force else 0.0
        self._improve(self.primal, min(target, field))
        for adjoint, product in zip(self.adjoints, goal, strict=True):
            half = math.sqrt(product / force) if force else 0.0
            self._improve(adjoint, min(half, product / max(self.primal.norm, TINY)))

    def _improve(self, system, target):
        """Reduce a residual to the target, or as far as the KSP gets. Collective."""
        if system.norm <= target:
            return
        ksp, before = self._ksp, system.norm
        # Relative, because a KSP may measure preconditioned residuals, which have another unit.
        ksp.setTolerances(rtol=max(self._rtol, target / before))
        ksp.solve(system.residual, self._correction)
        self._iterations += ksp.getIterationNumber()
        self._reason = ksp.getConvergedReason()
        system.solution.axpy(1.0, self._correction)
        system.update_residual(self.operators.S)
        if not math.isfinite(system.norm):
            self._reason = min(self._reason, NO_NUMBER)
            system.start_from_zero()
        elif system.norm > before:
            system.solution.axpy(-1.0, self._correction)
            system.update_residual(self.operators.S)

    def _assess(self, omega):
        """Return the state reached, its bounds, and whether they meet the tolerance."""
        primal, bounds = self.primal, self.bounds
        displacement = self._read(primal.solution)
        bound = np.full(len(displacement), math.nan)
        size, field_bound = primal.solution.norm(), math.nan
        backward_error = primal.norm / max(bounds.scale * size + primal.rhs.norm(), TINY)
        terms = bounds.rounding(primal.solution)
        if not bounds.proven:
            good = backward_error <= BACKWARD_ERROR
            good = good and self._withstands_rounding(displacement, terms)
        else:
            residual = bounds.primal_residual(primal, terms)
            for d, adjoint in enumerate(self.adjoints):
                displacement[d] += adjoint.solution.tDot(primal.residual)
                bound[d] = bounds.amplitude(residual, terms, adjoint, displacement[d])
            good = np.all(is_accurate(bound, displacement, self.tolerance))
            if self.whole_field:
                field_bound = bounds.field(residual)
                good = good and is_accurate(field_bound, size, self.tolerance)
        reason = self._judged(good and np.all(np.isfinite(displacement)))
        return SteadyState(
            omega, displacement, bound, backward_error, self._iterations, reason, field_bound
        )

    def _judged(self, good):
        """Return the reason to give for a state that is good, or is not."""
        if good:
            return self._reason if self._reason > 0 else REACHED
        return min(self._reason, 0)

    def _compared(self, state):
        """Return a state that misses its accuracy with bounds ball by ball; judge by the floor."""
        if not math.isfinite(state.backward_error) or not np.all(np.isfinite(state.displacement)):
            return state
        if self._comparison is None:
            self._comparison = Comparison(self.operators)
        primal, bounds = self.primal, self.bounds
        bound, field_bound = state.error_bound, state.field_bound
        errors = self._comparison.errors(bounds.residuals(primal), bounds)
        if errors is not None:
            corrected = np.abs(state.displacement - self._read(primal.solution))
            bound = np.fmin(bound, 1.01 * (np.abs(self._read(errors)) + corrected))
            if self.whole_field:
                field_bound = np.fmin(field_bound, 1.01 * errors.norm() + bounds.lost)
        good = is_accurate(bound, state.displacement, self.tolerance) | (bound <= self.floor)
        good = np.all(good)
        if self.whole_field:
            good = good and is_accurate(field_bound, primal.solution.norm(), self.tolerance)
        reason = self._judged(good)
        return replace(state, error_bound=bound, field_bound=field_bound, converged_reason=reason)

    def _read(self, x):
        """Return the entries of a vector at the detectors, on every rank. Collective."""
        self._scatter.scatter(x, self._readings)
        return self._readings.getArray().copy()

    def _withstands_rounding(self, displacement, terms):
        """Return whether rounding of random signs leaves the amplitudes as they are. Collective."""
        residual = self.bounds.random_rounding(terms)
        self._ksp.setTolerances(rtol=0.01)
        self._ksp.solve(residual, self._correction)
        self._iterations += self._ksp.getIterationNumber()
        if self._ksp.getConvergedReason() <= 0:
            return False
        allowed = self.tolerance / ROUNDING_TRIED
        moved = np.abs(self._read(self._correction)) + TINIEST  # an amplitude may have vanished
        good = np.all(moved <= allowed * np.abs(displacement))
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
