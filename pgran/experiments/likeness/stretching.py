"""How alike two signals are in a window, and how far one is stretched or shifted against the other.

x_a and x_b are vectors of equal steps of t, <x, y> = Re sum conj(x) y; y is x_b moved by e:

    CC(e) = <x_a, y> / (|x_a| |y|),    y(t) = x_b(t (1 + e)), x_b(t / (1 + e)) or x_b(t + e).

Errors suppose x_b = X x_a + sqrt(1 - X^2) n, n of the spectrum of x_a but independent of it; p is
this power spectrum, of sum 1, q that of z, the part of dx_a/de across x_a (`pgran manual
comparing` has where they come from):

    var e = (1 - X^2) / X^2 <(n, z)^2> / |z|^4,    var CC = (1 - X^2)^2 <(n, x_a)^2>,
    <(n, z)^2> = sum_k p_k q_(k+1),    half of that for complex signals.
"""

import math

import numpy as np

from pgran.store.estimate import Estimate

TRIALS = 8, 400  # of moves of either sign, at least and at most
ROUNDING = 1e-13  # of the reach
UNLIKE = 3.5  # errors of artanh CC within which strangers are: no move is known
WIDER = 6  # times as far as asked, where B has been heard, no move may be better
MOVES = {  # where x_b is read, and the derivative of that by e; a stretch makes all in B faster
    "response": {
        "stretch": lambda t, e: (t * (1 + e), t),
        "shift": lambda t, e: (t + e, np.ones_like(t)),
    },
    "pulse": {"stretch": lambda t, e: (t / (1 + e), -t / (1 + e) ** 2)},
}


class Pair:
    """Two signals, SciPy's splines, at the equal steps `time` of a window.

    Complex ones over the exponential of the straight line through ln|x_a|, so that no end rules;
    with `logarithm` ln|x|, less its line.
    """

    def __init__(self, a, b, time, logarithm=False):
        self.b, self.time, self.logarithm, self.weight = b, time, logarithm, 1.0
        line = np.stack([np.ones_like(time), time - time.mean()])[: 2 * logarithm]
        self.line = line / np.linalg.norm(line, axis=1, keepdims=True)
        self.raw = self.read(a, time)
        if np.iscomplexobj(self.raw[0]):
            fall, level = np.polyfit(time, np.log(np.abs(self.raw[0])), 1)
            self.weight = np.exp(-level - fall * time)
            self.raw = self.read(a, time)
        self.x, _ = self.unit(*self.raw)
        self.alone = self.noise(self.x)  # 1 / N, N the independent numbers in the window

    def read(self, signal, time):
        """Return a signal at some times, and its derivative."""
        x, slope = signal(time), signal(time, 1)
        if self.logarithm:
            return np.log(np.abs(x)), (slope / x).real
        return self.weight * x, self.weight * slope

    def unit(self, x, slope):
        """Return x without its line as a vector of length 1, and the derivative of that vector."""
        x, slope = (each - self.line.T @ (self.line @ each) for each in (x, slope))
        x, slope = x / np.linalg.norm(x), slope / np.linalg.norm(x)
        return x, slope - np.vdot(x, slope).real * x

    def moved(self, move, e):
        """Return x_b, moved by e, as a vector of length 1, and its derivative by e."""
        time, rate = move(self.time, e)
        y, slope = self.read(self.b, time)
        return self.unit(y, rate * slope)

    def in_part(self, move, e):
        """Return CC(e) over what x_b is known of, 0 of less than half the window."""
        time, (first, *_, last) = move(self.time, e)[0], self.b.x
        known = (first <= time) & (time <= last)
        y, _ = self.unit(*self.read(self.b, np.clip(np.nan_to_num(time), first, last)))
        size = np.linalg.norm(self.x[known]) * np.linalg.norm(y[known])
        return np.vdot(self.x[known], y[known]).real / size if 2 * known.sum() > len(time) else 0.0

    def noise(self, z):
        """Return <(n, z)^2>; neighbours of a periodogram are independent, <p_k^2> = 2 <p_k>^2."""
        p, q = (np.abs(np.fft.fft(each)) ** 2 / len(self.time) for each in (self.x, z))
        return p @ np.roll(q, 1) / (2 if np.iscomplexobj(z) else 1)

    def correlation(self, move=MOVES["pulse"]["stretch"], e=0.0):
        """Return CC(e), an Estimate; its error to first order in 1/N."""
        less = 0.5 * np.linalg.norm(self.x - self.moved(move, e)[0]) ** 2  # 1 - CC, not cancelled
        return Estimate(1 - less, less * (2 - less) * math.sqrt(self.alone * (1 + 2 * self.alone)))

    def best(self, move, reach):
        """Return the move of the largest correlation, at most `reach`, an Estimate, and that one.

        NaN where signals are too little alike, with an infinite error if it is at an end or beyond.
        """
        from scipy.optimize import brentq  # here: SciPy takes its time

        z = self.unit(self.raw[0], move(self.time, 0.0)[1] * self.raw[1])[1]
        steepness = np.linalg.norm(z)  # of x_a with itself 1 - CC is (steepness e)^2 / 2
        trials = np.linspace(-reach, reach, 2 * int(np.clip(2 * reach * steepness, *TRIALS)) + 1)
        found = [[np.vdot(self.x, y).real for y in self.moved(move, e)] for e in trials]
        values, slopes = np.transpose(found)
        top, least = values.argmax(), math.tanh(UNLIKE * math.sqrt(self.alone))
        others = np.linspace(1, WIDER, (WIDER - 1) * len(trials) // 2)  # as dense as these
        with np.errstate(all="ignore"):
            beyond = max(self.in_part(move, e) for e in np.outer([-reach, reach], others).flat)
        if top in (0, len(trials) - 1) or beyond > max(values[top], least):
            return Estimate(math.nan, math.inf), float(values[top])

        def slope(e):
            return np.vdot(self.x, self.moved(move, e)[1]).real

        near, far = trials[top], trials[top + (1 if slopes[top] > 0 else -1)]
        while slope(far) * slopes[top] > 0 and abs(far - near) > ROUNDING * reach:
            far = 0.5 * (near + far)  # where deep minima of ln|x| meet the top is a cusp
        crossed = slope(far) * slopes[top] <= 0
        e = brentq(slope, near, far, xtol=ROUNDING * reach) if crossed else near
        there = self.correlation(move, e).value
        if there < least:
            return Estimate(math.nan, math.nan), there
        less = (1 / there**2 - 1) * (1 + 4 * self.alone)
        return Estimate(float(e), math.sqrt(max(less, 0.0) * self.noise(z)) / steepness**2), there
