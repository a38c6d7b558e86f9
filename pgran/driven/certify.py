"""The smallest eigenvalues of damping, proven by factors, and of stiffness, certified by counts."""

import contextlib

import numpy as np
from mpi4py import MPI

from pgran.driven.counting import ModeCounter
from pgran.driven.layout import NetworkLayout
from pgran.medium.graph import SYMMETRIC
from pgran.medium.rounding import EPSILON
from pgran.run.petsc import PETSc

PARTS = (0.9, 0.5, 0.1, 0.01)  # of an estimate of the smallest eigenvalue that are tried
STEPS = 20  # of inverse iteration at most
ENOUGH = 0.99  # of the last quotient: inverse iteration that lowers it less has come near enough
FLOORS = (1e-10, 1e-8, 1e-6, 1e-4, 1e-2, 0.1)  # of |K|: how far below zero its eigenvalues may be


def smallest_damping(lattice):
    """Return a number that no eigenvalue of C = B^T diag(damped) B is below; 0 if none is certain.

    The same on every rank. Of a network it is computed once, on a copy of this rank's own.
    """
    if lattice.isotropic:
        return lattice.least_damping
    cache = vars(lattice)
    if "smallest_damping" not in cache:
        with NetworkLayout(lattice, MPI.COMM_SELF) as layout:
            cache["smallest_damping"] = _certified_damping(lattice, *layout.csr(layout.damped))
    return cache["smallest_damping"]


def smallest_stiffness(operators):
    """Return a number that no eigenvalue of K is below; 0 where no spring's constant is negative.

    The same on every rank; computed once for the constants that operators have.
    """
    if operators.softest is None:
        constants, operators.softest = operators.constants, 0.0
        if constants.min(initial=0.0) < 0:
            part, norm = _floor(operators.lattice, constants)
            operators.softest = -part * norm
    return operators.softest


def is_stable(network):
    """Return whether no eigenvalue of K is negative but for rounding, certified by a count."""
    part, _ = _floor(network, network.constants)
    return part == FLOORS[0]


def _floor(network, constants):
    """Return how far below zero eigenvalues of K may be in units of its norm, and that norm."""
    with NetworkLayout(network, MPI.COMM_SELF) as layout:
        matrix = layout.csr(constants)
    with _counter(network, *matrix) as counter:
        certain = (p for p in FLOORS if counter.below(-p * counter.norm, p / 2 * counter.norm) == 0)
        return next(certain, 1.01), counter.norm


@contextlib.contextmanager
def _counter(network, pointer, columns, values):
    """Return, for a `with`, what counts the eigenvalues of a real symmetric matrix."""
    size = (len(pointer) - 1,) * 2
    matrix = PETSc.Mat().createAIJ(size, csr=(pointer, columns, values), comm=MPI.COMM_SELF)
    with ModeCounter(matrix, network) as counter:
        yield counter
    matrix.destroy()


def _certified_damping(network, pointer, columns, values):
    """Return what `smallest_damping` does, for a C that is no Laplacian.

    Inverse iteration estimates the smallest eigenvalue from above. None is below a part of it but
    for the error of factors L D L^T of C less that part, if D is positive.
    """
    from scipy.sparse import csc_matrix, identity
    from scipy.sparse.linalg import splu

    C = csc_matrix((values.real.copy(), columns, pointer))  # symmetric: rows are columns
    rounding = network.rounding * network.damping_norm  # of C's own sums
    one = identity(C.shape[0], format="csc")
    try:
        # Where C is singular, pivots that rounding leaves would exchange rows and fill the factors.
        estimate = _estimate(C, splu(C + 8 * rounding * one, "NATURAL", **SYMMETRIC))
        for part in PARTS:
            if not part * estimate > 2 * rounding:  # NaN too
                break
            factors = splu(C - part * estimate * one, "NATURAL", **SYMMETRIC)
            least = part * estimate - _factor_error(factors) - rounding
            if least > 0:
                return 0.99 * least
    except RuntimeError:  # singular
        pass
    return 0.0


def _estimate(C, factors):
    """Return the Rayleigh quotient of inverse iteration, once a step changes it little."""
    x = np.random.Generator(np.random.Philox(1)).standard_normal(C.shape[0])
    last = np.inf
    for _ in range(STEPS):
        x = factors.solve(x)
        x /= np.linalg.norm(x)
        quotient = x @ (C @ x)
        if not quotient < ENOUGH * last:  # NaN too
            break
        last = quotient
    return quotient


def _factor_error(factors):
    """Return a bound of |A - L D L^T|_2 of a symmetric A; infinite unless D is positive.

    With D the diagonal of U it is at most the row sums of g |L| |U| + |L| |U - D L^T|, where
    |A - L U| <= g |L| |U| without exchanged rows (Higham, Accuracy and Stability of Numerical
    Algorithms, theorem 9.3), g = n eps of at most n factors in a row of L.
    """
    from scipy.sparse import diags

    L, U = factors.L, factors.U
    pivots = U.diagonal()
    if not np.all(pivots > 0) or not np.array_equal(factors.perm_r, factors.perm_c):
        return np.inf
    longest = np.bincount(L.indices).max() + 8
    uneven = abs(U - diags(pivots) @ L.T)
    row_sums = longest * EPSILON * (abs(U) @ np.ones(len(pivots))) + uneven @ np.ones(len(pivots))
    return 1.01 * float((abs(L) @ row_sums).max())
