"""Sweeps over frequencies by either way: a factorization each, or one recurrence for all."""

import contextlib

import numpy as np

from pgran.driven.drive import FEW, TOGETHER, FrequencySweep
from pgran.errors import InputError
from pgran.run.agreement import on_root
from pgran.run.experiment import option
from pgran.run.task import carry_out

METHOD = option(
    "auto",
    "factor, a factorization a frequency; moments, one recurrence, a product of the matrix a term, "
    "for all of them but those that it misses; auto, what is quicker",
    choices=("auto", "factor", "moments"),
)


def carry_out_sweep(sweep, method, crew, progress):
    """Return the rows of a sweep on rank 0, None on others, and how many moments. Collective.

    `sweep` has a method `by_moments(group)`, which gives a `moment_sweep.MomentSweep`. Frequencies
    that moments miss, or for which a series is too long, are solved with factorizations.
    """
    # several sources share out the ranks, one alone takes them all
    least = TOGETHER if len(sweep.sources) >= crew.groups else FEW
    with crew.together(sweep.scaled.size > least), contextlib.ExitStack() as held:
        task = None if method == "factor" else _chosen(sweep, method, crew, held)
        rows = None if task is None else carry_out(task, crew, progress)
    if task is None:
        return carry_out(sweep, crew, progress), 0
    missed = on_root(crew.world, lambda: np.flatnonzero(rows["converged_reason"] <= 0).tolist())
    if missed:
        solved = carry_out(sweep.part(missed), crew, progress)
        if rows is not None:
            rows[missed] = solved
    return rows, task.count


def _chosen(sweep, method, crew, held):
    """Return a sweep by moments, which `held` destroys, None where auto takes none. Collective."""
    from pgran.driven.recurrence import NoSeriesError

    try:
        task = held.enter_context(sweep.by_moments(crew.group))
        return task if task.choose(method, crew.world) else None
    except NoSeriesError as error:
        if method == "moments":
            raise InputError(f"{sweep.by} moments: no series for {error}; take auto") from None
        return None


class PatternSweep(FrequencySweep):
    """What patterns of balls pass on to one another, at one s = sigma + i omega after the other.

    A scene puts into a row, in `keep`, what it wants of the solved patterns: of what its `sources`
    give its `receivers`, or themselves if there are none.
    """

    receivers = None

    def by_moments(self, group):
        """Return the same by moments. Collective."""
        from pgran.driven.moment_sweep import PatternMoments

        return PatternMoments(self, group)

    def solver(self, operators):
        """See `FrequencySweep`."""
        from pgran.driven.patterns import PatternSolver

        return PatternSolver(operators, **self.choices)

    def solve(self, point, solver, s):
        """See `FrequencySweep`."""
        solver.solve(s)
        self.keep(point, solver)
        point["backward_error"] = solver.backward_error
