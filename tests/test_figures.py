"""The figures show what the result holds: results made by hand, drawn, and read off the axes."""

import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from pgran import figures
from pgran.errors import FileError, PgranError

pytest.importorskip("matplotlib")

from matplotlib.collections import LineCollection

from pgran.figures import bonds, response, style

OMEGA_MX = 2.0
SLOPE, INTERCEPT = -150.0, 5.0


@pytest.fixture(autouse=True)
def _style():
    with style.applied():
        yield


def make_result(x=None, shape=(4, 3), detectors=((1, 1),)):
    """A result whose phase is a straight line, frequencies `x` in units of omega_mx."""
    x = np.linspace(0.005, 1.3, 260) if x is None else np.asarray(x, dtype=float)
    nd, rng = len(detectors), np.random.default_rng(5)
    steeper = SLOPE * np.arange(1, nd + 1)
    kmax = OMEGA_MX**2 / (2 * len(shape))
    lattice = SimpleNamespace(shape=np.array(shape), mass=1.0, damping=0.1, omega_mx=OMEGA_MX)
    for axis in range(len(shape)):
        size = [n + (a == axis) for a, n in enumerate(shape)]
        setattr(lattice, f"stiffness_{'xyz'[axis]}", rng.uniform(0, kmax, size))
    return SimpleNamespace(
        scene="response",
        lattice=lattice,
        response=SimpleNamespace(
            omega=x * OMEGA_MX,
            detector=np.array(detectors),
            amplitude=np.outer(10.0 ** (-8 * x), np.arange(1, nd + 1)),
            phase=np.outer(x, steeper) + INTERCEPT,
            converged_reason=np.ones(len(x), dtype=int),
            phase_slope=steeper,
            phase_intercept=np.full(nd, INTERCEPT),
            phase_velocity=3 / np.abs(steeper),
            phase_fit_min=0.3,
            phase_fit_max=1.0,
        ),
    )


def curves(ax):
    """The lines that are data: not the fits, not the marks."""
    return [line for line in ax.get_lines() if np.ma.isMaskedArray(line.get_ydata(orig=True))]


def marks(ax, marker):
    """Where on the frequency axis there are marks of one kind."""
    found = [line.get_xdata() for line in ax.get_lines() if line.get_marker() == marker]
    return np.concatenate(found) if found else np.array([])


def legend(ax):
    return [text.get_text() for text in ax.get_legend().get_texts()] if ax.get_legend() else []


def bond_lines(figure):
    """The collection of bonds: the one that has values."""
    collections = figure.axes[0].collections
    return next(c for c in collections if c.get_array() is not None)


# Amplitude


def test_upper_limits_of_amplitudes_at_the_floor():
    """In the place of an amplitude that is not known stands what it cannot exceed."""
    result = make_result(detectors=((1, 1), (2, 2)))
    sweep = result.response
    sweep.error_bound = np.full(sweep.amplitude.shape, 1e-3)
    sweep.at_floor = np.zeros(sweep.amplitude.shape, np.int8)
    sweep.at_floor[[30, 31], 1] = 1
    ax = response.draw_amplitude(result).axes[0]
    first, second = curves(ax)
    assert not np.ma.getmaskarray(first.get_ydata(orig=True)).any()
    assert list(np.flatnonzero(np.ma.getmaskarray(second.get_ydata(orig=True)))) == [30, 31]
    (limits,) = [line for line in ax.get_lines() if line.get_marker() == "v"]
    there = np.isfinite(limits.get_ydata())
    assert np.array_equal(np.flatnonzero(there), [30, 31])
    assert np.array_equal(limits.get_ydata()[there], sweep.amplitude[[30, 31], 1] + 1e-3)
    assert legend(ax)[-1] == "upper limit, at the floor"


def test_panels_are_the_three_regimes_on_log_axes():
    panels = response.draw_amplitude(make_result()).axes
    assert [ax.get_yscale() for ax in panels] == ["log"] * 3
    edges = [ax.get_xlim() for ax in panels]
    assert edges[0] == (0.0, 0.3)
    assert edges[1] == (0.3, 1.0)
    assert edges[2][0] == 1.0
    assert 1.3 < edges[2][1] < 1.35
    assert panels[-1].get_xlabel() == response.FREQUENCY


