"""Amplitudes of samples against depth: typical and coherent fall, intensity, group delay."""

import math
from functools import cached_property

import numpy as np

from pgran.errors import InputError
from pgran.experiments.ensemble.record import ABOVE_FLOOR, CERTAIN
from pgran.experiments.ensemble.statistics import finite_samples
from pgran.store.estimate import FEWEST_SAMPLES, Estimate, jackknife_samples, plug_in

FEWEST_DEPTHS = 3  # of a straight line
NEWTON = 4  # steps, from a thirtieth of the width of a maximum on
ROUNDING = 1e-20  # the square of what rounding may change ln|A| by


def along(depth, window):
    """Return depths of detectors, ascending, the matrix that averages over each, and lines' depths.

    These are the numbers of the depths in the window; an InputError says if there are too few.
    """
    if not np.all(np.isfinite(depth)):
        raise InputError("depth: every one must be finite")
    depths, place = np.unique(depth, return_inverse=True)
    # one column a depth: 1/n at each of its n detectors, so that numbers @ share are the means
    share = (place[:, None] == np.arange(len(depths))) / np.bincount(place)
    inside = np.flatnonzero((window[0] <= depths) & (depths <= window[1]))
    if len(inside) < FEWEST_DEPTHS:
        few = f"from {window[0]:.3g} to {window[1]:.3g} there are {len(inside)}"
        raise InputError(f"depth: a line needs {FEWEST_DEPTHS} depths, and {few}")
    return depths, share, inside


def certain(measured, where=True):
    """Return an Estimate, NaN where it is not above 0 for certain, and but for some places."""
    kept = where & (measured.value > CERTAIN * measured.error)
    return Estimate(*(np.where(kept, x, math.nan) for x in (measured.value, measured.error)))


