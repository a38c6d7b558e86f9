"""One style for all figures, and the pages, axes, legends and words that several of them share."""

import contextlib
import math
import re
import textwrap
from contextvars import ContextVar

import matplotlib
import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import offset_copy

from pgran.errors import FileError
from pgran.store.fields import ball_names as ball_names

MM = 1 / 25.4  # in inches
COLUMN, PAGE = 85 * MM, 170 * MM  # widths: one column of a journal, and two
UNIT = "omega_mx"  # how the line that marks it is found
FEW, HANDFUL = 100, 10  # points that are marked by dots, and that make no curve
LETTERS, SMALL = 15, 17  # so many to an inch, and of a legend's
SIGNED = "cividis"  # from -1 to 1: the sign is seen in grey, too
HEARD = ("response", "pulse", "relaxation", "sensitivity", "heat", "ensemble")
LETTER = "abcdefghijklmnopqrstuvwxyz"  # of panels
ACCENT, FAILED, MODE, UNRESOLVED = "#0072B2", "#D00000", "#555555", "#D55E00"
COLOURS = ("black", "#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9")

AMPLITUDE = r"amplitude $|A|$ (drive = 1)"
PHASE = "phase (rad)"
FREQUENCY = r"driving frequency $\omega/\omega_{mx}$"
DENSITY = r"modes per ball and $\omega_{mx}$"
TIME = r"time ($1/\omega_{mx}$)"
DELAY = r"group delay ($1/\omega_{mx}$)"
DISTANCE = "distance from the driven wall (spacings)"
ATTENUATION = "attenuation length (spacings)"
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


_asked = ContextVar("width", default=None)


@contextlib.contextmanager
def applied(width=None):
    """Make this style hold for a while, whatever the user's matplotlibrc says.

    Parameters
    ----------
    width : float, optional
        Of all pages, in mm, instead of their own.
    """
    before = _asked.set(width and width * MM)
    try:
        with matplotlib.rc_context():
            matplotlib.rcdefaults()
            matplotlib.rcParams.update(RC)
            yield
    finally:
        _asked.reset(before)


def wide(width):
    """Return how wide a page is in inches: as is asked for, else `width`."""
    return _asked.get() or width


class Page(Figure):
    """A figure that is drawn in this style whenever it is drawn; it needs no window.

    Its `caption` says in words what its `panels` show.
    """

    caption, panels = "", ()

    def draw(self, renderer):
        """Draw: matplotlib makes ticks only now, in the style that holds now."""
        with applied():
            super().draw(renderer)


def page(width, height, **panels):
    """Return an empty figure, sizes in inches, and an array of the panels of `Figure.subplots`."""
    figure = Page(figsize=(wide(width), height))
    figure.panels = figure.subplots(squeeze=False, **panels).ravel()
    return figure, figure.panels


