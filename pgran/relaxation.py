"""One bond a step: the amplitude at the detectors while the network of bonds is redrawn.

At each step one bond, drawn uniformly, gets a new constant from the bond law. Both draws are a pure
function of (seed, trajectory, step), so the changes of the next steps are known ahead. A change
delta of bond b turns S into S + delta b b^T and moves the drive along when b ends at the driven
wall; with w = b^T A, the driven wall counted as displacement 1, the amplitudes become

    A' = A - S^-1 b c w,    c = delta / (1 + delta b^T S^-1 b).

So the amplitudes of a window of steps follow exactly from one factorization at its start, one solve
for each of its bonds, and algebra among those bonds alone.
"""

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from pgran.errors import InputError
from pgran.lattice import bond_arrays, bond_count
from pgran.operators import SAME, Owner
from pgran.steady import BACKWARD_ERROR
from pgran.stiffness import unit_numbers

COLUMNS = 32  # right-hand sides solved for at once
# A window ends where rounding is estimated to reach this part of an amplitude.
LARGEST_LOSS = 1e-12
EPSILON = np.finfo(float).eps


@dataclass(frozen=True)
class Changes:
    """Which bonds change, and to what.

    Attributes
    ----------
    bond : numpy.ndarray of int, shape (n,)
        Numbers of bonds, axis after axis, each array in C order.
    stiffness : numpy.ndarray, shape (n,)
        Their new constants.
    """

    bond: np.ndarray
    stiffness: np.ndarray

    def __getitem__(self, part):
        """Return some of the changes."""
        return Changes(self.bond[part], self.stiffness[part])

    def __len__(self):
        """Return how many there are."""
        return len(self.bond)


def draw_changes(law, shape, seed, trajectory, first, count):
    """Return the changes of `count` steps from step `first` on, counted from 0.

    Not collective; the same on every rank.

    Parameters
    ----------
    law : callable
        Turns numbers uniform on [0, 1) into bond constants (`pgran.stiffness.BondLaw`).
    shape : sequence of int
        Balls along each axis.
    seed, trajectory, first, count : int
        Trajectories of one seed are independent.
    """
    u = unit_numbers(seed, 2 * first, 2 * count, generation=1 + trajectory)
    bonds = bond_count(shape)
    return Changes(np.minimum((u[::2] * bonds).astype(np.int64), bonds - 1), law(u[1::2]))


def march(G, w, q, delta):
    """Change one bond after the other; return what each adds to the amplitudes.

    Not collective. This is the LDL^T factorization of diag(1/delta) + G without pivoting, whose
    leading blocks are the networks after each step.

    Parameters
    ----------
    G : numpy.ndarray, shape (s, s)
        b^T S^-1 b' of the changing bonds before any change.
    w : numpy.ndarray, shape (s,)
        Their relative displacements.
    q : numpy.ndarray, shape (s, nd)
        Those in the adjoints of the detectors.
    delta : numpy.ndarray, shape (s,)
        By how much each changes.

    Returns
    -------
    increments : numpy.ndarray, shape (s, nd)
    rounding : numpy.ndarray, shape (s, nd)
        What rounding may have done to each, estimated: a pivot inherits the rounding of the
        flexibility before all changes, relative to its own size.
    """
    steps = len(delta)
    A = np.concatenate([G, w[:, None], q], axis=1)
    c, pivot = np.empty(steps, dtype=complex), np.empty(steps, dtype=complex)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for t in range(steps):
            pivot[t] = 1.0 + delta[t] * A[t, t]
            c[t] = delta[t] / pivot[t]
            A[t + 1 :, t + 1 :] -= np.multiply.outer(c[t] * A[t + 1 :, t], A[t, t + 1 :])
        increments = -(c * A[:, steps])[:, None] * A[:, steps + 1 :]
        gain = 1.0 + np.abs(delta * np.diagonal(G) / pivot)
        return increments, EPSILON * gain[:, None] * np.abs(increments)


