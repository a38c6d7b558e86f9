"""The amplitudes along a stretch of changes of bonds: window by window, or step by step.

A window is one factorization, one solve for each of its bonds, and algebra:

    step   0        1        2            s
    state  x0 ----> x1 ----> x2 -> ... -> xs          algebra with S0, Y, G alone
           |                              |
           S0 factored, x0, Y solved      the next window's S0: xs is solved afresh, and compared

A change delta of bond b turns S into S + delta b b^T and moves the drive along when b ends at the
driven wall; with w = b^T A, the driven wall counted as displacement 1, the amplitudes become

    A' = A - S^-1 b c w,    c = delta / (1 + delta b^T S^-1 b).

As the changes are known ahead, that is algebra among the bonds of a window alone
(`pgran.driven.deformation`), and it is exact but for rounding.

The algebra proves its own results. Let S0, x0, z0 be the matrix, the amplitudes and the adjoint
at the start, with residuals r0 and q0; B the bonds b_1 .. b_s of a window, Y the solutions of
S0 Y = B with residuals R, G = B^T Y, Delta the changes so far, and w, q the displacements B^T x0
(the driven wall counted) and B^T z0. After some steps x = x0 + Y gamma and z = z0 + Y eta have the
residuals

    r = r0 + R gamma - B h,        h = gamma + Delta (w + G gamma),
    r_z = q0 + R eta - B g,        g = eta + Delta (q + G eta),

h and g being what the algebra misses. As in `pgran.driven.accuracy`, x_d + z^T r is wrong by at
most |r|_2 |r_z|_2 |S^-1|_2, and damping bounds S^-1 for all steps alike. Up to products of
residuals with Y that sum is the amplitude at the start plus q^T gamma - (q + G eta)^T h, which is
reported.
"""

import contextlib

import numpy as np

from pgran.driven.amplitudes import is_accurate
from pgran.driven.columns import BlockSolver
from pgran.driven.deformation import Deformation, amplitudes, march
from pgran.driven.operators import Owner
from pgran.errors import InputError
from pgran.medium.base import SMALLEST_NORMAL
from pgran.run.petsc import logged

# A window ends where its relative bound exceeds this, even if less is asked for: a fresh start is
# cheap, and errors are a hundredth of their bounds or less, which keeps them below 1e-10.
LARGEST_BOUND = 1e-8
# NumPy rounds products of fewer than 4 complex numbers, and magnitudes of complex numbers that do
# not follow each other, in one way or another, depending on where they happen to lie in memory.
# Neither is used, so that a run repeats bit for bit.
SHORTEST_WINDOW = 4


def states_along(exchange, solver, s, changes, method, window):
    """Return the amplitudes before and after each change, their bounds, and how windows drift.

    Collective. The methods `krylov` and `direct` solve at each step. A window, of at most so many
    steps, begins with a state solved for afresh, which is compared with what the one before made
    of it.
    """
    amplitude = np.empty((len(changes) + 1, len(solver.adjoints)), dtype=complex)
    bound, drift = np.empty(amplitude.shape), np.zeros(len(amplitude))
    done, last, reach = 0, None, window  # `last`: up to which step windows have come
    in_windows = method == "window"
    with Windows(exchange, solver, s) if in_windows else contextlib.nullcontext() as windows:
        while True:
            if method != "krylov":
                solver.restart()
            state = solver.solve(s)
            good, start, start_bound = state.converged_reason > 0, np.nan, np.nan
            if good:
                start, start_bound = state.displacement, state.error_bound
            if good and last == done:
                compared = is_accurate(start_bound, start, solver.tolerance)
                compared &= is_accurate(bound[done], amplitude[done], solver.tolerance)
                moved = np.abs(amplitude[done] - start)[compared] / np.abs(start[compared])
                drift[done] = moved.max(initial=0.0)
            amplitude[done], bound[done] = start, start_bound
            if done == len(changes):
                return amplitude, bound, drift
            steps = 1
            if good and in_windows:
                after, after_bound = windows.follow(state, changes[done : done + reach])
                last = done + len(after)
                amplitude[done + 1 : last + 1], bound[done + 1 : last + 1] = after, after_bound
                steps = max(1, len(after))
                reach = min(window, 2 * steps)  # after an early end not much more may be reached
            exchange.apply(changes[done : done + steps])
            done += steps


class BondExchange:
    """All bond constants before a step of a trajectory, their operators; `draw` gives Changes."""

    def __init__(self, lattice, operators, draw):
        self.operators, self.draw = operators, draw
        self.initial = lattice.constants
        self.constants = self.initial.copy()
        self.trajectory, self.step = 0, 0

    def move_to(self, trajectory, step):
        """Set all bonds to what they are before a step; the operators anew. Collective."""
        if trajectory != self.trajectory or step < self.step:
            self.constants[:] = self.initial
            self.step = 0
        changes = self.draw(trajectory, self.step, step - self.step)
        self.constants[changes.bond] = changes.stiffness
        self.trajectory, self.step = trajectory, step
        self.operators.set_stiffness(self.constants)

    def differences(self, changes, s):
        """Return how far each change moves kappa of its bond, which may repeat, at s."""
        before = self.constants[changes.bond]
        # Sorted by bond, stably: where a bond repeats, it starts from its change before.
        order = np.argsort(changes.bond, kind="stable")
        again = changes.bond[order][1:] == changes.bond[order][:-1]
        before[order[1:][again]] = changes.stiffness[order[:-1][again]]
        growth, lattice = changes.stiffness - before, self.operators.lattice
        return lattice.stiffer(growth, s, changes.bond, before)

    def apply(self, changes):
        """Carry out the changes of the next steps. Collective."""
        self.constants[changes.bond] = changes.stiffness  # of several of one bond the last holds
        self.operators.set_stiffness(self.constants, changes.bond)
        self.step += len(changes)


