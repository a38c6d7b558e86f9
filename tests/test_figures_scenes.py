"""Figures of the box, modes, projections, relaxations and accuracy, read off the axes."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from figure_results import (
    UNIT,
    curves,
    gaps,
    labels,
    lines,
    make_accuracy,
    make_continuum,
    make_modes,
    make_projection,
    make_relaxation,
    marks,
    note,
)

from pgran import figures
from pgran.errors import FileError

pytest.importorskip("matplotlib")

from matplotlib.figure import Figure

from pgran.figures import accuracy, continuum, modes, projection, relaxation


def draw(panel, *shown, **wanted):
    """One panel in axes of their own."""
    ax = Figure().subplots()
    panel(ax, *shown, **wanted)
    return ax


@pytest.mark.parametrize(
    ("make", "expected"),
    [
        (make_continuum, ["exactpl"]),
        (make_modes, ["shapes", "participation", "density"]),
        (lambda: make_modes(omega=[0.4, 0.5]), ["shapes", "participation"]),
        (make_projection, ["onefreq", "maxci", "cifreq"]),
        (lambda: make_projection([0.6], [0.5, 0.6]), ["onefreq"]),
        (lambda: make_projection([0.5, 0.6, 0.7]), ["onefreq"]),
        (lambda: make_projection(None, [0.59, 0.6, 0.62]), ["cifreq"]),
        (make_relaxation, ["timeres"]),
        (lambda: make_accuracy([1e-3]), ["front"]),
    ],
)
def test_what_is_shown_depends_on_what_there_is(make, expected):
    made = figures.make(make())
    assert list(made) == expected
    for figure in made.values():
        figure.draw_without_rendering()
        assert not note(figure)


@pytest.mark.parametrize(
    ("make", "what"),
    [
        (lambda: make_continuum(count=0), "no frequencies"),
        (lambda: make_modes(omega=[]), "no modes"),
        (lambda: make_projection([]), "no frequencies"),
        (lambda: make_relaxation(trajectories=0), "no amplitudes"),
        (lambda: make_accuracy([np.nan]), "no configuration"),
    ],
)
def test_results_with_nothing_to_draw(make, what):
    with pytest.raises(FileError, match=f"nothing to draw in this result: {what}"):
        figures.make(make())


# The box


def test_the_box_has_amplitude_above_phase_and_its_resonances():
    made = make_continuum()
    made.continuum.amplitude[7] = 0.0  # on a wall at rest
    upper, lower = figures.make(made)["exactpl"].axes
    assert (upper.get_yscale(), lower.get_yscale()) == ("log", "linear")
    for ax, values in ((upper, made.continuum.amplitude), (lower, made.continuum.phase)):
        (curve,) = curves(ax)
        assert curve.get_xdata() == pytest.approx(made.continuum.omega / 3.0)
        assert np.array_equal(curve.get_ydata(orig=True).data, values)
        assert gaps(curve) == [7]
        assert marks(ax, "+") == pytest.approx([4.4, 9.9])
    assert labels(upper) == ["driven resonances"]
    assert "0.003" in upper.get_title(loc="left")
    assert "rad" in lower.get_ylabel()
    made.continuum.amplitude[:] = 0.0
    assert not draw(continuum.amplitude, made.continuum).yaxis.get_visible()


def test_without_damping_the_phase_is_0_or_pi():
    box = make_continuum(damping=0.0).continuum
    box.phase[100:] += 2 * np.pi  # rounding decides by which way an unwrapped phase jumps
    ax = draw(continuum.phase, box)
    (curve,) = curves(ax)
    assert curve.get_drawstyle() == "steps-mid"
    assert set(curve.get_ydata()) == {0.0, np.pi}
    assert np.array_equal(curve.get_ydata() > 0, np.floor(box.omega / 9) % 2 == 1)
    assert list(ax.get_yticks()) == [0, np.pi]


# Modes


def test_the_modes_chosen():
    assert modes.pick(np.array([0.1, 0.2, 0.59, 0.61, 0.98, 1.1])) == [1, 3, 4]
    assert modes.pick(np.array([0.1, 0.6, 0.7, 0.8])) == [1, 3]
    assert modes.pick(np.array([0.6, 0.61])) == [0, 1]
    modes_at = np.array([0.2, 0.4, 0.58, 0.61, 0.7, 0.9])
    assert projection.successive(modes_at, 0.6) == [2, 3, 4]
    assert projection.successive(modes_at, 2.0) == [3, 4, 5]
    assert projection.successive(modes_at[:2], 0.6) == [0, 1]


@pytest.mark.parametrize("shape", [(30,), (6, 5), (20, 4), (4, 20), (4, 3, 5)])
def test_a_mode_is_an_image_symmetric_about_0_or_a_line_from_wall_to_wall(shape):
    made = make_modes(shape)
    figure = figures.make(made)["shapes"]
    panels = [ax for ax in figure.axes if ax.get_title(loc="left")]
    for mode, ax in zip(modes.pick(made.modes.omega / UNIT), panels, strict=True):
        vector, title = made.modes.vector[mode], ax.get_title(loc="left")
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
            assert image.get_cmap()(0.5)[:3] == pytest.approx(np.ones(3), abs=0.05)
        assert f"= {made.modes.omega[mode] / UNIT:.4f}" in title
        assert f"$P_i$ = {made.modes.participation[mode]:.3g} balls" in title
        assert (f"plane $z$ = {largest[-1]}" in title) == (len(shape) == 3)
    assert len(panels) == 3
    figure.draw_without_rendering()
    boxes = [ax._left_title.get_window_extent() for ax in panels]
    assert not any(one.overlaps(other) for one, other in pairwise(boxes))
    assert all(box.x1 <= figure.bbox.x1 and box.y1 <= figure.bbox.y1 for box in boxes)


def test_participation_and_density_against_frequency():
    made = make_modes((20, 20))
    ax = draw(modes.participation, made.modes, made.lattice)
    (points,) = ax.get_lines()
    assert np.array_equal(points.get_xdata(), made.modes.omega / UNIT)
    assert np.array_equal(points.get_ydata(), made.modes.participation)
    assert (ax.get_yscale(), ax.get_ylim()) == ("log", (1, 400))
    ax = draw(modes.density, made.modes, made.lattice)
    density, edges, _ = ax.patches[0].get_data()
    assert np.sum(density * np.diff(edges)) == pytest.approx(400)
    assert edges[[0, -1]] == pytest.approx([0.05, 1.2])


def test_missing_modes_are_said_in_every_figure():
    for figure in figures.make(make_modes(missing=1, certified=False)).values():
        assert note(figure) == "NOT ALL MODES: 30 of 31 found"
    bare = make_modes(certified=False)
    bare.modes = replace(bare.modes, vector=None)
    assert "NOT CERTIFIED" in note(figures.make(bare)["participation"])
    for figure in figures.make(make_projection(missing=1)).values():
        assert note(figure) == "NOT ALL MODES: 45 of 46 found"


# Projections


def test_coefficients_at_one_frequency():
    made = make_projection()
    shown = made.projection
    shown.converged_reason[200] = 0  # .6 itself
    ax = draw(projection.coefficients, shown, made.lattice)
    (curve,), (drive,) = curves(ax), lines(ax, linestyle="-", color="#0072B2")
    nearest = np.flatnonzero(np.isclose(np.abs(shown.omega / UNIT - 0.6), 0.0025))[0]
    assert np.array_equal(curve.get_xdata(), shown.mode_omega / UNIT)
    assert np.array_equal(curve.get_ydata(), np.abs(shown.coefficient[nearest]))
    assert list(drive.get_xdata()) == [shown.omega[nearest] / UNIT] * 2
    assert labels(ax) == [rf"driving frequency {drive.get_xdata()[0]:.4g} $\omega_{{mx}}$"]
    shown.converged_reason[:] = -3
    ax = draw(projection.coefficients, shown, made.lattice, drive=0.5)
    assert np.ma.getmaskarray(curves(ax)[0].get_ydata(orig=True)).all()
    assert marks(ax, "x") == pytest.approx([0.5])
    assert "missed the accuracy asked for" in labels(ax)


def test_the_dominant_mode_and_a_line_of_slope_1():
    made = make_projection()
    shown = made.projection
    shown.converged_reason[50] = -1
    ax = draw(projection.dominant, shown, made.lattice)
    (curve,), (line,) = curves(ax), lines(ax, linewidth=2.5)
    assert np.array_equal(curve.get_xdata(), shown.omega / UNIT)
    assert np.array_equal(curve.get_ydata(orig=True).data, shown.mode_omega[shown.dominant] / UNIT)
    assert gaps(curve) == [50]
    assert np.array_equal(line.get_xdata(), line.get_ydata())
    assert line.get_xdata() == pytest.approx([0.1, 1.1])
    assert labels(ax) == ["slope 1", "missed the accuracy asked for"]


@pytest.mark.parametrize(("x", "centre"), [(None, 0.6), (np.linspace(0.2, 0.4, 81), 0.3)])
def test_coefficients_of_three_modes(x, centre):
    made = make_projection(x)
    shown = made.projection
    x, own = shown.omega / UNIT, shown.mode_omega / UNIT
    failed = np.abs(x - centre).argmin() + np.array([2, 3])
    shown.converged_reason[failed] = -3
    ax = draw(projection.single_modes, shown, made.lattice)
    assert marks(ax, "x") == list(x[failed])
    for mode, curve in zip(projection.successive(own, centre), curves(ax), strict=True):
        near = np.isin(x, curve.get_xdata())
        values = curve.get_ydata(orig=True)
        assert np.array_equal(values.data, np.abs(shown.coefficient[near, mode]))
        assert list(x[near][gaps(curve)]) == list(x[failed])
        assert x[near][values.argmax()] == pytest.approx(own[mode], abs=0.005)
        assert any(f"{own[mode]:.5f}" in label for label in labels(ax))
    assert len({curve.get_color() for curve in curves(ax)}) == 3
    assert np.ptp(curves(ax)[0].get_xdata()) == pytest.approx(0.15, abs=0.01)


# Relaxation


def test_a_stretch_of_the_series():
    shown = make_relaxation(4000, trajectories=2).relaxation
    for wanted, length in (({}, 2001), ({"steps": 70}, 71)):
        ax = draw(relaxation.series, shown, **wanted)
        (curve,) = curves(ax)
        assert np.array_equal(curve.get_xdata(), np.arange(length))
        assert np.array_equal(curve.get_ydata(), shown.amplitude[0, :length, 0])
    assert labels(ax) == ["ball (1, 2)"]
    assert "step" in ax.get_xlabel()


def test_the_spectrum_its_fit_and_slope_2():
    made = make_relaxation(20000)
    shown = made.spectrum
    ax = figures.make(made)["timeres"].axes[1]
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")
    power, fit, slope = ((line.get_xdata(), line.get_ydata()) for line in ax.get_lines())
    assert np.array_equal(power, (shown.frequency, shown.power))
    assert fit[0][[0, -1]] == pytest.approx([0.01, 0.3])
    window = (shown.frequency >= 0.01) & (shown.frequency <= 0.3)
    through = np.interp(shown.frequency[window], *fit)
    assert np.mean(shown.power[window] / through) == pytest.approx(1, abs=0.15)
    assert np.diff(np.log(slope[1])) == pytest.approx(-2 * np.diff(np.log(slope[0])))
    assert np.all(slope[1] > fit[1])
    assert rf"\psi = {shown.exponent:.3f} \pm {shown.exponent_error:.3f}" in labels(ax)[0]
    assert labels(ax)[1] == r"slope $-2$"


def test_failed_steps_and_upper_limits_of_amplitudes_at_the_floor():
    made = make_relaxation()
    shown = made.relaxation
    shown.displacement[0, [6, 9]] = np.nan
    shown.at_floor[0, [5, 200], 0] = 1
    figure = figures.make(made)["timeres"]
    (ax,) = figure.axes
    assert gaps(curves(ax)[0]) == [5, 6, 9, 200]
    assert marks(ax, "x") == [6, 9]
    assert note(figure) == "2 of 301 amplitudes missed the accuracy asked for"
    (limits,) = lines(ax, marker="v")
    there = np.isfinite(limits.get_ydata())
    assert list(limits.get_xdata()[there]) == [5, 200]
    assert np.array_equal(limits.get_ydata()[there], shown.amplitude[0, [5, 200], 0] + 0.5)
    assert labels(ax)[1:] == ["upper limit, at the floor", "missed the accuracy asked for"]
    shown.displacement[:] = np.nan
    assert not draw(relaxation.series, shown).yaxis.get_visible()


# Accuracy


def test_errors_against_run_time_and_the_front():
    made = make_accuracy([1e-3, 1e-5, 1e-4, 1e-6, *[1e-2] * 7, np.nan])
    assert "solver11" in note(figures.make(made)["front"])
    ax = draw(accuracy.front, made.accuracy)
    names = [f"solver{n}" for n in range(11)]
    assert labels(ax)[:11] == names
    assert "hollow: some failed" in labels(ax)
    drawn = [line for line in ax.get_lines() if line.get_label() in names]
    assert len({(line.get_color(), line.get_marker()) for line in drawn}) == 11
    (hollow,) = (x for x in lines(ax, markerfacecolor="white") if x.get_xdata().any())
    assert list(hollow.get_xdata()) == [4]
    (steps,) = lines(ax, drawstyle="steps-post")
    assert steps.get_xdata()[:3].tolist() == [1, 1, 2]
    assert steps.get_ydata()[1:].tolist() == [1e-3, 1e-5, 1e-5]
