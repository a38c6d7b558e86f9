"""The order in which unknowns are eliminated, so that factors fill little."""

import numpy as np

# PETSc has this order from SuiteSparse, which not every PETSc is built with.
MINIMUM_DEGREE = "amd"


def elimination_order(pattern):
    """Return the order of elimination of a symmetric matrix: approximate minimum degree.

    It is postordered: each child of the elimination tree comes before its parent, and a subtree is
    a range, so that SuperLU finds its supernodes without numbering anew.

    Parameters
    ----------
    pattern : scipy.sparse.csr_matrix or csc_matrix, shape (n, n)
        Its nonzeros count, not their values; the diagonal belongs to them.

    Returns
    -------
    ndarray of int, shape (n,)
        Which unknown is eliminated first, second, and so on.
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
    factors = spilu(
        graph, drop_tol=1.0, fill_factor=1.0, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )  # fmt: skip
    return np.argsort(factors.perm_c)
