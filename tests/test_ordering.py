"""The order of elimination: a permutation, postordered, of factors that fill little."""

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from pgran.medium import graph
from pgran.medium.springs import SYMMETRIC


def patterns():
    """Sparse patterns with a diagonal: of one unknown, of parts apart, random and dense ones."""
    yield sp.identity(1, format="csr")
    yield sp.identity(7, format="csr")
    yield sp.csr_matrix(np.ones((9, 9)))
    for seed in range(24):
        rng = np.random.default_rng(seed)
        size = int(rng.integers(2, 300))
        i, j = rng.integers(0, size, (2, rng.integers(0, 4 * size)))
        half = sp.coo_matrix((np.ones(len(i)), (i, j)), (size, size)).tocsr()
        yield (half + half.T + sp.identity(size)).tocsr()


def factors(pattern, order, method):
    """SuperLU's factors of a definite matrix of a pattern, numbered anew."""
    matrix = pattern[order][:, order].tocsc()
    matrix.data[:] = -1.0
    matrix.setdiag(1.0 + matrix.shape[0])
    matrix.sort_indices()
    return splu(matrix, method, **SYMMETRIC)


@pytest.mark.parametrize("has_amd", [True, False])
def test_postordered_and_as_sparse_as_minimum_degree(has_amd, monkeypatch):
    """Where PETSc knows the order and where it does not."""
    if not has_amd:
        monkeypatch.setattr(graph, "MINIMUM_DEGREE", "none_such")
    filled, expected = 0, 0
    for pattern in patterns():
        order = graph.elimination_order(pattern)
        numbers = np.arange(pattern.shape[0])
        assert sorted(order) == numbers.tolist()
        own = factors(pattern, order, "NATURAL")
        np.testing.assert_array_equal(own.perm_c, numbers)
        filled += own.L.nnz
        expected += factors(pattern, numbers, "MMD_AT_PLUS_A").L.nnz
    assert filled <= 1.1 * expected
