"""Statistics of modes: random matrices, independent levels, uniform lattices, dense references."""

import math

import numpy as np
import pytest
from samples import random_lattice, uniform_lattice
from synthetic import fair

import pgran
from pgran.errors import InputError
from pgran.experiments.modes import levels
from pgran.experiments.modes import scene as modes
from pgran.medium.network import Network


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
    (line,) = modes.spacings([2.5 * omega for omega in spectra], 2.5)
    for name, window in (("below .3", (0, 0.3)), ("from .3 to 1", (0.3, 1)), ("above 1", (1, 9))):
        found = levels.spacing_ratio(spectra, window)
        assert f"{found.value:.3f} +- {found.error:.3f} {name}" in line
    assert "extended modes 0.531, localized ones 0.386" in line
    (line,) = modes.spacings([omega[omega < 1.1] for omega in spectra[:1]], 1.0)
    assert "from .3 to 1 omega_mx" in line
    assert not list(modes.spacings([np.linspace(0.1, 1.2, 20)], 1.0))
    assert not list(modes.spacings([np.repeat(np.linspace(0.1, 1.2, 200), 3)], 1.0))
    assert not list(modes.spacings(spectra, 0.0))


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


@pytest.mark.parametrize(
    ("values", "window", "message"),
    [
        (np.arange(51.0), None, "^values: 49 ratios .* 50 are needed"),
        (np.arange(99.0), (10.0, 40.0), "^values: 29 ratios"),
        (np.arange(99.0)[::-1], None, "^values: .* ascend"),
        (np.append(np.arange(99.0), [98.0, 98.0]), None, "^values: three modes coincide at 98"),
        (np.append(np.arange(99.0), np.nan), None, "^values: .* finite"),
        (np.arange(99.0), (1.0, 1.0), "^window: 1 to 1"),
        ([], None, "^values: 0 ratios"),
    ],
)
def test_spectra_without_ratios(values, window, message):
    with pytest.raises(InputError, match=message):
        levels.spacing_ratio(values, window)


def network(kind, damping):
    """Eight balls of unequal masses on a ring and its diagonals, two of them held."""
    rng, balls = np.random.default_rng(6), 8
    bond = [(i, (i + step) % balls) for step in (1, 3) for i in range(balls)]
    angle = 2 * np.pi * np.arange(balls) / balls
    return Network(
        bond,
        rng.uniform(0.1, 0.3, len(bond)),
        np.where(np.arange(balls) < 2, [1, 2, *[0] * 6], 0),
        rng.uniform(0.5, 2.0, balls),
        damping,
        kind,
        position=np.stack([np.cos(angle), np.sin(angle)], axis=1) * rng.uniform(1, 1.3, (8, 1)),
        tangential=None if kind == "scalar" else rng.uniform(0.05, 0.1, len(bond)),
        radius=rng.uniform(0.3, 0.5, balls),
    )


def dense(lattice):
    """K and beta B^T B, column by column, of a lattice or a network."""
    one = np.eye(lattice.balls).reshape(-1, *lattice.shape)
    K = lattice.restoring_forces(one).reshape(lattice.balls, -1)
    rows = [(t, c) for t, _, c in lattice.stretched(one, np.zeros(lattice.balls))]
    return K, lattice.damping * sum((t * c) @ t.T for t, c in rows)


@pytest.mark.parametrize("kind", ["1D", "2D", "3D", "scalar", "vector", "rotations"])
def test_modal_widths_are_those_of_damped_modes(kind):
    """To first order in beta: Gamma is twice the decay rate of the damped mode, -2 Re s."""
    shapes = {"1D": (30,), "2D": (6, 7), "3D": (3, 4, 3)}
    beta = 1e-5
    if kind in shapes:
        lattice = random_lattice(shapes[kind], 4, damping=beta, mass=1.7)
    else:
        lattice = network(kind, damping=beta)
    K, C = dense(lattice)
    values, vectors = np.linalg.eigh(K)
    modes = 3.0 * vectors.T.reshape(-1, *lattice.shape)  # of any length
    widths = levels.modal_widths(lattice, modes)
    np.testing.assert_allclose(
        widths, np.einsum("pi,pq,qi->i", vectors, C, vectors) / lattice.mass, rtol=1e-9
    )
    n, m = lattice.balls, lattice.mass
    companion = np.block([[np.zeros((n, n)), np.eye(n)], [-K / m, -C / m]])
    s = np.linalg.eigvals(companion)
    s = s[s.imag > 0]
    s = s[np.argsort(s.imag)]
    moving = values > 1e-6
    np.testing.assert_allclose(-2 * s.real[-moving.sum() :], widths[moving], rtol=1e-3)


def test_widths_of_many_modes_are_found_part_by_part(monkeypatch):
    lattice = uniform_lattice((5, 4), stiffness=0.2, damping=0.01)
    K, _ = dense(lattice)
    values, vectors = np.linalg.eigh(K)
    monkeypatch.setattr(levels, "NUMBERS_AT_ONCE", 3 * lattice.bonds)
    widths = levels.modal_widths(lattice, vectors.T.reshape(-1, 5, 4))
    np.testing.assert_allclose(widths, 0.01 * values / 0.2, rtol=1e-9)  # C = K / K0


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


@pytest.mark.parametrize(
    ("window", "message"),
    [((0.0, 0.09), "^window: 9 modes of 1 samples .* 10 of each"), ((1.0, 1.0), "^window: 1 to 1")],
)
def test_windows_without_overlap(window, message):
    omega = np.arange(0.005, 1.0, 0.01)
    with pytest.raises(InputError, match=message):
        levels.modal_overlap(omega, omega, window)
