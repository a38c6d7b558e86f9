"""One style for all figures, and the curves, marks and labels that several of them share."""

import contextlib

import matplotlib
import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from pgran.errors import FileError

COLUMN, PAGE = 3.4, 7.0  # widths in inches: one column of a journal, and two
ACCENT, FAILED, MODE, UNRESOLVED = "#0072B2", "#D00000", "#555555", "#D55E00"
COLOURS = ("black", "#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9")

AMPLITUDE = r"amplitude $|A|$ (drive = 1)"
PHASE = "phase (rad)"
FREQUENCY = r"driving frequency $\omega/\omega_{mx}$"
MODE_FREQUENCY = r"mode frequency $\omega_i/\omega_{mx}$"

RC = {
    "axes.linewidth": 0.6,
    "axes.titlelocation": "left",
    "axes.titlesize": 8,
    "figure.constrained_layout.use": True,
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
    "ytick.minor.size": 1.5,
}
for _tick in ("xtick", "ytick"):
    RC |= {f"{_tick}.labelsize": 7, f"{_tick}.major.size": 3, f"{_tick}.major.width": 0.6}


@contextlib.contextmanager
def applied():
    """Make this style hold for a while, whatever the user's matplotlibrc says."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(RC)
        yield


class Page(Figure):
    """A figure that is drawn in this style whenever it is drawn; it needs no window."""

    def draw(self, renderer):
        """Draw: matplotlib makes ticks only now, in the style that holds now."""
        with applied():
            super().draw(renderer)


def page(width, height, **panels):
    """Return an empty figure, sizes in inches, and an array of the panels of `Figure.subplots`."""
    figure = Page(figsize=(width, height))
    return figure, figure.subplots(squeeze=False, **panels).ravel()


def check_any(values, what):
    """Raise a FileError unless there are values to draw."""
    if not np.size(values):
        raise FileError(f"nothing to draw in this result: no {what}")


def colours(count):
    """Return a colour for each of `count` lines, apart by lightness too as far as there are few."""
    if count <= len(COLOURS):
        return COLOURS[:count]
    return matplotlib.colormaps["viridis"](np.linspace(0.0, 0.9, count))


def pale(colour):
    """Return a colour mixed with white."""
    return tuple(1 - 0.4 * (1 - part) for part in to_rgb(colour))


def ball_names(detectors):
    """Return what each detector is called in a legend."""
    sites = np.asarray(detectors).tolist()
    return [f"ball {site[0] if len(site) == 1 else tuple(site)}" for site in sites]


def driven(lattice):
    """Return what is driven."""
    return "driven wall" if lattice.group == "lattice" else "driven balls"


def limits(x, within=(0.0, np.inf)):
    """Return the range of an axis for the points `x`, cut off at the ends of `within`."""
    margin = 0.05 * np.ptp(x) or 0.02
    return max(within[0], x.min() - margin), min(within[1], x.max() + margin)


def columns_of(labels):
    """Return in how many columns a legend of a page's width lists labels beside a title."""
    longest = max(len(line) for label in labels for line in label.split("\n"))
    return max(1, min(4, 90 // (longest + 8)))


def legend_above(panels, columns):
    """Put one legend of all panels above the upper right of the first, where no data can be.

    What several curves of a panel have in common comes last.
    """
    handles, shared = {}, {}
    for ax in panels:
        drawn, labels = ax.get_legend_handles_labels()
        for handle, label in zip(drawn, labels, strict=True):
            (shared if labels.count(label) > 1 else handles).setdefault(label, handle)
    handles |= shared
    if handles:
        place = {"loc": "lower right", "bbox_to_anchor": (1, 1)}
        panels[0].legend(handles.values(), handles.keys(), ncol=columns, **place)


def note(figure, text):
    """Write above all panels what is wrong with a result."""
    figure.suptitle(text, fontsize="medium", color=FAILED)


def note_missing(figure, record):
    """Say in a figure if modes are missing or inaccurate, in a record of modes or on modes."""
    found = len(getattr(record, "mode_omega", record.omega))
    if found != record.count_expected:
        note(figure, f"NOT ALL MODES: {found} of {record.count_expected} found")
    elif not record.count_certified:
        note(figure, "NOT CERTIFIED: some modes are inaccurate")


def curves(ax, x, y, good, labels=None, limit=None, dots=None, **line):
    """Draw curves with gaps where points are not good; return them, masked there.

    A good point that stands alone is a dot, upper limits are triangles that point down. Where
    nothing is good the axis of `y` is hidden.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    x : numpy.ndarray, shape (n,)
    y : numpy.ndarray, shape (n,) or (n, curves)
    good : numpy.ndarray of bool, shape of `y`
    labels : sequence of str, shape (curves,), optional
    limit : numpy.ndarray, shape of `y`, optional
        Upper limits; NaN: none.
    dots : bool, optional
        Mark every good point by a dot. By default those of at most 100.
    **line
        For `Axes.plot`.
    """
    y, good = np.reshape(y, (len(x), -1)), np.reshape(good, (len(x), -1))
    shades, drawn = colours(y.shape[1]), []
    dots = len(x) <= 100 if dots is None else dots
    for n, shade in enumerate(shades):
        padded = np.pad(good[:, n], 1)
        lone = good[:, n] & ~padded[:-2] & ~padded[2:]
        look = {"color": shade, "label": labels[n] if labels else None}
        dotted = np.flatnonzero(good[:, n] if dots else lone).tolist()
        if dotted:
            look |= {"marker": ".", "markevery": dotted, "markeredgewidth": 0}
        drawn += ax.plot(x, np.ma.masked_where(~good[:, n], y[:, n]), **(look | line))
    label = "upper limit, at the floor"
    look = {"linestyle": "none", "marker": "v", "markersize": 2.5, "markeredgewidth": 0}
    for n in [] if limit is None else np.flatnonzero(np.isfinite(limit).any(axis=0)):
        ax.plot(x, limit[:, n], color=drawn[n].get_color(), label=label, **look)
        label = None
    if not np.isfinite(ax.dataLim.height):
        ax.yaxis.set_visible(False)
    return drawn


def upper_limits(record):
    """Return the upper limits of amplitudes that are at the floor, NaN for all others."""
    amplitude = np.abs(record.displacement)
    at_floor = getattr(record, "at_floor", None)
    if at_floor is None:  # a file of version 0.1
        return np.full(amplitude.shape, np.nan)
    return np.where(at_floor > 0, amplitude + record.error_bound, np.nan)


def mark_failed(ax, x):
    """Mark where there is no good result, by crosses on the upper edge."""
    _mark(ax, x, 1.0, marker="x", color=FAILED, label="missed the accuracy asked for")


def mark_unresolved(ax, x):
    """Mark where straight lines between points are not the curve, by ticks on the lower edge."""
    _mark(ax, x, 0.015, marker="|", color=UNRESOLVED, markersize=3, label="curve not resolved")


def mark_modes(ax, x, label="normal modes"):
    """Mark frequencies `x` of modes by pluses on the frequency axis (paper: freqres)."""
    _mark(ax, x, 0.0, marker="+", color=MODE, label=label)


def _mark(ax, x, height, **mark):
    """Draw marks at a height in units of the axes, those inside the limits of `ax`."""
    low, high = ax.get_xlim()
    inside = np.asarray(x)[(low <= x) & (x <= high)]
    if inside.size:
        mark |= {"linestyle": "none", "markeredgewidth": 0.6, "clip_on": False, "zorder": 5}
        place = {"transform": ax.get_xaxis_transform(), "scalex": False, "scaley": False}
        ax.plot(inside, np.full(inside.size, height), **place, **mark)
