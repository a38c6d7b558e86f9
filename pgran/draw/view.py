"""Which balls and contacts of a network are seen, and where: a plane, or a cut through space."""

import numpy as np
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.colors import to_rgb

from pgran.draw import scales, style
from pgran.medium.space import in_space, reaches
from pgran.medium.springs import AT_REST, DRIVEN

FACES = np.array([to_rgb("#f0f0f0"), to_rgb("#8c8c8c"), style.pale(style.DRIVEN)])  # of a `kind`
EDGES = np.array(["#aaaaaa", "black", style.DRIVEN])
RIM = 1.2  # points, of balls that are held
GROUND = {"colors": "#bbbbbb", "linewidths": 0.3}
BARRED = 0.05  # of the largest: smaller negative numbers have no bar
MANY = 5000  # contacts: above that they are pixels in a PDF, too


def bars(ax, places, points):
    """Mark places (n, 2) of negative numbers by bars, if neighbours are 3 `points` apart."""
    if points >= 3 and len(places):
        look = {"color": "white", "marker": "_", "linestyle": "none", "zorder": 2.5}
        look |= {"markersize": min(0.4 * points, 5), "markeredgewidth": 0.7}
        ax.plot(*places.T, label="negative", **look)


class View:
    """What is seen: all of a plane network; of one in space the balls that a plane cuts.

    The plane goes through one ball, by default the one that is nearest to the middle, and contains
    the direction of the drive. The network has positions.
    """

    def __init__(self, network, ball=None, driven=True):
        """Find the balls that are seen, and the circles that the plane cuts of them.

        Their `kind` is FREE, AT_REST or DRIVEN, by what holds them or by a force; nothing is driven
        in motions without a drive, as normal modes are.
        """
        self.network, place = network, in_space(network.position)
        self.kind = network.held if driven else np.minimum(network.held, AT_REST)
        if driven and network.push is not None:
            self.kind = np.where(np.any(network.push, axis=1), DRIVEN, network.held)
        self.along, self.crosses = reaches(network)
        self.spacing = float(np.median(np.linalg.norm(self.along, axis=1)))
        sized = network.radius is not None
        radius = network.radius if sized else np.full(len(place), 0.25 * self.spacing)
        across, depth, self.plane = 2, np.zeros(len(place)), ""
        if network.position.shape[1] == 3:
            drive = np.abs(np.append(network.direction, [0, 0])[:3])
            across = 2 - int(np.argmin(drive[::-1]))
            middle = (place.min(axis=0) + place.max(axis=0)) / 2
            ball = np.linalg.norm(place - middle, axis=1).argmin() if ball is None else ball
            depth = place[:, across] - place[ball, across]
            where = scales.said(place[ball, across], network, scales.PLACES[0], 3)
            self.plane = f"plane ${'xyz'[across]}$ = {where}"
        near = radius if sized else np.full(len(place), 0.5 * self.spacing)
        self.seen = np.abs(depth) < near
        self.size = radius * np.sqrt(np.maximum(1 - (depth / near) ** 2, 0)) * 2
        self.axes = [axis for axis in range(3) if axis != across]
        self.xy = place[:, self.axes]
        self.low = self.xy.min(axis=0) - radius.max()
        self.extent = np.maximum(self.xy.max(axis=0) + radius.max() - self.low, self.spacing)

    def draw(self, ax, chosen=None, **look):
        """Draw the balls that are seen, or those chosen of them, as circles; return them."""
        chosen = self.seen if chosen is None else chosen
        size, kind = self.size[chosen], self.kind[chosen]
        place = {"units": "xy", "offset_transform": ax.transData}
        edge = 0.4 if "array" not in look else 0.2 if len(size) <= MANY / 2 else 0.0
        if "array" in look:  # which hides the faces' colours
            edge = np.where(kind > 0, RIM, edge)
        look = {"linewidths": edge, "rasterized": len(size) > MANY} | look
        look |= {"facecolors": FACES[kind], "edgecolors": EDGES[kind]}
        drawn = EllipseCollection(size, size, 0, offsets=self.xy[chosen], **place, **look)
        return ax.add_collection(drawn)

    def coloured(self, ax, numbers, chosen, **look):
        """Draw chosen balls in colours of numbers, -1 to 1, NaN in grey, with bars; return them."""
        look = {"cmap": style.SIGNED, "clim": (-1.0, 1.0)} | look
        drawn = self.draw(ax, chosen, array=np.ma.masked_invalid(numbers[chosen]), **look)
        bars(ax, self.xy[chosen & (numbers < -BARRED)], self.points(ax))
        return drawn

    def lines(self, bond):
        """Return each contact that is seen as a line, and its number; one that crosses as two."""
        seen, along = self.seen[bond].all(axis=1), self.along[:, self.axes]
        across, ends = self.crosses, self.xy[bond]  # shape (nb, 2, 2)
        near, far = ends.copy(), ends.copy()
        near[:, 1] = near[:, 0] + along * np.where(across, 0.5, 1.0)[:, None]
        far[:, 0] = far[:, 1] - 0.5 * along
        numbers = [np.flatnonzero(seen), np.flatnonzero(seen & across)]
        return np.concatenate([near[numbers[0]], far[numbers[1]]]), np.concatenate(numbers)

    def ground(self, ax, zorder):
        """Draw contacts thinly, below what matters."""
        segments, _ = self.lines(self.network.bond)
        look = GROUND | {"rasterized": len(segments) > MANY, "zorder": zorder}
        ax.add_collection(LineCollection(segments, **look))

    def points(self, ax):
        """Return how many points on paper are between neighbours, before the layout."""
        return 72 * ax.bbox.width / ax.figure.dpi * self.spacing / self.extent[0]

    def frame(self, ax, margin=0.0, points=()):
        """Set limits, which hold some points, too, and those of shared axes, and names of axes."""
        margin = max(margin, 0.02 * self.extent.max())
        ends = [self.low - margin, self.low + self.extent + margin, *points]
        if not ax.get_autoscale_on():
            ends += zip(ax.get_xlim(), ax.get_ylim(), strict=True)
        (left, bottom), (right, top) = np.min(ends, axis=0), np.max(ends, axis=0)
        ax.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
        for axis, place in zip((ax.xaxis, ax.yaxis), self.axes, strict=True):
            scales.label(axis, scales.PLACES[place])
        ax.locator_params("both", nbins=6, steps=[1, 2, 5, 10])
