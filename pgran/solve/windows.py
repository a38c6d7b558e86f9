"""Windows of relaxation steps: one factorization, one solve for each bond, and algebra.

A change delta of bond b turns S into S + delta b b^T and moves the drive along when b ends at the
driven wall; with w = b^T A, the driven wall counted as displacement 1, the amplitudes become

    A' = A - S^-1 b c w,    c = delta / (1 + delta b^T S^-1 b).

The changes of the next steps are known ahead (`pgran.physics.changes`). So the amplitudes of a
window of steps follow exactly from one factorization at its start, one solve for each of its bonds,
and algebra among those bonds alone.

That algebra proves its own results. Let S0, x0, z0 be the matrix, the amplitudes and the adjoint
at the start, with residuals r0 and s0; B the bonds b_1 .. b_s of a window, Y the solutions of
S0 Y = B with residuals R, G = B^T Y, Delta the changes so far, and w, q the displacements B^T x0
(the driven wall counted) and B^T z0. After some steps x = x0 + Y gamma and z = z0 + Y eta have the
residuals

    r = r0 + R gamma - B h,    h = gamma + Delta (w + G gamma),
    s = s0 + R eta - B g,      g = eta + Delta (q + G eta),

h and g being what the algebra misses. As in `pgran.solve.bounds`, x_d + z^T r is wrong by at most
|r|_2 |s|_2 |S^-1|_2, and damping bounds S^-1 for all steps alike. Up to products of residuals with
Y that sum is the amplitude at the start plus q^T gamma - (q + G eta)^T h, which is reported.
"""

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from pgran.errors import InputError
from pgran.physics.accuracy import is_accurate
from pgran.solve.bounds import EPSILON, TINIEST
from pgran.solve.operators import SAME, Owner

COLUMNS = 32  # right-hand sides solved for at once
# A window ends where its relative bound exceeds this, even if less is asked for: a fresh start is
# cheap, and errors are a hundredth of their bounds or less, which keeps them below 1e-10.
LONGEST_REACH = 1e-8
# NumPy rounds products of fewer than 4 complex numbers, and magnitudes of complex numbers that do
# not follow each other, in one way or another, depending on where they happen to lie in memory.
# Neither is used, so that a run repeats bit for bit.
SHORTEST = 4
BOND = 2**0.5  # |b|_2 of a bond between balls


def march(G, delta):
    """Change one bond after the other; return how each then deforms the lattice.

    Not collective. This is the inverse, column by column, of the factor L^T in the L D L^T
    factorization of diag(1/delta) + G, whose leading blocks are the networks after each step.

    Parameters
    ----------
    G : numpy.ndarray, shape (s, s)
        b^T S0^-1 b' of the changing bonds before any change.
    delta : numpy.ndarray, shape (s,)
        By how much each changes.

    Returns
    -------
    T : numpy.ndarray, shape (s, s)
        S^-1 b_t = S0^-1 B T[:, t] once the bonds before t have changed.
    c : numpy.ndarray, shape (s,)
        delta / (1 + delta b^T S^-1 b).
    """
    steps = len(delta)
    T, (c, row) = np.eye(steps, dtype=complex), np.zeros((2, steps), dtype=complex)
    with np.errstate(all="ignore"):  # what is not finite has no bound
        for t in range(steps):
            before = T[:t, :t]
            row[:t] = G[t, :t] @ before
            along = -c * row
            T[:t, t] = before @ along[:t]
            c[t] = delta[t] / (1.0 + delta[t] * (G[t, t] + row @ along))
    return T, c


