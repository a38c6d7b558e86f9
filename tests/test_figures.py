"""Figures of responses and of lattices: results made by hand, drawn, and read off the axes."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from figure_results import (
    INTERCEPT,
    UNIT,
    curves,
    gaps,
    labels,
    lines,
    make_lattice,
    make_modes,
    make_response,
    marks,
)

import pgran
from pgran import errors, figures
from pgran.command.plot import run as plot
from pgran.errors import FileError, PgranError

pytest.importorskip("matplotlib")

import matplotlib
from matplotlib.figure import Figure

from pgran.figures import bonds, response, style

PANELS = [response.amplitude, response.phase]


def draw(result, panel=response.amplitude, **wanted):
    """One panel of a response in axes of their own."""
    ax = Figure().subplots()
    panel(ax, result.response, result.lattice, **wanted)
    return ax


# Amplitude and phase


def test_every_point_of_every_detector_is_drawn_in_its_regime():
    result = make_response(detectors=[(1, 1), (3, 0)])
    panels = figures.make(result)["amplitude"].axes
    assert [ax.get_yscale() for ax in panels] == ["log"] * 3
    assert [ax.get_xlim() for ax in panels] == [(0.0, 0.3), (0.3, 1.0), (1.0, pytest.approx(1.315))]
    assert [ax.get_xlabel() for ax in panels] == ["", "", style.FREQUENCY]
    for d in range(2):
        seen = [curves(ax)[d] for ax in panels]
        assert np.array_equal(seen[0].get_xdata(), result.response.omega / UNIT)
        assert np.array_equal(seen[0].get_ydata(orig=True).data, result.response.amplitude[:, d])
        assert sum(260 - len(gaps(line)) for line in seen) == 260
    assert [text.get_text() for text in panels[0].get_legend().get_texts()] == labels(panels[0])
    assert labels(panels[0]) == ["ball (1, 1)", "ball (3, 0)"]
    assert len({line.get_color() for line in curves(panels[0])}) == 2


@pytest.mark.parametrize(
    ("x", "ranges"),
    [
        (np.linspace(0.3, 1.0, 50), [(0.3, 1.0)]),
        ([0.3], [(0.3, 0.32)]),
        ([0.2, 0.3, 1.2], [(0.195, 0.3), (1.18, 1.22)]),
    ],
)
def test_regimes_without_data_are_left_out(x, ranges):
    panels = figures.make(make_response(x))["amplitude"].axes
    assert [ax.get_xlim() for ax in panels] == [pytest.approx(each) for each in ranges]


def test_failed_points_are_crosses_and_gaps():
    result, failed = make_response(), [80, 81, 83, 250]
    result.response.converged_reason[failed] = [-3, 0, -1, -9]
    result.response.amplitude[80] = np.nan
    result.response.amplitude[5] = 0.0  # has no place on a log axis
    for panel, missing in zip(PANELS, ([5, *failed], failed), strict=True):
        ax = draw(result, panel)
        (line,) = curves(ax)
        assert marks(ax, "x") == list(result.response.omega[failed] / UNIT)
        assert gaps(line) == missing
        assert line.get_markevery() == [82]  # has no good neighbour to be joined with: a dot
        assert labels(ax)[-1] == "missed the accuracy asked for"
    result.response.converged_reason[:] = -3
    assert not draw(result).yaxis.get_visible()


def test_upper_limits_of_amplitudes_at_the_floor():
    """In the place of an amplitude that is not known stands what it cannot exceed."""
    result = make_response(detectors=((1, 1), (2, 2)))
    result.response.at_floor[[30, 31], 1] = 1
    ax = draw(result)
    assert [gaps(line) for line in curves(ax)] == [[], [30, 31]]
    (limits,) = lines(ax, marker="v")
    there = np.isfinite(limits.get_ydata())
    assert list(np.flatnonzero(there)) == [30, 31]
    expected = result.response.amplitude[[30, 31], 1] + 1e-3
    assert limits.get_ydata()[there] == pytest.approx(expected, rel=1e-14)
    assert labels(ax)[-1] == "upper limit, at the floor"


@pytest.mark.parametrize("panel", PANELS)
def test_modes_are_pluses_on_the_frequency_axis(panel):
    modes = np.array([0.1, 0.5, 0.9, 1.2, 7.0])  # the last lies beyond the sweep
    ax = draw(make_response(), panel, modes=modes * UNIT)
    assert marks(ax, "+") == pytest.approx(modes[:-1])
    (pluses,) = lines(ax, marker="+")
    drawn = pluses.get_transform().transform(pluses.get_xydata())
    assert drawn[:, 1] == pytest.approx(ax.bbox.y0)
    assert labels(ax)[-1] == "normal modes"


def test_phase_and_its_fit():
    result = make_response(detectors=[(1, 1), (3, 0)])
    shown = result.response
    shown.phase[:] += np.random.default_rng(1).normal(size=shown.phase.shape)
    ax = draw(result, response.phase)
    x = shown.omega / UNIT
    window = x[(x > 0.3) & (x < 1.0)]
    fits = lines(ax, linewidth=3)
    for d, (curve, fit) in enumerate(zip(curves(ax), fits, strict=True)):
        assert np.array_equal(curve.get_ydata(), shown.phase[:, d])
        assert np.array_equal(fit.get_xdata(), window[[0, -1]])
        assert fit.get_ydata() == pytest.approx(shown.phase_slope[d] * window[[0, -1]] + INTERCEPT)
    for label, words in zip(labels(ax), ("$-150$ rad", "$-300$ rad", "0.3 to 1 "), strict=True):
        assert words in label
    assert "= 0.02 " in labels(ax)[0]
    assert "rad" in ax.get_ylabel()
    shown.phase_slope[:] = np.nan
    assert labels(draw(result, response.phase)) == ["ball (1, 1)", "ball (3, 0)"]


def test_legends_lie_outside_of_the_data():
    result = make_response(detectors=[(1, 1), (3, 0), (2, 2)])
    result.response.converged_reason[100] = -3
    for figure in figures.make(result, modes=[0.4, 0.8]).values():
        figure.draw_without_rendering()
        box = figure.axes[0].get_legend().get_window_extent()
        assert box.y0 >= figure.axes[0].bbox.y1
        assert box.x0 >= 0
        assert box.y1 <= figure.bbox.y1


# Bonds


@pytest.mark.parametrize(
    ("shape", "detector", "count"),
    [((6,), (2,), 7), ((4, 3), (1, 1), 31), ((4, 3, 5), (1, 1, 2), 31)],
)
def test_every_bond_is_a_segment_of_its_grey(shape, detector, count):
    result, kmax = make_response(shape=shape, detectors=[detector]), UNIT**2 / (2 * len(shape))
    extreme = result.lattice.stiffness_x.copy()
    extreme[2], extreme[3] = 0.0, kmax
    result.lattice = replace(result.lattice, stiffness_x=extreme)
    figure = figures.make(result)["bonds"]
    figure.draw_without_rendering()
    (drawn,) = (c for c in figure.axes[0].collections if c.get_array() is not None)
    seen = set()
    for ends, grey in zip(drawn.get_segments(), drawn.get_colors(), strict=True):
        (x0, y0), (x1, y1) = ends
        assert abs(x1 - x0) + abs(y1 - y0) == 1
        along_x = y0 == y1
        k = result.lattice.stiffness_x if along_x else result.lattice.stiffness_y
        where = (int(max(x0, x1)), int(max(y0, y1)), *detector[2:])[: len(shape)]
        assert grey[:3] == pytest.approx(np.full(3, 1 - k[where] / kmax), abs=1 / 256)
        seen.add((along_x, where))
    assert len(seen) == len(drawn.get_segments()) == count
    ends = np.array(drawn.get_segments())
    assert ends.min(axis=(0, 1)).tolist() == [-1, -1 if len(shape) > 1 else 0]
    assert ends.max(axis=(0, 1)).tolist() == [*shape[:2], 0][:2]
    title = figure._suptitle.get_text() if figure._suptitle else ""
    assert ("z = 2" in title) == (len(shape) == 3)


def test_detectors_and_walls():
    ax = Figure().subplots()
    bonds.bonds(ax, make_lattice((4, 3, 5)), [(1, 2, 2), (3, 0, 2), (0, 0, 4)])
    dots = lines(ax, marker="o")
    assert [(*line.get_xdata(), *line.get_ydata()) for line in dots] == [(1, 2), (3, 0)]
    assert labels(ax) == ["ball (1, 2, 2)", "ball (3, 0, 2)", "driven wall"]
    assert np.array_equal(lines(ax, marker="None")[0].get_xdata(), [4, 4])
    (walls,) = (c for c in ax.collections if c.get_array() is None)
    sides = {tuple(map(tuple, side)) for side in walls.get_segments()}
    assert sides == {((-1, -1), (-1, 3)), ((-1, -1), (4, -1)), ((-1, 3), (4, 3))}


@pytest.mark.parametrize("shape", [(70, 70), (70, 70, 2), (9000,)])
def test_a_large_lattice_is_an_image_of_means(shape):
    lattice, ax = make_lattice(shape), Figure().subplots()
    image = bonds.bonds(ax, lattice, [(3, 4, 1)[: len(shape)]])
    assert list(ax.images) == [image]
    ball, expected = (5, 6, 1)[: len(shape)], 0.0
    for axis in range(len(shape)):
        k = getattr(lattice, f"stiffness_{'xyz'[axis]}")
        above = tuple(n + (a == axis) for a, n in enumerate(ball))
        expected += (k[ball] + k[above]) / (2 * len(shape))
    assert image.get_array()[(*ball[1:2], 0)[0], 5] == pytest.approx(expected)
    assert image.norm.vmax == pytest.approx(UNIT**2 / (2 * len(shape)))


# Files, and figures of the user's


@pytest.mark.parametrize("ending", ["PNG", "pdf"])
def test_plot_saves_one_file_a_figure(tmp_path, ending):
    made = pgran.plot(make_response([0.5]), tmp_path / "new" / f"my.run.{ending}", modes=[0.9])
    assert list(made) == ["amplitude", "phase", "bonds"]
    begin = {"PNG": b"\x89PNG", "pdf": b"%PDF"}[ending]
    for name in made:
        assert (tmp_path / "new" / f"my.run-{name}.{ending}").read_bytes().startswith(begin)


@pytest.mark.parametrize("name", ["figure", "figure.h5", "figure.", "figure.pgf", "file/a.png"])
def test_names_that_no_figure_can_have(tmp_path, name):
    (tmp_path / "file").touch()
    refused = r"a-amplitude\.png: cannot be written" if "file" in name else r"one of .*, \.png"
    with pytest.raises(FileError, match=refused):
        pgran.plot(make_response([0.5]), tmp_path / name)


def test_nothing_to_draw():
    result = make_response()
    with pytest.raises(FileError, match=r"nothing to draw in this result .scene response"):
        figures.make(SimpleNamespace(scene=result.scene, lattice=result.lattice))
    with pytest.raises(FileError, match="no frequencies"):
        figures.make(make_response([]))
    result.lattice = replace(result.lattice, omega_mx=0.0)
    with pytest.raises(FileError, match="omega_mx is 0"):
        figures.make(result)


def test_without_matplotlib(monkeypatch):
    for module in [name for name in sys.modules if name.startswith("pgran.figures.")]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.delattr(figures, "style")
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(PgranError, match="pip install matplotlib"):
        figures.make(make_response())


def test_a_file_of_version_1_is_drawn_and_no_pyplot_is_needed():
    code = f"""
