"""The figure of a pulse: the signals of a row of detectors, each at its distance from the wall."""

import numpy as np

from pgran.figures import bonds, style


def figures(result, modes=None):
    """Yield the signals, and the bonds."""
    signals, lattice = result.pulse, result.medium
    figure, (ax,) = style.page(style.PAGE, min(8.0, 1.6 + 0.7 * (1 + len(signals.detector))))
    seismogram(ax, signals, lattice)
    style.legend_above([ax], columns=2)
    yield "signals", figure
    yield "bonds", bonds.page(lattice, signals.detector)


def seismogram(ax, signals, lattice):
    """Draw the signals above each other, each scaled to its largest, by distance from the wall.

    The wall's own motion is at the bottom; a tick marks where a front has arrived. What is below
    the bound of its error is not drawn. Returns the curves.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    signals : pgran.results.Signals
    lattice : pgran.results.LatticeRecord
    """
    distance = lattice.shape[0] - signals.detector[:, 0]
    order = np.argsort(distance, kind="stable")
    known = np.abs(signals.displacement).max(axis=0) > signals.error_bound.max(axis=0)
    largest = np.abs(signals.displacement).max(axis=0)
    wall = signals.wall / np.abs(signals.wall).max()
    ax.plot(signals.time, 0.45 * wall, color=style.ACCENT)
    drawn, rows = [], ["driven wall"]
    label = "front: a tenth of the largest displacement"
    for row, d in enumerate(order, 1):
        name = style.ball_names(signals.detector[d : d + 1])[0]
        if known[d]:
            rows.append(f"{name}\nlargest {largest[d]:.2g}")
            values = row + 0.45 * signals.displacement[:, d] / largest[d]
            drawn += ax.plot(signals.time, values, color="black")
        else:
            rows.append(f"{name}\nbelow its error")
        if known[d] and np.isfinite(signals.arrival[d]):
            ax.plot(
                *([signals.arrival[d]] * 2, [row - 0.3, row + 0.3]),
                color=style.FAILED, linewidth=1.2, label=label,
            )  # fmt: skip
            label = None
    ax.set_yticks(range(len(rows)), rows)
    ax.set(xlabel=r"time ($\sqrt{m/k}$)", xlim=(signals.time[0], signals.time[-1]))
    return drawn
