"""Linear systems with the matrix S: the KSP that solves them, and a right-hand side's state."""

import math

from mpi4py import MPI  # noqa: F401 (first: PETSc may have no MPI library of its own)
from petsc4py import PETSc

TINY = 1e-300
# Larger lattices go to MUMPS: it factors faster, but each of its solves is dearer.
PETSC_FACTORS = {1: 10**7, 2: 50_000, 3: 4_000}
# Up to so many balls the ordering by minimum degree leaves less work than nested dissection.
MINIMUM_DEGREE = {1: 10**7, 2: 2500, 3: 0}


class System:
    """One right-hand side of S with its solution and true residual."""

    def __init__(self, rhs):
        """Share `rhs`; own the rest."""
        self.rhs = rhs
        self.solution, self.residual, self.earlier = (rhs.duplicate() for _ in range(3))
        self.norm = math.inf

    def destroy(self):
        """Free what is owned. Collective."""
        for held in (self.solution, self.residual, self.earlier):
            held.destroy()

    def advance(self):
        """Make room for the next solution; this one becomes the earlier one. Not collective."""
        self.solution, self.earlier = self.earlier, self.solution

    def start_from_zero(self):
        """Guess nothing. Collective."""
        self.solution.set(0.0)
        self.rhs.copy(self.residual)
        self.norm = self.residual.norm()

    def start_from_preconditioner(self, pc, matrix):
        """Guess the preconditioned right-hand side: the solution, if `pc` is a factorization.

        Collective.
        """
        pc.apply(self.rhs, self.solution)
        self.update_residual(matrix)
        if not self.norm <= self.rhs.norm():  # NaN too
            self.start_from_zero()

    def start_from_line(self, step, matrix):
        """Guess by a straight line through the last two solutions, `step` of their distance on.

        Collective.
        """
        self.solution.scale(-step)
        self.solution.axpy(1.0 + step, self.earlier)
        self.update_residual(matrix)

    def update_residual(self, matrix):
        """Compute the true residual and its norm. Collective."""
        matrix.mult(self.solution, self.residual)
        self.residual.aypx(-1.0, self.rhs)
        self.norm = self.residual.norm()


def factor_package(shape, ranks):
    """Return what factors the matrix of a lattice that so many ranks share. Not collective."""
    small = math.prod(shape) <= PETSC_FACTORS[len(shape)]
    return "petsc" if ranks == 1 and small else "mumps"


def make_ksp(operators):
    """Return the KSP for S, with the defaults, then as its options say (prefix `steady_`).

    Collective. The caller destroys it.

    Parameters
    ----------
    operators : pgran.operators.Operators
    """
    ksp = PETSc.KSP().create(operators.comm)
    ksp.setOptionsPrefix("steady_")
    ksp.setOperators(operators.S)
    ksp.setType("bcgs")
    ksp.setTolerances(rtol=1e-13, atol=TINY, max_it=1000)
    pc = ksp.getPC()
    pc.setType("cholesky")
    if factor_package(operators.shape, operators.comm.size) != "petsc":
        pc.setFactorSolverType("mumps")
    elif operators.balls <= MINIMUM_DEGREE[len(operators.shape)]:
        pc.setFactorOrdering("qmd")
    ksp.setFromOptions()
    accept_small_pivots(pc)
    if ksp.getType() != "preonly":
        # The preconditioner applied once is the solution already if it is a fresh factorization.
        ksp.setInitialGuessKnoll(True)
    return ksp


def accept_small_pivots(pc):
    """Call no pivot zero that is not, unless options say otherwise. Not collective.

    PETSc's threshold is absolute, 2e-14, and the unit of stiffness is the user's. A pivot that is
    zero but for rounding shows in the residuals.

    Parameters
    ----------
    pc : petsc4py.PETSc.PC
        Of its final type.
    """
    pc.setFactorPivot(zeropivot=0.0)
    pc.setFromOptions()
