"""The figure of a lattice: its bonds, walls and detectors (paper: sprlat, sprpic)."""

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from pgran.draw import style

WALL, WALL_SHADE = 0.05, "#888888"  # inches
TALLEST_PANEL = 6.5  # inches of a panel
ROOM_FOR_BALLS = 25  # points from ball to ball; with more, all balls are drawn


def page(lattice, detectors):
    """Return the figure of the bonds in a plane, with its scale of grey."""
    chain, (nx, ny) = len(lattice.shape) == 1, (*lattice.shape, 1)[:2]
    ratio, plane = (ny + 1) / (nx + 1), tuple(detectors[0][2:])
    width = style.wide(style.PAGE if chain or nx > 40 or ratio < 0.5 else style.COLUMN)
    height = 0.35 if chain else min(max((width - 0.7) * ratio, 0.8), TALLEST_PANEL)
    figure, (ax,) = style.page(width, height + 1.1)
    drawn = bonds(ax, lattice, detectors)
    beyond = np.max(drawn.get_array()) > drawn.norm.vmax * (1 + 1e-9)
    look = {"aspect": 9 * width, "pad": 0.02, "extend": "max" if beyond else "neither"}
    bar = figure.colorbar(drawn, ax=ax, orientation="horizontal", **look)
    bar.set_label("bond constant $K$" + (", mean of each ball" if ax.images else ""))
    bar.outline.set_linewidth(0.6)
    ax.set_title(f"plane $z$ = {plane[0]}" if plane else "")
    figure.caption = (
        "The lattice: a line is a bond, the darker the larger its constant $K$; hatched: walls at "
        "rest; green: what drives; dots: detectors."
    )
    style.legend_above([ax])
    return figure


def bonds(ax, lattice, detectors):
    """Draw the bonds, white to black from 0 to kmax, the walls and the detectors (paper: sprpic).

    Where the constants have nothing to do with kmax, up to the largest of them. Three dimensions:
    the bonds within the plane of the first detector; `detectors` have the shape (nd, dim). Of a
    small lattice all balls are drawn (paper: sprlat). A large one is drawn as an image: at each
    ball the mean constant of all its bonds. Returns what a colour bar is of.
    """
    axes, (nx, ny) = len(lattice.shape), (*lattice.shape, 1)[:2]
    stiffness = lattice.stiffness
    plane, kmax = tuple(detectors[0][2:]), lattice.mass * lattice.omega_mx**2 / (2 * axes)
    stiffest = max(np.max(k) for k in stiffness)
    fits = 0.5 * kmax <= stiffest <= 2 * kmax or stiffest == 0
    grey = {"cmap": "gray_r", "norm": Normalize(0.0, kmax if fits else stiffest)}
    spacing = 72 * ax.bbox.width / ax.figure.dpi / (nx + 1)  # points from ball to ball
    segments, constants = _segments([k[(..., *plane)] for k in stiffness[:2]])
    if len(segments) <= 8000:
        thick = 8.0 if axes == 1 else min(max(0.3 * spacing, 0.5), 4.0)
        order = np.argsort(constants, kind="stable")  # stiff bonds over soft ones
        drawn = LineCollection(segments[order], array=constants[order], linewidths=thick, **grey)
        ax.add_collection(drawn)
    else:
        both = [np.delete(k, 0, axis) + np.delete(k, -1, axis) for axis, k in enumerate(stiffness)]
        mean = (sum(both) / (2 * axes))[(..., *plane)].reshape(nx, ny)
        drawn = ax.imshow(mean.T, origin="lower", extent=(-0.5, nx - 0.5, -0.5, ny - 0.5), **grey)
    equal = axes > 1 and 1 / 8 <= (ny + 1) / (nx + 1) <= 8
    ax.set(xlim=(-1, nx), ylim=(-1, ny), aspect="equal" if equal else "auto")
    names, shades = style.ball_names(detectors), style.colours(len(detectors))
    dot = {"marker": "o", "markeredgecolor": "white", "linestyle": "none", "clip_on": False}
    dot["markersize"] = min(max(0.7 * spacing, 5.0), 8.0)
    if axes > 1 and spacing > ROOM_FOR_BALLS:
        ax.plot(*np.indices((nx, ny)).reshape(2, -1), markersize=ROOM_FOR_BALLS / 2, **style.RING)
    for site, name, shade in zip(detectors, names, shades, strict=True):
        if tuple(site[2:]) == plane:
            ax.plot(*(*site, 0)[:2], color=shade, label=name, **dot)
    walls(ax, lattice, plane)
    return drawn


