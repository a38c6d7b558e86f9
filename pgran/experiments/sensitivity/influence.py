"""What figures of sensitivities and of the heater share: maps at a few frequencies, and shares."""

import logging
from functools import partial

import numpy as np

from pgran.draw import balls, style
from pgran.experiments.sensitivity.maps import Map

log = logging.getLogger("pgran")
MOST = 3  # frequencies in maps, and detectors with maps of their own


def few(record):
    """Return the numbers of up to three good frequencies: the middles of as many equal parts."""
    good = np.flatnonzero(record.converged_reason > 0)
    count = min(MOST, len(good))
    return [int(good[(2 * n + 1) * len(good) // (2 * count)]) for n in range(count)]


def detectors(record):
    """Return up to three detectors with the ends of their figures' names; say what is left out."""
    sites = record.detector.tolist()
    if len(sites) > MOST:
        log.warning("maps are drawn of the first %d of %d detectors", MOST, len(sites))
    if len(sites) == 1:
        return [("", 0)]
    return [("_" + "_".join(map(str, site)), d) for d, site in enumerate(sites[:MOST])]


def pages(name, draw, record, medium, what, words):
    """Yield a page of maps for each detector that has its own: its name, and the figure.

    Parameters
    ----------
    name : str
    draw : callable
        Draws a panel: `draw(ax, record, medium, at, d)`.
    record : pgran.results.Sensitivity or pgran.results.Heat
    medium : pgran.results.LatticeRecord or pgran.results.NetworkRecord
        With positions.
    what : str
        That the colours are of.
    words : callable
        Says what is drawn: `words(record, medium, at, d)`.
    """
    chosen = few(record)
    for end, d in detectors(record):
        panels = [partial(draw, record=record, medium=medium, at=n, d=d) for n in chosen]
        text = words(record, medium, chosen[0], d)
        yield f"{name}{end}", page(record, medium, d, panels, what, text)


def on_bonds(ax, seen, values, mean=False):
    """Draw numbers of bonds in units of the largest that is seen; return what is drawn, and it.

    Where bonds are too many to be seen, each ball has the sum over its bonds, or their mean.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    seen : pgran.experiments.sensitivity.maps.Map
    values : numpy.ndarray, shape (bonds,)
        NaN: none.
    mean : bool
    """
    if seen.each(values):
        unit = balls.scale_of(np.nan_to_num(values[seen.numbers]))
        return seen.lines(ax, values / unit), unit
    known = np.isfinite(values)
    values = seen.summed(np.where(known, values, 0.0))
    if mean:
        values /= np.maximum(seen.summed(known), 1)
    unit = balls.scale_of(values[seen.free])
    return seen.discs(ax, values / unit), unit


def shares(values, total=None):
    """Return sizes, the largest first, and which share of the total is as large or larger."""
    size = np.sort(values[np.isfinite(values)])[::-1]
    return size, np.arange(1, len(size) + 1) / (total or max(len(size), 1))


def logarithmic(ax, curves, reach=0.0):
    """Make both axes of a distribution logarithmic, and leave out what is next to nothing.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    curves : list of matplotlib.lines.Line2D
    reach : float
        That the first axis goes beyond at least.
    """
    largest = max((curve.get_xdata().max(initial=0.0) for curve in curves), default=0.0) or 1.0
    right = 2 * max(largest, reach)
    ax.set(xscale="log", yscale="log", ylim=(None, 1), xlim=(1e-5 * largest, right))


def title(ax, record, medium, at, largest, few_beyond):
    """Say in the title of a map which frequency it is at, and its unit."""
    said = "99% within" if few_beyond else "largest"
    x = record.omega[at] / medium.omega_mx
    ax.set_title(rf"$\omega$ = {x:.4g} $\omega_{{mx}}$, {said} {largest}")


def page(record, medium, d, panels, what, text):
    """Return the figure of some maps, with what they show and what failed said above."""
    seen = Map(medium, record.detector[d])
    figure = balls.page(seen.extent, panels, what)
    name, plane = style.ball_names(record.detector[d : d + 1])[0], seen.view.plane
    held = "driven wall: blue" if seen.lattice else "balls at rest: dark; driven: blue"
    where = f"{plane}; " * bool(plane) + f"circle: {name}; {held}"
    shade = style.FAILED if record.failures else "black"
    rows = style.above(figure, where, text, failed(record), color=shade)
    figure.set_figheight(figure.get_figheight() + 0.14 * rows)
    figure.caption = f"Map of the {what}: {text}; {where}."
    return figure


def failed(record):
    """Return how many frequencies are not drawn because they failed, in words."""
    count = f"{record.failures} of {len(record.omega)} frequencies"
    return f"NOT DRAWN: {count} that missed the accuracy asked for" if record.failures else ""


def note_failed(figure, record):
    """Say so in a figure that has no other words above it."""
    if record.failures:
        style.note(figure, failed(record))
