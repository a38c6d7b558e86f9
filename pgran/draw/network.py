"""The figure of a network, its balls and contacts where they are."""

from itertools import cycle

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D

from pgran.draw import captions, style
from pgran.draw.view import EDGES, FACES, MANY, View
from pgran.errors import log
from pgran.medium.space import in_space
from pgran.medium.springs import AT_REST, DRIVEN

MARKS = "osD^v<>"  # of detectors
ARROW, CLEAR = 14, 20  # points: half of the drive's double arrow, its middle from detectors


def figures(result, **_):
    """Yield the network with the detectors of the result, if it has positions."""
    if not result.network.has_places:
        log.warning("the network has no positions: neither it nor a motion of it is drawn")
        return
    sites = captions.heard(result)
    yield "network", page(result.network, [] if sites is None else sites[:, 0])


def page(network, balls):
    """Return the figure of the contacts, with detectors at these balls."""
    view = View(network, balls[0] if len(balls) else None)
    ratio = view.extent[1] / view.extent[0]
    width = style.wide(style.PAGE if ratio < 0.4 else style.COLUMN)
    height = min(max((width - 0.6) * ratio, 0.6), 7.0) + 0.5
    figure, (ax,) = style.page(width, height)
    contacts(ax, network, balls)
    what = "stiffness" if network.force is None else "force"
    dots = "; small marks: detectors" if len(balls) else ""
    figure.caption = (
        f"The network: a line is a contact, as thick as its {what}; circles: balls, dark ones at "
        f"rest, green ones driven along the double arrow{dots}."
    )
    style.legend_above([ax])
    if view.plane:
        style.above(figure, f"network in the {view.plane}")
    return figure


def contacts(ax, network, balls=()):
    """Draw contacts as lines whose width is the force, or the stiffness; all balls; detectors.

    A contact across the end of a periodic box is a half line at both of its balls. Three
    dimensions: what the plane of the first detector cuts. `balls` are the numbers of the detectors,
    `network` has positions. Returns the lines.
    """
    view = View(network, balls[0] if len(balls) else None)
    view.frame(ax)
    view.draw(ax)
    what = "stiffness" if network.force is None else "force"
    values = getattr(network, what)
    thickest, largest = min(max(0.2 * view.points(ax), 0.3), 2.5), np.abs(values).max() or 1.0
    segments, numbers = view.lines(network.bond)
    widths = np.maximum(thickest * np.abs(values) / largest, 0.1)[numbers]
    shades = np.where(values < 0, style.UNRESOLVED, "black")[numbers]
    look = {"capstyle": "butt", "rasterized": len(segments) > MANY}
    drawn = LineCollection(segments, linewidths=widths, colors=shades, **look)
    ax.add_collection(drawn)
    _entry(ax, f"{what} up to {captions.number(largest, 3)}", color="black", linewidth=thickest)
    if np.any(values < 0):
        _entry(ax, f"negative {what}", color=style.UNRESOLVED, linewidth=thickest)
    _arrow(ax, network, view, [ball for ball in balls if view.seen[ball]])
    look = {"markeredgecolor": "black", "linestyle": "none", "markersize": 6, "zorder": 4}
    look |= {"markeredgewidth": 0.6, "path_effects": [style.HALO]}
    names = style.ball_names(np.reshape(balls, (-1, 1)).astype(int))
    shades = zip(style.colours(len(balls)), cycle(MARKS), strict=False)
    for ball, name, (shade, mark) in zip(balls, names, shades, strict=True):
        if view.seen[ball]:
            ax.plot(*view.xy[ball], color=shade, marker=mark, label=name, **look)
    for kind, name in ((AT_REST, "at rest"), (DRIVEN, "driven")):
        if np.any(view.kind == kind):
            look = {"color": FACES[kind], "markeredgecolor": EDGES[kind], "markeredgewidth": 0.4}
            _entry(ax, name, marker="o", linestyle="none", **look)
    return drawn


def _entry(ax, label, **look):
    """Add an entry to the legend."""
    ax.add_line(Line2D([], [], label=label, **look))


def _arrow(ax, network, view, balls):
    """Draw a double arrow along the drive at the middle one of the driven balls, in the frame.

    Of those, if there are any, where it keeps clear of the detectors, these balls.
    """
    driven = view.xy[view.seen & (view.kind == DRIVEN)]
    if not len(driven) or len(network.direction) == 1:
        return
    point = view.spacing / view.points(ax)
    half = ARROW * point * in_space(network.direction)[view.axes]
    (left, right), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    inside = np.array([left, bottom]) + np.abs(half), np.array([right, top]) - np.abs(half)
    middles, aside = np.clip(driven, *inside), np.linalg.norm(driven - driven.mean(axis=0), axis=1)
    near = [np.linalg.norm(middles - view.xy[ball], axis=1) < CLEAR * point for ball in balls]
    middle = middles[np.lexsort((aside, np.any(near, axis=0) + 0 * aside))[0]]
    look = {"arrowstyle": "<->", "color": style.DRIVEN, "linewidth": 1.8, "mutation_scale": 9}
    look |= {"shrinkA": 0, "shrinkB": 0, "path_effects": [style.HALO], "zorder": 5}
    ax.annotate("", xy=middle + half, xytext=middle - half, arrowprops=look)
