"""Panels of the box, responses, modes, projections, relaxations and accuracy, read off the axes."""

from dataclasses import replace

import numpy as np
import pytest
from figure_reading import curves, draw, gaps, labels, lines, marks, note, page_of
from figure_results import (
    SWEEP,
    UNIT,
    compare,
    count_modes,
    find_modes,
    lean,
    listen,
    project,
    relax,
    respond,
    respond_box,
    result_of,
    shout,
)
from matplotlib.markers import TICKUP
from samples import uniform_lattice

from pgran.draw import pages as figures
from pgran.draw.captions import formulas
from pgran.errors import FileError
from pgran.experiments.accuracy import figures as accuracy
from pgran.experiments.continuum import figures as continuum
from pgran.experiments.loud import figures as loud
from pgran.experiments.modes import figures as modes
from pgran.experiments.modes import figures_density as density
from pgran.experiments.modes import figures_projection as projection
from pgran.experiments.pulse import figures as pulse
from pgran.experiments.relaxation import figures as relaxation
from pgran.experiments.relaxation.fluctuations import power_spectrum
from pgran.experiments.response import figures as response
from pgran.medium.space import reaches

FINE = np.linspace(0.1, 1.1, 401)


def test_results_with_nothing_to_draw():
    empty = {"modes": find_modes(interval=(50.0, 51.0)), "configuration": compare([np.nan])}
    for what, result in empty.items():
        with pytest.raises(FileError, match=f"nothing to draw in this result: no {what}"):
            figures.make(result)


# What each panel draws: a function of the record, x and y. Frequencies are in units of omega_mx,
# those of the box in units of sqrt(K0/m) / Lx, energies in units of m omega_mx^2.
PANELS = [
    (respond, response.amplitude, lambda r: (SWEEP, r.amplitude[:, 0])),
    (respond, response.phase, lambda r: (SWEEP, r.phase[:, 0])),
    (respond, response.delay, lambda r: (SWEEP, UNIT * r.delay[:, 0])),
    (respond, response.force, lambda r: (SWEEP, np.abs(r.force))),
    (respond, response.force_phase, lambda r: (SWEEP, np.angle(r.force))),
    (respond, response.power, lambda r: (SWEEP, r.power)),
    (respond_box, continuum.amplitude, lambda r: (r.omega / 3, r.amplitude)),
    (respond_box, continuum.phase, lambda r: (r.omega / 3, r.phase)),
    (find_modes, modes.participation, lambda r: (r.omega / UNIT, r.participation)),
    (count_modes, density.staircase, lambda r: (r.omega / UNIT, r.count)),
    (lambda: project(FINE), projection.coefficients,
     lambda r: (r.mode_omega / UNIT, np.abs(r.coefficient[200]))),
    (lambda: project(FINE), projection.dominant,
     lambda r: (FINE, r.mode_omega[r.dominant] / UNIT)),
    (relax, relaxation.series, lambda r: (np.arange(301), r.amplitude[0, :, 0])),
    (lambda: listen(method="laplace"), pulse.energy,
     lambda r: (UNIT * r.time, np.transpose([r.work, r.energy, r.dissipated]))),
]  # fmt: skip
ALONE = ("continuum", "relaxation")  # panels that take no medium


def drawn(panel, result):
    """One panel of a result in axes of its own, and the record that it shows."""
    record = getattr(result, result.scene)
    alone = panel.__module__.split(".")[2] in ALONE
    return draw(panel, record, *[] if alone else [result.medium]), record


@pytest.mark.parametrize(("make", "panel", "expected"), PANELS)
def test_curves_are_the_numbers_of_the_record(make, panel, expected):
    ax, record = drawn(panel, make())
    x, every = expected(record)
    for y, line in zip(np.reshape(every, (len(x), -1)).T, shown_in(ax), strict=False):
        assert line.get_xdata() == pytest.approx(x, rel=1e-12)
        shown = np.ma.getdata(line.get_ydata(orig=True))
        np.testing.assert_allclose(shown, y, rtol=1e-12, atol=0)
        assert not gaps(line) or panel in (response.force, response.force_phase, response.power)


