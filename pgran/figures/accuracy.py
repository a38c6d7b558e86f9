"""The figure of an accuracy study: error against run time, a colour and a mark a solver."""

import textwrap

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullFormatter

from pgran.errors import FileError
from pgran.figures import style

NEEDS = (
    *("label", "solver", "tolerance", "seconds", "seconds_min", "seconds_max"),
    *("error_max", "error_bound_max", "failures", "on_front", "reference_bound", "repeats"),
)
MARKS = "os^Dv<>"  # 7, so that with 6 colours no two solvers of 42 look alike


def figures(result, modes=None):
    """Yield the name and the figure of an accuracy study.

    Parameters
    ----------
    result : types.SimpleNamespace
        With groups `accuracy` and `lattice`.
    modes
        Not used.

    Raises
    ------
    FileError
        If no configuration has computed anything.
    """
    if not np.isfinite(result.accuracy.error_max).any():
        raise FileError("nothing to draw in this result: no configuration has computed anything")
    yield "front", draw_front(result.accuracy)


def draw_front(accuracy):
    """Return the figure of the largest errors against run time, and of the front.

    Thin lines join the tolerances of a solver; bars are the range of the repeats, dashes the bounds
    that the solver itself gives. Configurations with failures are hollow, and solvers of
    which one computed nothing are named. No error below the reference's own can be seen.
    """
    figure = style.new_figure(style.PAGE, 3.2)
    ax = figure.subplots()
    ax.set(xscale="log", yscale="log")
    drawn = np.isfinite(accuracy.error_max)
    solvers = list(dict.fromkeys(accuracy.solver[drawn]))
    handles = {}
    for number, solver in enumerate(solvers):
        rows = np.flatnonzero(drawn & (accuracy.solver == solver))
        colour, mark = (kinds[number % len(kinds)] for kinds in (style.COLOURS, MARKS))
        draw_solver(ax, accuracy, rows, colour, mark)
        handles[solver] = Line2D([], [], color=colour, marker=mark, linewidth=0.5)
    if np.any(accuracy.failures[drawn]):
        hollow = {"marker": "o", "markerfacecolor": "white", "linestyle": "none"}
        handles["hollow: some failed"] = Line2D([], [], color="#777777", **hollow)
    handles["bound by the solver"] = Line2D([], [], color="#aaaaaa", marker="_", linestyle="none")
    handles["bound of the reference"] = ax.axhline(
        accuracy.reference_bound, color="#777777", linewidth=0.6, linestyle=":"
    )
    low, high = ax.get_ylim()
    ax.set_ylim(low / 2, max(high, 1000 * low))
    draw_staircase(ax, accuracy, handles)
    ax.legend(handles.values(), handles.keys(), loc="upper left", bbox_to_anchor=(1.01, 1))
    times = ax.get_xlim()
    if times[1] < 1000 * times[0]:  # else powers of ten are enough
        ax.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    ax.xaxis.set_major_formatter("{x:g}")
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.set_xlabel(f"run time (s), median of {accuracy.repeats}")
    ax.set_ylabel("largest relative error")
    if not np.all(drawn):
        nothing = ", ".join(dict.fromkeys(accuracy.solver[~drawn]))
        style.note(figure, textwrap.fill(f"without a result, at some tolerance: {nothing}", 100))
    return figure


def draw_solver(ax, accuracy, rows, colour, mark):
    """Draw the configurations of one solver."""
    x, y = accuracy.seconds[rows], accuracy.error_max[rows]
    spread = accuracy.seconds_min[rows], accuracy.seconds_max[rows]
    bound, failed = accuracy.error_bound_max[rows], accuracy.failures[rows] > 0
    ax.plot(x, y, color=colour, linewidth=0.5)
    ax.hlines(y, *spread, color=style.pale(colour), linewidth=2)
    ax.plot(x, bound, linestyle="none", marker="_", color=style.pale(colour), zorder=1)
    for chosen, face in ((~failed, colour), (failed, "white")):
        points = {"linestyle": "none", "marker": mark, "color": colour, "markerfacecolor": face}
        ax.plot(x[chosen], y[chosen], **points)


def draw_staircase(ax, accuracy, handles):
    """Draw the front, beyond which no configuration is."""
    front = np.flatnonzero(accuracy.on_front)
    if not front.size:
        return
    front = front[np.argsort(accuracy.seconds[front])]
    right, top = ax.get_xlim()[1], ax.get_ylim()[1]
    ax.set(xlim=ax.get_xlim(), ylim=ax.get_ylim())
    x = [accuracy.seconds[front[0]], *accuracy.seconds[front], right]
    y = [top, *accuracy.error_max[front], accuracy.error_max[front[-1]]]
    (handles["front"],) = ax.step(x, y, where="post", color="#cccccc", linewidth=2.5, zorder=0)
