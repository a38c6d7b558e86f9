"""How alike curves and codas are: stretches, perturbations, codas of known law, relaxation."""

import dataclasses
import re
from types import SimpleNamespace

import numpy as np
import pytest
from figure_results import result_of
from samples import random_lattice, reference_of
from scipy.interpolate import CubicHermiteSpline as Spline
from synthetic import codas, fair, weaver

import pgran
from pgran.command.compare import table
from pgran.experiments.likeness.compare import MOVES, Pair
from pgran.experiments.relaxation import fluctuations as memory
from pgran.store import file as store
from pgran.store.estimate import jackknife_samples, with_error

LATTICE, X, SWEEP = random_lattice((6, 5), damping=0.01), 0.01, np.linspace(0.05, 1.3, 300)
SPEED = np.sqrt(1 + X)


def with_bonds(lattice, change, speed=1.0):
    made = tuple(change(n, k) for n, k in enumerate(lattice.stiffness))
    return dataclasses.replace(lattice, stiffness=made, damping=lattice.damping * speed)


def swept(lattice, omegas=SWEEP, **choices):
    return result_of(pgran.sweep(lattice, omegas, [(3, 2), (1, 1)], **choices), lattice)


def heard(lattice, speed=1.0):
    sent = {"omega": 0.6 * speed, "width": 8 / speed, "time": 300, "points": 601}
    return result_of(pgran.pulse(lattice, [(3, 2)], **sent), lattice)


STIFFER = with_bonds(LATTICE, lambda n, k: (1 + X) * k, SPEED)


@pytest.fixture(scope="module")
def results():
    return {"response": swept(LATTICE), "pulse": heard(LATTICE)}


@pytest.mark.parametrize(("kind", "shape"), [("response", (8, 2, 2)), ("pulse", (6, 1, 1))])
def test_stiffer_springs_are_a_stretch_and_the_same_ones_none(results, kind, shape):
    """k (1 + x), beta sqrt(1 + x), and the wall's motion as much faster: all is sqrt(1 + x)."""
    found = pgran.compare(results[kind], results[kind])
    np.testing.assert_allclose(found.correlation, np.ones(shape), rtol=1e-15)
    window, record = [found.low[0], found.high[0]], getattr(results[kind], kind)
    alone = pgran.compare(record, record, windows=window)
    np.testing.assert_array_equal(alone.correlation, found.correlation[:1])
    assert np.isnan(alone.omega_mx)
    either = pgran.compare(record, results[kind], windows=window)
    assert either.omega_mx == found.omega_mx == LATTICE.omega_mx
    for name in ("stretch", "correlation_error", "stretch_error"):
        np.testing.assert_allclose(getattr(found, name), 0, atol=1e-14)
    other = swept(STIFFER) if kind == "response" else heard(STIFFER, SPEED)
    found = pgran.compare(results[kind], other)
    np.testing.assert_allclose(found.stretch, SPEED - 1, rtol=1e-4)
    np.testing.assert_allclose(found.stretched, 1, rtol=1e-8)
    assert np.all(np.abs(found.stretch - SPEED + 1) < 9 * found.stretch_error)


def test_a_resonance_moves_by_first_order_perturbation():
    """d omega / omega = sum_b dk_b (b^T f)^2 / (2 m omega^2), f the mode's shape."""
    lattice, rng = random_lattice((4, 3), 4, damping=1e-4), np.random.default_rng(3)
    dk = [1e-4 * k * rng.standard_normal(k.shape) for k in lattice.stiffness]
    both = lattice, with_bonds(lattice, lambda n, k: k + dk[n])
    modes = pgran.find_modes(lattice, shapes=True)
    for omega, shape in ((modes.omega[n], np.pad(modes.vector[n], 1)) for n in (0, 6)):
        strain = np.diff(shape, axis=0)[:, 1:-1], np.diff(shape, axis=1)[1:-1]
        work = sum(np.sum(k * s**2) for k, s in zip(dk, strain, strict=True))
        omegas = omega * np.linspace(0.994, 1.006, 241)
        curves = [swept(each, omegas, method="points") for each in both]
        found = pgran.compare(*curves, windows=[0.998 * omega, 1.002 * omega], stretch=0.003)
        for moved in (found.stretch, found.shift / omega):
            np.testing.assert_allclose(moved, work / (2 * omega**2), rtol=2e-3)


