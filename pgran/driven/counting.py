"""How many eigenvalues of K lie below a shift.

By Sylvester's law the factorization K - sigma = L D L^T has as many negative entries in D as K has
eigenvalues below sigma. It costs a factorization and makes no vectors.
"""

import contextlib

import numpy as np
from mpi4py import MPI

from pgran.driven.inertia import RealFactors, real_matrix
from pgran.driven.linear import accept_small_pivots
from pgran.driven.operators import SAME, Owner
from pgran.run.petsc import PETSc

SLOW = 0.05  # seconds of a lattice's factorization from which SuperLU's dense blocks are faster


def flag_hermitian(matrix):
    """Let PETSc know of a real symmetric matrix that it is one."""
    matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    matrix.setOption(PETSc.Mat.Option.HERMITIAN, True)


class ModeCounter(Owner):
    """Counts the eigenvalues below a shift of K, or C, of a lattice or network.

    Each rank counts on a copy of its own, because PETSc's own factorization, the only one that
    gives the inertia of complex matrices everywhere, is serial. Where it would take long (`SLOW`;
    `costly` beside a search for some modes) SciPy's SuperLU does it unless options choose. No
    eigenvalue exceeds `norm`, |K|_inf, 1 if K is zero; there are `order` of them.
    """

    owns = ("_pc", "_shifted", "_x", "_rhs", "_residual")

    def __init__(self, K, lattice):
        self.K, self.norm = K, K.norm(PETSc.NormType.INFINITY) or 1.0
        self.order, self.comm = K.getSize()[0], MPI.COMM_SELF
        self.semidefinite = lattice.semidefinite
        self._shifted = K.duplicate(copy=True)
        flag_hermitian(self._shifted)
        self._x, self._rhs = K.createVecs()
        self._residual = self._rhs.duplicate()
        self._rhs.setArray(np.random.Generator(np.random.Philox(1)).standard_normal(self.order))
        self.costly = lattice.elimination.costly
        chosen = PETSc.Options("normal_count_").hasName("pc_type")
        slow = self.costly or (lattice.is_grid and lattice.elimination.seconds > SLOW)
        self._factor = self._by_superlu if slow and not chosen else self._by_petsc
        self._pc = PETSc.PC().create(K.getComm())
        self._pc.setOptionsPrefix("normal_count_")
        self._pc.setType("cholesky")
        if lattice.elimination.numbered:  # its unknowns are numbered in that order
            self._pc.setFactorOrdering("natural")
        self._pc.setOperators(self._shifted)
        self._pc.setFromOptions()
        accept_small_pivots(self._pc)

    def below(self, shift, clearance):
        """Return how many eigenvalues lie below a shift, or None where that is uncertain.

        It is certain if none lies within `clearance`: the counts on both sides agree, and each is
        of a matrix much closer to K - shift than that.
        """
        counts = {self._inertia(shift + side * clearance, 0.1 * clearance) for side in (-1, 1)}
        return counts.pop() if len(counts) == 1 else None

    def _inertia(self, shift, allowed):
        """Count the negative pivots of K - shift; None if the factors miss it by more than allowed.

        Without pivoting, a tiny pivot spoils the factors. E = K - shift - L D L^T is estimated by
        |E x| / |x| of one solution x, L D L^T x = b, of a random b: E x = (K - shift) x - b.
        """
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
        try:
            factors = RealFactors(real_matrix(self._shifted), 0.0)
        except ZeroDivisionError:
            return 0, 1
        self._x.setArray(factors.solve(self._rhs.getArray(readonly=True).real))
        return factors.negative or 0, factors.negative is None
