"""Curves with gaps where results are not good, and what is marked along the frequency axis."""

from itertools import cycle

import numpy as np
from matplotlib.markers import TICKUP

from pgran.draw import scales, style

RUG_SPACING = 1.0  # points on paper that modes are apart at least to be marked one by one


def curves(ax, x, y, good, labels=None, limit=None, dots=None, **line):
    """Draw curves with gaps where points are not good; return them, masked there.

    Of points `x`, shape (n,), `y` has the shape (n,) or (n, curves), so have `good` and `limit`,
    upper limits or NaN, which are triangles that point down. A good point that stands alone is a
    dot, as are all with `dots`, by default those of at most `style.FEW`. Where nothing is good the
    axis of `y` is hidden. `line` is for `Axes.plot`.
    """
    y, good = np.reshape(y, (len(x), -1)), np.reshape(good, (len(x), -1))
    shades, drawn = style.colours(y.shape[1]), []
    dots = len(x) <= style.FEW if dots is None else dots
    for n, shade in enumerate(shades):
        padded = np.pad(good[:, n], 1)
        lone = good[:, n] & ~padded[:-2] & ~padded[2:]
        look = {"color": shade, "label": labels[n] if labels else None}
        dotted = np.flatnonzero(good[:, n] if dots else lone).tolist()
        if dotted:
            look |= {"marker": ".", "markevery": dotted, "markeredgewidth": 0}
        drawn += ax.plot(x, np.ma.masked_where(~good[:, n], y[:, n]), **(look | line))
    label = "upper limit, at the floor"
    look = {"linestyle": "none", "marker": "v", "markersize": 2.5, "markeredgewidth": 0}
    for n in [] if limit is None else np.flatnonzero(np.isfinite(limit).any(axis=0)):
        ax.plot(x, limit[:, n], color=drawn[n].get_color(), label=label, **look)
        label = None
    if not np.isfinite(ax.dataLim.height):
        ax.yaxis.set_visible(False)
    return drawn


def over_frequency(
    ax, record, medium, values, good, labels=None, limit=None, within=(-np.inf, np.inf), **line
):
    """Draw `curves` of a record over its driving frequencies, and mark those that failed."""
    x, reached = record.omega / medium.omega_mx, record.converged_reason > 0
    scales.frequencies(ax, x, within=within)
    good = np.reshape(good, (len(x), -1)) & reached[:, None]
    drawn = curves(ax, x, values, good, labels, limit, **line)
    failed(ax, x[~reached])
    return drawn


def points(ax, x, values, errors, labels, marks="osv^", xerr=0.0, **look):
    """Draw rows of values with errors; `x`, `xerr` are of all rows, or a row each; return them."""
    look = {"linestyle": "none", "markersize": 3, "elinewidth": 0.8} | look
    x, xerr, shades = *np.broadcast_arrays(x, xerr, values)[:2], style.colours(len(labels))
    drawn = []
    for n, (label, shade, mark) in enumerate(zip(labels, shades, cycle(marks), strict=False)):
        # of bars that are all NaN matplotlib warns
        known = slice(None if np.isfinite(values[n]).any() else 0)
        row = [each[n][known] for each in (x, values, errors, xerr)]
        row[3] = row[3] if np.any(xerr) else None
        drawn.append(ax.errorbar(*row, label=label, color=shade, marker=mark, **look))
    return drawn


def upper_limits(record):
    """Return the upper limits of amplitudes that are at the floor, NaN for all others."""
    amplitude = np.abs(record.displacement)
    at_floor = getattr(record, "at_floor", None)
    if at_floor is None:  # a file of version 0.1
        return np.full(amplitude.shape, np.nan)
    return np.where(at_floor > 0, amplitude + record.error_bound, np.nan)


def known_amplitudes(response):
    """Return which amplitudes are as accurate as asked, above the floor, and have a logarithm."""
    above = np.isfinite(response.amplitude) & (response.amplitude > 0)
    above &= np.isnan(upper_limits(response))
    return above & (response.converged_reason > 0)[:, None]


def failed(ax, x, label="missed the accuracy asked for"):
    """Mark where there is no good result, by crosses on the upper edge."""
    _mark(ax, x, 1.0, marker="x", color=style.FAILED, label=label)


def unresolved(ax, x):
    """Mark where straight lines between points are not the curve, by ticks on the lower edge."""
    ticks = {"marker": "|", "markersize": 3, "color": style.UNRESOLVED}
    _mark(ax, x, 0.015, label="curve not resolved", **ticks)


def modes(ax, x, label="normal modes"):
    """Mark frequencies of modes by ticks, or how dense many of them are (paper: freqres)."""
    low, high = ax.get_xlim()
    x = np.asarray(x)[(low <= x) & (x <= high)]
    points = 72 * ax.bbox.width / ax.figure.dpi
    if x.size * RUG_SPACING <= points:
        _mark(ax, x, 0.0, marker=TICKUP, color="black", markersize=4)
        ax.plot([], [], "k|", markersize=4, markeredgewidth=0.4, label=label)  # beside its words
        return
    counts, edges = np.histogram(x, np.linspace(low, high, int(points / 4)))
    height = 0.1 * np.append(counts, 0) / counts.max()
    look = {"color": "#b0b0b0", "linewidth": 0, "zorder": 0.4, "label": f"density of {label}"}
    ax.fill_between(edges, height, step="post", transform=ax.get_xaxis_transform(), **look)


def _mark(ax, x, height, **mark):
    """Draw marks at a height in units of the axes, those inside the limits of `ax`."""
    low, high = ax.get_xlim()
    inside = np.asarray(x)[(low <= x) & (x <= high)]
    if inside.size:
        mark |= {"linestyle": "none", "markeredgewidth": 0.4, "clip_on": False, "zorder": 5}
        place = {"transform": ax.get_xaxis_transform(), "scalex": False, "scaley": False}
        ax.plot(inside, np.full(inside.size, height), **place, **mark)