import sys, pgran, pgran.figures
assert "matplotlib" not in sys.modules
made = pgran.plot({str(Path(__file__).with_name("version1.h5"))!r})
assert list(made) == ["amplitude", "phase", "bonds"]
assert "matplotlib.figure" in sys.modules
assert "matplotlib.pyplot" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_panel_leaves_the_rest_of_a_figure_alone():
    figure = Figure()
    mine, third, other = figure.subplots(1, 3)
    other.plot([1, 2], [3, 4])
    before = figure.get_children(), other.get_children(), other.get_xlim(), other.get_ylim()
    result = make_response()
    response.amplitude(mine, result.response, result.lattice, modes=[0.4])
    bonds.bonds(third, result.lattice, result.response.detector)
    assert mine.get_lines()
    after = figure.get_children(), other.get_children(), other.get_xlim(), other.get_ylim()
    assert after == before
    assert figure.axes == [mine, third, other]


def test_pages_keep_their_style_and_leave_the_user_s():
    with matplotlib.rc_context({"font.size": 31, "xtick.labelsize": 32}):
        figure = figures.make(make_response([0.5, 0.6]))["phase"]
        figure.draw_without_rendering()
        assert {label.get_fontsize() for label in figure.axes[0].get_xticklabels()} == {7}
        assert matplotlib.rcParams["font.size"] == 31
        ax = draw(make_response([0.5, 0.6]))
        assert ax.xaxis.get_ticklabels()[0].get_fontsize() == 32


