"""Linear systems with the matrix S: their states, the KSP that solves them, when it factors anew.

Whether a fresh factorization pays is decided by iteration counts and prices, never by clocks, so
that a run repeats exactly.
"""

import math
from functools import cached_property

from mpi4py import MPI

from pgran.driven.operators import Owner
from pgran.errors import is_bad_input
from pgran.run.agreement import met_by_all
from pgran.run.petsc import PETSc, logged, note

FACTORIZATIONS, INCOMPLETE = ("lu", "cholesky"), ("ilu", "icc")
# What a factorization costs in Krylov iterations, for each entry of the factor and ball; measured.
FACTOR_PRICE = {"petsc": 0.4, "mumps": 0.075}
LEAST_NORM = 1e-300  # a residual of which is none
NO_NUMBER = int(PETSc.KSP.ConvergedReason.DIVERGED_NANORINF)
NO_PRECONDITIONER = int(PETSc.KSP.ConvergedReason.DIVERGED_PCSETUP_FAILED)
# MUMPS: two of its ICNTL and the option of another, a kind of scaling and the quickest ordering.
ANALYSIS_BY_VALUES, SCALING, ORDERING = 6, 8, "mat_mumps_icntl_7"
BY_DIAGONAL, AMF = 1, 2


class System(Owner):
    """A right-hand side of S, with its solution, true residual, and the two solutions before."""

    owns = ("solution", "residual", "last", "before_last")

    def __init__(self, rhs, name="amplitudes"):
        self.rhs, self.name = rhs, name
        self.solution, self.residual, self.last, self.before_last = (
            rhs.duplicate() for _ in range(4)
        )
        self.norm = math.inf

    def advance(self):
        """Keep the solution as the last one; a start then fills `solution`."""
        self.solution, self.last, self.before_last = self.before_last, self.solution, self.last

    def start_from_zero(self):
        """Guess nothing. Collective."""
        self.solution.set(0.0)
        self.rhs.copy(self.residual)
        self.norm = self.residual.norm()

    def start(self, matrix):
        """Start from what the solution holds, unless nothing is better. Collective."""
        self.update_residual(matrix)
        if not self.norm <= self.rhs.norm():  # NaN too
            self.start_from_zero()

    def start_from_line(self, step, matrix):
        """Guess by the line through the last two solutions, `step` of it farther. Collective."""
        self.before_last.copy(self.solution)
        self.solution.scale(-step)
        self.solution.axpy(1.0 + step, self.last)
        self.update_residual(matrix)

    def update_residual(self, matrix):
        """Compute the true residual and its norm. Collective."""
        matrix.mult(self.solution, self.residual)
        self.residual.aypx(-1.0, self.rhs)
        self.norm = self.residual.norm()


