"""Normal modes K f = lambda f, lambda = m omega^2, of one slice of the spectrum, with SLEPc.

The slice comes with the number of its modes (`slices`), and the solver searches until it has them
all: an EPS (option prefix `normal_`), by default Krylov-Schur on (K - sigma)^-1, sigma in the
middle of the slice; of networks, unless options are set, `nearest` first, in real arithmetic. A
Krylov space sees one vector of each eigenspace, so copies of degenerate modes may be missing: the
search is repeated in the orthogonal complement of what was found.

The complex build of SLEPc gives complex vectors. One Rayleigh-Ritz step in real arithmetic makes
them real and orthonormal.
"""

import contextlib
import logging

import numpy as np
import slepc4py
from mpi4py import MPI

from pgran.driven.counting import flag_hermitian
from pgran.driven.operators import Owner
from pgran.experiments.modes.nearest import Nearest
from pgran.experiments.modes.shapes import rayleigh_ritz, residuals, with_fixed_sign
from pgran.run.petsc import PETSc, plain_errors

slepc4py.init([])  # PETSc has its options already

from slepc4py import SLEPc  # noqa: E402

log = logging.getLogger("pgran")

SEARCHES = 40
SEARCH_AGAIN = 1e-13  # of |K|: residuals above it make the search start again from another sigma
HELD_RESIDUAL = 5e-13  # of |K|: the same of modes that an earlier search has found
ROUGHLY = 1e-6  # accuracy of eigenvalues that counts are to confirm
REFINE = 2e-14  # of |K|: residuals above it are worth a step of refinement
# Where sigma goes, as parts of the slice: elsewhere if modes are missing, or inaccurate because
# sigma came too close to one. An interval or a contour is widened by the difference instead.
SHIFTS = (0.5, 0.43, 0.57, 0.36, 0.64)
# The eta of selective reorthogonalization: where a Krylov space is a small part of all, doing it
# only for what has lost a digit saves a quarter of the time; else modes are missed. A search that
# fails is repeated with SLEPc's own eta, .71.
ETA, ETA_BALLS = 0.3, 5000
# Multiplications of a network's factorization for each unknown up to which PETSc's own is faster
# for the many solves of an EPS; beyond that MUMPS, unless SLEPc is to make slices, by inertias.
PETSC_SOLVES = 30_000


