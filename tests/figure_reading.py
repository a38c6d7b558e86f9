"""What tests read off the axes of a figure."""

from itertools import zip_longest

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from matplotlib.figure import Figure

from pgran import catalogue
from pgran.draw import pages, style


def draw(panel, *shown, **wanted):
    """One panel in axes of their own."""
    ax = Figure().subplots()
    panel(ax, *shown, **wanted)
    return ax


def page_of(result, name, **over):
    """One page of a result, as `pages.make` makes it, without those after it and its letters."""
    with style.applied():
        pages_of = catalogue.figures(result.scene).figures(result, **over)
        return next(figure for found, figure in pages_of if found == name)


def lines(ax, **wanted):
    """The lines of one panel that have these properties."""
    chosen = ax.get_lines()
    for name, value in wanted.items():
        chosen = [line for line in chosen if getattr(line, f"get_{name}")() == value]
    return chosen


def curves(ax):
    """The lines that are data: not the fits, not the marks."""
    return [line for line in ax.get_lines() if np.ma.isMaskedArray(line.get_ydata(orig=True))]


def gaps(line):
    return list(np.flatnonzero(np.ma.getmaskarray(line.get_ydata(orig=True))))


def marks(ax, marker):
    """Where on the frequency axis there are marks of one kind."""
    return [x for line in lines(ax, marker=marker) for x in line.get_xdata()]


def labels(ax):
    """What a legend of the panel lists."""
    return ax.get_legend_handles_labels()[1]


def note(figure):
    return figure._suptitle.get_text() if figure._suptitle else ""


def lay_out(figure):
    """Place the panels of a page as they are when it is drawn: texts with errors fail, too."""
    with style.applied():
        figure.get_layout_engine().execute(figure)


def rows_of(legend):
    """The rows of a legend; matplotlib has its texts column by column."""
    listed = [text.get_text() for text in legend.get_texts()]
    columns = getattr(legend, "_ncols", None) or legend._ncol  # of matplotlib 3.5
    rows = zip_longest(*np.array_split(listed, columns))
    return [[text for text in row if text is not None] for row in rows]


def legend(figure):
    """What the legend of a page lists, which lies above its panels, whole and within the page.

    Besides the dotted line of omega_mx.
    """
    lay_out(figure)
    (shown,) = (ax.get_legend() for ax in figure.axes if ax.get_legend())
    box = shown.get_window_extent()
    assert all(ax.bbox.y1 <= box.y0 for ax in figure.panels if ax.get_legend())
    assert figure.bbox.padded(1).contains(*box.min)
    assert figure.bbox.padded(1).contains(*box.max)
    texts = [text for row in rows_of(shown) for text in row]
    return [text for text in texts if text != r"$\omega_{mx}$"]


def saving(monkeypatch):
    """Return where figures go that are saved from now on."""
    saved = []
    monkeypatch.setattr(pages, "save", lambda made, path: saved.append(made) or [path])
    return saved
