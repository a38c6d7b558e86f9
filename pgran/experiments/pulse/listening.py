"""What is listened to after a pulse, and the record that signals make."""

import math

import numpy as np

from pgran.experiments.pulse import signal
from pgran.experiments.pulse.record import Signals
from pgran.run.machine import check_memory

FIELDS = 4  # times at which the field is kept
FINE = 0.6  # step times frequency of what is integrated by splines: to about 1e-9


class Listening:
    """What is listened to: the lattice, its detectors, the pulse and the times.

    Parameters
    ----------
    lattice : pgran.medium.lattice.Lattice
    detectors : array_like of int
        Ball indices, flat or one row a detector.
    sent : pgran.experiments.pulse.wall.Pulse or pgran.experiments.pulse.wall.Samples
    time : float
        How long.
    points : int
        At so many equal times.
    tolerance : float
        Asked of displacements, relative to a signal's largest.
    fields : bool
        Whether the field at FIELDS times is wanted.
    """

    def __init__(self, lattice, detectors, sent, time, points, tolerance, fields):
        """Choose how finely powers are integrated."""
        self.lattice, self.sent, self.tolerance, self.fields = lattice, sent, tolerance, fields
        self.sites = lattice.sites(detectors)
        self.scaled, self.unit = lattice.in_own_unit()
        self.highest = math.sqrt(self.scaled.stiffness_norm / self.scaled.mass)  # of normal modes
        step = time / (points - 1)
        self.finer = math.ceil(2 * step * sent.reach / FINE)
        self.before = math.ceil(-sent.start * self.finer / step)
        fine = points * self.finer + self.before
        check_memory("pulse_points", 48 * points * len(self.sites) + 64 * fine)
        self.time = np.linspace(0.0, time, points)
        fine = np.linspace(0.0, time, self.finer * (points - 1) + 1)
        self.fine = np.append(-step / self.finer * np.arange(self.before, 0, -1), fine)
        self.field_time = np.linspace(sent.centre, time, FIELDS + 1)[1:]

    @property
    def speed(self):
        """The wall's velocity at the times of `fine`."""
        return self.sent.moves(self.fine, 2)[1]

    def coarse(self, values):
        """Return values at the times of the signals from those at the times of `fine`."""
        return values[self.before :: self.finer]

    def integral(self, power):
        """Return the integral of a power, given at the times of `fine`, until each time.

        Not collective. And an estimate of its error: the largest so far of its difference from the
        integral by every second time.
        """
        found = self.coarse(signal.integral(self.fine, power))
        rare = slice((len(self.fine) - 1) % 2, None, 2)  # the last one, too
        rougher = signal.integral(self.fine[rare], power[rare], self.time)
        return found, np.maximum.accumulate(np.abs(found - rougher))

    def signals(self, method, found, error, taken, **more):
        """Return the record.

        Not collective.

        Parameters
        ----------
        method : str
        found, error : tuple of numpy.ndarray, shape (nt, nd)
            Displacement and velocity, and what these may be wrong by.
        taken : dict of str: (numpy.ndarray, numpy.ndarray), shapes (nt,)
            Force and work of the wall, energy and what the dashpots took, where they are known, and
            estimates of their errors, in the unit of `scaled`.
        **more
            Other fields of `Signals`.
        """
        displacement, velocity = found
        envelope = signal.envelopes(displacement, velocity)
        moves, speed = self.sent.moves(self.time, 2)
        wall_arrival = float(signal.arrivals(self.time, speed[:, None], 0 * speed[:, None])[0])
        for name, (values, estimate) in taken.items():
            more |= {name: self.unit * values, f"{name}_estimate": self.unit * estimate}
        decay, decay_error = signal.codas(self.time, envelope, error[0])
        return Signals(
            shape=self.sent.shape,
            pulse_omega=self.sent.omega,
            pulse_width=self.sent.width,
            method=method,
            tolerance=self.tolerance,
            wall_arrival=wall_arrival,
            arrival=signal.arrivals(self.time, velocity, error[1], wall_arrival),
            centre=signal.centres(self.time, envelope),
            decay=decay,
            decay_error=decay_error,
            time=self.time,
            wall=moves,
            detector=self.sites,
            displacement=displacement,
            velocity=velocity,
            envelope=envelope,
            **more,
        )
