"""The figures of noisy responses: P(I/<I>) and the correlation of I, beside the Gaussian laws."""

from functools import partial

import numpy as np

from pgran.draw import style

SHADES = {"whole": "black", "incoherent": "#0072B2"}
NAMES = {"whole": "measured", "incoherent": r"less $\langle A\rangle$"}
WIDTHS = 6  # half widths up to which correlations are drawn
CAPTIONS = {
    "intensity": "Density of the intensity $I = |A|^2$ over its mean, with standard errors.",
    "correlation": "Correlation of the intensity along the driving frequency.",
}
LAW = {"color": "#777777", "linewidth": 1.2}


def figures(result, **_):
    """Yield densities, and correlations in known half widths, a panel a window and detector."""
    found = result.statistics
    everywhere = list(np.ndindex(found.coherent_part.shape))
    scaled = [place for place in everywhere if np.isfinite(found.half_width[place]).any()]
    for panel, places in ((intensity, everywhere), (correlation, scaled)):
        draws = [partial(_titled, panel=panel, found=found, place=place) for place in places]
        if draws:
            yield panel.__name__, style.stack(draws, [CAPTIONS[panel.__name__]])


def _titled(ax, panel, found, place):
    """Draw a panel of one window and detector, and say which."""
    panel(ax, found, *place)
    w, d = place
    where = rf"{found.low[w]:g} $\leq \omega \leq$ {found.high[w]:g}"
    ax.set_title(f"{where}, {style.ball_names(found.detector)[d]}")


def intensity(ax, found, window=0, detector=0):
    """Draw the density of I/<I> with its errors, and exp(-x); return the line of the law."""
    middle = 0.5 * (found.edge[1:] + found.edge[:-1])
    # of a Gaussian field the mean over each bin, as the points are
    law = -np.diff(np.exp(-found.edge)) / np.diff(found.edge)
    (line,) = ax.plot(middle, law, label=r"Gaussian, $e^{-x}$", **LAW)
    for f, part in enumerate(found.part):
        value, error = (each[window, detector, f] for each in (found.density, found.density_error))
        _points(ax, middle, np.where(value > 0, value, np.nan), error, part)
    ax.set_xlim(found.edge[0], found.edge[-1])
    ax.set(yscale="log", xlabel=r"$x = I/\langle I\rangle$", ylabel="density $P(x)$")
    return line


def correlation(ax, found, window=0, detector=0):
    """Draw the correlation of I against the shift in its half widths, and a Lorentzian.

    Returns the line of the law.
    """
    known = np.isfinite(found.correlation[window, detector])
    reach = found.shift[window] / found.half_width[window, detector][:, None]
    furthest = min(WIDTHS, np.max(reach, where=known & np.isfinite(reach), initial=1.0))
    x = np.linspace(0, furthest, 200)
    (line,) = ax.plot(x, 1 / (1 + x**2), label="Lorentzian", **LAW)
    for f, part in enumerate(found.part):
        inside, place = reach[f] <= furthest, (window, detector, f)
        value, error = found.correlation[place], found.correlation_error[place]
        _points(ax, reach[f][inside], value[inside], error[inside], part)
    ax.axhline(0, color="black", linewidth=0.4)
    ax.set(xlim=(0, furthest), xlabel=r"shift of $\omega$ (half widths)")
    ax.set_ylabel("correlation of $I$")
    return line


def _points(ax, x, value, error, part):
    """Draw points with their errors, a shade and a mark for each part of the field."""
    whole, shade = part == "whole", SHADES[part]
    look = {"linestyle": "none", "marker": "o" if whole else "s", "markersize": 2.5}
    look |= {"markerfacecolor": shade if whole else "white", "markeredgewidth": 0.6}
    ax.errorbar(x, value, error, color=shade, label=NAMES[part], elinewidth=0.6, **look)
