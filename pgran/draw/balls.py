"""How balls move: of a lattice an image of a plane, or the line along a chain; of a network arrows.

And the page of such panels, or of maps, with one scale of colours from -1 to 1.
"""

import math

import numpy as np

from pgran.draw import bonds, style
from pgran.draw.view import BARRED, View, bars
from pgran.medium.space import everywhere, in_space

LEAST_MOTION = 1e-3  # of the largest: what moves less does not count among the balls that move
NARROWEST_PANEL = 1.3  # inches of a panel
BAR_ASPECT = 9.0  # to an inch: how many times as long as thick a colour bar is
MANY_BALLS = 1000  # balls that move; the colours of fewer reach to the largest
LEAST_ARROW = 0.02  # of the largest: no arrow for what is smaller
ARROWS = "arrows: displacements, scaled in each panel to the largest"


def scale_of(values, few=False):
    """Return the number that is one end of the colours, 1 if nothing moves.

    That is the largest, of a `few` or where a few balls move, else their 99th percentile: single
    ones, between soft bonds, move many times as far as the others, which would be pale.
    """
    size = np.abs(values)
    moving = size[size > LEAST_MOTION * size.max()]
    few = few or moving.size <= MANY_BALLS
    return float(moving.max(initial=0.0) if few else np.quantile(moving, 0.99)) or 1.0


def beyond(drawn):
    """Return whether some of the balls that are drawn are beyond the ends of the colours."""
    values = drawn.get_array() if hasattr(drawn, "get_array") else None  # a line has none
    return values is not None and np.abs(values).max() > 1


def motion(ax, medium, values, drive=None, detectors=(), of=None):
    """Draw displacements `values` in units of the largest (`scale_of`), or of a larger drive's.

    Without a drive all that is held is at rest. Of three dimensions the plane of the first
    detector, or of the ball that moves farthest, in the motion `of` if that is another one. Returns
    the image, the line of a chain, or arrows or balls of a network; the unit; and the plane in
    words.
    """
    of = values if of is None else of
    if medium.group == "network":
        ball = detectors[0][0] if len(detectors) else None
        if ball is None:
            moved = everywhere(medium, of[None])[0, :, : medium.built.axes]
            ball = np.linalg.norm(moved, axis=1).argmax()
        view = View(medium, ball, drive is not None)
        if medium.built.axes > 1:
            drawn, unit = arrows(ax, medium, view, values, drive or 0.0)
        else:
            moves = everywhere(medium, values[None], [drive or 0.0])[0, :, 0]
            unit = scale_of(moves[view.seen])
            view.frame(ax)
            drawn = view.coloured(ax, moves / unit, view.seen)
        xy, plane = view.xy[[each for (each,) in detectors if view.seen[each]]], view.plane
    else:
        largest = np.unravel_index(np.abs(of).argmax(), of.shape)
        through = tuple((detectors[0] if len(detectors) else largest)[2:])
        values = values[(..., *through)]
        chain, moves = values.ndim == 1, np.append(values, drive or 0.0)
        unit = scale_of(moves, few=chain)
        drawn = image(ax, values / unit, (drive or 0.0) / unit)
        if drive is not None:
            bonds.source(ax, medium, values.shape[0] - (0.0 if chain else 0.5), through)
        xy = np.array([site[:2] for site in detectors if tuple(site[2:]) == through])
        if chain and len(xy):  # on the line
            xy = np.stack([xy[:, 0], values[xy[:, 0]] / unit], axis=1)
        plane = "".join(f"plane $z$ = {z}" for z in through)
    if len(xy):
        look = style.RING | {"markersize": 3, "markeredgewidth": 0.6, "zorder": 4}
        ax.plot(*xy.T, label="detectors", **look)
    return drawn, unit, plane


def image(ax, values, wall=0.0):
    """Draw numbers, -1 blue to 1 red, as an image with bars or a line up to `wall`; return it."""
    chain, (nx, ny) = values.ndim == 1, (*values.shape, 1)[:2]
    if chain:
        ax.axhline(0.0, color=style.MODE, linewidth=0.5)
        line = np.pad(values, 1, constant_values=(0.0, wall))
        (drawn,) = ax.plot(np.arange(-1, nx + 1), line, color="black")
        ax.set(xlim=(-1, nx), ylim=(-1.1, 1.1))
    else:
        place = {"origin": "lower", "extent": (-0.5, nx - 0.5, -0.5, ny - 0.5)}
        colours = {"cmap": style.SIGNED, "vmin": -1.0, "vmax": 1.0, "interpolation": "nearest"}
        drawn = ax.imshow(values.T, **place, **colours)
        ax.set(aspect="equal" if 1 / 8 <= ny / nx <= 3 else "auto", ylabel="ball $j$")
        bars(ax, np.argwhere(values < -BARRED), 72 * ax.bbox.width / ax.figure.dpi / nx)
    ax.set_xlabel("ball $i$")
    bins = 6 if len(values) < 100 else 3  # numbers of three digits are wide
    ax.locator_params("x" if chain else "both", nbins=bins, steps=[1, 2, 5, 10], integer=True)
    return drawn


