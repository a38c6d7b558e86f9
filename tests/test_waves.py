"""Structure factors: dense resolvents, sum rules, crystals' dispersion, fits of oscillators."""

import dataclasses
import math
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from figure_reading import draw, lines, note, page_of
from figure_results import result_of
from mpi4py import MPI
from network_samples import NetworkReference
from samples import run_scene, uniform_lattice
from scipy.integrate import quad

import pgran
from pgran.command.resolve import SCENES, resolve
from pgran.driven.accuracy import Accuracy
from pgran.experiments.modes.figures import speeds
from pgran.experiments.structure import figures
from pgran.experiments.structure.scene import fitted, ioffe_regel, spectrum
from pgran.medium import crystals
from pgran.medium.base import record_of
from pgran.medium.waves import Waves
from pgran.run.options import read_words
from pgran.store.record import Result

sys.path.append(str(Path(__file__).parents[1] / "jobs"))

import waves as job

PERIODIC, WALLS = (True, True), (False, True)  # along x and y
OMEGA = np.linspace(0.02, 4, 80)
TRIANGULAR = crystals.triangular((6, 2), periodic=True, box=[6, 12**0.5], damping=0.2)
FCC = crystals.fcc((3, 2, 2), periodic=True, box=2**0.5 * np.array([3, 2, 2]))


def network(periodic, displacement="vector", damping=0.1):
    """A random network of unequal masses, with pre-stress unless it is scalar."""
    edge, masses = math.sqrt(24), np.random.default_rng(5).uniform(0.5, 2, 24)
    more = {"masses": masses, "damping": damping, "box": edge * np.array(periodic)}
    more |= {"displacement": displacement, "periodic": periodic}
    made = crystals.random_geometric(24, 2, 8.0, **more)
    force = None if displacement == "scalar" else 0.02 * made.stiffness
    return dataclasses.replace(made, force=force)


def dense(medium, g, s):
    """S of complex displacements g of the free balls, by dense resolvents of the forces M g."""
    whole = NetworkReference(medium)
    K, C, M = (matrix.astype(float) for matrix in (whole.K, whole.C, np.diag(whole.M)))
    fields = [np.linalg.solve(K + z * medium.damping * C + z * z * M, M @ g) for z in s]
    return 2 / np.pi * np.real(s * (fields @ (M @ g).conj())) / (g.conj() @ M @ g).real


@pytest.mark.parametrize("displacement", ["scalar", "vector", "rotations"])
@pytest.mark.parametrize("periodic", [PERIODIC, WALLS])
def test_spectra_are_those_of_dense_resolvents(displacement, periodic):
    """Of masses that differ, within bounds; of a plane wave, or of one that stands along x."""
    medium, omega = network(periodic, displacement), np.array([0.3, 1.1, 2.5])
    q = 2 * np.pi / math.sqrt(24) * np.array([1, -2])
    x, directions = medium.position[medium.free], [q, [2, 1]]
    wave = np.exp(1j * x @ q)
    if periodic == WALLS:
        touching = np.unique(medium.bond)
        ends = medium.position[touching[medium.held[touching] > 0], 0]
        q[0], directions = 2 * np.pi / np.ptp(ends), [[0, 1], [1, 0]]
        wave = np.sin(q[0] * (x[:, 0] - ends.min())) * np.exp(1j * q[1] * x[:, 1])
    found = pgran.structure(medium, [q], omega, width=0.05, method="factor")
    for branch, along in enumerate([[1]] if displacement == "scalar" else directions):
        g = np.zeros((len(x), medium.components), complex)
        g[:, : medium.axes] = wave[:, None] * along
        exact = dense(medium, g.ravel(), 0.05 + 1j * omega)
        error = np.abs(found.structure_factor[:, branch, 0] - exact)
        assert np.all(error <= found.error_bound[:, branch, 0] + 1e-12 * exact)
        assert np.all(found.error_bound[:, branch, 0] < 1e-9 * exact)
    of_names = [getattr(found, name) for name in ("scalar", "longitudinal", "transverse")]
    there = [values for values in of_names if values is not None]
    assert np.array_equal(there, found.structure_factor.transpose(1, 2, 0))


