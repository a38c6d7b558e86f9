"""Normal modes as arrays over the balls: how many take part, what damps, drives and hears them.

To first order in the damping, where modes stand apart, detector d moves by

    A_d = sum_i 2 omega_i R_i / (omega_i^2 - omega^2 + i omega Gamma_i),

with the residues R_i = (e_d^T f_i) (f_i^T f) / (2 m omega_i), f the force of the drive at rest, e_d
what the detector reads. A mode alone has its peak |A_d| = 2 |R_i| / Gamma_i at omega_i.
"""

import math

import numpy as np

from pgran.medium.base import einstein_frequency

RESIDUAL = 1e-12  # of |K|: what a mode must meet
# A frequency smaller than this part of what the stiffest bonds make is that of a mode at rest, but
# for rounding; omega_mx may be any number that the user gives.
ZERO = 1e-6
NUMBERS_AT_ONCE = 1 << 22


def least_frequency(lattice):
    """Return the frequency up to which a mode is at rest."""
    return ZERO * einstein_frequency(lattice.axes, lattice.stiffest, lattice.mass)


def with_fixed_sign(vectors):
    """Return modes with their entry of largest magnitude positive."""
    flat = vectors.reshape(len(vectors), math.prod(vectors.shape[1:]))
    largest = np.argmax(np.abs(flat), axis=1)
    signs = np.where(flat[np.arange(len(flat)), largest] < 0, -1.0, 1.0)
    return (signs[:, None] * flat).reshape(vectors.shape)


def participation(lattice, vectors):
    """Return 1 / sum |f_p|^4 of each mode: how many balls take part."""
    squares = lattice.per_ball(vectors * vectors)
    return 1.0 / np.sum(squares * squares, axis=1)


def modal_widths(lattice, vectors):
    """Return Gamma = beta f^T C f / m of each mode f, C = B^T B of the dashpots, shape (nm,).

    The full width at half power of |A|^2 along omega where the mode stands alone, to first order in
    beta: S f = (m omega_i^2 - m omega^2 + i omega beta C) f, so that
    |f^T A|^2 ~ 1 / ((omega_i - omega)^2 + (Gamma/2)^2). Drag adds f^T alpha f, loss angles
    f^T L f / (m omega_i). The vectors, shape (nm, *lattice.shape),
    may have any length.
    """
    widths, at_once = np.empty(len(vectors)), max(1, NUMBERS_AT_ONCE // lattice.bonds)
    for first in range(0, len(vectors), at_once):
        chunk = vectors[first : first + at_once]
        springs = lattice.stretched(chunk, np.zeros(len(chunk)))
        power = sum(longer**2 @ damped for longer, _, damped in springs)
        size = np.sum(chunk.reshape(len(chunk), -1) ** 2, axis=1)
        some = lattice.damping * power / (lattice.mass * size)
        widths[first : first + at_once] = some + lattice.other_widths(chunk)
    return widths


class Resonances:
    """What the modes of a medium mean to its drive, if it has one, and to detectors, if any."""

    def __init__(self, medium, detectors=None):
        self.medium, self.sites = medium, None
        self.force = medium.driving.ravel()
        self.driven = bool(np.any(self.force))
        if detectors is not None:
            self.sites = medium.sites(detectors, "-modes_detectors")
            self.unknowns, self.weights = medium.readings(self.sites)

    @property
    def left_out(self):
        """Arrays of a mode's row that there are not."""
        return ("source",) * (not self.driven) + ("reading",) * (self.sites is None)

    def of(self, vectors):
        """Return arrays by their names in `record.Modes`, of modes f, a row of `vectors` each."""
        flat = vectors.reshape(len(vectors), self.medium.size)
        found = {"width": modal_widths(self.medium, vectors)}
        if self.driven:
            found["source"] = flat @ self.force
        if self.sites is not None:
            found["reading"] = np.sum(self.weights * flat[:, self.unknowns], axis=2)
        return found

    def residues(self, omega, columns):
        """Return residues, shape (nm, nd), NaN of modes at rest or unstable; None if unknown."""
        if not {"source", "reading"} <= columns.keys():
            return None
        whole = np.where(omega > 0, 2 * self.medium.mass * omega, np.nan)
        return columns["reading"] * (columns["source"] / whole)[:, None]
