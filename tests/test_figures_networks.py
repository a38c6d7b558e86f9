"""Figures of networks, read off the axes."""

from dataclasses import replace

import numpy as np
import pytest
from figure_reading import draw, labels, legend, lines, note, page_of, saving
from figure_results import result_of
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.quiver import Quiver

import pgran
from pgran.command.plot import run as plot
from pgran.draw import balls, network, style
from pgran.draw import pages as figures
from pgran.draw.view import FACES, View
from pgran.errors import FileError
from pgran.experiments.modes import figures as modes
from pgran.experiments.pulse import figures as pulse
from pgran.experiments.response import figures as response
from pgran.medium.base import record_of
from pgran.medium.crystals import crystal
from pgran.medium.network_file import write_network
from pgran.medium.space import reaches

HEIGHT = 3 * np.sqrt(3)  # of the periodic strip


def strip(displacement="vector", **others):
    """A strip of discs, periodic across, with forces and masses at random, one force attractive."""
    net = crystal("triangular", (4, 3), periodic=(False, True))
    rng = np.random.default_rng(3)
    force = rng.uniform(0.01, 0.1, len(net.bond))
    force[5] *= -1
    masses = rng.uniform(0.5, 2.0, len(net.held))
    radius = np.full(len(net.held), 0.5)
    made = {"force": force, "masses": masses, "radius": radius, "displacement": displacement}
    return replace(net, kmax=None, median_mass=None, **made | others)


def gas(direction):
    """Spheres of several sizes at random, chained by contacts."""
    rng = np.random.default_rng(1)
    position, radius = rng.uniform(0, 4, (40, 3)), rng.uniform(0.2, 0.6, 40)
    bond = np.stack([np.arange(39), np.arange(1, 40)], axis=1)
    held = np.zeros(40, dtype=int)
    held[[0, -1]] = 1, 2
    kind = {"displacement": "vector", "position": position, "radius": radius}
    return pgran.Network(bond, np.ones(39), held, direction=direction, **kind)


def of_kind(ax, kind):
    return [child for child in ax.get_children() if isinstance(child, kind)]


def circles(ax):
    """Centres and radii of the balls."""
    (drawn,) = of_kind(ax, EllipseCollection)
    drawn._set_transforms()  # in units of the axes, wherever these lie
    return drawn, np.asarray(drawn.get_offsets()), drawn.get_transforms()[:, 0, 0]


def listen(net, heard, **sent):
    sent = {"width": 3.0, "omega": 0.5, "time": 60.0, "points": 201, "fields": True} | sent
    return result_of(pgran.pulse(net, heard, method="laplace", **sent), net)


def sweep(net, heard):
    return result_of(pgran.sweep(net, np.linspace(0.1, 1.5, 9), heard, method="points"), net)


def test_contacts_are_lines_as_wide_as_their_force_and_stubs_at_the_ends_of_the_box():
    net = strip()
    ax = draw(network.contacts, record_of(net), list(net.free[:2]))
    (drawn,) = of_kind(ax, LineCollection)
    segments, widths = np.array(drawn.get_segments()), np.array(drawn.get_linewidths())
    ends, count = net.position[net.bond], len(net.bond)
    wraps = np.abs(ends[:, 1, 1] - ends[:, 0, 1]) > HEIGHT / 2
    assert 0 < np.count_nonzero(wraps) == len(segments) - count < count
    assert segments[:count][~wraps] == pytest.approx(ends[~wraps])
    first, second = segments[:count][wraps], segments[count:]
    assert first[:, 0] == pytest.approx(ends[wraps, 0])
    assert second[:, 1] == pytest.approx(ends[wraps, 1])
    apart = first[:, 1] - second[:, 0]  # the halves meet in the middle, a period away
    assert np.abs(apart) == pytest.approx(np.tile([0, HEIGHT], (len(apart), 1)), abs=1e-12)
    for stubs in (first, second):
        assert np.linalg.norm(stubs[:, 1] - stubs[:, 0], axis=1) == pytest.approx(0.5)
    force = np.append(net.force, net.force[wraps])
    assert widths / widths.max() == pytest.approx(np.abs(force) / np.abs(force).max())
    orange = (drawn.get_colors()[:, :3] == to_rgb(style.UNRESOLVED)).all(axis=1)
    assert np.array_equal(orange, force < 0)
    assert {f"force up to {np.abs(net.force).max():.3g}", "negative force"} <= set(labels(ax))
    marks = [line.get_marker() for line in ax.get_lines() if "ball" in line.get_label()]
    assert len(marks) == len(set(marks)) == 2  # which a print in grey keeps