@dataclass(frozen=True)
class Deformation:
    """The amplitudes, or an adjoint, after each of a window's steps, by its part along Y.

    A column of an array (s, s) is a step.

    Attributes
    ----------
    part : numpy.ndarray, shape (s, s)
        gamma, or eta.
    size : numpy.ndarray, shape (s, s)
        Its magnitude.
    stretch : numpy.ndarray, shape (s, s)
        w + G gamma, or q + G eta: the displacements of the bonds.
    missed : numpy.ndarray, shape (s, s)
        h, or g.
    sizes : numpy.ndarray, shape (s, s)
        The magnitudes of `missed`.
    rows, ends : numpy.ndarray, shape (s,)
        A stretch is wrong by rounding by at most rows times the 2-norm of its column of `part`,
        plus ends.
    delta : numpy.ndarray, shape (s, s)
        The magnitudes of the changes so far.
    norm : numpy.ndarray, shape (s,)
        The 2-norms of the columns of `part`.
    """

    part: np.ndarray
    size: np.ndarray
    stretch: np.ndarray
    missed: np.ndarray
    sizes: np.ndarray
    rows: np.ndarray
    ends: np.ndarray
    delta: np.ndarray
    norm: np.ndarray

    @classmethod
    def of(cls, T, c, G, rows, delta, stretch, wall=0.0):
        """Return what changes delta make of the stretch of bonds, where a wall may move as well.

        Not collective; `rows` are the 2-norms of the rows of G.
        """
        w, steps = stretch + wall, len(delta)
        part = np.cumsum(T * (-c * (w @ T)), axis=1)
        stretch = w[:, None] + G @ part
        upper = np.tri(steps).T  # bonds change one after the other
        missed = upper * (part + delta[:, None] * stretch)
        # Displacements of bonds are differences, rounded once; then come s products and sums.
        rows, ends = (steps + 8) * EPSILON * rows, EPSILON * (4 * np.abs(w) + wall)
        return cls(
            part, np.abs(part), stretch, missed, np.abs(missed),
            rows, ends, np.abs(delta)[:, None] * upper,
            np.sqrt(squares(part)) + np.sqrt(2 * steps * TINIEST),
        )  # fmt: skip

    def stretch_rounding(self, weights):
        """Return bounds, step by step, of what rounding does to a sum of weights times stretches.

        Not collective; `weights` of shape (s, s) are not negative.
        """
        return (self.rows @ weights) * self.norm + self.ends @ weights

    def missed_rounding(self, weights):
        """Return the same for weights times `missed`. Not collective."""
        changed = self.stretch_rounding(self.delta * weights)
        return changed + 2 * EPSILON * np.einsum("it,it->t", weights, self.size)

    def residual(self, start, columns):
        """Return bounds of |r|_2 after each step.

        Not collective.

        Parameters
        ----------
        start : float
            A bound of |r0|_2.
        columns : numpy.ndarray, shape (s,)
            Bounds of the residuals of the columns of Y.
        """
        missed = np.sum(self.sizes, axis=0) + self.missed_rounding(np.ones(self.size.shape))
        return start + columns @ self.size + BOND * missed


