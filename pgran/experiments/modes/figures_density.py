"""The figures of the density of modes: how many lie below each frequency, and how densely."""

import numpy as np

from pgran.draw import style
from pgran.draw.style import ANY_FREQUENCY

SAID = {
    "staircase": "How many normal modes lie below a frequency: counts.",
    "density": "Density of the normal modes between counted frequencies.",
}
WEYL = {"color": style.UNRESOLVED, "linestyle": "--", "label": "long waves (Weyl)"}


def figures(result, **_):
    """Yield the staircase and the density."""
    record, lattice = result.density, result.medium
    for panel in (staircase, density):
        figure, (ax,) = style.page(style.COLUMN, 2.5)
        panel(ax, record, lattice)
        figure.caption = SAID[panel.__name__]
        if record.failures:
            style.note(figure, f"NOT CERTIFIED: {record.failures} counts, left out")
        yield panel.__name__, figure


def staircase(ax, density, lattice):
    """Draw how many modes lie below each frequency; return the curve.

    With Weyl's law where the record has it: equal bonds, two axes.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    density : pgran.results.Density
    lattice : pgran.results.LatticeRecord or pgran.results.NetworkRecord
    """
    x, known = density.omega / density.omega_mx, density.certified
    dots = {"marker": "."} if len(x) <= 100 else {}
    (curve,) = ax.plot(x, np.where(known, density.count, np.nan), color="black", **dots)
    ax.set_ylabel(r"modes below $\omega$")
    style.frequencies(ax, x, ANY_FREQUENCY)
    ax.set_ylim(0, 1.05 * max(density.count.max(), 1))
    fine = np.linspace(density.omega[0], density.omega[-1], 300)
    _weyl(ax, fine, density.weyl(lattice, fine), density)
    return curve


def density(ax, density, lattice):
    """Draw the modes between neighbouring frequencies, per ball and omega_mx; return the outline.

    With Weyl's law where the record has it.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    density : pgran.results.Density
    lattice : pgran.results.LatticeRecord or pgran.results.NetworkRecord
    """
    x = density.omega / density.omega_mx
    ax.stairs(density.density, x, fill=True, color=style.pale(style.ACCENT))
    outline = ax.stairs(density.density, x, color=style.ACCENT)
    ax.set_ylabel(style.DENSITY)
    style.frequencies(ax, x, ANY_FREQUENCY)
    ax.set_ylim(0, 1.05 * (np.nanmax(density.density, initial=0.0) or 1.0))
    below = density.weyl(lattice, density.omega)
    if below is not None:
        _weyl(ax, density.middle, np.diff(below) / (density.balls * np.diff(x)), density)
    return outline


def _weyl(ax, omega, values, density):
    """Draw Weyl's law, if there is one, and name it."""
    if values is not None:
        ax.plot(omega / density.omega_mx, np.maximum(values, 0.0), **WEYL)
        ax.legend(loc="upper left")
