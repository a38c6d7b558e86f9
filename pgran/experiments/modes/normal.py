"""Normal modes K f = lambda f, lambda = m omega^2, by SLEPc: an EPS (option prefix `normal_`).

By default it is Krylov-Schur on (K - sigma)^-1. A search goes either for what is nearest to a value
(`near`), or for all modes of a slice of the spectrum, whose number is known (`solve`). A Krylov
space sees one vector of each eigenspace, so copies of degenerate modes may be missing: in a slice
the search is repeated in the orthogonal complement of what was found until they are all there.

The complex build of SLEPc gives complex vectors. One Rayleigh-Ritz step in real arithmetic makes
them real and orthonormal.
"""

from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
import slepc4py
from mpi4py import MPI

from pgran.driven.counting import complex_matrix, flag_hermitian, real_matrix
from pgran.driven.factors import RealFactors
from pgran.driven.operators import Owner
from pgran.errors import log
from pgran.experiments.modes.shapes import with_fixed_sign
from pgran.run.petsc import PETSc, logged, note, plain_errors

slepc4py.init([])  # PETSc has its options already

from slepc4py import SLEPc  # noqa: E402

TOLERANCE = 1e-13  # of an eigenvalue of (K - sigma)^-1
SEARCHES = 40
SEARCH_AGAIN = 1e-13  # of |K|: residuals above it make the search start again from another sigma
REFINE = 2e-14  # of |K|: residuals above it are worth a step of refinement
# Where sigma goes, as parts of the slice: elsewhere if modes are missing, or inaccurate because
# sigma came too close to one. An interval or a contour is widened by the difference instead.
SHIFTS = (0.5, 0.43, 0.57, 0.36, 0.64)
RESTARTS = 8  # of a search near a value: where it takes more, modes are equal, and some are missed
HELD = 4  # searches near a value
ASIDE = 1e-8  # of |K|: how far from an eigenvalue sigma goes where there are no factors else
# The eta of selective reorthogonalization: where a Krylov space is a small part of all, doing it
# only for what has lost a digit saves a quarter of the time; else modes are missed. A search that
# fails is repeated with SLEPc's own eta, .71.
ETA, ETA_BALLS = 0.3, 5000


class Modes(NamedTuple):
    """Real modes: lambda, ascending, orthonormal f, a row each, and |K f - lambda f| / |K|."""

    values: np.ndarray
    vectors: np.ndarray
    residuals: np.ndarray

    def within(self, low, high):
        """Return those with low < lambda < high."""
        inside = (self.values > low) & (self.values < high)
        return Modes(*(part[inside] for part in self))

    def defects(self, count):
        """Return how many of `count` modes are missing or too many, and the largest residual."""
        return abs(count - len(self.values)), self.residuals.max(initial=0.0)


