"""The figures of a pulse: signals by distance, fields, energy; `transfer` has the spectra."""

from functools import partial

import numpy as np

from pgran.draw import balls, bonds, captions, scales, style, together
from pgran.experiments.pulse import transfer


def figures(result, response=None, **_):
    """Yield the signals, the field if it is stored, the energy if known, spectra, and the bonds."""
    signals, lattice = result.pulse, result.medium
    panel = {"signals": signals, "lattice": lattice}
    caption = (
        f"A pulse ({signals.shape}): displacements of balls against time, by their depth, the "
        f"distance from what is driven in {lattice.length}, each in units of its largest; at the "
        "bottom the motion of the drive; "
        "thick ticks: arrival of the front, when a thousandth of the signal's energy has passed; "
        "pale: envelopes."
    )
    height = min(8.0, 1.4 + 0.7 * (1 + len(signals.detector)))
    yield "signals", style.single(seismogram, caption, style.PAGE, height, **panel)
    if signals.field is not None and lattice.has_places:
        times = range(len(signals.field_time))
        panels = [partial(field, number=n, **panel) for n in times]
        caption = "Displacements of all balls at some times."
        yield "field", balls.motions(lattice, panels, caption, "circles: detectors", driven=True)
    if signals.energy is not None:
        caption = "Work of the drive, energy of balls and springs, and what damping took."
        yield "energy", style.single(energy, caption, **panel)
    yield "spectrum", transfer.page(signals, lattice, response)
    if lattice.group == "lattice":
        yield "bonds", bonds.page(lattice, signals.detector)


def errors(record, _):
    """Return the largest error of signals in units of their largest displacement."""
    relative = np.nanmax(record.error.max(axis=0) / np.abs(record.displacement).max(axis=0))
    how = "proven" if record.error_bound is not None else "estimated"
    most = captions.number(relative)
    return f"Error of every signal: at most {most} of its largest displacement ({how})."


def seismogram(ax, signals, lattice):
    """Draw the signals above each other, each scaled to its largest, by distance from the wall.

    The wall's own motion is at the bottom; ticks mark where fronts have arrived. Envelopes are pale
    lines, unless the wall ends elsewhere than it began. What is below its error is not drawn.
    Returns the curves.
    """
    time, largest = signals.time * lattice.omega_mx, np.abs(signals.displacement).max(axis=0)
    known = largest > signals.error.max(axis=0)
    order, names = captions.by_depth(lattice, signals.detector, "\n")
    wall = signals.wall / np.abs(signals.wall).max()
    returns = abs(wall[-1]) < 0.1  # else signals do not swing about 0, which an envelope supposes
    ax.plot(time, 0.45 * wall, color=style.DRIVEN)
    drawn, fronts, label = [], [signals.wall_arrival], "envelope"
    driven = "driven wall" if lattice.group == "lattice" else "driven balls"
    rows = [driven if lattice.push is None else "force"]
    for row, d in enumerate(order, 1):
        size = f"largest {largest[d]:.2g}" if known[d] else "below its error"
        rows.append(f"{names[d]}\n{size}")
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
    scales.label(ax.xaxis, scales.TIME)
    ax.set(xlim=time[[0, -1]], ylim=(-0.7, len(rows) - 0.3))
    return drawn


def field(ax, signals, lattice, number):
    """Draw all balls at one of the times of `field`, and the detectors; return what is drawn."""
    time, where = signals.field_time[number], signals.detector
    wall = np.interp(time, signals.time, signals.wall)
    values = signals.field[number]
    drawn, unit, plane = balls.motion(ax, lattice, values, wall, where, few_beyond=True)
    largest = f"{'99 % within' if balls.beyond(drawn) else 'largest'} {unit:.2g}"
    moment = rf"$t$ = {scales.time(time * lattice.omega_mx, lattice)}"
    ax.set_title(", ".join(filter(None, [moment, largest, plane])))
    return drawn


def energy(ax, signals, lattice):
    """Draw work of the drive, energy of balls and springs, what damping took; return the curves."""
    time, unit = signals.time * lattice.omega_mx, lattice.built.mass * lattice.omega_mx**2
    shown = [
        (signals.work, "work of the drive", {"color": "#bbbbbb", "linewidth": 2.5}),
        (signals.energy, "energy of balls and springs", {"color": style.ACCENT}),
        (signals.dissipated, "taken by damping", {"color": style.UNRESOLVED, "linestyle": "--"}),
    ]
    scales.label(ax.xaxis, scales.TIME)
    ax.set(xlim=time[[0, -1]], ylabel=r"energy ($m\,\omega_{mx}^2 \times$ displacement$^2$)")
    return [ax.plot(time, y / unit, label=label, **look)[0] for y, label, look in shown]


def over(results, labels):
    """Yield the signals of the first detector; not those that are below their error."""

    def signals(ax):
        last = 0.0
        for number, (result, label) in enumerate(zip(results, labels, strict=True)):
            shown, time = result.pulse, result.pulse.time * result.medium.omega_mx
            moved, error = shown.displacement[:, 0], shown.error[:, 0]
            if not np.abs(moved).max() > error.max():
                label, moved = f"{label}: below its error", np.full_like(moved, np.nan)
            ax.plot(time, moved, label=label, **together.curve_look(number))
            last = max(last, time[-1])
        first = {style.ball_names(result.pulse.detector[:1])[0] for result in results}
        ax.set_title(first.pop() if len(first) == 1 else "first detectors")
        scales.label(ax.xaxis, scales.TIME)
        ax.set(ylabel="displacement", xlim=(0, last))

    caption = "Displacement of a ball against time."
    yield "signals", style.single(signals, caption, style.PAGE)
