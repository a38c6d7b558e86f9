"""Figures of ensembles and of the noise of their responses, read off the axes."""

import re
from dataclasses import fields, replace
from functools import cache
from types import SimpleNamespace

import figure_results
import numpy as np
import pytest
from figure_reading import draw, labels, lay_out, legend, note, page_of
from matplotlib.figure import Figure
from synthetic import gaussian_fields

import pgran
from pgran.draw import pages as figures
from pgran.draw import scales
from pgran.errors import FileError
from pgran.experiments.ensemble import figures as ensemble
from pgran.medium.base import record_of

LATTICE = {"shape": (5, 4), "mass": 0.25}
FIRST = pgran.Lattice.random(seed=1993, **LATTICE)
MEDIUM, UNIT = record_of(FIRST), FIRST.omega_mx
DETECTORS = (2, 2, 4, 0)
GIVEN = {
    "response": {"omegas": np.linspace(0.5, 2.1, 401), "detectors": DETECTORS},
    "modes": {},
    "relaxation": {"omega": 1.0, "detectors": (2, 2), "steps": 2100,
                   "law": pgran.BondLaw("uniform")},
    "pulse": {"detectors": DETECTORS, "width": 3.0, "time": 200.0, "points": 300},
    "sensitivity": {"omegas": [1.0], "detectors": (2, 2)},
}  # fmt: skip


@cache
def found_of(of, keep="measures"):
    return pgran.ensemble(of, 12, lattice=LATTICE, keep=keep, **GIVEN[of])


def result_of(found, **others):
    return SimpleNamespace(scene="ensemble", medium=MEDIUM, ensemble=found, **others)


@pytest.mark.parametrize(
    ("of", "keep", "expected"),
    [
        ("response", "measures", ["amplitude", "delay", "velocity"]),
        ("modes", "curves", ["density", "participation", "widths", "above"]),
        ("modes", "measures", ["above"]),
        ("relaxation", "measures", ["exponent", "order"]),
        ("pulse", "measures", ["arrival", "centre", "decay"]),
        ("sensitivity", "measures", ["effective_bonds"]),
    ],
)
def test_what_is_shown_depends_on_what_there_is(of, keep, expected):
    made = figures.make(result_of(found_of(of, keep)))
    assert list(made) == expected
    for figure in made.values():
        lay_out(figure)
        assert note(figure) == ""
        assert "single samples" not in figure.caption  # but of responses, if curves are kept


@pytest.mark.parametrize("panel", [ensemble.amplitude, ensemble.delay])
def test_bands_medians_samples_and_the_coherent_part(panel):
    found, d = found_of("response", "curves"), 1
    ax = draw(panel, found, MEDIUM, d)
    if panel is ensemble.amplitude:
        every = np.abs(found.displacement[:, :, d])
        low, middle, high = np.exp(np.percentile(np.log(every), (10, 50, 90), axis=0))
    else:
        every = found.sample_delay[:, :, d] * UNIT
        low, middle, high = np.percentile(every, (10, 50, 90), axis=0)
    lines = {line.get_label(): line for line in ax.get_lines()}
    dots = [line for line in ax.get_lines() if line.get_marker() == "."]
    for n, alone in enumerate(dots):
        good = ensemble.resolved(found, n, d)
        # NumPy's |A| can differ in its last bit between a whole array and a part of it.
        drawn = next(line for line in ax.get_lines() if line.get_gid() == f"seed {1993 + n}")
        drawn = drawn.get_ydata()
        np.testing.assert_allclose(drawn[good], every[n][good], rtol=1e-14)
        np.testing.assert_allclose(alone.get_ydata(), every[n][~good], rtol=1e-14)
    assert len(dots) == 3
    np.testing.assert_allclose(lines["median"].get_ydata(), middle, rtol=1e-10)
    assert np.array_equal(lines["median"].get_xdata(), found.omega / UNIT)
    (band,) = ax.collections
    x, y = band.get_paths()[0].vertices.T
    for at in (0, 200, 400):
        edge = np.unique(y[np.isclose(x, found.omega[at] / UNIT)])
        np.testing.assert_allclose(edge[[0, -1]], [low[at], high[at]], rtol=1e-10)
    coherent = [line for name, line in lines.items() if name.startswith("coherent")]
    assert len(coherent) == (panel is ensemble.amplitude)
    for line in coherent:
        part = ensemble.coherent(found, d)
        np.testing.assert_array_equal(line.get_ydata(), part)
        assert np.isfinite(part).any()


