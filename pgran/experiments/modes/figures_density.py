"""The figures of the density of modes: how many lie below each frequency, and how densely."""

from functools import partial

import numpy as np

from pgran.draw import scales, style

CAPTIONS = {
    "staircase": "How many normal modes lie below a frequency: counts.",
    "density": "Density of the normal modes between counted frequencies.",
}


def figures(result, **_):
    """Yield the staircase and the density."""
    record, lattice = result.density, result.medium
    for panel in (staircase, density):
        draw = partial(panel, density=record, lattice=lattice)
        figure = style.single(draw, CAPTIONS[panel.__name__])
        if record.failures:
            style.note(figure, f"NOT CERTIFIED: {record.failures} counts, left out")
        yield panel.__name__, figure


def errors(record, _):
    """Return how many counts are certain."""
    return f"{np.count_nonzero(record.certified)} of {len(record.omega)} counts are certified."


def staircase(ax, density, lattice):
    """Draw how many modes lie below each frequency; return the curve.

    With Weyl's law where the record has it: equal bonds, two axes.
    """
    x, counts = density.omega / density.omega_mx, density.count
    dots = {"marker": "."} if len(x) <= style.FEW else {}
    shown = np.where(density.certified, counts, np.nan)
    (curve,) = ax.plot(x, shown, color="black", **dots)
    fine = np.linspace(density.omega[0], density.omega[-1], 300)
    _finish(ax, density, counts.max(initial=1), fine, density.weyl(lattice, fine))
    ax.set_ylabel(r"modes below $\omega$")
    return curve


def density(ax, density, lattice):
    """Draw the modes between neighbouring frequencies, per ball and omega_mx; return the outline.

    With Weyl's law where the record has it.
    """
    x, values = density.omega / density.omega_mx, density.density
    ax.stairs(values, x, fill=True, color=style.pale(style.ACCENT))
    outline = ax.stairs(values, x, color=style.ACCENT)
    law = density.weyl(lattice, density.omega)
    law = None if law is None else np.diff(law) / (density.balls * np.diff(x))
    _finish(ax, density, np.nanmax(values, initial=0.0) or 1.0, density.middle, law)
    scales.label(ax.yaxis, scales.DENSITY)
    return outline


def _finish(ax, density, largest, omega, law):
    """Draw Weyl's law, if there is one, and make the axes those of frequencies and counts."""
    if law is not None:
        look = {"color": style.UNRESOLVED, "linestyle": "--", "label": "long waves (Weyl)"}
        ax.plot(omega / density.omega_mx, np.maximum(law, 0.0), **look)
    scales.frequencies(ax, density.omega / density.omega_mx, scales.ANY_FREQUENCY)
    ax.set_ylim(0, 1.05 * largest)
