"""The figure of a relaxing network: amplitude against time, power spectrum (paper: timeres)."""

import numpy as np

from pgran.errors import FileError
from pgran.figures import check_group, style
from pgran.figures.response import AMPLITUDE, FEW

NEEDS = ("omega", "detector", "displacement")
SPECTRUM = ("exponent", "exponent_error", "scale", "fit_min", "fit_max", "frequency", "power")
STRETCH = 2000  # steps of the series that are drawn
APART = 6.0  # factor between the spectrum and the line of slope -2


def figures(result, modes=None):
    """Yield the name and the figure of a relaxation.

    Parameters
    ----------
    result : types.SimpleNamespace
        With groups `relaxation`, `lattice`, and `spectrum` if there is one.
    modes
        Not used.

    Raises
    ------
    FileError
        If there is no trajectory, or a spectrum is incomplete.
    """
    if not np.size(result.relaxation.displacement):
        raise FileError("nothing to draw in this result: no amplitudes")
    if hasattr(result, "spectrum"):
        check_group(result, "spectrum", SPECTRUM)
    yield "timeres", draw_relaxation(result)


def draw_relaxation(result):
    """Return the figure of the series and of its power spectrum, if there is one (paper: timeres).

    The series is the beginning of the first trajectory. Steps that missed the accuracy asked for
    are gaps, and crosses on the upper edge; of amplitudes at the floor the upper limit is drawn.
    """
    spectrum = getattr(result, "spectrum", None)
    panels = 2 if spectrum else 1
    figure = style.new_figure(style.COLUMN, 0.2 + 2.3 * panels)
    ax, *below = figure.subplots(panels, 1, squeeze=False)[:, 0]
    draw_series(ax, result)
    for panel in below:
        draw_spectrum(panel, spectrum)
        ax.set_title("(a)")
        panel.set_title("(b)")
    figure.align_ylabels()
    missed = np.isnan(result.relaxation.displacement).any(axis=2)
    if missed.any():
        count = f"{np.count_nonzero(missed)} of {missed.size} amplitudes"
        style.note(figure, f"{count} missed the accuracy asked for")
    return figure


def draw_series(ax, result):
    """Draw the amplitudes of the first trajectory against time."""
    beginning = np.s_[0, : STRETCH + 1]
    series = np.abs(result.relaxation.displacement[beginning])
    highest = style.upper_limits(result.relaxation, np.abs(result.relaxation.displacement))
    time = np.arange(len(series))
    ax.set_xlim(0, max(len(time) - 1, 1))
    ax.locator_params("x", nbins=5)
    handles, marks, detectors = {}, {}, result.relaxation.detector
    shades = style.colours(len(detectors))
    columns = zip(detectors, series.T, highest[beginning].T, shades, strict=True)
    for site, amplitude, limit, colour in columns:
        good = np.isfinite(amplitude) & np.isnan(limit)
        handles[style.ball_name(site)] = style.draw_good(
            ax, time, amplitude, good, len(time) <= FEW, color=colour
        )
        limits = style.draw_limits(ax, time, limit, colour)
        if limits:
            marks[limits.get_label()] = limits
    if np.isfinite(series).any():
        ax.set_ylim(bottom=0)
    else:
        ax.yaxis.set_visible(False)
    failed = style.mark_failed(ax, time[np.isnan(series).any(axis=1)])
    if failed:
        marks[failed.get_label()] = failed
    style.legend_above(ax, handles | marks, columns=1 if marks else 2)
    ax.set_xlabel("time (steps of one bond)")
    ax.set_ylabel(AMPLITUDE)


def draw_spectrum(ax, spectrum):
    """Draw a power spectrum, the law fitted to it, and a line of slope -2."""
    f, power = spectrum.frequency, spectrum.power
    ax.set(xscale="log", yscale="log")
    ax.plot(f, power, color="#777777", linewidth=0.5)
    window = np.geomspace(spectrum.fit_min, spectrum.fit_max, 100)
    law = spectrum.scale / (2 * np.sin(np.pi * window)) ** spectrum.exponent
    (fit,) = ax.plot(window, law, color=style.ACCENT, linewidth=1.5)
    middle = len(window) // 2
    parallel = APART * law[middle] * (window / window[middle]) ** -2.0
    (slope,) = ax.plot(window, parallel, color="black", linestyle="--")
    value = rf"$\psi = {spectrum.exponent:.3f} \pm {spectrum.exponent_error:.3f}$"
    handles = {rf"$S \propto (2\sin\pi f)^{{-\psi}}$, {value}": fit, r"slope $-2$": slope}
    ax.legend(handles.values(), handles.keys(), loc="lower left", borderaxespad=0.8)
    ax.set_xlabel("frequency $f$ (cycles per step)")
    ax.set_ylabel("power density $S$ (steps per cycle)")
