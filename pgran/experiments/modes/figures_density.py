"""The figures of the density of modes: how many lie below each frequency, and how densely."""

import contextlib

import numpy as np

from pgran.draw import captions, scales, style
from pgran.errors import PgranError
from pgran.store.estimate import counted

BARS = {"linestyle": "none", "elinewidth": 0.6}
LAW = {"color": style.UNRESOLVED, "linestyle": "--"}
DEBYE = "long waves (Debye), by statics"
LEAST = 1e-4  # of the largest density: what rounding may leave of a mean less its error
BINS = 24  # at most, evenly in the logarithm of the frequency


def figures(result, **_):
    """Yield the staircase and the density, and energy diffusivities if there are some."""
    record, lattice = result.density, result.medium
    edges, errors = record.omega / record.omega_mx, record.modes_error
    known = np.isfinite(record.density) & (record.omega[:-1] > 0)  # not at rest
    counts = np.where(known, record.modes, 0)
    both, level = {"density": record, "lattice": lattice}, debye(lattice)
    panels = {staircase: both, density: both | {"level": level}}
    if dimension(lattice) and counts.any():
        bins = {"edges": edges, "counts": counts, "errors": errors}
        panels[reduced] = bins | {"lattice": lattice, "level": level}
    if record.diffusivity is not None:
        panels[diffusivity] = both
    for panel, shown in panels.items():
        figure = style.single(panel, **shown)
        if record.failures:
            style.note(figure, f"NOT CERTIFIED: {counted(record.failures, 'count')}, left out")
        if panel in (density, reduced) and (record.unstable or 0) > 0:
            style.note(figure, f"NOT SHOWN: {counted(record.unstable, 'unstable mode')}")
        yield panel.__name__, figure


def errors(record, _):
    """Return how many counts are certain, or what estimates are made of."""
    if record.method == "moments":
        width = captions.number(np.median(record.resolution / np.diff(record.omega)), 2)
        return (
            f"Estimates by {record.moments} moments of {record.vectors} random vectors, smoothed "
            f"by {width} of a bin (median)."
        )
    return f"{np.count_nonzero(record.certified)} of {len(record.omega)} counts are certified."


def staircase(ax, density, lattice):
    """How many normal modes lie below a frequency: counts, or estimates with bars, their standard
    errors; broken: Weyl's law, if it is known.
    """
    x, counts = density.omega / density.omega_mx, density.count
    dots = {"marker": "."} if len(x) <= style.FEW else {}
    estimated = density.method == "moments"
    shown = np.where(density.certified | estimated, counts, np.nan)
    (curve,) = ax.plot(x, shown, color="black", **dots)
    if estimated:
        ax.errorbar(x, shown, density.count_error, color="black", **BARS)
    fine = np.linspace(density.omega[0], density.omega[-1], 300)
    law = density.weyl(lattice, fine)
    if law is not None:
        ax.plot(fine / density.omega_mx, np.maximum(law, 0.0), label="long waves (Weyl)", **LAW)
    scales.frequencies(ax, x, scales.ANY_FREQUENCY)
    ax.set_ylim(0, 1.05 * counts.max(initial=1))
    ax.set_ylabel(r"modes below $\omega$")
    return curve


def density(ax, density, lattice, level=None):
    """Density of the normal modes between frequencies; bars: standard errors, of counts their
    square roots.
    """
    bins = density.omega / density.omega_mx, density.modes, lattice, scales.ANY_FREQUENCY, level
    return histogram(ax, *bins, errors=density.modes_error)


def histogram(
    ax, edges, counts, lattice, quantity=scales.MODE_FREQUENCY, level=None, d=1, errors=None, **look
):
    """Draw the density of modes per ball that are counted between edges, over x^(d-1).

    Without a look of its own it is filled, and has `errors` of counts, by default their roots; with
    Debye's law at the `level` of `debye`.
    """
    # between edges Debye's x^(d-1) has the integral (high^d - low^d) / d
    share = lattice.free_balls * np.diff(edges**d) / d
    values = counts / share
    if not look:
        ax.stairs(values, edges, fill=True, color=style.pale(style.ACCENT))
        errors = np.sqrt(counts) if errors is None else errors
        middle = 0.5 * (edges[1:] + edges[:-1])
        ax.errorbar(middle, values, errors / share, ecolor=style.ACCENT, **BARS)
    outline = ax.stairs(values, edges, **look or {"edgecolor": style.ACCENT})
    density_axes(ax, edges, quantity, log=d > 1 or None)
    if level is not None:
        x = np.linspace(max(edges[0], 0.0), edges[-1], 200)
        law = level * x ** (dimension(lattice) - d)
        shown = law <= ax.get_ylim()[1]
        ax.plot(x[shown], law[shown], label=DEBYE, scaley=d > 1, **LAW)
    return outline