def shown_in(ax):
    return curves(ax) or lines(ax, color="black") or ax.get_lines()


FAILED = [80, 81, 83, 250]


@pytest.mark.parametrize(
    ("make", "panel"),
    [(respond, getattr(response, name)) for name in ("amplitude", "phase", "delay", "force")]
    + [(lambda: project(FINE), projection.dominant), (relax, relaxation.series)],
)
def test_failed_points_are_crosses_and_gaps(make, panel):
    result = make()
    record = getattr(result, result.scene)
    if panel is relaxation.series:
        record.displacement[0, FAILED] = np.nan
    else:
        record.converged_reason[FAILED] = [-3, 0, -1, -9]
    ax, _ = drawn(panel, result)
    (line,) = curves(ax)
    assert marks(ax, "x") == pytest.approx(line.get_xdata()[FAILED])
    assert set(FAILED) <= set(gaps(line))
    assert 82 in line.get_markevery()  # has no good neighbour to be joined with: a dot
    assert "missed the accuracy asked for" in labels(ax)
    if panel in (response.amplitude, response.phase):
        record.converged_reason[:] = -3
    elif panel is relaxation.series:
        assert note(figures.make(result)["timeres"]).startswith("4 of 301 amplitudes missed")
        record.displacement[:] = np.nan
    else:
        return
    assert not drawn(panel, result)[0].yaxis.get_visible()


def test_the_box_on_a_wall_at_rest_and_its_resonances():
    result = respond_box()
    box = result.continuum
    box.amplitude[7] = 0.0
    upper, lower = figures.make(result)["exactpl"].axes
    assert (upper.get_yscale(), lower.get_yscale()) == ("log", "linear")
    for ax in (upper, lower):
        assert gaps(curves(ax)[0]) == [7]
        assert marks(ax, TICKUP) == pytest.approx(box.resonance / 3)
    assert labels(upper) == ["driven resonances"]


def test_without_damping_the_phase_is_0_or_pi():
    box = respond_box(damping=0.0).continuum
    box.phase[100:] += 2 * np.pi  # rounding decides by which way an unwrapped phase jumps
    ax = draw(continuum.phase, box)
    (steps,) = curves(ax)
    assert np.array_equal(steps.get_ydata() == np.pi, box.displacement.real < 0)
    assert set(steps.get_ydata()) == set(ax.get_yticks()) == {0.0, np.pi}


def test_the_modes_chosen():
    """Near .6 one that is extended as the median of its neighbours, nearest if it has none."""
    x, balls = np.array([0.1, 0.2, 0.56, 0.59, 0.6, 0.67, 0.98, 1.1]), np.arange(8.0)
    assert modes.pick(x, balls) == [1, 3, 6]
    assert modes.pick(x, balls[[0, 1, 3, 2, 4, 5, 6, 7]]) == [1, 2, 6]
    assert modes.pick(x[[0, 1, 5, 6]], balls[:4]) == [1, 2, 3]
    assert modes.pick(np.array([0.6, 0.61]), balls[:2]) == [0, 1]
    assert projection.successive(np.array([0.2, 0.4, 0.58, 0.61, 0.7, 0.9]), 0.6) == [2, 3, 4]


@pytest.mark.parametrize("shape", [(30,), (6, 5), (4, 3, 5)])
def test_a_mode_is_an_image_symmetric_about_0_or_a_line_from_wall_to_wall(shape):
    result = find_modes(shape)
    shown, x = result.modes, result.modes.omega / result.lattice.omega_mx
    panels = page_of(result, "shapes").panels
    for mode, ax in zip(modes.pick(x, shown.participation), panels, strict=True):
        vector, title = shown.vector[mode], ax.get_title(loc="left")
        largest = np.unravel_index(np.abs(vector).argmax(), shape)
        plane = vector[(..., *largest[2:])] / np.abs(vector).max()
        if len(shape) == 1:
            (line,) = lines(ax, color="black")
            assert list(line.get_xdata()) == list(range(-1, 31))
            assert np.array_equal(line.get_ydata(), [0, *plane, 0])
        else:
            (image,) = ax.images
            assert np.array_equal(image.get_array(), plane.T)
            assert image.get_clim() == (-1.0, 1.0)
        assert f"{x[mode]:.4g} " in title
        assert f"$P_i$ = {shown.participation[mode]:.3g} balls" in title
        assert (f"plane $z$ = {largest[-1]}" in title) == (len(shape) == 3)


