"""The sound waves that fit into a medium.

Along a periodic axis of length L a wave vector has components 2 pi n / L, and a wave is a cosine
and a sine. Between walls, a distance L apart, it stands: sin(n pi (x - x_wall) / L). Along an axis
that is neither, as up to a free surface, it does not vary.
"""

import itertools
import math

import numpy as np

from pgran.errors import InputError
from pgran.medium.base import AXES
from pgran.medium.contacts import tangents
from pgran.medium.space import reaches
from pgran.medium.springs import FREE
from pgran.run.machine import check_memory

ALIKE = 1e-6  # relative: by how much a given wave vector may differ from one that fits


class Waves:
    """The waves that fit into a medium: arrays of whole numbers n, one for each axis.

    Walls of a network are its outermost held balls that touch free ones, along those axes on which
    all free balls lie between them. `unit` (d,) is the wave vector of n = 1, 0 along an axis
    without waves; `branches` are the names of polarisations.
    """

    def __init__(self, medium):
        self.medium, self.scalar = medium, medium.components == 1
        self.branches = ("scalar",) if self.scalar else ("longitudinal", "transverse")
        ends = of_lattice if medium.is_grid else of_network
        self.place, low, high, box, self.contact = ends(medium)
        self.axes, nowhere = len(low), np.zeros(len(low))
        first, last = self.place.min(axis=0), self.place.max(axis=0)
        self.walled = (low < first) & (last < high)
        self.start = np.where(self.walled, low, 0.0)
        period = np.where(self.walled, 2 * (high - low), box)  # of the wave n = 1
        self.unit = np.divide(2 * math.pi, period, out=nowhere.copy(), where=period > 0)

    def first(self, count, direction):
        """Return the waves of each of the `count` smallest magnitudes, a list of lists.

        They run along one axis, the `direction`, or in `all`, diagonals of periodic axes included.
        """
        check_memory("structure_count", 200 * count * self.medium.size)  # while S is solved
        waves = {}
        for step, n in itertools.product(self._directions(direction), range(1, count + 1)):
            # beside the axis along which it gets shorter there is half a wave between walls
            wave = np.where((step == 0) & self.walled, 1, n * step)
            waves[tuple(wave)] = wave
        if not waves:
            raise InputError(
                f"-structure_direction {direction}: no wave fits: it has no period and no walls"
            )
        ordered = sorted(waves.values(), key=self.magnitude)
        groups = itertools.groupby(ordered, lambda wave: f"{self.magnitude(wave):.6e}")
        return [list(group) for _, group in groups][:count]

    def _directions(self, wanted):
        """Yield the numbers of the longest wave in each direction."""
        for step in itertools.product((0, 1, -1), repeat=self.axes):
            along = np.flatnonzero(step)
            name = "".join(AXES[axis] for axis in along)
            fits = np.all(self.unit[along] > 0) and (
                len(along) == 1 or not self.walled[along].any()
            )
            # of a direction and its opposite the first
            if step > (0,) * self.axes and fits and wanted in ("all", name):
                yield np.array(step)

    def given(self, wavevectors):
        """Return waves of given wave vectors, as `first`, the smallest first; refuse others."""
        if wavevectors.ndim != 2 or wavevectors.shape[1] != self.axes or not len(wavevectors):
            raise InputError(f"wavevectors: rows of {self.axes} components are needed")
        waves = np.divide(wavevectors, self.unit, out=0 * wavevectors, where=self.unit > 0).round()
        fits = np.abs(waves * self.unit - wavevectors) <= ALIKE * np.abs(wavevectors)
        fits &= (waves != 0) | ~self.walled
        for at in np.flatnonzero(~fits.all(axis=1) | ~waves.any(axis=1)):
            raise InputError(
                f"wavevectors: {wavevectors[at]} does not fit into this medium: components are "
                f"multiples of {self.unit}, and not 0 between walls"
            )
        return [[wave] for wave in sorted(waves.astype(int), key=self.magnitude)]

    def magnitude(self, wave):
        """Return the wave number of a wave."""
        return float(np.linalg.norm(wave * self.unit))

    def polarisations(self, wave):
        """Return for each branch the directions of displacements, shape (n, axes of these).

        A standing wave, which runs both ways, is polarised by the axis along which it is shortest.
        """
        if self.scalar:
            return [np.ones((1, 1))]
        along = wave * self.unit / self.magnitude(wave)
        if self.walled.any():
            along = np.eye(self.axes)[np.argmax(np.abs(along))]
        return [along[None], np.concatenate(tangents(along[None]))]

    def patterns(self, groups):
        """Return the patterns f of groups of waves, and the place of each: branch, then group.

        With the displacements g of a wave f = M^(1/2) g / (g^H M g)^(1/2), of mass-weighted
        unknowns: a force in proportion to the mass. The sum of f^T G f over the patterns of a place
        is the mean of f^H G f over its waves, as G is symmetric.
        """
        rows, places = [], []
        components, weights = self.medium.components, self.medium.displacements(1.0)
        for column, group in enumerate(groups):
            for wave in group:
                for branch, directions in enumerate(self.polarisations(wave)):
                    parts = self._parts(wave)[:, None, :, None] * directions[:, None]
                    f = np.zeros((*parts.shape[:3], components))  # part, polarisation, ball
                    f[..., : parts.shape[3]] = parts
                    f = f.reshape(*f.shape[:2], -1) / weights
                    f /= np.linalg.norm(f, axis=(0, 2), keepdims=True)
                    f /= math.sqrt(len(group) * len(directions))
                    rows.append(f.reshape(-1, f.shape[2]))
                    places += [branch * len(groups) + column] * len(rows[-1])
        return np.concatenate(rows), np.array(places)

    def _parts(self, wave):
        """Return a wave at the free balls, in one part if it stands, else a cosine and a sine."""
        angle = wave * self.unit * (self.place - self.start)
        standing = np.prod(np.sin(angle[:, self.walled]), axis=1)
        if not np.linalg.norm(standing) > ALIKE:
            raise InputError(f"-structure_count: the wave {wave} is 0 at every ball: take fewer")
        if not wave[~self.walled].any():
            return standing[None]
        phase = angle[:, ~self.walled].sum(axis=1)
        return standing * np.stack([np.cos(phase), np.sin(phase)])

    def every(self):
        """Return all waves that are longer than two contacts along each axis, of both signs."""
        longest = math.pi / self.contact / np.where(self.unit > 0, self.unit, np.inf)
        ends = np.maximum(np.ceil(longest - ALIKE).astype(int), 1)
        ranges = map(range, np.where(self.walled, 1, 1 - ends), ends)
        return [np.array(n) for n in itertools.product(*ranges) if any(n)]

    def strongest(self, vectors):
        """Return wave number, branch and share of modes v, mass-weighted, shape (nm, unknowns).

        Of waves alike, a branch's whose numbers differ by half of what the smallest do, at most,
        the mean of (f^T v)^2 is the largest for each mode, and the share is its sum.
        """
        every = self.every()
        if not every:
            raise InputError("wave numbers: no wave fits: there are no periods and no walls")
        k, power = np.array([self.magnitude(wave) for wave in every]), []
        for wave in every:
            patterns, branch = self.patterns([[wave]])
            squares = (patterns @ vectors.T) ** 2
            power.append([squares[branch == b].sum(axis=0) for b in range(len(self.branches))])
        bins = np.rint(2 * k / self.unit[self.unit > 0].min())
        alike = np.equal.outer(np.unique(bins), bins).astype(float)
        sums, moments = (np.tensordot(alike * each, power, 1) for each in (1.0, k))
        means = (sums.T / alike.sum(axis=1)).T.reshape(-1, len(vectors))
        at = *np.unravel_index(means.argmax(axis=0), sums.shape[:2]), np.arange(len(vectors))
        share = sums[at] * np.array([1, self.axes - 1])[at[1]]  # of all transverse directions
        return moments[at] / sums[at], np.array(self.branches)[at[1]], share


