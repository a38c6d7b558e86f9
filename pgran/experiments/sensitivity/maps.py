"""Maps of what belongs to bonds and balls, in lattices and networks alike, and shares of these."""

from dataclasses import replace
from functools import partial

import numpy as np
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import LinearSegmentedColormap, ListedColormap

from pgran.draw import balls, bonds, scales, style
from pgran.draw.view import BARRED, MANY, View
from pgran.errors import log
from pgran.medium.space import as_network

MOST = 3  # frequencies in maps, and detectors with maps of their own
CLEAR = 8000  # bonds in the plane that are drawn one by one; of more, what their balls sum up to
CELLS = 24  # of arrows along the longer side, where there are more bonds
LOST = LinearSegmentedColormap.from_list("lost", ["white", "#fdbe85", "#e6550d"])
# for lines, which would not be seen if they were white
STRONG = ListedColormap(style.SIGNED(np.r_[0.0:0.3:64j, 0.7:1.0:64j]))
FAINT = 0.05  # of the largest: no wedge for what is smaller
SHORTEST = 3.0  # points that a line is long, in a panel as it is before the layout


class Map(View):
    """The balls and bonds that are seen: of three dimensions those in the plane of one ball.

    That is the detector, which is marked. A lattice is a network whose balls touch, within walls;
    its free balls come first.
    """

    def __init__(self, medium, detector):
        self.medium, self.lattice = medium, medium.group == "lattice"
        network = as_network(medium)
        if self.lattice:
            network = replace(network, radius=np.full(len(network.held), 0.5))
        shape = medium.shape if self.lattice else (len(network.held),)
        self.site, (self.name,) = tuple(detector), style.ball_names([detector])
        self.detector = int(np.ravel_multi_index(self.site, shape))
        super().__init__(network, self.detector)
        self.free = self.seen & (network.held == 0)
        self.segments, self.numbers = self.lines(network.bond)
        self.clear = len(self.segments) <= CLEAR

    def background(self, ax):
        """Set the limits; draw walls, balls that are held, faint bonds, and mark the detector."""
        if self.lattice:
            bonds.walls(ax, self.medium, self.site[2:], arrow=False)
        else:
            self.frame(ax)
            self.draw(ax, self.seen & (self.kind > 0), zorder=0.6)
        if self.clear:
            self.ground(ax, 0.5)
        look = style.RING | {"markersize": 4.5, "markeredgewidth": 1.0, "zorder": 5}
        ax.plot(*self.xy[self.detector], label="detector", **look)

    def beside(self, ax, text):
        """Write a text beside the detector, towards the middle of the panel."""
        place = self.xy[self.detector]
        side, away = ("left", 4) if place[0] < np.mean(ax.get_xlim()) else ("right", -4)
        look = {"fontsize": "small", "path_effects": [style.HALO], "zorder": 5}
        ax.annotate(text, place, (away, 4), textcoords="offset points", ha=side, **look)

    def on_bonds(self, ax, values, mean=False):
        """Draw numbers of bonds, NaN: none, in units of the largest that is seen.

        Where bonds are too many to be seen, each ball has the sum over its bonds, or their mean.
        Returns what is drawn, and the unit.
        """
        if self.each(values):
            unit = balls.scale_of(np.nan_to_num(values[self.numbers]))
            return self._lines(ax, values / unit), unit
        known = np.isfinite(values)
        values = self.summed(np.where(known, values, 0.0))
        if mean:
            values /= np.maximum(self.summed(known), 1)
        unit = balls.scale_of(values[self.free])
        return self.discs(ax, values / unit), unit

    def each(self, values):
        """Return whether the bonds with a number are few enough to be drawn one by one."""
        return np.count_nonzero(np.isfinite(values[self.numbers])) <= CLEAR

    def words(self, values, grows, combined="sum"):
        """Return what `on_bonds` shows of these numbers, in words; what red is."""
        if self.each(values):
            return f"red: {grows}; blue, hollow: it falls; width: square root"
        return f"each ball: {combined} over its bonds; red: {grows}; blue: it falls"

    def _lines(self, ax, values):
        """Draw numbers from -1 to 1 as lines, as wide as the root, of negative ones hollow.

        A few bonds of a large lattice are drawn longer than they are.
        """
        self.background(ax)
        points = self.points(ax)
        thickest = min(max(0.45 * points, 1.2), 5.0)
        values = values[self.numbers]
        order = np.argsort(np.abs(values), kind="stable")  # the NaNs last
        order = order[np.isfinite(values[order])]
        values, segments = values[order], self.segments[order]
        widths = thickest * np.sqrt(np.minimum(np.abs(values), 1.0))
        middle = segments.mean(axis=1, keepdims=True)
        segments = middle + max(1.0, SHORTEST / points) * (segments - middle)
        look = {"capstyle": "butt", "rasterized": len(order) > MANY}
        colours = {"array": values, "cmap": STRONG, "clim": (-1.0, 1.0), "zorder": 2}
        drawn = LineCollection(segments, linewidths=widths, **colours, **look)
        ax.add_collection(drawn)
        hollow = values < -BARRED
        look |= {"colors": "white", "linewidths": 0.35 * widths[hollow], "zorder": 2.1}
        ax.add_collection(LineCollection(segments[hollow], label="negative", **look))
        return drawn

    def summed(self, values):
        """Return for each ball the sum over its bonds, which counts a bond at both its balls."""
        bond = self.network.bond
        return np.bincount(bond.ravel(), np.repeat(values, 2), len(self.network.held))

    def discs(self, ax, values):
        """Draw numbers of all balls, -1 to 1, as colours of the free ones; return these."""
        self.background(ax)
        return self.coloured(ax, values, self.free)

    def flow(self, ax, values, lost):
        """Draw what flows through bonds, from the first ball to the second where it is positive.

        A wedge a bond, broad where it comes from, its width as the root of what flows; where bonds
        are too many, a wedge a square cell, for the sum of the vectors along them. Returns the
        balls, coloured by what is lost there. Both are in units of the largest.
        """
        self.background(ax)
        look = {"cmap": LOST, "clim": (0.0, 1.0), "zorder": 0.4, "linewidths": 0}
        drawn = self.draw(ax, self.free, array=lost[self.free], **look)
        flows, breadth = values[self.numbers], 0.65 * self.spacing
        start, end = np.moveaxis(self.segments, 1, 0)
        if not self.clear:
            start, end, flows, breadth = self._cells(start, end, flows)
        shown = np.abs(flows) > FAINT**2
        flows, start, end = flows[shown], start[shown], end[shown]
        start, end = np.where(flows[:, None] >= 0, [start, end], [end, start])
        along = end - start
        across = np.stack([-along[:, 1], along[:, 0]], axis=1)
        across /= np.linalg.norm(along, axis=1, keepdims=True)
        across *= 0.5 * breadth * np.sqrt(np.abs(flows))[:, None]
        wedges = np.stack([start - across, start + across, end], axis=1)
        look = {"facecolors": "black", "linewidths": 0, "rasterized": len(wedges) > MANY}
        ax.add_collection(PolyCollection(wedges, zorder=2, **look))
        return drawn

    def _cells(self, start, end, flows):
        """Return start and end of a wedge a cell, its flow, and the breadth of the largest."""
        middle, vectors = 0.5 * (start + end), flows[:, None] * (end - start)
        side = self.extent.max() / CELLS
        cell = ((middle - self.low) // side).astype(int)
        occupied, number = np.unique(cell, axis=0, return_inverse=True)
        total = np.zeros((len(occupied), 2))
        np.add.at(total, number.ravel(), vectors)
        size = np.linalg.norm(total, axis=1)
        centre = self.low + (occupied + 0.5) * side
        half = 0.45 * side * total / np.where(size > 0, size, 1.0)[:, None]
        return centre - half, centre + half, size / (size.max() or 1.0), 0.5 * side


def few(record):
    """Return the numbers of up to three good frequencies: the middles of as many equal parts."""
    good = np.flatnonzero(record.converged_reason > 0)
    if not len(good):
        log.warning("no frequency of the %s is as accurate as asked: none is drawn", record.group)
    count = min(MOST, len(good))
    return [int(good[(2 * n + 1) * len(good) // (2 * count)]) for n in range(count)]


def pages(name, draw, record, medium, what, words):
    """Yield the name and the page of maps of each detector that has its own.

    A panel is `draw(ax, record, medium, at, d)`, its colours are of `what`, and
    `words(seen, record, at, d)` says what is drawn in a Map.
    """
    at, sites = few(record), record.detector.tolist()
    if len(sites) > MOST:
        log.warning("maps are drawn of the first %d of %d detectors", MOST, len(sites))
    for d, site in enumerate(sites[:MOST]):
        seen = Map(medium, site)
        panels = [partial(draw, record=record, medium=medium, at=n, d=d) for n in at]
        end = "_".join(["", *map(str, site)]) if len(sites) > 1 else ""
        yield name + end, page(seen, record, panels, what, words(seen, record, at[0], d))


def page(seen, record, panels, what, text):
    """Return the figure of some maps, with what they show and what failed said above."""
    figure = balls.page(seen.extent, panels, what)
    held = "green: what drives" if seen.lattice else "dark: at rest; green: driven"
    where = "; ".join(filter(None, [seen.plane, f"circle: {seen.name}", held]))
    style.above(figure, where, text)
    note_failed(figure, record)
    figure.caption = f"Map of the {what}: {text}; {where}."
    return figure


def note_failed(figure, record):
    """Say in a figure how many frequencies are not drawn because they failed."""
    if failed := np.count_nonzero(record.converged_reason <= 0):
        count = f"{failed} of {len(record.omega)} frequencies"
        style.note(figure, f"NOT DRAWN: {count} that missed the accuracy asked for")


def title(ax, record, medium, at, largest, few_beyond):
    """Say in the title of a map which frequency it is at, and its unit."""
    end = "99 % within" if few_beyond else "largest"
    x = record.omega[at] / medium.omega_mx
    ax.set_title(f"{scales.frequency(x, medium)}, {end} {largest}")


def shares(values, total=None):
    """Return sizes, the largest first, and which share of the total is as large or larger."""
    size = np.sort(values[np.isfinite(values)])[::-1]
    return size, np.arange(1, len(size) + 1) / (total or max(len(size), 1))


def logarithmic(ax, curves, reach=0.0):
    """Make axes of shares logarithmic, up to `reach` at least, from where 95 % are beyond."""
    sizes = [curve.get_xdata() for curve in curves if np.any(curve.get_xdata() > 0)]
    largest = max((size.max() for size in sizes), default=1.0)
    least = min((np.quantile(size, 0.05) for size in sizes), default=0.0)
    least, right = max(least, 1e-5 * largest), 2 * max(largest, reach)
    ax.set(xscale="log", yscale="log", ylim=(None, 1), xlim=(least, right))