class Profiles:
    """Responses of samples at detectors of several depths, and their means against depth.

    `depth` are those of the detectors, shape (nd,); `amplitude` and `derivative` are A and
    dA/domega, shape (samples, nw, nd). Samples that are not finite everywhere are left out, aloud.
    Means have the shape (nw, nx), of frequencies and of `depths`, ascending; detectors of one depth
    are averaged in each sample. Straight lines go through the depths in a window (low, high).
    An InputError says what is too little.
    """

    def __init__(self, depth, amplitude, derivative, window=(-math.inf, math.inf)):
        self.depths, self.share, self.inside = along(depth, window)
        kept = finite_samples(np.where(np.isfinite(derivative), amplitude, math.nan))
        self.samples = np.count_nonzero(kept)
        if self.samples < FEWEST_SAMPLES:
            few = f"{self.samples} samples are too few"
            raise InputError(f"amplitude: {few}; {FEWEST_SAMPLES} are needed")
        self.amplitude, self.derivative = amplitude[kept], derivative[kept]
        self.intensities = np.abs(self.amplitude) ** 2 @ self.share
        if not np.all(self.intensities.any(axis=0)):
            raise InputError("amplitude: it vanishes in all samples")

    @cached_property
    def levels(self):
        """ln|A| of each sample, shape (samples, nw, nx), whose mean is the typical amplitude.

        It averages itself where <|A|^2> is ruled by few samples (Sheng, Introduction to Wave
        Scattering, Localization and Mesoscopic Phenomena, 2006, ch. 8).
        """
        size = np.abs(self.amplitude)
        if np.any(size == 0):
            sample, frequency, detector = np.argwhere(size == 0)[0]
            where = f"sample {sample}, frequency {frequency}, detector {detector}"
            raise InputError(f"amplitude: that of {where} vanishes and has no logarithm")
        return np.log(size) @ self.share

    def _falls(self, values, weights):
        """Return minus the slopes of lines through values (nw, n) at the lines' depths."""
        # least squares: slope = sum w (x - <x>) y / sum w (x - <x>)^2, <x> = sum w x / sum w
        depths = self.depths[self.inside]
        away = depths - (weights @ depths / weights.sum(axis=1))[:, None]
        return -np.sum(weights * away * values, axis=1) / np.sum(weights * away**2, axis=1)

    def _attenuation(self, means):
        """Return 1 / length of means of some samples; depths weigh by 1 / variance of ln|A|."""
        levels = self.levels[..., self.inside]

        def measure(some):
            weights = 1 / (levels[some].var(axis=0) + ROUNDING)
            return self._falls(means(some)[:, self.inside], weights)

        return plug_in(measure, self.samples)

    def attenuation(self):
        """Return 1 / length of the line <ln|A|> = a - depth / length, by frequency."""
        return self._attenuation(lambda some: self.levels[some].mean(axis=0))

    def attenuation_of_intensity(self):
        """Return 1 / length of <|A|^2> ~ exp(-depth / length), by frequency."""
        return self._attenuation(lambda some: np.log(self.intensities[some].mean(axis=0)))

    def straightness(self):
        """Return the probability of residuals as large, were <ln|A|> straight, by frequency.

        The residuals of a line through n depths are p = n - 2 numbers u of each sample, with the
        covariance S over samples. Of N samples T^2 = N <u> S^-1 <u> is p (N - 1) / (N - p) times an
        F of p and N - p degrees (Hotelling, Ann. Math. Stat. 2, 360 (1931)); NaN below 2 n samples.
        """
        from scipy.stats import f

        depths, count = self.depths[self.inside], self.samples
        if count < 2 * len(depths):
            return np.full(self.levels.shape[1], math.nan)
        line = np.stack([np.ones(len(depths)), depths], axis=1)
        residual = self.levels[..., self.inside] @ np.linalg.qr(line, mode="complete")[0][:, 2:]
        mean, p = residual.mean(axis=0)[..., None], len(depths) - 2
        away = residual.transpose(1, 2, 0) - mean
        spread = away @ away.swapaxes(1, 2) / (count - 1) + ROUNDING * np.eye(p)
        square = count * np.sum(mean * np.linalg.solve(spread, mean), axis=(1, 2))
        return f.sf(square * (count - p) / (p * (count - 1)), p, count - p)

    def coherent(self):
        """Return k and 1 / l of the coherent field <A> ~ exp(-i k depth - depth / (2 l)).

        Of N samples without any |<A>|^2 still is <|A|^2> / N on the mean. That floor, the variance
        of the mean, is taken off, and what is left weighs a depth in units of it. k is that of the
        wave, of those longer than two spacings of depths, which phases fit best; unwrapped along
        depths, they would jump with noise. Both are NaN unless |<A>|^2 exceeds its floor
        `ABOVE_FLOOR` times at the first 3 depths, and k unless known to half a turn.
        """
        field, depths = (self.amplitude @ self.share)[..., self.inside], self.depths[self.inside]
        trials = np.linspace(0, math.pi / np.diff(depths).min(), 16 * len(depths))
        waves = np.exp(1j * np.outer(depths, trials))

        def measure(some):
            mean = field[some].mean(axis=0)
            floor = field[some].var(axis=0, ddof=1) / np.count_nonzero(some)
            floor = np.maximum(floor, 1e-12 * np.abs(mean) ** 2)
            weights = np.maximum(np.abs(mean) ** 2 / floor - 1, ROUNDING)
            turn = weights * np.exp(1j * np.angle(mean))
            k = trials[np.argmax(np.abs(turn @ waves), axis=1)]
            for _ in range(NEWTON):  # to the maximum of |sum w exp(i arg <A> + i k depth)|
                wave = turn * np.exp(1j * np.outer(k, depths))
                late = np.angle(wave / wave.sum(axis=1, keepdims=True))
                k = k + self._falls(np.tan(late), weights * np.cos(late))
            fall = self._falls(np.log(weights) + np.log(floor), weights)
            return np.array([k, fall, weights[:, :FEWEST_DEPTHS].min(axis=1)])

        found = plug_in(measure, self.samples)
        value = np.where(found.value[2] > ABOVE_FLOOR - 1, found.value, math.nan)
        k, fall = (Estimate(value[n], found.error[n]) for n in (0, 1))
        return certain(k, k.error * np.ptp(depths) < math.pi), fall

    def delay(self, over=None):
        """Return the mean group delay, each sample's weighted by its intensity.

            tau = < |A|^2 (-d arg A / d omega) > / < |A|^2 > = -< Im(A* dA/domega) > / < |A|^2 >

        For a complex Gaussian field this is the mean delay itself, whose own distribution has no
        variance (van Tiggelen, Sebbah, Stoytchev and Genack, Phys. Rev. E 59, 7166 (1999)); where
        modes of one width Gamma overlap it is 1/Gamma. `over`, shape (n, nw), are averages over
        frequencies, one a row, that are wanted in place of single frequencies.
        """
        return jackknife_samples(self._delay(over), self.samples)

    def delay_growth(self, over=None):
        """Return by how much the mean group delay grows with depth, 1 / speed, by frequency.

        The slope of the straight line through `delay`, all depths alike, with the error over
        samples. What stands and rings between walls has none; what propagates has.
        """
        measure, alike = self._delay(over), np.ones((1, len(self.inside)))
        return jackknife_samples(
            lambda some: -self._falls(measure(some)[:, self.inside], alike), self.samples
        )

    def _delay(self, over):
        """Return the function of a mask of samples that is their mean delay."""
        flow = -np.imag(np.conj(self.amplitude) * self.derivative) @ self.share

        def measure(some):
            late = flow[some].mean(axis=0) / self.intensities[some].mean(axis=0)
            return late if over is None else over @ late

        return measure