def density_axes(ax, edges, quantity=scales.MODE_FREQUENCY, log=None):
    """Make axes those of a density of modes between edges, logarithmic ones if these are `wide`."""
    scales.label(ax.yaxis, scales.DENSITY)
    log = scales.wide(edges) if log is None else log
    scales.frequencies(ax, edges, quantity, log=log)
    ax.set_yscale("log" if log else "linear")
    ax.autoscale(axis="y")  # of another result, too
    least, top = 0.5 * ax.dataLim.minposy, ax.get_ylim()[1]
    ax.set_ylim(bottom=max(least, LEAST * top) if log else 0)


def debye(lattice):
    """Return the density of long waves per ball over x^(d-1), x in units of omega_mx, if known."""
    found = sound_of(lattice)
    part = found and found.balls / lattice.free_balls  # rattlers carry no waves
    return found and part * found.debye(lattice.omega_mx) * lattice.omega_mx


def sound_of(lattice):
    """Return `pgran.sound` of a medium, None where it is not known, as in networks with walls."""
    from pgran.medium.statics import sound

    with contextlib.suppress(PgranError):
        return sound(lattice.built)


def dimension(lattice):
    """Return along how many axes waves run, 0 if that is not known."""
    if lattice.group == "lattice":
        return len(lattice.shape)
    return lattice.position.shape[1] if lattice.has_places else 0


def log_bins(x):
    """Return `edges` of bins of equal ratio, and `counts` of the positive `x` in each."""
    x = x[x > 0]
    ends = x.min() * (1 - 1e-9), x.max() * (1 + 1e-9)
    edges = np.geomspace(*ends, min(BINS, round(np.sqrt(len(x)))) + 1)
    return {"edges": edges, "counts": np.histogram(x, edges)[0]}


def reduced(ax, edges, counts, lattice, level=None, errors=None, **look):
    r"""Density of the normal modes over $(\omega/\omega_{mx})^{d-1}$, $d$ the dimension of space,
    by which that of long waves is a constant; bars: standard errors, of counts their square roots.

    `edges`, in units of omega_mx, are those of the `counts` of modes and of their `errors`, `level`
    is as of `debye`.
    """
    d, first = dimension(lattice), np.argmax(edges > 0)
    look |= {"level": level, "d": d, "errors": None if errors is None else errors[first:]}
    drawn = histogram(ax, edges[first:], counts[first:], lattice, **look)
    over = ["", r"/(\omega_i/\omega_{mx})", r"/(\omega_i/\omega_{mx})^2"][d - 1]
    ax.set_ylabel(rf"$D(\omega_i){over}$ per ball and $\omega_{{mx}}$")
    return drawn


def diffusivity(ax, density, lattice):
    r"""Energy diffusivity $d$ of the normal modes at a frequency; bars: standard errors, and how
    far frequencies are smoothed. Left out: where $d$ is less than twice its error, or
    fewer than ten modes lie within the resolution.
    """
    names = "middle diffusivity resolution diffusivity_error"
    values = [getattr(density, name)[density.diffuses] for name in names.split()]
    x, y, xerr, yerr = np.divide(values, density.omega_mx)
    look = {"color": style.ACCENT, "marker": "o", "markersize": 2} | BARS
    drawn = ax.errorbar(x, y, yerr, xerr, **look)
    scales.frequencies(ax, density.middle / density.omega_mx, scales.ANY_FREQUENCY)
    ax.set_ylabel(rf"$d$ along {density.diffusivity_axis} (length$^2\,\omega_{{mx}}$)")
    ax.set_yscale("log")
    return drawn
