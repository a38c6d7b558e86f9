"""The figure of an accuracy study: error against run time, a colour and a mark a solver."""

import numpy as np
from matplotlib.colors import to_rgb

from pgran.draw import captions, scales, style
from pgran.store.estimate import counted

ALIKE_ERRORS = 10  # errors that differ by less are one line: run times are what is to be seen
MARKS = "os^Dv<>"  # 7, so that with 6 colours no two solvers of 42 look alike


def figures(result, **_):
    """Yield the largest errors against run time, and the names of solvers without a result."""
    accuracy = result.accuracy
    drawn = np.isfinite(accuracy.error_max)
    style.check_any(np.flatnonzero(drawn), "configuration has computed anything")
    alike = np.nanmax(accuracy.error_max) < ALIKE_ERRORS * np.nanmin(accuracy.error_max)
    panel, height = (times, 0.9 + 0.18 * np.count_nonzero(drawn)) if alike else (front, 2.8)
    caption = (
        f"Largest relative error against run time of {accuracy.experiment}, by solvers and the "
        f"tolerances given to them; median of {counted(accuracy.repeats, 'run')}, "
        "bars: from the shortest to the longest."
    )
    figure = style.single(panel, caption, style.PAGE, height, fewest=0, accuracy=accuracy)
    if not np.all(drawn):
        nothing = ", ".join(dict.fromkeys(accuracy.solver[~drawn]))
        style.note(figure, f"without a result, at some tolerance: {nothing}")
    yield "front", figure


def errors(record, _):
    """Return what errors are relative to."""
    reference = captions.number(record.reference_bound)
    return f"The reference's own relative error: at most {reference}."


def times(ax, accuracy):
    """Draw run times as bars, ranges as lines, hollow if some failed."""
    rows = np.flatnonzero(np.isfinite(accuracy.error_max))
    rows = rows[np.argsort(accuracy.seconds[rows], kind="stable")]
    seconds, place = accuracy.seconds[rows], np.arange(len(rows))
    failed = accuracy.failures[rows] > 0
    shades = np.where(failed[:, None], 1.0, to_rgb(style.pale(style.ACCENT)))
    look = {"color": shades, "edgecolor": style.ACCENT, "linewidth": 0.6}
    drawn = ax.barh(place, seconds, 0.7, **look)
    ends = accuracy.seconds_min[rows], accuracy.seconds_max[rows]
    ax.hlines(place, *ends, color="black", linewidth=0.8)
    ax.set_yticks(place, [captions.formulas(label) for label in accuracy.label[rows]])
    ax.invert_yaxis()
    largest = captions.number(accuracy.error_max[rows].max())
    text = f"run time (s), median of {accuracy.repeats}"
    text += "; hollow: some failed" * bool(failed.any())
    text += f"\nrelative errors at most {largest}"
    ax.set(xlabel=text, xlim=(0, 1.02 * ends[1].max()))
    return drawn


def front(ax, accuracy):
    """Draw the largest errors against run time, and the front beyond which no configuration is.

    Thin lines join the tolerances of a solver; bars are the range of the repeats, dashes the bounds
    that the solver itself gives. Configurations with failures are hollow. No error below the
    reference's own can be seen. Returns the lines of the solvers.
    """
    ax.set(xscale="log", yscale="log", ylabel="largest relative error")
    ax.set_xlabel(f"run time (s), median of {accuracy.repeats}")
    drawn, lines = np.isfinite(accuracy.error_max), []
    for number, solver in enumerate(dict.fromkeys(accuracy.solver[drawn])):
        rows = np.flatnonzero(drawn & (accuracy.solver == solver))
        colour, mark = (kinds[number % len(kinds)] for kinds in (style.COLOURS, MARKS))
        lines.append(_solver(ax, accuracy, rows, color=colour, marker=mark))
    alone = {"linestyle": "none"}
    if np.any(accuracy.failures[drawn]):
        hollow = {"marker": "o", "markerfacecolor": "white", "label": "hollow: some failed"}
        ax.plot([], [], color="#777777", **hollow, **alone)
    ax.plot([], [], color="#aaaaaa", marker="_", label="solver's bound", **alone)
    dotted = {"linewidth": 0.6, "linestyle": ":", "label": "reference's bound"}
    ax.axhline(accuracy.reference_bound, color="#777777", **dotted)
    low, high = ax.get_ylim()
    ax.set_ylim(low / 2, max(high, 1000 * low))
    _staircase(ax, accuracy)
    scales.convert(ax.xaxis, 1.0)  # with seconds, not their powers of ten, beside it
    return lines


def _solver(ax, accuracy, rows, **look):
    """Draw the configurations of one solver; return its line."""
    x, y, failed = accuracy.seconds[rows], accuracy.error_max[rows], accuracy.failures[rows] > 0
    pale, bound = style.pale(look["color"]), accuracy.error_bound_max[rows]
    ax.hlines(y, accuracy.seconds_min[rows], accuracy.seconds_max[rows], color=pale, linewidth=2)
    ax.plot(x, bound, linestyle="none", marker="_", color=pale, zorder=1)
    (line,) = ax.plot(x, y, linewidth=0.5, label=accuracy.solver[rows[0]], **look)
    ax.plot(x[failed], y[failed], linestyle="none", markerfacecolor="white", **look)
    return line


def _staircase(ax, accuracy):
    """Draw the front, from the upper edge to the right one."""
    front = np.flatnonzero(accuracy.on_front)
    if front.size:
        front = front[np.argsort(accuracy.seconds[front])]
        seconds, error = accuracy.seconds[front], accuracy.error_max[front]
        x = [seconds[0], *seconds, ax.get_xlim()[1]]
        y = [ax.get_ylim()[1], *error, error[-1]]
        ax.set(xlim=ax.get_xlim(), ylim=ax.get_ylim())
        ax.step(x, y, where="post", color="#cccccc", linewidth=2.5, zorder=0, label="front")