@pytest.mark.parametrize("points", [30, 300, 3000])
def test_samples_have_lines_where_these_are_their_curve(points):
    """A resonance, of whose width there are half a point, six and sixty."""
    x, middle = np.linspace(0.5, 1.5, points), np.linspace(0.5, 1.5, 2 * points - 1)[1::2]
    A, between = (1 / (1 - omega**2 + 0.02j * omega) for omega in (x, middle))
    found = SimpleNamespace(omega=x, displacement=A[None, :, None])
    wrong = np.abs(between - 0.5 * (A[1:] + A[:-1])) / np.minimum(np.abs(A[1:]), np.abs(A[:-1]))
    good = ensemble.resolved(found, 0, 0)
    assert good.all() == np.all(wrong < ensemble.COARSE_LINE) == (points > 30)


def test_the_floor_of_few_samples_is_no_coherent_part():
    """<A> of N fields without one is sqrt(<I>/N); of those with one it comes out without that."""
    omega, A, _ = gaussian_fields(np.random.default_rng(2), 40, 4001, 0.02, 0.1)
    for strength in (0.0, 2.0):
        fields = (A + strength)[:, :, None]
        found = replace(
            found_of("response", "curves"), good=np.ones(40, np.int8), omega=omega,
            coherent=fields.mean(axis=0), intensity=np.mean(np.abs(fields) ** 2, axis=0),
        )  # fmt: skip
        shown = ensemble.coherent(found, 0)
        if strength:
            assert np.mean(shown**2) == pytest.approx(strength**2, abs=0.05)
        else:
            assert np.mean(np.isfinite(shown)) < 0.02
            flat = found_of("response", "curves")
            flat = replace(flat, coherent=0 * flat.coherent)
            made = page_of(result_of(flat), "amplitude")
            assert not [n for ax in made.axes for n in labels(ax) if n.startswith("coherent")]
            assert "single samples" in made.caption


@pytest.mark.parametrize("span", [80, 125])
def test_delays_are_linear_unless_all_but_a_tenth_span_two_decades(span):
    size = np.geomspace(7 * span ** (-1 / 1.8), 7 * span ** (1 / 1.8), 1001)
    ax = draw(scales.delays, np.append(size, -size))
    assert ax.get_yscale() == ("linear" if span < 100 else "symlog")
    if span > 100:
        assert ax.yaxis.get_transform().linthresh == 7  # their median
        assert labels(ax) == ["linear axis"]


def test_many_detectors_stand_in_columns_on_one_page():
    """Of curves and of histograms, which would be higher than a sheet of paper below each other."""
    sites = [(i, j) for i in range(5) for j in (0, 2)][:9]
    given = GIVEN["response"] | {"detectors": sites, "omegas": np.linspace(0.5, 2.1, 401)}
    found = pgran.ensemble("response", 8, lattice=LATTICE, keep="curves", **given)
    figure = page_of(result_of(found), "amplitude")
    assert "median" in legend(figure)
    velocities = page_of(result_of(found), "velocity")
    for page in (figure, velocities):
        assert len(page.panels) == len(page.axes) <= 9
        assert page.get_figheight() < 250 / 25.4
    (shown,) = [ax.get_legend() for ax in figure.axes if ax.get_legend()]
    box = shown.get_window_extent()
    assert all(not box.overlaps(ax._left_title.get_window_extent()) for ax in figure.axes)