def test_every_point_of_every_detector_is_drawn():
    result = make_result(detectors=[(1, 1), (3, 0)])
    panels = response.draw_amplitude(result).axes
    for d in range(2):
        x = np.concatenate([curves(ax)[d].get_xdata() for ax in panels])
        y = np.concatenate([curves(ax)[d].get_ydata() for ax in panels])
        assert np.array_equal(x, result.response.omega / OMEGA_MX)
        assert np.array_equal(y, result.response.amplitude[:, d])
    assert legend(panels[0]) == ["ball (1, 1)", "ball (3, 0)"]
    assert len({line.get_color() for line in curves(panels[0])}) == 2


@pytest.mark.parametrize(
    ("x", "ranges"),
    [
        (np.linspace(0.4, 0.8, 50), [(0.38, 0.82)]),
        (np.linspace(0.3, 1.0, 50), [(0.3, 1.0)]),
        ([0.3], [(0.3, 0.32)]),
        ([0.6], [(0.58, 0.62)]),
        ([0.2, 0.3, 1.2], [(0.195, 0.3), (1.18, 1.22)]),
        ([1.1, 1.5], [(1.08, 1.52)]),
    ],
)
def test_regimes_without_data_are_left_out(x, ranges):
    panels = response.draw_amplitude(make_result(x)).axes
    assert [ax.get_xlim() for ax in panels] == [pytest.approx(each) for each in ranges]
    assert sum(len(curves(ax)[0].get_xdata()) for ax in panels) == len(x)


def test_failed_points_are_crosses_and_gaps():
    result = make_result()
    failed = [80, 81, 83, 250]
    result.response.converged_reason[failed] = [-3, 0, -1, -9]
    result.response.amplitude[80] = np.nan
    panels = response.draw_amplitude(result).axes
    x = result.response.omega / OMEGA_MX
    assert np.array_equal(np.concatenate([marks(ax, "x") for ax in panels]), x[failed])
    drawn = np.ma.concatenate([curves(ax)[0].get_ydata(orig=True) for ax in panels])
    assert np.array_equal(np.flatnonzero(np.ma.getmaskarray(drawn)), failed)
    assert legend(panels[0]) == ["missed the accuracy asked for"]
    # Point 82 has no good neighbour to be joined with: a dot.
    line = curves(panels[1])[0]
    assert line.get_xdata()[line.get_markevery()] == x[82]


def test_a_sweep_that_failed_altogether_has_no_amplitude_axis(tmp_path):
    result = make_result()
    result.response.converged_reason[:] = -3
    for ax in response.draw_amplitude(result).axes:
        assert not ax.yaxis.get_visible()
        assert marks(ax, "x").size
    assert len(figures.draw(result, tmp_path / "a.png")) == 3


def test_an_amplitude_of_zero_is_no_point_on_a_log_axis():
    result = make_result()
    result.response.amplitude[5] = 0.0
    mask = np.ma.getmaskarray(
        curves(response.draw_amplitude(result).axes[0])[0].get_ydata(orig=True)
    )
    assert np.flatnonzero(mask) == [5]


@pytest.mark.parametrize("figure", [response.draw_amplitude, response.draw_phase])
def test_modes_are_pluses_on_the_frequency_axis(figure):
    modes = np.array([0.1, 0.5, 0.9, 1.2, 7.0])  # the last lies beyond the sweep
    axes = figure(make_result(), modes * OMEGA_MX).axes
    assert np.concatenate([marks(ax, "+") for ax in axes]) == pytest.approx(modes[:-1])
    for ax in axes:
        (pluses,) = (line for line in ax.get_lines() if line.get_marker() == "+")
        drawn = pluses.get_transform().transform(pluses.get_xydata())
        assert drawn[:, 1] == pytest.approx(ax.bbox.y0)
    assert "normal modes" in legend(axes[0])


# Phase


