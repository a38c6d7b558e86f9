"""The graph of a network's contacts: connected parts, order of elimination, least damping.

Its Laplacian L has a row for each free ball; held balls are walls. Where damping is beta on the
whole relative velocity of a contact and balls do not turn, C is L for each component of the
displacements. One sparse factorization of L tells the order of elimination and bounds L from below.
"""

import dataclasses
from functools import cached_property

import numpy as np

from pgran.errors import InputError
from pgran.medium.base import EPSILON, SMALLEST_NORMAL, Elimination, Medium
from pgran.medium.springs import AT_REST, DRIVEN, FREE, SYMMETRIC

# Multiplications of a factorization: beyond these all ranks share the network; up to so many for
# each unknown PETSc is faster than MUMPS; up to so many for each ball a better order of MUMPS costs
# more than it saves.
LARGE_WORK, PETSC_WORK, QUICK_WORK = 3e9, 2500, 5e4
ITERATIONS = 30  # of inverse iteration at most
CLOSE = 0.9  # of the smallest eigenvalue: a bound that is as close as that is not improved
# PETSc has this order from SuiteSparse, which not every PETSc is built with.
MINIMUM_DEGREE = "amd"


class Graph:
    """The graph of a network's free balls, by one factorization of its Laplacian L.

    The sparse `laplacian` (free, free) is that of constants 1 in mass-weighted unknowns. `order` is
    that of minimum degree, which fills factors little. The factorization of a matrix over all
    unknowns takes `work` multiplications; its factor has so many `entries`, the matrix so many
    `nonzeros`. No eigenvalue of L is below `smallest`, which is mostly close, 0 if none is certain.
    """

    def __init__(self, network):
        number = np.full(len(network.held), -1)
        number[network.free] = np.arange(len(network.free))
        ends, each = number[network.bond], network.components
        met = np.bincount(ends[ends >= 0], minlength=len(network.free))  # contacts of each ball
        self.laplacian = _laplacian(ends, met, network.weights[::each])
        self.order = elimination_order(self.laplacian)
        in_order = self.laplacian[self.order][:, self.order]
        in_order.sort_indices()
        factors = _factored(in_order)
        lengths = np.diff(factors.L.indptr).astype(float)
        # A column of L's factor with n entries: n^2 multiplications, blocks of c x c in the matrix.
        self.work, self.entries = float(lengths @ lengths) * each**3, lengths.sum() * each**2
        self.nonzeros = float(self.laplacian.nnz) * each**2
        # the diagonal is a product, an entry beside it a sum over contacts of the same two balls
        self.smallest = _lowest(in_order, factors, (int(met.max()) + 8) * EPSILON)


def _laplacian(ends, met, weights):
    """Return L, sparse by columns, of contacts' balls (n, 2), -1 if held, with `met` contacts."""
    from scipy.sparse import csc_matrix

    i, j = ends[np.all(ends >= 0, axis=1)].T
    beside, own = -weights[i] * weights[j], np.arange(len(met))
    values = np.concatenate([met * weights**2, beside, beside])
    places = np.concatenate([own, i, j]), np.concatenate([own, j, i])
    return csc_matrix((values, places), (len(met),) * 2)


def _factored(laplacian):
    """Return the factors of L in order, the diagonal raised where parts of the network float."""
    from scipy.sparse import identity
    from scipy.sparse.linalg import splu

    try:
        return splu(laplacian, "NATURAL", **SYMMETRIC)
    except RuntimeError:  # singular
        lift = laplacian.diagonal().max() * identity(laplacian.shape[0], format="csc")
        return splu(laplacian + lift, "NATURAL", **SYMMETRIC)


