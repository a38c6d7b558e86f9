"""The structure factor, frequency by frequency, and the record of it with its oscillators."""

import numpy as np

from pgran.driven.pattern_sweep import PatternSweep
from pgran.experiments.structure.oscillator import fitted, ioffe_regel
from pgran.experiments.structure.record import Structure
from pgran.medium.rounding import EPSILON
from pgran.store.estimate import Estimate, with_errors
from pgran.store.record import columns_of, row_of


class Spectra(PatternSweep):
    """S of groups of waves at sigma + i omega; `sigma` may be one number or one a frequency.

    `waves` are those that fit into the medium.
    """

    def __init__(self, lattice, omegas, sigma, waves, groups, choices):
        self.waves, self.groups = waves, groups
        self.shape = len(waves.branches), len(groups)
        row = row_of(Structure, branch=self.shape[:1], q=self.shape[1:])
        super().__init__(lattice, omegas, None, row, choices, sigma)
        self.patterns, self.places = waves.patterns(groups)

    def without_dashpots(self):
        """Return the same task for the medium without damping."""
        return Spectra(
            self.lattice.undamped(), self.omegas, self.s.real, self.waves, self.groups, self.choices
        )

    def compute(self, point, solver, s):
        """See `PatternSweep`."""
        G, bounds = solver.diagonal(self.patterns)
        bounds = bounds + (len(G) + 8) * EPSILON * np.abs(G)  # what follows is rounded, too
        # Re(s G), of the velocity that a force makes, is -omega Im G at s = i omega
        scale = 2 * self.scaled.mass / np.pi
        value = point["structure_factor"] = self._summed(scale * np.real(s * G))
        bound = point["error_bound"] = self._summed(scale * abs(s) * bounds)
        point["converged_reason"] = np.all(bound <= solver.tolerance * np.abs(value))

    def _summed(self, numbers):
        """Return the sums of the patterns' numbers over each branch and wave number."""
        return np.bincount(self.places, numbers, np.prod(self.shape)).reshape(self.shape)

    def record(self, swept, elastic, seconds):
        """Return the record of the rows with dashpots and without, which may be the same."""
        sweeps = [swept] if elastic is swept else [swept, elastic]
        columns = columns_of(Structure, swept)
        columns["converged_reason"] = np.min([rows["converged_reason"] for rows in sweeps], axis=0)
        frequency, width = self._oscillators(swept)
        _, scattering = self._oscillators(elastic)
        lattice, waves = self.lattice, self.waves
        power = lattice.springs.damped @ (lattice.springs.B @ self.patterns.T) ** 2  # f^T B^T d B f
        dashpots = self._summed(power) * lattice.damping / lattice.mass
        limits = zip(frequency.value, scattering.value, strict=True)
        return Structure(
            **columns,
            **with_errors(frequency=frequency, width=width, scattering=scattering),
            factorizations=sum(int(rows["factorizations"].sum()) for rows in sweeps),
            solve_seconds=seconds,
            omega=self.omegas,
            resolution=self.s.real,
            branch=np.array(waves.branches),
            q=np.array([waves.magnitude(group[0]) for group in self.groups]),
            wavevector=np.array([waves.unit * group[0] for group in self.groups]),
            directions=np.array([len(group) for group in self.groups]),
            dashpots=dashpots + self._summed(lattice.other_widths(self.patterns)),
            ioffe_regel=np.array([ioffe_regel(*branch)[0] for branch in limits]),
        )

    def _oscillators(self, rows):
        """Return Omega and Gamma of each branch and group, an Estimate each."""
        values = np.where(rows["converged_reason"][:, None, None], rows["structure_factor"], np.nan)
        fits = [fitted(self.s, each) for each in values.reshape(len(rows), -1).T]
        numbers = np.array([(fit.value, fit.error) for fit in fits])
        return [Estimate(*each.T.reshape(2, *self.shape)) for each in np.moveaxis(numbers, 2, 0)]
