"""The figures of the density of modes: how many lie below each frequency, and how densely."""

import contextlib

import numpy as np

from pgran.draw import scales, style
from pgran.errors import PgranError
from pgran.store.estimate import counted

LAW = {"color": style.UNRESOLVED, "linestyle": "--"}
DEBYE = "long waves (Debye), by statics"
BINS = 24  # at most, evenly in the logarithm of the frequency


def figures(result, **_):
    """Yield the staircase and the density."""
    record, lattice = result.density, result.medium
    known = record.certified[1:] & record.certified[:-1] & (record.omega[:-1] > 0)  # not at rest
    counts = np.where(known, np.diff(record.count), 0)
    both, level = {"density": record, "lattice": lattice}, debye(lattice)
    panels = {staircase: both, density: both | {"level": level}}
    if dimension(lattice) and counts.any():
        bins = {"edges": record.omega / record.omega_mx, "counts": counts}
        panels[reduced] = bins | {"lattice": lattice, "level": level}
    for panel, shown in panels.items():
        figure = style.single(panel, **shown)
        if record.failures:
            style.note(figure, f"NOT CERTIFIED: {counted(record.failures, 'count')}, left out")
        if panel is not staircase and (record.unstable or 0) > 0:
            style.note(figure, f"NOT SHOWN: {counted(record.unstable, 'unstable mode')}")
        yield panel.__name__, figure


def errors(record, _):
    """Return how many counts are certain."""
    return f"{np.count_nonzero(record.certified)} of {len(record.omega)} counts are certified."


def staircase(ax, density, lattice):
    """How many normal modes lie below a frequency: counts; broken: Weyl's law, if it is known."""
    x, counts = density.omega / density.omega_mx, density.count
    dots = {"marker": "."} if len(x) <= style.FEW else {}
    shown = np.where(density.certified, counts, np.nan)
    (curve,) = ax.plot(x, shown, color="black", **dots)
    fine = np.linspace(density.omega[0], density.omega[-1], 300)
    law = density.weyl(lattice, fine)
    if law is not None:
        ax.plot(fine / density.omega_mx, np.maximum(law, 0.0), label="long waves (Weyl)", **LAW)
    scales.frequencies(ax, x, scales.ANY_FREQUENCY)
    ax.set_ylim(0, 1.05 * counts.max(initial=1))
    ax.set_ylabel(r"modes below $\omega$")
    return curve


def density(ax, density, lattice, level=None):
    """Density of the normal modes between counted frequencies; bars: square roots of the counts."""
    x = density.omega / density.omega_mx
    counts = density.density * density.balls * np.diff(x)
    return histogram(ax, x, counts, lattice, scales.ANY_FREQUENCY, level)


def histogram(ax, edges, counts, lattice, quantity=scales.MODE_FREQUENCY, level=None, **look):
    """Draw the density of modes per ball that are counted between edges.

    Without a look of its own it is filled, and has counting errors; with Debye's law at the `level`
    of `debye`.
    """
    share = lattice.free_balls * np.diff(edges)
    values = counts / share
    if not look:
        ax.stairs(values, edges, fill=True, color=style.pale(style.ACCENT))
        bars = {"linestyle": "none", "ecolor": style.ACCENT, "elinewidth": 0.6}
        ax.errorbar(0.5 * (edges[1:] + edges[:-1]), values, np.sqrt(counts) / share, **bars)
    outline = ax.stairs(values, edges, **look or {"edgecolor": style.ACCENT})
    density_axes(ax, edges, quantity)
    if level is not None:
        d, x = dimension(lattice), np.linspace(max(edges[0], 0.0), edges[-1], 200)
        x = x[level * x ** (d - 1) <= ax.get_ylim()[1]]
        ax.plot(x, level * x ** (d - 1), label=DEBYE, scaley=False, **LAW)
    return outline


def density_axes(ax, edges, quantity=scales.MODE_FREQUENCY):
    """Make axes those of a density of modes between edges."""
    scales.label(ax.yaxis, scales.DENSITY)
    scales.frequencies(ax, edges, quantity)
    ax.autoscale(axis="y")  # of another result, too
    ax.set_ylim(bottom=0)


def debye(lattice):
    """Return the density of long waves per ball over x^(d-1), x in units of omega_mx, if known.

    That needs their speeds, `pgran.sound`, which networks with walls have not.
    """
    from pgran.medium.statics import sound

    with contextlib.suppress(PgranError):
        found = sound(lattice.built)
        part = found.balls / lattice.free_balls  # rattlers carry no waves
        return part * found.debye(lattice.omega_mx) * lattice.omega_mx
    return None


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


def reduced(ax, edges, counts, lattice, level=None):
    r"""Density of the normal modes over $(\omega/\omega_{mx})^{d-1}$, $d$ the dimension of space,
    by which that of long waves is a constant; bars: square roots of the counts.

    `edges`, in units of omega_mx, are those of the `counts` of modes, `level` is as of `debye`.
    """
    d, some = dimension(lattice), counts > 0
    # between edges Debye's x^(d-1) has the integral (high^d - low^d) / d
    volumes = lattice.free_balls * np.diff(edges**d)[some] / d
    values, errors = counts[some] / volumes, np.sqrt(counts[some]) / volumes
    middle = (0.5 * (edges[1:] + edges[:-1]))[some]
    look = {"color": "black", "marker": ".", "linestyle": "none", "elinewidth": 0.6}
    points = ax.errorbar(middle, values, errors, **look)
    scales.frequencies(ax, middle, scales.MODE_FREQUENCY)
    if level is not None:
        ax.axhline(level, label=DEBYE, **LAW)
        values = np.append(values, level)
    ax.set(xscale="log", xlim=(edges[edges > 0][0], edges[-1]))
    ax.set(yscale="log", ylim=(0.5 * values.min(), 2 * values.max()))
    for axis in (ax.xaxis, ax.yaxis):
        scales.convert(axis, 1.0)  # which has ticks at 1, 2, 5 where there is one power of ten
    over = ["", r"/(\omega_i/\omega_{mx})", r"/(\omega_i/\omega_{mx})^2"][d - 1]
    ax.set_ylabel(rf"$D(\omega_i){over}$ per ball and $\omega_{{mx}}$")
    return points