class ModeSolver(Owner):
    """Finds the modes of slices of the spectrum of K, which is this rank's alone."""

    owns = ("_eps",)
    radius = np.nan  # within which eigenvalues lie for certain: none is known

    def __init__(self, operators):
        self.lattice, self.K, self.comm = operators.lattice, operators.K, MPI.COMM_SELF
        flag_hermitian(self.K)
        self._layout = operators.layout
        self.norm = self.K.norm(PETSc.NormType.INFINITY) or 1.0
        self._eps, self._nearest = None, None
        if not self.lattice.is_grid and not PETSc.Options("normal_").getAll():
            self._nearest = Nearest(self)

    def interval(self, omega, count):
        """See `Nearest.interval`; None where counts come first: lattices', or by options."""
        return self._nearest and self._nearest.interval(omega, self.lattice.mass, count)

    def solve(self, low, high, count, search=None):
        """Return the modes with low < lambda < high, `count` of them, as far as they are found.

        They are lambda, ascending, the vectors f, shape (modes, *lattice.shape), real, orthonormal,
        the largest entry positive, and the residuals |K f - lambda f| / |K|. A `search` of
        `interval`, on this rank or on another one, has found them already; in other slices of a
        network they are searched for in the same way first.
        """
        best, self._failure = None, "the EPS did not converge"
        held = None
        if search:
            held = self._nearest.modes(search)
        elif self._nearest and 2 * count < self.lattice.size:
            held = self._nearest.searched(0.5 * (low + high), count)
        if held is not None:
            values, vectors, residual = held
            inside = (values > low) & (values < high)
            shapes = with_fixed_sign(self._layout.fields(vectors[inside]))
            best = values[inside], shapes, np.linalg.norm(residual[inside], axis=1) / self.norm
            if _defects(best, count) <= (0, HELD_RESIDUAL):
                return best
        for fraction in SHIFTS:
            first = fraction == SHIFTS[0]
            eps = self._eps = self._eps or self.make_eps(first)
            rough = self._search(eps, low, high, count, fraction)
            modes = self._real_modes(rough, low, high)
            # pairs compare by their first numbers first: what is missing is worse than residuals
            if _defects(modes, count) > (0, REFINE) and eps.getST().getType() == "sinvert":
                modes = self._real_modes(self.refined(eps.getST(), rough), low, high)
            if self._deflated or not first or _defects(modes, count) > (0, SEARCH_AGAIN):
                eps.destroy()  # it never forgets what it was to deflate
                self._eps = None
            if best is None or _defects(modes, count) < _defects(best, count):
                best = modes
            if _defects(best, count) <= (0, SEARCH_AGAIN):
                break
        if len(best[0]) != count:
            log.warning(
                "%d of %d modes found for omega^2 m from %.6g to %.6g: %s",
                len(best[0]), count, low, high, self._failure,
            )  # fmt: skip
        return best

    @contextlib.contextmanager
    def inverse(self, value):
        """Yield what multiplies real columns by (K - value)^-1, as an EPS would."""
        eps = self.make_eps(first=True)
        x, right = self.K.createVecs()
        st = eps.getST()

        def multiply(columns):
            found = np.empty_like(columns.T, order="C")
            for there, column in zip(np.atleast_2d(found), np.atleast_2d(columns.T), strict=True):
                right.setArray(column)
                st.apply(right, x)
                there[:] = x.getArray(readonly=True).real
            return found.T

        try:
            with plain_errors():
                st.setShift(value)
                st.setUp()
                yield multiply
        finally:
            for thing in (eps, x, right):
                thing.destroy()

    @plain_errors()
    def nearest(self, value, count):
        """Return roughly the eigenvalues nearest to a value; none where the EPS has no target.

        Some may be missing, or belong to others' copies.
        """
        eps = self.make_eps(first=True)
        values = []
        if eps.getWhichEigenpairs() == SLEPc.EPS.Which.TARGET_MAGNITUDE:
            eps.setTarget(value)
            eps.setDimensions(min(count, self.lattice.size))
            eps.setTolerances(ROUGHLY, 20)
            self.start(eps, 0)
            with contextlib.suppress(PETSc.Error), plain_errors():
                eps.solve()
                values = [eps.getEigenvalue(number).real for number in range(eps.getConverged())]
        eps.destroy()
        return np.array(values)

    def _real_modes(self, rough, low, high):
        """Return values, shapes and residuals of the slice's real modes that vectors span."""
        values, vectors = rayleigh_ritz(self.lattice, self._layout.fields(rough))
        inside = (values > low) & (values < high)
        values, vectors = values[inside], vectors[inside]
        residual = residuals(self.lattice, values, vectors) / self.norm
        return values, with_fixed_sign(vectors), residual

    @plain_errors()
    def make_eps(self, first):
        """Create an EPS with the defaults of a first search or a later one, then its options."""
        eps = SLEPc.EPS().create(PETSc.COMM_SELF)
        eps.setOptionsPrefix("normal_")
        eps.setOperators(self.K)
        eps.setProblemType(SLEPc.EPS.ProblemType.HEP)
        eps.setType(eps_type())
        eps.setTolerances(1e-13, 200)
        if eps.getType() == "lapack":
            eps.getDS().setMethod(2)  # divide and conquer; the default QR is five times as slow
        elif eps.getType() == "ciss":
            eps.setWhichEigenpairs(SLEPc.EPS.Which.ALL)
        else:
            eps.setWhichEigenpairs(SLEPc.EPS.Which.TARGET_MAGNITUDE)
            if first and self.lattice.size >= ETA_BALLS:
                eps.getBV().setOrthogonalization(eta=ETA)
            invert(eps.getST(), self.lattice)
        eps.setFromOptions()
        return eps

    def _search(self, eps, low, high, count, fraction):
        """Return eigenvectors of the slice, a row each, searching on while some are missing."""
        inside, seen = [], []  # copies of those in the slice; all that converged, to be deflated
        self._deflated = False
        once = eps.getType() == "lapack" or eps.getWhichEigenpairs() == SLEPc.EPS.Which.ALL
        try:
            with plain_errors():
                for _ in range(1 if once else SEARCHES):
                    before = len(seen)
                    self._aim(eps, low, high, count - len(inside), before, fraction)
                    if seen:
                        eps.setDeflationSpace(seen)
                        self._deflated = True
                    self.start(eps, before)
                    eps.solve()
                    for number in range(eps.getConverged()):
                        vector = self.K.createVecLeft()
                        value = eps.getEigenpair(number, vector).real
                        seen.append(vector)
                        if low < value < high:
                            inside.append(vector.getArray().copy())
                    if len(inside) >= count or len(seen) == before:
                        break
        except PETSc.Error as error:
            self._failure = str(error).splitlines()[-1]
        finally:
            for vector in seen:
                vector.destroy()
        return np.array(inside, dtype=complex).reshape(-1, self.lattice.size)

    def _aim(self, eps, low, high, missing, seen, fraction):
        """Tell the EPS where to search, and for how many modes."""
        width = high - low
        margin = abs(fraction - SHIFTS[0]) * width
        if eps.getType() == "ciss":
            # A flat ellipse around the slice, with room for half as many vectors again. More
            # moments would need fewer vectors, but lose digits.
            rg = eps.getRG()
            rg.setType("ellipse")
            rg.setEllipseParameters(0.5 * (low + high), 0.5 * width + margin, 0.1)
            points, moments = 24, 2
            block = -(-3 * missing // (2 * moments)) + 2
            eps.setCISSSizes(points, block, moments, 1, block)
        elif eps.getWhichEigenpairs() == SLEPc.EPS.Which.ALL:
            eps.setInterval(low - margin, high + margin)
        elif eps.getType() != "lapack":
            eps.setTarget(low + fraction * width)
            room = self.lattice.size - seen
            eps.setDimensions(missing, min(room, missing + missing // 3 + 12))

    def start(self, eps, seen):
        """Start from a random vector that depends on nothing but how many modes were seen.

        Another search needs another one: what the last one left out is orthogonal to its own.
        """
        vector = self.K.createVecLeft()
        numbers = np.random.Generator(np.random.Philox(seen)).standard_normal(self.lattice.size)
        vector.setArray(numbers)
        eps.setInitialSpace(vector)
        vector.destroy()

    @plain_errors()
    def refined(self, st, rough):
        """Return x - (K - sigma)^-1 (K x - lambda x) for eigenvectors x, a row each.

        An LDL^T without pivoting is that of a matrix nearby, whose modes the EPS finds. This step
        takes out what they contain of modes farther from sigma than lambda; Rayleigh-Ritz does the
        rest.
        """
        x, residual = self.K.createVecs()
        refined = rough.copy()
        for vector in refined:
            x.setArray(vector)
            self.K.mult(x, residual)
            residual.axpy(-residual.dot(x) / x.dot(x), x)
            st.apply(residual, x)
            vector -= x.getArray()
        x.destroy()
        residual.destroy()
        return refined


def invert(st, medium):
    """Let a solver see the inverse of a shifted matrix, by its factors."""
    st.setType("sinvert")
    st.getKSP().setType("preonly")
    pc = st.getKSP().getPC()
    pc.setType("cholesky")
    if not medium.elimination.numbered:
        return
    pc.setFactorOrdering("natural")  # unknowns are numbered in the order of elimination
    if medium.is_grid:
        return
    own_slices = PETSc.Options("normal_").getBool("eps_all", False)
    if medium.graph.work > PETSC_SOLVES * medium.size and not own_slices:
        pc.setType("lu")  # MUMPS has no LDL^T of Hermitian matrices
        pc.setFactorSolverType("mumps")


def _defects(modes, count):
    """Return how many modes are missing or too many, and the largest residual."""
    values, _, residual = modes
    return abs(count - len(values)), residual.max(initial=0.0)


def eps_type():
    """Return the type of EPS that the options ask for; `lapack` finds all modes at once."""
    return PETSc.Options("normal_").getString("eps_type", "krylovschur")
