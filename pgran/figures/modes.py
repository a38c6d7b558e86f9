"""The figures of normal modes: shapes, participation, density (paper: modepic)."""

import math
from functools import partial

import numpy as np

from pgran.figures import balls, network, style
from pgran.figures.view import View
from pgran.results.space import everywhere


def figures(result, **_):
    """Yield three shapes if they are stored, participation ratios, the density of many modes."""
    record, lattice, made = result.modes, result.medium, {}
    style.check_any(record.omega, "modes")
    if record.vector is not None and getattr(lattice, "position", lattice.shape) is not None:
        made["shapes"] = _shapes_page(record, lattice)
    many = len(record.omega) >= 20 and np.ptp(record.omega) > 0
    for panel in (participation, density) if many else (participation,):
        figure, (ax,) = style.page(style.COLUMN, 2.5)
        panel(ax, record, lattice)
        made[panel.__name__] = figure
    for name, figure in made.items():
        style.note_missing(figure, record)
        yield name, figure


def shape(ax, modes, lattice, mode):
    """Draw the shape of one mode in units of its largest entry (paper: modepic).

    Blue to white to red from -1 to 1. Three dimensions: the plane through the largest entry. One: a
    line from wall to wall. Of a network the displacements, as `network.motion` draws them. Returns
    the image, the line, or arrows or balls.

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
    ax.set(yscale="log", ylim=(1, max(balls, 10)), xlabel=style.MODE_FREQUENCY)
    ax.set_ylabel(f"participation ratio $P_i$ (of {balls} balls)")
    return points


def density(ax, modes, lattice):
    """Draw the histogram of the modes over frequency; its area is their number. Return the outline.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    modes : pgran.results.Modes
    lattice : pgran.results.LatticeRecord
    """
    x = modes.omega / lattice.omega_mx
    counts, edges = np.histogram(x, bins=round(math.sqrt(len(x))))
    ax.stairs(counts / np.diff(edges), edges, fill=True, color=style.pale(style.ACCENT))
    outline = ax.stairs(counts / np.diff(edges), edges, color=style.ACCENT)
    ax.set_ylim(bottom=0)
    ax.set(xlabel=style.MODE_FREQUENCY, ylabel=r"density of modes (modes per $\omega_{mx}$)")
    return outline


def pick(x):
    """Return the indices of the modes to picture, ascending, each once; all if there are three.

    The second lowest mode and those nearest to .6053 and 1, as the paper; `x` in units of omega_mx.
    """
    if len(x) <= 3:
        return list(range(len(x)))
    return sorted({1, *(int(np.abs(x - wanted).argmin()) for wanted in (0.6053, 1.0))})


def _shapes_page(modes, lattice):
    """Return the figure of up to three modes."""
    picked = pick(modes.omega / lattice.omega_mx)
    panels = [partial(shape, modes=modes, lattice=lattice, mode=mode) for mode in picked]
    if lattice.group == "lattice":
        return balls.page(lattice.shape, panels)
    figure = balls.page(View(lattice).extent, panels)
    network.explain(figure, lattice)
    return figure
