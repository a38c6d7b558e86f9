"""The figures of a pulse: signals by distance, fields, energy; `transfer` has the spectra."""

from functools import partial

import numpy as np

from pgran.draw import balls, bonds, network, style, together
from pgran.draw.view import View
from pgran.experiments.pulse import transfer


def figures(result, response=None, **_):
    """Yield the signals, the field if it is stored, the energy if known, spectra, and the bonds."""
    signals, lattice = result.pulse, result.medium
    figure, (ax,) = style.page(style.PAGE, min(8.0, 1.6 + 0.7 * (1 + len(signals.detector))))
    seismogram(ax, signals, lattice)
    style.legend_above([ax])
    figure.caption = (
        f"A pulse ({signals.shape}): displacements of balls against time, by their distance from "
        "what is driven, each in units of its largest; at the bottom the motion of the drive; "
        "thick ticks: arrival of the front, when a thousandth of the signal's energy has passed; "
        "pale: envelopes."
    )
    yield "signals", figure
    if signals.field is not None and lattice.has_places:
        yield "field", _field_page(signals, lattice)
    if signals.energy is not None:
        figure, (ax,) = style.page(style.COLUMN, 2.7)
        energy(ax, signals, lattice)
        style.legend_above([ax])
        figure.caption = "Work of the drive, energy of balls and springs, and what damping took."
        yield "energy", figure
    yield "spectrum", transfer.page(signals, lattice, response)
    if lattice.group == "lattice":
        yield "bonds", bonds.page(lattice, signals.detector)


def seismogram(ax, signals, lattice):
    """Draw the signals above each other, each scaled to its largest, by distance from the wall.

    The wall's own motion is at the bottom; ticks mark where fronts have arrived. Envelopes are pale
    lines, unless the wall ends elsewhere than it began. What is below its error is not drawn.
    Returns the curves.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    signals : pgran.results.Signals
    lattice : pgran.results.LatticeRecord
    """
    time, largest = signals.time * lattice.omega_mx, np.abs(signals.displacement).max(axis=0)
    known = largest > signals.error.max(axis=0)
    distance = lattice.built.depths(signals.detector)
    wall = signals.wall / np.abs(signals.wall).max()
    returns = abs(wall[-1]) < 0.1  # else signals do not swing about 0, which an envelope supposes
    ax.plot(time, 0.45 * wall, color=style.ACCENT)
    drawn, rows, fronts = [], [style.driven(lattice)], [signals.wall_arrival]
    label = "envelope"
    for row, d in enumerate(np.argsort(distance, kind="stable"), 1):
        name = style.ball_names(signals.detector[d : d + 1])[0]
        rows.append(f"{name}\n" + (f"largest {largest[d]:.2g}" if known[d] else "below its error"))
        fronts.append(signals.arrival[d] if known[d] else np.nan)
        if not known[d]:
            continue
        scale = 0.45 / largest[d]
        if returns:
            above = row + scale * signals.envelope[:, d]
            ax.plot(time, above, color="#aaaaaa", linewidth=0.6, label=label)
            label = None
        drawn += ax.plot(time, row + scale * signals.displacement[:, d], color="black")
    ends = np.arange(len(rows)) + np.array([[-0.3], [0.3]])
    look = {"color": style.FAILED, "linewidth": 1.2, "zorder": 3}
    look["label"] = "front: a thousandth of the energy has passed"
    ax.vlines(np.array(fronts) * lattice.omega_mx, *ends, **look)
    ax.set_yticks(range(len(rows)), rows)
    ax.set(xlabel=style.TIME, xlim=time[[0, -1]], ylim=(-0.7, len(rows) - 0.3))
    return drawn


