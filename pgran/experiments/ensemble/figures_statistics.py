"""The figures of noisy responses: P(I/<I>) and the correlation of I, beside the Gaussian laws."""

from functools import partial

import numpy as np

from pgran.draw import marks, scales, style

NAMES = {"whole": "computed", "incoherent": r"less $\langle A\rangle$"}
WIDTHS = 6  # half widths up to which correlations are drawn
CAPTIONS = {
    "intensity": "Density of the intensity $I = |A|^2$ over its mean, with standard errors.",
    "correlation": "Correlation of the intensity along the driving frequency.",
}
LAW = {"color": "#777777", "linewidth": 1.2}
LOOK = {"markersize": 2.5, "elinewidth": 0.6, "fillstyle": "none", "markeredgewidth": 0.6}


def figures(result, **_):
    """Yield densities, and correlations in known half widths, a panel a window and detector."""
    found, medium = result.statistics, result.medium
    everywhere = list(np.ndindex(found.coherent_part.shape))
    scaled = [place for place in everywhere if np.isfinite(found.half_width[place]).any()]
    for panel, places in ((intensity, everywhere), (correlation, scaled)):
        draws = [partial(_titled, panel=panel, place=place) for place in places]
        if draws:
            caption = CAPTIONS[panel.__name__]
            yield panel.__name__, style.stack(draws, caption, found=found, medium=medium)


def _titled(ax, found, medium, panel, place):
    """Draw a panel of one window and detector, and say which."""
    panel(ax, found, *place)
    w, d = place
    low, high = (scales.frequency(x[w] / medium.omega_mx, medium) for x in (found.low, found.high))
    ax.set_title(f"{low} to {high}, {style.ball_names(found.detector)[d]}")


def intensity(ax, found, window=0, detector=0):
    """Draw the density of I/<I> with its errors, and exp(-x); return the line of the law."""
    middle = 0.5 * (found.edge[1:] + found.edge[:-1])
    # of a Gaussian field the mean over each bin, as the points are
    law = -np.diff(np.exp(-found.edge)) / np.diff(found.edge)
    (line,) = ax.plot(middle, law, label=r"Gaussian, $e^{-x}$", **LAW)
    values, errors = (each[window, detector] for each in (found.density, found.density_error))
    values, names = np.where(values > 0, values, np.nan), [NAMES[part] for part in found.part]
    marks.points(ax, middle, values, errors, names, **LOOK)
    ax.set_xlim(found.edge[0], found.edge[-1])
    ax.set(yscale="log", xlabel=r"$x = I/\langle I\rangle$", ylabel="density $P(x)$")
    return line


def correlation(ax, found, window=0, detector=0):
    """Draw the correlation of I against the shift in half widths; return the line of the law."""
    known = np.isfinite(found.correlation[window, detector])
    reach = found.shift[window] / found.half_width[window, detector][:, None]
    furthest = min(WIDTHS, np.max(reach, where=known & np.isfinite(reach), initial=1.0))
    x = np.linspace(0, furthest, 200)
    (line,) = ax.plot(x, 1 / (1 + x**2), label="Lorentzian", **LAW)
    values, names = found.correlation[window, detector], [NAMES[part] for part in found.part]
    values = np.where(reach <= furthest, values, np.nan)
    errors = found.correlation_error[window, detector]
    marks.points(ax, reach, values, errors, names, **LOOK)
    ax.axhline(0, color="black", linewidth=0.4)
    ax.set(xlim=(0, furthest), xlabel=r"shift of $\omega$ (half widths)")
    ax.set_ylabel("correlation of $I$")
    return line
