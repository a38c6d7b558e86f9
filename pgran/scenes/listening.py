"""What is listened to after a pulse, and the record that signals make."""

import math

import numpy as np

from pgran.machine import check_memory
from pgran.physics import signal
from pgran.results import Signals

FIELDS = 4  # times at which the field is kept
FINE = 0.6  # step times frequency of what is integrated by splines: to about 1e-9


class Listening:
    """What is listened to: the lattice, its detectors, the pulse and the times.

    Parameters
    ----------
    lattice : pgran.physics.lattice.Lattice
    detectors : array_like of int
        Ball indices, flat or one row a detector.
    sent : pgran.physics.pulse.Pulse or pgran.physics.pulse.Samples
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
        check_memory("pulse_points", points * (48 * len(self.sites) + 64 * self.finer))
        self.time = np.linspace(0.0, time, points)
        self.fine = np.linspace(0.0, time, self.finer * (points - 1) + 1)
        self.field_time = np.linspace(sent.centre, time, FIELDS + 1)[1:]

    def signals(self, method, found, error, force, energy, power, **more):
        """Return the record.

        Not collective.

        Parameters
        ----------
        method : str
        found, error : tuple of numpy.ndarray, shape (nt, nd)
            Displacement and velocity, and what these may be wrong by.
        force : numpy.ndarray, shape (times of `fine`,)
            Of the wall, in the unit of `scaled`; so are energies.
        energy : numpy.ndarray, shape (nt,), or None
        power : numpy.ndarray, shape (times of `fine`,), or None
            What the dashpots take; without it that is what is left of the work.
        **more
            Other fields of `Signals`.
        """
        displacement, velocity = found
        envelope = signal.envelopes(displacement, velocity)
        moves = self.sent.moves(self.time)[0]
        work = signal.integral(self.fine, force * self.sent.moves(self.fine, 2)[1])[:: self.finer]
        dissipated = None if energy is None else work - energy
        if power is not None:
            dissipated = signal.integral(self.fine, power)[:: self.finer]
        decay, decay_error = signal.codas(self.time, envelope, error[0])
        return Signals(
            shape=self.sent.shape,
            pulse_omega=self.sent.omega,
            pulse_width=self.sent.width,
            method=method,
            tolerance=self.tolerance,
            wall_arrival=float(signal.arrivals(self.time, moves[:, None], 0 * moves[:, None])[0]),
            arrival=signal.arrivals(self.time, displacement, error[0]),
            centre=signal.centres(self.time, envelope),
            decay=decay,
            decay_error=decay_error,
            time=self.time,
            wall=moves,
            detector=self.sites,
            displacement=displacement,
            velocity=velocity,
            envelope=envelope,
            force=self.unit * force[:: self.finer],
            work=self.unit * work,
            energy=None if energy is None else self.unit * energy,
            dissipated=None if dissipated is None else self.unit * dissipated,
            **more,
        )
