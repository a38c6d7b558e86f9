"""The density of modes, and how modes spread energy, estimated by moments of random vectors.

With signs r drawn at random <r^T F r> = tr F for any matrix F. Of the steps F = [K < lambda] a
series of Chebyshev polynomials in the X of `driven.moments`, damped by Jackson's kernel g_n, is a
step as wide as pi |sin theta| / N in x = cos theta (A. Weisse et al., Reviews of Modern Physics 78,
275 (2006)):

    N(x) = (m_0 (pi - theta) - 2 sum over n >= 1 of g_n m_n sin(n theta) / n) / pi.

The energy diffusivity of modes at omega, by P. B. Allen and J. L. Feldman (Physical Review B 48,
12581 (1993)), is with A = K / m and its commutator V = [x, A] with positions

    d = (pi / 2 omega) tr(D V D V^T) / tr D,    D = delta(omega^2 - A), V_ij = (x_i - x_j) A_ij.

All of these are estimates. The variance of r^T F r is 2 (tr F^2 - sum of F_ii^2): of steps and
bins, 0 <= F <= 1, at most 2 n (1 - n / N), n of all N modes, so that standard errors of counts and
densities are no less than those of their vectors. Diffusivities have errors by the scatter of their
vectors, which Student's t widens.
"""

import contextlib
import math
from itertools import islice

import numpy as np

from pgran.driven.moments import Chebyshev
from pgran.driven.operators import Owner
from pgran.driven.recurrence import Rows
from pgran.errors import InputError
from pgran.experiments.modes.density_options import MOST
from pgran.experiments.modes.record import Density
from pgran.medium.base import AXES
from pgran.run.task import Task

SHARP = 0.1  # of the mean distance of frequencies: how far a step is smoothed
BLOCK = 32  # terms summed up at once