def test_balls_are_circles_and_those_that_are_held_or_heard_are_marked():
    net = strip()
    with style.applied():
        figure = network.page(record_of(net), list(net.free[:2]))
    (ax,) = figure.axes
    drawn, centres, radii = circles(ax)
    assert centres == pytest.approx(net.position)
    assert radii == pytest.approx(net.radius)
    faces = drawn.get_facecolors()[:, :3]
    for held in (0, 1, 2):
        assert np.all(faces[net.held == held] == FACES[held])
    names = [f"ball {ball}" for ball in net.free[:2]]
    beyond = figure.caption.partition("Not in the legend: ")[2].rstrip(".").split(", ")
    assert {"at rest", "driven", *names} <= {*legend(figure), *beyond}
    for ball, name in zip(net.free, names, strict=False):
        (dot,) = lines(ax, label=name)
        assert (*dot.get_xdata(), *dot.get_ydata()) == pytest.approx(net.position[ball])
    (arrow,) = ax.texts
    (x, y), (along, across) = np.subtract(arrow.xy, arrow.xyann), net.direction
    assert x * across == pytest.approx(y * along)
    assert all(ax.viewLim.padded(1e-9).contains(*tip) for tip in (arrow.xy, arrow.xyann))


def test_what_drives_is_marked_where_it_does():
    net = strip()
    pushed = record_of(pgran.with_source(net, balls=net.free[[3]]))
    assert np.array_equal(np.flatnonzero(View(pushed).kind == 2), net.free[[3]])
    assert np.array_equal(View(record_of(net), driven=False).kind, np.minimum(net.held, 1))
    # the arrow is at another driven ball than the middle one where that has a detector beside it
    net = pgran.pack(80, pressure=0.02, walls="x", seed=3)
    driven = net.position[net.held == 2]
    middle = driven[np.linalg.norm(driven - driven.mean(axis=0), axis=1).argmin()]
    heard = net.free[np.linalg.norm(net.position[net.free] - middle, axis=1).argsort()[:3]]
    with style.applied():
        (ax,) = network.page(record_of(net), heard).axes
    along = np.linspace(ax.texts[0].xy, ax.texts[0].xyann, 99)[:, None]
    assert np.linalg.norm(along - net.position[heard], axis=2).min() > 0.3


def test_without_radii_and_forces_dots_and_stiffness():
    net = crystal("square", (4, 3), lambda u: 0.5 + u / 2)
    ax = draw(network.contacts, record_of(net))
    assert f"stiffness up to {net.stiffness.max():.3g}" in labels(ax)
    widths = np.array(of_kind(ax, LineCollection)[0].get_linewidths())
    assert widths / widths.max() == pytest.approx(net.stiffness / net.stiffness.max())
    assert circles(ax)[2] == pytest.approx(0.25)


@pytest.mark.parametrize(("direction", "across"), [([1, 0, 0], 2), ([0, 0, 1], 1), ([0, 1, 1], 0)])
def test_of_spheres_a_plane_along_the_drive_is_drawn(direction, across):
    net = gas(direction)
    figure = network.page(record_of(net), [7])
    _, centres, radii = circles(figure.axes[0])
    depth = net.position[:, across] - net.position[7, across]
    cut = np.abs(depth) < net.radius
    seen = [axis for axis in range(3) if axis != across]
    assert centres == pytest.approx(net.position[cut][:, seen])
    assert radii**2 + depth[cut] ** 2 == pytest.approx(net.radius[cut] ** 2)
    assert f"{'xyz'[across]}$ = {net.position[7, across]:.3g}" in note(figure)
    (drawn,) = of_kind(figure.axes[0], LineCollection)
    assert len(drawn.get_segments()) == np.count_nonzero(cut[net.bond].all(axis=1))
    # a plane that is low is within the page as it is drawn first
    low = replace(net, position=net.position * [2, 1, 1], kmax=None, median_mass=None)
    figure = network.page(record_of(low), [7])
    figure.draw_without_rendering()
    assert figure.panels[0].get_tightbbox().y0 > 0