class Windows(Owner):
    """Solves windows of steps; destroy with `destroy` or `with`.

    Collective.

    Parameters
    ----------
    network : Network
    solver : pgran.solve.steady.SteadySolver
        Of the network's operators, with adjoints.
    omega : float

    Raises
    ------
    InputError
        If the solver's preconditioner is no factorization, or there is no damping.
    """

    def __init__(self, network, solver, omega):
        """Make the blocks of right-hand sides and solutions."""
        if network.operators.damping == 0:
            raise InputError(
                "-relax_method window: needs damping (-lattice_damping), which bounds the error of "
                "every step; -relax_method krylov or direct does without"
            )
        if solver.factor is None:
            raise InputError(
                "-relax_method window: needs a factorization (-steady_pc_type cholesky or lu); "
                "-relax_method krylov does without"
            )
        self.network, self.solver, self.omega = network, solver, omega
        self.comm = network.operators.comm
        rows = network.operators.f.getSizes()
        self._rhs, self._found, self._residual = (
            PETSc.Mat().createDense((rows, (None, COLUMNS)), comm=self.comm) for _ in range(3)
        )
        for block in (self._rhs, self._found, self._residual):
            block.setUp()
            block.assemble()

    def destroy(self):
        """Free the blocks. Collective."""
        for block in (self._rhs, self._found, self._residual):
            block.destroy()

    def start(self):
        """Return the steady state of the network as it is, from a fresh factorization. Collective.

        Returns
        -------
        pgran.solve.steady.SteadyState
        """
        self.solver.restart()
        self.state = self.solver.solve(self.omega)
        return self.state

    def follow(self, changes):
        """Return the amplitudes after each of some changes, `start` being the state before them.

        Collective. The network stays as it is.

        Parameters
        ----------
        changes : Changes

        Returns
        -------
        after, error_bound : numpy.ndarray, shape (n, nd)
            n is smaller than the number of changes, even 0, where more would lose accuracy.
        """
        wanted, solver, network = len(changes), self.solver, self.network
        changes = changes.extended(SHORTEST)
        before, ends = self.state.displacement, network.operators.bond_ends[changes.bond]
        after = np.empty((len(changes), len(before)), dtype=complex)
        error_bound = np.empty(after.shape)
        if self.state.converged_reason <= 0:
            return after[:0], error_bound[:0]
        G, sizes, residuals = self._flexibility(ends)
        systems = [solver.primal, *solver.adjoints]
        fields = np.stack([system.solution.getArray(readonly=True) for system in systems], axis=1)
        # rows of their own: see SHORTEST
        w, *adjoint_w = np.ascontiguousarray(self._stretch(fields, ends).T)
        delta, steps = network.differences(changes), len(changes)
        bounds = solver.bounds
        terms = bounds.rounding(solver.primal.solution)
        r0 = bounds.primal_residual(solver.primal, terms)
        with np.errstate(all="ignore"):
            (T, c), rows = march(G, delta), np.sqrt(squares(G.T))
            driven = network.operators.driven_bonds[changes.bond]
            primal = Deformation.of(T, c, G, rows, delta, w, driven)
            moved, r = sizes @ primal.size, primal.residual(r0, residuals)
            for d, (system, q) in enumerate(zip(solver.adjoints, adjoint_w, strict=True)):
                adjoint = Deformation.of(T, c, G, rows, delta, q)
                s0 = bounds.adjoint_residual(system)
                left_out = np.sum(adjoint.stretch * primal.missed, axis=0)
                amplitude = before[d] + q @ primal.part - left_out
                after[:, d] = amplitude
                reach = np.abs(adjoint.stretch)
                products = np.abs(q) @ primal.size + np.einsum("it,it->t", reach, primal.sizes)
                rounding = EPSILON * (steps + 6) * products
                rounding += primal.missed_rounding(reach) + adjoint.stretch_rounding(primal.sizes)
                left = s0 * moved + (sizes @ adjoint.size) * (r0 + residuals @ primal.size)
                theory = r * adjoint.residual(s0, residuals) / bounds.stability(self.omega)
                error_bound[:, d] = 1.01 * (theory + left + rounding)
                error_bound[:, d] += bounds.evaluation(r0, terms, system, before[d])
                error_bound[:, d] += 4 * EPSILON * np.abs(amplitude)
            error_bound += 64 * steps**2 * TINIEST
            kept = is_accurate(error_bound, after, min(solver.tolerance, LONGEST_REACH))
            # The floor is for what was no more accurate at the start either.
            known = is_accurate(self.state.error_bound, before, solver.tolerance)
            kept |= (error_bound <= solver.floor) & ~known
        kept = np.all(kept, axis=1)
        count = wanted if np.all(kept[:wanted]) else np.argmin(kept)
        return after[:count], error_bound[:count]

    def _flexibility(self, ends):
        """Return G = B^T Y from block solves with the factorization, and bounds of two norms.

        Those of Y and of its residual, column by column. A KSP may make up for an inexact
        factorization; here its residual shows.
        """
        S, factor, bounds = self.network.operators.S, self.solver.factor, self.solver.bounds
        first, last = self._rhs.getOwnershipRange()
        columns, norms = [], []
        for start in range(0, len(ends), COLUMNS):
            chunk = ends[start : start + COLUMNS]
            block = self._rhs.getDenseArray()
            block[:] = 0.0
            for side, sign in ((0, -1.0), (1, 1.0)):
                mine = np.flatnonzero((chunk[:, side] >= first) & (chunk[:, side] < last))
                block[chunk[mine, side] - first, mine] = sign
            self._rhs.assemble()
            factor.matSolve(self._rhs, self._found)
            S.matMult(self._found, self._residual)
            self._residual.axpy(-1.0, self._rhs, structure=SAME)
            found, missed = (
                block.getDenseArray(readonly=True)[:, : len(chunk)]
                for block in (self._found, self._residual)
            )
            columns.append(self._stretch(found, ends))
            norms.append([squares(found), squares(missed)])
        total = np.concatenate(norms, axis=1)
        if self.comm.size > 1:
            self.comm.Allreduce(MPI.IN_PLACE, total)
        sizes, residuals = 1.01 * np.sqrt(total)
        sizes += bounds.lost
        residuals += bounds.unit * (BOND + bounds.scale * sizes) + bounds.lost
        return np.concatenate(columns, axis=1), sizes, residuals

    def _stretch(self, fields, ends):
        """Return b^T x for each bond b and each column x of this rank's rows, on every rank."""
        first, last = self._rhs.getOwnershipRange()
        stretch = np.zeros((len(ends), fields.shape[1]), dtype=complex)
        for side, sign in ((0, -1.0), (1, 1.0)):
            mine = (ends[:, side] >= first) & (ends[:, side] < last)
            stretch[mine] += sign * fields[ends[mine, side] - first]
        if self.comm.size > 1:
            self.comm.Allreduce(MPI.IN_PLACE, stretch)
        return stretch


def squares(columns):
    """Return the sum of squares of each column of this rank's part of a block. Not collective."""
    rows = np.ascontiguousarray(columns.T).view(float)
    return np.einsum("ij,ij->i", rows, rows)
