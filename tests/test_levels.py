"""Statistics of modes: random matrices, independent levels, uniform lattices, dense references."""

import math

import numpy as np
import pytest
from network_samples import NetworkReference, random_network
from samples import random_lattice, reference_of
from synthetic import fair

import pgran
from pgran.experiments.modes import levels, shapes
from pgran.store.estimate import with_error


def goe(rng, size):
    """The eigenvalues of a matrix of the Gaussian orthogonal ensemble."""
    matrix = rng.standard_normal((size, size))
    return np.linalg.eigvalsh(matrix + matrix.T)


def poisson(rng, low, high, density):
    """Independent levels."""
    return np.sort(rng.uniform(low, high, rng.poisson(density * (high - low))))


@pytest.mark.parametrize("samples", [1, 10])
def test_spacing_ratios(samples):
    """Of one spectrum and of several, in the middle, where the density is nearly even."""
    rng, size = np.random.default_rng(1), 250 // samples**0.5
    middle = (-0.5 * math.sqrt(2 * size), 0.5 * math.sqrt(2 * size))
    for make, truth, window in (
        (lambda: goe(rng, int(size)), levels.GOE_SPACING_RATIO, middle),
        (lambda: poisson(rng, 0.0, 2.0, 150.0), levels.POISSON_SPACING_RATIO, (0.2, 1.8)),
    ):
        spectra = [[make() for _ in range(samples)] for _ in range(100)]
        found = [levels.spacing_ratio(s if samples > 1 else s[0], window) for s in spectra]
        fair(found, truth)


def test_spacings_in_words():
    """The numbers of each range of frequencies, in any unit; nothing where there are few."""
    rng = np.random.default_rng(3)
    spectra = [poisson(rng, 0.0, 1.4, 400.0) for _ in range(3)]
    (line,) = levels.spacings([2.5 * omega for omega in spectra], 2.5)
    for name, window in (("below .3", (0, 0.3)), ("from .3 to 1", (0.3, 1)), ("above 1", (1, 9))):
        found = levels.spacing_ratio(spectra, window)
        assert f"{with_error(found.value, found.error)} {name}" in line
    assert "extended modes 0.531, localized ones 0.386" in line
    (line,) = levels.spacings([omega[omega < 1.1] for omega in spectra[:1]], 1.0)
    assert "from .3 to 1 omega_mx" in line
    assert not list(levels.spacings([np.linspace(0.1, 1.2, 20)], 1.0))
    assert not list(levels.spacings([np.repeat(np.linspace(0.1, 1.2, 200), 3)], 1.0))
    assert not list(levels.spacings(spectra, 0.0))


def test_modes_above_omega_mx_are_localized():
    """There neighbouring modes of the paper's lattice repel each other less than below."""
    found = pgran.ensemble("modes", 12, lattice={"shape": (16, 16)}, keep="curves")
    low, high = (levels.spacing_ratio(found.mode_omega, w) for w in ((0.3, 0.6), (1.0, 2.0)))
    assert low.value - high.value > 3 * math.hypot(low.error, high.error)
    assert abs(low.value - levels.GOE_SPACING_RATIO) < 3 * low.error


def test_spacing_ratio_is_that_of_any_smooth_scale():
    values = goe(np.random.default_rng(2), 400)[150:250]
    ratio, other = levels.spacing_ratio(values), levels.spacing_ratio(np.sqrt(values + 40))
    assert other.value == pytest.approx(ratio.value, abs=0.02 * ratio.error + 2e-3)
    naive = [
        min(b - a, c - b) / max(b - a, c - b)
        for a, b, c in zip(values, values[1:], values[2:], strict=False)
    ]
    assert ratio.value == pytest.approx(np.mean(naive), rel=1e-12)


LEVELS, MODES = np.arange(99.0), np.arange(0.005, 1.0, 0.01)


