"""The figures of the driven lattice in terms of its modes (paper: onefreq, maxci, cifreq)."""

import numpy as np

from pgran.draw import marks, scales, style
from pgran.experiments.modes import figures as modes_figures

COEFFICIENT = "coefficient $|c_i|$ (drive = 1)"
SHOWN_DRIVE = 0.6  # omega_mx: the driving frequency of onefreq, and where the modes of cifreq lie


def figures(result, **_):
    """Yield what a projection is made for."""
    projection = result.projection
    style.check_any(projection.mode_omega, "modes")
    if len(projection.omega) <= style.HANDFUL:  # no sweep
        name, draw = "onefreq", coefficients
    elif len(projection.mode_omega) > style.HANDFUL:
        name, draw = "maxci", dominant
    else:
        name, draw = "cifreq", single_modes
    figure = style.single(draw, projection=projection, lattice=result.medium)
    modes_figures.note_missing(figure, projection)
    yield name, figure


def errors(record, how):
    """Return how many modes there are, and how many frequencies failed."""
    failed = record.converged_reason <= 0
    missed = f"{np.count_nonzero(failed)} of {len(failed)} frequencies"
    lost = f" {missed} missed the accuracy asked for." if failed.any() else ""
    return modes_figures.errors(record, how) + lost


def coefficients(ax, projection, lattice, drive=SHOWN_DRIVE):
    """Coefficients of the driven lattice in its normal modes at one driving frequency, against the
    frequency of the modes.

    (Paper: onefreq.) Of the driving frequencies that are as accurate as asked the one nearest to
    `drive`, in units of omega_mx, is drawn; if none is, only a cross at the nearest of all.
    """
    x, modes, accurate = _in_units(projection, lattice)
    shown = np.where(accurate == accurate.any(), np.abs(x - drive), np.inf).argmin()
    values = np.abs(projection.coefficient[shown])
    good = accurate[shown] & np.isfinite(values) & (values > 0)
    ax.set(yscale="log", ylabel=COEFFICIENT)
    scales.frequencies(ax, modes, scales.MODE_FREQUENCY, aside=modes_figures.ASIDE)
    label = f"driving frequency {scales.frequency(x[shown], lattice)}"
    ax.axvline(x[shown], color=style.ACCENT, zorder=1, label=label)
    look = {"color": "black", "linestyle": "none", "clip_on": False}
    (curve,) = marks.curves(ax, modes, values, good, dots=True, **look)
    if good.any():
        stems = {"color": "#bbbbbb", "linewidth": 0.4, "zorder": 1}
        ax.vlines(modes[good], ax.get_ylim()[0], values[good], **stems)
    if not accurate[shown]:
        marks.failed(ax, x[[shown]])
    return curve


def dominant(ax, projection, lattice):
    """Frequency of the mode that is excited most, against the driving frequency.

    (Paper: maxci.)
    """
    x, modes, accurate = _in_units(projection, lattice)
    good = accurate & (projection.dominant >= 0)
    scales.label(ax.yaxis, scales.DOMINANT)
    scales.frequencies(ax, x)
    ends = [max(x[0], modes[0]), min(x[-1], modes[-1])]
    if ends[0] < ends[1]:
        ax.plot(ends, ends, color=style.pale(style.ACCENT), linewidth=2.5, label="slope 1")
    look = {"color": "black", "linestyle": "none", "markersize": 2.5}
    (points,) = marks.curves(ax, x, modes[projection.dominant], good, dots=True, **look)
    marks.failed(ax, x[~good])
    return points


def single_modes(ax, projection, lattice):
    """Coefficients of successive normal modes against the driving frequency; dotted: their own
    frequencies.

    (Paper: cifreq.) The three modes nearest to .6 omega_mx, or to the middle of a sweep that is
    elsewhere.
    """
    x, modes, accurate = _in_units(projection, lattice)
    chosen = successive(modes, SHOWN_DRIVE if x[0] <= SHOWN_DRIVE <= x[-1] else (x[0] + x[-1]) / 2)
    near = (x >= modes[chosen[0]] - 0.05) & (x <= modes[chosen[-1]] + 0.05)
    if np.count_nonzero(near) <= style.HANDFUL:
        near[:] = True
    values = np.abs(projection.coefficient[near][:, chosen])
    good = accurate[near, None] & np.isfinite(values) & (values > 0)
    ax.set(yscale="log", ylabel=COEFFICIENT)
    scales.frequencies(ax, x[near])
    labels = [scales.frequency(modes[mode], lattice, 5) for mode in chosen]
    drawn = marks.curves(ax, x[near], values, good, labels)
    for mode, curve in zip(chosen, drawn, strict=True):
        ax.axvline(modes[mode], color=curve.get_color(), linestyle=":", zorder=1)
    marks.failed(ax, x[near & ~accurate])
    return drawn


def successive(modes, centre):
    """Return the indices of the up to three successive modes nearest to a frequency."""
    first = range(max(1, len(modes) - 2))
    windows = [list(range(n, min(n + 3, len(modes)))) for n in first]
    return min(windows, key=lambda window: np.abs(modes[window] - centre).max())


def _in_units(projection, lattice):
    """Return driving and mode frequencies in units of omega_mx, and which drives are accurate."""
    unit = lattice.omega_mx
    return projection.omega / unit, projection.mode_omega / unit, projection.converged_reason > 0
