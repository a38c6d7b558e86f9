"""The memory of relaxations, on sums over bonds whose variances by order are known exactly."""

import itertools
import math

import numpy as np
import pytest
from synthetic import BondSums, fair

from pgran.errors import InputError
from pgran.experiments.relaxation import fluctuations as memory
from pgran.experiments.relaxation.fluctuations import Series

MADE = BondSums(12, {1: 0.5, 2: 0.6, 3: 0.8})
LAGS = np.array([0, 1, 4, 12, 24])
M, ORDER = MADE.bonds, MADE.order
SQUARES = sum(k**2 * w for k, w in MADE.W.items()) / sum(MADE.W.values())  # <k^2>
CORRELATION = MADE.covariance(LAGS) / MADE.covariance(0)
MEASURES = [
    (lambda run: memory.autocorrelation(run, LAGS[1:]), CORRELATION[1:]),
    (memory.mean_order, ORDER),
    (memory.increment_correlation, -math.sqrt(ORDER / (2 * M))),
    (memory.successive_correlation, -SQUARES / (2 * ORDER * M)),
]


@pytest.fixture(scope="module")
def runs():
    """Single trajectories of 150 M steps."""
    rng = np.random.default_rng(1)
    return [Series(MADE.series(rng, 150 * M), M) for _ in range(200)]


@pytest.mark.parametrize(("measure", "truth"), MEASURES)
def test_measures_and_their_errors(runs, measure, truth):
    fair([measure(run) for run in runs], truth)


def test_measures_of_one_series(runs):
    """The correlation with itself has no error; those of increments as NumPy has them."""
    whole = memory.autocorrelation(runs[0], [0])
    assert (whole.value, whole.error) == (pytest.approx(1), pytest.approx(0, abs=1e-12))
    B = runs[0].values[0]
    steps = np.diff(B)
    for measure, one, other in (
        (memory.increment_correlation, B[:-1], steps),
        (memory.successive_correlation, steps[:-1], steps[1:]),
    ):
        naive = np.corrcoef(one, other)[0, 1]
        assert measure(runs[0]).value == pytest.approx(naive, abs=0.02)


def test_several_short_trajectories():
    rng = np.random.default_rng(2)
    series = ([MADE.series(rng, 10 * M) for _ in range(12)] for _ in range(150))
    fair([memory.mean_order(Series(values, M)) for values in series], ORDER)


def test_pairs_are_all_counted():
    """Against sums one pair after the other, of parts; some have none."""
    row, ends = np.random.default_rng(3).standard_normal(40), [0, 13, 26, 40]
    sums = memory._pair_sums(row, np.array(ends[:-1]), [0, 9, 20])
    for part, (start, end) in enumerate(itertools.pairwise(ends)):
        for place, lag in enumerate([0, 9, 20]):
            pairs = [(1, row[t], row[t + lag], row[t] * row[t + lag])
                     for t in range(start, end) if t + lag < 40]  # fmt: skip
            naive = np.sum(pairs or np.zeros((1, 4)), axis=0)
            np.testing.assert_allclose(sums[part, :, place], naive, atol=1e-12)


@pytest.mark.parametrize("weights", [{1: 1.0}, {3: 1.0}, {1: 0.2, 4: 1.0}])
def test_bounds_hold(weights):
    made = BondSums(12, weights)
    C = made.covariance(LAGS) / made.covariance(0)
    low, high = memory.bounds(LAGS, made.bonds, made.order)
    assert np.all((low <= C + 1e-15) & (high + 1e-15 >= C))
    if weights == {1: 1.0}:
        np.testing.assert_allclose(low, high)


RANDOM = np.random.default_rng(6).standard_normal(200)


@pytest.mark.parametrize(
    ("values", "bonds", "message"),
    [
        (np.full(200, 0.1), 4, "^series: .* never changes"),
        (RANDOM, 10, "^series: 200 steps .* 210 are needed"),
        (RANDOM.reshape(4, 50), 9, "^series: 50 steps .* 54 are needed"),
        (RANDOM.reshape(4, 50)[:, 50:], 60, "^series: 0 steps .* 360 are needed"),
    ],
)
def test_series_without_a_memory(values, bonds, message):
    with pytest.raises(InputError, match=message):
        Series(values, bonds)
