"""The record of a dynamic structure factor, and of the oscillators fitted to it."""

from dataclasses import dataclass

import numpy as np

from pgran.store.record import Frequencies, array, attribute, error_of


@dataclass(frozen=True, eq=False, repr=False)
class Structure(Frequencies):
    """The dynamic structure factor S(q, omega) of plane or standing waves, `nq` wave numbers.

    S is what a medium takes up from forces of the form of a wave, -(2 omega m / pi) Im f^H S^-1 f;
    its integral is 1. At s = sigma + i omega, with a `resolution` sigma, peaks are wider by
    2 sigma, but not the fitted oscillators. These are NaN where none fits. A frequency whose
    `converged_reason` is not positive failed, with dashpots or without.
    """

    group = "structure"
    q: np.ndarray = array("wave number", "1/length")
    branch: np.ndarray = array("polarisation", "1", dtype=str)
    wavevector: np.ndarray = array("wave vector, one of several", "1/length", "q", "coordinate")
    directions: np.ndarray = array("how many wave vectors S is the mean of", "1", "q", dtype=int)
    resolution: np.ndarray = array("sigma, the real part of s", "sqrt(k/m)", "omega")
    structure_factor: np.ndarray = array("S", "sqrt(m/k)", "omega", "branch", "q", row=True)
    error_bound: np.ndarray = error_of(structure_factor, "bound of its error; inf: none is known")
    backward_error: np.ndarray = array(
        "largest |f - S A| / (|S| |A| + |f|) of a wave", "1", "omega", row=True
    )
    frequency: np.ndarray = array("Omega of the oscillator", "sqrt(k/m)", "branch", "q")
    frequency_error: np.ndarray = error_of(frequency)
    width: np.ndarray = array("Gamma of the oscillator", "sqrt(k/m)", "branch", "q")
    width_error: np.ndarray = error_of(width)
    scattering: np.ndarray = array(
        "Gamma without dashpots; with them if sigma is 0", "sqrt(k/m)", "branch", "q"
    )
    scattering_error: np.ndarray = error_of(scattering)
    dashpots: np.ndarray = array(
        "f^H C f / m, the width by dashpots to first order", "sqrt(k/m)", "branch", "q"
    )
    ioffe_regel: np.ndarray = array(
        "Omega where pi scattering = Omega; NaN: not known", "sqrt(k/m)", "branch"
    )

    moments: int | None = attribute(
        "how many moments of each source gave it, with dashpots and without; 0 or none: "
        "factorizations alone",
        optional=True,
    )

    def _branch(self, name):
        """Return S of a branch, shape (nq, nw), None if there is none of that name."""
        found = np.flatnonzero(self.branch == name)
        return self.structure_factor[:, found[0]].T if found.size else None

    @property
    def longitudinal(self):
        """S of longitudinal waves, shape (nq, nw); None where displacements are scalar."""
        return self._branch("longitudinal")

    @property
    def transverse(self):
        """S of transverse waves, shape (nq, nw); None where displacements are scalar."""
        return self._branch("transverse")

    @property
    def scalar(self):
        """S of scalar displacements, shape (nq, nw), or None."""
        return self._branch("scalar")

    @property
    def velocity(self):
        """Phase velocities Omega / q, (branch, q)."""
        return self.frequency / self.q

    @property
    def mean_free_path(self):
        """Phase velocities over rates of scattering, (branch, q)."""
        return self.velocity / self.scattering

    @property
    def coarse(self):
        """Whether frequencies are too far apart for a peak, or for single modes, (branch, q)."""
        apart = np.interp(self.frequency, self.omega, np.gradient(self.omega))
        wider = 2 * np.interp(self.frequency, self.omega, self.resolution)
        own = np.maximum(self.width, 0.0)  # rounding may leave less
        return apart > np.minimum((own + wider) / 4, self.dashpots + wider)

    def exactness(self, number="{:.1e}".format):
        """Return in words how exact S is."""
        good = self.converged_reason > 0
        if not good.any():
            return "no S is as accurate as asked"
        relative = self.error_bound[good] / np.abs(self.structure_factor[good])
        words = f"relative error of every S at most {number(relative.max())}"
        if self.failures:
            words += f"; {self.failures} of {len(good)} frequencies failed or missed the accuracy"
        return words
