"""What factors and circles prove, against closed forms; campaigns/damped.py has other laws."""

import numpy as np
import pytest
import scipy.sparse as sp

from pgran.driven.factors import RealFactors, proven_least
from pgran.experiments.modes import certain
from pgran.experiments.modes.certain import discs, number_below, number_within, radii

CRITICAL = sp.csr_matrix([[1.0]]), sp.csr_matrix([[2.0]]), 1.0  # s = -1 twice, with one x


def chain(size, part=0.02, mass=2.0):
    """K, C = part K and m of balls between walls, and exact s and x: those with Im s > 0."""
    K = sp.diags([-1.0, 2.0, -1.0], [-1, 0, 1], (size, size)).tocsr()
    wave = np.pi * np.arange(1, size + 1) / (size + 1)
    x, squares = np.sin(np.outer(np.arange(1, size + 1), wave)), 4 * np.sin(wave / 2) ** 2 / mass
    gamma = part * squares / 2
    return (K, part * K, mass), -gamma + 1j * np.sqrt(squares - gamma**2), x


def random_factors(seed):
    """A sparse symmetric matrix, real or complex, a shift, often near a pivot, and the factors."""
    rng = np.random.default_rng(seed)
    half, other = (sp.random(12, 12, 0.2, random_state=rng) for _ in range(2))
    half = half + (1j * other if seed % 2 else 0) + sp.diags(rng.standard_normal(12))
    S = (half + half.T).tocsc()
    S.sort_indices()
    shift = 0.0 if seed % 2 else S[0, 0] + rng.choice([1e-12, -1e-9, 1e-6, 1.0])
    return S, shift, RealFactors(S, shift)


def test_errors_of_factors_are_bounded_and_counts_within_them():
    for seed in range(60):
        S, shift, factors = random_factors(seed)
        if factors.pivots is None:
            assert factors.error() == np.inf
            continue
        place = np.argsort(factors._factors.perm_c)
        L = factors._factors.L.toarray().astype(np.clongdouble)
        shifted = S.toarray() - shift * np.eye(12, dtype=np.longdouble)
        exact = shifted[np.ix_(place, place)] - (L * factors.pivots) @ L.T
        error = factors.error()
        assert np.linalg.norm(exact.astype(complex), 2) <= error <= factors.error(np.inf)
        if seed % 2 == 0:
            values, edge = np.linalg.eigvalsh(S.toarray()), error + 1e-14 * abs(S).sum()
            low, high = (np.count_nonzero(values < shift + side * edge) for side in (-1, 1))
            assert low <= factors.negative <= high
    swapped = RealFactors(sp.csc_matrix([[0.0, 1.0], [1.0, 0.0]]), 0.0)  # moved pivots tell nothing
    assert (swapped.negative, swapped.error()) == (None, np.inf)
    np.testing.assert_allclose(swapped.solve(np.array([2.0, 3.0])), [3.0, 2.0])
    with pytest.raises(ZeroDivisionError, match="singular"):
        RealFactors(sp.csc_matrix(np.ones((2, 2))), 0.0)


def test_the_smallest_singular_value_is_bounded():
    for seed in range(1, 60, 2):
        S, *_ = random_factors(seed)
        least = np.linalg.svd(S.toarray(), compute_uv=False)[-1]
        assert 0.97 * least < proven_least(S, 0.99 * least) <= 0.99 * least
        assert proven_least(S, 1.01 * least) == proven_least(S, np.nan) == 0


@pytest.mark.parametrize("double", [False, True])
def test_discs_and_radii_hold_all_modes_of_a_closed_form(double):
    (K, C, m), s, x = chain(7)
    if double:  # two chains, whose modes are mixed: no mode is alone
        K, C = (sp.block_diag([A, A]).tocsr() for A in (K, C))
        s, x = np.tile(s, 2), np.block([[x, 0.5 * x], [0.3j * x, x]])
    s, x = np.concatenate([s, s.conj()]), np.concatenate([x, x.conj()], axis=1)
    rough = s * (1 + 1e-13), x * (1 + 1e-13j * np.arange(len(s)))
    disc, radius = discs(K, C, m, *rough), radii(K, C, m, *rough)
    assert np.all(np.abs(s - rough[0]) < np.minimum(disc, radius))
    assert disc.max() < 2e-11
    assert np.all(radius == np.inf) if double else radius.max() < 1e-12


def test_where_modes_do_not_span_or_are_none_nothing_is_proven():
    for s in ([-1, -1], [-1, -1 + 1e-9], [np.nan, 1], [0, 0]):
        rough = np.array(s) + 0j, np.ones((1, 2)) + 0j
        assert np.all(discs(*CRITICAL, *rough) > 1e-8)
        assert np.all(radii(*CRITICAL, *rough) == np.inf)
    quadratic, s, x = chain(7)
    assert np.all(radii(*quadratic, s + 0.1, x) == np.inf)


@pytest.mark.parametrize(("proven", "chains"), [(False, 1), (False, 2), (True, 1)])
def test_a_mode_just_inside_a_circle_counts_and_one_just_outside_does_not(proven, chains):
    (K, C, m), s, _ = chain(5)  # of two chains all modes are double: phases turn by 2 pi there
    quadratic = *(sp.block_diag([A] * chains).tocsr() for A in (K, C)), m
    radius = 0.4 * abs(s[1] - s[2])
    for far, number in ((0.8, 1), (1.2, 0)) if proven else ((0.99, 1), (1.01, 0)):
        centre = s[1] + far * radius * np.exp(0.3j)
        assert number_within(*quadratic, centre, radius, proven) == number * chains
    assert number_within(*quadratic, s[1] + radius, radius, proven) is None


def test_what_a_circle_leaves_open(monkeypatch):
    quadratic, s, _ = chain(5)
    for name, value in ("AHEAD", 0.5), ("MOST", 50), ("EPSILON", 1e-4):
        with monkeypatch.context() as less:
            less.setattr(certain, name, value)
            assert number_within(*quadratic, s[1], 0.9 * abs(s[1] - s[2]), True) is None
    assert number_within(*quadratic, 0.0, 3.0) == 10
    swapped = sp.csr_matrix([[0.0, 1.0], [1.0, 0.0]])
    assert number_within(swapped, 0 * swapped, 0.0, 1.0, 0.5) is None


def test_overdamped_modes_are_proven_like_others():
    s, x = np.array([-3 - 5**0.5, -3 + 5**0.5]) / 2, np.ones((1, 2))  # real, as LAPACK tells them
    quadratic = CRITICAL[0], 1.5 * CRITICAL[1], 1.0
    assert discs(*quadratic, s, x).max() < 1e-13
    assert radii(*quadratic, s, x).max() < 1e-13
    assert number_within(*quadratic, s[0], 1.0) == number_within(*quadratic, s[1], 1.0, True) == 1


def test_modes_below_are_counted_in_gaps_alone():
    (K, C, m), s, _ = chain(5, 1e-3)
    gap = abs(s[1] + s[2]) / 2
    for R, number in (0.1, 0), (gap, 4), (3.0, 10), (abs(s[1]), None):
        assert number_below(K, C, m, R) == number
    for left in (K, 1e3 * C), (K, -C), (K.astype(complex), C):
        assert number_below(*left, m, gap) is None
