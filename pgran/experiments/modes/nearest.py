"""Modes of a network nearest to a value of lambda: one search, one factorization at each end.

A search comes first, by Lanczos's method in real arithmetic and without restarts, which takes half
the time of an EPS of the complex SLEPc. Its values tell where to count: in the widest gaps that
leave the wanted modes between them.

    lambda  --x-|--x-o-oo-o---o-oo-|---x-->    o wanted, x found beside them, | an end

With K - end = L D L^T + E at either end, |E|_2 <= eps, and m more negative pivots at the upper one,
let m of the modes found, X with R = K X - X W and |X^T X - 1|_F <= delta < 1, all lie farther than

    sqrt(2) |R|_F / sqrt(1 - delta)

inside (low + eps, high - eps). Then K has exactly m eigenvalues there: no more by the counts, and
no fewer, since to each value belongs an eigenvalue of its own within that distance (W. Kahan; see
G. W. Stewart and J. Sun, Matrix Perturbation Theory, section IV.4).
"""

import contextlib
from typing import NamedTuple

import numpy as np

from pgran.driven.counting import real_matrix
from pgran.driven.factors import RealFactors
from pgran.medium.base import EPSILON
from pgran.run.petsc import PETSc

SPARE = 4  # modes that are searched for beyond those that are wanted
TRIES = 3  # searches, each for half as many modes again, until there are gaps
PLACES = (0.5, 0.36, 0.64)  # parts of a gap where it is counted, the next if one is no good
ROOM = 0.8  # part of the way to a gap's nearer side that eps may be
OUTSIDE = 1e-11  # of |K|: how far below or above all eigenvalues nothing needs to be counted
HELD = 4  # searches whose modes are held until their slice is asked for
MOST = 60  # wanted modes of a search
CLOSELY = 1e-11  # of an eigenvalue of (K - sigma)^-1: the residual of a vector that is found
STEPS, CHECKED = 100, 4  # of Lanczos's method beyond 4 for each mode; how often it is checked
REFINE = 2e-13  # of |K|: residuals above it are worth a step of refinement
SPOILT = 1e-10  # part of a matrix by which factors may differ from it


class Cut(NamedTuple):
    """A value of lambda that is clear of all eigenvalues, and how many of them lie below it."""

    shift: float
    below: int


class Search(NamedTuple):
    """What a search depends on, but for K: so many modes nearest to a value of lambda."""

    value: float
    wanted: int


class Modes(NamedTuple):
    """Real modes: values, ascending, vectors f, a row each, and K f - lambda f."""

    values: np.ndarray
    vectors: np.ndarray
    residuals: np.ndarray


def lanczos(inverse, size, wanted):
    """Return vectors of so many modes nearest to sigma, a row each; None if some are not found.

    `inverse` multiplies by (K - sigma)^-1 in real arithmetic. A vector is made orthogonal to all
    before it once, after the recurrence has done most of that. There are no restarts.
    """
    from scipy.linalg import eigh_tridiagonal

    most = min(4 * wanted + STEPS, size)
    space, along, across = np.empty((most, size)), [], []
    space[0] = np.random.Generator(np.random.Philox(0)).standard_normal(size)
    space[0] /= np.linalg.norm(space[0])
    for step in range(most):
        last = inverse(space[step])
        along.append(last @ space[step])
        last -= along[step] * space[step]
        if step:
            last -= across[-1] * space[step - 1]
        last -= (space[: step + 1] @ last) @ space[: step + 1]
        across.append(np.linalg.norm(last))
        if not np.isfinite(across[step]):
            return None
        ends = step + 1 == most or across[step] == 0
        if step >= wanted and (ends or step % CHECKED == 0):
            values, vectors = eigh_tridiagonal(along, across[:-1])
            nearest = np.argsort(-np.abs(values))[:wanted]
            left = across[step] * np.abs(vectors[-1, nearest])
            if np.all(left <= CLOSELY * np.abs(values[nearest])):
                return vectors[:, nearest].T @ space[: step + 1]
        if ends:
            return None
        np.divide(last, across[step], out=space[step + 1])


