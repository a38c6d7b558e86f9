"""Pulses of the driven wall: their motion, its derivatives, its Laplace transform and its size.

All are made of bells exp(-x^2 / 2), x = (t - centre) / width: transforms are exact, and vanish
faster than any power above some frequency.
"""

import math

import numpy as np

from pgran.medium.base import EPSILON

SHAPES = ("gauss", "ricker", "burst", "step")
START = 6.0  # widths from the time 0 to the middle of a pulse: before, it is below 2e-8
BELL_REACH = 9.0  # widths from the middle of a bell to where it is below 3e-18
BELL_START = 11.0  # to where it is below 1e-26
BAND = 3.0  # up to BAND / width the spectrum of a bell is above a hundredth of its largest
HIGHEST = 15.0  # up to HIGHEST / width it is above 1e-40
# Further bells on both sides of the samples: a sample decays by e^(-1/2) a bell.
PADDING = 40


def bells(x, width, carrier, count):
    """Return g = exp(-x^2 / 2 + i carrier width x) and its derivatives, shape (count, ...).

    x is the time from the middle in units of `width`. With z = x - i carrier width the derivatives
    in time are Hermite polynomials times g: g' = -z g / width, and so

        g^(n + 1) = -(z g^(n) + n g^(n - 1) / width) / width.
    """
    z = x - 1j * carrier * width
    derivatives = [np.exp(-0.5 * x * x + 1j * carrier * width * x)]
    for n in range(count - 1):
        before = n * derivatives[n - 1] / width if n else 0.0
        derivatives.append(-(z * derivatives[n] + before) / width)
    return np.array(derivatives)


class Pulse:
    """A motion of the wall: a bell of standard deviation `width`, of height 1, or made of one.

    Its shape is `gauss`, the bell; `ricker`, its second derivative turned over, its spectrum
    largest at `omega`, from which its width follows; `burst`, the bell times cos(omega t); or
    `step`, its integral, from 0 to 1.

    Any motion is below 1e-26 before the time `begin`, as is what is left of it after `rest`; below
    2e-8 before `start`, from which on its work counts, and at rest again to 2e-8 after `end`;
    `centre` is its middle. Its spectrum is above a hundredth of its largest up to the omega `band`,
    above 2e-8 up to `reach`; above `highest` |U(s)| is below 1e-40 of its largest on any line.
    """

    start, size = 0.0, 1.0  # `size` is the unit of `moves`

    def __init__(self, shape, omega, width):
        self.shape, self.omega = shape, omega
        self.width = width = math.sqrt(2) / omega if shape == "ricker" else width
        self._carrier = carrier = omega if shape == "burst" else 0.0  # the bell is multiplied by it
        self.centre = START * width
        self.end = 2 * self.centre
        self.begin, self.rest = self.centre - BELL_START * width, self.centre + BELL_START * width
        self.band, self.reach = carrier + BAND / width, carrier + 2 * BAND / width
        self.highest = carrier + HIGHEST / width

    def moves(self, t, count=1):
        """Return the displacement of the wall and its derivatives, shape (count, *t.shape)."""
        x = (np.asarray(t) - self.centre) / self.width
        if self.shape == "ricker":
            return -(self.width**2) * bells(x, self.width, 0.0, count + 2)[2:].real
        if self.shape == "step":
            from scipy.special import ndtr  # here: SciPy takes its time

            slope = bells(x, self.width, 0.0, count).real / (self.width * math.sqrt(2 * math.pi))
            return np.concatenate([[ndtr(x)], slope[: count - 1]])
        return bells(x, self.width, self._carrier, count).real

    def transform(self, s):
        """Return int U(t) e^(-s t) dt over all times."""
        area, shift = self.width * math.sqrt(2 * math.pi), np.exp(-s * self.centre)

        def bell(s):
            return np.exp(0.5 * (s * self.width) ** 2)

        if self.shape == "step":
            return bell(s) / s * shift
        if self.shape == "ricker":
            return -area * (s * self.width) ** 2 * bell(s) * shift
        if self.shape == "gauss":
            return area * bell(s) * shift
        carrier = 1j * self._carrier
        return 0.5 * area * (bell(s - carrier) + bell(s + carrier)) * shift

    def rounding(self, s, transform):
        """Return no less than the rounding error of a transform at s."""
        size = np.abs(s)
        steps = 16 + size * self.centre + (size * self.width) ** 2
        return 4 * EPSILON * steps * np.abs(transform)

    def sizes(self, t):
        """Return no less than int |U| dt and int |U'| dt up to some times."""
        area, t = self.width * math.sqrt(2 * math.pi), np.maximum(t, self.width)
        moved, turned = {
            "gauss": (area, 2),
            "ricker": (2 * area, 4),
            "burst": (area, 2 + self.omega * area),
            "step": (t, 1),
        }[self.shape]
        return moved * np.ones_like(t), turned * np.ones_like(t)


