"""The smallest eigenvalues of damping and stiffness, certified by counts."""

import contextlib

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from pgran.physics.lattice import Lattice, smallest_damping_eigenvalue
from pgran.solve.counting import MARGIN, ModeCounter
from pgran.solve.layout import NetworkLayout

PARTS = (0.9, 0.5, 0.1, 0.01)  # of the estimate that are tried
STEPS = 20  # of inverse iteration
FLOORS = (1e-10, 1e-8, 1e-6, 1e-4, 1e-2, 0.1)  # of |K|: how far below zero its eigenvalues may be


def smallest_damping(lattice):
    """Return a number that no eigenvalue of C = B^T diag(damped) B is below; 0 if none is certain.

    Not collective, the same on every rank. Of a network it is found out once, on a copy of this
    rank's own: an estimate by inverse iteration is certified by Sylvester's law, as a factorization
    of C less a little more than that number has no negative pivot.
    """
    if isinstance(lattice, Lattice):
        return smallest_damping_eigenvalue(lattice.shape)
    known = vars(lattice)
    if "smallest_damping" not in known:
        with NetworkLayout(lattice, MPI.COMM_SELF) as layout:
            known["smallest_damping"] = _certified(lattice, *layout.csr(layout.damped))
    return known["smallest_damping"]


def is_stable(network):
    """Return whether no eigenvalue of K is negative but for rounding, certified by a count.

    Not collective, the same on every rank.
    """
    with NetworkLayout(network, MPI.COMM_SELF) as layout:
        pointer, columns, values = layout.csr(network.constants)
    with _hermitian(pointer, columns, values) as matrix, ModeCounter(matrix, network) as counter:
        margin = MARGIN * counter.norm
        return counter.below(-margin, 0.5 * margin) == 0


def smallest_stiffness(operators):
    """Return a number that no eigenvalue of K is below; 0 where no spring's constant is negative.

    Not collective, the same on every rank; found out once for the constants that operators have.
    """
    if operators.softest is None:
        operators.softest = 0.0
        if operators.constants.min(initial=0.0) < 0:
            with NetworkLayout(operators.lattice, MPI.COMM_SELF) as layout:
                operators.softest = _certified_floor(*layout.csr(operators.constants))
    return operators.softest


def _certified_floor(pointer, columns, values):
    """Return the same for a matrix."""
    with _hermitian(pointer, columns, values) as matrix, ModeCounter(matrix) as counter:
        shifts = (-part * counter.norm for part in FLOORS)
        certain = (shift for shift in shifts if counter.below(shift, -0.5 * shift) == 0)
        return next(certain, -1.01 * counter.norm)


@contextlib.contextmanager
def _hermitian(pointer, columns, values):
    """Return, for a `with`, a real symmetric matrix, flagged as what it is."""
    size = (len(pointer) - 1,) * 2
    matrix = PETSc.Mat().createAIJ(size, csr=(pointer, columns, values), comm=MPI.COMM_SELF)
    for flag in (PETSc.Mat.Option.SYMMETRIC, PETSc.Mat.Option.HERMITIAN):
        matrix.setOption(flag, True)
    yield matrix
    matrix.destroy()


def _certified(network, pointer, columns, values):
    """Return the same for a matrix."""
    from scipy.sparse import csc_matrix
    from scipy.sparse.linalg import splu

    C = csc_matrix((values.real.copy(), columns, pointer))  # symmetric: rows are columns
    try:
        factors = splu(C)
    except RuntimeError:  # singular
        return 0.0
    x = np.random.Generator(np.random.Philox(1)).standard_normal(C.shape[0])
    for _ in range(STEPS):
        x = factors.solve(x)
        size = np.linalg.norm(x)
        if not 0 < size < np.inf:
            return 0.0
        x /= size
    estimate, found = x @ (C @ x), 0.0
    with _hermitian(pointer, columns, values) as matrix, ModeCounter(matrix, network) as counter:
        for part in PARTS:
            shift, clearance = part * estimate, 0.05 * part * estimate
            if counter.below(shift, clearance) == 0:
                # the count is of a matrix nearer to C - shift than a tenth of the clearance
                found = 0.99 * (shift - clearance)
                break
    return found
