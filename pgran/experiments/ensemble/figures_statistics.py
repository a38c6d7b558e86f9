"""The figures of noisy responses: P(I/<I>) and the correlation of I, beside the Gaussian laws."""

import numpy as np

from pgran.draw import style

SHADES = {"whole": "black", "incoherent": "#0072B2"}
NAMES = {"whole": "measured", "incoherent": r"less $\langle A\rangle$"}
WIDTHS = 6  # half widths up to which correlations are drawn

SAID = {
    "intensity": "Density of the intensity $I = |A|^2$ over its mean, with standard errors.",
    "correlation": "Correlation of the intensity along the driving frequency.",
}


def figures(result, **_):
    """Yield densities, and correlations in known half widths, a panel a window and detector."""
    found = result.statistics
    everywhere = list(np.ndindex(found.coherent_part.shape))
    scaled = [place for place in everywhere if np.isfinite(found.half_width[place]).any()]
    for panel, places in ((intensity, everywhere), (correlation, scaled)):
        if not places:
            continue
        figure, panels = style.page(style.COLUMN, 0.5 + 2.2 * len(places), nrows=len(places))
        figure.caption = SAID[panel.__name__]
        for ax, (w, d) in zip(panels, places, strict=True):
            panel(ax, found, w, d)
            where = rf"{found.low[w]:g} $\leq \omega \leq$ {found.high[w]:g}"
            ax.set_title(where + (f", {style.ball_names(found.detector)[d]}"))
        for ax in panels:
            ax.legend(loc="upper right", borderaxespad=0.6)
        yield panel.__name__, figure


def intensity(ax, found, window=0, detector=0):
    """Draw the density of I/<I> with its errors, and exp(-x); return the line of the law.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    found : pgran.results.NoiseStatistics
    window, detector : int
    """
    middle = 0.5 * (found.edge[1:] + found.edge[:-1])
    # of a Gaussian field the mean over each bin, as the points are
    law = -np.diff(np.exp(-found.edge)) / np.diff(found.edge)
    (line,) = ax.plot(middle, law, color="#777777", linewidth=1.2, label=r"Gaussian, $e^{-x}$")
    for f, which in enumerate(found.part):
        value, error = (part[window, detector, f] for part in (found.density, found.density_error))
        _points(ax, middle, np.where(value > 0, value, np.nan), error, which)
    ax.set_xlim(found.edge[0], found.edge[-1])
    ax.set(yscale="log", xlabel=r"$x = I/\langle I\rangle$", ylabel="density $P(x)$")
    return line


def correlation(ax, found, window=0, detector=0):
    """Draw the correlation of I against the shift in its half widths, and a Lorentzian.

    Returns the line of the law. Parameters are those of `intensity`.
    """
    known = np.isfinite(found.correlation[window, detector])
    reach = found.shift[window] / found.half_width[window, detector][:, None]
    furthest = min(WIDTHS, np.max(reach, where=known & np.isfinite(reach), initial=1.0))
    x = np.linspace(0, furthest, 200)
    (line,) = ax.plot(x, 1 / (1 + x**2), color="#777777", linewidth=1.2, label="Lorentzian")
    for f, which in enumerate(found.part):
        place = window, detector, f
        shift, inside = reach[f], reach[f] <= furthest
        value, error = (
            part[place][inside] for part in (found.correlation, found.correlation_error)
        )
        _points(ax, shift[inside], value, error, which)
    ax.axhline(0, color="black", linewidth=0.4)
    ax.set(
        xlim=(0, furthest), xlabel="shift of $\\omega$ (half widths)", ylabel="correlation of $I$"
    )
    return line


def _points(ax, x, value, error, which):
    """Draw points with their errors, a shade and a mark for each part of the field."""
    look = {"marker": "o" if which == "whole" else "s", "markersize": 2.5, "elinewidth": 0.6}
    ax.errorbar(
        x, value, error, linestyle="none", color=SHADES[which], label=NAMES[which],
        markerfacecolor=SHADES[which] if which == "whole" else "white", markeredgewidth=0.6, **look,
    )  # fmt: skip
