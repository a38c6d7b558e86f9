"""The figure of a likeness: correlations, stretches, and how a coda decorrelates, by windows."""

from functools import partial

import numpy as np

from pgran.draw import scales, style

SIGNALS = {"ln|A|": (r"$\ln|A|$", "o"), "A": ("$A$", "s"), "u": ("$u$", "o")}
CAPTIONS = (
    "in windows; open: under the stretch that makes it largest.",
    "That stretch, the relative change of frequencies or speeds, where one is known.",
    "Minus the logarithm of the correlation, against time.",
)


def figures(result, **_):
    """Yield the panels below each other."""
    found = result.likeness
    panels = [correlation, stretch] + [decorrelation] * (found.of == "pulse")
    both = f"Correlation of A ({found.label_a}) and B ({found.label_b}) {CAPTIONS[0]}"
    draws = [partial(panel, found=found) for panel in panels]
    page = style.stack(draws, [both, *CAPTIONS[1 : len(draws)]], shared=True)
    page.caption += " Bars: windows, and standard errors."
    yield "likeness", page


def correlation(ax, found):
    """Draw correlations as they are, and the largest ones; return the points of the first."""
    _points(ax, found, "", found.stretched, 0 * found.stretched, fill="white")
    return _points(ax, found, "correlation", found.correlation, found.correlation_error)


def stretch(ax, found):
    """Draw stretches; return the points."""
    return _points(ax, found, r"stretch $\epsilon$", found.stretch, found.stretch_error)


def decorrelation(ax, found):
    """Draw -ln of correlations where they are positive; return the points."""
    positive = np.where(found.correlation > 0, found.correlation, np.nan)
    return _points(ax, found, r"$-\ln\,$CC", -np.log(positive), found.correlation_error / positive)


def _points(ax, found, label, values, errors, fill=None):
    """Draw values with their errors in windows: a colour a detector, a mark a signal."""
    pulse, drawn = found.of == "pulse", []
    unit = (found.omega_mx or 1.0) ** (1 if pulse else -1)
    low, high = found.low * unit, found.high * unit
    shown = scales.TIME if pulse else scales.FREQUENCY
    scales.label(ax.xaxis, shown if found.omega_mx else shown._replace(own=""))
    ax.set(xlim=(low.min(), high.max()), ylabel=label)
    ax.axhline(0, color="black", linewidth=0.4)
    balls = style.ball_names(found.detector)
    for d, shade in enumerate(style.colours(len(balls))):
        for n, (signal, mark) in enumerate(SIGNALS[str(name)] for name in found.signal):
            name = ", ".join([balls[d]] * (len(balls) > 1) + [signal] * (not pulse))
            look = {"color": shade, "marker": mark, "markerfacecolor": fill or shade}
            look |= {"linestyle": "none", "markersize": 3, "elinewidth": 0.6}
            look["label"] = None if fill else name or None
            points = 0.5 * (low + high), values[:, d, n], errors[:, d, n], 0.5 * (high - low)
            known = np.isfinite(points[1])
            drawn.append(ax.errorbar(*(x[known] for x in points), **look))
    return drawn