def _segments(stiffness):
    """Return each bond of one or two axes as a line between sites or walls, and its constant."""
    segments = []
    for axis, k in enumerate(stiffness):
        ends = np.zeros((k.size, 2, 2))  # lower and upper end, x and y of each
        ends[:, :, : k.ndim] = np.argwhere(np.ones(k.shape))[:, None, :]
        ends[:, 0, axis] -= 1
        segments.append(ends)
    return np.concatenate(segments), np.concatenate([k.ravel() for k in stiffness])


def walls(ax, lattice, plane=(), arrow=True):
    """Draw the walls, hatched at rest, what drives in green, with an arrow; number the balls."""
    axes, (nx, ny) = len(lattice.shape), (*lattice.shape, 1)[:2]
    ax.spines[:].set_visible(False)
    inch = ax.bbox.width / ax.figure.dpi / (nx + 1)  # of a spacing
    thick = WALL / inch, WALL / inch if axes > 1 and ax.get_aspect() != "auto" else 0.03 * (ny + 1)
    whole = lattice.wall is None and lattice.push is None and "x+" not in (lattice.free or "")
    along = (-1 - thick[0], nx + 1 + thick[0])
    rest = {"x-": (-1 - thick[0], -1, thick[0], ny + 1)}
    if not whole:
        rest["x+"] = (nx, -1, thick[0], ny + 1)
    if axes > 1:
        rest |= {"y-": (along[0], -1 - thick[1], along[1], thick[1])}
        rest |= {"y+": (along[0], ny, along[1], thick[1])}
    look = {"facecolor": "white", "edgecolor": WALL_SHADE, "hatch": "//////", "linewidth": 0}
    for side, (left, bottom, width, height) in rest.items():
        if side not in (lattice.free or ""):
            ax.add_patch(Rectangle((left, bottom), width, height, clip_on=False, **look))
    ax.set_xlim(-1 - thick[0], nx + (0 if whole else thick[0]))
    ax.set_ylim(-1 - (axes > 1) * thick[1], ny + (axes > 1) * thick[1])
    source(ax, lattice, nx, plane)
    if arrow and whole:
        look = {"arrowstyle": "<->", "color": style.DRIVEN, "shrinkA": 0, "shrinkB": 4}
        place = {"xytext": (22, 0), "textcoords": "offset points"}
        ax.annotate("", xy=(nx, (ny - 1) / 2), arrowprops=look, **place)
    for axis, count, name in ((ax.xaxis, nx, "i"), (ax.yaxis, ny, "j")):
        locator = MaxNLocator(nbins=6, steps=[1, 2, 5, 10], integer=True)
        ticks = locator.tick_values(0, max(count - 1, 1))
        axis.set_ticks([tick for tick in ticks if 0 <= tick < count])
        axis.set_label_text(f"ball ${name}$")
    ax.yaxis.set_visible(axes > 1)


def source(ax, lattice, x, plane=()):
    """Draw what drives a lattice: its wall at x, places of that, or balls under a force."""
    look = {"color": style.DRIVEN, "clip_on": False, "zorder": 3}
    if lattice.push is not None:
        balls = np.argwhere(lattice.push[(..., *plane)]).T
        look |= {"marker": ">", "markersize": 5, "linestyle": "none", "label": "force"}
        ax.plot(balls[0], balls[1] if len(balls) > 1 else 0 * balls[0], **look)
    elif "x+" in (lattice.free or ""):
        return  # nothing does
    elif lattice.wall is None:
        low, high = ax.get_ylim()
        ends = max(low, -1), min(high, (*lattice.shape, 1)[1])
        ax.plot([x, x], ends, linewidth=3, label="driven wall", scaley=False, **look)
    else:
        moved = np.flatnonzero(lattice.built.wall[(..., *plane)])
        ax.vlines(np.full(len(moved), x), moved - 0.5, moved + 0.5, linewidth=3,
                  label="driven part", **look)  # fmt: skip
