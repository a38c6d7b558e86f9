"""Sweeps that need whole fields and all adjoints of steady states, with bounds of the errors."""

import numpy as np

from pgran.driven.sweep import FrequencySweep
from pgran.store.record import row_of

MISSED = 0  # the reason of a frequency whose results miss the accuracy asked for


class AdjointSweep(FrequencySweep):
    """Steady states of which more than the amplitudes is computed, frequency by frequency.

    A row holds what `record` declares, but for `missing`, optional arrays with their bounds, which
    the sweep does not compute; `lengths` are those of the record's other axes.
    """

    def __init__(self, lattice, omegas, sites, error_tolerance, record, missing, **lengths):
        without = {*missing, *(f"{name}_bound" for name in missing)}
        lengths |= {"detector_number": (len(sites),), "every_bond": (lattice.bonds,)}
        row = [("field_bound", float), *row_of(record, without, **lengths)]
        choices = {"error_tolerance": error_tolerance, "whole_field": True, "whole_adjoints": True}
        super().__init__(lattice, omegas, sites, row, choices)

    def keep(self, point, solver):
        """See `FrequencySweep`; a frequency without proven bounds misses the accuracy."""
        solver.restart()  # to factor each S: by another's, fields are as good as asked and no more
        if not solver.bounds.proven:
            point["converged_reason"] = min(point["converged_reason"], MISSED)

    @staticmethod
    def systems(point, solver):
        """Return the solved systems, the field's, then each adjoint's, and bounds of their errors.

        Collective over a group. The errors are those of the solutions in the 2-norm.
        """
        bounds = solver.bounds
        errors = [1.01 * bounds.inverse_norm * bounds.adjoint_residual(z) for z in solver.adjoints]
        return [solver.primal, *solver.adjoints], np.array([point["field_bound"], *errors])