def test_samples_that_are_left_out_are_not_drawn_and_said():
    found = found_of("response", "curves")
    good = found.good.copy()
    good[[0, 5]] = 0
    part = replace(found, good=good, left_out=2)
    made = figures.make(result_of(part))
    assert {note(figure) for figure in made.values()} == {"left out: 2 of 12 samples"}
    drawn = [line.get_gid() for line in made["amplitude"].axes[0].get_lines()]
    assert "seed 1993" not in drawn
    assert "seed 1996" in drawn
    nothing = replace(found, good=0 * good, left_out=12)
    with pytest.raises(FileError, match="nothing to draw in this result: no sample"):
        figures.make(result_of(nothing))


@pytest.mark.parametrize(("of", "name", "d"), [("pulse", "arrival", 1), ("modes", "above", None)])
def test_histograms_count_every_sample_that_has_the_number(of, name, d):
    found = found_of(of)
    values = getattr(found, name).copy()
    values[3] = np.nan
    found = replace(found, **{name: values})
    ax = Figure().subplots()
    counts, edges, _ = ensemble.histogram(ax, found, name, d or 0).get_data()
    known = np.delete(values if d is None else values[:, d], 3)
    assert counts.sum() == len(known) == 11
    assert edges[0] <= known.min() <= known.max() <= edges[-1]
    assert ax.get_lines()[0].get_xdata()[0] == pytest.approx(known.mean())
    where = "" if d is None else f"ball {DETECTORS[2 * d : 2 * d + 2]}: "
    title = ax.get_title("left") or ax.get_title()
    numbers = re.match(rf"{re.escape(where)}mean \$(\S+) \\pm (\S+)\$", title).groups()
    mean, error = map(float, numbers)
    exact = known.std(ddof=1) / np.sqrt(11)
    assert error == pytest.approx(exact, rel=0.06)
    assert abs(mean - known.mean()) < 0.06 * exact
    unit = re.search(r"\(\$.*\$\)", ax.get_xlabel())
    assert not unit or title.endswith(unit[0].strip("()"))
    assert ax.get_ylabel() == "samples (11; 1 withheld)"
    assert "Withheld: samples" in page_of(result_of(found), name).caption


def test_modes_of_a_sample():
    """Densities are per ball, with their errors; participation ratios are medians in bins."""
    found, ax = found_of("modes", "curves"), Figure().subplots()
    counts, edges, _ = ensemble.density(ax, found, MEDIUM).get_data()
    assert np.sum(counts * np.diff(edges)) == pytest.approx(1)
    each = [np.histogram(row / UNIT, edges)[0] / np.diff(edges) for row in found.mode_omega]
    error = np.std(each, axis=0, ddof=1) / np.sqrt(12) / FIRST.size
    top, _, bottom = ax.patches[0].get_data()
    np.testing.assert_allclose(top - bottom, 2 * error, atol=1e-9)
    median = ensemble.participation(Figure().subplots(), found, MEDIUM)
    middle, edges, _ = median.get_data()
    x = found.mode_omega.ravel() / UNIT
    for n in (2, 9):
        inside = (edges[n] <= x) & (x < edges[n + 1])
        assert middle[n] == pytest.approx(np.median(found.participation.ravel()[inside]))


