"""The driven steady state S(s) A = f(s), solved until its error bound is met.

One KSP (option prefix `steady_`) serves every s = sigma + i omega. Its factorization is reused for
those that follow as long as iterating is expected to be cheaper than factoring anew. Beside the
amplitudes A an adjoint z of each detector is solved with the same factorization; the two together
give the amplitude at the detector with a rigorous bound (`accuracy`).
"""

import logging
import math
from functools import cached_property

import numpy as np

from pgran.driven.accuracy import Accuracy, SteadyState
from pgran.driven.linear import (
    FACTORIZATIONS,
    LEAST_NORM,
    NO_PRECONDITIONER,
    Krylov,
    ReusePolicy,
    System,
    ends_run,
    expected_iterations,
    factor_price,
    point_name,
)
from pgran.driven.operators import Owner
from pgran.errors import petsc_message
from pgran.run.petsc import PETSc, logged

log = logging.getLogger("pgran")

REFINEMENTS = 20  # of iterative refinement with one factorization, if each halves a bound
AIMED_PART = 0.3  # aim at this part of what the tolerance allows


class SteadySolver(Owner):
    """Solves for one s after the other; destroy with `destroy` or `with`. Collective.

    `sites` (nd, dim) are the detectors, none where only the field is wanted. Each amplitude is to
    have the relative `error_tolerance`, or a bound below `error_floor` of the wall's amplitude;
    with `whole_field` the field the same in the 2-norm, with `whole_adjoints` the adjoints small
    residuals, too. `refresh_iterations` is the limit of `ReusePolicy`; with `derivatives` those
    along omega are computed as well.
    """

    owns = ("_krylov", "bounds", "_correction", "primal", "_units", "adjoints")

    def __init__(
        self, operators, sites, error_tolerance=1e-4, refresh_iterations=0, whole_field=False,
        error_floor=0.0, derivatives=False, whole_adjoints=False
    ):  # fmt: skip
        self.operators, self.comm, self._sites = operators, operators.comm, sites
        self.tolerance = error_tolerance
        self.floor = error_floor * operators.lattice.drive_size
        self.whole_field, self.whole_adjoints = whole_field, whole_adjoints
        self.derivatives, self.factorizations = derivatives, 0
        self._spoilt = False  # the last s has failed: factors may be at fault
        self._works = False  # a factorization has worked once: options are right
        self._told = set()  # messages of PETSc that were told
        self._make_systems()
        self._policy = ReusePolicy(refresh_iterations)
        self.restart()

    def _make_systems(self):
        """Make what is solved, and what bounds the errors."""
        asked = self.tolerance, self.floor, self.whole_field
        self.bounds = Accuracy(self.operators, self._sites, *asked)
        self._correction, self.primal = self.operators.f.duplicate(), System(self.operators.f)

    @cached_property
    def adjoints(self):
        """The adjoint of each detector. Collective when first asked for."""
        self._units = self.bounds.detectors.unit_vectors()
        return list(map(System, self._units, self.bounds.detectors.names))

    @cached_property
    def _krylov(self):
        """The KSP, made only for use: SuperLU_DIST cannot free what it never factored."""
        return Krylov(self.operators, self._correction)

    @property
    def field(self):
        """The amplitudes of all balls at the last s."""
        return self.primal.solution

    @property
    def factor(self):
        """The factorization of S, or None if the preconditioner is none. Collective."""
        pc = self._krylov.pc
        return pc.getFactorMatrix() if pc.getType() in FACTORIZATIONS else None

    @property
    def _systems(self):
        """What is solved at the present s: no adjoints where they would prove nothing."""
        return [self.primal, *self.adjoints] if self.bounds.proven else [self.primal]

    def invert(self, block, image):
        """Set a block's columns to S^-1 of another's, as good as its factors. Collective."""
        self._krylov.invert(block, image)

    def restart(self):
        """Let nothing that follows depend on what was solved before."""
        self._policy.restart()
        self._earlier, self._size = [], None

    @logged("states")
    def solve(self, s):
        """Return the `SteadyState` at s = sigma + i omega, sigma >= 0: i omega for a steady drive.

        Collective. A point that misses its accuracy with a reused factorization is solved again
        with a fresh one, and marked if it still does.
        """
        state, s = None, complex(s)
        try:
            with np.errstate(all="ignore"):  # what is not finite has no bound
                state = self._solve(s)
                if self.derivatives:
                    state = self.bounds.with_derivatives(state, self._systems)
        except PETSc.Error as error:
            self._tell(s, error)
        if state is None:  # the error is gone, and with it what it kept alive
            self._renew()
            state = self._nothing(s)
        self._spoilt = state.converged_reason <= 0
        if self._spoilt:
            self.restart()
        return state

    def _solve(self, s):
        """Solve for one s by what may help, the cheapest first."""
        if self._spoilt:
            self._forget_factors()
        self.operators.combine(s)
        self.bounds.prepare(s)
        for system in self._systems:
            system.advance()
        fresh = self._krylov.ksp.getType() == "preonly" or self._policy.due(self._expected(s))
        state = self._attempt(s, fresh)
        if state.converged_reason <= 0 and not fresh:
            self._policy.count_failure()
            if state.converged_reason == NO_PRECONDITIONER:
                self._forget_factors()
                self.operators.combine(s)
            fresh = True
            state = self._attempt(s, fresh)
        if state.converged_reason <= 0:
            state = self.bounds.compared(state, self.primal, self._krylov)
        if state.converged_reason <= 0 or math.isinf(self.bounds.inverse_norm):
            state = self._sharpened(state)
        self._policy.count(fresh, state.iterations)
        self._earlier, self._size = [*self._earlier[-1:], s], np.abs(state.displacement)
        return state

    def _expected(self, s):
        """Return how many iterations all systems are expected to take if nothing is factored."""
        if not self._earlier:
            return math.inf
        parameters = self.operators.axes, self.operators.mass, self.operators.damping
        return len(self._systems) * expected_iterations(self._earlier[-1], s, *parameters)

    def _attempt(self, s, fresh):
        """Solve with a fresh or the present factorization."""
        self._krylov.begin(None if fresh else self._policy.patience())
        if not fresh:
            self._start_from_line(s)
        elif self._factor():
            self._krylov.start(self._systems)
        else:
            return self._nothing(s)
        return self._refined(s, fresh)

    def _factor(self):
        """Set up the preconditioner for the present S; return whether that works."""
        self.factorizations += 1
        if not self._krylov.factor():
            return False
        self._works = True
        if not self._policy.price:
            self._policy.price = factor_price(self._krylov.pc, self.operators.size)
        return True

    def _start_from_line(self, s):
        """Start from the line through the last two states."""
        step = 0.0
        if len(self._earlier) == 2 and self._earlier[0] != self._earlier[1]:
            before, last = self._earlier
            step = (s - last) / (last - before)
        for system in self._systems:
            system.start_from_line(step, self.operators.S)

    def _refined(self, s, fresh, state=None):
        """Return the state after as many passes of refinement as help, from one before or none."""
        krylov, size = self._krylov, self._size if state is None else np.abs(state.displacement)
        for attempt in range(REFINEMENTS):
            previous = state
            if attempt or not fresh:
                self._improve_all(size)
            state = self.bounds.assess(s, self._systems, krylov)
            size = np.abs(state.displacement)
            if state.converged_reason > 0 or not np.all(np.isfinite(size)):
                break
            if krylov.reason < 0 and not fresh:
                break
            if previous and not (  # refinement has stalled
                np.any(state.error_bound < 0.5 * previous.error_bound)
                or state.field_bound < 0.5 * previous.field_bound
            ):
                break
        return state

    def _improve_all(self, size):
        """Reduce all residuals until their products are small enough for amplitudes of that size.

        Without a bound, as far as the KSP gets. Of the digits a product needs each residual
        contributes half, relative to its right-hand side.
        """
        krylov, primal, adjoints = self._krylov, self.primal, self._systems[1:]
        # An amplitude is proven where |r|_2 |q|_2 <= goal. With |r| / |f| = |q| / |e_d| and |e_d|
        # about 1 that takes |r| <= sqrt(goal |f|), |q| <= sqrt(goal / |f|).
        goal, field = np.zeros(len(adjoints)), 0.0
        if self.bounds.proven:
            share = AIMED_PART * self.tolerance / self.bounds.inverse_norm
            goal = share * size
            field = share * primal.solution.norm() if self.whole_field else math.inf
        force = primal.rhs.norm()
        target = math.sqrt(goal.min(initial=math.inf) * force) if force else 0.0
        krylov.improve(primal, min(target, field))
        for adjoint, product in zip(adjoints, goal, strict=True):
            half = math.sqrt(product / force) if force else 0.0
            target = min(half, product / max(primal.norm, LEAST_NORM))
            if self.whole_adjoints and self.bounds.proven:
                target = min(target, share * adjoint.solution.norm())
            krylov.improve(adjoint, target)

    def _sharpened(self, state):
        """Return the state with bounds by a count of S, refined by these if they are worth it."""
        if not math.isfinite(state.backward_error):
            return state
        allowed = np.maximum(self.tolerance * np.abs(state.displacement), self.floor)
        needed = np.max(state.error_bound / allowed, initial=0.0)
        if not self.bounds.sharpen(self._krylov, needed if math.isfinite(needed) else 0.0):
            return state
        sharper = self._refined(state.s, False, state)
        sharper = self.bounds.judged(sharper, self.primal, self._krylov, self.floor)
        known = np.all(sharper.error_bound <= state.error_bound)
        return sharper if sharper.converged_reason > 0 or known else state

    def _nothing(self, s):
        """Return the state of an s without a solution."""
        self.primal.solution.set(math.nan)
        missing = np.full(len(self.bounds.detectors), math.nan)
        unknown = math.inf if self.bounds.proven else math.nan
        bound = np.full(missing.shape, unknown)
        return SteadyState(
            s=s, displacement=missing + 0j, error_bound=bound, field_bound=unknown,
            derivative=missing + 0j, derivative_bound=bound,
            reaction=math.nan, reaction_bound=unknown,
            backward_error=math.nan, iterations=0, converged_reason=NO_PRECONDITIONER,
        )  # fmt: skip

    def _tell(self, s, error):
        """Say why PETSc fails at an s, each reason once; raise what ends the run."""
        if ends_run(error, self._works, self.comm):
            raise error
        message = petsc_message(error)
        if message not in self._told:
            self._told.add(message)
            log.warning("%s is marked: %s", point_name(s), message)

    def _forget_factors(self):
        """Free what PETSc may have marked as failed for good: its solvers and S."""
        self.forget("_krylov")
        self.bounds.forget_factors()
        self.operators.forget("S")

    def _renew(self):
        """Make all anew that an error inside PETSc may have left unfit for use.

        PETSc may have locked vectors, or taken some for its own, to be freed with the solver that
        it was interrupted in: so they are held until the solvers are gone.
        """
        vectors = [self.operators.f, *self.vectors()]
        for vector in vectors:
            vector.incRef()
            vector.incRef()
        self._forget_factors()
        for vector in vectors:
            while vector.refcount > 1:
                vector.decRef()
        self.forget(*self.owns)
        self.operators.forget("f")
        self._make_systems()