def _lowest(laplacian, factors, rounding):
    """Return a lower bound of L's eigenvalues; rounding moves (L x)_i by that part of its terms.

    For x > 0 none is below the smallest of (L x)_i / x_i: by Gershgorin's circles of X^-1 L X, as L
    has no positive entries beside its diagonal. Inverse iteration finds an x.
    """
    best, x = 0.0, np.ones(laplacian.shape[0])
    for _ in range(ITERATIONS):
        x = factors.solve(x)
        x /= np.abs(x).max() or 1.0
        if not np.all(x > SMALLEST_NORMAL / EPSILON):  # NaN too
            break
        product = laplacian @ x
        sizes = 2 * laplacian.diagonal() * x - product  # of the terms: one alone is positive
        best = max(best, float(np.min((product - rounding * sizes) / x)))
        if best > CLOSE * (x @ product) / (x @ x):
            break
    return best


def elimination_order(pattern):
    """Return which unknown of a symmetric matrix is eliminated first, second, and so on.

    By approximate minimum degree, postordered: each child of the elimination tree comes before its
    parent, and a subtree is a range, so that SuperLU finds its supernodes without numbering anew.
    Of the sparse `pattern` its nonzeros count, not their values; the diagonal belongs to them.
    """
    from pgran.run.petsc import PETSc

    counts = pattern.indptr.astype(PETSc.IntType), pattern.indices.astype(PETSc.IntType)
    values = np.ones(len(pattern.indices), dtype=PETSc.ScalarType)
    matrix = PETSc.Mat().createAIJ(pattern.shape, csr=(*counts, values), comm=PETSc.COMM_SELF)
    try:
        rows, columns = matrix.getOrdering(MINIMUM_DEGREE)
    except PETSc.Error:
        return _by_superlu(pattern)
    finally:
        matrix.destroy()
    order = rows.getIndices().astype(np.intp)
    rows.destroy()
    columns.destroy()
    return order


def _by_superlu(pattern):
    """Return SuperLU's order of minimum degree, from a factorization that drops nearly all."""
    from scipy.sparse import csc_matrix
    from scipy.sparse.linalg import spilu

    # -1 beside a large diagonal: no pivot can be zero.
    values = np.full(len(pattern.indices), -1.0)
    graph = csc_matrix((values, pattern.indices, pattern.indptr), pattern.shape)
    graph.setdiag(float(np.diff(pattern.indptr).max(initial=0)) + 1.0)
    dropping = {"drop_tol": 1.0, "fill_factor": 1.0, "permc_spec": "MMD_AT_PLUS_A"}
    return np.argsort(spilu(graph, **dropping, **SYMMETRIC).perm_c)


class Connected:
    """The contacts of a network as a graph; a lattice answers the same by closed forms."""

    @cached_property
    def graph(self):
        """See `Graph`."""
        return Graph(self)

    @property
    def order(self):
        """The unknowns in the order of elimination."""
        width = self.components
        return (self.graph.order[:, None] * width + np.arange(width)).ravel()

    @property
    def is_large(self):
        """Whether all ranks should share it."""
        return self.graph.work > LARGE_WORK

    @cached_property
    def elimination(self):
        """See `Elimination`."""
        work = self.graph.work
        small = work <= PETSC_WORK * max(self.size, 200)
        quick = work <= QUICK_WORK * self.free_balls
        seconds = 1e-3 + 3.3e-7 * self.nonzeros + 1.3e-9 * work
        return Elimination(True, "natural", small, quick, not small, seconds)

    @property
    def nonzeros(self):
        """How many nonzeros K has."""
        return self.graph.nonzeros

    @property
    def least_damping(self):
        """A number that no eigenvalue of the dashpots' C is below where they are isotropic."""
        return 0.999 * self.graph.smallest  # normals have the length 1 but for 1e-6

    def check_driven(self):
        """Raise InputError if nothing is driven, or if balls float."""
        if self.push is None and not np.any(self.held == DRIVEN):
            raise InputError(
                "network: no ball is driven: make it with --drive or --walls, or give -drive_balls "
                "(in Python pgran.with_source(network, balls=[...]))"
            )
        floating = ~anchored(self.bond, self.held)
        floating = np.flatnonzero(floating if self.drag is None else floating & (self.drag == 0))
        if len(floating):
            raise InputError(
                f"network: {len(floating)} of the balls float, ball {floating[0]} first: no path "
                "to a held one; pgran import and pgran.medium.graph.without_floating drop them"
            )