class Krylov(Owner):
    """The KSP of S; its `iterations` since `begin`, its last `reason`, or 0. Collective."""

    owns = ("ksp", "_block", "_image")

    def __init__(self, operators, correction):
        self.operators, self._correction = operators, correction
        self.ksp, self._block, self._image = make_ksp(operators, operators.S), None, None
        self._rtol, _, _, self._longest = self.ksp.getTolerances()
        self._exact = self.pc.getType() in FACTORIZATIONS
        self._asked = [k[11:] for k in PETSc.Options().getAll() if k.startswith("steady_ksp_")]
        self._prints = any(key.startswith(("view", "monitor", "converged")) for key in self._asked)
        self.begin()

    @property
    def pc(self):
        """The preconditioner."""
        return self.ksp.getPC()

    def begin(self, longest=None):
        """Count from zero; give up a solve after so many iterations, or as its options say."""
        self.iterations, self.reason, self._fresh = 0, 0, False
        self.ksp.setTolerances(max_it=longest or self._longest)

    def factor(self):
        """Set up the preconditioner for this S and later solves; say if it works. Collective."""
        self.pc.setReusePreconditioner(False)
        works = set_up(self.ksp, self.operators.S, self.operators)
        self.pc.setReusePreconditioner(works)
        self._fresh, self._s = self._exact, self.operators.s
        made = "factorization" if self._exact else "set-up"
        note(self._name, self.operators.comm, **{made: 1, "iteration": 0})
        return works

    @cached_property
    def _name(self):
        """The KSP, once it is set up, in words."""
        package = f" ({self.pc.getFactorSolverType()})" if self._exact else ""
        return f"-steady_* KSP {self.ksp.getType()}, PC {self.pc.getType()}{package}"

    def start(self, systems):
        """Guess the preconditioned right-hand sides, which may be the solutions. Collective.

        Keys for the KSP act: with any, it solves where applying a factorization once might do.
        """
        if self._asked and self._exact:
            for system in systems:
                self._solve(system.rhs, self._rtol, system.name)
                self._correction.copy(system.solution)
        elif len(systems) > 1 and self.pc.getFactorSolverType() == "mumps":
            self._apply_to_all(systems)
        else:
            for system in systems:
                self.pc.apply(system.rhs, system.solution)
        for system in systems:
            system.start(self.operators.S)

    def _apply_to_all(self, systems):
        """Solve for all right-hand sides at once, which reads the factor once. Collective."""
        if self._block is None:  # as many systems always
            self._block, self._image = (self.operators.block(len(systems)) for _ in range(2))
            if PETSc.Options().hasName("citations"):  # PETSc cites MUMPS for plain solves alone
                self.pc.apply(systems[0].rhs, systems[0].solution)
        for column, system in zip(self._block.getDenseArray().T, systems, strict=True):
            column[:] = system.rhs.getArray(readonly=True)
        self._block.assemble()
        self.pc.getFactorMatrix().matSolve(self._block, self._image)
        for column, system in zip(self._image.getDenseArray().T, systems, strict=True):
            system.solution.setArray(column)

    def improve(self, system, target):
        """Reduce a residual to the target, or as far as the KSP gets. Collective."""
        if system.norm <= target:
            return
        before, correction = system.norm, self._correction
        # Relative, because a KSP may measure preconditioned residuals, which have another unit.
        self._solve(system.residual, max(self._rtol, target / before), f"rest of {system.name}")
        self.reason = self.ksp.getConvergedReason()
        system.solution.axpy(1.0, correction)
        system.update_residual(self.operators.S)
        if not math.isfinite(system.norm):
            self.reason = min(self.reason, NO_NUMBER)
            system.start_from_zero()
        elif system.norm > before:
            system.solution.axpy(-1.0, correction)
            system.update_residual(self.operators.S)

    def roughly_solved(self, rhs):
        """Return S^-1 rhs to two digits, or None; the next solve overwrites it. Collective."""
        self._solve(rhs, 0.01, "what rounding does")
        return self._correction if self.ksp.getConvergedReason() > 0 else None

    @logged("states")
    def invert(self, block, image, names=()):
        """Set a block's columns to S^-1 of another's: by factors, or a KSP each. Collective."""
        if self._exact and not self._asked:
            self.pc.getFactorMatrix().matSolve(block, image)
            return
        rhs, columns = self._correction.duplicate(), block.getDenseArray(readonly=True).T
        names = names or [f"right-hand side {number}" for number in range(len(columns))]
        for column, solution, name in zip(columns, image.getDenseArray().T, names, strict=True):
            rhs.setArray(column)
            self._solve(rhs, self._rtol, name)
            solution[:] = self._correction.getArray(readonly=True)
        image.assemble()
        rhs.destroy()

    def _solve(self, rhs, rtol, name):
        """Solve for a right-hand side; say of which, and with what, above what the KSP prints."""
        if self._prints:
            age = ", fresh: one application solves" if self._fresh else f" of {point_name(self._s)}"
            here = f"rank {MPI.COMM_WORLD.rank}, {point_name(self.operators.s)}, {name}"
            PETSc.Sys.Print(f"{here}: {self._name}{age}", comm=self.ksp.comm)
        self.ksp.setTolerances(rtol=rtol)
        self.ksp.solve(rhs, self._correction)
        if self.ksp.getType() != "preonly":  # whose one iteration is to apply the preconditioner
            self.iterations += self.ksp.getIterationNumber()
            note(self._name, self.operators.comm, iteration=self.ksp.getIterationNumber())


def point_name(s):
    """Return an s = sigma + i omega in words."""
    return f"s = {s:g}" if s.real else f"omega = {s.imag:g}"


def is_factored():
    """Return whether the options ask for a factorization of S."""
    return PETSc.Options("steady_").getString("pc_type", "cholesky") in FACTORIZATIONS


def factor_package(lattice, ranks):
    """Return what factors the matrix of a medium that so many ranks share."""
    return "petsc" if ranks == 1 and lattice.elimination.small else "mumps"


def make_ksp(operators, matrix, prefix="steady_", kind="bcgs"):
    """Return a KSP of a matrix like S: on an LDL^T factorization, or as the prefix's options say.

    Collective. The caller destroys it.
    """
    ksp = PETSc.KSP().create(operators.comm)
    ksp.setOptionsPrefix(prefix)
    ksp.setOperators(matrix)
    ksp.setType(kind)
    ksp.setTolerances(rtol=1e-13, atol=LEAST_NORM, max_it=1000)
    pc = ksp.getPC()
    pc.setType("cholesky")
    if factor_package(operators.lattice, operators.comm.size) != "petsc":
        pc.setFactorSolverType("mumps")
    else:
        pc.setFactorOrdering(operators.lattice.elimination.ordering)
    ksp.setFromOptions()
    if pc.getType() in INCOMPLETE:  # these miss less in a narrow band than by dissection
        pc.setFactorOrdering("rcm")
        pc.setFromOptions()
    accept_small_pivots(pc)
    if pc.getType() in FACTORIZATIONS and pc.getFactorSolverType() == "mumps":
        # Let MUMPS analyse the pattern alone; options win. Else it permutes by the values of the
        # first matrix, and the last digits of all later solutions depend on which frequency a rank
        # happened to factor first. On one rank it scales by the diagonal: its usual scaling, the
        # only one of matrices that ranks share, takes up to a tenth of a factorization, but
        # exchanges no fewer pivots.
        pc.setFactorSetUpSolverType()
        factor = pc.getFactorMatrix()
        factor.setMumpsIcntl(ANALYSIS_BY_VALUES, 0)
        if pc.comm.size == 1:
            factor.setMumpsIcntl(SCALING, BY_DIAGONAL)
    # The preconditioner applied once is the solution already if it is a fresh factorization.
    knoll = PETSc.Options(prefix).getBool("ksp_knoll", ksp.getType() != "preonly")
    ksp.setInitialGuessKnoll(knoll)
    return ksp


