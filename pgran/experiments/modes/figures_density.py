"""The figures of the density of modes: how many lie below each frequency, and how densely."""

import contextlib
from functools import partial

import numpy as np

from pgran.draw import scales, style
from pgran.errors import PgranError
from pgran.medium.statics import sound

CAPTIONS = {
    "staircase": "How many normal modes lie below a frequency: counts.",
    "density": "Density of the normal modes between counted frequencies.",
    "reduced": r"Density of the normal modes over $(\omega/\omega_{mx})^{d-1}$, $d$ the dimension "
    "of space, by which that of long waves is a constant; bars: square roots of the counts.",
}
BINS = 24  # at most, evenly in the logarithm of the frequency


def figures(result, **_):
    """Yield the staircase and the density."""
    record, lattice = result.density, result.medium
    known = record.certified[1:] & record.certified[:-1] & (record.omega[:-1] > 0)  # not at rest
    counts = np.where(known, np.diff(record.count), 0)
    both = {"density": record, "lattice": lattice}
    draws = {"staircase": partial(staircase, **both), "density": partial(density, **both)}
    if dimension(lattice) and counts.any():
        bins = {"edges": record.omega / record.omega_mx, "counts": counts}
        draws["reduced"] = partial(reduced, lattice=lattice, **bins)
    for name, draw in draws.items():
        figure = style.single(draw, CAPTIONS[name])
        if record.failures:
            style.note(figure, f"NOT CERTIFIED: {record.failures} counts, left out")
        yield name, figure


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


def dimension(lattice):
    """Return along how many axes waves run, 0 if that is not known."""
    if lattice.group == "lattice":
        return len(lattice.shape)
    return lattice.position.shape[1] if lattice.has_places else 0


def log_bins(x):
    """Return edges of bins of equal ratio, and how many of the positive `x` each holds."""
    x = x[x > 0]
    ends = x.min() * (1 - 1e-9), x.max() * (1 + 1e-9)
    edges = np.geomspace(*ends, min(BINS, round(np.sqrt(len(x)))) + 1)
    return edges, np.histogram(x, edges)[0]


def reduced(ax, edges, counts, lattice):
    """Draw the density of modes over x^(d-1), with counting errors, and Debye's law.

    `edges`, in units of omega_mx, are those of the `counts` of modes. The law needs the speeds of
    long waves, `pgran.sound`. Returns the points.
    """
    d, some = dimension(lattice), counts > 0
    # between edges Debye's x^(d-1) has the integral (high^d - low^d) / d
    volumes = lattice.free_balls * np.diff(edges**d)[some] / d
    values, errors = counts[some] / volumes, np.sqrt(counts[some]) / volumes
    middle = (0.5 * (edges[1:] + edges[:-1]))[some]
    look = {"color": "black", "marker": ".", "linestyle": "none", "elinewidth": 0.6}
    points = ax.errorbar(middle, values, errors, **look)
    scales.frequencies(ax, middle, scales.MODE_FREQUENCY)
    with contextlib.suppress(PgranError):  # networks with walls have no one speed
        found = sound(lattice.built)
        part = found.balls / lattice.free_balls  # rattlers carry no waves
        level = part * found.debye(lattice.omega_mx) * lattice.omega_mx
        look = {"color": style.UNRESOLVED, "linestyle": "--"}
        ax.axhline(level, label="long waves (Debye), by statics", **look)
        values = np.append(values, level)
    ax.set(xscale="log", xlim=(edges[edges > 0][0], edges[-1]))
    ax.set(yscale="log", ylim=(0.5 * values.min(), 2 * values.max()))
    for axis in (ax.xaxis, ax.yaxis):
        scales.convert(axis, 1.0)  # which has ticks at 1, 2, 5 where there is one power of ten
    over = ["", r"/(\omega_i/\omega_{mx})", r"/(\omega_i/\omega_{mx})^2"][d - 1]
    ax.set_ylabel(rf"$D(\omega_i){over}$ per ball and $\omega_{{mx}}$")
    return points


def _finish(ax, density, largest, omega, law):
    """Draw Weyl's law, if there is one, and make the axes those of frequencies and counts."""
    if law is not None:
        look = {"color": style.UNRESOLVED, "linestyle": "--", "label": "long waves (Weyl)"}
        ax.plot(omega / density.omega_mx, np.maximum(law, 0.0), **look)
    scales.frequencies(ax, density.omega / density.omega_mx, scales.ANY_FREQUENCY)
    ax.set_ylim(0, 1.05 * largest)