def without_floating(network):
    """Return a network without balls that float, and the numbers of those kept, ascending.

    A free ball floats if no path of contacts leads from it to a held ball: its motion is no answer
    to the drive, and K and C are singular. Where no ball is held, all parts but the largest float.
    The unit of frequency, `kmax`, stays. Raises InputError if nothing free is left.
    """
    kept = np.flatnonzero(anchored(network.bond, network.held))
    return subnetwork(network, kept), kept


def without_rattlers(network: Medium) -> tuple[Medium, np.ndarray]:
    """Return a network without its `rattlers`, and the numbers of the balls kept, ascending.

    The unit of frequency stays. Raises InputError if nothing free is left.

    Examples
    --------
    >>> import pgran
    >>> from pgran.medium.crystals import diluted, triangular
    >>> network = diluted(triangular((5, 4)), 0.3)
    >>> kept, numbers = pgran.without_rattlers(network)
    >>> len(network.held), len(kept.held)
    (40, 33)
    """
    kept = np.flatnonzero(~_rattling(network))
    return subnetwork(network, kept), kept


def with_rattlers_at_rest(network):
    """Return a network whose `rattlers` are held at rest and touch nothing, of the same balls."""
    loose = _rattling(network)
    held = np.where(loose, AT_REST, network.held)
    whole = np.flatnonzero(~np.any(loose[network.bond], axis=1))
    return subnetwork(dataclasses.replace(network, held=held), contacts=whole)


def _rattling(network):
    """Return `rattlers`; raise an InputError if there is nothing else that is free."""
    loose = rattlers(network)
    if np.all(loose | (network.held != FREE)):
        raise InputError(
            f"network: all of its {np.count_nonzero(loose)} free balls are rattlers, held by too "
            "few contacts with others that are not: nothing is left that carries sound"
        )
    return loose


def rattlers(network):
    """Return which free balls too few contacts hold, shape (balls,), those with others not counted.

    In balance a ball that repels its neighbours needs d + 1 contacts in d dimensions, with
    tangential springs d; one of a scalar displacement is held by a single spring.
    """
    least = 1 if network.displacement == "scalar" else network.axes + (network.tangential is None)
    return loose_balls(network.bond, network.held != FREE, least)


def loose_balls(pairs, held, least):
    """Return which free balls have fewer than `least` contacts, rattlers left out: rattlers."""
    kept = np.ones(len(held), dtype=bool)
    while True:
        carrying = pairs[kept[pairs].all(axis=1)]
        rattling = kept & ~held & (np.bincount(carrying.ravel(), minlength=len(held)) < least)
        if not rattling.any():
            return ~kept
        kept &= ~rattling


def anchored(bond, held):
    """Return which balls do not float, shape (balls,)."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    balls = len(held)
    graph = coo_matrix((np.ones(len(bond)), tuple(bond.T)), (balls, balls))
    count, label = connected_components(graph, directed=False)
    if not np.any(held):
        return label == np.argmax(np.bincount(label))
    anchors = np.zeros(count, dtype=bool)
    anchors[label[held != FREE]] = True
    return anchors[label]


def subnetwork(network, balls=None, contacts=None):
    """Return the network of some balls, and of those of some contacts that join two of them.

    Both are numbers, ascending, or None for all. Raises InputError if nothing free is left.
    """
    balls = np.arange(len(network.held)) if balls is None else np.asarray(balls)
    contacts = np.arange(len(network.bond)) if contacts is None else np.asarray(contacts)
    number = np.full(len(network.held), -1)
    number[balls] = np.arange(len(balls))
    bond = number[network.bond[contacts]]
    whole = np.all(bond >= 0, axis=1)
    kept = {name: value[balls] for name, value in network.arrays_of("ball").items()}
    for name, value in network.arrays_of("contact").items():
        kept[name] = value[contacts[whole]]
    return dataclasses.replace(network, **kept | {"bond": bond[whole]})
