"""The figures of normal modes: shapes, participation, density (paper: modepic)."""

import math
from functools import partial

import numpy as np

from pgran.draw import balls, network, style, together
from pgran.draw.view import View
from pgran.medium.space import everywhere

SAID = {
    "shapes": "Shapes of normal modes, each in units of its largest displacement; $P_i$: how many "
    "balls take part.",
    "participation": "Participation ratio $P_i$ of each normal mode against its frequency.",
    "density": "Density of the normal modes per ball and $\\omega_{mx}$; its area is the share of "
    "the modes that are shown.",
}
NEAR = 0.05  # omega_mx: modes around the middle one that is pictured


def figures(result, **_):
    """Yield three shapes if they are stored, participation ratios, the density of many modes."""
    record, lattice, made = result.modes, result.medium, {}
    style.check_any(record.omega, "modes")
    if record.vector is not None and lattice.has_places:
        made["shapes"] = _shapes_page(record, lattice)
    many = len(record.omega) >= 20 and np.ptp(record.omega) > 0
    for panel in (participation, density) if many else (participation,):
        figure, (ax,) = style.page(style.COLUMN, 2.5)
        panel(ax, record, lattice)
        figure.caption = SAID[panel.__name__]
        made[panel.__name__] = figure
    for name, figure in made.items():
        style.note_missing(figure, record)
        yield name, figure


def shape(ax, modes, lattice, mode):
    """Draw the shape of one mode in units of its largest entry (paper: modepic).

    Colours from -1, dark blue, to 1, yellow. Three dimensions: the plane through the largest entry.
    One: a line from wall to wall. Of a network the displacements, as `network.motion` draws them.
    Returns the image, the line, or arrows or balls.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    modes : pgran.results.Modes
        With `vector`.
    lattice : pgran.results.LatticeRecord or pgran.results.NetworkRecord
    mode : int
        Which one, the lowest is 0.
    """
    values = modes.vector[mode]
    if lattice.group == "network":
        values = lattice.built.displacements(values)
        moved = everywhere(lattice, values[None])[0, :, : lattice.built.axes]
        view = View(lattice, np.linalg.norm(moved, axis=1).argmax())
        drawn, _ = network.motion(ax, lattice, view, values)
        plane = view.plane and f", {view.plane}"
    else:
        largest = np.unravel_index(np.abs(values).argmax(), values.shape)
        drawn = balls.draw(ax, values[(..., *largest[2:])] / np.abs(values[largest]))
        plane = "".join(f", plane $z$ = {z}" for z in largest[2:])
    omega = rf"$\omega_i$ = {modes.omega[mode] / lattice.omega_mx:.4f} $\omega_{{mx}}$"
    ax.set_title(f"{omega}, $P_i$ = {modes.participation[mode]:.3g} balls{plane}")
    return drawn


def participation(ax, modes, lattice):
    """Draw the participation ratio against frequency, from 1 to all balls; return the points.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    modes : pgran.results.Modes
    lattice : pgran.results.LatticeRecord
    """
    x, balls = modes.omega / lattice.omega_mx, lattice.free_balls
    look = {"linestyle": "none", "marker": ".", "markeredgewidth": 0, "color": "black"}
    (points,) = ax.plot(x, modes.participation, clip_on=False, **look)
    ax.set(yscale="log", ylim=(1, max(balls, 10)))
    style.frequencies(ax, x, style.MODE_FREQUENCY)
    ax.set_ylabel(f"participation ratio $P_i$ (of {balls} balls)")
    return points


def density(ax, modes, lattice):
    """Draw the histogram of the modes over frequency, per ball and omega_mx; return the outline.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    modes : pgran.results.Modes
    lattice : pgran.results.LatticeRecord
    """
    x = modes.omega / lattice.omega_mx
    counts, edges = np.histogram(x, bins=round(math.sqrt(len(x))))
    values = counts / np.diff(edges) / lattice.free_balls
    ax.stairs(values, edges, fill=True, color=style.pale(style.ACCENT))
    outline = ax.stairs(values, edges, color=style.ACCENT)
    ax.set(ylim=(0, None), ylabel=style.DENSITY)
    style.frequencies(ax, edges, style.MODE_FREQUENCY)
    return outline


def pick(x, participation):
    """Return the indices of the modes to picture, ascending, each once; all if there are three.

    The second lowest mode, one near .6 that is extended as the median of those around it, and the
    one nearest to 1 (paper: modepic).

    Parameters
    ----------
    x : numpy.ndarray, shape (nm,)
        Frequencies in units of omega_mx.
    participation : numpy.ndarray, shape (nm,)
    """
    if len(x) <= 3:
        return list(range(len(x)))
    distance = np.abs(x - 0.6)
    near = np.flatnonzero(distance <= max(NEAR, distance.min()))
    usual = np.median(participation[near])
    middle = near[np.abs(participation[near] - usual).argmin()]
    return sorted({1, int(middle), int(np.abs(x - 1.0).argmin())})


def _shapes_page(modes, lattice):
    """Return the figure of up to three modes."""
    picked = pick(modes.omega / lattice.omega_mx, modes.participation)
    panels = [partial(shape, modes=modes, lattice=lattice, mode=mode) for mode in picked]
    if lattice.group == "lattice":
        figure = balls.page(lattice.shape, panels)
        figure.caption = f"{SAID['shapes']} {balls.DRIVEN}"
        return figure
    figure = balls.page(View(lattice).extent, panels)
    figure.caption = SAID["shapes"]
    network.explain(figure, lattice)
    return figure


def over(results, labels):
    """Yield participation ratios, and densities if each result has 20 modes or more."""
    found = [result.modes.omega / result.medium.omega_mx for result in results]
    for x in found:
        style.check_any(x, "modes")
    shown = list(zip(results, found, labels, strict=True))
    figure, (ax,) = style.page(style.COLUMN, 2.5)
    for number, (result, x, label) in enumerate(shown):
        look = {"markersize": 3, "markeredgewidth": 0.5, "fillstyle": "none", "clip_on": False}
        look |= {
            "marker": together.MARKS[number],
            "color": together.COLOURS[number],
            "linestyle": "none",
        }
        ax.plot(x, result.modes.participation, label=label, **look)
    most = max(result.medium.free_balls for result in results)
    ax.set(yscale="log", ylim=(1, max(most, 10)), ylabel="participation ratio $P_i$ (balls)")
    style.frequencies(ax, np.concatenate(found), style.MODE_FREQUENCY)
    figure.caption = SAID["participation"]
    made = {"participation": figure}
    if min(map(len, found)) >= 20:
        made["density"], (ax,) = style.page(style.COLUMN, 2.5)
        bins = round(max(map(len, found)) ** 0.5)
        edges = np.histogram_bin_edges(np.concatenate(found), bins)
        for number, (result, x, label) in enumerate(shown):
            counts = np.histogram(x, edges)[0] / np.diff(edges) / result.medium.free_balls
            look = {"edgecolor": together.COLOURS[number], "linestyle": together.LINES[number]}
            ax.stairs(counts, edges, label=label, **look)
        ax.set(ylim=(0, None), ylabel=style.DENSITY)
        style.frequencies(ax, edges, style.MODE_FREQUENCY)
        made["density"].caption = SAID["density"]
    missing = sum(not result.modes.count_certified for result in results)
    for name, page in made.items():
        together.finish(page)
        if missing:
            style.note(page, f"NOT CERTIFIED: modes of {missing} of {len(results)} results")
        yield name, page
