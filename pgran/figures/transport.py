"""Figures of transport: amplitude against depth, attenuation length, delay."""

import numpy as np

from pgran.figures import style

SHOWN = 4  # frequencies
SAID = (
    "Mean logarithm of the amplitude against the distance from the driven wall, at some driving "
    "frequencies.",
    "Attenuation length against the driving frequency, where it is known.",
    "Mean group delay against the distance. Bars: standard errors over samples.",
)


def figures(result, **_):
    """Yield the profiles over depth above the attenuation length by frequency and the delay."""
    found, unit = result.transport, result.medium.omega_mx
    figure, axes = style.page(style.COLUMN, 6.6, nrows=3)
    profile(axes[0], found, unit)
    length(axes[1], found, unit)
    delay(axes[2], found, unit)
    style.legend_above(axes[:1])
    figure.align_ylabels()
    figure.caption = style.lettered(SAID)
    yield "transport", figure


def profile(ax, found, unit):
    """Draw <ln|A|> against depth at a few frequencies; return the curves."""
    chosen = np.unique(np.linspace(0, len(found.omega) - 1, SHOWN + 2).astype(int)[1:-1])
    ax.set(xlabel=style.DISTANCE, ylabel=r"$\langle\ln|A|\rangle$")
    drawn = []
    for number, mark, shade in zip(chosen, "osv^", style.colours(SHOWN), strict=False):
        label = rf"{found.omega[number] / unit:.3g} $\omega_{{mx}}$"
        error = found.ln_amplitude_error[number]
        look = {"fmt": mark, "markersize": 3, "elinewidth": 0.8, "label": label, "color": shade}
        drawn.append(ax.errorbar(found.depth, found.ln_amplitude[number], error, **look))
    return drawn


def length(ax, found, unit):
    """Draw the attenuation length by frequency, where it is known; return what was drawn."""
    known = np.isfinite(found.length)
    ax.set(ylabel=style.ATTENUATION, yscale="log")
    style.frequencies(ax, found.omega / unit)
    look = {"fmt": ".", "markersize": 3, "linewidth": 0.6, "color": style.ACCENT}
    values = found.omega[known] / unit, found.length[known], found.length_error[known]
    return ax.errorbar(*values, **look)


def delay(ax, found, unit):
    """Draw the mean delay against depth; return what was drawn."""
    ax.set(xlabel=style.DISTANCE, ylabel=style.DELAY)
    look = {"fmt": "o", "markersize": 3, "elinewidth": 0.8, "color": "black"}
    return ax.errorbar(found.depth, found.delay * unit, found.delay_error * unit, **look)