def grid(count, rows, narrowest, height, **panels):
    """Return an empty page with panels in columns, the panels row by row, and how many columns.

    Parameters
    ----------
    count : int
        How many panels.
    rows : int
        Before there is another column.
    narrowest : float
        That a column may be, in inches; then there are more rows.
    height : callable
        Of the page in inches, by the number of rows.
    **panels
        Of `Figure.subplots`.
    """
    columns = min(-(-count // rows), max(1, int(wide(PAGE) / narrowest)))
    rows = -(-count // columns)
    figure, made = page(PAGE, height(rows), nrows=rows, ncols=columns, **panels)
    for ax in made[count:]:
        ax.remove()
    figure.panels = made[:count]
    return figure, figure.panels, columns


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


def driven(lattice):
    """Return what is driven."""
    return "driven wall" if lattice.group == "lattice" else "driven balls"


def heard(result):
    """Return the detectors of a result, shape (nd, dim), None if it has none."""
    records = (getattr(result, name, None) for name in HEARD)
    found = (getattr(record, "detector", None) for record in records)
    return next((sites for sites in found if sites is not None), None)


def limits(x):
    """Return the range of an axis for the points `x`: theirs, and a margin around a handful."""
    margin = 0.05 * (np.ptp(x) or np.max(np.abs(x)) or 1.0) if len(x) <= HANDFUL else 0.0
    return np.min(x) - margin, np.max(x) + margin


def frequencies(ax, x, label=FREQUENCY, within=(0.0, np.inf)):
    """Make an axis one of the frequencies `x`, in units of omega_mx, which is a dotted line.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    x : numpy.ndarray
    label : str
    within : tuple of float
        The part of them that is drawn.
    """
    low, high = limits(x)
    low, high = max(low, within[0]), min(high, within[1])
    ax.set(xlim=(low, high), xlabel=label)
    ax.xaxis.set_major_locator(round_ticks(ax.figure))
    if low < 1 < high:
        look = {"color": MODE, "linewidth": 0.6, "linestyle": (0, (1, 2)), "gid": UNIT}
        ax.axvline(1.0, zorder=0.5, **look)


def letter(panels):
    """Put (a), (b) and so on before the titles of several panels."""
    for name, ax in zip(LETTER, panels if len(panels) > 1 else (), strict=False):
        ax.set_title(f"({name}) {ax.get_title(loc='left')}".strip())


def round_ticks(figure):
    """Return what makes ticks, as many whatever the layout is: that depends on them."""
    return MaxNLocator(6 if figure.get_figwidth() < 1.5 * COLUMN else 10, steps=[1, 2, 2.5, 5, 10])


def symmetric(ax, values, threshold):
    """Make the axis of y linear up to a threshold, logarithmic beyond, with few labels.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    values : numpy.ndarray
        That are drawn.
    threshold : float
    """
    ax.set_yscale("symlog", linthresh=threshold)
    largest = np.max(np.abs(values), initial=threshold)
    ax.set_yticks(symmetric_ticks(threshold, largest))


def symmetric_ticks(threshold, largest):
    """Return 0 and a few powers of ten from a threshold to the largest value, of both signs."""
    low, high = math.ceil(math.log10(threshold)), math.floor(math.log10(largest))
    powers = 10.0 ** np.arange(low, high + 1)[:: -max(1, -(-(high - low + 1) // 3))]
    return [*-powers, 0.0, *powers]


def lettered(said):
    """Return what several panels show as one text."""
    if len(said) == 1:
        return said[0]
    return " ".join(f"({name}) {text}" for name, text in zip(LETTER, said, strict=False))


def above(figure, *lines, **look):
    """Write lines above all panels, as long as the figure is wide."""
    wrapped = [part for line in lines for part in textwrap.wrap(line, characters(figure))]
    figure.suptitle("\n".join(wrapped), fontsize="medium", **look)
    return len(wrapped)


def characters(figure):
    """Return how many letters a line above a figure has."""
    return int(LETTERS * figure.get_figwidth())


def _letters(text):
    """Return about how many letters the longest line of a text has, when its formulas are drawn."""
    drawn = re.sub(r"[${}_^]|\\[,;]", "", re.sub(r"\\[a-zA-Z]+", "x", text))
    return max(map(len, drawn.split("\n")))


def legend_above(panels):
    """Put one legend of all panels above the upper right of the first, where no data can be.

    What several curves of a panel have in common comes last. It is beside the title, or above that
    if there is no room or another panel beside, in as many columns as fit: give the last panel of
    a row first. Returns how many rows there are.
    """
    handles, shared = {}, {}
    for ax in panels:
        drawn, labels = ax.get_legend_handles_labels()
        for handle, label in zip(drawn, labels, strict=True):
            (shared if labels.count(label) > 1 else handles).setdefault(label, handle)
    handles |= shared
    if not handles:
        return 0
    figure, one = panels[0].figure, 7 + max(map(_letters, handles))
    title = _letters(panels[0].get_title(loc="left"))
    title += 4 * (len(getattr(figure, "panels", ())) > 1)
    width, place = figure.get_figwidth() - 0.5, panels[0].transAxes
    alone = panels[0].get_subplotspec().get_gridspec().ncols == 1
    beside = alone and SMALL * (width - title / LETTERS) >= one
    if beside:
        width -= title / LETTERS
    else:
        place = offset_copy(place, figure, y=1.5 * RC["font.size"], units="points")
    columns = max(1, min(4, int(SMALL * width / one)))
    look = {"loc": "lower right", "bbox_to_anchor": (1, 1), "bbox_transform": place}
    panels[0].legend(handles.values(), handles.keys(), ncol=columns, columnspacing=1.2, **look)
    return math.ceil(len(handles) / columns)


def note(figure, text):
    """Write above all panels what is wrong with a result."""
    above(figure, text, color=FAILED)


def note_missing(figure, record):
    """Say in a figure if modes are missing or inaccurate, in a record of modes or on modes."""
    if record.count_found != record.count_expected:
        note(figure, f"NOT ALL MODES: {record.count_found} of {record.count_expected} found")
    elif not record.count_certified:
        note(figure, "NOT CERTIFIED: some modes are inaccurate")


# Numbers of a sample, by their names in `pgran.results.Ensemble`, and their axes.
NUMBERS = {
    "velocity": r"phase velocity ($d\,\omega_{mx}$)",
    "exponent": r"exponent $\psi$ of the spectrum",
    "order": r"bonds that act jointly, $\bar k$",
    "arrival": r"arrival of the front ($\sqrt{m/k}$)",
    "centre": r"centre of the envelope ($\sqrt{m/k}$)",
    "decay": r"rate of decay ($\sqrt{k/m}$)",
    "effective_bonds": "bonds that matter",
    "modes": "modes found",
    "above": r"modes above $\omega_{mx}$",
}


ANY_FREQUENCY = r"frequency $\omega/\omega_{mx}$"
