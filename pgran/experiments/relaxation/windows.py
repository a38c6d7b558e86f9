"""Windows of relaxation steps: one factorization, one solve for each bond, and algebra.

A change delta of bond b turns S into S + delta b b^T and moves the drive along when b ends at the
driven wall; with w = b^T A, the driven wall counted as displacement 1, the amplitudes become

    A' = A - S^-1 b c w,    c = delta / (1 + delta b^T S^-1 b).

The changes of the next steps are known ahead (`changes`). So the amplitudes of a
window of steps follow exactly from one factorization at its start, one solve for each of its bonds,
and algebra among those bonds alone (`pgran.driven.deformation`).

That algebra proves its own results. Let S0, x0, z0 be the matrix, the amplitudes and the adjoint
at the start, with residuals r0 and q0; B the bonds b_1 .. b_s of a window, Y the solutions of
S0 Y = B with residuals R, G = B^T Y, Delta the changes so far, and w, q the displacements B^T x0
(the driven wall counted) and B^T z0. After some steps x = x0 + Y gamma and z = z0 + Y eta have the
residuals

    r = r0 + R gamma - B h,        h = gamma + Delta (w + G gamma),
    r_z = q0 + R eta - B g,        g = eta + Delta (q + G eta),

h and g being what the algebra misses. As in `pgran.driven.bounds`, x_d + z^T r is wrong by at most
|r|_2 |r_z|_2 |S^-1|_2, and damping bounds S^-1 for all steps alike. Up to products of residuals
with Y that sum is the amplitude at the start plus q^T gamma - (q + G eta)^T h, which is reported.
"""

import numpy as np

from pgran.driven.accurate import is_accurate
from pgran.driven.columns import Columns
from pgran.driven.deformation import Deformation, amplitudes, march
from pgran.driven.owner import Owner
from pgran.errors import InputError
from pgran.medium.rounding import SMALLEST_NORMAL

# A window ends where its relative bound exceeds this, even if less is asked for: a fresh start is
# cheap, and errors are a hundredth of their bounds or less, which keeps them below 1e-10.
LONGEST_REACH = 1e-8
# NumPy rounds products of fewer than 4 complex numbers, and magnitudes of complex numbers that do
# not follow each other, in one way or another, depending on where they happen to lie in memory.
# Neither is used, so that a run repeats bit for bit.
SHORTEST = 4


class Windows(Owner):
    """Solves windows of steps; destroy with `destroy` or `with`.

    Collective.

    Parameters
    ----------
    changing : pgran.experiments.relaxation.changing.ChangingBonds
    solver : pgran.driven.steady.SteadySolver
    s : complex
        i omega.

    Raises
    ------
    InputError
        If the solver's preconditioner is no factorization, or there is no damping.
    """

    owns = ("_columns",)

    def __init__(self, changing, solver, s):
        """Make the blocks of right-hand sides and solutions."""
        self.operators = changing.operators
        if self.operators.damping == 0:
            raise InputError(
                "-relax_method window: needs damping (-lattice_damping), which bounds the error of "
                "every step; -relax_method krylov or direct does without"
            )
        if solver.factor is None:
            raise InputError(
                "-relax_method window: needs a factorization (-steady_pc_type cholesky or lu); "
                "-relax_method krylov does without"
            )
        self.changing, self.solver, self.s = changing, solver, s
        self._columns, self._rows = Columns(solver), self.operators.lattice.rows

    def start(self):
        """Return the steady state of the bonds as they are, factored afresh. Collective."""
        self.solver.restart()
        self.state = self.solver.solve(self.s)
        return self.state

    def follow(self, changes):
        """Return the amplitudes after each of some Changes, `start` being the state before them.

        Collective. The bonds stay as they are.

        Returns
        -------
        after, error_bound : numpy.ndarray, shape (n, nd)
            n is smaller than the number of changes, even 0, where more would lose accuracy.
        """
        if self.state.converged_reason <= 0:
            nothing = np.empty((0, len(self.state.displacement)))
            return nothing + 0j, nothing
        wanted, changes = len(changes), changes.extended(SHORTEST)
        G, *columns = self._flexibility(changes.bond)
        with np.errstate(all="ignore"):
            found = self._amplitudes(*columns, *self._deformations(changes, G, columns[0]))
            after, error_bound = (np.stack(columns, axis=1) for columns in zip(*found, strict=True))
            kept = self._are_kept(after[:wanted], error_bound[:wanted])
        count = wanted if np.all(kept) else np.argmin(kept)
        return after[:count], error_bound[:count]

    def _flexibility(self, bonds):
        """Return G, and bounds of the norms of Y's columns and of their residuals."""
        solved = self._columns.solved(bonds, self.operators.spread, self._rows[0])
        columns, norms, residuals = zip(
            *((self.operators.stretch(found, bonds), *known) for _, found, *known in solved),
            strict=True,
        )
        return np.concatenate(columns, axis=1), np.concatenate(norms), np.concatenate(residuals)

    def _deformations(self, changes, G, norms):
        """Return how the amplitudes, and the adjoints of detectors, follow the changes.

        `norms` are no less than those of Y's columns.
        """
        systems = [self.solver.primal, *self.solver.adjoints]
        fields = np.stack([system.solution.getArray(readonly=True) for system in systems], axis=1)
        # rows of their own: see SHORTEST
        starts = np.ascontiguousarray(self.operators.stretch(fields, changes.bond).T)
        delta, driven = (
            self.changing.differences(changes),
            self.operators.layout.drive[changes.bond],
        )
        algebra, (primal, *adjoints) = (*march(G, delta), G, delta), starts
        known = [(self._rows, (system.solution.norm(), norms)) for system in systems]
        return Deformation(*algebra, primal, *known[0], driven), [
            Deformation(*algebra, z, *size) for z, size in zip(adjoints, known[1:], strict=True)
        ]

    def _amplitudes(self, norms, residuals, primal, adjoints):
        """Yield the amplitudes at each detector after each step, and their bounds."""
        solver, bounds = self.solver, self.solver.bounds
        terms = bounds.rounding(solver.primal.solution)
        r0 = bounds.primal_residual(solver.primal, terms)
        moved, r = norms @ primal.coefficient_sizes, primal.residual(r0, residuals)
        for system, adjoint, before in zip(
            solver.adjoints, adjoints, self.state.displacement, strict=True
        ):
            q0 = bounds.adjoint_residual(system)
            amplitude, rounding = amplitudes(before, primal, adjoint)
            theory = r * adjoint.residual(q0, residuals) / bounds.stability(self.s)
            # products of residuals with Y, which the amplitude leaves out
            left_out = q0 * moved + (norms @ adjoint.coefficient_sizes) * (
                r0 + residuals @ primal.coefficient_sizes
            )
            bound = 1.01 * (theory + left_out + rounding)
            bound += bounds.evaluation(r0, terms, system, before)
            yield amplitude, bound + 64 * len(r) ** 2 * SMALLEST_NORMAL

    def _are_kept(self, after, error_bound):
        """Return which steps are accurate at all detectors, or as accurate as their start."""
        solver, start = self.solver, self.state
        kept = is_accurate(error_bound, after, min(solver.tolerance, LONGEST_REACH))
        # The floor is for what was no more accurate at the start either.
        known = is_accurate(start.error_bound, start.displacement, solver.tolerance)
        return np.all(kept | ((error_bound <= solver.floor) & ~known), axis=1)
