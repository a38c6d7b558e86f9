"""The smallest eigenvalues of damping, proven by factors, and of stiffness, certified by counts."""

import numpy as np
from mpi4py import MPI

from pgran.driven.counting import ModeCounter
from pgran.driven.inertia import RealFactors
from pgran.driven.operators import NetworkLayout
from pgran.medium.springs import norm_of
from pgran.run.petsc import PETSc

PARTS = (0.9, 0.5, 0.1, 0.01)  # of an estimate of the smallest eigenvalue that are tried
STEPS = 20  # of inverse iteration at most
SHARP = 0.05  # of the shift: how sharp the bound of the factors' error need be
ENOUGH = 0.99  # of the last quotient: inverse iteration that lowers it less has come near enough
FLOORS = (1e-10, 1e-8, 1e-6, 1e-4, 1e-2, 0.1)  # of |K|: how far below zero its eigenvalues may be


def smallest_damping(lattice):
    """Return a number that no eigenvalue of C is below, drag included; 0 if none is certain.

    The same on every rank. It is counted once where no closed form is known, on a copy of this
    rank's own.
    """
    cache = vars(lattice)
    if "smallest_damping" not in cache:
        least, drag = 0.0, np.ravel(lattice.dragged)
        if lattice.isotropic:
            least = (lattice.least_damping if lattice.damping else 0.0) + drag.min()
        if not lattice.isotropic or (least <= 0 and lattice.drags is not None):
            least = _least(lattice, lattice.dashpots, lattice.damping_norm, drag)
        cache["smallest_damping"] = least
    return cache["smallest_damping"]


def smallest_loss(lattice):
    """Return a number that no eigenvalue of L is below, 0 if none above 0 is certain; counted once.

    L = B^T diag(eta k) B of what springs lose by themselves, which negative eigenvalues would feed.
    """
    cache = vars(lattice)
    if lattice.losses is None:
        return 0.0
    if "smallest_loss" not in cache:
        norm = norm_of(lattice.springs.B, np.abs(lattice.losses))
        cache["smallest_loss"] = _least(lattice, lattice.losses, norm)
    return cache["smallest_loss"]


def least_stiffness(network):
    """Return a number that no eigenvalue of K is below; 0 if none above 0 is certain."""
    return _least(network, network.constants, network.stiffness_norm)


def smallest_stiffness(operators):
    """Return a number that no eigenvalue of K is below; 0 where no spring's constant is negative.

    The same on every rank; computed once for the constants that operators have.
    """
    if operators.softest is None:
        constants, operators.softest = operators.constants.real, 0.0
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
        csr = layout.csr(constants)
    matrix = PETSc.Mat().createAIJ((network.size,) * 2, csr=csr, comm=MPI.COMM_SELF)
    with ModeCounter(matrix, network) as counter:
        certain = (p for p in FLOORS if counter.below(-p * counter.norm, p / 2 * counter.norm) == 0)
        part = next(certain, 1.01)
    matrix.destroy()
    return part, counter.norm


def _least(medium, constants, norm, diagonal=0.0):
    """Return what no eigenvalue of B^T diag(constants) B + diag(diagonal) is below; 0 if unknown.

    Its magnitudes sum up to `norm`. Inverse iteration estimates the smallest eigenvalue from above.
    None is below a part of it, but for the error of factors of the matrix less that part, if these
    have no negative pivot.
    """
    from scipy.sparse import csc_matrix

    with NetworkLayout(medium, MPI.COMM_SELF) as layout:
        pointer, columns, values = layout.csr(constants)
    if np.any(diagonal):
        rows = np.repeat(np.arange(medium.size), np.diff(pointer))
        values[rows == columns] += np.broadcast_to(diagonal, medium.size)[medium.order]
    matrix = csc_matrix((values.real.copy(), columns, pointer))  # symmetric: rows are columns
    rounding = medium.rounding * norm  # of the sums that its entries are
    try:
        # Were it singular, pivots that rounding leaves would exchange rows and fill the factors.
        estimate = _estimate(matrix, RealFactors(matrix, -8 * rounding))
        for part in PARTS:
            shift = part * estimate
            if not shift > 2 * rounding:  # NaN too
                break
            factors = RealFactors(matrix, shift)
            if factors.negative == 0:
                least = shift - factors.error(SHARP * shift) - rounding
                if least > 0:
                    return 0.99 * least
    except ZeroDivisionError:
        pass
    return 0.0


def _estimate(matrix, factors):
    """Return the Rayleigh quotient of inverse iteration, once a step changes it little."""
    x = np.random.Generator(np.random.Philox(1)).standard_normal(matrix.shape[0])
    last = np.inf
    for _ in range(STEPS):
        x = factors.solve(x)
        x /= np.linalg.norm(x)
        quotient = x @ (matrix @ x)
        if not quotient < ENOUGH * last:  # NaN too
            break
        last = quotient
    return quotient