def test_contacts_of_unknown_distance_cross_where_the_normal_points_elsewhere():
    net = record_of(strip(force=None))
    along, crosses = reaches(net)
    assert np.count_nonzero(crosses) > 0
    bare = replace(net, distance=None)
    assert np.array_equal(reaches(bare)[1], crosses)
    assert reaches(bare)[0] == pytest.approx(along)
    assert not reaches(replace(net, normal=None))[1].any()


@pytest.mark.parametrize("displacement", ["vector", "rotations"])
def test_arrows_are_displacements_of_the_modes_chosen(displacement):
    net = strip(displacement, tangential=np.full(len(strip().bond), 0.5))
    result = result_of(pgran.find_modes(net, shapes=True), net)
    x, each = result.modes.omega / net.omega_mx, net.components
    panels = page_of(result, "shapes").panels
    for mode, ax in zip(modes.pick(x, result.modes.participation), panels, strict=True):
        moves = np.zeros((len(net.held), each))
        moves[net.free] = result.modes.vector[mode].reshape(-1, each)
        moves /= np.sqrt(net.masses)[:, None]  # up to a factor that all have
        if displacement == "rotations":
            moves[:, 2] *= np.sqrt(2)  # R times the angle: of a disc I = m R^2 / 2
        size = np.linalg.norm(moves[:, :2], axis=1)
        largest = max(size.max(), np.abs(moves[:, 2:]).max(initial=0.0))
        (arrows,) = of_kind(ax, Quiver)
        shown = size > balls.LEAST_ARROW * largest
        assert np.array_equal(arrows.XY, net.position[shown])
        drawn = np.stack([arrows.U, arrows.V], axis=1)
        assert all(ax.viewLim.contains(*tip) for tip in arrows.XY + drawn)
        longest = np.linalg.norm(drawn, axis=1).max()
        assert drawn / longest == pytest.approx(moves[shown, :2] / size.max())
        assert f"{x[mode]:.4g} " in ax.get_title(loc="left")
        if displacement == "rotations":
            colours = circles(ax)[0].get_array().data
            assert colours == pytest.approx(moves[:, 2] / largest)


def test_scalar_fields_are_colours():
    net = strip("scalar", force=None, direction=None)
    result = listen(net, [int(net.free[3])])
    shown = result.pulse
    panels = page_of(result, "field").panels
    assert len(panels) == 4
    for number, ax in enumerate(panels):
        values = np.zeros(len(net.held))
        values[net.free] = shown.field[number]
        values[net.held == 2] = np.interp(shown.field_time[number], shown.time, shown.wall)
        drawn, centres, _ = circles(ax)
        assert drawn.get_array().data == pytest.approx(values / np.abs(values).max())
        assert drawn.get_clim() == (-1, 1)
        assert centres == pytest.approx(net.position)
        (dot,) = lines(ax, marker="o")
        assert (*dot.get_xdata(), *dot.get_ydata()) == pytest.approx(net.position[net.free[3]])
        assert f"largest {np.abs(values).max():.2g}" in ax.get_title(loc="left")


def test_a_few_of_many_numbers_are_beyond_the_colours():
    net = crystal("square", (42, 40), displacement="scalar")
    values = np.random.default_rng(2).normal(size=len(net.free))
    values[7] = 50.0
    drawn, unit, _ = balls.motion(Figure().subplots(), record_of(net), values, 0.5)
    moves = np.zeros(len(net.held))
    moves[net.free], moves[net.held == 2] = values, 0.5
    assert unit == pytest.approx(np.quantile(np.abs(moves[np.abs(moves) > 0.05]), 0.99))
    assert drawn.get_array().data == pytest.approx(moves / unit)