@pytest.mark.parametrize("complex_ones", [False, True])
def test_errors_are_the_scatter_of_codas(complex_ones):
    """And what Weaver's formula says of a Gaussian spectrum. (tests/campaigns/estimates.py)"""
    rng, faster = np.random.default_rng(5), MOVES["pulse"]["stretch"]
    made = [codas(rng, 0.9, 0.003, complex_ones) for _ in range(60)]
    stretch = [pair.best(faster, 0.02)[0] for pair in made]
    fair(stretch, 0.003)
    fair([pair.correlation(faster, 0.003) for pair in made], 0.9)
    claimed = np.sqrt(np.mean([each.error**2 for each in stretch]))
    assert claimed == pytest.approx(weaver(0.9), rel=0.15)


def test_relaxation_forgets_within_its_exact_bounds():
    """Covariances of ln|A| less its line, summed over a window, like those of any observable."""
    omega, law, steps = np.linspace(0.2, 1, 41), pgran.BondLaw("uniform"), [0, 1, 5, 17]

    def flat(lattice):
        exact, s = reference_of(lattice), 1j * omega[:, None]
        S = exact.K + s[..., None] * (lattice.damping * exact.C + s[..., None] * np.eye(6))
        f = exact.drive_K + s * lattice.damping * exact.drive_C
        A = np.linalg.solve(S.astype(complex), f[..., None].astype(complex))[:, 0, 0]
        pair = Pair(*2 * [Spline(omega, A, 0 * A)], omega, logarithm=True)
        return pair.raw[0] - pair.line.T @ (pair.line @ pair.raw[0])

    drawn = [random_lattice((3, 2), seed, damping=0.05) for seed in range(120)]
    later = [[pgran.redrawn(x, t, n, law) for t in steps] for n, x in enumerate(drawn)]
    curves = np.array([[flat(lattice) for lattice in row] for row in later])

    def alike(t, some):
        a, b = (curves[some, i] - curves[some, i].mean(axis=0) for i in (0, t))
        return 2 * np.sum(a * b) / np.sum(a**2 + b**2)

    M = drawn[0].constants.size
    found = [jackknife_samples(lambda some, t=t: alike(t, some), 120) for t in (1, 2, 3)]
    low, high = memory.bounds(np.array(steps[1:]), M, M * (1 - found[0].value))
    for each, *ends in zip(found, low, high, strict=True):
        assert ends[0] - 3 * each.error < each.value < ends[1] + 3 * each.error


def changed(result, change):
    return result_of(dataclasses.replace(getattr(result, result.scene), **change), LATTICE)


@pytest.mark.parametrize(
    ("kind", "change", "choices", "said"),
    [
        ("pulse", {}, {"stretch": 0.6}, "-stretch: a number between 0 and .5 is needed, not 0.6"),
        ("pulse", {}, {"windows": [280, 299]}, "-windows: 280 to 299 is not within the times that"),
        ("pulse", {}, {"windows": [200, 202]}, "200 to 202 holds 5 good points of A, and needs 8"),
        ("pulse", {"wall": np.linspace(0, 1, 601)}, {}, "the wall moves until the end; listen"),
        ("pulse", {"detector": np.ones((2, 2), int)}, {}, "A is heard at 1 ball, B at 2 balls"),
        ("pulse", {"envelope": np.zeros((601, 1))}, {}, "B is nowhere larger than its errors"),
        ("pulse", {"envelope": np.eye(601, 1)}, {}, "and -48 to -48 have nothing in common"),
        ("response", {"derivative": None}, {}, "a response of this age has no derivatives"),
        ("modes", {}, {}, "two pulses are needed, not response and modes"),
    ],
)
def test_what_cannot_be_compared(results, kind, change, choices, said):
    other = changed(results[kind], change) if kind in results else SimpleNamespace(scene=kind)
    with pytest.raises(pgran.PgranError, match=said):
        pgran.compare(results.get(kind, results["response"]), other, **choices)