def test_densities_of_modes_are_per_ball_and_participation_ends_at_all_balls():
    result, counted = find_modes((6, 5)), count_modes()
    for panel, of in ((modes.density, result), (density.density, counted)):
        ax, _ = drawn(panel, of)
        values, edges, _ = ax.patches[0].get_data()
        assert np.sum(values * np.diff(edges)) == pytest.approx(1)
    assert np.array_equal(edges, counted.density.omega / UNIT)
    ax, _ = drawn(modes.participation, result)
    low, high = ax.get_ylim()
    assert low < 1 < 30 < high  # points of one ball, and of all, are whole
    assert ax.child_axes[0].get_ylabel() == "$P_i/N$, of $N$ = 30 balls"


def test_unstable_modes_are_at_negative_frequencies_and_none_is_lost():
    """In bins that end at 0; where there is no place for them their number is said."""
    result = find_modes((6, 5))
    omega = np.append(-result.modes.omega[2::-1], result.modes.omega[3:])
    result.modes = replace(result.modes, omega=omega)
    ax, _ = drawn(modes.participation, result)
    (low, high), x = ax.get_xlim(), lines(ax, marker=".")[0].get_xdata()
    assert low < x[0] < x[2] < 0 < x[3] < x[-1] < high
    values, edges, _ = drawn(modes.density, result)[0].patches[0].get_data()
    parts = values * np.diff(edges)
    assert parts[edges[:-1] < 0].sum() == pytest.approx(3 / 30)
    assert parts.sum() == pytest.approx(1)
    made = figures.make(result)
    assert all("3 unstable modes" in made[name].caption for name in ("participation", "density"))
    counted = figures.make(result_of(replace(count_modes().density, unstable=3)))
    for page in (made["reduced"], counted["density"], counted["reduced"]):
        assert note(page).endswith("NOT SHOWN: 3 unstable modes")


@pytest.mark.parametrize(("size", "scale"), [(90, "log"), (20, "linear")])
def test_modes_of_a_wide_range_have_logarithmic_axes(size, scale):
    """Bins of equal ratios, which lose no mode."""
    ax, _ = drawn(modes.density, find_modes((size,)))
    values, edges, _ = ax.patches[0].get_data()
    assert np.sum(values * np.diff(edges)) == pytest.approx(1)
    assert np.ptp(np.diff(np.log(edges) if scale == "log" else edges)) == pytest.approx(0)
    points, _ = drawn(modes.participation, find_modes((size,)))
    assert {ax.get_xscale(), ax.get_yscale(), points.get_xscale()} == {scale}
    assert ax.get_ylim()[0] < values[values > 0].min()


def test_weyls_law_is_drawn_where_bonds_are_equal():
    random, equal = count_modes(), count_modes(uniform_lattice((9, 8), mass=0.25))
    assert not labels(drawn(density.staircase, random)[0])
    assert labels(drawn(density.staircase, equal)[0]) == ["long waves (Weyl)"]


def test_what_is_missing_is_said_in_every_figure():
    missing = {"count_expected": 13}
    bare = {"vector": None, "count_certified": False}
    uncertain = {"certified": np.arange(30) != 4}
    for result, changed, said in (
        (find_modes(), missing, "NOT ALL MODES: 12 of 13 found"),
        (project(FINE), missing, "NOT ALL MODES: 12 of 13 found"),
        (find_modes(), bare, "NOT CERTIFIED: some modes"),
        (count_modes(), uncertain, "NOT CERTIFIED: 1 count,"),
    ):
        record = getattr(result, result.scene)
        for figure in figures.make(result_of(replace(record, **changed))).values():
            assert said in note(figure)


