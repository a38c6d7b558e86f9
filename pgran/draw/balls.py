"""A number for each ball: an image of a plane of balls, or the line along a chain."""

import numpy as np

from pgran.draw import style

STILL = 1e-3  # of the largest: what moves less does not count among the balls that move
DRIVEN = "Thick blue line: driven wall."
NARROWEST = 1.3  # inches of a panel
MANY = 1000  # balls that move; the colours of fewer reach to the largest


def scale_of(values):
    """Return the number that is one end of the colours, 1 if nothing moves.

    That is the largest, or where many balls move their 99th percentile: a few of them, between soft
    bonds, move many times as far as the others, which would be pale.

    Parameters
    ----------
    values : numpy.ndarray
    """
    size = np.abs(values)
    moving = size[size > STILL * size.max()]
    return float(np.quantile(moving, 0.99) if moving.size > MANY else moving.max(initial=0)) or 1.0


def beyond(drawn):
    """Return whether some of the balls that are drawn are beyond the ends of the colours."""
    return drawn.get_array() is not None and np.abs(drawn.get_array()).max() > 1


def draw(ax, values, wall=0.0):
    """Draw numbers from -1, dark blue, to 1, yellow; return the image or the line.

    The driven wall is a thick blue line. One axis: a line from wall to wall.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    values : numpy.ndarray, shape (nx,) or (nx, ny)
    wall : float
        The number of the driven wall, where the line ends.
    """
    chain, (nx, ny) = values.ndim == 1, (*values.shape, 1)[:2]
    if chain:
        ax.axhline(0.0, color=style.MODE, linewidth=0.5)
        line = np.pad(values, 1, constant_values=(0.0, wall))
        (drawn,) = ax.plot(np.arange(-1, nx + 1), line, color="black")
        ax.set(xlim=(-1, nx), ylim=(-1.1, 1.1))
    else:
        place = {"origin": "lower", "extent": (-0.5, nx - 0.5, -0.5, ny - 0.5)}
        colours = {"cmap": style.SIGNED, "vmin": -1.0, "vmax": 1.0, "interpolation": "nearest"}
        drawn = ax.imshow(values.T, **place, **colours)
        ax.set(aspect="equal" if 1 / 8 <= ny / nx <= 3 else "auto", ylabel="ball $j$")
    end = nx - (0.0 if chain else 0.5)
    ax.axvline(end, color=style.ACCENT, linewidth=3, clip_on=False, zorder=3, label="driven wall")
    ax.set_xlabel("ball $i$")
    ax.locator_params("x" if chain else "both", nbins=6, steps=[1, 2, 5, 10], integer=True)
    return drawn


def page(shape, draws, what="displacement"):
    """Return a figure of some panels, as many next to each other as fit; long ones stacked.

    Parameters
    ----------
    shape : tuple of number
        Of the lattice; of what is in a plane width and height.
    draws : list of callable
        Each draws into the axes that it is given and gives them a title. What they return is of
        one kind; a colour bar says what its colours are.
    what : str
        That the colours are of.
    """
    (nx, ny), chain = (*shape, 1)[:2], len(shape) == 1
    flat, room = chain or nx > 1.5 * ny, style.wide(style.PAGE) - 1.2
    columns = 1 if flat else min(len(draws), max(1, int(room / NARROWEST)))
    rows = -(-len(draws) // columns)
    width = room if flat else min(2.2, room / columns)
    height = 1.1 if chain else min(max(width * ny / nx, 0.7), 7.0 / rows)
    size = columns * width + 1.2, rows * (height + 0.35) + 0.5
    figure, panels = style.page(*size, nrows=rows, ncols=columns, sharex=True, sharey=True)
    figure.set_layout_engine("compressed")  # as many panels as fit, next to each other
    for ax in panels[len(draws) :]:
        ax.remove()
    panels = figure.panels = panels[: len(draws)]
    shown = []
    for draw_into, ax in zip(draws, panels, strict=True):
        shown.append(draw_into(ax))
        if not flat:
            ax.set_title(ax.get_title(loc="left").replace(", ", "\n     ", 1))
        ax.label_outer()
    if chain:
        figure.supylabel(f"{what} / largest", fontsize="medium")
    elif shown[0].get_array() is not None:
        few = any(map(beyond, shown))
        bar = {"ticks": [-1, -0.5, 0, 0.5, 1], "pad": 0.02, "extend": "both" if few else "neither"}
        of = "99th percentile" + "\nof balls that move" * (what == "displacement")
        of = of if few else "largest"
        figure.colorbar(shown[0], ax=list(panels), label=f"{what} / {of}", **bar)
    return figure