def arrows(ax, network, view, values, drive=0.0):
    """Draw how all balls of a network move, by arrows in units of the largest displacement of all.

    Rotations in a plane are colours of -1 to 1, of radius times angle. Returns the balls, or the
    arrows if there are no colours, and the unit.
    """
    moves, axes = everywhere(network, values[None], [drive])[0], network.built.axes
    vectors = moves[:, :axes]
    turned = moves[:, axes:] * (network.radius[:, None] if network.built.turns else 1.0)
    coloured = turned.shape[1] == 1
    size = np.linalg.norm(vectors, axis=1)
    unit = max(size.max(), np.abs(turned).max() if coloured else 0.0) or 1.0
    longest = max(1.5 * view.spacing, 0.14 * math.sqrt(math.prod(view.extent)))
    chosen = view.seen & (size > LEAST_ARROW * unit)
    tips = longest * in_space(vectors)[chosen][:, view.axes] / unit
    view.frame(ax, 0.3 * longest, view.xy[chosen] + 1.05 * tips)  # with their heads
    drawn = view.coloured(ax, turned[:, 0] / unit, view.seen) if coloured else view.draw(ax)
    view.ground(ax, 1.5)
    thick = min(max(0.1 * view.points(ax), 0.5), 1.2) / 72
    look = {"angles": "xy", "scale_units": "xy", "scale": 1, "units": "inches", "width": thick}
    look |= {"headwidth": 3.5, "headlength": 4, "headaxislength": 3.8, "minlength": 0, "zorder": 3}
    look |= {"clip_on": False, "in_layout": False}
    if coloured:  # seen on dark balls, too
        look |= {"edgecolor": "white", "linewidth": 0.3}
    moving = ax.quiver(*view.xy[chosen].T, *tips.T, **look)
    return drawn if coloured else moving, unit


def motions(medium, draws, caption, *more, driven=False):
    """Return a figure of some panels of `motion`, with what is drawn, and more, said above."""
    network = medium.group == "network"
    figure = page(View(medium).extent if network else medium.shape, draws)
    kind = getattr(medium, "displacement", "scalar")
    turns = "; colours: radius times angle" if network and medium.built.turns == 1 else ""
    scaled = "each panel scaled by itself" if kind == "scalar" else ARROWS + turns
    rim = " rim" if turns or kind == "scalar" else ""
    rest = f"dark{rim}: balls at rest" if network and medium.held.any() else ""
    drives = f"green{rim}: driven balls" if network else "green: what drives"
    marked = any(line.get_label() == "negative" for ax in figure.panels for line in ax.get_lines())
    text = [scaled, *more, "blue, with bars: negative" * marked, rest, drives * driven]
    text = "; ".join(filter(None, text))
    style.above(figure, text)
    figure.caption = f"{caption} {text.capitalize()}."
    return figure


def page(extent, draws, what="displacement"):
    """Return a figure of some panels, as many next to each other as fit; long ones stacked.

    Each of `draws` draws into the axes that it is given and gives them a title. What they return is
    of one kind; a colour bar says that its colours are of `what`. `extent`: width and height, or
    the shape of a lattice.
    """
    (nx, ny), chain = (*extent, 1)[:2], len(extent) == 1
    flat, room = chain or nx > 1.5 * ny, style.wide(style.PAGE) - 1.2
    columns = 1 if flat else min(len(draws), max(1, int(room / NARROWEST_PANEL)))
    rows = -(-len(draws) // columns)
    width = room if flat else min(2.2, room / columns)
    height = 1.1 if chain else min(max(width * ny / nx, 0.7), 7.0 / rows)
    size = columns * width + 1.2, rows * (height + 0.4) + 0.6
    figure, panels = style.page(*size, nrows=rows, ncols=columns, sharex=True, sharey=True)
    figure.set_layout_engine("compressed", h_pad=0.07)  # as many panels as fit, next to each other
    for ax in panels[len(draws) :]:
        ax.remove()
    panels = figure.panels = panels[: len(draws)]
    shown = []
    for draw, ax in zip(draws, panels, strict=True):
        shown.append(draw(ax))
        if not flat:
            ax.set_title(ax.get_title(loc="left").replace(", ", "\n     "))
        ax.label_outer()
    if chain:
        figure.supylabel(f"{what} / largest", fontsize="medium")
    elif shown[0].get_array() is not None:
        few = any(map(beyond, shown))
        bar = {"ticks": [-1, -0.5, 0, 0.5, 1], "pad": 0.1 / width, "fraction": 0.1}
        bar |= {"aspect": BAR_ASPECT * rows * height, "extend": "both" if few else "neither"}
        of = "99th percentile" + "\nof balls that move" * (what == "displacement")
        of = of if few else "largest"
        figure.colorbar(shown[0], ax=list(panels), label=f"{what} / {of}", **bar)
    return figure
