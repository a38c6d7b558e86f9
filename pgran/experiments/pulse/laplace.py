"""What follows a pulse in time: the inverse Laplace transform, and what bounds its error.

On the line s = sigma + i omega the displacement of a ball is A(s) U(s), U(s) the transform of the
wall's motion. Taken at omega_k = 2 pi k / P only, the inverse transform

    e^(sigma t) (1 / P) sum over all k of A(s_k) U(s_k) e^(i omega_k t) = sum over n of
    u(t + n P) e^(-sigma n P)

has the later turns in it, damped; what is wrong with A grows by e^(sigma t). The factor e^(sigma T)
is all that doubles allow, GROWTH, and the period P so long that later turns are small enough. Every
part of the error is bounded:

- each amplitude's own bound, times |U| e^(sigma t);
- frequencies left out: |A| <= |S^-1| |f|, and U is known;
- later turns: with E the energy, dE/dt <= |u'| |f|, and so |u'|_2 <= (1/m) int |f|, never more;
  earlier ones, and frequencies above the pulse's highest, are below 1e-16 of what the wall does.
"""

import math

import numpy as np

from pgran.medium.rounding import EPSILON

GROWTH = 16.0  # sigma times the time wanted
SHORTEST = 1.2  # the period, in units of the time wanted
LEFT_OUT = 1e-9  # of the tolerance: what frequencies left out may add up to
LATER = 1e-4  # of the tolerance: what later turns may
AT_ONCE = 300_000  # numbers of a Fourier transform that are kept at once


def largest_amplitudes(limits, s):
    """Return no less than any |A(s)|, sigma > 0. Not collective."""
    size = np.abs(s)
    damped = size * (limits.stability + s.real * limits.mass)
    inertial = limits.mass * size**2 - limits.stiffness - size * limits.damping
    return 1.01 * (limits.drive + size * limits.drive_damping) / np.maximum(damped, inertial)


def largest_speed(limits, pulse, t):
    """Return no less than |u'|_2 up to some times.

    Not collective.

    Parameters
    ----------
    limits : pgran.driven.accurate.Limits
    pulse : pgran.experiments.pulse.wall.Pulse or pgran.experiments.pulse.wall.Samples
    t : float or numpy.ndarray
    """
    moved, turned = pulse.sizes(t)
    return (limits.drive * moved + limits.drive_damping * turned) / limits.mass