# Two results: a response with modes of its lattice


@pytest.fixture
def files(monkeypatch):
    """Results by the names of their files: a response, and modes of its lattice and of others."""
    modes_at = {"omega": [0.4, 0.9, 2.0]}
    shown = {"response.h5": make_response(), "modes.h5": make_modes(**modes_at)}
    shown["doubtful.h5"] = make_modes(**modes_at, certified=False)
    for made in shown.values():
        made.lattice = make_lattice()
    for name, other in (("softer.h5", {"seed": 2}), ("heavier.h5", {"mass": 2.0})):
        shown[name] = make_modes(**modes_at)
        shown[name].lattice = make_lattice(**other)
    monkeypatch.setattr(pgran, "load", shown.get)


@pytest.mark.parametrize(
    ("words", "name"),
    [
        ("response.h5 modes.h5", "response"),
        ("doubtful.h5 response.h5", "response"),
        ("response.h5 -o b.pdf modes.h5", "b"),
    ],
)
def test_modes_are_marked_in_a_response(files, capsys, caplog, monkeypatch, words, name):
    saved = []
    monkeypatch.setattr(figures, "save", lambda made, path: saved.append(made) or [path])
    with caplog.at_level("WARNING", logger="pgran"):
        assert plot(words.split()) == errors.DONE
    assert capsys.readouterr().out.startswith(f"{name}.p")
    assert marks(saved[0]["phase"].axes[0], "+") == pytest.approx([0.4, 0.9])
    assert ("missing or inaccurate" in caplog.text) == ("doubtful" in words)


@pytest.mark.parametrize(
    ("other", "refused"),
    [
        ("response.h5", "not response and response"),
        ("softer.h5", "different lattices"),
        ("heavier.h5", "different lattices"),
    ],
)
def test_two_results_that_are_no_pair(files, other, refused):
    with pytest.raises(FileError, match=refused):
        plot(["response.h5", other])