@logged("factors")
def set_up(ksp, matrix, operators):
    """Set up a KSP's preconditioner for a matrix; return whether that worked. Collective.

    One that failed is of no more use: PETSc keeps some failures for all later values.
    """
    comm, options = operators.comm, PETSc.Options(ksp.getOptionsPrefix())
    ksp.setOperators(matrix)  # without it a KSP overlooks new values
    # Let MUMPS look for an order no longer than that saves; options win. On one rank PETSc 3.18
    # overwrites what `setMumpsIcntl` says of it, so that MUMPS takes PORD; an option arrives.
    quick = operators.lattice.elimination.quick and not options.hasName(ORDERING)
    if quick:
        options[ORDERING] = AMF
    try:
        ksp.setUp()
    finally:
        if quick:
            options.delValue(ORDERING)
    works = ksp.getConvergedReason() >= 0  # says it of this rank alone
    return works if comm.size == 1 else comm.allreduce(works, MPI.LAND)


def accept_small_pivots(pc):
    """Call no pivot zero that is not, unless options say otherwise.

    PETSc's threshold is absolute, 2e-14, and constants of one lattice may differ by more. A pivot
    that is zero but for rounding shows in the residuals. But the threshold is the least that a
    shift to positive definite pivots adds to them, and without one PETSc never ends on a zero S.
    """
    usual = "positive_definite" if pc.getType() == "icc" else "none"
    options = PETSc.Options(pc.getOptionsPrefix())
    if options.getString("pc_factor_shift_type", usual).lower() != "positive_definite":
        pc.setFactorPivot(zeropivot=0.0)
        pc.setFromOptions()


def ends_run(error, works, comm):
    """Return whether an error of PETSc ends the run, instead of being marked. Collective.

    So does one of a callback, of an option if no factorization `works`, or not met by all ranks.
    """
    of_option = is_bad_input(error) and not works
    return bool(error.__cause__ or of_option) or not met_by_all(comm)


class ReusePolicy:
    """Decides before each frequency whether to factor anew.

    A cycle is a factorization and the frequencies it serves. It ends when the next frequency is
    expected to take more than the cycle's price for each frequency so far. What to expect: what the
    last one took, or, right after factoring, what the first reuse took in an earlier cycle. With a
    limit it ends when the last frequency took more iterations than that.
    """

    def __init__(self, limit=0):
        self.limit, self.price = limit, 0.0
        self.restart()

    def restart(self):
        """Forget the past: the next frequency gets a fresh factorization."""
        self._served, self._spent, self._last, self._first = 0, 0, math.inf, None

    def due(self, guess=0.0):
        """Return whether to factor before the next frequency; `guess`: what a first reuse takes."""
        if self._served == 0:
            return True
        if self.limit:
            return self._last > self.limit
        expected = self._last
        if self._served == 1:
            expected = guess if self._first is None else self._first
        return expected * self._served >= self.price + self._spent

    def patience(self):
        """Return after how many iterations a reused factorization is given up."""
        return None if self.limit or not self.price else max(4, math.ceil(2 * self.price))

    def count(self, fresh, iterations):
        """Note how many iterations a frequency took."""
        if fresh:
            self._served = self._spent = 0
        self._served += 1
        self._spent += iterations
        self._last = iterations
        if self._served == 2:
            self._first = iterations

    def count_failure(self):
        """Note that reusing the factorization did not work."""
        if self._served == 1:
            self._first = math.inf


def expected_iterations(before, s, axes, mass, damping):
    """Return the iterations that a solve at s takes with the factorization made at `before`.

    A resonance of the lattice is about |s| (2 d beta + sigma m) wide in m s^2, 2 d the mean
    eigenvalue of C. Each application of the old factorization reduces the residual by the part of
    that width which m s^2 has moved.
    """
    width = 2 * axes * abs(s) * damping + abs(s) * s.real * mass
    moved = mass * abs(s * s - before * before)
    if moved == 0:
        return 1.0
    if moved >= width:
        return math.inf
    return math.log(1e-6) / (2 * math.log(moved / width))


def factor_price(pc, size):
    """Return what a factorization costs in Krylov iterations, from its size. Collective."""
    if pc.getType() not in FACTORIZATIONS:
        return 0.0
    info = pc.getFactorMatrix().getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)
    return FACTOR_PRICE.get(pc.getFactorSolverType(), 0.2) * info["nz_used"] / size
