"""Curves and series of known law, and whether repeated estimates and their errors are right."""

import math

import numpy as np
from scipy.interpolate import CubicHermiteSpline as Spline

from pgran.experiments.likeness.compare import Pair

STEPS_OF_PERIOD = 2  # of what is made, to what is kept: FFTs repeat themselves


def fair(estimates, truth):
    """Assert that the mean of estimates is the truth, within 3 standard errors of their spread.

    Their spread must be what they claim as their error, to a fifth. Numbers or arrays.
    """
    values = np.array([e.value for e in estimates])
    claimed = np.sqrt(np.mean(np.square([e.error for e in estimates]), axis=0))
    found = values.std(axis=0, ddof=1)
    missed = np.abs(values.mean(axis=0) - truth) / (found / math.sqrt(len(values)))
    assert np.all(missed < 3), (values.mean(axis=0), truth, missed)
    ratio = found / claimed
    assert np.all(np.abs(ratio - 1) < 0.2), ratio


def complex_normal(rng, *shape):
    """Complex Gaussian numbers with <|g|^2> = 1."""
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / math.sqrt(2)


def gaussian_fields(rng, samples, points, gamma, step):
    """Return omega, A and dA/domega of complex Gaussian fields with <I> = 1.

    A = sum_t g(t) exp(-i omega t), <|g|^2> ~ exp(-Gamma t): correlation 1 / (1 + i s / Gamma).
    """
    count = STEPS_OF_PERIOD * points
    t = (np.arange(count) + 0.5) * 2 * np.pi / (count * step)
    g = complex_normal(rng, samples, count) * np.exp(-gamma * t / 2)
    g /= math.sqrt(np.sum(np.exp(-gamma * t)))
    omega = step * np.arange(points)
    turn = np.exp(-1j * omega * t[0])  # of the half step that t begins with
    fields = (np.fft.fft(x, axis=1)[:, :points] * turn for x in (g, -1j * t * g))
    return 0.5 + omega, *fields


def lorentzian(shift, gamma):
    """The correlation of the intensity where many modes of one width overlap."""
    return 1 / (1 + (np.asarray(shift) / gamma) ** 2)


def mean_intensity(curves):
    """<I> over samples and window: the simplest estimate of `noise.NoisyCurves`."""
    return curves.estimate(lambda x: curves.average(x.mean(axis=0)))


def lorentzians(rng, samples, omega, gamma, overlap):
    """Return sums of modes of one width at random frequencies, strengths complex Gaussian.

    <I^2>/<I>^2 = 2 + 2 / (pi overlap), by Campbell's theorem for shot noise.
    """
    low, high = omega[0] - 40 * gamma, omega[-1] + 40 * gamma
    out = np.empty((samples, len(omega)), dtype=complex)
    for row in out:
        count = rng.poisson(overlap / gamma * (high - low))
        place, g = rng.uniform(low, high, count), complex_normal(rng, count)
        row[:] = (1 / (place - omega[:, None] + 0.5j * gamma)) @ g
    return out


class BondSums:
    """Sums over products of k bonds of M, whose variances W_k by order are known exactly.

    Bonds 1 to k, k + 1 to 2k, ... make the products of the order k, which has one of the `weights`.
    """

    def __init__(self, bonds, weights):
        self.bonds, self.weights = bonds, weights
        self.W = {k: (bonds // k) * w**2 for k, w in weights.items()}  # of bonds of variance 1

    @property
    def order(self):
        """The mean order kbar."""
        return sum(k * w for k, w in self.W.items()) / sum(self.W.values())

    def covariance(self, lags):
        """C(t)."""
        return sum(w * (1 - k / self.bonds) ** np.asarray(lags) for k, w in self.W.items())

    def series(self, rng, steps):
        """B after each step, one bond a step redrawn."""
        bond = np.concatenate([np.arange(self.bonds), rng.integers(self.bonds, size=steps)])
        time = np.arange(len(bond))
        last = np.where(bond[:, None] == np.arange(self.bonds), time[:, None], 0)
        x = rng.uniform(-math.sqrt(3), math.sqrt(3), len(bond))
        x = x[np.maximum.accumulate(last, axis=0)[self.bonds :]]
        B = 5.0
        for k, w in self.weights.items():
            whole = self.bonds // k * k
            B = B + w * x[:, :whole].reshape(steps, -1, k).prod(axis=2).sum(axis=1)
        return B


SPREAD, CODA = 0.2, (200.0, 400.0)  # of the power spectrum around 1, and the window of codas


def codas(rng, alike, stretch, complex_ones=False):
    """Return a pair of Gaussian codas, whose correlation is `alike` on the mean once stretched."""
    time, omega = np.arange(190, 410, 0.4), np.linspace(0.001, 2, 160) + rng.uniform(0, 0.01)
    g, n = np.exp(-((omega - 1) ** 2) / (4 * SPREAD**2)) * complex_normal(rng, 2, len(omega))
    signals = []
    for strength, speed in ((g, 1.0), (alike * g + math.sqrt(1 - alike**2) * n, 1 + stretch)):
        turns = np.exp(1j * np.outer(time * speed, omega))
        both = turns @ strength, turns @ (1j * omega * speed * strength)
        signals.append(Spline(time, *(both if complex_ones else np.real(both))))
    return Pair(*signals, np.linspace(*CODA, 500))


def weaver(alike):
    """The error of a stretch of these codas by Weaver et al., their T and omega_c^2 put in."""
    squares = SPREAD * (1 + SPREAD**2) * (CODA[1] ** 3 - CODA[0] ** 3)
    return math.sqrt((1 / alike**2 - 1) * 1.5 * math.sqrt(math.pi) / squares)