class Windows(Owner):
    """Follows windows of changes at s = i omega; destroy with `destroy` or `with`. Collective."""

    owns = ("_columns",)

    def __init__(self, exchange, solver, s):
        self.operators, self.comm = exchange.operators, exchange.operators.comm
        if self.operators.damping == 0:
            raise InputError(
                "-relax_method window: needs damping, -lattice_damping; krylov does without"
            )
        if solver.factor is None:
            raise InputError(
                "-relax_method window: needs a factorization (-steady_pc_type lu); krylov not"
            )
        self.exchange, self.solver, self.s = exchange, solver, s
        self._columns, self._rows = BlockSolver(solver), self.operators.lattice.row_norms

    @logged("windows")
    def follow(self, state, changes):
        """Return the amplitudes after each change, shape (n, nd), and their bounds. Collective.

        The solver has found the `state` before them by a fresh factorization; the bonds stay as
        they are. n is smaller than the number of changes, even 0, where more would lose accuracy.
        """
        wanted, changes = len(changes), changes.extended(SHORTEST_WINDOW)
        G, norms, residuals = self._flexibility(changes.bond)
        delta = self.exchange.differences(changes, self.s)
        with np.errstate(all="ignore"):  # what is not finite is not accurate
            deformations = self._deformations(changes.bond, delta, G, norms)
            found = self._amplitudes(state, delta, norms, residuals, *deformations)
            after, error_bound = (np.stack(x, axis=1) for x in zip(*found, strict=True))
            accurate = self._are_accurate(state, after[:wanted], error_bound[:wanted])
        count = wanted if np.all(accurate) else np.argmin(accurate)
        return after[:count], error_bound[:count]

    def _flexibility(self, bonds):
        """Return G, and bounds of the norms of Y's columns and of their residuals."""
        blocks = self._columns.solved(bonds, self.operators.spread, self._rows[0])
        columns, norms, residuals = zip(
            *((self.operators.stretch(Y, bonds), *bounds) for _, Y, *bounds in blocks), strict=True
        )
        return np.concatenate(columns, axis=1), np.concatenate(norms), np.concatenate(residuals)

    def _deformations(self, bonds, delta, G, norms):
        """Return how the amplitudes, and then the adjoint of each detector, follow the changes."""
        systems = [self.solver.primal, *self.solver.adjoints]
        fields = np.stack([system.solution.getArray(readonly=True) for system in systems], axis=1)
        # b^T x0 and b^T z0, in rows of their own: see SHORTEST_WINDOW
        starts = np.ascontiguousarray(self.operators.stretch(fields, bonds).T)
        T, c = march(G, delta)
        walls = [self.operators.layout.drive[bonds], *[0.0] * len(self.solver.adjoints)]
        return [
            Deformation(T, c, G, delta, start, self._rows, (system.solution.norm(), norms), wall)
            for system, start, wall in zip(systems, starts, walls, strict=True)
        ]

    def _amplitudes(self, state, delta, norms, residuals, primal, *adjoints):
        """Yield the amplitudes at each detector after each step, and their bounds:

        |r| |r_z| |S^-1| + |q0| |Y gamma| + |Y eta| (|r0| + |R gamma|), and what rounding adds.
        """
        solver, bounds = self.solver, self.solver.bounds
        terms = bounds.rounding(solver.primal.solution)
        r0 = bounds.primal_residual(solver.primal, terms)
        moved = norms @ primal.coefficient_sizes  # |Y gamma|
        missed = residuals @ primal.coefficient_sizes  # |R gamma|
        r, stability = primal.residual(r0, residuals), self._stability(delta)
        detectors = zip(solver.adjoints, adjoints, state.displacement, strict=True)
        for system, adjoint, before in detectors:
            q0 = bounds.adjoint_residual(system)
            amplitude, rounding = amplitudes(before, primal, adjoint)
            theory = r * adjoint.residual(q0, residuals) / stability
            # products of residuals with Y, which the amplitude leaves out
            left_out = q0 * moved + (norms @ adjoint.coefficient_sizes) * (r0 + missed)
            bound = 1.01 * (theory + left_out + rounding)
            bound += bounds.evaluation(r0, terms, system, before)
            yield amplitude, bound + 64 * len(r) ** 2 * SMALLEST_NORMAL

    def _stability(self, delta):
        """Return what bounds |S^-1| after each step: less where kappa lost a part of what damps."""
        stability = self.solver.bounds.stability(self.s)
        if not self.operators.lattice.has_law:
            return stability
        lost = np.cumsum(np.maximum(-delta.imag, 0.0))
        return np.maximum(stability - self._rows[0] ** 2 * lost, 0.0)

    def _are_accurate(self, start, after, error_bound):
        """Return which steps are accurate at all detectors, or as accurate as their start."""
        solver = self.solver
        accurate = is_accurate(error_bound, after, min(solver.tolerance, LARGEST_BOUND))
        # The floor is for what was no more accurate at the start either.
        at_start = is_accurate(start.error_bound, start.displacement, solver.tolerance)
        return np.all(accurate | ((error_bound <= solver.floor) & ~at_start), axis=1)