class Nearest:
    """Finds and counts modes of a network, for a `normal.ModeSolver`."""

    def __init__(self, solver):
        self._solver, self.K, self.norm = solver, real_matrix(solver.K), solver.norm
        self.semidefinite, self.order = solver.lattice.semidefinite, self.K.shape[0]
        self._held = {}

    def modes(self, search):
        """Return at least the modes of a search, the same to the bit each time; None if it fails.

        Of eigenvalues that are equal, and so everywhere, some may be missing.
        """
        if search not in self._held:
            while len(self._held) >= HELD:
                del self._held[next(iter(self._held))]
            self._held[search] = self.searched(*search)
        return self._held[search]

    def searched(self, value, wanted):
        """Return so many modes nearest to a value, refined where that pays; None if it fails."""
        try:
            with contextlib.ExitStack() as held:
                inverse = self._inverse(value, held)
                vectors = inverse and lanczos(inverse, self.order, wanted)
                if vectors is None:
                    return None
                modes = self._ritz(vectors)
                if np.linalg.norm(modes.residuals, axis=1).max() > REFINE * self.norm:
                    # what they contain of modes farther from sigma than lambda goes
                    modes = self._ritz(modes.vectors - inverse(modes.residuals.T).T)
                return modes
        except (PETSc.Error, ZeroDivisionError, np.linalg.LinAlgError):
            return None

    def _inverse(self, value, held):
        """Return what multiplies columns by (K - value)^-1; None where small pivots spoil it.

        Where factors fill, real ones are faster, else PETSc's, which are `held`.
        """
        if self._solver.lattice.elimination.costly:
            inverse = RealFactors(self.K, value).solve
        else:
            inverse = held.enter_context(self._solver.inverse(value))
        right = np.random.Generator(np.random.Philox(1)).standard_normal(self.order)
        x = inverse(right)
        left = np.linalg.norm(self.K @ x - value * x - right)
        return inverse if left <= SPOILT * self.norm * np.linalg.norm(x) else None

    def _ritz(self, vectors):
        """Return the Ritz values and vectors in the span of real vectors, a row each."""
        from scipy.linalg import eigh

        forces = (self.K @ vectors.T).T
        energy, squares = vectors @ forces.T, vectors @ vectors.T
        values, rotation = eigh(0.5 * (energy + energy.T), squares)
        vectors = rotation.T @ vectors
        return Modes(values, vectors, rotation.T @ forces - values[:, None] * vectors)

    def interval(self, omega, mass, count):
        """Return cuts below and above the `count` modes nearest to omega, and their search.

        None where it is not proven that the search finds all modes between them.
        """
        wanted = count + SPARE
        for _ in range(TRIES):
            if count > MOST or 2 * wanted > self.order:
                return None
            search = Search(mass * omega**2, wanted)
            found = self.modes(search)
            if found is None:
                return None
            omegas = np.sign(found.values) * np.sqrt(np.abs(found.values) / mass)
            farthest = np.sort(np.abs(omegas - omega))[count - 1]
            sides = [mass * side * abs(side) for side in (omega - farthest, omega + farthest)]
            reach = np.abs(found.values - search.value).max()
            first, last = search.value - reach, search.value + reach
            least = 0.0 if self.semidefinite else -self.norm
            if first <= least:  # the search has reached below all eigenvalues
                low = Cut(least - OUTSIDE * self.norm, 0)
            else:
                low = self._cut(found.values, first, sides[0], 1)
            if last >= self.norm:
                high = Cut((1 + OUTSIDE) * self.norm, self.order)
            else:
                high = low and self._cut(found.values, sides[1], last, -1)
            if low and high:
                return (low, high, search) if self._complete(found, low, high) else None
            wanted += wanted // 2
        return None

    def _cut(self, values, start, stop, side):
        """Return a cut in the widest gap between start and stop, moved inward by its error.

        `side` is 1 at an interval's lower end, -1 at its upper one. None where no count is certain.
        """
        within = values[(values > start) & (values < stop)]
        edges = np.concatenate([[start], within, [stop]])
        widest = np.argmax(np.diff(edges))
        start, width = edges[widest], edges[widest + 1] - edges[widest]
        for place in PLACES if width > 0 else ():
            shift = start + place * width
            try:
                factors = RealFactors(self.K, shift)
            except ZeroDivisionError:
                continue
            room = ROOM * min(place, 1 - place) * width
            error = factors.error(room)
            if error <= room:
                return Cut(shift + side * error, factors.negative)
        return None

    def _complete(self, modes, low, high):
        """Return whether the modes between two cuts are proven to be all eigenvalues there."""
        inside = (modes.values > low.shift) & (modes.values < high.shift)
        values, vectors = modes.values[inside], modes.vectors[inside]
        if len(values) != high.below - low.below or not len(values):
            return not len(values) and high.below == low.below
        # What rounding adds: each entry of a product of n factors is off by less than n EPSILON / 2
        # of the magnitudes that it is summed from.
        squares = vectors @ vectors.T
        delta = np.linalg.norm(squares - np.eye(len(values)))
        delta += 1.01 * self.order * EPSILON * np.trace(squares)
        met = int(np.diff(self.K.indptr).max())
        size = self.norm + np.abs(values).max()
        rounding = (met + 3) * EPSILON * size * np.sqrt(self.order * np.trace(squares))
        radius = np.sqrt(2.0) * (np.linalg.norm(modes.residuals[inside]) + rounding)
        if not delta < 1:
            return False
        radius /= np.sqrt(1 - delta)
        return low.shift < values.min() - radius and values.max() + radius < high.shift