def test_the_sum_rules():
    """By Gauss and Legendre in the angle whose tangent is omega.

    int S = 1; int (omega^2 S - 2 D / pi) = f^H (K - C^2) f with D = f^H C f, of masses 1.
    """
    medium = network(WALLS, damping=0.5)
    node, weight = np.polynomial.legendre.leggauss(220)
    omega = np.tan(np.pi / 4 * (node + 1))
    weight = np.pi / 4 * weight * (1 + omega**2)
    found = pgran.structure(medium, 3, omega, width=0)
    S, D = found.structure_factor, found.dashpots
    assert np.tensordot(weight, S, 1) == pytest.approx(1, abs=1e-8)
    second = np.tensordot(weight, omega[:, None, None] ** 2 * S - 2 * D / np.pi, 1)
    whole = NetworkReference(medium)
    K, C = ((X / np.sqrt(np.outer(whole.M, whole.M))).astype(float) for X in (whole.K, whole.C))
    waves = Waves(medium)
    f, place = waves.patterns(waves.first(3, "all"))
    for matrix, expected in ((K - 0.25 * C @ C, second), (0.5 * C, D)):
        sums = np.bincount(place, np.einsum("ij,jk,ik->i", f, matrix, f))
        assert expected.ravel() == pytest.approx(sums, rel=1e-6)


@pytest.mark.parametrize("width", [None, 0.1])
@pytest.mark.parametrize(
    ("medium", "axis", "count"), [(TRIANGULAR, 0, 3), (TRIANGULAR, 1, 2), (FCC, 0, 1)]
)
def test_all_branches_of_a_crystal(medium, axis, count, width):
    """Of ideal waves Gamma is that of dashpots, and that of scattering 0, whatever sigma is."""
    found = pgran.structure(
        medium, count, OMEGA, direction="xyz"[axis], width=width, method="factor"
    )
    assert found.q == pytest.approx(2 * np.pi / medium.box[axis] * np.arange(1, count + 1))
    assert not found.coarse.any()
    n = medium.normal[np.any(medium.bond == 0, axis=1)]  # of the contacts of one ball
    for at, q in enumerate(found.q):
        squares, vectors = np.linalg.eigh((n.T * (1 - np.cos(q * n[:, axis]))) @ n)
        longitudinal = np.argmax(np.abs(vectors[axis]))
        exact = np.sqrt([squares[longitudinal], squares[longitudinal - 1]])
        assert found.frequency[:, at] == pytest.approx(exact, rel=1e-8)
        assert found.velocity[:, at] == pytest.approx(exact / q, rel=1e-8)
        assert found.width[:, at] == pytest.approx(found.dashpots[:, at], rel=1e-9)
        assert found.scattering[:, at] == pytest.approx(0, abs=1e-13)


def test_standing_waves_of_a_uniform_lattice_are_its_modes():
    found = pgran.structure(uniform_lattice((7, 5)), 4, np.linspace(0.02, 1.2, 80))
    angles = np.pi * np.array([(1 / 8, 1 / 6), (2 / 8, 1 / 6), (1 / 8, 2 / 6), (3 / 8, 1 / 6)])
    assert found.wavevector == pytest.approx(angles)
    exact = np.sqrt(0.5 * np.sum(1 - np.cos(angles), axis=1))
    assert found.frequency[0] == pytest.approx(exact, rel=1e-8)
    assert found.width == pytest.approx(found.dashpots, rel=1e-5)


def test_which_waves_there_are():
    """All diagonals of a cube; wave vectors that are given are sorted."""
    cube = Waves(crystals.fcc((2, 2, 2), periodic=True, box=3 * [8**0.5]))
    assert [len(group) for group in cube.first(3, "all")] == [3, 6, 4]
    given = cube.given(cube.unit * np.array([[2, 0, 0], [0, 1, 0]]))
    assert [wave.tolist() for (wave,) in given] == [[0, 1, 0], [2, 0, 0]]


@pytest.mark.parametrize("shape", [(9,), (6, 5)])
def test_wave_numbers_of_a_uniform_lattice_are_those_of_its_standing_waves(shape):
    """All of each mode is one of them, omega^2 = 4 k / m sum sin^2(q / 2)."""
    lattice = uniform_lattice(shape)
    modes = pgran.find_modes(lattice, shapes=True)
    k, branch, share = modes.wave_numbers(lattice)
    q = np.pi * (np.indices(shape).reshape(len(shape), -1).T + 1) / (np.array(shape) + 1)
    exact = np.sqrt(4 * 0.25 * np.sum(np.sin(q / 2) ** 2, axis=1))
    order = np.argsort(exact)
    assert modes.omega == pytest.approx(exact[order])
    assert k == pytest.approx(np.linalg.norm(q, axis=1)[order])
    assert share == pytest.approx(1)
    assert set(branch) == {"scalar"}
    (points, *_) = lines(draw(speeds, modes, record_of(lattice)), marker=".")
    assert points.get_ydata() == pytest.approx(modes.omega / k / lattice.omega_mx)
    for wrong, medium in (pgran.find_modes(lattice), lattice), (modes, uniform_lattice((3, 3))):
        with pytest.raises(pgran.InputError, match="modes of this medium, with shapes"):
            wrong.wave_numbers(medium)
    free = dataclasses.replace(lattice, free=("x-", "x+", "y-", "y+")[: 2 * len(shape)])
    with pytest.raises(pgran.InputError, match="no periods and no walls"):
        modes.wave_numbers(free)


