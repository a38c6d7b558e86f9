"""The figures of normal modes: shapes, participation, density (paper: modepic)."""

import math
from functools import partial

import numpy as np

from pgran.draw import balls, captions, scales, style, together
from pgran.experiments.modes.record import exactness

CAPTIONS = {
    "shapes": "Shapes of normal modes; $P_i$: how many balls take part.",
    "participation": "Participation ratio $P_i$ of each normal mode against its frequency.",
    "density": "Density of the normal modes per ball and $\\omega_{mx}$; its area is the share of "
    "the modes that are shown.",
}
NEAR = 0.05  # omega_mx: modes around the middle one that is pictured
MANY = 20  # modes that have a density


def figures(result, **_):
    """Yield three shapes if they are stored, participation ratios, the density of many modes."""
    record, lattice, made = result.modes, result.medium, {}
    both = {"modes": record, "lattice": lattice}
    style.check_any(record.omega, "modes")
    if record.vector is not None and lattice.has_places:
        picked = pick(record.omega / lattice.omega_mx, record.participation)
        panels = [partial(shape, mode=mode, **both) for mode in picked]
        made["shapes"] = balls.motions(lattice, panels, CAPTIONS["shapes"])
    made["participation"] = style.single(partial(participation, **both), CAPTIONS["participation"])
    if len(record.omega) >= MANY and np.ptp(record.omega) > 0:
        made["density"] = style.single(partial(density, fill=True, **both), CAPTIONS["density"])
    for name, figure in made.items():
        style.note_missing(figure, record)
        yield name, figure


def errors(record, _):
    """Return how many modes were found, and whether their count certifies them."""
    words = f"{record.count_found} of {record.count_expected} normal modes"
    if not record.count_certified:
        return f"{words} were found; they are not certified."
    residual = getattr(record, "residual", ())  # a projection has none
    largest = f"; residuals at most {captions.number(residual.max())}" if len(residual) else ""
    return f"{words}, {exactness(record, captions.number)}{largest}."


def shape(ax, modes, lattice, mode):
    """Draw the shape of one mode in units of its largest entry (paper: modepic).

    As `balls.motion` draws displacements: colours from -1, dark blue, to 1, yellow, a line from
    wall to wall, or arrows. The lowest mode is number 0; the record has its `vector`. Returns the
    image, the line, or arrows or balls.
    """
    values = lattice.built.displacements(modes.vector[mode])
    drawn, _, plane = balls.motion(ax, lattice, values)
    omega = rf"$\omega_i$ = {modes.omega[mode] / lattice.omega_mx:.4f} $\omega_{{mx}}$"
    taking_part = f"$P_i$ = {modes.participation[mode]:.3g} balls"
    ax.set_title(", ".join(filter(None, [omega, taking_part, plane])))
    return drawn


def participation(ax, modes, lattice, **look):
    """Draw the participation ratio against frequency, from 1 to all balls; return the points."""
    x = modes.omega / lattice.omega_mx
    look = {"marker": ".", "markeredgewidth": 0, "color": "black"} | look
    (points,) = ax.plot(x, modes.participation, linestyle="none", clip_on=False, **look)
    participation_axes(ax, x, lattice)
    return points


def participation_axes(ax, x, lattice):
    """Make axes those of participation ratios of modes at `x`, in units of omega_mx."""
    scales.frequencies(ax, x, scales.MODE_FREQUENCY)
    top = ax.get_ylim()[1] if ax.get_yscale() == "log" else 10  # of another result
    ax.set(yscale="log", ylim=(1, max(lattice.free_balls, top)))
    ax.set_ylabel(f"participation ratio $P_i$ (of {lattice.free_balls} balls)")


def bin_edges(x):
    """Return the edges of about as many bins as there are modes in one, from end to end."""
    count = np.count_nonzero(np.isfinite(x))
    return np.linspace(np.nanmin(x), np.nanmax(x), min(60, max(4, round(math.sqrt(count)))) + 1)


def density_of(x, edges, lattice):
    """Return the density of modes at `x` between edges, per ball, in units of omega_mx."""
    return np.histogram(x, edges)[0] / np.diff(edges) / lattice.free_balls


def density(ax, modes, lattice, edges=None, fill=False, **look):
    """Draw the histogram of the modes over frequency, per ball and omega_mx; return the outline."""
    x = modes.omega / lattice.omega_mx
    edges = bin_edges(x) if edges is None else edges
    values = density_of(x, edges, lattice)
    if fill:
        ax.stairs(values, edges, fill=True, color=style.pale(style.ACCENT))
    outline = ax.stairs(values, edges, **{"edgecolor": style.ACCENT} | look)
    density_axes(ax, edges)
    return outline


def density_axes(ax, edges):
    """Make axes those of a density of modes between edges."""
    scales.label(ax.yaxis, scales.DENSITY)
    scales.frequencies(ax, edges, scales.MODE_FREQUENCY)
    ax.autoscale(axis="y")  # of another result, too
    ax.set_ylim(bottom=0)


def pick(x, participation):
    """Return the indices of the modes to picture, ascending, each once; all if there are three.

    The second lowest mode, one near .6 that is extended as the median of those around it, and the
    one nearest to 1 (paper: modepic). `x`: frequencies in units of omega_mx.
    """
    if len(x) <= 3:
        return list(range(len(x)))
    distance = np.abs(x - 0.6)
    near = np.flatnonzero(distance <= max(NEAR, distance.min()))
    usual = np.median(participation[near])
    middle = near[np.abs(participation[near] - usual).argmin()]
    return sorted({1, int(middle), int(np.abs(x - 1.0).argmin())})


def over(results, labels):
    """Yield participation ratios, and densities if each result has many modes."""
    x = [result.modes.omega / result.medium.omega_mx for result in results]
    for each in x:
        style.check_any(each, "modes")
    several = [(r.modes, r.medium, label) for r, label in zip(results, labels, strict=True)]

    def points(ax):
        look = {"markersize": 3, "markeredgewidth": 0.5, "fillstyle": "none"}
        for number, (modes, medium, label) in enumerate(several):
            look |= {"marker": together.MARKS[number], "color": style.COLOURS[number]}
            participation(ax, modes, medium, label=label, **look)
        ax.set_ylabel("participation ratio $P_i$ (balls)")

    def outlines(ax):
        most = bin_edges(max(x, key=len))
        edges = np.histogram_bin_edges(np.concatenate(x), len(most) - 1)
        for number, (modes, medium, label) in enumerate(several):
            look = {"edgecolor": style.COLOURS[number], "linestyle": together.LINES[number]}
            density(ax, modes, medium, edges, label=label, **look)

    made = {"participation": points}
    if min(map(len, x)) >= MANY:
        made["density"] = outlines
    missing = sum(not result.modes.count_certified for result in results)
    for name, draw in made.items():
        page = style.single(draw, CAPTIONS[name])
        if missing:
            style.note(page, f"NOT CERTIFIED: modes of {missing} of {len(results)} results")
        yield name, page
