"""Sweeps that need whole fields and all adjoints of steady states, with bounds of the errors."""

import numpy as np

from pgran.driven.sweep import FrequencySweep

MISSED = 0  # the reason of a frequency whose results miss the accuracy asked for


class AdjointSweep(FrequencySweep):
    """Steady states of which more than the amplitudes is computed, frequency by frequency.

    Parameters
    ----------
    lattice, omegas, sites
        As of `FrequencySweep`.
    kept : sequence of tuple
        Fields of a row besides the amplitudes at the detectors and the bounds of the errors.
    error_tolerance : float
        Asked of each amplitude.
    """

    def __init__(self, lattice, omegas, sites, kept, error_tolerance):
        """Ask for whole fields."""
        nd = len(sites)
        amplitudes = [
            ("displacement", complex, (nd,)), ("error_bound", float, (nd,)),
            ("field_bound", float), ("converged_reason", np.int64),
        ]  # fmt: skip
        choices = {"error_tolerance": error_tolerance, "whole_field": True, "whole_adjoints": True}
        super().__init__(lattice, omegas, sites, [*amplitudes, *kept], choices)

    def keep(self, point, solver):
        """See `FrequencySweep`; a frequency without proven bounds misses the accuracy."""
        solver.restart()  # to factor each S: by another's, fields are as good as asked and no more
        if not solver.bounds.proven:
            point["converged_reason"] = min(point["converged_reason"], MISSED)

    def systems(self, point, solver):
        """Return the solved systems, that of the field first, and bounds of their errors.

        Collective over a group.

        Returns
        -------
        systems : list
            Of the field and of each detector's adjoint.
        errors : numpy.ndarray
            Bounds of the 2-norm of each solution's error.
        """
        bounds = solver.bounds
        errors = [1.01 * bounds.inverse_norm * bounds.adjoint_residual(z) for z in solver.adjoints]
        return [solver.primal, *solver.adjoints], np.array([point["field_bound"], *errors])