class Line:
    """Where on the line of the inverse transform the amplitudes are computed, and what follows.

    Parameters
    ----------
    pulse : pgran.experiments.pulse.wall.Pulse or pgran.experiments.pulse.wall.Samples
    time : float
        How long the signals are wanted.
    points : int
        At so many equal times, 0 and the last included.
    limits : pgran.driven.accurate.Limits
    tolerance : float
        Of displacements, in units of the wall's.
    readings : array_like of float, optional
        |e_d| of each detector, whose displacement is e_d^T u: 1 unless its mass is not the unit.

    Attributes
    ----------
    s : numpy.ndarray, shape (ns,)
    growth : float
        An error of every A(s) is as many times larger in a displacement, at most.
    left_out, left_out_speed : float
        What the frequencies left out add up to in |A|_2, without the factor e^(sigma t).
    """

    def __init__(self, pulse, time, points, limits, tolerance, readings=1.0):
        """Leave out what is too small to matter."""
        self.pulse, self.limits, self.sigma = pulse, limits, GROWTH / time
        self.readings = np.asarray(readings)
        tolerance = tolerance / self.readings.max(initial=1.0)
        later = 3 * time * float(largest_speed(limits, pulse, 3 * time)) / (LATER * tolerance)
        # and so long that the pulse before this one's time 0 is no part of the turn before either
        earlier = max(SHORTEST, 1.0 - pulse.begin / time)
        turn = max(earlier, min(3.0, math.log(max(later, 1.0)) / GROWTH))
        step = time / (points - 1)
        self.times = math.ceil(turn * time / step)  # in a period
        self.period = self.times * step
        self.time = np.linspace(0.0, time, points)
        count = math.ceil(pulse.highest * self.period / (2 * math.pi)) + 1
        s = self.sigma + 2j * np.pi / self.period * np.arange(count)
        U = pulse.transform(s)
        size = 2 / self.period * largest_amplitudes(limits, s) * np.abs(U)
        order = np.argsort(size, kind="stable")
        small = np.cumsum(size[order]) * math.exp(GROWTH) <= LEFT_OUT * tolerance
        small[-1] = False  # something is left even where the wall drives nothing
        out, self.number = order[small], np.sort(order[~small])
        self.s, self.transform = s[self.number], U[self.number]
        self.left_out, self.left_out_speed = size[out].sum(), (size * np.abs(s))[out].sum()
        self._weight = np.where(self.number == 0, 1.0, 2.0) / self.period
        self.growth = math.exp(GROWTH) * np.sum(self._weight * np.abs(self.transform))

    def inverse(self, transforms, finer=1, before=0):
        """Return functions at the times of the signals from their transforms on the line.

        Not collective.

        Parameters
        ----------
        transforms : numpy.ndarray, shape (ns, ...)
        finer : int
            Each step between these times is cut into so many.
        before : int
            So many of the finer steps before the time 0 are wanted, too.

        Returns
        -------
        numpy.ndarray, shape (before + finer (points - 1) + 1, ...)
        """
        from scipy.fft import irfft  # here: SciPy takes its time, and all scenes are imported

        times, count = finer * self.times, finer * (len(self.time) - 1) + 1
        fold = -(-2 * (self.number[-1] + 1) // times)  # so fine a grid holds all frequencies
        n = fold * times
        spectrum = np.zeros((n // 2 + 1, *transforms.shape[1:]), dtype=complex)
        spectrum[self.number] = transforms
        turn = irfft(spectrum, n, axis=0)  # a period, at the end of which is what was before 0
        values = np.concatenate([turn[n - fold * before :: fold], turn[: fold * count : fold]])
        time = np.linspace(0.0, self.time[-1], count)
        time = np.append(-self.period / times * np.arange(before, 0, -1), time)
        growth = np.exp(self.sigma * time) * (n / self.period)
        return values * growth.reshape(-1, *[1] * (values.ndim - 1))

    def at(self, time, transforms):
        """Return functions at any times, shape (times, ...); `inverse` is quicker for many.

        Not collective. Parameters are those of `inverse`.
        """
        found = []
        for part in np.array_split(time, 1 + len(time) * len(self.s) // AT_ONCE):
            turning = self._weight * np.exp(np.outer(part, self.s))
            real, imaginary = (np.ascontiguousarray(x) for x in (turning.real, turning.imag))
            moved = np.tensordot(real, transforms.real, 1)
            found.append(moved - np.tensordot(imaginary, transforms.imag, 1))
        return np.concatenate(found)

    def signals(self, amplitude, bound):
        """Return displacements, velocities, and a bound of the error of each, shape (nt, nd).

        Not collective.

        Parameters
        ----------
        amplitude, bound : numpy.ndarray, shape (ns, nd)
            A(s) of each detector and the bound of its error.
        """
        growth, U = np.exp(self.sigma * self.time)[:, None], self.transform[:, None]
        size, found = np.abs(self.s), []
        steps = len(self.s) + 16 + 6 * math.log2(self.times + len(self.s)) + size * self.period
        rounding = 4 * EPSILON * steps * np.abs(self.transform)
        rounding += self.pulse.rounding(self.s, self.transform)
        for power, left_out, later in (
            (np.ones_like(self.s), self.left_out, self._later(1)),
            (self.s, self.left_out_speed, self._later(0)),
        ):
            weight = (self._weight * np.abs(power))[:, None]
            wrong = weight * (np.abs(U) * bound + rounding[:, None] * np.abs(amplitude))
            found.append(self.inverse(power[:, None] * amplitude * U))
            others = left_out * self.readings, later[:, None] * self.readings
            found.append(1.01 * growth * (wrong.sum(axis=0) + others[0]) + others[1])
        return found

    def summed(self, errors):
        """Return what errors of a function on the line, but for U, add up to without e^(sigma t).

        Not collective; `errors` has the shape (ns,).
        """
        return np.sum(self._weight * np.abs(self.transform) * errors)

    def _later(self, power):
        """Bound what later turns add: |u'| <= V and |u| <= t V at the times t + n P, n >= 1."""
        total = np.zeros_like(self.time)
        for n in range(1, 4):
            t, damped = self.time + n * self.period, math.exp(-n * self.sigma * self.period)
            total += 1.1 * largest_speed(self.limits, self.pulse, t) * t**power * damped
        return total