def test_coefficients_at_the_nearest_frequency_that_is_accurate():
    result = project(FINE)
    shown = result.projection
    shown.converged_reason[[199, 200]] = 0  # .6 itself and the one below
    ax = draw(projection.coefficients, shown, result.lattice)
    (curve,), (drive,) = curves(ax), lines(ax, linestyle="-", color="#0072B2")
    assert np.array_equal(curve.get_ydata(), np.abs(shown.coefficient[201]))
    assert list(drive.get_xdata()) == [shown.omega[201] / UNIT] * 2
    (slope,) = lines(draw(projection.dominant, shown, result.lattice), linewidth=2.5)
    assert np.array_equal(slope.get_xdata(), slope.get_ydata())


@pytest.mark.parametrize(("x", "centre"), [(FINE, 0.6), (np.linspace(0.2, 0.4, 81), 0.3)])
def test_coefficients_of_three_modes(x, centre):
    result = project(x, (6, 5))
    shown, own = result.projection, result.projection.mode_omega / UNIT
    failed = np.abs(x - centre).argmin() + np.array([2, 3])
    shown.converged_reason[failed] = -3
    ax = draw(projection.single_modes, shown, result.lattice)
    assert marks(ax, "x") == pytest.approx(x[failed])
    for mode, curve in zip(projection.successive(own, centre), curves(ax), strict=True):
        near = np.isin(shown.omega / UNIT, curve.get_xdata())
        values = curve.get_ydata(orig=True)
        np.testing.assert_allclose(values.data, np.abs(shown.coefficient[near, mode]), rtol=1e-14)
        assert list(x[near][gaps(curve)]) == list(x[failed])


def test_the_spectrum_its_fit_and_slope_2():
    result = relax()
    walk = np.cumsum(np.random.default_rng(8).normal(size=(1, 20001)), axis=1)
    result.spectrum = shown = power_spectrum(walk)  # falls like f^-2
    ax = figures.make(result)["timeres"].axes[1]
    power, fit, slope = ((line.get_xdata(), line.get_ydata()) for line in ax.get_lines())
    assert np.array_equal(power, (shown.frequency, shown.power))
    assert fit[0][[0, -1]] == pytest.approx([0.01, 0.3])
    window = (shown.frequency >= 0.01) & (shown.frequency <= 0.3)
    ratio = shown.power[window] / np.interp(shown.frequency[window], *fit)
    assert np.mean(ratio) == pytest.approx(1, abs=0.15)
    assert np.diff(np.log(slope[1])) == pytest.approx(-2 * np.diff(np.log(slope[0])))
    assert rf"\psi = {shown.exponent:.3f} \pm {shown.exponent_error:.3f}" in labels(ax)[0]


def test_errors_against_run_time_and_the_front():
    result = compare([1e-3, 1e-5, 1e-4, 1e-6, *[1e-2] * 7, np.nan])
    assert "solver11" in note(figures.make(result)["front"])
    ax = draw(accuracy.front, result.accuracy)
    names = [f"solver{n}" for n in range(11)]
    assert labels(ax)[:11] == names
    shown = [line for line in ax.get_lines() if line.get_label() in names]
    assert len({(line.get_color(), line.get_marker()) for line in shown}) == 11
    (hollow,) = (x for x in lines(ax, markerfacecolor="white") if x.get_xdata().any())
    assert list(hollow.get_xdata()) == [4]
    (steps,) = lines(ax, drawstyle="steps-post")
    assert steps.get_xdata()[:3].tolist() == [1, 1, 2]
    assert steps.get_ydata()[1:].tolist() == [1e-3, 1e-5, 1e-5]


