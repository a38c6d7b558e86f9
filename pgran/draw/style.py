"""One style for all figures, and pages of panels with their legends, captions and notes."""

import contextlib
import inspect
import io
import textwrap
from contextvars import ContextVar

import matplotlib
import numpy as np
from matplotlib.colors import LinearSegmentedColormap, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.transforms import offset_copy

from pgran.errors import FileError
from pgran.store.record import ball_names as ball_names
from pgran.store.si import SI

MM = 1 / 25.4  # in inches
COLUMN, PAGE = 85 * MM, 170 * MM  # widths: one column of a journal, and two
UNIT = "omega_mx"  # how the line that marks it is found
FEW, HANDFUL = 100, 10  # points that are marked by dots, and that make no curve
TOO_FEW = 3  # points that make no panel
LETTERS_AN_INCH = 15  # to an inch
LEGEND_COLUMNS, LEGEND_ROWS = 6, 2  # at most, of a legend
LINE, BESIDE = 1 / 6, 0.75  # inches: of a line of text; for (a), a gap, and numbers of the axis
NAMED = 1.2  # inches of a panel that has room for the name of its axis of y
# from -1 to 1: negative numbers are the darker ones in grey
SIGNED = ["#041c4a", "#1f5fa8", "#8fc1e0", "#ffffff", "#fcb398", "#ee6a4a", "#d7301f"]
SIGNED = LinearSegmentedColormap.from_list("signed", SIGNED).with_extremes(bad="#e4e4e4")
PANEL_LETTERS = "abcdefghijklmnopqrstuvwxyz"  # of panels
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


_asked = ContextVar("width and units", default=(None, None, False))