def test_what_is_left_out_is_said(results, caplog):
    """Points without a bound, lines that are no curve, other balls, stretches beyond, strangers."""
    A, response = results["response"], results["response"].response
    error, lines = response.error_bound.copy(), response.line_error.copy()
    error[100:103], lines[90:] = np.nan, 1
    change = {"error_bound": error, "line_error": lines, "models": None}
    B = changed(A, change | {"detector": response.detector[::-1]})
    windows = [0.2, 0.35, 0.4, 0.55]
    np.testing.assert_allclose(pgran.compare(A, B, windows).correlation, 1, atol=1e-3)
    assert np.isinf(pgran.compare(A, swept(STIFFER), windows, stretch=1e-3).stretch_error).any()
    strange = swept(random_lattice((6, 5), 8))
    assert np.isnan(pgran.compare(A, strange, windows).stretch_error).any()
    for said in ("errors hide 3 points of B", "not resolved between", "at the end of what -stre"):
        assert re.search(said, caplog.text)


def test_a_stretch_beyond_what_is_tried_is_not_taken_for_a_small_one():
    """Codas look alike by whole turns; B is read as far as it is known."""
    lattice = random_lattice((6, 5), 1, damping=0.01)
    A = heard(lattice)
    for faster in (1.05, 1.1, 0.95):
        B = heard(with_bonds(lattice, lambda n, k, x=faster: x * x * k, faster), faster)
        assert not np.isfinite(pgran.compare(A, B).stretch_error).any()


def test_the_command(call, place, world, results):
    """Tells in words what the record has, draws it, or stores it, and replaces nothing unasked."""
    pytest.importorskip("matplotlib")
    for name, result in (("a", results["pulse"]), ("b", heard(STIFFER))):
        told = {"scene": "pulse", "bonds_sha256": "", "options": f"-bonds_seed {ord(name)}\n"}
        told |= {"units_time": 1e-6, "units_length": ord(name)}  # these disagree
        place(f"{name}.h5", store.write, told, [result.medium, result.pulse])
    done = call("compare", "a.h5", "b.h5", "-windows", "100,200,200,290", "-stretch", ".03")
    assert done.returncode == 0, done.stderr
    found = pgran.compare("a.h5", "b.h5", [[100, 200], [200, 290]], 0.03)
    assert "A: seed 97; B: seed 98\nball (3, 2), u\ntime  " in done.stdout
    for name, sign, at in (("correlation", "", (0, 0, 0)), ("stretch", "+", (1, 0, 0))):
        number = with_error(getattr(found, name)[at], getattr(found, f"{name}_error")[at])
        assert f" {sign}{number} " in done.stdout
    one = np.ones_like(found.stretch)
    near = dataclasses.replace(found, correlation=one - 2e-6, correlation_error=1.1e-6 * one)
    assert " 0.9999980 +- 0.0000011 " in "".join(table(near))
    itself = call("compare", "a.h5", "b.h5", "-o", "a.h5", "-output_overwrite")
    assert itself.returncode == 2 or world.rank > 0
    assert "-o a.h5: this result is compared" in itself.stderr
    again = [call("compare", "a.h5", "b.h5", "-o", "c.h5").returncode for _ in range(2)]
    assert again == [0, 4] or world.rank > 0
    kept, panels = (
        pgran.load("c.h5").likeness.correlation[:, 0, 0],
        pgran.plot("c.h5")["likeness"].panels,
    )
    assert panels[-1].get_xlabel() == "time (µs)"
    for panel, expected in ((panels[0], kept), (panels[2], -np.log(kept))):
        assert panel.containers[-1].lines[0].get_ydata() == pytest.approx(expected)