class Samples:
    """A motion of numbers at equal times, `width` apart, a bell as wide as the spacing at each.

    Before the first number, at time 0, the wall is at rest at 0; after the last one it stays. In
    between this is as smooth a curve as there is: a constant has ripples of 5e-9. The unit is
    `size`, a power of 2, of which the largest number is 1 to 2.

        number              0   1  ...  n - 1              before it 0, after it as the last one
        bell     0  ...  PADDING  ...  PADDING + n - 1  ...  2 PADDING + n - 1
    """

    shape, omega = "file", 0.0

    def __init__(self, values, width):
        self.size = 2.0 ** np.floor(np.log2(np.abs(values).max()))
        self.values, self.width = values / self.size, width
        self.heights = self._heights()
        self._steps = np.diff(self.heights, prepend=0.0)  # from each bell to the next
        self.end = (len(values) - 1) * width
        self.centre = 0.5 * self.end
        margin = (PADDING + BELL_START) * width
        self.begin, self.rest = -margin, self.end + margin
        self.start = self.begin  # the bells of the first samples rise before the time 0
        self.band, self.reach = self._above(0.01), self._above(2e-8)
        self.highest = HIGHEST / width

    def _heights(self):
        """Return the height of each bell, of those before and after the numbers, too."""
        from scipy.linalg import solveh_banded

        motion = np.concatenate(
            [np.zeros(PADDING), self.values, np.full(2 * PADDING, self.values[-1])]
        )
        # At the time of a number the sum of all bells, exp(-j^2 / 2) of one j places away, is it.
        band = np.exp(-0.5 * np.arange(int(BELL_REACH) + 1.0) ** 2)
        heights = solveh_banded(np.outer(band, np.ones(len(motion))), motion, lower=True)
        heights = heights[:-PADDING]  # their own end is felt by those cut off alone
        heights[-1] = motion[-1] / (2 * band.sum() - 1)  # it stands for all that would follow
        return heights

    def _above(self, share):
        """Return up to which omega the spectrum is above a share of its largest.

        Its images beyond the spacing's own frequency do not count.
        """
        size = np.abs(np.fft.rfft(self._steps))[1:]
        size /= np.arange(1, len(size) + 1)
        last = np.flatnonzero(size > share * size.max())[-1]
        return math.pi / self.width * (1 + last) / len(size)

    def moves(self, t, count=1):
        """See `Pulse`."""
        x = np.asarray(t)[..., None] / self.width + PADDING
        near = np.floor(x) + np.arange(-BELL_REACH, BELL_REACH + 2)
        height = self.heights[np.clip(near.astype(int), 0, len(self.heights) - 1)]
        height = np.where(near < 0, 0.0, height)
        return np.sum(height * bells(x - near, self.width, 0.0, count).real, axis=-1)

    def transform(self, s):
        """See `Pulse`."""
        exact = np.asarray(s, dtype=np.clongdouble)  # the sum cancels where U is small
        turn, total = np.exp(-exact * self.width), np.zeros_like(exact)
        for step in self._steps[::-1]:  # Horner's rule: all times are multiples of the spacing
            total = total * turn + step
        return (total * self._factor(exact)).astype(complex)

    def rounding(self, s, transform):
        """See `Pulse`."""
        sizes = np.sum(np.abs(self._steps)) * np.abs(self._factor(s))
        count = len(self._steps) * (1 + np.abs(s) * self.width)
        own = EPSILON * (16 + np.abs(s * self.width) ** 2) * np.abs(transform)
        return 4 * own + 4 * float(np.finfo(np.longdouble).eps) * count * sizes

    def _factor(self, s):
        """Return what the transform has in common to all bells, and what steps add up to."""
        area, shift = self.width * math.sqrt(2 * math.pi), np.exp(s * PADDING * self.width)
        return area * shift * np.exp(0.5 * (s * self.width) ** 2) / -np.expm1(-s * self.width)

    def sizes(self, t):
        """See `Pulse`."""
        area, heights = self.width * math.sqrt(2 * math.pi), np.abs(self.heights)
        # 2.54 is no less than the sum of bells of height 1 that follow each other, sqrt(2 pi)
        moved = area * heights.sum() + np.maximum(t - self.end, 0.0) * 2.54 * heights[-1]
        return moved, np.full_like(moved, 2.54 * np.abs(self._steps).sum())