def test_phase_and_its_fit():
    result = make_result(detectors=[(1, 1), (3, 0)])
    result.response.phase += np.random.default_rng(1).normal(size=result.response.phase.shape)
    ax = response.draw_phase(result).axes[0]
    x = result.response.omega / OMEGA_MX
    window = x[(x > 0.3) & (x < 1.0)]
    fits = [line for line in ax.get_lines() if line not in curves(ax)]
    for d, (curve, fit) in enumerate(zip(curves(ax), fits, strict=True)):
        assert np.array_equal(curve.get_ydata(), result.response.phase[:, d])
        assert np.array_equal(fit.get_xdata(), window[[0, -1]])
        expected = result.response.phase_slope[d] * fit.get_xdata() + INTERCEPT
        assert fit.get_ydata() == pytest.approx(expected)
    assert "$-150$ rad" in legend(ax)[0]
    assert "= 0.02 " in legend(ax)[0]
    assert "$-300$ rad" in legend(ax)[1]
    assert "0.3 to 1 " in legend(ax)[2]
    assert "rad" in ax.get_ylabel()


def test_no_fit_is_drawn_where_there_is_none():
    result = make_result([0.2, 0.6])
    result.response.phase_slope[:] = np.nan
    ax = response.draw_phase(result).axes[0]
    assert len(ax.get_lines()) == 1
    assert legend(ax) == ["ball (1, 1)"]


def test_legends_lie_outside_of_the_data():
    for figure in (response.draw_amplitude, response.draw_phase):
        result = make_result(detectors=[(1, 1), (3, 0), (2, 2)])
        result.response.converged_reason[100] = -3
        drawn = figure(result)
        drawn.draw_without_rendering()
        box = drawn.axes[0].get_legend().get_window_extent()
        assert box.y0 >= drawn.axes[0].bbox.y1
        assert box.x0 >= 0
        assert box.y1 <= drawn.bbox.y1


# Bonds


@pytest.mark.parametrize(
    ("shape", "detector", "count"),
    [((6,), (2,), 7), ((4, 3), (1, 1), 31), ((4, 3, 5), (1, 1, 2), 31)],
)
def test_every_bond_is_a_segment_of_its_grey(shape, detector, count):
    result = make_result(shape=shape, detectors=[detector])
    lattice = result.lattice
    lattice.stiffness_x[2] = 0.0
    lattice.stiffness_x[3] = kmax = OMEGA_MX**2 / (2 * len(shape))
    figure = bonds.draw_bonds(lattice, result.response.detector)
    figure.draw_without_rendering()
    lines = bond_lines(figure)
    assert len(lines.get_segments()) == count
    seen = set()
    for ends, grey in zip(lines.get_segments(), lines.get_colors(), strict=True):
        (x0, y0), (x1, y1) = ends
        assert abs(x1 - x0) + abs(y1 - y0) == 1
        along_x = y0 == y1
        k = lattice.stiffness_x if along_x else lattice.stiffness_y
        where = (int(max(x0, x1)), int(max(y0, y1)), *detector[2:])
        value = k[where[: len(shape)] if len(shape) > 1 else where[0]]
        assert grey[:3] == pytest.approx(np.full(3, 1 - value / kmax), abs=1 / 256)
        seen.add((along_x, where))
    assert len(seen) == count
    title = figure._suptitle
    assert (title is None) == (len(shape) < 3)
    assert title is None or "z = 2" in title.get_text()


def test_bonds_do_not_leave_the_walls():
    ends, _ = bonds.bond_segments([np.zeros((5, 3)), np.zeros((4, 4))])
    assert np.array_equal(ends.min(axis=(0, 1)), [-1, -1])
    assert np.array_equal(ends.max(axis=(0, 1)), [4, 3])


def test_detectors_and_driven_wall():
    result = make_result(shape=(4, 3, 5), detectors=[(1, 2, 2), (3, 0, 2), (0, 0, 4)])
    ax = bonds.draw_bonds(result.lattice, result.response.detector).axes[0]
    dots = [line for line in ax.get_lines() if line.get_marker() == "o"]
    assert [(*line.get_xdata(), *line.get_ydata()) for line in dots] == [(1, 2), (3, 0)]
    (wall,) = (line for line in ax.get_lines() if line.get_marker() == "None")
    assert np.array_equal(wall.get_xdata(), [4, 4])
    assert legend(ax) == ["ball (1, 2, 2)", "ball (3, 0, 2)", "driven wall"]
    assert set(ax.get_xticks()) <= set(range(4))


