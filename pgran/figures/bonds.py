"""The figure of a lattice: its bonds, walls and detectors (paper: sprpic)."""

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.ticker import MaxNLocator

from pgran.figures import style

MOST_LINES = 8000  # bonds; a lattice with more is drawn as an image of its balls


def draw_bonds(lattice, detectors):
    """Return the figure of the bonds, white to black from 0 to kmax (paper: sprpic).

    Three dimensions: the bonds within the plane of the first detector. A large lattice is drawn as
    an image: at each ball the mean constant of all its bonds.

    Parameters
    ----------
    lattice : types.SimpleNamespace
        The group `lattice` of a result.
    detectors : array_like of int, shape (nd, dim)

    Returns
    -------
    matplotlib.figure.Figure
    """
    sites = np.asarray(detectors)
    axes = len(lattice.shape)
    stiffness = [getattr(lattice, f"stiffness_{name}") for name in "xyz"[:axes]]
    plane, (nx, ny) = tuple(sites[0, 2:].tolist()), (*map(int, lattice.shape), 1)[:2]
    seen = [n for n, site in enumerate(sites.tolist()) if tuple(site[2:]) == plane]
    width, height, aspect = size(nx, ny, axes)
    columns = 3 if width == style.COLUMN else 6
    height += 0.13 * (len(seen) // columns) + 0.2 * len(plane)
    figure = style.new_figure(width, height)
    ax = figure.subplots()
    spacing = 72 * (width - 0.8) / (nx + 1)  # points from ball to ball

    kmax = lattice.mass * lattice.omega_mx**2 / (2 * axes)
    grey = {"cmap": "gray_r", "norm": Normalize(0.0, kmax)}
    segments, constants = bond_segments([k[(..., *plane)] for k in stiffness[:2]])
    if len(segments) <= MOST_LINES:
        thick = 8.0 if axes == 1 else min(max(0.3 * spacing, 0.5), 4.0)
        order = np.argsort(constants, kind="stable")  # stiff bonds over soft ones
        bonds = LineCollection(segments[order], array=constants[order], linewidths=thick, **grey)
        ax.add_collection(bonds)
        label = "bond constant $K$"
    else:
        constants = mean_of_bonds(stiffness)[(..., *plane)].reshape(nx, ny)
        bonds = ax.imshow(
            constants.T, origin="lower", extent=(-0.5, nx - 0.5, -0.5, ny - 0.5), **grey
        )
        label = "bond constant $K$, mean of each ball"
    ax.set(xlim=(-1, nx), ylim=(-1, ny), aspect=aspect)
    bar = figure.colorbar(
        bonds,
        ax=ax,
        label=label,
        orientation="horizontal",
        aspect=9 * width,
        pad=0.05,
        extend="max" if np.max(constants) > kmax * (1 + 1e-9) else "neither",
    )
    bar.outline.set_linewidth(0.6)

    handles, shades = {}, style.colours(len(sites))
    for n in seen:
        (handles[style.ball_name(sites[n])],) = ax.plot(
            *(*sites[n], 0)[:2],
            marker="o",
            markersize=min(max(0.7 * spacing, 5.0), 8.0),
            color=shades[n],
            markeredgecolor="white",
            linestyle="none",
        )
    handles["driven wall"] = draw_walls(ax, nx, ny, axes)
    style.legend_above(ax, handles, columns)
    if plane:
        figure.suptitle(f"bonds in the plane $z = {plane[0]}$", fontsize="medium")
    return figure


def size(nx, ny, axes):
    """Return the width and height of the figure in inches, and the aspect of its lattice."""
    chain = axes == 1
    ratio = (ny + 1) / (nx + 1)
    width = style.PAGE if chain or nx > 40 or ratio < 0.5 else style.COLUMN
    height = 0.35 if chain else min(max((width - 0.8) * ratio, 0.8), 6.5)
    return width, height + 1.1, "auto" if chain or not 1 / 8 <= ratio <= 8 else "equal"


def bond_segments(stiffness):
    """Return each bond of one or two axes as a line from site to site, and its constant.

    Returns
    -------
    segments : numpy.ndarray, shape (bonds, 2, 2)
        Both ends, x and y of each; walls count as sites.
    constants : numpy.ndarray, shape (bonds,)
    """
    segments = []
    for axis, k in enumerate(stiffness):
        upper = np.stack(np.meshgrid(*map(np.arange, k.shape), indexing="ij"), axis=-1)
        upper = upper.reshape(k.size, k.ndim)
        ends = np.zeros((k.size, 2, 2))
        ends[:, :, : k.ndim] = upper[:, None, :]
        ends[:, 0, axis] -= 1
        segments.append(ends)
    return np.concatenate(segments), np.concatenate([k.ravel() for k in stiffness])


def mean_of_bonds(stiffness):
    """Return the mean constant of the bonds at each ball."""
    total = 0.0
    for axis, k in enumerate(stiffness):
        count = k.shape[axis] - 1
        total = total + k.take(range(count), axis) + k.take(range(1, count + 1), axis)
    return total / (2 * len(stiffness))


def draw_walls(ax, nx, ny, axes):
    """Draw the walls, the driven one with a double arrow; return the driven one."""
    ax.spines[:].set_visible(False)
    rest = [[(-1, -1), (-1, ny)]]
    if axes > 1:
        rest += [[(-1, -1), (nx, -1)], [(-1, ny), (nx, ny)]]
    ax.add_collection(LineCollection(rest, colors="black", linewidths=1.5, clip_on=False))
    (driven,) = ax.plot([nx, nx], [-1, ny], color=style.ACCENT, linewidth=3, clip_on=False)
    ax.annotate(
        "",
        xy=(nx, (ny - 1) / 2),
        xytext=(22, 0),
        textcoords="offset points",
        arrowprops={"arrowstyle": "<->", "color": style.ACCENT, "shrinkA": 0, "shrinkB": 4},
    )
    for axis, count, name in ((ax.xaxis, nx, "i"), (ax.yaxis, ny, "j")):
        ticks = MaxNLocator(nbins=6, steps=[1, 2, 5, 10], integer=True).tick_values(
            0, max(count - 1, 1)
        )
        axis.set_ticks([int(tick) for tick in ticks if 0 <= tick < count])
        axis.set_label_text(f"ball ${name}$")
    ax.yaxis.set_visible(axes > 1)
    return driven
