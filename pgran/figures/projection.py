"""The figures of the driven lattice in terms of its modes (paper: onefreq, maxci, cifreq)."""

import numpy as np

from pgran.errors import FileError
from pgran.figures import modes as mode_figures
from pgran.figures import response, style

NEEDS = (
    *("omega", "mode_omega", "coefficient", "dominant", "converged_reason"),
    *("count_expected", "count_certified"),
)
COEFFICIENT = "coefficient $|c_i|$ (driven wall = 1)"
SHOWN = 0.6  # omega_mx: the driving frequency of onefreq, and where the modes of cifreq lie
FEW = 10  # frequencies or modes that make no curve
AROUND = 0.05  # omega_mx to either side of the modes of cifreq


def figures(result, modes=None):
    """Yield the name and the figure of what a projection can show.

    One driving frequency: its coefficients. A sweep: the dominant mode and three single modes. A
    sweep on a handful of modes: these alone.

    Parameters
    ----------
    result : types.SimpleNamespace
        With groups `projection` and `lattice`.
    modes
        Not used.

    Raises
    ------
    FileError
        If there is no frequency or no mode.
    """
    projection = result.projection
    for name, values in (("frequencies", projection.omega), ("modes", projection.mode_omega)):
        if not np.size(values):
            raise FileError(f"nothing to draw in this result: no {name}")
    sweep, many = np.size(projection.omega) > FEW, np.size(projection.mode_omega) > FEW
    if many or not sweep:
        yield "onefreq", draw_one_frequency(result)
    if many and sweep:
        yield "maxci", draw_dominant(result)
    if sweep:
        yield "cifreq", draw_three_modes(result)


def draw_one_frequency(result):
    """Return the coefficients against the frequency of the modes (paper: onefreq).

    Of the driving frequencies that are as accurate as asked, the one nearest to .6 omega_mx.
    """
    x, modes, good = in_units(result)
    distance = np.abs(x - SHOWN) + np.where(good, 0.0, np.inf)
    shown = int(distance.argmin())
    coefficient = np.abs(result.projection.coefficient[shown])
    figure, ax = new_panel()
    ax.set_yscale("log")
    ax.set_xlim(response.limits(modes, 0.0, np.inf))
    drive = ax.axvline(x[shown], color=style.ACCENT, zorder=1)
    if good[shown]:
        dots = {"color": "#999999", "markerfacecolor": "black", "linewidth": 0.5}
        drawn = np.isfinite(coefficient) & (coefficient > 0)
        style.draw_good(ax, modes, coefficient, drawn, True, **dots)
    else:
        style.note(figure, f"{x[shown]:g} $\\omega_{{mx}}$ missed the accuracy asked for")
        ax.yaxis.set_visible(False)
    style.legend_above(ax, {rf"driving frequency {x[shown]:.4g} $\omega_{{mx}}$": drive}, columns=1)
    ax.set_xlabel(mode_figures.FREQUENCY)
    ax.set_ylabel(COEFFICIENT)
    return figure_of(result, figure)


def draw_dominant(result):
    """Return the frequency of the dominant mode against the drive (paper: maxci).

    With a line of slope 1. Points that missed the accuracy asked for are crosses on the upper edge.
    """
    x, modes, good = in_units(result)
    dominant = result.projection.dominant
    figure, ax = new_panel()
    ax.set_xlim(response.limits(x, 0.0, np.inf))
    ends = np.array([max(x[0], modes[0]), min(x[-1], modes[-1])])
    handles = {}
    if ends[0] < ends[1]:
        (handles["slope 1"],) = ax.plot(ends, ends, color=style.pale(style.ACCENT), linewidth=2.5)
    good = good & (dominant >= 0)
    style.draw_good(
        ax, x, modes[dominant], good, True, color="black", linestyle="none", markersize=2.5
    )
    mark_failed(ax, x, good, handles)
    style.legend_above(ax, handles, columns=2)
    ax.set_xlabel(response.FREQUENCY)
    ax.set_ylabel(r"dominant mode $\omega_i/\omega_{mx}$")
    return figure_of(result, figure)


def draw_three_modes(result):
    """Return the coefficients of three successive modes against the drive (paper: cifreq).

    The modes nearest to .6 omega_mx, or to the middle of a sweep that is elsewhere; their own
    frequencies are broken lines. Points that missed the accuracy asked for are gaps, and crosses on
    the upper edge.
    """
    x, modes, good = in_units(result)
    centre = SHOWN if x[0] <= SHOWN <= x[-1] else (x[0] + x[-1]) / 2
    chosen = successive(modes, centre)
    near = (x >= modes[chosen[0]] - AROUND) & (x <= modes[chosen[-1]] + AROUND)
    if np.count_nonzero(near) <= FEW:
        near[:] = True
    figure, ax = new_panel()
    ax.set_xlim(x[near][[0, -1]])
    ax.set_yscale("log")
    handles = {}
    for mode, colour in zip(chosen, style.colours(len(chosen)), strict=True):
        label = rf"$\omega_i$ = {modes[mode]:.5f} $\omega_{{mx}}$"
        coefficient = np.abs(result.projection.coefficient[near, mode])
        handles[label] = style.draw_good(
            ax,
            x[near],
            coefficient,
            good[near] & np.isfinite(coefficient) & (coefficient > 0),
            np.count_nonzero(near) <= response.FEW,
            color=colour,
        )
        ax.axvline(modes[mode], color=colour, linestyle=":", zorder=1)
    mark_failed(ax, x[near], good[near], handles)
    style.legend_above(ax, handles, columns=1)
    ax.set_xlabel(response.FREQUENCY)
    ax.set_ylabel(COEFFICIENT)
    return figure_of(result, figure)


def in_units(result):
    """Return driving and mode frequencies in units of omega_mx, and which drives are accurate."""
    projection, unit = result.projection, result.lattice.omega_mx
    good = projection.converged_reason > 0
    return projection.omega / unit, projection.mode_omega / unit, good


def successive(modes, centre):
    """Return the indices of the up to three successive modes nearest to a frequency."""
    first = range(max(1, len(modes) - 2))
    windows = [list(range(n, min(n + 3, len(modes)))) for n in first]
    return min(windows, key=lambda window: np.abs(modes[window] - centre).max())


def new_panel():
    """Return a figure of one column with one panel."""
    figure = style.new_figure(style.COLUMN, 2.7)
    return figure, figure.subplots()


def mark_failed(ax, x, good, handles):
    """Mark frequencies without a good result, and note them for the legend."""
    failed = style.mark_failed(ax, x[~good])
    if failed:
        handles[failed.get_label()] = failed


def figure_of(result, figure):
    """Return a figure, with a note if it lacks modes."""
    mode_figures.note_missing(figure, result.projection, np.size(result.projection.mode_omega))
    return figure