@contextlib.contextmanager
def applied(width=None, si=None, every=False):
    """Make this style hold for a while, whatever the user's matplotlibrc says.

    `width`: of all pages, in mm, instead of their own. `si`: units of axes and of numbers in words.
    `every` panel is drawn, however few its points are.
    """
    before = _asked.set((width and width * MM, si, every))
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
    """A figure without a window, which is drawn in this style whenever it is drawn.

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

    def _repr_png_(self):
        """Return the picture that a notebook shows."""
        memory = io.BytesIO()
        self.savefig(memory, format="png", dpi=120)
        return memory.getvalue()

    def grow(self, inches):
        """Make room for what stands above the panels: these stay as high as they are."""
        self.set_figheight(self.get_figheight() + inches)


def page(width, height, **panels):
    """Return an empty figure, sizes in inches, and an array of the panels of `Figure.subplots`."""
    figure = Page(figsize=(wide(width), height))
    figure.panels = figure.subplots(squeeze=False, **panels).ravel()
    return figure, figure.panels


def single(draw, caption=None, width=COLUMN, height=2.3, **shown):
    """Return the page of one panel; see `stack`."""
    return stack([draw], caption, width, height, **shown)


def stack(draws, caption=None, width=COLUMN, height=2.1, shared=False, fewest=TOO_FEW, **shown):
    """Return a page of panels below each other, each as high as said, with its legend above.

    A panel is `draw(ax, **shown)`; the caption is a text, or that of their docstrings. `shared`:
    they have one axis of x and one legend. A panel whose curves have up to `fewest` points is left
    out; a page without panels is no figure.
    """
    fewest = 0 if _asked.get()[2] else fewest
    figure, panels = page(width, height * len(draws), nrows=len(draws))
    both = zip(draws, panels, strict=True)
    kept = [draw for draw, ax in both if most_points(draw(ax, **shown)) > fewest]
    if len(kept) < len(draws):
        figure.panels = ()
        if kept:
            figure = stack(kept, caption, width, height, shared, fewest, **shown)
            figure.caption += f" Not drawn: panels of up to {fewest} points."
        return figure
    if shared:
        name_once(panels, 1)
        for ax in panels:
            ax.label_outer()
        figure.get_layout_engine().set(h_pad=0.02, hspace=0)
    figure.caption = caption or lettered(map(caption_of, draws))
    for group in [panels] if shared else [[ax] for ax in panels]:
        legend_above(group)
    figure.align_ylabels()
    return figure


def most_points(drawn):
    """Return how many points the longest has of the curves that were drawn; inf of other things."""
    lines = [_line(each) for each in (drawn if isinstance(drawn, list) else [drawn])]
    if not all(isinstance(line, Line2D) for line in lines):
        return np.inf
    return max((np.ma.masked_invalid(line.get_ydata()).count() for line in lines), default=0)


def _line(drawn):
    """Return the line of points with their errors; what is drawn otherwise."""
    return getattr(drawn, "lines", [drawn])[0]


def name_once(panels, columns):
    """Name axes of y in the first column, of low panels that are alike in the middle one alone."""
    first = range(0, len(panels), columns)
    low = panels[0].figure.get_figheight() / len(first) < NAMED
    if low and len({ax.get_ylabel() for ax in panels}) == 1:
        first = first[len(first) // 2 :][:1]
    for n, ax in enumerate(panels):
        ax.yaxis.label.set_visible(n in first)


def grid(draws, height, rows, narrowest, **shared):
    """Return a page of panels `draw(ax)` in columns, row by row, and how many columns.

    Of more than `rows` panels there is another column, if none is narrower than `narrowest` then,
    in inches; `height(rows)` is the page's. Axes are named once, those of x in each column.
    """
    count = len(draws)
    columns = min(-(-count // rows), max(1, int(wide(PAGE) / narrowest)))
    rows = -(-count // columns)
    figure, made = page(PAGE, height(rows), nrows=rows, ncols=columns, **shared)
    for ax in made[count:]:
        ax.remove()
    figure.panels = made[:count]
    for n, (draw, ax) in enumerate(zip(draws, figure.panels, strict=True)):
        draw(ax)
        lowest = n + columns >= count
        ax.xaxis.label.set_visible(lowest)
        ax.tick_params(labelbottom=lowest or not shared)
    name_once(figure.panels, columns)
    return figure, columns


def caption_of(panel):
    """Return the caption of a panel: the first paragraph of its docstring."""
    function = getattr(panel, "func", panel)  # of a partial one
    return " ".join((inspect.getdoc(function) or "").partition("\n\n")[0].split())


def lettered(texts):
    """Return the captions of several panels as one, each with its letter."""
    texts = list(texts)
    letters = [f"({letter}) " for letter in PANEL_LETTERS] if len(texts) > 1 else [""]
    return " ".join(letter + text for letter, text in zip(letters, texts, strict=False))


def letter(panels):
    """Put (a), (b) and so on before the titles of several panels."""
    for name, ax in zip(PANEL_LETTERS, panels if len(panels) > 1 else (), strict=False):
        ax.set_title(f"({name}) {ax.get_title(loc='left')}".strip())


def title(ax, *facts):
    """Give a panel a title of facts, without those that are empty."""
    ax.set_title(", ".join(filter(None, facts)))


def above(figure, *lines, **look):
    """Write lines above all panels, under those that are there, as long as the figure is wide."""
    width = int(LETTERS_AN_INCH * figure.get_figwidth())
    wrapped = [part for line in lines for part in textwrap.wrap(line, width)]
    wrapped = min(wrapped, textwrap.wrap("; ".join(lines), width), key=len)
    figure.heading = [*figure.heading, *wrapped]
    figure.suptitle("\n".join(figure.heading), fontsize="medium", **look)
    figure.grow(0.14 * len(wrapped))


def note(figure, text):
    """Write above all panels what is wrong with a result."""
    above(figure, text, color=FAILED)


def legend_above(panels):
    """Put one legend of all panels above the upper right of the first, where no data can be.

    In as many columns as fit, read row by row, beside the title or else above it. What several
    curves of a panel have in common comes last, and the dotted line of omega_mx. The figure grows
    by as much. Of panels beside each other give the last of a row first. What two rows have no room
    for the figure's caption lists: the last, of a scale of colours some in between.
    """
    own, common = {}, {}
    entries = [ax.get_legend_handles_labels() for ax in panels]
    for drawn, labels in sorted(entries, key=lambda each: -len(each[1])):  # in one all are in order
        for handle, label in zip(drawn, labels, strict=True):
            (common if labels.count(label) > 1 else own).setdefault(label, handle)
    handles = own | common
    units = [line for ax in panels for line in ax.get_lines() if line.get_gid() == UNIT]
    handles |= dict(zip([r"$\omega_{mx}$"], units, strict=False))
    if not handles:
        return
    first, figure = panels[0], panels[0].figure
    before = getattr(first.get_legend(), "grown", 0.0)
    beside = first.get_subplotspec().get_gridspec().ncols  # a wider legend would push these apart
    room = figure.get_figwidth() / beside - 0.5
    for columns in range(min(LEGEND_COLUMNS, len(handles)), 0, -1):
        listed = _listed(handles, LEGEND_ROWS * columns)
        by_rows = [label for n in range(columns) for label in listed[n::columns]]
        look = {"ncol": columns, "columnspacing": 1.2, "loc": "lower right"}
        shown = [handles[label] for label in by_rows]
        legend = first.legend(shown, by_rows, bbox_to_anchor=(1, 1), **look)
        width, legend.grown = _size(legend)
        if width <= room:
            break
    others = ", ".join(label for label in handles if label not in listed)
    figure.caption += f" Not in the legend: {others}." * bool(others)
    text = first.set_title(first.get_title(loc="left"), loc="left")
    title, several = _size(text)[0], len(getattr(figure, "panels", ())) > 1
    if (title or several) and (beside > 1 or title + BESIDE + width > room):
        raised = offset_copy(first.transAxes, figure, y=LINE, units="inches")
        legend.set_bbox_to_anchor((1, 1), raised)
        legend.grown += LINE
    figure.grow(legend.grown - before)


def _listed(handles, most):
    """Return up to so many labels of a legend: of a scale of colours some, equally far apart."""
    shades = {label: getattr(_line(each), "get_color", str)() for label, each in handles.items()}
    scale = [label for label, shade in shades.items() if np.shape(shade) == (4,)]  # RGBA
    count = max(most - len(handles) + len(scale), 2)
    kept = np.linspace(0, max(len(scale) - 1, 0), count).astype(int)
    left_out = [label for n, label in enumerate(scale) if n not in kept]
    return [label for label in handles if label not in left_out][:most]


def _size(artist):
    """Return width and height of what is drawn, in inches."""
    return artist.get_window_extent().size / artist.figure.dpi


def colours(count):
    """Return a colour for each of `count` lines, apart by lightness too as far as there are few."""
    if count <= len(COLOURS):
        return COLOURS[:count]
    return matplotlib.colormaps["viridis"](np.linspace(0.0, 0.9, count))


def pale(colour):
    """Return a colour mixed with white."""
    return tuple(1 - 0.4 * (1 - part) for part in to_rgb(colour))


def check_any(values, what):
    """Raise a FileError unless there are values to draw."""
    if not np.size(values):
        raise FileError(f"nothing to draw in this result: no {what}")