def of_lattice(lattice):
    """Return where balls are (n, d), the walls, or balls, at both ends, no period, the spacing."""
    shape = np.array(lattice.shape, dtype=float)
    walls = [[f"{x}{side}" not in lattice.free for x in AXES[: len(shape)]] for side in "-+"]
    low, high = np.where(walls[0], -1.0, 0.0), np.where(walls[1], shape, shape - 1)
    place = np.indices(lattice.shape, dtype=float).reshape(len(shape), -1).T
    return place, low, high, np.zeros(len(shape)), 1.0


def of_network(network):
    """Return where free balls are, the ends of held ones, the periods, a contact's length."""
    if network.position is None:
        raise InputError("-network_file: waves need the positions of the balls")
    if network.components > 1 and network.position.shape[1] != network.axes:
        raise InputError("-network_file: positions and normals differ in their dimensions")
    place, nowhere = network.position[network.free], np.zeros(network.position.shape[1])
    box, gravity = (nowhere if v is None else v for v in (network.box, network.gravity))
    touching = np.unique(network.bond[np.any(network.held[network.bond] == FREE, axis=1)])
    held = network.position[touching[network.held[touching] != FREE]]
    low, high = (end(held if len(held) else place, axis=0) for end in (np.min, np.max))
    low = np.where((box == 0) & (gravity == 0), low, place.min(axis=0))  # else none stands there
    contact = np.median(np.linalg.norm(reaches(network)[0], axis=1))
    return place, low, high, box, contact
