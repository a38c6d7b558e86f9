"""The figures of what a signal depends on: derivatives by bonds, and the power through them."""

import logging
from functools import partial

import numpy as np

from pgran.figures import balls, bonds, style
from pgran.figures.maps import Map

log = logging.getLogger("pgran")
MOST = 3  # frequencies in maps, and detectors with maps of their own
SIGNS = "red: |A| grows with k; blue, hollow: it falls; width: square root"
SUMS = "each ball: sum over its bonds; red: |A| grows with k; blue: it falls"
SLOPE = r"$|d\,\ln|A|\,/\,d\,\ln k|$"


def figures(result, **_):
    """Yield for each detector the map of the derivatives, the flux, how they are distributed."""
    found, medium = result.sensitivity, result.medium
    chosen = few(found)
    if not len(chosen):
        log.warning("no frequency of the sensitivity is as accurate as asked: none is drawn")
        return
    if getattr(medium, "position", medium.shape) is not None:
        for name, d in detectors(found):
            panels = [partial(derivatives, record=found, medium=medium, at=n, d=d) for n in chosen]
            seen = Map(medium, found.detector[d])
            text = SIGNS if seen.each(found.on_bonds(chosen[0], d)) else SUMS
            yield f"sensitivity{name}", page(found, medium, d, panels, "derivative", text)
        panels = [partial(flux, record=found, medium=medium, at=n) for n in chosen]
        text = "wedges: power, from the broad end to the point; width: square root"
        yield "flux", page(found, medium, 0, panels, "power lost at a ball", text)
    figure, (ax,) = style.page(style.COLUMN, 2.5)
    distribution(ax, found, medium)
    figure.set_figheight(2.3 + 0.13 * style.legend_above([ax]))
    figure.caption = "Share of the bonds whose logarithmic derivative is larger."
    note_failed(figure, found)
    yield "distribution", figure
    if medium.group == "lattice":
        yield "bonds", bonds.page(medium, found.detector)


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


def derivatives(ax, record, medium, at, d=0):
    """Draw d ln|A| / d ln k of all bonds at one frequency, in units of the largest that is seen.

    Where bonds are too many to be seen, the sum over the bonds of each ball: what happens if it
    presses harder on all its neighbours. Only bonds that are kept are drawn (`most`). Three
    dimensions: the plane of the detector. Returns what a colour bar is of.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    record : pgran.results.Sensitivity
    medium : pgran.results.LatticeRecord or pgran.results.NetworkRecord
        With positions.
    at : int
        Number of the frequency.
    d : int
        Number of the detector.
    """
    seen, values = Map(medium, record.detector[d]), record.on_bonds(at, d)
    if seen.each(values):
        unit = balls.scale_of(np.nan_to_num(values[seen.numbers]))
        drawn = seen.lines(ax, values / unit)
    else:
        values = seen.summed(np.nan_to_num(values))
        unit = balls.scale_of(values[seen.free])
        drawn = seen.discs(ax, values / unit)
    title(ax, record, medium, at, f"{unit:.3g}", balls.beyond(drawn))
    return drawn


def flux(ax, record, medium, at):
    """Draw the mean power through all bonds at one frequency, and where it is lost.

    The loss of a bond counts half at each of its balls. Returns the balls, coloured in units of the
    largest loss that is seen.

    Parameters are those of `derivatives`.
    """
    seen = Map(medium, record.detector[0])
    lost = 0.5 * seen.summed(record.loss[at])
    largest = np.abs(record.flux[at][seen.numbers]).max(initial=0.0) or 1.0
    drawn = seen.flow(ax, record.flux[at] / largest, lost / (lost[seen.free].max() or 1.0))
    title(ax, record, medium, at, f"power {largest:.2g}", False)
    return drawn


def distribution(ax, record, medium):
    """Draw how many of the bonds change |A| by more than so much, at a few frequencies.

    With `most` only those that are kept. Returns the curves.

    Parameters are those of `derivatives`.
    """
    drawn, total = [], record.flux.shape[1]
    names = style.ball_names(record.detector)
    for n in few(record):
        for d, name in enumerate(names):
            size = np.sort(np.abs(record.log_amplitude[n, d]))[::-1]
            share = np.arange(1, len(size) + 1) / total
            x = record.omega[n] / medium.omega_mx
            label = rf"{x:.4g} $\omega_{{mx}}$" + f", {name}" * (len(names) > 1)
            drawn += ax.plot(size, share, label=label)
    for curve, shade in zip(drawn, style.colours(len(drawn)), strict=True):
        curve.set_color(shade)
    ax.set(xlabel=SLOPE, ylabel="share of bonds with more")
    logarithmic(ax, drawn)
    return drawn


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