def test_low_modes_of_a_dense_packing_run_at_the_speeds_of_sound():
    packing = pgran.without_rattlers(pgran.pack(200, pressure=0.2, seed=1))[0]
    modes, sound = pgran.find_modes(packing, shapes=True).moving(packing), pgran.sound(packing)
    k, branch, share = modes.wave_numbers(packing)
    for name in ("transverse", "longitudinal"):
        first = np.flatnonzero((branch == name) & (share > 0.4))[:4]
        speed = modes.omega[first] / k[first] / getattr(sound, name).speed
        assert len(first) == 4
        assert speed == pytest.approx(1, abs=0.12)
        assert speed.mean() == pytest.approx(1, abs=0.04)


@pytest.mark.parametrize("sigma", [0.0, 0.1, np.linspace(0.01, 0.3, 80)])
def test_an_oscillator_is_found_again(sigma):
    s = sigma + 1j * OMEGA
    exact = spectrum(s, 0.9, 0.25)
    fit = fitted(s, np.where(OMEGA < 2, exact, np.nan))
    assert fit.value == pytest.approx([0.9, 0.25], rel=1e-9)
    fit = fitted(0.1 + s, spectrum(0.1 + s, 0.9, 0.0))
    assert fit.value == pytest.approx([0.9, 0.0], abs=1e-13)
    fit = fitted(s, exact + 0.02 * np.random.default_rng(2).standard_normal(80))
    assert np.all(np.abs(fit.value - [0.9, 0.25]) < 4 * fit.error)
    for nothing in (spectrum(s, 9.0, 0.25), np.full(80, np.nan), -exact):
        assert np.isnan(fitted(s, nothing).value).all()
    area = quad(lambda x: spectrum(np.mean(sigma) + 1j * x, 0.9, 0.25), 0, np.inf)[0]
    assert area == pytest.approx(1, abs=1e-6)


def test_errors_of_spectra_whose_scatter_is_smoothed():
    """White noise that a Lorentzian of the half width sigma smooths, as a finite sample's modes."""
    x, sigma = np.linspace(-1, 5, 1201), 2 * (OMEGA[1] - OMEGA[0])
    s, rng, fits = sigma + 1j * OMEGA, np.random.default_rng(4), []
    kernel = 1 / ((OMEGA[:, None] - x) ** 2 + sigma**2)
    for _ in range(60):
        noise = kernel @ rng.standard_normal(1201)
        fits.append(fitted(s, spectrum(s, 0.9, 0.25) + 0.03 * noise / noise.std()))
    scatter = np.std([fit.value for fit in fits], axis=0)
    errors = np.mean([fit.error for fit in fits], axis=0)
    assert np.all((scatter > 0.5 * errors) & (scatter < 1.3 * errors))


@pytest.mark.parametrize(
    ("ratio", "limit", "said"),
    [
        ([0.2, np.nan, 0.6, 1.4], 3.5, ""),
        ([0.2, 1.2, 0.6, 1.4], 1.8, "pi Gamma < Omega again at 1 of the larger"),
        ([0.1, 0.2, 0.3, 0.4], np.nan, "not reached: pi Gamma / Omega is at most 0.4"),
        ([1.2, 0.2, 0.3, 0.4], np.nan, "the sample is too small"),
        ([np.nan] * 4, np.nan, "no oscillator fits"),
    ],
)
def test_where_waves_end(ratio, limit, said):
    frequency = np.array([1.0, 2, 3, 4])
    found, why_not = ioffe_regel(frequency, np.array(ratio) * frequency / np.pi)
    assert found == pytest.approx(limit, nan_ok=True)
    assert said in why_not


