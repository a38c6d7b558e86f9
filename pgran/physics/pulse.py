"""Pulses of the driven wall, their Laplace transforms, and the inverse transform of what follows.

On the line s = sigma + i omega the displacement of a ball is A(s) U(s), U(s) the transform of the
wall's motion. Taken at omega_k = 2 pi k / P only, the inverse transform

    e^(sigma t) (1 / P) sum over all k of A(s_k) U(s_k) e^(i omega_k t) = sum over n of
    u(t + n P) e^(-sigma n P)

has the later turns in it, damped; what is wrong with A grows by e^(sigma t). With P half as long
again as the time wanted, and sigma P = 24, both are small. Every part of the error is bounded:

- each amplitude's own bound, times |U| e^(sigma t);
- frequencies left out: |A| <= |S^-1| |f|, and U is known;
- later turns: with E the energy, dE/dt <= |u'| |f|, and so |u'|_2 <= (1/m) int |f|, never more;
  earlier ones, and frequencies above `Pulse.highest`, are below 1e-25 of what the wall does.

NumPy only.
"""

import math
from dataclasses import dataclass

import numpy as np

from pgran.physics.rounding import EPSILON

SHAPES = ("gauss", "ricker", "burst", "step")
START = 9.0  # widths from the time 0 to the middle of a pulse: before, it is below 3e-18
SIGMA_PERIOD, TURN = 24.0, 1.5  # sigma P; P in units of the time wanted


@dataclass(frozen=True)
class Pulse:
    """A motion of the wall: a bell of standard deviation `width`, of height 1, or made of one.

    Parameters
    ----------
    shape : str
        `gauss`, the bell; `ricker`, its second derivative turned over, its spectrum largest at
        `omega`; `burst`, the bell times cos(omega t); `step`, its integral.
    omega : float
    width : float
        A ricker's follows from its omega.
    """

    shape: str
    omega: float
    width: float

    def __post_init__(self):
        """Let a ricker have the width of its frequency."""
        if self.shape == "ricker":
            object.__setattr__(self, "width", math.sqrt(2) / self.omega)

    @property
    def centre(self):
        """The time of its middle."""
        return START * self.width

    def wall(self, t):
        """Return the displacement of the wall at some times. Not collective."""
        from scipy.special import ndtr  # here: SciPy takes its time, and all scenes are imported

        x = (np.asarray(t) - self.centre) / self.width
        bell = np.exp(-0.5 * x * x)
        return {
            "gauss": lambda: bell,
            "ricker": lambda: (1 - x * x) * bell,
            "burst": lambda: bell * np.cos(self.omega * self.width * x),
            "step": lambda: ndtr(x),
        }[self.shape]()

    def transform(self, s):
        """Return int U(t) e^(-s t) dt over all times. Not collective."""

        def bell(s):
            return np.exp(0.5 * (s * self.width) ** 2)

        area, shift = self.width * math.sqrt(2 * math.pi), np.exp(-s * self.centre)
        carrier = 1j * self.omega
        return {
            "gauss": lambda: area * bell(s),
            "ricker": lambda: -area * (s * self.width) ** 2 * bell(s),
            "burst": lambda: 0.5 * area * (bell(s - carrier) + bell(s + carrier)),
            "step": lambda: bell(s) / s,
        }[self.shape]() * shift

    def sizes(self, t):
        """Return no less than int |U| dt and int |U'| dt up to some times. Not collective."""
        area, t = self.width * math.sqrt(2 * math.pi), np.maximum(t, self.width)
        one = np.ones_like(t)
        return {
            "gauss": lambda: (area * one, 2 * one),
            "ricker": lambda: (2 * area * one, 4 * one),
            "burst": lambda: (area * one, (2 + self.omega * area) * one),
            "step": lambda: (t, one),
        }[self.shape]()

    def highest(self):
        """Return an omega above which |U| is below 1e-40 of its largest on any line."""
        carrier = self.omega if self.shape == "burst" else 0.0
        return carrier + 15.0 / self.width


