"""How many eigenvalues of K lie below a shift, and numbers that no eigenvalue of K, C, L is below.

By Sylvester's law the factorization K - sigma = L D L^T has as many negative entries in D as K has
eigenvalues below sigma. It costs a factorization and makes no vectors. What counts certify here,
the error of real factors proves elsewhere (`factors`).
"""

import contextlib

import numpy as np
from mpi4py import MPI

from pgran.driven.linear import accept_small_pivots
from pgran.driven.operators import SAME, NetworkLayout, Owner
from pgran.medium.springs import norm_of
from pgran.run.petsc import PETSc, logged

# Seconds of a factorization of squares and cubes, from which on SuperLU is faster.
SLOW_SECONDS = 0.015
TRIED_PARTS = (0.9, 0.5, 0.1, 0.01)  # of an estimate of the smallest eigenvalue that are tried
MOST_STEPS = 20  # of inverse iteration at most
CONVERGED_PART = 0.99  # of the last quotient: what lowers it less has come near enough
# of |K|: how far below zero its eigenvalues may be
STIFFNESS_FLOORS = (1e-10, 1e-8, 1e-6, 1e-4, 1e-2, 0.1)


def smallest_damping(lattice):
    """Return a number that no eigenvalue of C is below, drag included; 0 if none is certain.

    The same on every rank; counted once, on a copy of its own, where no closed form is known.
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
    """Return a number that no eigenvalue of L = B^T diag(eta k) B is below; 0 if unknown."""
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
    """Return a number that no eigenvalue of K is below; 0 where no constant is negative."""
    if operators.softest is None:
        constants, operators.softest = operators.constants.real, 0.0
        if constants.min(initial=0.0) < 0:
            part, norm = _floor(operators.lattice, constants)
            operators.softest = -part * norm
    return operators.softest


def is_stable(network):
    """Return whether no eigenvalue of K is negative but for rounding, certified by a count."""
    part, _ = _floor(network, network.constants)
    return part == STIFFNESS_FLOORS[0]


def _floor(network, constants):
    """Return how far below zero eigenvalues of K may be in units of its norm, and that norm."""
    with NetworkLayout(network, MPI.COMM_SELF) as layout:
        csr = layout.csr(constants)
    matrix = PETSc.Mat().createAIJ((network.size,) * 2, csr=csr, comm=MPI.COMM_SELF)
    with ModeCounter(matrix, network) as counter:
        norm, floors = counter.norm, STIFFNESS_FLOORS
        part = next((p for p in floors if counter.below(-p * norm, p / 2 * norm) == 0), 1.01)
    matrix.destroy()
    return part, norm


def _least(medium, constants, norm, diagonal=0.0):
    """Return what no eigenvalue of B^T diag(constants) B + diagonal is below; 0 if unknown."""
    from scipy.sparse import csc_matrix

    from pgran.driven.factors import RealFactors, proven_gap

    with NetworkLayout(medium, MPI.COMM_SELF) as layout:
        pointer, columns, values = layout.csr(constants)
    if np.any(diagonal):
        rows = np.repeat(np.arange(medium.size), np.diff(pointer))
        values[rows == columns] += np.broadcast_to(diagonal, medium.size)[medium.order]
    matrix = csc_matrix((values.real.copy(), columns, pointer))  # symmetric: rows are columns
    rounding = medium.rounding * norm  # of the sums that its entries are
    # Inverse iteration estimates the smallest eigenvalue from above; factors prove a part of it.
    try:
        # Were it singular, pivots that rounding leaves would exchange rows and fill the factors.
        estimate = _estimate(matrix, RealFactors(matrix, -8 * rounding))
    except ZeroDivisionError:
        return 0.0
    proven = (proven_gap(matrix, part * estimate, 0, rounding) for part in TRIED_PARTS)
    return next(filter(None, proven), 0.0)


def _estimate(matrix, factors):
    """Return the Rayleigh quotient of inverse iteration, once a step changes it little."""
    x = np.random.Generator(np.random.Philox(1)).standard_normal(matrix.shape[0])
    last = np.inf
    for _ in range(MOST_STEPS):
        x = factors.solve(x)
        x /= np.linalg.norm(x)
        quotient = x @ (matrix @ x)
        if not quotient < CONVERGED_PART * last:  # NaN too
            break
        last = quotient
    return quotient


class ModeCounter(Owner):
    """Counts the eigenvalues below a shift of K, or C, of a lattice or network.

    Each rank counts on a copy of its own, because PETSc's own factorization, the only one that
    gives the inertia of complex matrices everywhere, is serial. Where it would take long SciPy's
    SuperLU does it unless options choose. No eigenvalue exceeds `norm`, |K|_inf, 1 if K is zero;
    there are `order` of them.
    """

    owns = ("_pc", "_shifted", "_x", "_rhs", "_residual")

    def __init__(self, K, lattice):
        self.K, self.norm = K, K.norm(PETSc.NormType.INFINITY) or 1.0
        self.order, self.comm = K.getSize()[0], MPI.COMM_SELF
        self.semidefinite, elimination = lattice.semidefinite, lattice.elimination
        self._shifted = K.duplicate(copy=True)
        flag_hermitian(self._shifted)
        self._x, self._rhs = K.createVecs()
        self._residual = self._rhs.duplicate()
        self._rhs.setArray(np.random.Generator(np.random.Philox(1)).standard_normal(self.order))
        self.costly = elimination.costly
        chosen = PETSc.Options("normal_count_").hasName("pc_type")
        slow = lattice.is_grid and lattice.axes > 1 and elimination.seconds > SLOW_SECONDS
        slow = slow or self.costly
        self._factor = self._by_superlu if slow and not chosen else self._by_petsc
        self._pc = PETSc.PC().create(K.getComm())
        self._pc.setOptionsPrefix("normal_count_")
        self._pc.setType("cholesky")
        if elimination.numbered:  # its unknowns are numbered in that order
            self._pc.setFactorOrdering("natural")
        self._pc.setOperators(self._shifted)
        self._pc.setFromOptions()
        accept_small_pivots(self._pc)

    def below(self, shift, clearance):
        """Return how many eigenvalues lie below a shift; None unless none lies within `clearance`.

        Then the counts on both sides agree, each of a matrix much closer to K - shift than that.
        """
        counts = {self._inertia(shift + side * clearance, 0.1 * clearance) for side in (-1, 1)}
        return counts.pop() if len(counts) == 1 else None

    @logged("counts")
    def _inertia(self, shift, allowed):
        """Count the negative pivots of K - shift; None if factors miss it by more than allowed."""
        # Without pivoting, a tiny pivot spoils the factors. E = K - shift - L D L^T is estimated by
        # |E x| / |x| of a solution x of L D L^T x = b, b random: E x = (K - shift) x - b.
        self.K.copy(self._shifted, structure=SAME)
        self._shifted.shift(-shift)
        with contextlib.suppress(PETSc.Error):
            negative, zero = self._factor()
            self._shifted.mult(self._x, self._residual)
            self._residual.axpy(-1.0, self._rhs)
            if not zero and self._residual.norm() <= allowed * self._x.norm():  # false for NaN
                return negative
        self._pc.reset()  # else its failure would stay
        return None

    def _by_petsc(self):
        """Return how many pivots are negative, how many zero, and set x to a solution."""
        self._pc.setOperators(self._shifted)
        self._pc.setUp()
        self._pc.apply(self._rhs, self._x)
        return self._pc.getFactorMatrix().getInertia()[:2]

    def _by_superlu(self):
        """Return the same by real arithmetic on dense blocks: much faster where factors fill."""
        from pgran.driven.factors import RealFactors

        try:
            factors = RealFactors(real_matrix(self._shifted), 0.0)
        except ZeroDivisionError:
            return 0, 1
        self._x.setArray(factors.solve(self._rhs.getArray(readonly=True).real))
        return factors.negative or 0, factors.negative is None


def flag_hermitian(matrix):
    """Let PETSc know of a real symmetric matrix that it is one."""
    matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    matrix.setOption(PETSc.Mat.Option.HERMITIAN, True)


def real_matrix(K):
    """Return the real part of a symmetric PETSc.Mat of this rank alone, sparse by columns."""
    return complex_matrix(K).real.copy()  # which SuperLU needs in one piece


def complex_matrix(S):
    """Return a symmetric PETSc.Mat of this rank alone as a scipy.sparse.csc_matrix."""
    from scipy.sparse import csc_matrix

    pointer, columns, values = S.getValuesCSR()  # symmetric: rows are columns
    return csc_matrix((values, columns, pointer), S.getSize())
