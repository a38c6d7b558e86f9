"""Figures of responses and of lattices, read off the axes, and the command that saves figures."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from figure_reading import curves, draw, gaps, labels, legend, lines, marks, page_of, saving
from figure_results import SWEEP, UNIT, find_modes, listen, project, respond, result_of
from matplotlib.figure import Figure
from matplotlib.markers import TICKUP
from result_samples import no_room_beyond
from samples import random_lattice

import pgran
from pgran import errors
from pgran.command.plot import run as plot
from pgran.draw import bonds, style
from pgran.draw import pages as figures
from pgran.errors import FileError, InputError
from pgran.experiments.response import figures as response
from pgran.medium.record import LatticeRecord
from pgran.store.estimate import with_error


def test_the_regimes_hold_every_point_of_every_detector():
    result = respond(detectors=[(1, 1), (3, 0)])
    result.response.at_floor[[70, 71], 1] = 1
    figure = page_of(result, "amplitude", modes=UNIT * np.array([0.1, 0.5, 7.0]))
    panels = figure.axes
    assert [ax.get_yscale() for ax in panels] == ["log"] * 3
    assert [ax.get_xlim() for ax in panels] == [(0.005, 0.3), (0.3, 1.0), (1.0, 1.3)]
    for d in range(2):
        seen = [curves(ax)[d] for ax in panels]
        assert seen[0].get_xdata() == pytest.approx(SWEEP)
        assert np.array_equal(seen[0].get_ydata(orig=True).data, result.response.amplitude[:, d])
        assert sum(260 - len(gaps(line)) for line in seen) == 260 - 2 * d
    (limits,) = lines(panels[1], marker="v")
    assert list(np.flatnonzero(np.isfinite(limits.get_ydata()))) == [70, 71]
    assert [marks(ax, TICKUP) for ax in panels] == [pytest.approx([0.1]), pytest.approx([0.5]), []]
    names = ["ball (1, 1)", "ball (3, 0)", "upper limit, at the floor", "normal modes"]
    assert legend(figure) == names


def test_where_the_curve_is_not_resolved():
    """A tick at the middle of each straight line that is wrong."""
    result = respond()
    result.response.line_error[[81, 120]] = [[0.02], [np.inf]]
    for panel in (response.amplitude, response.phase, response.delay):
        ax = draw(panel, result.response, result.lattice)
        middle = 0.5 * (SWEEP[[80, 119]] + SWEEP[[81, 120]])
        assert marks(ax, "|") == pytest.approx(middle)
        assert labels(ax)[-1] == "curve not resolved"


def test_delays_have_a_panel_a_detector_and_a_band_where_the_axis_is_linear():
    balls = [(1, 1), (3, 0)]
    for ax, ball in zip(page_of(respond(detectors=balls), "delay").panels, balls, strict=True):
        assert ax.get_title(loc="left") == f"ball {ball}"
        ends = ax.transData.inverted().transform(ax.patches[0].get_window_extent())[:, 1]
        linear = ax.yaxis.get_transform().linthresh
        assert ends == pytest.approx([-linear, linear])


def test_the_force_of_the_wall_and_its_power():
    """Gaps where a bound is no small part of it; no power without damping; None in older files."""
    result = respond()
    shown = result.response
    shown.force_bound[[100, 101]] = np.abs(shown.force[[100, 101]]) * [0.02, np.nan]
    panels = page_of(result, "wall", modes=UNIT * np.array([0.1])).axes
    assert [marks(ax, TICKUP) for ax in panels] == [pytest.approx([0.1])] * 3
    assert [gaps(curves(ax)[0])[0] for ax in panels[:2]] == [100] * 2
    assert 101 in gaps(curves(panels[2])[0])
    undamped = figures.make(respond(lattice=random_lattice((4, 3), damping=0.0)))
    assert set(undamped) == {"amplitude", "phase", "wall", "bonds"}
    assert len(undamped["wall"].axes) == 2
    older = replace(shown, force=None, force_bound=None, power=None)
    assert "wall" not in figures.make(result_of(older))
    shown.force_bound[:] = np.inf
    assert "wall" not in figures.make(result)


def test_phase_and_its_fit():
    lattice = random_lattice((4, 3), seed=20, mass=0.25)  # whose phases are lines
    result = respond(detectors=[(1, 1), (3, 0)], lattice=lattice)
    shown = result.response
    ax = draw(response.phase, shown, result.lattice)
    ends = SWEEP[(SWEEP > 0.299) & (SWEEP < 1.001)][[0, -1]]
    for d, fit in enumerate(lines(ax, linewidth=3)):
        assert fit.get_xdata() == pytest.approx(ends)
        assert fit.get_ydata() == pytest.approx(
            shown.phase_slope[d] * ends + shown.phase_intercept[d]
        )
        number = with_error(shown.phase_velocity[d], shown.phase_velocity_error[d])
        assert number.replace("+-", r"\pm") in figures.make(result)["phase"].caption
    newer = ("phase_used_min", "phase_used_max", "phase_slope_error", "phase_velocity_error")
    older = replace(shown, **dict.fromkeys(newer))
    ends = SWEEP[(SWEEP > 0.3) & (SWEEP < 1.0)][[0, -1]]
    for fit in lines(draw(response.phase, older, result.lattice), linewidth=3):
        assert fit.get_xdata() == pytest.approx(ends)
    shown.phase_slope[:] = np.nan
    assert labels(draw(response.phase, shown, result.lattice)) == ["ball (1, 1)", "ball (3, 0)"]


@pytest.mark.parametrize(
    ("shape", "detector", "count"),
    [((6,), (2,), 7), ((4, 3), (1, 1), 31), ((4, 3, 5), (1, 1, 2), 31)],
)
def test_every_bond_is_a_segment_of_its_grey(shape, detector, count):
    lattice = LatticeRecord.of(random_lattice(shape))
    with style.applied():
        figure = bonds.page(lattice, [detector, (0,) * len(shape)])
    figure.draw_without_rendering()
    (drawn,) = (c for c in figure.axes[0].collections if c.get_array() is not None)
    seen = set()
    for ends, grey in zip(drawn.get_segments(), drawn.get_colors(), strict=True):
        (x0, y0), (x1, y1) = ends
        assert abs(x1 - x0) + abs(y1 - y0) == 1
        k = lattice.stiffness_x if y0 == y1 else lattice.stiffness_y
        where = (int(max(x0, x1)), int(max(y0, y1)), *detector[2:])[: len(shape)]
        assert grey[:3] == pytest.approx(np.full(3, 1 - k[where] / 0.25), abs=1 / 256)
        seen.add((y0 == y1, where))
    assert len(seen) == len(drawn.get_segments()) == count
    dots = lines(figure.axes[0], marker="o")
    every = [dot for dot in dots if dot.get_markerfacecolor() == "white"]
    assert len(dots) - len(every) == 1 + (len(shape) < 3)  # detectors in the plane
    if len(shape) > 1:  # so small that all balls are drawn
        (balls,) = every
        assert set(zip(*balls.get_data(), strict=True)) == set(np.ndindex(shape[:2]))
    assert ("$z$ = 2" in figure.axes[0].get_title(loc="left")) == (len(shape) == 3)


@pytest.mark.parametrize("part", [1e-6, 0.6, 1.9, 1e6])
def test_bonds_are_seen_whatever_kmax_is(part):
    lattice = random_lattice((6, 5))
    record = LatticeRecord.of(replace(lattice, kmax=lattice.stiffest / part))
    (drawn,) = draw(bonds.bonds, record, [(1, 1)]).collections[:1]
    top = lattice.stiffest / part if 0.5 < part < 2 else lattice.stiffest
    assert drawn.norm.vmax == pytest.approx(top)


@pytest.mark.parametrize("shape", [(70, 70, 2), (9000,)])
def test_a_large_lattice_is_an_image_of_means(shape):
    lattice, ball = random_lattice(shape), (5, 6, 1)[: len(shape)]
    (image,) = draw(bonds.bonds, LatticeRecord.of(lattice), [ball]).images
    above = [tuple(n + (a == axis) for a, n in enumerate(ball)) for axis in range(len(shape))]
    mean = np.mean([[k[ball], k[up]] for k, up in zip(lattice.stiffness, above, strict=True)])
    assert image.get_array()[(*ball[1:2], 0)[0], 5] == pytest.approx(mean)


def test_plot_saves_one_file_a_figure(tmp_path):
    for ending, begin in (("PNG", b"\x89PNG"), ("pdf", b"%PDF")):
        made = pgran.plot(project([0.5]), tmp_path / "new" / f"my.run.{ending}")
        assert list(made) == ["onefreq"]
        written = tmp_path / "new" / f"my.run-onefreq.{ending}"
        assert written.read_bytes().startswith(begin)


@pytest.mark.parametrize("name", ["figure", "figure.h5", "figure.pgf", "file/a.png"])
def test_names_that_no_figure_can_have(tmp_path, name):
    (tmp_path / "file").touch()
    refused = r"a-onefreq\.png: cannot be written" if "file" in name else r"one of .*, \.png"
    with pytest.raises(FileError, match=refused):
        pgran.plot(project([0.5]), tmp_path / name)


def test_nothing_to_draw():
    result = respond([0.5])
    with pytest.raises(FileError, match=r"nothing to draw in this result .scene response"):
        figures.make(SimpleNamespace(scene=result.scene, lattice=result.lattice))
    result.medium = replace(result.medium, omega_mx=0.0)
    with pytest.raises(FileError, match="omega_mx is 0"):
        figures.make(result)


def test_a_file_of_version_1_is_drawn_and_no_pyplot_is_needed():
    code = f"""
