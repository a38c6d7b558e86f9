"""The figures of a sweep: amplitude and phase against frequency (paper: freqres, phaseres)."""

import math

import numpy as np

from pgran.errors import FileError
from pgran.figures import style
from pgran.figures.bonds import draw_bonds

NEEDS = (
    *("omega", "detector", "amplitude", "phase", "converged_reason"),
    *("phase_slope", "phase_intercept", "phase_velocity", "phase_fit_min", "phase_fit_max"),
)
FREQUENCY = r"driving frequency $\omega/\omega_{mx}$"
AMPLITUDE = r"amplitude $|A|$ (driven wall = 1)"
EDGES = (0.3, 1.0)  # of the three regimes, in units of omega_mx
REGIMES = ("low frequencies", "intermediate frequencies", "high frequencies")
FEW = 100  # frequencies of a sweep that is drawn with dots


def figures(result, modes=None):
    """Yield the name and the figure of everything that a sweep has to show.

    Parameters
    ----------
    result : types.SimpleNamespace
        With groups `response` and `lattice`.
    modes : array_like, optional
        Angular frequencies of normal modes.

    Raises
    ------
    FileError
        If the sweep holds no frequency.
    """
    if not np.size(result.response.omega):
        raise FileError("nothing to draw in this result: no frequencies")
    yield "amplitude", draw_amplitude(result, modes)
    yield "phase", draw_phase(result, modes)
    yield "bonds", draw_bonds(result.lattice, result.response.detector)


def draw_amplitude(result, modes=None):
    """Return the figure of the amplitudes against frequency, a panel a regime (paper: freqres).

    Regimes that the sweep does not reach are left out. Points that missed the accuracy asked for
    are gaps in the curves and crosses on the upper edge; of amplitudes at the floor the upper limit
    is drawn.
    """
    response = result.response
    x, pluses = in_units(result, modes)
    home = regimes(x)
    present = np.unique(home)
    highest = style.upper_limits(response, response.amplitude)
    curves = list(zip(response.detector, response.amplitude.T, highest.T, strict=True))
    rows = math.ceil((len(curves) + np.isfinite(highest).any()) / 4)
    figure = style.new_figure(style.PAGE, 0.4 + 1.75 * len(present) + 0.13 * rows)
    panels = figure.subplots(len(present), 1, squeeze=False)[:, 0]
    handles, marks = {}, {}
    for letter, regime, ax in zip("abc", present, panels, strict=False):
        low, high = (0.0, *EDGES)[regime], (*EDGES, math.inf)[regime]
        inside = (low <= x) & (x <= high) | (home == regime)
        ax.set_yscale("log")
        ax.set_xlim(limits(x[home == regime], low, high))
        shades = style.colours(len(curves))
        for (site, amplitude, limit), colour in zip(curves, shades, strict=True):
            good = (good_points(response, amplitude) & (amplitude > 0) & np.isnan(limit))[inside]
            curve = style.draw_good(
                ax, x[inside], amplitude[inside], good, len(x) <= FEW, color=colour
            )
            if len(curves) > 1:
                handles[style.ball_name(site)] = curve
            upper = style.draw_limits(ax, x[inside], limit[inside], colour)
            if upper:
                marks[upper.get_label()] = upper
        mark(ax, response, x, pluses, marks)
        ax.set_title(f"({letter}) {REGIMES[regime]}" if len(present) > 1 else REGIMES[regime])
    style.legend_above(panels[0], handles | marks, columns=4)
    panels[-1].set_xlabel(FREQUENCY)
    figure.supylabel(AMPLITUDE, fontsize="medium")
    return figure


def draw_phase(result, modes=None):
    """Return the figure of the unwrapped phase with the straight lines fitted (paper: phaseres).

    A line covers the points that it was fitted to; its slope and the phase velocity (`phsvel`) are
    in the legend. Points that missed the accuracy asked for are as in the amplitudes.
    """
    response = result.response
    x, pluses = in_units(result, modes)
    count = len(response.detector)
    figure = style.new_figure(style.COLUMN, 2.5 + 0.13 * count)
    ax = figure.subplots()
    ax.set_xlim(limits(x, 0.0, math.inf))
    ax.locator_params("x", nbins=7)
    handles, fit = {}, None
    for d, (site, colour) in enumerate(zip(response.detector, style.colours(count), strict=True)):
        good = good_points(response, response.phase[:, d])
        label = style.ball_name(site)
        window = good & (x > response.phase_fit_min) & (x < response.phase_fit_max)
        if np.isfinite(response.phase_slope[d]) and window.any():
            ends = x[window][[0, -1]]
            line = response.phase_slope[d] * ends + response.phase_intercept[d]
            (fit,) = ax.plot(ends, line, color=style.pale(colour), linewidth=3, zorder=1)
            label += fit_text(response.phase_slope[d], response.phase_velocity[d])
        handles[label] = style.draw_good(
            ax, x, response.phase[:, d], good, len(x) <= FEW, color=colour
        )
    if fit:
        window = f"{response.phase_fit_min:g} to {response.phase_fit_max:g}"
        handles[rf"fit, {window} $\omega_{{mx}}$: slope $s$, phase velocity $v$ ($d$: spacing)"] = (
            fit
        )
    mark(ax, response, x, pluses, handles)
    style.legend_above(ax, handles, columns=1)
    ax.set_xlabel(FREQUENCY)
    ax.set_ylabel("phase (rad)")
    return figure


def in_units(result, modes):
    """Return the driving frequencies and those of the modes, in units of omega_mx."""
    unit = result.lattice.omega_mx
    return result.response.omega / unit, np.asarray([] if modes is None else modes) / unit


def regimes(x):
    """Return the regime of each frequency; an edge belongs below, the first point of all above."""
    home = np.searchsorted(EDGES, x)
    home[0] = np.searchsorted(EDGES, x[0], side="right")
    return home


def limits(x, low, high):
    """Return the range of an axis for the points `x`, within `low` and `high`."""
    margin = 0.05 * np.ptp(x) or 0.02
    return max(low, x.min() - margin), min(high, x.max() + margin)


def good_points(response, values):
    """Return which points are as accurate as asked, and finite."""
    return (response.converged_reason > 0) & np.isfinite(values)


def mark(ax, response, x, pluses, handles):
    """Mark failed frequencies and normal modes, and note the marks for the legend."""
    failed = style.mark_failed(ax, x[response.converged_reason <= 0])
    for marks in (failed, style.mark_modes(ax, pluses)):
        if marks:
            handles[marks.get_label()] = marks
    if not np.isfinite(ax.dataLim.height):
        ax.yaxis.set_visible(False)


def fit_text(slope, velocity):
    """Return the slope of the phase and the phase velocity in words."""
    return (
        rf": $s$ = ${slope:.4g}$ rad/$\omega_{{mx}}$, "
        rf"$v$ = {velocity:.3g} $d\,\omega_{{mx}}$"
    )