class Network:
    """The bonds of a lattice while they change, in an array and in its operators.

    Collective.

    Parameters
    ----------
    lattice : pgran.lattice.Lattice
        Before any change.
    operators : pgran.operators.Operators
    draw : callable
        Takes a trajectory, the first step and how many, and returns their Changes.
    """

    def __init__(self, lattice, operators, draw):
        """Start from the lattice's bonds."""
        self.shape, self.operators, self.draw = lattice.shape, operators, draw
        self.initial = np.concatenate([k.ravel() for k in lattice.stiffness])
        self.bonds = self.initial.copy()
        self.trajectory, self.step = 0, 0

    def move_to(self, trajectory, step):
        """Set all bonds to what they are before a step; the operators anew. Collective."""
        if trajectory != self.trajectory or step < self.step:
            self.bonds[:] = self.initial
            self.step = 0
        changes = self.draw(trajectory, self.step, step - self.step)
        self.bonds[changes.bond] = changes.stiffness
        self.trajectory, self.step = trajectory, step
        self.operators.set_stiffness(bond_arrays(self.shape, self.bonds))

    def differences(self, changes):
        """Return by how much each change moves its bond, repeated bonds included."""
        before = self.bonds[changes.bond]
        order = np.argsort(changes.bond, kind="stable")
        again = changes.bond[order][1:] == changes.bond[order][:-1]
        before[order[1:][again]] = changes.stiffness[order[:-1][again]]
        return changes.stiffness - before

    def apply(self, changes):
        """Carry out the changes of the next steps. Collective."""
        self.bonds[changes.bond] = changes.stiffness  # of several of one bond the last holds
        self.operators.change_bonds(np.unique(changes.bond), self.bonds)
        self.step += len(changes)


class Windows(Owner):
    """Solves windows of steps; destroy with `destroy` or `with`.

    Collective.

    Parameters
    ----------
    network : Network
    solver : pgran.steady.SteadySolver
        Of the network's operators, with adjoints.
    omega : float

    Raises
    ------
    InputError
        If the solver's preconditioner is no factorization.
    """

    def __init__(self, network, solver, omega):
        """Make the blocks of right-hand sides and solutions."""
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
        pgran.steady.SteadyState
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
        numpy.ndarray, shape (n, nd)
            n is smaller than the number of changes, even 0, where more would miss the accuracy.
        """
        operators, before = self.network.operators, self.state.displacement
        ends = operators.bond_ends[changes.bond]
        flexibility = self._flexibility(ends)
        if self.state.converged_reason <= 0 or flexibility is None:
            return np.empty((0, len(before)), dtype=complex)
        fields = np.stack([v.getArray(readonly=True) for v in self.solver.solutions], axis=1)
        stretch = self._stretch(fields, ends)
        w = stretch[:, 0] + operators.driven_bonds[changes.bond]
        increments, rounding = march(
            flexibility, w, stretch[:, 1:], self.network.differences(changes)
        )
        after = before + np.cumsum(increments, axis=0)
        loss = EPSILON * np.abs(before) + np.cumsum(rounding, axis=0)
        error = loss + np.nan_to_num(self.state.error_bound)
        kept = loss <= LARGEST_LOSS * np.abs(after)
        kept &= error <= self.solver.tolerance * np.abs(after)
        kept = np.all(kept, axis=1)
        return after[: len(after) if np.all(kept) else np.argmin(kept)]

    def _flexibility(self, ends):
        """Return b^T S^-1 b' for all pairs of bonds, from block solves with the factorization.

        None if the factorization does not solve: a KSP may make up for an inexact one, this cannot.
        """
        S, factor = self.network.operators.S, self.solver.factor
        scale = S.norm(PETSc.NormType.INFINITY)
        first, last = self._rhs.getOwnershipRange()
        columns, exact = [], True
        for start in range(0, len(ends), COLUMNS):
            chunk = ends[start : start + COLUMNS]
            block = self._rhs.getDenseArray()
            block[:] = 0.0
            for side, sign in ((0, -1.0), (1, 1.0)):
                mine = np.flatnonzero((chunk[:, side] >= first) & (chunk[:, side] < last))
                block[chunk[mine, side] - first, mine] = sign
            self._rhs.assemble()
            factor.matSolve(self._rhs, self._found)
            found = self._found.getDenseArray(readonly=True)[:, : len(chunk)]
            columns.append(self._stretch(found, ends))
            allowed = scale * self._found.norm() + self._rhs.norm()
            S.matMult(self._found, self._residual)
            self._residual.axpy(-1.0, self._rhs, structure=SAME)
            exact = exact and self._residual.norm() <= BACKWARD_ERROR * allowed
        return np.concatenate(columns, axis=1) if exact else None

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


def window_length(balls):
    """Return how many steps a factorization should serve.

    Measured: the factorization's price a step falls like 1/s, that of the algebra grows like s^2.
    """
    return 64 if balls < 5000 else 128