class Traces(Owner, Task):
    """Moments of random vectors, each a unit, and the traces for diffusivities along an `axis`.

    Collective when made, over the ranks `group` that share a medium.
    """

    owns = ("matrices",)

    def __init__(self, lattice, omegas, group, vectors, moments, axis, seed=1):
        self.lattice, self.omegas, self.axis, self.seed = lattice, omegas, axis, seed
        self.scaled, _ = lattice.undamped().in_own_unit()
        self.comm, self.matrices = group, Rows(self.scaled, group)
        self.layout = self.matrices.layout
        self.series = series = Chebyshev(self.matrices, self.scaled, (0.0, 0.0, 0.0), ())
        highest = math.sqrt(4 / (series.a * self.scaled.mass))
        needed = math.pi * highest / (2 * SHARP * np.mean(np.diff(omegas)))
        if moments is None and needed > MOST:
            raise InputError(
                f"-modes_density: frequencies so close take {needed:.1g} moments, of {MOST} at "
                "most: take fewer, or -modes_density_moments, which smooths more"
            )
        self.count = 2 * (moments // 2) if moments else 2 * math.ceil(needed / 2)
        self.middle = 0.5 * (omegas[1:] + omegas[:-1])
        self.units, self.items = range(vectors), f"vectors of {self.count} moments"
        spread = 2 * len(self.middle) if axis is not None else 0
        row = [("moments", float, (self.count,)), ("spread", float, (spread,))]
        self.row = np.dtype(row)

    @contextlib.contextmanager
    def open(self, group):
        """See `Task`."""
        commutator = None if self.axis is None else self._commutator()

        def work(unit):
            bits = np.random.Generator(np.random.Philox(key=[self.seed, unit]))
            signs = bits.integers(0, 2, self.scaled.size, dtype=np.int8) * 2.0 - 1.0
            signs = self.layout.free_values(signs.reshape(self.scaled.shape))
            row = np.zeros(1, self.row)
            found = self.series.terms(*self.series.read(signs, None, self.count), None)
            row["moments"] = found.readings[:, 0]
            if commutator is not None:
                row["spread"] = self._spread(commutator, signs)
            return row

        yield work

    def _commutator(self):
        """Return this rank's rows of V, distances across a periodic box the nearest."""
        medium, axis, period = self.scaled, self.axis, 0.0
        if medium.is_grid:
            places = np.indices(medium.shape)[axis].astype(float)
        else:
            places = np.repeat(medium.position[medium.free, axis], medium.components)
            period = 0.0 if medium.box is None else medium.box[axis]
        x = self.matrices.padded(self.layout.free_values(places.reshape(medium.shape)))
        V = self.matrices.matrix(medium.constants) / medium.mass
        apart = np.repeat(x[: self.matrices.own], np.diff(V.indptr)) - x[V.indices]
        if period:
            apart -= period * np.round(apart / period)
        V.data *= apart
        return V

    def _spread(self, V, signs):
        """Return p . V q and p . r at the middles, p = D r and q = -D V r. Collective."""
        padded = self.matrices.padded
        p, q = self._filtered(signs), self._filtered(-(V @ padded(signs)))
        found = [before @ (V @ padded(after)) for before, after in zip(p, q, strict=True)]
        return self.matrices.total(np.concatenate([found, p @ signs]))

    def _filtered(self, start):
        """Return D start at the middles, smoothed by the kernel: shape (middles, own)."""
        weights, total = self._weights(self.middle), np.zeros((len(self.middle), len(start)))
        block = np.empty((BLOCK, len(start)))
        terms = self.series.recurrence.terms(start[None], self.count)
        for first in range(0, self.count, BLOCK):
            for place, now in enumerate(islice(terms, BLOCK)):
                block[place] = now[0]
            total += weights[:, first : first + BLOCK] @ block[: place + 1]
        return total

    def _angle(self, omega):
        """Return theta of frequencies."""
        x = (self.series.a * self.scaled.mass * omega**2 - self.series.b) / 2
        return np.arccos(np.clip(x, -1.0, 1.0))

    def _weights(self, omega):
        """Return the weights of terms in delta(omega^2 - A) but for factors, (n, terms)."""
        weights = jackson(self.count) * np.cos(np.outer(self._angle(omega), np.arange(self.count)))
        weights[:, 0] /= 2
        width = np.sin(self._angle(omega))[:, None]
        return np.divide(weights, width, out=0.0 * weights, where=width > 0)  # none beyond all

    def below(self, moments, omega):
        """Return about how many modes are below frequencies."""
        n, angle = np.arange(1, self.count), self._angle(omega)
        steps = jackson(self.count)[1:] / n
        turned = (moments[1:] * steps) @ np.sin(np.outer(n, angle))
        return (moments[0] * (math.pi - angle) - 2 * turned) / math.pi

    def scatter(self, modes, vectors):
        """Return no less than the standard errors of numbers of modes by so many vectors."""
        modes = np.clip(modes, 1, self.scaled.size)
        return np.sqrt(2 * modes * (1 - modes / self.scaled.size) / vectors)

    def resolution(self):
        """Return how far steps are smoothed at the middles, in omega."""
        scale = self.series.a * self.scaled.mass * self.middle
        return math.pi / self.count * np.sin(self._angle(self.middle)) / scale

    def collect(self, rows, seconds):
        """See `Task`."""
        unit, balls = self.lattice.omega_mx, self.lattice.free_balls
        count = self.below(rows["moments"].mean(axis=0), self.omegas)
        modes = np.diff(count)
        # a bin's width for each ball: what makes modes a density
        widths = balls * np.diff(self.omegas) / unit if unit > 0 else math.nan
        found = {}
        if self.axis is not None:
            found["diffusivity_axis"] = AXES[self.axis]
            found["diffusivity"], found["diffusivity_error"] = self.diffusivity(rows["spread"])
        return Density(
            balls=balls,
            omega_mx=unit,
            solve_seconds=seconds,
            unstable=0 if self.lattice.semidefinite else -1,
            method="moments",
            vectors=len(rows),
            moments=self.count,
            omega=self.omegas,
            count=np.rint(count).astype(int),
            certified=np.zeros(len(count), dtype=bool),
            margin=np.zeros(len(count)),
            middle=self.middle,
            density=modes / widths,
            density_error=self.scatter(modes, len(rows)) / widths,
            count_error=self.scatter(count, len(rows)),
            resolution=self.resolution(),
            **found,
        )

    def diffusivity(self, spread):
        """Return d at the middles, in the medium's units, and its standard error."""
        from scipy.stats import norm, t

        across, level = np.split(spread, 2, axis=1)
        modes, vectors = level.mean(axis=0), len(spread)
        modes[modes <= 0] = math.nan
        ratio = across.mean(axis=0) / modes
        widened = t.ppf(norm.cdf(1.0), vectors - 1) / math.sqrt(vectors)
        error = widened * (across - ratio * level).std(axis=0, ddof=1) / modes
        # pi / 2 omega, and delta(omega^2 - A) is a m / pi times the weights' sum
        factor = self.series.a * self.scaled.mass / (2 * self.middle)
        return factor * ratio, factor * error


def jackson(count):
    """Return Jackson's kernel g_n, n < count."""
    n, step = np.arange(count), math.pi / (count + 1)
    turned = (count - n + 1) * np.cos(n * step) + np.sin(n * step) / math.tan(step)
    return turned / (count + 1)
