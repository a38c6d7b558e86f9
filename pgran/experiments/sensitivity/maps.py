"""Maps of what belongs to bonds and balls, in lattices and networks alike, and shares of these."""

import logging
from dataclasses import replace
from functools import partial

import numpy as np
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import LinearSegmentedColormap, ListedColormap

from pgran.draw import balls, bonds, scales, style
from pgran.draw.view import BARRED, MANY, View
from pgran.medium.space import as_network

log = logging.getLogger("pgran")
MOST = 3  # frequencies in maps, and detectors with maps of their own
CLEAR = 8000  # bonds in the plane that are drawn one by one; of more, what their balls sum up to
CELLS = 24  # of arrows along the longer side, where there are more bonds
LOST = LinearSegmentedColormap.from_list("lost", ["white", "#fdbe85", "#e6550d"])
# for lines, which would not be seen if they were white
STRONG = ListedColormap(style.SIGNED(np.r_[0.0:0.3:64j, 0.7:1.0:64j]))
FAINT = 0.05  # of the largest: no wedge for what is smaller
SHORTEST = 3.0  # points that a line is long, in a panel as it is before the layout


class Map:
    """The balls and bonds that are seen: of three dimensions those in the plane of one ball.

    That is the detector, which is marked. A lattice is a network whose balls touch, within walls;
    its free balls come first.
    """

    def __init__(self, medium, detector):
        self.medium, self.lattice = medium, medium.group == "lattice"
        self.network = network = as_network(medium)
        if self.lattice:
            network = replace(network, radius=np.full(len(network.held), 0.5))
        shape = medium.shape if self.lattice else (len(network.held),)
        self.detector = int(np.ravel_multi_index(tuple(detector), shape))
        self.site, (self.name,) = tuple(detector), style.ball_names([detector])
        self.view = View(network, self.detector)
        self.free = self.view.seen & (network.held == 0)
        self.segments, self.numbers = self.view.lines(network.bond)
        self.clear = len(self.segments) <= CLEAR

    def frame(self, ax):
        """Set the limits; draw walls, balls that are held, faint bonds, and mark the detector."""
        if self.lattice:
            bonds.walls(ax, self.medium, tuple(self.site[2:]), arrow=False)
        else:
            self.view.frame(ax)
            self.view.draw(ax, self.view.seen & (self.view.kind > 0), zorder=0.6)
        if self.clear:
            self.view.ground(ax, 0.5)
        look = style.RING | {"markersize": 4.5, "markeredgewidth": 1.0, "zorder": 5}
        ax.plot(*self.view.xy[self.detector], label="detector", **look)

    def beside(self, ax, text):
        """Write a text beside the detector, towards the middle of the panel."""
        (x, _), middle = self.view.xy[self.detector], np.mean(ax.get_xlim())
        place = {"xytext": (4, 4) if x < middle else (-4, 4), "textcoords": "offset points"}
        halo = {"path_effects": [style.HALO], "zorder": 5}
        side = "left" if x < middle else "right"
        ax.annotate(text, self.view.xy[self.detector], ha=side, fontsize="small", **place, **halo)

    def lines(self, ax, values):
        """Draw numbers from -1 to 1 on all bonds, NaN: none; return what a colour bar is of.

        Widths are as the root of the magnitude; lines of negative numbers are hollow. Those of a
        large lattice, a few bonds of which are drawn, are longer than bonds.
        """
        self.frame(ax)
        points = self.view.points(ax)
        thickest = min(max(0.45 * points, 1.2), 5.0)
        of_lines = values[self.numbers]
        order = np.argsort(np.abs(of_lines), kind="stable")  # the NaNs last
        order = order[np.isfinite(of_lines[order])]
        size = np.sqrt(np.minimum(np.abs(of_lines[order]), 1.0))
        middle = self.segments[order].mean(axis=1, keepdims=True)
        segments = middle + max(1.0, SHORTEST / points) * (self.segments[order] - middle)
        look = {"capstyle": "butt", "rasterized": len(order) > MANY}
        drawn = LineCollection(
            segments, array=of_lines[order], cmap=STRONG, clim=(-1.0, 1.0),
            linewidths=thickest * size, zorder=2, **look,
        )  # fmt: skip
        ax.add_collection(drawn)
        hollow = of_lines[order] < -BARRED
        widths = 0.35 * thickest * size[hollow]
        look |= {"colors": "white", "linewidths": widths, "zorder": 2.1, "label": "negative"}
        ax.add_collection(LineCollection(segments[hollow], **look))
        return drawn

    def each(self, values):
        """Return whether the bonds with a number are few enough to be drawn one by one."""
        return np.count_nonzero(np.isfinite(values[self.numbers])) <= CLEAR

    def words(self, values, grows, combined="sum"):
        """Return what `on_bonds` shows of these numbers, in words; what red is."""
        if self.each(values):
            return f"red: {grows}; blue, hollow: it falls; width: square root"
        return f"each ball: {combined} over its bonds; red: {grows}; blue: it falls"

    def on_bonds(self, ax, values, mean=False):
        """Draw numbers of bonds, NaN: none, in units of the largest that is seen.

        Where bonds are too many to be seen, each ball has the sum over its bonds, or their mean.
        Returns what is drawn, and the unit.
        """
        if self.each(values):
            unit = balls.scale_of(np.nan_to_num(values[self.numbers]))
            return self.lines(ax, values / unit), unit
        known = np.isfinite(values)
        values = self.summed(np.where(known, values, 0.0))
        if mean:
            values /= np.maximum(self.summed(known), 1)
        unit = balls.scale_of(values[self.free])
        return self.discs(ax, values / unit), unit

    def summed(self, values):
        """Return for each ball the sum over its bonds, which counts a bond at both its balls."""
        total = np.zeros(len(self.network.held))
        for end in self.network.bond.T:
            np.add.at(total, end, values)
        return total

    def discs(self, ax, values):
        """Draw numbers of all balls, -1 to 1, as colours of the free ones; return these."""
        self.frame(ax)
        return self.view.coloured(ax, values, self.free)

    def flow(self, ax, values, lost):
        """Draw what flows through bonds, from the first ball to the second where it is positive.

        A wedge a bond, broad where it comes from, its width as the root of what flows; where bonds
        are too many, a wedge a square cell, for the sum of the vectors along them. Returns the
        balls, coloured by what is lost there. Both are in units of the largest.
        """
        self.frame(ax)
        look = {"cmap": LOST, "clim": (0.0, 1.0), "zorder": 0.4, "linewidths": 0}
        drawn = self.view.draw(ax, self.free, array=lost[self.free], **look)
        flows, breadth = values[self.numbers], 0.65 * self.view.spacing
        start, end = self.segments[:, 0], self.segments[:, 1]
        if not self.clear:
            start, end, flows, breadth = self._cells(0.5 * (start + end), flows)
        shown = np.abs(flows) > FAINT**2
        flows, start, end = flows[shown], start[shown], end[shown]
        start, end = (np.where(flows[:, None] >= 0, *pair) for pair in ((start, end), (end, start)))
        along = end - start
        across = np.stack([-along[:, 1], along[:, 0]], axis=1)
        across /= np.linalg.norm(along, axis=1, keepdims=True)
        across *= 0.5 * breadth * np.sqrt(np.abs(flows))[:, None]
        wedges = np.stack([start - across, start + across, end], axis=1)
        look = {"facecolors": "black", "linewidths": 0, "rasterized": len(wedges) > MANY}
        ax.add_collection(PolyCollection(wedges, zorder=2, **look))
        return drawn

    def _cells(self, middle, flows):
        """Return start and end of a wedge a cell, its flow, and the breadth of the largest."""
        vectors = flows[:, None] * (self.segments[:, 1] - self.segments[:, 0])
        side = self.view.extent.max() / CELLS
        cell = ((middle - self.view.low) // side).astype(int)
        occupied, number = np.unique(cell, axis=0, return_inverse=True)
        total = np.zeros((len(occupied), 2))
        np.add.at(total, number.ravel(), vectors)
        size = np.linalg.norm(total, axis=1)
        centre = self.view.low + (occupied + 0.5) * side
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
    figure = balls.page(seen.view.extent, panels, what)
    held = "green: what drives" if seen.lattice else "dark: at rest; green: driven"
    where = "; ".join(filter(None, [seen.view.plane, f"circle: {seen.name}", held]))
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
    """Make axes of shares logarithmic, up to `reach` at least, without what is next to nothing."""
    largest = max((curve.get_xdata().max(initial=0.0) for curve in curves), default=0.0) or 1.0
    right = 2 * max(largest, reach)
    ax.set(xscale="log", yscale="log", ylim=(None, 1), xlim=(1e-5 * largest, right))