def field(ax, signals, lattice, number):
    """Draw the displacement of all balls at one time in units of its largest, or the wall's.

    Colours from -1, dark blue, to 1, yellow; of many balls a few may be beyond `balls.scale_of`.
    The driven wall and the detectors are marked. Three dimensions: the plane of the first detector.
    One: a line from wall to wall. A network is drawn by `network.motion`. Returns the image, the
    line, or arrows or balls.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    signals : pgran.results.Signals
        With `field`.
    lattice : pgran.results.LatticeRecord
    number : int
        Which of the times.
    """
    time, plane = signals.field_time[number], tuple(signals.detector[0, 2:])
    wall = np.interp(time, signals.time, signals.wall)
    look = {"linestyle": "none", "markerfacecolor": "white", "markersize": 3}
    look |= {"marker": "o", "markeredgecolor": "black", "markeredgewidth": 0.6}
    if lattice.group == "network":
        view, values = View(lattice, signals.detector[0, 0]), signals.field[number]
        drawn, unit = network.motion(ax, lattice, view, values, wall, beyond=True)
        dots = view.xy[[ball for ball in signals.detector[:, 0] if view.seen[ball]]]
        ax.plot(*dots.T, label="detectors", zorder=4, **look)
        ax.set_title(_title(time, lattice, unit, balls.beyond(drawn)))
        return drawn
    values = signals.field[(number, ..., *plane)]
    moves, chain = np.append(values, wall), values.ndim == 1
    unit = (np.abs(moves).max() or 1.0) if chain else balls.scale_of(moves)
    drawn = balls.draw(ax, values / unit, wall / unit)
    dots = signals.detector[(signals.detector[:, 2:] == plane).all(axis=1), :2]
    heights = values[dots[:, 0]] / unit if chain else dots[:, 1]
    ax.plot(dots[:, 0], heights, label="detectors", **look)
    ax.set_title(_title(time, lattice, unit, not chain and balls.beyond(drawn)))
    return drawn


def _title(time, lattice, unit, few):
    """Return the title of a field; whether few balls move farther than its unit."""
    size = f"{'99% within' if few else 'largest'} {unit:.2g}"
    return rf"$t$ = {time * lattice.omega_mx:.4g}$/\omega_{{mx}}$, {size}"


def energy(ax, signals, lattice):
    """Draw the work of the drive, the energy of balls and springs, and what damping took.

    Returns the curves.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    signals : pgran.results.Signals
        With `energy`.
    lattice : pgran.results.LatticeRecord
    """
    time, unit = signals.time * lattice.omega_mx, lattice.built.mass * lattice.omega_mx**2
    shown = [
        (signals.work, "work of the drive", {"color": "#bbbbbb", "linewidth": 2.5}),
        (signals.energy, "energy of balls and springs", {"color": style.ACCENT}),
        (signals.dissipated, "taken by damping", {"color": style.UNRESOLVED, "linestyle": "--"}),
    ]
    ax.set(xlabel=style.TIME, xlim=time[[0, -1]])
    ax.set_ylabel(r"energy ($m\,\omega_{mx}^2 \times$ displacement$^2$)")
    return [ax.plot(time, y / unit, label=label, **look)[0] for y, label, look in shown]


def _field_page(signals, lattice):
    """Return the figure of the fields at all times."""
    times = range(len(signals.field_time))
    panels = [partial(field, signals=signals, lattice=lattice, number=n) for n in times]
    said = "Displacements of all balls at some times."
    if lattice.group == "network":
        view = View(lattice, signals.detector[0, 0])
        figure = balls.page(view.extent, panels)
        figure.caption = said
        network.explain(figure, lattice, view.plane, "circles: detectors")
        return figure
    figure = balls.page(lattice.shape, panels)
    text = "".join(f"plane $z$ = {z}, " for z in signals.detector[0, 2:])
    text += "each scaled by itself; circles: detectors"
    style.above(figure, text)
    figure.caption = f"{said} {text.capitalize()}. {balls.DRIVEN}"
    return figure


def over(results, labels):
    """Yield the signals of the first detector; not those that are below their error."""
    figure, (ax,) = style.page(style.PAGE, 2.5)
    for number, (result, label) in enumerate(zip(results, labels, strict=True)):
        signals, time = result.pulse, result.pulse.time * result.medium.omega_mx
        moved, error = signals.displacement[:, 0], signals.error[:, 0]
        if not np.abs(moved).max() > error.max():
            label, moved = f"{label}: below its error", np.full_like(moved, np.nan)
        ax.plot(time, moved, label=label, **together.look_of(number))
    first = {style.ball_names(result.pulse.detector[:1])[0] for result in results}
    ax.set_title(first.pop() if len(first) == 1 else "first detectors")
    last = max(result.pulse.time[-1] * result.medium.omega_mx for result in results)
    ax.set(xlabel=style.TIME, ylabel="displacement", xlim=(0, last))
    together.finish(figure)
    figure.caption = "Displacement of a ball against time."
    yield "signals", figure
