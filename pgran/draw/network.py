"""The figure of a network, its balls and contacts where they are; and how the balls move there."""

import logging
import math

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D

from pgran.draw import style
from pgran.draw.balls import scale_of
from pgran.draw.view import EDGES, FACES, MANY, View
from pgran.medium.space import everywhere, in_space

log = logging.getLogger("pgran")
AT_REST, DRIVEN = 1, 2  # what `held` says, 0: free
FAINT = 0.02  # of the largest: no arrow for what is smaller


def figures(result, **_):
    """Yield the network with the detectors of the result, if it has positions."""
    if not result.network.has_places:
        log.warning("the network has no positions: neither it nor a motion of it is drawn")
        return
    sites = style.heard(result)
    yield "network", page(result.network, [] if sites is None else sites[:, 0])


def page(network, balls):
    """Return the figure of the contacts, with detectors at these balls."""
    view = View(network, balls[0] if len(balls) else None)
    ratio = view.extent[1] / view.extent[0]
    width = style.wide(style.PAGE if ratio < 0.4 else style.COLUMN)
    height = min(max((width - 0.6) * ratio, 0.6), 7.0) + 0.5
    figure, (ax,) = style.page(width, height + 0.2 * bool(view.plane))
    contacts(ax, network, balls)
    figure.set_figheight(figure.get_figheight() + 0.14 * style.legend_above([ax]))
    what = "stiffness" if network.force is None else "force"
    dots = "; dots: detectors" if len(balls) else ""
    figure.caption = (
        f"The network: a line is a contact, as thick as its {what}; circles: balls, dark ones at "
        f"rest, blue ones driven along the double arrow{dots}."
    )
    if view.plane:
        figure.suptitle(f"network in the {view.plane}", fontsize="medium")
    return figure


def contacts(ax, network, balls=()):
    """Draw contacts as lines whose width is the force, or the stiffness; balls; detectors.

    A contact across the end of a periodic box is a half line at both balls. Three dimensions: what
    the plane of the first detector cuts. Returns the lines.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    network : pgran.results.NetworkRecord
        With positions.
    balls : sequence of int
        That are detectors.
    """
    view = View(network, balls[0] if len(balls) else None)
    view.frame(ax)
    view.draw(ax)
    for kind, name in ((AT_REST, "at rest"), (DRIVEN, "driven")):
        if np.any(network.held == kind):
            look = {"color": FACES[kind], "markeredgecolor": EDGES[kind], "markeredgewidth": 0.4}
            _entry(ax, name, marker="o", linestyle="none", **look)
    what = "stiffness" if network.force is None else "force"
    values = getattr(network, what)
    points = 72 * ax.bbox.width / ax.figure.dpi * view.spacing / view.extent[0]  # ball to ball
    thickest, largest = min(max(0.2 * points, 0.3), 2.5), np.abs(values).max() or 1.0
    segments, numbers = view.lines(network.bond)
    widths = np.maximum(thickest * np.abs(values) / largest, 0.1)[numbers]
    shades = np.where(values < 0, style.UNRESOLVED, "black")[numbers]
    look = {"capstyle": "butt", "rasterized": len(segments) > MANY}
    drawn = LineCollection(segments, linewidths=widths, colors=shades, **look)
    ax.add_collection(drawn)
    _entry(ax, f"{what} up to {largest:.3g}", color="black", linewidth=thickest)
    if np.any(values < 0):
        _entry(ax, f"negative {what}", color=style.UNRESOLVED, linewidth=thickest)
    _arrow(ax, network, view)
    look = {"marker": "o", "markeredgecolor": "white", "linestyle": "none", "markersize": 6}
    names = style.ball_names(np.reshape(balls, (-1, 1)).astype(int))
    for ball, name, shade in zip(balls, names, style.colours(len(balls)), strict=True):
        if view.seen[ball]:
            ax.plot(*view.xy[ball], color=shade, label=name, zorder=4, **look)
    return drawn


