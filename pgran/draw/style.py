"""One style for all figures, and the pages, legends and words that several of them share."""

import contextlib
import textwrap
from contextvars import ContextVar
from itertools import product

import matplotlib
import numpy as np
from matplotlib.colors import LinearSegmentedColormap, to_rgb
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.transforms import offset_copy

from pgran import catalogue
from pgran.errors import FileError
from pgran.store.record import ball_names as ball_names
from pgran.store.si import SI

MM = 1 / 25.4  # in inches
COLUMN, PAGE = 85 * MM, 170 * MM  # widths: one column of a journal, and two
UNIT = "omega_mx"  # how the line that marks it is found
FEW, HANDFUL = 100, 10  # points that are marked by dots, and that make no curve
LETTERS = 15  # to an inch
COLUMNS = 6  # of a legend
LETTERED, BESIDE = 0.25, 0.5  # inches that (a) needs before a title; left of it, and after it
# from -1 to 1: negative numbers are the darker ones in grey
SIGNED = ["#041c4a", "#1f5fa8", "#8fc1e0", "#ffffff", "#fcb398", "#ee6a4a", "#d7301f"]
SIGNED = LinearSegmentedColormap.from_list("signed", SIGNED).with_extremes(bad="#e4e4e4")
LETTER = "abcdefghijklmnopqrstuvwxyz"  # of panels
ACCENT, FAILED, MODE, UNRESOLVED = "#0072B2", "#D00000", "#555555", "#D55E00"
DRIVEN = "#009E73"  # what drives: walls, balls, their motion
RING = {"marker": "o", "linestyle": "none", "markerfacecolor": "white", "markeredgecolor": "black"}
HALO = withStroke(linewidth=3, foreground="white")  # around what lies over data
COLOURS = ("black", "#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9")

