"""Figures of the box, modes, projections, relaxations and accuracy, read off the axes."""

from dataclasses import replace

import numpy as np
import pytest
from figure_reading import curves, draw, gaps, labels, lines, marks, note
from figure_results import (
    UNIT,
    compare,
    count_modes,
    find_modes,
    listen,
    project,
    relax,
    respond_box,
    result_of,
)
from matplotlib.markers import TICKUP
from samples import uniform_lattice

from pgran.draw import pages as figures
from pgran.errors import FileError
from pgran.experiments.accuracy import figures as accuracy
from pgran.experiments.continuum import figures as continuum
from pgran.experiments.modes import figures as modes
from pgran.experiments.modes import figures_density as density
from pgran.experiments.modes import figures_projection as projection
from pgran.experiments.relaxation import figures as relaxation
from pgran.experiments.relaxation.spectrum import power_spectrum

FINE = np.linspace(0.1, 1.1, 401)


def bare_signals():
    unknown = dict.fromkeys(["energy", "dissipated", "field_time", "field"])
    return result_of(replace(listen().pulse, **unknown))


@pytest.mark.parametrize(
    ("make", "expected"),
    [
        (respond_box, ["exactpl"]),
        (lambda: find_modes((6, 5)), ["shapes", "participation", "density"]),
        (lambda: find_modes((2, 1)), ["shapes", "participation"]),
        (count_modes, ["staircase", "density"]),
        (lambda: project(FINE), ["maxci"]),
        (lambda: project([0.6], (2, 1)), ["onefreq"]),
        (lambda: project([0.5, 0.6, 0.7]), ["onefreq"]),
        (lambda: project(FINE, (3, 1)), ["cifreq"]),
        (relax, ["timeres"]),
        (lambda: compare([1e-3]), ["front"]),
        (listen, ["signals", "field", "energy", "spectrum", "bonds"]),
        (bare_signals, ["signals", "spectrum", "bonds"]),
    ],
)
def test_what_is_shown_depends_on_what_there_is(make, expected):
    made = figures.make(make())
    assert list(made) == expected
    for figure in made.values():
        figure.draw_without_rendering()
        assert "NOT" not in note(figure)


def test_results_with_nothing_to_draw():
    empty = {"modes": find_modes(interval=(50.0, 51.0)), "configuration": compare([np.nan])}
    for what, result in empty.items():
        with pytest.raises(FileError, match=f"nothing to draw in this result: no {what}"):
            figures.make(result)


def test_the_box_has_amplitude_above_phase_and_its_resonances():
    result = respond_box()
    box = result.continuum
    box.amplitude[7] = 0.0  # on a wall at rest
    upper, lower = figures.make(result)["exactpl"].axes
    assert (upper.get_yscale(), lower.get_yscale()) == ("log", "linear")
    for ax, values in ((upper, box.amplitude), (lower, box.phase)):
        (curve,) = curves(ax)
        assert curve.get_xdata() == pytest.approx(box.omega / 3)  # units of sqrt(K0/m) / Lx
        assert np.array_equal(curve.get_ydata(orig=True).data, values)
        assert gaps(curve) == [7]
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
    panels = [ax for ax in figures.make(result)["shapes"].axes if ax.get_title(loc="left")]
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
        assert f"= {x[mode]:.4f}" in title
        assert f"$P_i$ = {shown.participation[mode]:.3g} balls" in title
        assert (f"plane $z$ = {largest[-1]}" in title) == (len(shape) == 3)


def test_participation_and_density_against_frequency():
    result = find_modes((6, 5))
    ax = draw(modes.participation, result.modes, result.lattice)
    (points,) = lines(ax, marker=".")
    assert np.array_equal(points.get_xdata(), result.modes.omega / UNIT)
    assert np.array_equal(points.get_ydata(), result.modes.participation)
    assert (ax.get_yscale(), ax.get_ylim()) == ("log", (1, 30))
    ax = draw(modes.density, result.modes, result.lattice)
    density, edges, _ = ax.patches[0].get_data()
    assert np.sum(density * np.diff(edges)) == pytest.approx(1)  # per ball


