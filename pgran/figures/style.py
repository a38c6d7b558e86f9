"""One style for all figures, and the marks that several of them share."""

import contextlib

import matplotlib
import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

COLUMN, PAGE = 3.4, 7.0  # widths in inches: one column of a journal, and two
ACCENT, FAILED, MODE = "#0072B2", "#D00000", "#555555"
COLOURS = ("black", "#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9")

RC = {
    "axes.linewidth": 0.6,
    "axes.titlelocation": "left",
    "axes.titlesize": 8,
    "figure.constrained_layout.use": True,
    "figure.dpi": 100,
    "font.family": "sans-serif",
    "font.size": 8,
    "legend.borderaxespad": 0.3,
    "legend.borderpad": 0.0,
    "legend.fontsize": 7,
    "legend.frameon": False,
    "legend.handlelength": 1.6,
    "lines.linewidth": 0.8,
    "lines.markersize": 4,
    "pdf.fonttype": 42,
    "savefig.dpi": 300,
    "xtick.labelsize": 7,
    "xtick.major.size": 3,
    "xtick.major.width": 0.6,
    "ytick.labelsize": 7,
    "ytick.major.size": 3,
    "ytick.major.width": 0.6,
    "ytick.minor.size": 1.5,
}


@contextlib.contextmanager
def applied():
    """Make this style hold for a while, whatever the user's matplotlibrc says."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(RC)
        yield


def new_figure(width, height):
    """Return an empty figure, sizes in inches; no window and no backend is needed for it."""
    return Figure(figsize=(width, height))


def colours(count):
    """Return a colour for each of `count` lines, apart by lightness too as far as there are few."""
    if count <= len(COLOURS):
        return COLOURS[:count]
    return matplotlib.colormaps["viridis"](np.linspace(0.0, 0.9, count))


def ball_name(site):
    """Return what a detector is called in a legend."""
    return f"ball ({', '.join(str(int(index)) for index in site)})"


def pale(colour):
    """Return a colour mixed with white."""
    return tuple(1 - 0.4 * (1 - part) for part in to_rgb(colour))


def legend_above(ax, handles, columns):
    """Put a legend on the upper right of a panel, outside of it, where no data can be."""
    if handles:
        ax.legend(
            handles.values(), handles.keys(), loc="lower right", bbox_to_anchor=(1, 1), ncol=columns
        )


def note(figure, text):
    """Write above all panels what is wrong with a result."""
    figure.suptitle(text, fontsize="medium", color=FAILED)


def draw_good(ax, x, y, good, dots, **line):
    """Draw the good points of a curve, with gaps where points are missing.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    x, y : numpy.ndarray, shape (n,)
    good : numpy.ndarray of bool, shape (n,)
    dots : bool
        Mark every good point by a dot, not only those that stand alone.
    **line
        For `Axes.plot`.

    Returns
    -------
    matplotlib.lines.Line2D
        Its data are `x` and `y`, masked where they are not good.
    """
    padded = np.concatenate(([False], good, [False]))
    lone = good & ~padded[:-2] & ~padded[2:]
    dotted = np.flatnonzero(good if dots else lone).tolist()
    if dotted:
        line |= {"marker": ".", "markevery": dotted, "markeredgewidth": 0}
    (curve,) = ax.plot(x, np.ma.masked_where(~good, y), **line)
    return curve


def upper_limits(record, amplitude):
    """Return the upper limits of amplitudes that are at the floor, NaN for all others.

    Files of version 0.1 hold none.
    """
    if not np.any(getattr(record, "at_floor", 0)):
        return np.full(np.shape(amplitude), np.nan)
    return np.where(record.at_floor > 0, amplitude + record.error_bound, np.nan)


def draw_limits(ax, x, limit, colour):
    """Mark upper limits by triangles that point down; None where all are NaN."""
    if np.isnan(limit).all():
        return None
    style = {"linestyle": "none", "marker": "v", "markersize": 2.5, "markeredgewidth": 0}
    (marks,) = ax.plot(x, limit, color=colour, label="upper limit, at the floor", **style)
    return marks


def mark_failed(ax, x):
    """Mark frequencies without a good result by crosses on the upper edge; None where all are."""
    return _mark(ax, x, 1.0, marker="x", color=FAILED, label="missed the accuracy asked for")


def mark_modes(ax, x):
    """Mark frequencies of normal modes by pluses on the frequency axis (paper: freqres)."""
    return _mark(ax, x, 0.0, marker="+", color=MODE, label="normal modes")


def _mark(ax, x, height, **mark):
    """Draw marks at a height in units of the axes, those inside the limits of `ax`."""
    low, high = ax.get_xlim()
    inside = np.asarray(x)[(low <= x) & (x <= high)]
    if not inside.size:
        return None
    (marks,) = ax.plot(
        inside,
        np.full(inside.size, height),
        transform=ax.get_xaxis_transform(),
        linestyle="none",
        markeredgewidth=0.6,
        clip_on=False,
        scalex=False,
        scaley=False,
        zorder=5,
        **mark,
    )
    return marks