RC = {
    "axes.formatter.use_mathtext": True,
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


_asked = ContextVar("width and units", default=(None, None))


@contextlib.contextmanager
def applied(width=None, si=None):
    """Make this style hold for a while, whatever the user's matplotlibrc says.

    `width`: of all pages, in mm, instead of their own. `si`: units of numbers in words, as axes
    will have by `scales.in_si`, instead of the program's.
    """
    before = _asked.set((width and width * MM, si))
    try:
        with matplotlib.rc_context():
            matplotlib.rcdefaults()
            matplotlib.rcParams.update(RC)
            yield
    finally:
        _asked.reset(before)


def wide(width):
    """Return how wide a page is in inches: as is asked for, else `width`."""
    return _asked.get()[0] or width


def units():
    """Return the SI units that are shown."""
    return _asked.get()[1] or SI()


class Page(Figure):
    """A figure that is drawn in this style whenever it is drawn; it needs no window.

    Its `caption` says in words what its `panels` show, its `heading` is the lines above them.
    """

    caption, panels, heading = "", (), ()

    def draw(self, renderer):
        """Draw: matplotlib makes ticks only now, in the style that holds now."""
        with applied():
            # balls keep their shape: only a second layout knows how high such panels are
            if self.get_layout_engine() and any(ax.get_aspect() != "auto" for ax in self.axes):
                self.get_layout_engine().execute(self)
            super().draw(renderer)

    def grow(self, inches):
        """Make room for what stands above the panels: these stay as high as they are."""
        self.set_figheight(self.get_figheight() + inches)


def page(width, height, **panels):
    """Return an empty figure, sizes in inches, and an array of the panels of `Figure.subplots`."""
    figure = Page(figsize=(wide(width), height))
    figure.panels = figure.subplots(squeeze=False, **panels).ravel()
    return figure, figure.panels


def single(draw, captions, width=COLUMN, height=2.3, **shown):
    """Return the page of one panel; see `stack`."""
    return stack([draw], captions, width, height, **shown)


def stack(draws, captions, width=COLUMN, height=2.1, shared=False, **shown):
    """Return a page of panels below each other, each as high as said, with its legend above.

    A panel is `draw(ax, **shown)`; captions are a text, or one a panel, or by the panels' names.
    `shared`: they have one axis of x and one legend.
    """
    figure, panels = page(width, height * len(draws), nrows=len(draws))
    for draw, ax in zip(draws, panels, strict=True):
        draw(ax, **shown)
        if shared:
            ax.label_outer()
    if shared:
        figure.get_layout_engine().set(h_pad=0.01, hspace=0)
    for group in [panels] if shared else [[ax] for ax in panels]:
        legend_above(group)
    figure.align_ylabels()
    if isinstance(captions, dict):
        captions = [captions[draw.__name__] for draw in draws]
    captions = [captions] if isinstance(captions, str) else captions
    letters = [f"({letter}) " for letter in LETTER] if len(captions) > 1 else [""]
    figure.caption = " ".join(map("".join, zip(letters, captions, strict=False)))
    return figure


def grid(count, rows, narrowest, height, **panels):
    """Return an empty page with panels in columns, the panels row by row, and how many columns.

    Of more than `rows` panels there is another column, if none is narrower than `narrowest` then,
    in inches; `height(rows)` is the page's.
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


def heard(result):
    """Return the detectors of a result, shape (nd, dim), None if it has none."""
    records = (getattr(result, group, None) for group in catalogue.RECORDS)
    sites = (getattr(record, "detector", None) for record in records)
    return next((each for each in sites if each is not None), None)


def letter(panels):
    """Put (a), (b) and so on before the titles of several panels."""
    for name, ax in zip(LETTER, panels if len(panels) > 1 else (), strict=False):
        ax.set_title(f"({name}) {ax.get_title(loc='left')}".strip())


def above(figure, *lines, **look):
    """Write lines above all panels, under those that are there, as long as the figure is wide."""
    width = int(LETTERS * figure.get_figwidth())
    wrapped = [part for line in lines for part in textwrap.wrap(line, width)]
    wrapped = min(wrapped, textwrap.wrap("; ".join(lines), width), key=len)
    figure.heading = [*figure.heading, *wrapped]
    figure.suptitle("\n".join(figure.heading), fontsize="medium", **look)
    figure.grow(0.14 * len(wrapped))


def legend_above(panels):
    """Put one legend of all panels above the upper right of the first, where no data can be.

    What several curves of a panel have in common comes last, and the dotted line of omega_mx. It is
    beside the title if two lines hold it there, else above that, as where another panel is beside
    (give the last panel of a row first), in as many columns as fit. The figure grows by as much.
    """
    handles, shared = {}, {}
    for ax in panels:
        drawn, labels = ax.get_legend_handles_labels()
        for handle, label in zip(drawn, labels, strict=True):
            (shared if labels.count(label) > 1 else handles).setdefault(label, handle)
    handles |= shared
    dotted = (line for ax in panels for line in ax.get_lines() if line.get_gid() == UNIT)
    handles |= dict(zip([r"$\omega_{mx}$"], dotted, strict=False))
    if not handles:
        return
    first, figure = panels[0], panels[0].figure
    before = _size(first.get_legend())[1] if first.get_legend() else 0.0
    beside = first.get_subplotspec().get_gridspec().ncols  # a wider legend would push these apart
    room, lines_up = figure.get_figwidth() / beside - 0.5, 1.5 * RC["font.size"]
    places = [(offset_copy(first.transAxes, figure, y=lines_up, units="points"), room)]
    if beside == 1:
        title = _size(first.set_title(first.get_title(loc="left"), loc="left"))[0]
        title += LETTERED * (len(getattr(figure, "panels", ())) > 1)
        places.insert(0, (first.transAxes, room - title - BESIDE * (title > 0)))
        places = places[: 1 + (title > 0)]
    for (place, width), columns in product(places, range(COLUMNS, 0, -1)):
        look = {"loc": "lower right", "bbox_to_anchor": (1, 1), "bbox_transform": place}
        legend = first.legend(handles.values(), handles, ncol=columns, columnspacing=1.2, **look)
        last = place is places[-1][0]
        if _size(legend)[0] <= width and (last or len(handles) <= 2 * columns):
            break
    figure.grow(_size(legend)[1] - before)


def _size(artist):
    """Return width and height of what is drawn, in inches."""
    return artist.get_window_extent().size / artist.figure.dpi


def note(figure, text):
    """Write above all panels what is wrong with a result."""
    above(figure, text, color=FAILED)


def note_missing(figure, record):
    """Say in a figure if modes are missing or inaccurate, in a record of modes or on modes."""
    if record.count_found != record.count_expected:
        note(figure, f"NOT ALL MODES: {record.count_found} of {record.count_expected} found")
    elif not record.count_certified:
        note(figure, "NOT CERTIFIED: some modes are inaccurate")