def test_signals_by_distance_from_the_driven_balls():
    net = strip(direction=[0.6, 0.8], force=None)
    free = net.free[np.argsort(net.position[net.free, 0], kind="stable")]
    heard = [int(free[0]), int(free[-1]), int(free[len(free) // 2])]
    result = listen(net, heard)
    shown = result.pulse
    ticks = page_of(result, "signals").axes[0].get_yticklabels()
    names = [text.get_text().split("\n")[0] for text in ticks]
    assert names == ["driven balls", *[f"ball {heard[n]}" for n in (1, 2, 0)]]
    work = draw(pulse.energy, shown, result.medium).get_lines()[0].get_ydata()
    assert work == pytest.approx(shown.work / (np.median(net.masses) * net.omega_mx**2))
    wall = np.interp(shown.field_time[0], shown.time, shown.wall)
    view = View(result.network)
    arrows, largest = balls.arrows(Figure().subplots(), result.network, view, shown.field[0], wall)
    driven = np.isin(arrows.XY, net.position[net.held == 2]).all(axis=1)
    drawn = np.stack([arrows.U, arrows.V], axis=1)
    size = np.linalg.norm(drawn, axis=1)
    assert size[driven] / size.max() == pytest.approx(abs(wall) / largest)
    along = np.tile(np.sign(wall) * np.array([0.6, 0.8]), (np.count_nonzero(driven), 1))
    assert drawn[driven] / size[driven, None] == pytest.approx(along)


def test_a_network_without_positions_has_its_other_figures(caplog):
    net = strip("scalar", force=None, direction=None, position=None, normal=None)
    ball = int(net.free[0])
    for result, expected in (
        (result_of(pgran.find_modes(net, shapes=True), net), ["participation"]),
        (sweep(net, [ball]), ["amplitude", "phase", "delay", "wall"]),
        (listen(net, [ball]), ["signals", "energy", "spectrum"]),
    ):
        caplog.clear()
        with caplog.at_level("WARNING", logger="pgran"):
            assert list(figures.make(result)) == expected
        assert "no positions" in caplog.text


def test_a_velocity_is_given_where_there_is_a_distance():
    net = strip()
    ball = int(net.free[0])
    result = sweep(net, [ball])
    shown = result.response
    shown.phase_slope[:], shown.phase_intercept[:] = -3.0, 0.0
    shown.phase_slope_error[:] = shown.phase_velocity_error[:] = 0.1
    shown.phase_used_min[:], shown.phase_used_max[:] = 0.3, 1.0
    for velocity, said, unit in ((2.0, "v = 2", r"$v$ in lengths $\times"),
                                 (np.nan, "s = -3", "$s$ in rad/")):  # fmt: skip
        shown.phase_velocity[:] = velocity
        name, *others = labels(draw(response.phase, shown, result.medium))
        assert name.startswith(f"ball {ball}: ${said}")
        assert any(unit in label for label in others)
        assert ("2.00 " in page_of(result, "phase").caption) == np.isfinite(velocity)


def test_two_results_of_one_network(monkeypatch):
    net, saved = strip(), saving(monkeypatch)
    heard = [int(net.free[0])]
    other = sweep(replace(net, direction=[0, 1]), heard)
    shown = {"response.h5": sweep(net, heard), "pulse.h5": listen(net, heard), "other.h5": other}
    shown["modes.h5"] = result_of(pgran.find_modes(net), net)
    shown["lattice.h5"] = result_of(shown["modes.h5"].modes)
    monkeypatch.setattr(pgran, "load", shown.get)
    for pair in (["modes.h5", "response.h5"], ["modes.h5", "other.h5"],  # modes have no drive
                 ["pulse.h5", "response.h5"]):  # fmt: skip
        assert plot(pair) == 0
    assert "normal modes" in labels(saved[0]["phase"].axes[0])
    for pair in (["pulse.h5", "other.h5"], ["response.h5", "lattice.h5"]):
        with pytest.raises(FileError, match="belong to different lattices"):
            plot(pair)


def test_a_network_by_itself(tmp_path, monkeypatch):
    """Before anything is computed: from Python, and from its file."""
    net = strip()
    assert list(pgran.plot(net)) == ["network"]
    names = "bond", "stiffness", "held", "position", "normal", "distance", "force"
    write_network(tmp_path / "n.h5", {name: getattr(net, name) for name in names}, {})
    saved = saving(monkeypatch)
    assert plot([str(tmp_path / "n.h5")]) == 0
    assert list(saved[0]) == ["network"]
    bare = pgran.Network(net.bond, net.stiffness, net.held)
    with pytest.raises(FileError, match=r"nothing to draw in this result .scene network"):
        pgran.plot(bare)
