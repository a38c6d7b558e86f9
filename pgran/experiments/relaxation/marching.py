"""The amplitudes along a stretch of changes of bonds, by windows or step by step."""

import numpy as np

from pgran.driven.accurate import is_accurate
from pgran.experiments.relaxation.windows import Windows


def march_windows(changing, solver, s, changes, window):
    """Return the amplitudes before and after each change, their bounds, and how windows drift.

    Collective. Each window starts from a state solved for afresh, which is compared with what the
    window before made of it.

    Parameters
    ----------
    changing : pgran.experiments.relaxation.changing.ChangingBonds
    solver : pgran.driven.steady.SteadySolver
    s : complex
    changes : pgran.experiments.relaxation.changes.Changes
    window : int
        Steps to a window, at most.
    """
    found = np.empty((len(changes) + 1, len(solver.adjoints)), dtype=complex)
    bound = np.empty(found.shape)
    drift = np.zeros(len(found))
    done, known, reach = 0, 0, window
    with Windows(changing, solver, s) as windows:
        while True:
            start, start_bound = as_asked(windows.start())
            if done and known == done:
                compared = is_accurate(start_bound, start, solver.tolerance)
                compared &= is_accurate(bound[done], found[done], solver.tolerance)
                moved = np.abs(found[done] - start)[compared] / np.abs(start[compared])
                drift[done] = moved.max(initial=0.0)
            found[done], bound[done] = start, start_bound
            if done == len(changes):
                return found, bound, drift
            after, after_bound = windows.follow(changes[done : done + reach])
            known = done + len(after)
            found[done + 1 : known + 1], bound[done + 1 : known + 1] = after, after_bound
            steps = max(1, len(after))
            changing.apply(changes[done : done + steps])
            done += steps
            reach = min(window, 2 * steps)  # after an early end not much more may be reached


def march_steps(changing, solver, s, changes, direct):
    """Return the amplitudes before and after each change, solved for one by one; their bounds.

    Collective. Parameters are those of `march_windows`; `direct` says to factor at each step.
    """
    states = [as_asked(solver.solve(s))]
    for step in range(len(changes)):
        changing.apply(changes[step : step + 1])
        if direct:
            solver.restart()
        states.append(as_asked(solver.solve(s)))
    found, bound = zip(*states, strict=True)
    return np.stack(found), np.stack(bound), np.zeros(len(found))


def as_asked(state):
    """Return a state's amplitudes and bounds, NaN if they miss their accuracy. Not collective."""
    if state.converged_reason > 0:
        return state.displacement, state.error_bound
    missing = np.full(state.displacement.shape, np.nan)
    return missing, missing