@pytest.mark.parametrize(
    ("change", "wavevectors", "choices", "said"),
    [
        ({"position": None, "box": None}, 3, {}, "need the positions"),
        ({"box": None}, 3, {}, "no wave fits: "),
        ({}, 3, {"direction": "z"}, "-structure_direction z: no wave fits"),
        ({}, [[1.0, 0.0]], {}, r"\[1. 0.\] does not fit"),
        ({}, [[0.0, 0.0]], {}, "does not fit"),
        ({}, [1.0, 0.0], {}, "rows of 2 components"),
        ({"position": np.ones((24, 3)), "box": None}, 3, {}, "differ in their dimensions"),
        ({"damping": 0}, 3, {"width": 0}, "without dashpots peaks have no width"),
        ({}, 3, {"omegas": [1.0]}, "two frequencies at least"),
        (None, 9, {"direction": "y"}, "is 0 at every ball"),
    ],
)
def test_what_is_refused(change, wavevectors, choices, said):
    medium = (
        dataclasses.replace(TRIANGULAR, **change) if change is not None else uniform_lattice((7, 5))
    )
    with pytest.raises(pgran.InputError, match=said):
        pgran.structure(medium, wavevectors, **{"omegas": OMEGA} | choices)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("", ("relative error of every S at most", "scalar waves of q", "limit of scalar waves")),
        ("-sweep_max .3", ("3 spectra within the sweep",)),
        ("-structure_width 1e-4", ("too far apart for 3 of 3 peaks",)),
        ("-structure_width 0 -lattice_damping .01", ("too far apart",)),
        ("-error_tolerance 1e-17", ("no S is as accurate as asked", "not known, as no")),
    ],
)
def test_what_a_run_says(words, said):
    words = f"-scene structure -lattice_shape 6,5 -structure_count 3 -sweep_points 60 {words}"
    result = Result(run_scene(resolve(read_words(words.split())), MPI.COMM_SELF))
    lines = list(SCENES["structure"].summary(result))
    for text in said:
        assert any(text in line for line in lines), lines


def test_what_is_not_bounded_or_not_stable(caplog, monkeypatch):
    """Rotations without damping take counts, or are marked; a network may fly apart."""
    medium = network(WALLS, "rotations")
    normal, omega = dataclasses.replace(medium, damped="normal"), [0.5, 1.0, 2.0, 9.0]
    assert np.isfinite(pgran.structure(normal, 1, omega, width=0).error_bound).all()
    monkeypatch.setattr(Accuracy, "sharpen", lambda *_: False)  # as where ranks share it
    found = pgran.structure(normal, 1, omega, width=0)
    assert np.isinf(found.error_bound[:3]).all()
    assert found.exactness().endswith("; 3 of 4 frequencies failed or missed the accuracy")
    assert found.failures == 3
    assert not caplog.messages
    pgran.structure(dataclasses.replace(medium, force=medium.stiffness), 1, omega)
    assert "unstable" in caplog.text


def test_panels_show_the_numbers_of_the_record():
    found = pgran.structure(TRIANGULAR, 3, OMEGA, direction="x")
    found.converged_reason[7], found.ioffe_regel[1] = 0, 1.5
    unit = TRIANGULAR.omega_mx
    ax = draw(figures.spectra, found, TRIANGULAR, 1)
    S = ax.collections[0].get_array().reshape(80, 3)
    assert list(np.flatnonzero(np.ma.getmaskarray(S).any(axis=1))) == [7]
    shown, exact = (
        np.delete(np.ma.getdata(x), 7, axis=0) for x in (S, found.structure_factor[:, 1])
    )
    assert shown == pytest.approx(np.maximum(exact / exact.max(), 1e-3))
    assert lines(ax, marker="o")[0].get_ydata() == pytest.approx(found.frequency[1] / unit)
    unfit = dataclasses.replace(found, frequency=found.frequency.copy())
    unfit.frequency[1, 0] = np.nan
    with warnings.catch_warnings(action="error"):
        (fit,) = lines(draw(figures.spectra, unfit, TRIANGULAR, 1), marker="o")
    assert fit.get_ydata() == pytest.approx(found.frequency[1, 1:] / unit)
    curve = lines(draw(figures.speed, found, TRIANGULAR), linestyle="-")[0]
    assert curve.get_ydata() == pytest.approx(found.velocity[0])
    ax = draw(figures.scattering, found, TRIANGULAR)
    assert ax.get_lines()[-1].get_xdata() == [1.5 / unit] * 2
    assert "1 of 80 frequencies failed" in note(page_of(result_of(found, TRIANGULAR), "structure"))


def test_the_table_of_packings_in_small(capsys):
    job.main(60, 1e-2)
    head, _, row = (line.split(" | ") for line in capsys.readouterr().out.splitlines())
    assert len(row) == len(head)
    assert 0 < float(row[4].split()[0]) < 1
