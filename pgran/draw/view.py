"""Which balls and contacts of a network are seen, and where: a plane, or a cut through space."""

import numpy as np
from matplotlib.collections import EllipseCollection
from matplotlib.colors import to_rgb

from pgran.draw import scales, style
from pgran.medium.space import in_space, reaches

FACES = np.array([to_rgb("#e4e4e4"), to_rgb("#8c8c8c"), style.pale(style.ACCENT)])  # held so
EDGES = np.array(["#aaaaaa", "black", style.ACCENT])
RIM = 1.2  # points, of balls that are held
MANY = 5000  # contacts: above that they are pixels in a PDF, too


class View:
    """What is seen: all of a plane network; of one in space the balls that a plane cuts.

    The plane goes through one ball, by default the one that is nearest to the middle, and contains
    the direction of the drive. The network has positions.
    """

    def __init__(self, network, ball=None):
        """Find the balls that are seen, and the circles that the plane cuts of them."""
        self.network, place = network, in_space(network.position)
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
            self.plane = f"plane ${'xyz'[across]}$ = {place[ball, across]:.3g}"
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
        size, held = self.size[chosen], self.network.held[chosen]
        place = {"units": "xy", "offset_transform": ax.transData}
        edge = 0.4 if "array" not in look else 0.2 if len(size) <= MANY / 2 else 0.0
        if "array" in look:  # which hides the faces' colours
            edge = np.where(held > 0, RIM, edge)
        look |= {"linewidths": edge, "rasterized": len(size) > MANY}
        look |= {"facecolors": FACES[held], "edgecolors": EDGES[held]}
        drawn = EllipseCollection(size, size, 0, offsets=self.xy[chosen], **place, **look)
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

    def frame(self, ax, margin=0.0):
        """Set limits and names of the axes."""
        margin = max(margin, 0.02 * self.extent.max())
        (left, bottom), (right, top) = self.low - margin, self.low + self.extent + margin
        ax.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
        for axis, place in zip((ax.xaxis, ax.yaxis), self.axes, strict=True):
            scales.label(axis, scales.PLACES[place])
        ax.locator_params("both", nbins=6, steps=[1, 2, 5, 10])