import sys, pgran, pgran.draw.pages
assert "matplotlib" not in sys.modules
made = pgran.plot({str(Path(__file__).with_name("version1.h5"))!r})
assert list(made) == ["amplitude", "phase", "bonds"]
assert "matplotlib.figure" in sys.modules
assert "matplotlib.pyplot" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", code], check=True)


def test_panels_leave_the_rest_of_a_figure_alone():
    result, figure = respond([0.5, 0.6]), Figure()
    mine, other = figure.subplots(1, 2)
    before = figure.get_children(), other.get_children()
    response.amplitude(mine, result.response, result.lattice, modes=[1.1])
    assert (figure.get_children(), other.get_children()) == before


@pytest.fixture
def files(monkeypatch):
    """Results by the names of their files: a response, and modes of its lattice and of others."""
    found = find_modes()
    doubtful = result_of(replace(found.modes, count_certified=False))
    shown = {"response.h5": respond(), "modes.h5": found, "doubtful.h5": doubtful}
    shown["pulse.h5"] = listen()
    for name, other in (("softer.h5", {"seed": 2}), ("heavier.h5", {"seed": 5, "mass": 2.0})):
        shown[name] = result_of(found.modes, random_lattice((4, 3), **{"mass": 0.25} | other))
    monkeypatch.setattr(pgran, "load", shown.get)
    return shown


