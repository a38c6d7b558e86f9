"""Figures of transport: amplitude against depth, attenuation length, delay."""

import numpy as np

from pgran.draw import style

SHOWN = 4  # frequencies
SAID = (
    "Mean logarithm of the amplitude against the distance from the driven wall, at some driving "
    "frequencies.",
    "Attenuation length against the driving frequency, where it is known: above the first mode "
    "(dashed).",
    "Mean group delay in bands of frequencies against the distance.",
    "Mean group delay against the driving frequency at the smallest and the largest distance, "
    "linear up to a power of ten next to its median. Bars: standard errors over samples.",
)


def figures(result, **_):
    """Yield profiles over depth, the attenuation length by frequency, and delays by both."""
    found, unit = result.transport, result.medium.omega_mx
    delays = found.group_delay is not None  # files before version 5 have none
    panels = [profile, length] + [band_delay, delay] * delays
    figure, axes = style.page(style.COLUMN, 0.2 + 2.1 * len(panels), nrows=len(panels))
    for ax, panel in zip(axes, panels, strict=True):
        panel(ax, found, unit)
    for ax, panel in zip(axes, panels, strict=True):
        if panel is not length:
            style.legend_above([ax])
    figure.align_ylabels()
    figure.caption = style.lettered(SAID[: len(panels)])
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
    if found.first_mode is not None:
        ax.axvline(found.first_mode / unit, color="black", linestyle="--", linewidth=0.6)
    return ax.errorbar(*values, **look)


def band_delay(ax, found, unit):
    """Draw the mean delay of each band against depth; return the curves."""
    ax.set(xlabel=style.DISTANCE, ylabel=style.DELAY)
    ends = found.edge / unit
    drawn = []
    for band, (mark, shade) in enumerate(zip("osv", style.colours(len(ends) - 1), strict=False)):
        label = rf"{ends[band]:.3g} to {ends[band + 1]:.3g} $\omega_{{mx}}$"
        late, error = found.band_delay[band] * unit, found.band_delay_error[band] * unit
        look = {"fmt": mark, "markersize": 3, "elinewidth": 0.8, "label": label, "color": shade}
        drawn.append(ax.errorbar(found.depth, late, error, **look))
    return drawn


def delay(ax, found, unit):
    """Draw the mean delay by frequency at the smallest and the largest depth; return the curves."""
    style.frequencies(ax, found.omega / unit)
    ax.set_ylabel(style.DELAY)
    late = found.group_delay[:, [0, -1]] * unit
    style.symmetric(ax, late, 10.0 ** np.round(np.log10(np.median(np.abs(late)))))
    drawn = []
    for place, mark, shade in ((0, "o", "black"), (-1, "s", style.ACCENT)):
        late, error = (x[:, place] * unit for x in (found.group_delay, found.group_delay_error))
        look = {"fmt": mark, "markersize": 2, "elinewidth": 0.6, "color": shade}
        label = f"{found.depth[place]:g} spacings"
        drawn.append(ax.errorbar(found.omega / unit, late, error, label=label, **look))
    return drawn
