"""Sweeps of what patterns of balls pass on to one another; only these need their solver."""

from pgran.driven.sweep import FrequencySweep


class PatternSweep(FrequencySweep):
    """What patterns of balls pass on to one another, at one s = sigma + i omega after the other."""

    def compute(self, point, solver, s):
        """Put into a row what is wanted of the solved patterns. Collective over a group."""

    def solver(self, operators):
        """See `FrequencySweep`."""
        from pgran.driven.patterns import PatternSolver

        return PatternSolver(operators, **self.choices)

    def solve(self, point, solver, s):
        """See `FrequencySweep`."""
        solver.solve(s)
        self.compute(point, solver, s)
        point["backward_error"] = solver.backward_error