class ModeSolver(Owner):
    """Finds modes of K, which is this rank's alone."""

    owns = ("_eps",)
    radius = np.nan  # within which eigenvalues lie for certain: none is known

    def __init__(self, operators):
        self.lattice, self.K, self.comm = operators.lattice, operators.K, MPI.COMM_SELF
        flag_hermitian(self.K)
        self.norm = self.K.norm(PETSc.NormType.INFINITY) or 1.0
        self.type = PETSc.Options("normal_").getString("eps_type", "krylovschur")
        self.by_default = not PETSc.Options("normal_").getAll()
        self._layout, self._eps = operators.layout, None
        self.near = lru_cache(HELD)(self._near)  # modes are held until their slice is asked for

    @cached_property
    def real(self):
        """K in real arithmetic, sparse by columns."""
        return real_matrix(self.K)

    def _near(self, search):
        """Return the modes nearest to a value, as many as wanted or more; None if some hide.

        `search` is the value and the number. The modes are the same to the bit each time.
        """
        value, wanted = search
        eps = self.make_eps(first=True)
        eps.setTolerances(TOLERANCE, RESTARTS)
        far = 2 * self.norm  # no eigenvalue is so far away
        try:
            modes = self._modes(eps, value - far, value + far, wanted, searches=1)
        finally:
            eps.destroy()
        return modes if len(modes.values) >= wanted else None

    def solve(self, low, high, count, search=None):
        """Return the modes with low < lambda < high, `count` of them, as far as they are found.

        They are lambda, ascending, the vectors f, shape (modes, *lattice.shape), real, orthonormal,
        the largest entry positive, and the residuals |K f - lambda f| / |K|. A `search` of `near`,
        on this rank or on another one, has found them already.
        """
        self._failure = "the EPS did not converge"
        held = self.near(search) if search else None
        best = held and held.within(low, high)
        for fraction in SHIFTS:
            if best and best.defects(count) <= (0, SEARCH_AGAIN):
                break
            first = fraction == SHIFTS[0]
            self._eps = self._eps or self.make_eps(first)
            modes = self._modes(self._eps, low, high, count, fraction)
            if self._deflated or not first or modes.defects(count) > (0, SEARCH_AGAIN):
                self._eps.destroy()  # it never forgets what it was to deflate
                self._eps = None
            # pairs compare by their first numbers first: what is missing is worse than residuals
            if best is None or modes.defects(count) < best.defects(count):
                best = modes
        if len(best.values) != count:
            log.warning(
                "%d of %d modes found for omega^2 m from %.6g to %.6g: %s",
                len(best.values), count, low, high, self._failure,
            )  # fmt: skip
        return best.values, with_fixed_sign(self._layout.fields(best.vectors)), best.residuals

    @logged("modes")
    def _modes(self, eps, low, high, count, fraction=SHIFTS[0], searches=SEARCHES):
        """Return the real modes of a slice that an EPS finds, refined where that pays."""
        rows = self._search(eps, low, high, count, fraction, searches)
        modes, wrong = self._rayleigh_ritz(rows)
        st = eps.getST()
        if modes.within(low, high).defects(count) > (0, REFINE) and st.getType() == "sinvert":
            modes, _ = self._rayleigh_ritz(self._refined(st, modes, wrong))
        return modes.within(low, high)

    @plain_errors()
    def make_eps(self, first):
        """Create an EPS with the defaults of a first search or a later one, then its options."""
        eps = SLEPc.EPS().create(PETSc.COMM_SELF)
        eps.setOptionsPrefix("normal_")
        eps.setOperators(self.K)
        eps.setProblemType(SLEPc.EPS.ProblemType.HEP)
        eps.setType(self.type)
        eps.setTolerances(TOLERANCE, 200)
        if self.type == "lapack":
            eps.getDS().setMethod(2)  # divide and conquer; the default QR is five times as slow
        elif self.type == "ciss":
            eps.setWhichEigenpairs(SLEPc.EPS.Which.ALL)
        else:
            eps.setWhichEigenpairs(SLEPc.EPS.Which.TARGET_MAGNITUDE)
            if first and self.lattice.size >= ETA_BALLS:
                eps.getBV().setOrthogonalization(eta=ETA)
            invert(eps.getST(), self.lattice, PETSc.Options("normal_").getBool("eps_all", False))
        eps.setFromOptions()
        return eps

    def _search(self, eps, low, high, count, fraction, searches):
        """Return eigenvectors of a slice, a row each, searching on while some are missing."""
        inside, seen = [], []  # copies of those in the slice; all that converged, to be deflated
        self._deflated = False
        once = self.type == "lapack" or eps.getWhichEigenpairs() == SLEPc.EPS.Which.ALL
        try:
            with plain_errors():
                for _ in range(1 if once else searches):
                    before = len(seen)
                    self._aim(eps, low, high, count - len(inside), before, fraction)
                    if seen:
                        eps.setDeflationSpace(seen)
                        self._deflated = True
                    self._start(eps, before)
                    eps.solve()
                    note_search(eps)
                    for number in range(eps.getConverged()):
                        vector = self.K.createVecLeft()
                        value = eps.getEigenpair(number, vector).real
                        seen.append(vector)
                        if low < value < high:
                            inside.append(vector.getArray().copy())
                    if len(inside) >= count or len(seen) == before:
                        break
        except (PETSc.Error, ZeroDivisionError, MemoryError) as error:  # the latter by SuperLU
            self._failure = (str(error).splitlines() or [type(error).__name__])[-1]
        finally:
            for vector in seen:
                vector.destroy()
        return np.array(inside, dtype=complex).reshape(-1, self.lattice.size)

    def _aim(self, eps, low, high, missing, seen, fraction):
        """Tell the EPS where to search, and for how many modes."""
        width = high - low
        margin = abs(fraction - SHIFTS[0]) * width
        if self.type == "ciss":
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
        elif self.type != "lapack":
            eps.setTarget(low + fraction * width)
            room = self.lattice.size - seen
            eps.setDimensions(missing, min(room, missing + missing // 3 + 12))

    def _start(self, eps, seen):
        """Start from a random vector that depends on nothing but how many modes were seen.

        Another search needs another one: what the last one left out is orthogonal to its own.
        """
        vector = self.K.createVecLeft()
        numbers = np.random.Generator(np.random.Philox(seen)).standard_normal(self.lattice.size)
        vector.setArray(numbers)
        eps.setInitialSpace(vector)
        vector.destroy()

    def _rayleigh_ritz(self, rows):
        """Return the real modes in the span of complex vectors, a row each, and K f - lambda f.

        With rows X, orthonormal and spanning whole eigenspaces of a real matrix, the projector on
        their span is real: X^H X = Re(X)^T Re(X) + Im(X)^T Im(X). So the singular values of
        [Re X; Im X] are 1, as often as there are rows, and 0: a real orthonormal basis comes
        without loss of accuracy, and no cluster of equal eigenvalues needs to be told from its
        neighbours.
        """
        parts = [rows.real, rows.imag] if np.any(rows.imag) else [rows.real]
        parts = np.concatenate(parts)
        weights, rotation = np.linalg.eigh(parts @ parts.T)
        ones = weights > 0.1  # fewer than there are rows if these are not what they should be
        basis = (rotation[:, ones] / np.sqrt(weights[ones])).T @ parts
        forces = self._forces(basis)
        energy = basis @ forces.T
        values, rotation = np.linalg.eigh(0.5 * (energy + energy.T))
        vectors = rotation.T @ basis
        wrong = rotation.T @ forces - values[:, None] * vectors
        return Modes(values, vectors, np.linalg.norm(wrong, axis=1) / self.norm), wrong

    def _forces(self, vectors):
        """Return K f of each row f, K as it is stored."""
        columns = np.asfortranarray(vectors.T, dtype=complex)
        f = PETSc.Mat().createDense(columns.shape, array=columns, comm=PETSc.COMM_SELF)
        forces = self.K.matMult(f)
        found = forces.getDenseArray(readonly=True).real.T.copy()
        f.destroy()
        forces.destroy()
        return found

    @plain_errors()
    def _refined(self, st, modes, wrong):
        """Return f - (K - sigma)^-1 (K f - lambda f) of modes f where that is worth it.

        An LDL^T without pivoting is that of a matrix nearby, whose modes the EPS finds. This step
        takes out what they contain of modes farther from sigma than lambda; Rayleigh-Ritz does the
        rest.
        """
        right, x = self.K.createVecs()
        refined = modes.vectors.copy()
        for number in np.flatnonzero(modes.residuals > REFINE):
            right.setArray(wrong[number])
            st.apply(right, x)
            refined[number] -= x.getArray(readonly=True).real
        right.destroy()
        x.destroy()
        return refined


def note_search(solver):
    """Note what a solve of an EPS or a PEP has taken and found."""
    name = f"-{solver.getOptionsPrefix()}* {type(solver).__name__} {solver.getType()}"
    found = {"iteration": solver.getIterationNumber(), "pair": solver.getConverged()}
    note(f"{name}, ST {solver.getST().getType()}", solver.comm, solve=1, **found)


def invert(st, medium, by_inertia=False):
    """Let a solver see the inverse of a shifted matrix, by factors, with inertias if asked."""
    st.setType("sinvert")
    st.getKSP().setType("preonly")
    pc = st.getKSP().getPC()
    asked = PETSc.Options(pc.getOptionsPrefix()).getAll()
    asked = any(key.startswith("pc_factor_") for key in asked)  # which SuperLU's factors know not
    if fills(medium) and not by_inertia and not asked:
        pc.setType("python")
        pc.setPythonContext(SymmetricFactors())
        return
    pc.setType("cholesky")
    if medium.elimination.numbered:  # unknowns are numbered in the order of elimination
        pc.setFactorOrdering("natural")


class SymmetricFactors:
    """A PC for PETSc: SuperLU's factors of a symmetric matrix, real ones where it is real.

    Where factors fill, its dense blocks are much faster than PETSc's own complex LDL^T.
    """

    @logged("factors")
    def setUp(self, pc):
        """Factor the matrix."""
        matrix, _ = pc.getOperators()
        S = complex_matrix(matrix)
        del pc, matrix  # which an error would hold until Python has ended, too late to destroy them
        S.eliminate_zeros()
        self.is_real = not np.any(S.data.imag)
        S = S.real.copy() if self.is_real else S
        try:
            self._factors = RealFactors(S, 0.0)
        except ZeroDivisionError:  # sigma is an eigenvalue
            self._factors = RealFactors(S, ASIDE * (abs(S).max() or 1.0))

    def apply(self, pc, right, x):
        """Set x to the solution."""
        b = right.getArray(readonly=True)
        if self.is_real and np.any(b.imag):
            x.setArray(self._factors.solve(np.stack([b.real, b.imag], axis=1)) @ [1, 1j])
        else:
            x.setArray(self._factors.solve(b.real.copy() if self.is_real else b))


def fills(medium):
    """Return whether the factors of a medium have so many more entries that SuperLU is faster."""
    return medium.elimination.costly or (medium.is_grid and medium.axes > 2)