@pytest.mark.parametrize("shape", [(70, 70), (70, 70, 2), (9000,)])
def test_a_large_lattice_is_an_image_of_means(shape):
    result = make_result(shape=shape, detectors=[(3, 4, 1)[: len(shape)]])
    ax = bonds.draw_bonds(result.lattice, result.response.detector).axes[0]
    assert not [c for c in ax.collections if c.get_array() is not None]
    (image,) = ax.images
    ball = (5, 6, 1)[: len(shape)]
    expected = 0.0
    for axis in range(len(shape)):
        k = getattr(result.lattice, f"stiffness_{'xyz'[axis]}")
        above = tuple(n + (a == axis) for a, n in enumerate(ball))
        expected += (k[ball] + k[above]) / (2 * len(shape))
    row = ball[1] if len(shape) > 1 else 0
    assert image.get_array()[row, 5] == pytest.approx(expected)
    assert image.norm.vmax == pytest.approx(OMEGA_MX**2 / (2 * len(shape)))


def test_walls_are_lines_around_the_lattice():
    result = make_result(shape=(4, 3))
    ax = bonds.draw_bonds(result.lattice, result.response.detector).axes[0]
    (walls,) = (
        c for c in ax.collections if isinstance(c, LineCollection) and c.get_array() is None
    )
    sides = {tuple(map(tuple, side)) for side in walls.get_segments()}
    assert sides == {((-1, -1), (-1, 3)), ((-1, -1), (4, -1)), ((-1, 3), (4, 3))}


# Files


@pytest.mark.parametrize("ending", ["png", "pdf", "svg", "PNG"])
def test_draw_writes_one_file_a_figure(tmp_path, ending):
    written = figures.draw(make_result(), tmp_path / "new" / f"my.run.{ending}", modes=[0.4, 0.8])
    names = ["my.run-amplitude", "my.run-phase", "my.run-bonds"]
    assert written == [tmp_path / "new" / f"{name}.{ending}" for name in names]
    begin = {"png": b"\x89PNG", "pdf": b"%PDF", "svg": b"<?xml"}[ending.lower()]
    assert all(path.read_bytes().startswith(begin) for path in written)


@pytest.mark.parametrize("name", ["figure", "figure.h5", "figure.", "figure.pgf"])
def test_an_ending_that_is_no_figure(tmp_path, name):
    with pytest.raises(FileError, match=r"ends in one of .*\.pdf, .*\.png"):
        figures.draw(make_result(), tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_written_to(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(FileError, match=r"file.a-amplitude\.png: cannot be written"):
        figures.draw(make_result(), tmp_path / "file" / "a.png")


def test_nothing_to_draw(tmp_path):
    result = make_result()
    del result.response
    with pytest.raises(FileError, match=r"nothing to draw in this result .scene response"):
        figures.draw(result, tmp_path / "a.png")
    with pytest.raises(FileError, match="no frequencies"):
        figures.draw(make_result([]), tmp_path / "a.png")


@pytest.mark.parametrize(
    ("group", "name"), [("response", "phase"), ("lattice", "omega_mx"), ("lattice", "stiffness_y")]
)
def test_an_incomplete_result(tmp_path, group, name):
    result = make_result()
    delattr(getattr(result, group), name)
    with pytest.raises(FileError, match=f"{group}/{name} is missing"):
        figures.draw(result, tmp_path / "a.png")


def test_bonds_that_are_all_zero_give_no_unit_of_frequency(tmp_path):
    result = make_result()
    result.lattice.omega_mx = 0.0
    with pytest.raises(FileError, match="omega_mx is 0"):
        figures.draw(result, tmp_path / "a.png")


def test_without_matplotlib(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(PgranError, match="pip install matplotlib"):
        figures.draw(make_result(), tmp_path / "a.png")


def test_matplotlib_waits_until_something_is_drawn():
    code = "import sys, pgran, pgran.figures; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_the_style_is_undone(tmp_path):
    import matplotlib

    matplotlib.rcParams["font.size"] = 31
    figures.draw(make_result([0.5, 0.6]), tmp_path / "a.png")
    assert matplotlib.rcParams["font.size"] == 31