@pytest.mark.parametrize(
    ("words", "written"),
    [
        ("doubtful.h5 response.h5", "response.png"),
        ("response.h5 -o b.pdf modes.h5", "b.pdf"),
        ("pulse.h5 response.h5", "pulse.png"),
        ("response.h5 pulse.h5", "pulse.png"),
    ],
)
def test_results_that_belong_together(files, capsys, caplog, monkeypatch, words, written):
    """In either order: modes are marked in a response, which is laid over spectra of a pulse."""
    saved = saving(monkeypatch)
    with caplog.at_level("WARNING", logger="pgran"):
        assert plot(words.split()) == errors.DONE
    assert capsys.readouterr().out == f"{written}\n"
    if "pulse" in words:
        (steady,) = lines(saved[0]["spectrum"].axes[0], linewidth=2.5)
        amplitude = files["response.h5"].response.amplitude[:, 0]
        assert np.array_equal(steady.get_ydata(orig=True).data, amplitude)
    else:
        x = files["modes.h5"].modes.omega / UNIT
        assert marks(saved[0]["phase"].axes[0], TICKUP) == pytest.approx(x[x < 1.3])
    assert ("missing or inaccurate" in caplog.text) == ("doubtful" in words)


@pytest.mark.parametrize("ending", ["png", "pdf"])
@pytest.mark.parametrize("room", [0, 2000])
def test_no_room_for_a_figure(tmp_path, ending, room):
    """One error, no file of no bytes, and what was there stays, the caption, too."""
    figure = Figure()
    figure.subplots().plot(np.random.default_rng(1).random(400))
    path = tmp_path / f"a-phase.{ending}"
    path.write_bytes(b"earlier")
    figure.caption = "long" * 1000
    with no_room_beyond(room, path.name):
        figures.save({"phase": figure}, tmp_path / f"a.{ending}")
    with no_room_beyond(room, r"a-phase\.txt"):
        figures.save_captions({"phase": figure}, [tmp_path / "a-phase.txt"])
    assert path.read_bytes() == b"earlier"
    assert [*tmp_path.iterdir()] == [path]


def test_two_results_that_are_no_pair(files):
    for other in ("softer.h5", "heavier.h5"):
        with pytest.raises(FileError, match="different lattices"):
            plot(["response.h5", other])
    with pytest.raises(InputError, match="the same result is given twice"):
        plot(["response.h5", "response.h5"])
    for words in (["pulse.h5", "modes.h5"], ["response.h5", "modes.h5", "pulse.h5"]):
        with pytest.raises(FileError, match="but results of one scene, or response and modes or"):
            plot(words)
    for other in ({"seed": 2}, {"seed": 5, "damping": 0.01}):
        files["response.h5"] = respond([0.5], lattice=random_lattice((4, 3), mass=0.25, **other))
        with pytest.raises(FileError, match="the pulse and the response belong to different latt"):
            plot(["response.h5", "pulse.h5"])
