"""Figures of transport: amplitude against depth, attenuation length, delay."""

from functools import partial
from itertools import pairwise

import numpy as np

from pgran.draw import scales, style

SHOWN = 4  # frequencies
CAPTIONS = (
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
    draws = [partial(panel, found=found, unit=unit) for panel in panels]
    yield "transport", style.stack(draws, CAPTIONS[: len(panels)])


def profile(ax, found, unit):
    """Draw <ln|A|> against depth at a few frequencies; return the curves."""
    chosen = np.unique(np.linspace(0, len(found.omega) - 1, SHOWN + 2).astype(int)[1:-1])
    scales.label(ax.xaxis, scales.DISTANCE)
    ax.set_ylabel(r"$\langle\ln|A|\rangle$")
    labels = [rf"{found.omega[n] / unit:.3g} $\omega_{{mx}}$" for n in chosen]
    return _points(
        ax, found.depth, found.ln_amplitude[chosen], found.ln_amplitude_error[chosen], labels
    )


def length(ax, found, unit):
    """Draw the attenuation length by frequency, where it is known; return what was drawn."""
    known = np.isfinite(found.length)
    ax.set_yscale("log")
    scales.label(ax.yaxis, scales.ATTENUATION)
    scales.frequencies(ax, found.omega / unit)
    look = {"fmt": ".", "markersize": 3, "linewidth": 0.6, "color": style.ACCENT}
    values = found.omega[known] / unit, found.length[known], found.length_error[known]
    if found.first_mode is not None:
        ax.axvline(found.first_mode / unit, color="black", linestyle="--", linewidth=0.6)
    return ax.errorbar(*values, **look)


def band_delay(ax, found, unit):
    """Draw the mean delay of each band against depth; return the curves."""
    scales.label(ax.xaxis, scales.DISTANCE)
    scales.label(ax.yaxis, scales.DELAY)
    pairs = pairwise(found.edge / unit)
    labels = [rf"{low:.3g} to {high:.3g} $\omega_{{mx}}$" for low, high in pairs]
    late, error = found.band_delay * unit, found.band_delay_error * unit
    return _points(ax, found.depth, late, error, labels)


def delay(ax, found, unit):
    """Draw the mean delay by frequency at the smallest and the largest depth; return the curves."""
    scales.frequencies(ax, found.omega / unit)
    scales.label(ax.yaxis, scales.DELAY)
    late, error = (x[:, [0, -1]].T * unit for x in (found.group_delay, found.group_delay_error))
    scales.symmetric(ax, late, 10.0 ** np.round(np.log10(np.median(np.abs(late)))))
    labels = [f"{depth:g} spacings" for depth in found.depth[[0, -1]]]
    return _points(ax, found.omega / unit, late, error, labels, markersize=2, elinewidth=0.6)


def _points(ax, x, values, errors, labels, **look):
    """Draw rows of values with their errors, a colour and a mark each; return them."""
    look = {"linestyle": "none", "markersize": 3, "elinewidth": 0.8} | look
    rows = zip(values, errors, labels, "osv^", style.colours(len(labels)), strict=False)
    return [
        ax.errorbar(x, value, error, marker=mark, label=label, color=shade, **look)
        for value, error, label, mark, shade in rows
    ]
