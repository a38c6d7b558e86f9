"""The figures of normal modes: shapes, participation, density (paper: modepic)."""

import math

import numpy as np

from pgran.errors import FileError
from pgran.figures import style

NEEDS = ("omega", "participation", "count_expected", "count_certified")
FREQUENCY = r"mode frequency $\omega_i/\omega_{mx}$"
DENSITY = r"density of modes (modes per $\omega_{mx}$)"
PICTURED = (0.6053, 1.0)  # the second and third mode of the paper's figure, in units of omega_mx
NEXT_LINE = "\n     "
FEWEST = 20  # modes that a histogram is drawn of


def figures(result, modes=None):
    """Yield the name and the figure of everything that the normal modes have to show.

    Parameters
    ----------
    result : types.SimpleNamespace
        With groups `modes` and `lattice`.
    modes
        Not used.

    Raises
    ------
    FileError
        If there is no mode.
    """
    if not np.size(result.modes.omega):
        raise FileError("nothing to draw in this result: no modes")
    if getattr(result.modes, "vector", None) is not None:
        yield "shapes", draw_shapes(result)
    yield "participation", draw_participation(result)
    if np.size(result.modes.omega) >= FEWEST and np.ptp(result.modes.omega) > 0:
        yield "density", draw_density(result)


def draw_shapes(result):
    """Return the figure of up to three modes (paper: modepic).

    The second lowest mode and those nearest to .6053 and 1 omega_mx, in units of the largest entry
    of each, blue to white to red from -1 to 1. Three dimensions: the plane through the largest
    entry. One: lines.
    """
    picked = pick(in_units(result))
    axes, (nx, ny) = len(result.lattice.shape), (*map(int, result.lattice.shape), 1)[:2]
    flat = axes == 1 or nx > 1.5 * ny
    rows, columns = (len(picked), 1) if flat else (1, len(picked))
    width = style.PAGE - 1.2 if flat else 1.9
    height = 1.1 if axes == 1 else min(max(width * ny / nx, 0.7), 6.0 / rows)
    aspect = "equal" if 1 / 8 <= ny / nx <= 3 else "auto"
    figure = style.new_figure(columns * width + 1.2, rows * (height + 0.35) + 0.5)
    figure.set_layout_engine("compressed")  # as many panels as fit, next to each other
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    image = None
    for letter, mode, ax in zip("abc", picked, panels, strict=False):
        shape = result.modes.vector[mode]
        shape = shape / np.abs(shape).max()
        largest = np.unravel_index(np.abs(shape).argmax(), shape.shape)
        plane = tuple(map(int, largest[2:]))
        if axes == 1:
            ax.axhline(0.0, color=style.MODE, linewidth=0.5)
            ax.plot(np.arange(-1, nx + 1), np.pad(shape, 1), color="black")
            ax.set(xlim=(-1, nx), ylim=(-1.1, 1.1))
        else:
            image = ax.imshow(
                shape[(..., *plane)].T,
                origin="lower",
                extent=(-0.5, nx - 0.5, -0.5, ny - 0.5),
                cmap="RdBu_r",
                vmin=-1.0,
                vmax=1.0,
                interpolation="nearest",
                aspect=aspect,
            )
        frequency, balls = describe(result, mode)
        end = f", plane $z$ = {plane[0]}" if plane else ""
        ax.set_title(f"({letter}) {frequency}{', ' if flat else NEXT_LINE}{balls}{end}")
        ax.locator_params("both" if axes > 1 else "x", nbins=6, steps=[1, 2, 5, 10], integer=True)
        ax.label_outer()
    for ax in panels[-columns:]:
        ax.set_xlabel("ball $i$")
    displacement = "displacement / largest"
    if image:
        for ax in panels[::columns]:
            ax.set_ylabel("ball $j$")
        figure.colorbar(
            image, ax=list(panels), label=displacement, ticks=[-1, -0.5, 0, 0.5, 1], pad=0.02
        )
    else:
        figure.supylabel(displacement, fontsize="medium")
    note_missing(figure, result.modes, np.size(result.modes.omega))
    return figure


def draw_participation(result):
    """Return the figure of the participation ratio against frequency, from 1 to all balls."""
    figure = style.new_figure(style.COLUMN, 2.5)
    ax = figure.subplots()
    ax.set_yscale("log")
    ax.plot(
        in_units(result),
        result.modes.participation,
        linestyle="none",
        marker=".",
        markeredgewidth=0,
        color="black",
        clip_on=False,
    )
    balls = math.prod(map(int, result.lattice.shape))
    ax.set_ylim(1, max(balls, 10))
    ax.set_xlabel(FREQUENCY)
    ax.set_ylabel(f"participation ratio $P_i$ (of {balls} balls)")
    note_missing(figure, result.modes, np.size(result.modes.omega))
    return figure


def draw_density(result):
    """Return the histogram of the modes over frequency; its area is their number."""
    x = in_units(result)
    counts, edges = np.histogram(x, bins=round(math.sqrt(len(x))))
    figure = style.new_figure(style.COLUMN, 2.5)
    ax = figure.subplots()
    ax.stairs(counts / np.diff(edges), edges, fill=True, color=style.pale(style.ACCENT))
    ax.stairs(counts / np.diff(edges), edges, color=style.ACCENT)
    ax.set_ylim(bottom=0)
    ax.set_xlabel(FREQUENCY)
    ax.set_ylabel(DENSITY)
    note_missing(figure, result.modes, len(x))
    return figure


def in_units(result):
    """Return the frequencies of the modes in units of omega_mx."""
    return np.asarray(result.modes.omega) / result.lattice.omega_mx


def pick(x):
    """Return the indices of the modes to picture, ascending, each once; all if there are three."""
    if len(x) <= 3:
        return list(range(len(x)))
    nearest = [int(np.abs(x - wanted).argmin()) for wanted in PICTURED]
    return sorted({1, *nearest})


def describe(result, mode):
    """Return frequency and participation ratio of a mode in words."""
    return (
        rf"$\omega_i$ = {in_units(result)[mode]:.4f} $\omega_{{mx}}$",
        f"$P_i$ = {result.modes.participation[mode]:.3g} balls",
    )


def note_missing(figure, record, found):
    """Say in a figure if modes are missing or inaccurate.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    record : types.SimpleNamespace
        With `count_expected` and `count_certified`.
    found : int
        How many modes there are.
    """
    if record.count_certified:
        return
    if found != record.count_expected:
        style.note(figure, f"NOT ALL MODES: {found} of {record.count_expected} found")
    else:
        style.note(figure, "NOT CERTIFIED: some modes are inaccurate")
