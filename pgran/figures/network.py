"""The figure of a network, its balls and contacts where they are; and how the balls move there."""

import logging

import numpy as np
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.lines import Line2D

from pgran.figures import style
from pgran.results.space import everywhere, in_space, reaches

log = logging.getLogger("pgran")
AT_REST, DRIVEN = 1, 2  # what `held` says, 0: free
FACES = ("#e4e4e4", "#8c8c8c", style.pale(style.ACCENT))  # of balls that are held so
MANY = 5000  # contacts: above that they are pixels in a PDF, too
FAINT = 0.02  # of the largest: no arrow for what is smaller


def figures(result, **_):
    """Yield the network with the detectors of the result, if it has positions."""
    if result.network.position is None:
        log.warning("the network has no positions: neither it nor a motion of it is drawn")
        return
    heard = [getattr(result, name, None) for name in ("response", "pulse", "relaxation")]
    balls = [record.detector[:, 0] for record in heard if record is not None]
    yield "network", page(result.network, balls[0] if balls else [])


def page(network, balls):
    """Return the figure of the contacts, with detectors at these balls."""
    view = View(network, balls[0] if len(balls) else None)
    ratio = view.extent[1] / view.extent[0]
    width = style.PAGE if ratio < 0.4 else style.COLUMN
    columns = 2 if width == style.COLUMN else 4
    entries = 4 + len(balls)
    height = min(max((width - 0.6) * ratio, 0.6), 7.0) + 0.5 + 0.14 * -(-entries // columns)
    figure, (ax,) = style.page(width, height + 0.2 * bool(view.plane))
    contacts(ax, network, balls)
    style.legend_above([ax], columns)
    if view.plane:
        figure.suptitle(f"network in the {view.plane}", fontsize="medium")
    return figure


class View:
    """What is seen: all of a plane network; of one in space the balls that a plane cuts.

    The plane goes through one ball and contains the direction of the drive.

    Parameters
    ----------
    network : pgran.results.NetworkRecord
        With positions.
    ball : int, optional
        By default the one that is nearest to the middle.
    """

    def __init__(self, network, ball=None):
        """Find the balls that are seen, and the circles that the plane cuts of them."""
        place = in_space(network.position)
        self.along, self.crosses = reaches(network)
        self.spacing = float(np.median(np.linalg.norm(self.along, axis=1)))
        self.round = network.radius is not None
        radius = network.radius if self.round else np.full(len(place), 0.25 * self.spacing)
        across, depth, self.plane = 2, np.zeros(len(place)), ""
        if network.position.shape[1] == 3:
            drive = np.abs(np.append(network.direction, [0, 0])[:3])
            across = 2 - int(np.argmin(drive[::-1]))
            middle = (place.min(axis=0) + place.max(axis=0)) / 2
            ball = np.linalg.norm(place - middle, axis=1).argmin() if ball is None else ball
            depth = place[:, across] - place[ball, across]
            self.plane = f"plane ${'xyz'[across]}$ = {place[ball, across]:.3g}"
        near = radius if self.round else np.full(len(place), 0.5 * self.spacing)
        self.seen = np.abs(depth) < near
        self.size = radius * np.sqrt(np.maximum(1 - (depth / near) ** 2, 0)) * 2
        self.axes = [axis for axis in range(3) if axis != across]
        self.xy = place[:, self.axes]
        self.low = self.xy.min(axis=0) - radius.max()
        self.extent = np.maximum(self.xy.max(axis=0) + radius.max() - self.low, self.spacing)

    def draw(self, ax, **look):
        """Draw the balls that are seen as circles; return them."""
        size, place = self.size[self.seen], {"units": "xy", "offset_transform": ax.transData}
        look = {"linewidths": 0.4, "rasterized": len(size) > MANY} | look
        drawn = EllipseCollection(size, size, 0, offsets=self.xy[self.seen], **place, **look)
        return ax.add_collection(drawn)

    def lines(self, bond):
        """Return each contact that is seen as a line, and its number; one that crosses as two."""
        seen, along = self.seen[bond].all(axis=1), self.along[:, self.axes]
        across, ends = self.crosses, self.xy[bond]  # shape (nb, 2, 2)
        near, far = ends.copy(), ends.copy()
        near[:, 1] = near[:, 0] + along * np.where(across, 0.5, 1.0)[:, None]
        far[:, 0] = far[:, 1] - 0.5 * along
        numbers = [np.flatnonzero(seen), np.flatnonzero(seen & across)]
        return np.concatenate([near[numbers[0]], far[numbers[1]]]), np.concatenate(numbers)

    def frame(self, ax):
        """Set limits and names of the axes."""
        margin = 0.02 * self.extent.max()
        (left, bottom), (right, top) = self.low - margin, self.low + self.extent + margin
        ax.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
        ax.set(xlabel=f"${'xyz'[self.axes[0]]}$", ylabel=f"${'xyz'[self.axes[1]]}$")
        ax.locator_params("both", nbins=6, steps=[1, 2, 5, 10])


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
    view.draw(
        ax, facecolors=[FACES[held] for held in network.held[view.seen]], edgecolors="#aaaaaa"
    )
    for held, name in ((AT_REST, "at rest"), (DRIVEN, "driven")):
        if np.any(network.held == held):
            _entry(ax, name, marker="o", color=FACES[held], linestyle="none")
    what = "stiffness" if network.force is None else "force"
    values = getattr(network, what)
    points = 72 * ax.bbox.width / ax.figure.dpi * view.spacing / view.extent[0]  # ball to ball
    thickest, largest = min(max(0.3 * points, 0.8), 3.5), np.abs(values).max() or 1.0
    segments, numbers = view.lines(network.bond)
    widths = np.maximum(thickest * np.abs(values) / largest, 0.2)[numbers]
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


def motion(ax, network, view, values, drive=0.0):
    """Draw how all balls move: vectors as arrows, numbers from -1 to 1 blue to white to red.

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
    """
    moves, axes = everywhere(network, values[None], [drive])[0], network.built.axes
    unit = np.linalg.norm(moves[:, :axes], axis=1).max() or 1.0
    view.frame(ax)
    turned = moves[:, axes:] * (network.radius[:, None] if network.built.turns else 1.0)
    numbers = moves if axes == 1 else turned if turned.shape[1] == 1 else None
    edges, held = np.array(["#aaaaaa", "black", style.ACCENT]), network.held[view.seen]
    if numbers is None:
        look = {"facecolors": [FACES[kind] for kind in held]}
    else:
        look = {"array": numbers[view.seen, 0] / unit, "cmap": "RdBu_r", "clim": (-1.0, 1.0)}
    drawn = view.draw(ax, edgecolors=edges[held], **look)
    if axes == 1:
        return drawn, unit
    size = np.linalg.norm(moves[:, :axes], axis=1) / unit
    chosen = view.seen & (size > FAINT)
    longest = max(1.6 * view.spacing, 0.08 * view.extent.max())
    arrows = longest * in_space(moves[:, :axes])[chosen][:, view.axes] / unit
    look = {"angles": "xy", "scale_units": "xy", "scale": 1, "units": "inches", "width": 0.008}
    drawn_arrows = ax.quiver(*view.xy[chosen].T, *arrows.T, minlength=0, zorder=3, **look)
    return (drawn_arrows if numbers is None else drawn), unit


def say_longest(figure, network, *more):
    """Write above the panels of motions what their scale is, and more."""
    said = {"scalar": "each scaled to its largest displacement"}
    vector = "arrows: displacements, each scaled to the largest"
    said |= {"vector": vector, "rotations": f"{vector}; colours: radius times angle"}
    text = "; ".join([text for text in (*more, said[network.displacement]) if text])
    figure.suptitle(text, fontsize="medium")


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