def motion(ax, network, view, values, drive=0.0, beyond=False):
    """Draw how all balls move: vectors as arrows, numbers as colours of -1 to 1.

    The largest displacement of all is the unit. Rotations in a plane are such colours too, of
    radius times angle. Returns the balls, or the arrows if there are no colours, and the unit.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    network : pgran.results.NetworkRecord
    view : View
    values : numpy.ndarray, shape (unknowns,)
        Displacements of the free balls.
    drive : float
        That of the driven balls.
    beyond : bool
        Whether a few of many numbers may be beyond the colours: `balls.scale_of` those seen is the
        unit.
    """
    moves, axes = everywhere(network, values[None], [drive])[0], network.built.axes
    longest = max(1.2 * view.spacing, 0.09 * math.sqrt(math.prod(view.extent))) if axes > 1 else 0.0
    view.frame(ax, 0.9 * longest)
    turned = moves[:, axes:] * (network.radius[:, None] if network.built.turns else 1.0)
    numbers = moves if axes == 1 else turned if turned.shape[1] == 1 else None
    size = np.linalg.norm(moves[:, :axes], axis=1)
    unit = max(size.max(), 0.0 if numbers is None else np.abs(numbers).max()) or 1.0
    if beyond and axes == 1:
        unit = scale_of(moves[view.seen])
    look = {}
    if numbers is not None:
        look = {"array": numbers[view.seen, 0] / unit, "cmap": style.SIGNED, "clim": (-1.0, 1.0)}
    drawn = view.draw(ax, **look)
    if axes == 1:
        return drawn, unit
    chosen = view.seen & (size > FAINT * unit)
    arrows = longest * in_space(moves[:, :axes])[chosen][:, view.axes] / unit
    look = {"angles": "xy", "scale_units": "xy", "scale": 1, "units": "inches", "width": 0.008}
    look |= {"minlength": 0, "zorder": 3, "clip_on": False, "in_layout": False}
    if numbers is not None:  # seen on dark balls, too
        look |= {"edgecolor": "white", "linewidth": 0.3}
    drawn_arrows = ax.quiver(*view.xy[chosen].T, *arrows.T, **look)
    return (drawn_arrows if numbers is None else drawn), unit


def explain(figure, network, *more):
    """Write above panels of motions what is drawn, and more."""
    arrows = "arrows: displacements, scaled in each panel to the largest"
    said = {"scalar": "each panel scaled by itself", "vector": arrows}
    turns = "; colours: radius times angle" if network.built.turns == 1 else ""
    said["rotations"] = arrows + turns
    rim = " rim" if turns or network.displacement == "scalar" else ""
    held = f"dark{rim}: balls at rest; blue{rim}: driven balls" if network.held.any() else ""
    text = "; ".join([text for text in (*more, held) if text])
    rows = style.above(figure, said[network.displacement], text)
    figure.set_figheight(figure.get_figheight() + 0.15 * rows + 0.12)
    figure.caption += f" {said[network.displacement].capitalize()}; {text}."


def _entry(ax, label, **look):
    """Add an entry to the legend."""
    ax.add_line(Line2D([], [], label=label, **look))


def _arrow(ax, network, view):
    """Draw a double arrow along the drive at the driven ball in the middle of these."""
    driven = np.flatnonzero(view.seen & (network.held == DRIVEN))
    if not driven.size or len(network.direction) == 1:
        return
    middle = view.xy[driven].mean(axis=0)
    ball = driven[np.linalg.norm(view.xy[driven] - middle, axis=1).argmin()]
    along = 14 * in_space(network.direction)[view.axes]
    look = {"arrowstyle": "<-", "color": style.ACCENT, "linewidth": 1.5, "shrinkA": 0, "shrinkB": 0}
    for tip in (along, -along):
        place = {"xy": view.xy[ball], "xytext": tip, "textcoords": "offset points"}
        ax.annotate("", **place, arrowprops=look)