@pytest.mark.parametrize(
    ("statistic", "arguments", "message"),
    [
        (levels.spacing_ratio, [LEVELS[:51]], "^values: 49 ratios .* 50 are needed"),
        (levels.spacing_ratio, [LEVELS, (10.0, 40.0)], "^values: 29 ratios"),
        (levels.spacing_ratio, [LEVELS[::-1]], "^values: .* ascend"),
        (levels.spacing_ratio, [[*LEVELS, 98, 98]], "^values: three modes coincide at 98"),
        (levels.spacing_ratio, [[*LEVELS, np.nan]], "^values: .* finite"),
        (levels.spacing_ratio, [LEVELS, (1.0, 1.0)], "^window: 1 to 1"),
        (levels.spacing_ratio, [[]], "^values: 0 ratios"),
        (levels.modal_overlap, [MODES, MODES, (0.0, 0.09)], "^window: .* 9, .* each needs 10"),
        (levels.modal_overlap, [MODES, MODES, (1.0, 1.0)], "^window: 1 to 1"),
    ],
)
def test_levels_that_are_too_few_or_no_spectrum(statistic, arguments, message):
    with pytest.raises(pgran.InputError, match=message):
        statistic(*arguments)


def widths_by(K, C, lattice):
    """Modes of a dense K, a row each, and beta f^T C f / m of each."""
    values, vectors = np.linalg.eigh(K)
    widths = lattice.damping * np.einsum("pi,pq,qi->i", vectors, C, vectors) / lattice.mass
    return values, vectors.T, widths


@pytest.mark.parametrize("shape", [(30,), (6, 7), (3, 4, 3)])
def test_modal_widths_are_those_of_damped_modes(shape, monkeypatch):
    """To first order in beta, twice the decay rate of the damped mode, -2 Re s."""
    lattice = random_lattice(shape, 4, damping=1e-5, mass=1.7)
    K, C = (X.astype(float) for X in (reference_of(lattice).K, reference_of(lattice).C))
    _, modes, expected = widths_by(K, C, lattice)
    modes = 3.0 * modes.reshape(-1, *shape)  # of any length
    widths = shapes.modal_widths(lattice, modes)
    np.testing.assert_allclose(widths, expected, rtol=1e-9)
    rates = np.block([[0 * K, np.eye(len(K))], [-K / 1.7, -1e-5 * C / 1.7]])
    s = np.linalg.eigvals(rates)
    s = sorted(s[s.imag > 0], key=lambda s: s.imag)
    np.testing.assert_allclose(-2 * np.real(s), widths, rtol=1e-3)
    monkeypatch.setattr(shapes, "NUMBERS_AT_ONCE", 3 * lattice.bonds)  # three modes at a time
    np.testing.assert_allclose(shapes.modal_widths(lattice, modes), widths, rtol=1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_modal_widths_of_networks(seed):
    """Where modes stand alone: equal ones may be mixed. Their sum is beta tr C / m, however."""
    network = random_network(seed).network
    reference = NetworkReference(network)
    K, C = (reference.weighted(X).astype(float) for X in (reference.K, reference.C))
    values, _, expected = widths_by(K, C, network)
    modes = np.linalg.eigh(network.restoring_forces(np.eye(network.size)))[1].T
    widths = shapes.modal_widths(network, modes)
    size = network.damping * np.abs(C).sum(axis=1).max() / network.mass
    assert abs(widths.sum() - expected.sum()) <= 1e-9 * size
    apart = np.diff(values, prepend=-np.inf, append=np.inf) > 1e-5 * np.abs(values).max()
    alone = apart[1:] & apart[:-1]
    np.testing.assert_allclose(widths[alone], expected[alone], rtol=0, atol=1e-8 * size)


def test_modal_overlap():
    """Independent levels of one width, or of widths that grow along omega."""
    rng, window = np.random.default_rng(5), (0.2, 0.8)
    for samples in (1, 12):
        found = []
        for _ in range(200):
            omega = [poisson(rng, 0.0, 1.0, 400.0) for _ in range(samples)]
            width = [0.01 * w for w in omega]
            some = (omega, width) if samples > 1 else (omega[0], width[0])
            found.append(levels.modal_overlap(*some, window))
        fair(found, 0.01 * 0.5 * 400)
