"""How many eigenvalues of K lie below a shift, and the spectrum cut into slices by such counts.

By Sylvester's law the factorization K - sigma = L D L^T has as many negative entries in D as K has
eigenvalues below sigma. It costs a factorization and makes no vectors.
"""

import contextlib
from itertools import pairwise

import numpy as np
from mpi4py import MPI

from pgran.driven.linear import accept_small_pivots
from pgran.driven.operators import SAME
from pgran.driven.owner import Owner
from pgran.errors import PgranError
from pgran.medium.graph import SYMMETRIC
from pgran.run.agreement import agree
from pgran.run.petsc import PETSc

SLICE = 60  # modes that are computed together; measured for 40 x 40 and 100 x 100
MARGIN = 1e-11  # of |K|: how far the ends of an interval are moved outward
WIDE = 1e-8  # the same at most where an interval's ends are as good as any others nearby
CLOSE = 1e-4  # part of an interval: ends that near need not be told apart
ATTEMPTS = 40  # at an end, at an interval around a frequency, at cutting what is left


class ModeCounter(Owner):
    """Counts the eigenvalues of a lattice's K below a shift; destroy with `destroy` or `with`.

    Not collective: each rank counts on a copy of its own, because PETSc's own factorization, the
    only one that gives the inertia of complex matrices everywhere, is serial. Where it would take
    long, SciPy's SuperLU does it unless options choose.

    Parameters
    ----------
    K : petsc4py.PETSc.Mat
        Flagged symmetric and Hermitian, of this rank alone.
    lattice : pgran.medium.lattice.Lattice or pgran.medium.network.Network
        What K, or C, belongs to: whether it is semidefinite, and in which order it is factored.

    Attributes
    ----------
    norm : float
        |K|_inf, which no eigenvalue exceeds; 1 if K is zero.
    costly : bool
        Whether a count takes longer than a search for some modes: where factors fill.
    """

    owns = ("_pc", "_shifted", "_x", "_rhs", "_residual")

    def __init__(self, K, lattice):
        """Set up the factorization from its options, prefix `normal_count_`."""
        self.K, self.norm = K, K.norm(PETSc.NormType.INFINITY) or 1.0
        self.order, self.comm = K.getSize()[0], MPI.COMM_SELF
        self.semidefinite = lattice.semidefinite
        self._shifted = K.duplicate(copy=True)
        for flag in (PETSc.Mat.Option.SYMMETRIC, PETSc.Mat.Option.HERMITIAN):
            self._shifted.setOption(flag, True)
        self._x, self._rhs = K.createVecs()
        self._residual = self._rhs.duplicate()
        self._rhs.setArray(np.random.Generator(np.random.Philox(1)).standard_normal(self.order))
        self.costly = lattice.elimination.costly
        chosen = PETSc.Options("normal_count_").hasName("pc_type")
        self._factor = self._by_superlu if self.costly and not chosen else self._by_petsc
        self._pc = PETSc.PC().create(K.getComm())
        self._pc.setOptionsPrefix("normal_count_")
        self._pc.setType("cholesky")
        if lattice.elimination.numbered:  # its unknowns are numbered in that order
            self._pc.setFactorOrdering("natural")
        self._pc.setOperators(self._shifted)
        self._pc.setFromOptions()
        accept_small_pivots(self._pc)

    @property
    def clearance(self):
        """How far cuts stay from all eigenvalues: slices are then orthogonal to rounding."""
        return self.norm * min(max(0.1 / self.order, 2e-6), 0.5 / self.order)

    def below(self, shift, clearance):
        """Return how many eigenvalues lie below a shift, or None where that is uncertain.

        Not collective. It is certain if none lies within `clearance`: the counts on both sides
        agree, and each is of a matrix much closer to K - shift than that.
        """
        counts = {self._inertia(shift + side * clearance, 0.1 * clearance) for side in (-1, 1)}
        return counts.pop() if len(counts) == 1 else None

    def _inertia(self, shift, allowed):
        """Count the negative pivots of K - shift; None if the factors miss it by more than allowed.

        Without pivoting, a tiny pivot spoils the factors. E = K - shift - L D L^T is estimated by a
        solve, for which r = b - (K - shift) x = -E x.
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
        from scipy.sparse import csc_matrix
        from scipy.sparse.linalg import splu

        pointer, columns, values = self._shifted.getValuesCSR()  # symmetric: rows are columns
        try:
            factors = splu(
                csc_matrix((values.real.copy(), columns, pointer)), "NATURAL", **SYMMETRIC
            )
        except RuntimeError:  # a pivot is zero
            return 0, 1
        self._x.setArray(factors.solve(self._rhs.getArray(readonly=True).real))
        pivots = factors.U.diagonal()
        moved = not np.array_equal(factors.perm_r, factors.perm_c)  # no longer symmetric
        return np.count_nonzero(pivots < 0), np.count_nonzero(pivots == 0) + moved

    def end(self, shift, side, margin=MARGIN):
        """Return an end of an interval, moved outward by a part of |K|, and the count below it.

        Not collective. So a mode at the end belongs to the interval. Where another mode is too
        close to the moved end for a certain count, it is moved on. Raises PgranError if no reliable
        count is found.
        """
        # 0 stands for the lowest frequency; unstable modes may be on both sides of less
        if side < 0 and shift <= 0 and (self.semidefinite or not -self.norm < shift < 0):
            return -(margin if self.semidefinite else 1 + margin) * self.norm, 0
        if side > 0 and shift >= self.norm:
            return (1 + margin) * self.norm, self.order
        margin *= self.norm
        for _ in range(ATTEMPTS):
            count = self.below(shift + side * margin, 0.5 * margin)
            if count is not None:
                return shift + side * margin, count
            margin *= 1.5
        raise PgranError(
            f"no reliable count of the modes below omega^2 m = {shift:g}: the factorization that "
            "-normal_count_pc_* chooses gives none"
        )

    def interval(self, low, high, comm=MPI.COMM_SELF, margin=MARGIN):
        """Return the ends of [low, high] with their counts, {shift: count}.

        Collective over `comm`, whose ranks share out the work.

        Parameters
        ----------
        low, high : float
            Values of lambda.
        comm : mpi4py.MPI.Comm
        margin : float
            Of `end`.
        """
        ends = shared(comm, [(low, -1), (high, 1)], lambda end: self.end(*end, margin))
        return dict(found for _, found in ends)

    def around(self, omega, mass, wanted, reach=None):
        """Return an interval around `omega` with at least `wanted` modes and few more.

        Not collective. Symmetric in omega: those nearest are among them.

        Parameters
        ----------
        omega, mass : float
            lambda = mass omega^2.
        wanted : int
        reach : float, optional
            How far the interval is tried to extend first.

        Returns
        -------
        dict
            Ends in lambda with their counts, {shift: count}.
        """
        wanted = min(wanted, self.order)
        few = wanted + max(4, wanted // 4)
        short, long, top = 0.0, np.inf, np.sqrt(self.norm / mass)
        reach = reach or top * wanted / self.order
        for _ in range(ATTEMPTS):
            first, last = omega - reach, omega + reach  # below 0: unstable
            lowest, highest = mass * first * abs(first), mass * last**2
            margin = np.clip(CLOSE * (highest - lowest) / self.norm, MARGIN, WIDE)
            ends = self.interval(lowest, highest, margin=margin)
            low, high = ends.values()
            if high - low >= wanted:
                best, long = ends, reach
            else:
                short = reach
            if wanted <= high - low <= few or long - short <= max(MARGIN * top, CLOSE * reach):
                break
            guess = reach * np.clip(0.5 * (wanted + few) / max(high - low, 1), 0.125, 8.0)
            reach = guess if short < guess < long else 0.5 * (short + long)
        return best


def cut(counter, ends, comm):
    """Cut an interval into slices of about SLICE modes.

    Collective over `comm`, whose ranks share out the counts.

    Parameters
    ----------
    counter : ModeCounter
    ends : dict
        Two shifts with the numbers of modes below them.
    comm : mpi4py.MPI.Comm

    Returns
    -------
    list of (low, high, count)
        The largest first; the empty ones are left out. All cuts keep clear of eigenvalues, and a
        cluster of equal ones stays in one slice however many they are.
    """
    below = dict(ends)
    for attempt in range(ATTEMPTS):
        shifts = []
        for low, high in pairwise(sorted(below)):
            count = below[high] - below[low]
            if count > 1.5 * SLICE and high - low > 4 * counter.clearance:
                # more pieces at each attempt, so that a shift that failed is not tried again
                shifts += np.linspace(low, high, count // SLICE + 2 + attempt)[1:-1].tolist()
        if not shifts:
            break
        found = shared(comm, shifts, lambda shift: counter.below(shift, counter.clearance))
        below |= {shift: count for shift, count in found if count is not None}
    return _merged(below)


def shared(comm, items, work):
    """Return pairs (item, work(item)), the items shared out over the ranks.

    Collective. A PgranError that one rank meets is raised on all.

    Parameters
    ----------
    comm : mpi4py.MPI.Comm
    items : list
        The same on every rank.
    work : callable
        Not collective.
    """
    mine, failure = [], None
    try:
        mine += [(item, work(item)) for item in items[comm.rank :: comm.size]]
    except PgranError as error:
        failure = error
    agree(comm, failure)
    pairs = comm.allgather(mine)
    return [pairs[number % comm.size][number // comm.size] for number in range(len(items))]


def _merged(below):
    """Return the slices between cuts, neighbours joined where they are small."""
    first, *middle, last = sorted(below)
    kept = [first]
    for shift, following in pairwise([*middle, last]):
        if below[following] - below[kept[-1]] > SLICE:
            kept.append(shift)
    slices = [(low, high, below[high] - below[low]) for low, high in pairwise([*kept, last])]
    return sorted((piece for piece in slices if piece[2] > 0), key=lambda piece: -piece[2])