def test_transport_is_points_with_their_errors():
    result = figure_results.ensemble()
    found, unit = result.transport, result.medium.omega_mx
    x, bars = found.omega / unit, {}
    chosen = [float(n.split()[0]) for n in labels(draw(ensemble.profile, found, result.medium))]
    assert len(chosen) == ensemble.SHOWN_CURVES
    at = [np.abs(x - omega).argmin() for omega in chosen]
    bars["profile"] = found.depth, found.ln_amplitude[at], found.ln_amplitude_error[at]
    bars["wave_number"] = x, found.wave_number[None], found.wave_number_error[None]
    bars["band_delay"] = found.depth, found.band_delay * unit, found.band_delay_error * unit
    falls = [(name, by) for name, (_, by) in ensemble.FALLS.items()]
    falls = [(name, by) for name, by in falls if np.isfinite(getattr(found, name)).any()]
    lengths = ([by * getattr(found, n + end) for n, by in falls] for end in ("", "_error"))
    bars["length"] = x, *lengths
    for name, (x, values, errors) in bars.items():
        drawn = draw(getattr(ensemble, name), found, result.medium).containers
        for points, value, error in zip(drawn, values, errors, strict=True):
            line, _, (marks,) = points.lines
            assert line.get_linestyle() == "None"
            assert line.get_xdata() == pytest.approx(x)
            assert line.get_ydata() == pytest.approx(value, nan_ok=True)
            ends = [path.vertices[:, 1] for path in marks.get_paths()]
            low, high = np.transpose([end if len(end) == 2 else [np.nan] * 2 for end in ends])
            assert high - low == pytest.approx(2 * error, nan_ok=True)
        looks = {f"{p.lines[0].get_marker()}{p.lines[0].get_color()}" for p in drawn}
        assert len(looks) == len(values)
        if name == "band_delay":
            hollow = [str(points.lines[0].get_markerfacecolor()) == "none" for points in drawn]
            np.testing.assert_array_equal(hollow, ~found.propagates)
    ax = draw(ensemble.length, found, result.medium)
    known = np.isfinite([getattr(found, name) for name, _ in falls]).any(axis=0)
    assert ax.get_xlim() == pytest.approx([0, found.omega[known].max() / unit])
    assert [found.first_mode / unit] * 2 in [list(line.get_xdata()) for line in ax.get_lines()]


def test_transport_of_older_files_has_no_delays():
    result = figure_results.ensemble()
    new = [f.name for f in fields(result.transport)
           if f.metadata.get("since", 1) > 4 or f.default is None]  # fmt: skip
    older = figure_results.result_of(replace(result.transport, **dict.fromkeys(new)))
    (ax,) = figures.make(older)["transport"].axes  # three depths are no profile
    assert "length" in ax.get_ylabel()


def test_noise_beside_its_laws():
    """Correlations are drawn where half widths are known, which takes 80 samples."""
    windows, few = [(0.6, 1.1), (0.9, 1.5)], found_of("response", "curves")
    alone = {"scene": "ensemble", "medium": MEDIUM}  # without the ensemble
    made = figures.make(SimpleNamespace(statistics=pgran.statistics(few, windows[:1]), **alone))
    assert list(made) == ["intensity"]
    omega, A, _ = gaussian_fields(np.random.default_rng(1), 160, 251, 0.02, 0.004)
    fields = A.reshape(2, 80, -1).transpose(1, 2, 0)
    good = np.ones(80, np.int8)
    many = replace(few, omega=omega, displacement=fields, seed=np.arange(80), good=good)
    found = pgran.statistics(many, windows)
    made = figures.make(SimpleNamespace(statistics=found, **alone))
    assert list(made) == ["intensity", "correlation"]
    for figure in made.values():
        titles = [ax.get_title() + ax.get_title("left") for ax in figure.axes]
        assert len(titles) == 4
        assert rf"{1.5 / UNIT} $\omega_{{mx}}$, ball (4, 0)" in titles[3]
    ax = draw(ensemble.intensity, found, 1, 0)
    law, measured, rest = ax.get_lines()
    bins = np.diff(found.edge)
    assert np.sum(law.get_ydata() * bins) == pytest.approx(1 - np.exp(-8))
    for line, value in ((measured, found.density[1, 0, 0]), (rest, found.density[1, 0, 1])):
        assert np.array_equal(line.get_ydata(), np.where(value > 0, value, np.nan), equal_nan=True)
    ax = draw(ensemble.correlation, found, 1, 0)
    law, measured, *_ = ax.get_lines()
    assert np.interp(1.0, law.get_xdata(), law.get_ydata()) == pytest.approx(0.5, abs=1e-3)
    x = measured.get_xdata()
    shifts = found.shift[1, : len(x)]
    np.testing.assert_allclose(x * found.half_width[1, 0, 0], shifts, rtol=1e-12)
    shown = np.isfinite(measured.get_ydata())
    assert np.array_equal(shown, x <= 6)
    assert np.array_equal(measured.get_ydata()[shown], found.correlation[1, 0, 0, shown])