@dataclass(frozen=True)
class Limits:
    """What bounds the motion of a lattice.

    Attributes
    ----------
    mass : float
        m.
    stability : float
        beta lambda_min(C).
    stiffness, damping : float
        No less than |K|_2 and |C|_2, all damping in C.
    drive, drive_damping : float
        |f|_2 is at most drive + |s| drive_damping.
    """

    mass: float
    stability: float
    stiffness: float
    damping: float
    drive: float
    drive_damping: float

    def amplitudes(self, s):
        """Return no less than any |A(s)|, sigma > 0. Not collective."""
        size = np.abs(s)
        damped = size * (self.stability + s.real * self.mass)
        inertial = self.mass * size**2 - self.stiffness - size * self.damping
        return 1.01 * (self.drive + size * self.drive_damping) / np.maximum(damped, inertial)

    def speed(self, pulse, t):
        """Return no less than |u'|_2 up to some times. Not collective."""
        moved, turned = pulse.sizes(t)
        return (self.drive * moved + self.drive_damping * turned) / self.mass


class Line:
    """Where on the line of the inverse transform the amplitudes are computed.

    Parameters
    ----------
    pulse : Pulse
    time : float
        How long the signals are wanted.
    limits : Limits
    allowed : float
        What the frequencies left out may add up to, at most, in a displacement.

    Attributes
    ----------
    s : numpy.ndarray, shape (ns,)
    left_out, left_out_speed : float
        What the frequencies left out add up to, without the factor e^(sigma t).
    """

    def __init__(self, pulse, time, limits, allowed):
        """Leave out what is too small to matter."""
        self.pulse, self.limits, self.period = pulse, limits, TURN * time
        self.sigma = SIGMA_PERIOD / self.period
        count = math.ceil(pulse.highest() * self.period / (2 * math.pi)) + 1
        s = self.sigma + 2j * np.pi / self.period * np.arange(count)
        size = 2 / self.period * limits.amplitudes(s) * np.abs(pulse.transform(s))
        order = np.argsort(size, kind="stable")
        small = np.cumsum(size[order]) * math.exp(self.sigma * time) <= allowed
        small[-1] = False  # something is left even where the wall drives nothing
        out = order[small]
        self.s = s[np.sort(order[~small])]
        self.left_out, self.left_out_speed = size[out].sum(), (size * np.abs(s))[out].sum()

    def signals(self, time, amplitude, bound):
        """Return displacements, velocities, and a bound of the error of each, shape (nt, nd).

        Not collective.

        Parameters
        ----------
        time : numpy.ndarray, shape (nt,)
        amplitude, bound : numpy.ndarray, shape (ns, nd)
            A(s) of each detector and the bound of its error.
        """
        s, U = self.s[:, None], self.pulse.transform(self.s)[:, None]
        weight = np.where(self.s.imag == 0, 1.0, 2.0)[:, None] / self.period
        turning = np.exp(1j * np.outer(time, self.s.imag))
        growth = np.exp(self.sigma * time)[:, None]
        rounding = 4 * EPSILON * (len(s) + 16 + np.abs(s) * (self.pulse.centre + self.period))
        found = []
        for power, left_out, later in (
            (1.0, self.left_out, self._later(time, 1)),
            (s, self.left_out_speed, self._later(time, 0)),
        ):
            values = growth * (turning @ (weight * power * amplitude * U)).real
            size = weight * np.abs(power * U)
            wrong = np.sum(size * (bound + rounding * np.abs(amplitude)), axis=0)
            found += [values, 1.01 * growth * (wrong + left_out) + later[:, None]]
        return found

    def _later(self, time, power):
        """Bound what later turns add: |u'| <= V and |u| <= t V at the times t + n P, n >= 1."""
        total = np.zeros_like(time)
        for n in range(1, 4):
            t = time + n * self.period
            total += 1.1 * self.limits.speed(self.pulse, t) * t**power * math.exp(-SIGMA_PERIOD * n)
        return total
