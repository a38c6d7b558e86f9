"""Linear systems with the matrix S: the KSP that solves them, and a right-hand side's state."""

import math

from mpi4py import MPI
from petsc4py import PETSc

TINY = 1e-300
NO_PRECONDITIONER = int(PETSc.KSP.ConvergedReason.DIVERGED_PCSETUP_FAILED)
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

    @property
    def owned(self):
        """The vectors that are this system's own."""
        return self.solution, self.residual, self.earlier

    def destroy(self):
        """Free what is owned. Collective."""
        for vector in self.owned:
            vector.destroy()

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


def make_ksp(operators, matrix, prefix="steady_", kind="bcgs"):
    """Return a KSP on an LDL^T factorization by default, then as its options say.

    Collective. The caller destroys it.

    Parameters
    ----------
    operators : pgran.solve.operators.Operators
    matrix : petsc4py.PETSc.Mat
        S, or another one of its pattern.
    prefix : str
        Of the options.
    kind : str
        The type of KSP by default.
    """
    ksp = PETSc.KSP().create(operators.comm)
    ksp.setOptionsPrefix(prefix)
    ksp.setOperators(matrix)
    ksp.setType(kind)
    ksp.setTolerances(rtol=1e-13, atol=TINY, max_it=1000)
    pc = ksp.getPC()
    pc.setType("cholesky")
    if factor_package(operators.shape, operators.comm.size) != "petsc":
        pc.setFactorSolverType("mumps")
    elif operators.balls <= MINIMUM_DEGREE[len(operators.shape)]:
        pc.setFactorOrdering("qmd")
    ksp.setFromOptions()
    accept_small_pivots(pc)
    ignore_values_in_analysis(pc)
    if ksp.getType() != "preonly":
        # The preconditioner applied once is the solution already if it is a fresh factorization.
        ksp.setInitialGuessKnoll(True)
    return ksp


def set_up(ksp, matrix, comm):
    """Set up a KSP's preconditioner for the values of a matrix; return whether that worked.

    Collective. A KSP that failed is of no more use: PETSc keeps some failures for all later values.

    Parameters
    ----------
    ksp : petsc4py.PETSc.KSP
    matrix : petsc4py.PETSc.Mat
    comm : mpi4py.MPI.Comm
        Its ranks.
    """
    ksp.setOperators(matrix)  # without it a KSP overlooks new values
    ksp.setUp()
    failed = ksp.getConvergedReason() < 0  # says it of this rank alone
    if comm.size > 1:
        failed = comm.allreduce(failed, MPI.LOR)
    return not failed


def ignore_values_in_analysis(pc):
    """Let the symbolic factorization see the pattern alone, unless options say otherwise.

    Not collective. Else MUMPS permutes by the values of the first matrix, and the last digits of
    all later solutions depend on which frequency a rank happened to factor first.

    Parameters
    ----------
    pc : petsc4py.PETSc.PC
        Of its final type, with its matrix.
    """
    if pc.getType() in ("lu", "cholesky") and pc.getFactorSolverType() == "mumps":
        pc.setFactorSetUpSolverType()
        pc.getFactorMatrix().setMumpsIcntl(6, 0)


def accept_small_pivots(pc):
    """Call no pivot zero that is not, unless options say otherwise. Not collective.

    PETSc's threshold is absolute, 2e-14, and constants of one lattice may differ by more. A pivot
    that is zero but for rounding shows in the residuals. But the threshold is the least that a
    shift to positive definite pivots adds to them, and without one PETSc never ends on a zero S.

    Parameters
    ----------
    pc : petsc4py.PETSc.PC
        Of its final type.
    """
    usual = "positive_definite" if pc.getType() == "icc" else "none"
    options = PETSc.Options(pc.getOptionsPrefix())
    if options.getString("pc_factor_shift_type", usual).lower() != "positive_definite":
        pc.setFactorPivot(zeropivot=0.0)
        pc.setFromOptions()
