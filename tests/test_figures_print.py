"""Figures as they are printed: a column wide, or two, in grey, with captions."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from figure_reading import curves, draw, labels, lines, marks, note, page_of, rows_of
from figure_results import (
    SWEEP,
    UNIT,
    compare,
    count_modes,
    diffusing,
    ensemble,
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
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.markers import TICKUP
from samples import random_lattice

import pgran
from pgran.draw import bonds, scales, style, view
from pgran.draw import pages as figures
from pgran.draw.marks import points as errorbars
from pgran.experiments.modes import figures as modes
from pgran.experiments.response import figures as response
from pgran.medium.base import record_of
from pgran.medium.crystals import crystal

FINE = np.linspace(0.1, 1.1, 201)
LARGER = random_lattice((12, 11), seed=5, mass=0.25)
CUBE = random_lattice((4, 3, 5), seed=5, mass=0.25)


def sensitivity():
    found = pgran.sensitivity(LARGER, UNIT * np.array([0.3, 0.6, 0.9]), [(4, 5)])
    result = result_of(found, LARGER)
    omegas = UNIT * np.linspace(0.2, 0.9, 4)
    result.heat = pgran.heat(LARGER, omegas, [(4, 5)], factor=1.1, cut=True)
    return result


def network():
    """Modes of a network, and its response at two balls."""
    net = crystal("triangular", (4, 3), periodic=(False, True))
    result = result_of(pgran.find_modes(net, shapes=True), net)
    omegas, balls = np.linspace(0.1, 1.5, 201) * net.omega_mx, net.free[:2]
    result.response = pgran.sweep(net, omegas, balls, method="points")
    return result


def waves():
    net = crystal("triangular", (6, 4), periodic=True, box=[6, 4 * 3**0.5])
    return result_of(pgran.structure(net, 5, np.linspace(0.05, 2.5, 40)), net)


def bare_signals():
    unknown = dict.fromkeys(["energy", "dissipated", "field_time", "field"])
    return result_of(replace(listen().pulse, **unknown))


# results, and which figures they have; of those in CROWDED the texts on paper are looked at
SCENES = {
    "response": (lambda: respond(lattice=LARGER, detectors=[(4, 5), (8, 5)]),
                 "amplitude phase delay wall bonds"),
    "continuum": (respond_box, "exactpl"),
    "modes": (lambda: find_modes((12, 11)), "shapes speeds participation density reduced"),
    "chain": (lambda: find_modes((30,)), "shapes speeds participation density reduced"),
    "damped": (lambda: find_modes((6, 5), damped=True, detectors=[(1, 1), (3, 0)]),
               "widths swings residues"),
    "resonances": (lambda: find_modes((4, 3), detectors=[(1, 1), (3, 0)]),
                   "shapes speeds participation resonances"),
    "few modes": (lambda: find_modes((2, 1)), "shapes"),
    "density": (count_modes, "staircase density reduced"),
    "estimates": (lambda: count_modes(
        LARGER, method="moments", vectors=99, moments=12, diffusivity="x"
    ), "staircase density reduced diffusivity"),
    "few frequencies": (lambda: project([0.5, 0.6, 0.7], (2, 2)), "onefreq"),
    "dominant": (lambda: project(FINE, (6, 5)), "maxci"),
    "single modes": (lambda: project(FINE, (3, 1)), "cifreq"),
    "relaxation": (relax, "timeres"),
    "pulse": (lambda: listen([(1, 1, 2), (3, 0, 2)], CUBE, method="laplace"),
              "signals field energy spectrum bonds"),
    "bare signals": (bare_signals, "signals spectrum bonds"),
    "sensitivity": (sensitivity, "warmed cut changes sensitivity flux distribution bonds"),
    "many balls": (lambda: respond(lattice=LARGER, detectors=[(n, 5) for n in range(12)]),
                   "amplitude phase delay wall bonds"),
    "green": (lambda: result_of(pgran.green(LARGER, UNIT * SWEEP[::9], [(4, 5), (8, 5)]), LARGER),
              "green"),
    "network": (network, "shapes speeds participation density reduced network amplitude phase "
                         "delay wall"),
    "loud": (shout, "harmonics parts claps network"),
    "loud frequencies": (lean, "resonance"),
    "structure": (waves, "network structure dispersion"),
    "ensemble": (ensemble, "amplitude delay velocity intensity transport"),
    "diffusion": (diffusing, "diffusion"),
    "accuracy": (lambda: compare([1e-3, 1e-5, 1e-4, 1e-6]), "front"),
    "one configuration": (lambda: compare([1e-3]), "front"),
    "equally accurate": (lambda: compare([1e-9, 2e-9, 1.5e-9]), "front"),
}  # fmt: skip
CROWDED = (
    *("response", "continuum", "modes", "damped", "density", "single modes", "relaxation"),
    *("pulse", "sensitivity", "green", "network", "structure", "ensemble", "equally accurate"),
    *("loud", "loud frequencies"),
)


@pytest.mark.parametrize("scene", SCENES)
def test_nothing_overlaps_on_paper(scene):
    """Texts are apart, within the figure, and 7 or 8 points high; the legend is a small part.

    Axes end where data do; several panels have letters. What is shown depends on what there is.
    """
    result = SCENES[scene][0]()
    over = {"modes": UNIT * np.linspace(0.1, 1.2, 300)} if result.scene == "response" else {}
    made = figures.make(result, width=85, **over)
    assert list(made) == SCENES[scene][1].split()
    for name, figure in made.items():
        assert figure.get_figwidth() == pytest.approx(85 / 25.4)
        assert "NOT" not in note(figure)
        _check_panels(figure)
        _check_legends(figure)
        if scene in CROWDED:
            _check_texts(name, figure)


def test_results_over_each_other_on_two_columns():
    names = [f"-lattice_damping {beta}" for beta in (0.001, 0.003, 0.01)]
    for shown in ([respond()] * 3, [find_modes((6, 5))] * 3):
        for name, figure in figures.compare(shown, names, width=170).items():
            _check_texts(name, figure, part=0.2)


def _check_texts(name, figure, part=0.15):
    seen, paper = texts(figure), figure.bbox.padded(1.5)
    for text, box in seen:
        assert paper.contains(*box.min), (name, text)
        assert paper.contains(*box.max), (name, text)
    for (one, box), (other, beside) in combinations(seen, 2):
        shared = box.padded(-1).intersection(box.padded(-1), beside.padded(-1))
        assert shared is None or min(shared.size) <= 0, (name, one, other)
    for ax in figure.axes:
        if ax.get_legend() and name != "network":  # which explains its symbols
            box = ax.get_legend().get_window_extent()
            assert box.width * box.height < part * figure.bbox.width * figure.bbox.height
        sizes = {tick.label1.get_size() for tick in ax.xaxis.get_major_ticks()}
        assert sizes | {ax.xaxis.label.get_size(), ax._left_title.get_size()} <= {7, 8}


def texts(figure):
    """The texts of a figure that are seen, each with its box on paper."""
    figure.draw_without_rendering()
    shown = list(figure.texts)
    for ax in (ax for ax in figure.axes if ax.axison):
        shown += [ax.title, ax._left_title, ax._right_title, *ax.texts]
        if ax.get_legend():
            shown += ax.get_legend().get_texts()
        for axis in (ax.xaxis, ax.yaxis):
            if axis.get_visible():
                ticks = axis._update_ticks()
                shown += [axis.label, axis.offsetText, *(tick.label1 for tick in ticks)]
    with style.applied():
        seen = [text for text in shown if text.get_visible() and text.get_text().strip()]
        return [(text.get_text(), text.get_window_extent()) for text in seen]


def _check_panels(figure):
    for ax in figure.panels:
        data = [line.get_xdata() for line in curves(ax) if line.get_linestyle() != "None"]
        if data and len(data[0]) > style.HANDFUL and "time" not in ax.get_xlabel():
            every = np.concatenate(data)
            assert every.min() <= ax.get_xlim()[0] < ax.get_xlim()[1] <= every.max()
    titles = [ax.get_title(loc="left") for ax in figure.panels]
    letters = [f"({n})" for n in style.PANEL_LETTERS[: len(titles)]]
    assert (len(titles) == 1) == (not titles[0].startswith("(a)"))
    assert len(titles) == 1 or [title[:3] for title in titles] == letters
    said = [letter for letter in letters if letter in figure.caption]
    assert said in ([], letters)
    assert figure.caption[0] in "(ABCDEFGHIJKLMNOPQRSTUVWXYZ"
    assert figure.caption.endswith(".")


def _check_legends(figure):
    """Two rows, balls in their order; there, above the panels or in the caption is each name."""
    told = f"{figure.caption} {note(figure)} negative detector driven wall"
    names = [name for ax in figure.panels for name in labels(ax)]
    for rows in [rows_of(ax.get_legend()) for ax in figure.axes if ax.get_legend()]:
        listed = [name for row in rows for name in row]
        balls = [name for name in listed if name.startswith("ball (")]
        assert len(rows) <= style.LEGEND_ROWS
        assert balls == list(dict.fromkeys(name for name in names if name in balls))
        told += " ".join(listed)
    assert [name for name in names if name not in told] == []


def test_marks_of_modes_can_be_told_apart_or_are_a_density():
    result = respond()
    few, many = UNIT * np.linspace(0.2, 1.1, 40), UNIT * np.linspace(0.2, 1.1, 900)
    ax = draw(response.phase, result.response, result.lattice, few)
    assert marks(ax, TICKUP) == pytest.approx(few / UNIT)
    ax = draw(response.phase, result.response, result.lattice, many)
    assert not marks(ax, TICKUP)
    assert labels(ax)[-1] == "density of normal modes"
    (filled,) = (x for x in ax.collections if isinstance(x, PolyCollection))
    x, height = filled.get_paths()[0].vertices.T
    assert height.max() == pytest.approx(0.1)  # of the panel
    assert 0.15 < x[height > 0].min() < x[height > 0].max() < 1.15
    (unit,) = (line for line in ax.get_lines() if list(line.get_xdata()) == [1, 1])
    assert unit.get_linestyle() != "-"


@pytest.mark.parametrize(("low", "high"), [(0.2, 0.9), (0.3, 20.0), (3.0, 4.0), (0.6, 3e5)])
def test_a_logarithmic_axis_has_numbers(low, high):
    """Two at least, also where it holds no power of ten."""
    figure = Figure()
    ax = figure.subplots()
    ax.set(yscale="log", ylim=(low, high))
    scales.finish(figure)
    seen = [y for y in ax.get_yticks() if low <= y <= high]
    assert 2 <= len(seen) <= 9
    assert all(ax.yaxis.get_major_formatter().format_ticks(seen))
    ticks = scales.symmetric_ticks(low, high)
    assert len(ticks) >= 3
    assert all(low <= tick <= high for tick in ticks if tick > 0)


def test_few_points_that_are_no_curve_are_points():
    assert all(len(page.panels) for page in figures.make(project([0.5], (2, 1))).values())
    (ax,) = page_of(respond([0.2, 0.5, 0.6, 1.1]), "amplitude").axes  # one panel, points inside
    assert ax.get_xlim() == pytest.approx((0.155, 1.145))
    few, whole = respond(SWEEP[::20]), respond()
    for result, resolved, joined in ((few, 1, 1), (few, 0, 0), (whole, 0, 1)):
        result.response.line_error[1:] = 1.0 - resolved
        for panel in (response.amplitude, response.phase, response.force, response.power):
            (line,) = curves(draw(panel, result.response, result.lattice))
            assert line.get_linestyle() == ("-" if joined else "None")
            assert joined or line.get_marker() == "."


def test_signs_are_seen_in_grey_and_a_wall_is_marked_where_it_is_driven():
    """Numbers are the darker the larger they are, negative ones more, and these have bars."""
    grey = style.SIGNED(np.linspace(0, 1, 101))[:, :3] @ [0.299, 0.587, 0.114]
    assert np.all(np.diff(grey[:51]) > 0)
    assert np.all(np.diff(grey[50:]) < 0)
    assert np.all((grey[::-1] - grey)[:25] > 0.1)
    found = find_modes((6, 5))
    ax = draw(modes.shape, found.modes, found.lattice, 3)
    assert not lines(ax, color=style.DRIVEN)  # walls are at rest
    assert ax.images[0].get_cmap() is style.SIGNED
    (bars,) = lines(ax, label="negative")
    shown = np.argwhere(ax.images[0].get_array().T < -view.BARRED)
    assert np.array_equal(np.transpose(bars.get_data()), shown)
    (wall,) = lines(page_of(listen(), "field").panels[0], color=style.DRIVEN)
    assert list(wall.get_xdata()) == [3.5, 3.5]


@pytest.mark.parametrize(("shape", "count"), [((6,), 1), ((4, 3), 3), ((4, 3, 5), 3)])
def test_walls_at_rest_are_hatched_and_no_bonds(shape, count):
    shown = record_of(random_lattice(shape))
    ax = draw(bonds.bonds, shown, np.zeros((1, len(shape)), dtype=int))
    walls = [patch for patch in ax.patches if patch.get_hatch()]
    assert len(walls) == count
    (left, right), (low, high) = ax.get_xlim(), ax.get_ylim()
    assert right == shape[0]
    for wall in walls:  # outside of all bonds, within the panel
        x, y, (width, height) = *wall.get_xy(), (wall.get_width(), wall.get_height())
        assert x + width < -0.99 or y + height < -0.99 or y >= shape[1]
        assert left - 1e-9 <= x < x + width <= right + 1e-9
        assert low - 1e-9 <= y < y + height <= high + 1e-9


@pytest.mark.filterwarnings("error")
def test_rows_of_which_nothing_is_known_are_empty():
    values = np.array([[np.nan, np.nan], [1.0, np.nan]])
    drawn = draw(errorbars, [1.0, 2.0], values, 0 * values, "ab", xerr=0.1).containers
    assert [len(row.lines[0].get_xdata()) for row in drawn] == [0, 2]