def test_counts_of_modes_and_weyls_law():
    """Densities are per ball and omega_mx; the law is drawn where bonds are equal."""
    result = count_modes()
    shown, x = result.density, result.density.omega / UNIT
    ax = draw(density.staircase, shown, result.lattice)
    (curve,) = lines(ax, marker=".")
    assert np.array_equal(curve.get_xdata(), x)
    assert np.array_equal(curve.get_ydata(), shown.count)
    ax = draw(density.density, shown, result.lattice)
    values, edges, _ = ax.patches[0].get_data()
    assert np.array_equal(edges, x)
    assert np.sum(values * np.diff(edges)) == pytest.approx(1)
    assert not labels(ax)
    result = count_modes(uniform_lattice((9, 8), mass=0.25))
    for panel in (density.staircase, density.density):
        ax = draw(panel, result.density, result.lattice)
        assert labels(ax) == ["long waves (Weyl)"]
    shown = replace(result.density, certified=np.arange(30) != 4)
    for figure in figures.make(result_of(shown)).values():
        assert "NOT CERTIFIED: 1 counts" in note(figure)


def test_missing_modes_are_said_in_every_figure():
    for result in (find_modes(), project(FINE)):
        group = result.scene
        found = getattr(result, group)
        setattr(result, group, replace(found, count_expected=13))
        for figure in figures.make(result).values():
            assert note(figure).endswith("NOT ALL MODES: 12 of 13 found")
    bare = result_of(replace(find_modes().modes, vector=None, count_certified=False))
    assert "NOT CERTIFIED" in note(figures.make(bare)["participation"])


def test_coefficients_at_one_frequency():
    result = project(FINE)
    shown = result.projection
    shown.converged_reason[[199, 200]] = 0  # .6 itself and the one below
    ax = draw(projection.coefficients, shown, result.lattice)
    (curve,), (drive,) = curves(ax), lines(ax, linestyle="-", color="#0072B2")
    assert np.array_equal(curve.get_xdata(), shown.mode_omega / UNIT)
    assert np.array_equal(curve.get_ydata(), np.abs(shown.coefficient[201]))
    assert list(drive.get_xdata()) == [shown.omega[201] / UNIT] * 2


def test_the_dominant_mode_and_a_line_of_slope_1():
    result = project(FINE)
    shown = result.projection
    shown.converged_reason[50] = -1
    ax = draw(projection.dominant, shown, result.lattice)
    (curve,), (line,) = curves(ax), lines(ax, linewidth=2.5)
    assert np.array_equal(curve.get_ydata(orig=True).data, shown.mode_omega[shown.dominant] / UNIT)
    assert gaps(curve) == [50]
    assert np.array_equal(line.get_xdata(), line.get_ydata())
    assert marks(ax, "x") == pytest.approx(FINE[[50]])


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
        assert np.array_equal(values.data, np.abs(shown.coefficient[near, mode]))
        assert list(x[near][gaps(curve)]) == list(x[failed])


def test_the_series_with_failed_steps_and_amplitudes_at_the_floor():
    result = relax()
    shown = result.relaxation
    shown.displacement[0, [6, 9]] = np.nan
    shown.at_floor[0, [5, 200], 0] = 1
    shown.error_bound[:] = 0.5
    figure = figures.make(result)["timeres"]
    (ax,) = figure.axes
    (curve,), (limits,) = curves(ax), lines(ax, marker="v")
    assert np.array_equal(curve.get_ydata(orig=True).data, shown.amplitude[0, :, 0], equal_nan=True)
    assert gaps(curve) == [5, 6, 9, 200]
    assert marks(ax, "x") == [6, 9]
    assert note(figure) == "2 of 301 amplitudes missed the accuracy asked for"
    assert np.array_equal(limits.get_ydata()[[5, 200]], shown.amplitude[0, [5, 200], 0] + 0.5)
    shown.displacement[:] = np.nan
    assert not draw(relaxation.series, shown).yaxis.get_visible()


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
    drawn = [line for line in ax.get_lines() if line.get_label() in names]
    assert len({(line.get_color(), line.get_marker()) for line in drawn}) == 11
    (hollow,) = (x for x in lines(ax, markerfacecolor="white") if x.get_xdata().any())
    assert list(hollow.get_xdata()) == [4]
    (steps,) = lines(ax, drawstyle="steps-post")
    assert steps.get_xdata()[:3].tolist() == [1, 1, 2]
    assert steps.get_ydata()[1:].tolist() == [1e-3, 1e-5, 1e-5]