def test_equally_accurate_configurations_are_bars_of_their_run_times():
    result = compare([1e-9, 2e-9, 1.5e-9, 1e-9, np.nan])
    (ax,) = figures.make(result)["front"].axes
    assert [bar.get_width() for bar in ax.patches] == [1, 2, 3, 4]
    assert ax.patches[3].get_facecolor()[:3] == (1, 1, 1)  # failed
    told = [text.get_text() for text in ax.get_yticklabels()]
    assert told == list(map(formulas, result.accuracy.label[:4]))
    assert r"errors at most $2\times10^{-9}$" in ax.get_xlabel()
    (ax,) = figures.make(compare([1e-9, 2e-8]))["front"].axes
    assert ax.get_yscale() == "log"


def test_unstable_loud_states_are_dashed_inaccurate_ones_hollow_missing_ones_crosses():
    """Along amplitudes; beside harmonics are their slopes, and where the first contact opens."""
    result = shout()
    record = result.loud
    record.multiplier[0, 3], record.converged_reason[0, [2, 4]] = -1.5, (0, -1)
    ax, (x,) = draw(loud.harmonics, record, result.medium), record.drive
    dashed, solid = curves(ax)[::2], curves(ax)[1::2]
    for n, (one, other) in enumerate(zip(dashed, solid, strict=True)):
        for line in (one, other):
            assert line.get_xdata() == pytest.approx(x, rel=1e-12)
            shown = np.ma.getdata(line.get_ydata(orig=True))
            assert shown[:4] == pytest.approx(np.abs(record.harmonic[0, :4, 0, n]), rel=1e-12)
        assert (one.get_linestyle(), other.get_linestyle()) == ("--", "-")
        assert (gaps(one), gaps(other)) == ([4], [3, 4])
    assert [*lines(ax, markerfacecolor="white")[0].get_xdata()] == [x[2]]
    assert marks(ax, "x") == pytest.approx([x[4]])
    for n in (1, 2):
        (slope,) = lines(ax, label=f"slope {n}")
        rise = np.diff(np.log(slope.get_ydata())) / np.diff(np.log(slope.get_xdata()))
        assert rise == pytest.approx(n)
    assert lines(ax, linestyle=":")[0].get_xdata()[0] == record.opening[0, 0]
    told = loud.errors(record, "")
    for words in ("estimated", "1 of 5 states are less accurate", "1 of 5 states are not reached"):
        assert words in told
    for panel, values in ((loud.change, record.change), (loud.clapping, record.clapping)):
        line = curves(draw(panel, record, result.medium))[0]
        assert np.ma.getdata(line.get_ydata(orig=True))[:4] == pytest.approx(values[0, :4])


def test_a_loud_resonance_up_and_down_and_its_folds():
    result = lean()
    record, unit = result.loud, result.medium.omega_mx
    ax = draw(loud.ratio, record, result.medium)
    for n, line in enumerate(curves(ax)[::2]):
        assert line.get_xdata() == pytest.approx(record.omega / unit)
        expected = np.abs(record.harmonic[:, n, 0, 1]) / record.drive[:, n]
        assert np.ma.getdata(line.get_ydata(orig=True)) == pytest.approx(expected)
    folds = np.unique(record.fold[np.isfinite(record.fold)])
    assert len(np.unique(folds.round(6))) == 2  # the same up and down
    assert marks(ax, TICKUP) == pytest.approx(folds / unit)
    assert labels(ax)[1:] == ["drive 0.003 overlaps", "drive 0.02 overlaps"]


def test_contacts_that_clap_are_drawn():
    """Those of the state with most of them; across the end of the box a line is in two parts."""
    result = shout()
    figure, clapped = page_of(result, "claps"), result.loud.clapped[0, -1] == 1
    drawn = [each for each in figure.panels[0].collections if 2.0 in each.get_linewidth()]
    count = np.count_nonzero(clapped) + np.count_nonzero(clapped & reaches(result.medium)[1])
    assert sum(len(each.get_segments()) for each in drawn) == count > 0
    assert f"Orange: {np.count_nonzero(clapped)} of {len(clapped)} contacts" in figure.caption
