"""The figures of a pulse: signals by distance, fields, energy, and spectra beside a response's."""

from functools import partial

import numpy as np

from pgran.draw import balls, bonds, captions, marks, scales, style
from pgran.errors import FileError

LOUD_PART = 0.01  # of the largest of the wall's spectrum: what spectra are divided by
FADING_PART = 0.25  # part of the time, the last one, over which motions are faded out before that
FINER = 8  # times as many frequencies as a signal has: peaks are round
NARROWEST_PANEL = 2.0  # inches of a column of spectra
PANEL_ROWS = 6  # of spectra, before there is another column


def figures(result, response=None, **_):
    """Yield the signals, the field if it is stored, the energy if known, spectra, and the bonds."""
    signals, lattice = result.pulse, result.medium
    shown = {"signals": signals, "lattice": lattice}
    height = min(8.0, 1.4 + 0.7 * (1 + len(signals.detector)))
    figure = style.single(seismogram, None, style.PAGE, height, **shown)
    figure.caption += f" Pulse: {signals.shape}; depths in {lattice.length}."
    yield "signals", figure
    if signals.field is not None and lattice.has_places:
        times = [partial(field, number=n, **shown) for n in range(len(signals.field_time))]
        caption = style.caption_of(field)
        yield "field", balls.motions(lattice, times, caption, "circles: detectors", driven=True)
    if signals.energy is not None:
        yield "energy", style.single(energy, **shown)
    yield "spectrum", _spectra(signals, lattice, response)
    if lattice.group == "lattice":
        yield "bonds", bonds.page(lattice, signals.detector)


def errors(record, _):
    """Return the largest error of signals in units of their largest displacement."""
    relative = np.nanmax(record.error.max(axis=0) / np.abs(record.displacement).max(axis=0))
    how = "proven" if record.error_bound is not None else "estimated"
    most = captions.number(relative)
    return f"Error of every signal: at most {most} of its largest displacement ({how})."


def seismogram(ax, signals, lattice):
    """Displacements of balls against time, by their depth, the distance from what is driven, each
    in units of its largest; at the bottom the motion of the drive; thick ticks: arrival of the
    front, when a thousandth of the signal's energy has passed; pale: envelopes.

    A wall that ends elsewhere than it began leaves no envelopes. What is below its error is not
    drawn.
    """
    time, largest = signals.time * lattice.omega_mx, np.abs(signals.displacement).max(axis=0)
    known = largest > signals.error.max(axis=0)
    order, names = captions.by_depth(lattice, signals.detector, "\n")
    wall = signals.wall / np.abs(signals.wall).max()
    returns = abs(wall[-1]) < 0.1  # else signals do not swing about 0, which an envelope supposes
    ax.plot(time, 0.45 * wall, color=style.DRIVEN)
    drawn, fronts = [], [signals.wall_arrival]
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
            ax.plot(time, above, color="#aaaaaa", linewidth=0.6, label="envelope")
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
    """Displacements of all balls at some times."""
    time, where = signals.field_time[number], signals.detector
    wall = np.interp(time, signals.time, signals.wall)
    values = signals.field[number]
    drawn, unit, plane = balls.motion(ax, lattice, values, wall, where)
    largest = f"{'99 % within' if balls.beyond(drawn) else 'largest'} {unit:.2g}"
    moment = scales.said(time * lattice.omega_mx, lattice, scales.TIME_IN_WORDS)
    style.title(ax, rf"$t$ = {moment}", largest, plane)
    return drawn


def energy(ax, signals, lattice):
    """Work of the drive, energy of balls and springs, and what damping took."""
    time, unit = signals.time * lattice.omega_mx, lattice.built.mass * lattice.omega_mx**2
    shown = [
        (signals.work, "work of the drive", {"color": "#bbbbbb", "linewidth": 2.5}),
        (signals.energy, "energy of balls and springs", {"color": style.ACCENT}),
        (signals.dissipated, "taken by damping", {"color": style.UNRESOLVED, "linestyle": "--"}),
    ]
    scales.label(ax.xaxis, scales.TIME)
    ax.set(xlim=time[[0, -1]], ylabel=r"energy ($m\,\omega_{mx}^2 \times$ displacement$^2$)")
    return [ax.plot(time, y / unit, label=label, **look)[0] for y, label, look in shown]


def _spectra(signals, lattice, response):
    """Return the figure of the spectra, a panel a detector."""
    if response and not any(_heard_at(site, response).size for site in signals.detector):
        raise FileError("the pulse and the response have no detector in common")
    order, _ = captions.by_depth(lattice, signals.detector)
    shown = {"signals": signals, "lattice": lattice, "response": response}

    def height(rows):
        return 0.4 + max(1.2 * rows, 2.0)

    heard = [d for d in order if ratio(signals, d)[2].any()] or order  # not below the error
    draws = [partial(spectrum, number=d, **shown) for d in heard]
    alike = {"sharex": True, "sharey": True}
    figure, columns = style.grid(draws, height, PANEL_ROWS, NARROWEST_PANEL, **alike)
    for ax in figure.panels:
        ax.set_ylabel("")
    figure.supylabel(scales.AMPLITUDE, fontsize="medium")
    end = signals.time[-1] * lattice.omega_mx
    until = rf"until $T$ = {scales.said(end, lattice, scales.TIME_IN_WORDS)}"
    style.above(figure, f"signal/drive {until}", "left: of the largest speed, near that end")
    blurred = scales.frequency(2 * np.pi / end, lattice, 2)
    figure.caption = (
        f"{style.caption_of(spectrum)} The signals are those {until}. Left: largest speed in the "
        "last quarter of that time over the largest of all; where some is left frequencies are "
        f"blurred by {blurred} or more."
    )
    if response:
        style.legend_above([figure.panels[columns - 1], *figure.panels])
    return figure


def spectrum(ax, signals, lattice, number, response=None):
    r"""Spectra of the signals of balls over that of the drive, where they are above their error.

    Velocities are faded out over the last quarter of the time T. This blurs the spectrum of a ball
    that moves there still, over 2 pi / T or, if it began late, more: the title says how much of its
    largest velocity is left there. What is below its error, or where the wall's own velocity has
    next to no spectrum, is not drawn. Of a response of the same lattice the amplitude is drawn
    where it has the detector.
    """
    omega, size, good = ratio(signals, number)
    x = omega / lattice.omega_mx
    ax.set(yscale="log", ylabel=scales.AMPLITUDE)
    scales.frequencies(ax, x[good if good.any() else np.isfinite(size)], scales.ANY_FREQUENCY)
    low, high = ax.get_xlim()
    for d in [] if response is None else _heard_at(signals.detector[number], response):
        swept, there = response.omega / lattice.omega_mx, marks.known_amplitudes(response)[:, d]
        there &= (low <= swept) & (swept <= high)
        look = {"color": style.pale(style.ACCENT), "linewidth": 2.5, "dots": False}
        marks.curves(ax, swept, response.amplitude[:, d], there, ["steady response"], **look)
    look = {"color": "black", "dots": False}
    (curve,) = marks.curves(ax, x, size, good, ["signal/drive"], **look)
    speed = np.abs(signals.velocity[:, number])
    left = speed[-round(FADING_PART * len(speed)) :].max() / (speed.max() or 1.0)
    _, (name,) = captions.by_depth(lattice, signals.detector[[number]])
    ax.set_title(f"{name}; {100 * left:.3g} % left")
    return curve


def _heard_at(site, response):
    """Return the numbers of the response's detectors at a site."""
    return np.flatnonzero((response.detector == site).all(axis=1))


def ratio(signals, number):
    """Return angular frequencies, |u^ / U^| of one detector there, and which exceed their error.

    From differences between successive times, whose transforms have a factor in common: so a step
    has a spectrum too. Both are faded out alike; without that a ball that moves still at the end
    would seem to have heard all frequencies. All have the shape (n,); the ratio is NaN where the
    wall has next to no spectrum.
    """
    step, count = signals.time[1] - signals.time[0], FINER * len(signals.time)
    omega = 2 * np.pi / step * np.fft.rfftfreq(count)
    window = np.ones(len(signals.time) - 1)
    fading = max(round(FADING_PART * len(window)), 1)
    bell = np.blackman(fading + 2)[1:-1]
    window[-fading:] -= np.cumsum(bell) / bell.sum()
    moved, wall = (
        np.abs(np.fft.rfft(np.diff(values) * window, count))
        for values in (signals.displacement[:, number], signals.wall)
    )
    loud = wall > LOUD_PART * wall.max()
    size = np.divide(moved, wall, out=np.full_like(moved, np.nan), where=loud)
    error = signals.error[:, number]
    if not np.isfinite(error).all():
        return omega, size, np.zeros_like(loud)
    # An error e at one time adds e |w - z w'|, w and w' in the window before and after, |z| = 1.
    before, after = np.append(0.0, window), np.append(window, 0.0)
    turn = 2 * np.abs(np.sin(omega * step / 2))  # |1 - z|
    bound = turn * (after @ error) + np.abs(before - after) @ error
    return omega, size, loud & (moved > bound)


def over(results, looks):
    """Yield the signals of the first detector; not those that are below their error."""

    def signals(ax):
        """Displacement of a ball against time."""
        last = 0.0
        for result, look in zip(results, looks, strict=True):
            shown, time = result.pulse, result.pulse.time * result.medium.omega_mx
            moved, error, label = shown.displacement[:, 0], shown.error[:, 0], look.label
            if not np.abs(moved).max() > error.max():
                label = f"{label}: below its error".lstrip("_: ")  # which may have no label
                moved = np.full_like(moved, np.nan)
            ax.plot(time, moved, label=label, **look.curve)
            last = max(last, time[-1])
        first = {style.ball_names(result.pulse.detector[:1])[0] for result in results}
        ax.set_title(first.pop() if len(first) == 1 else "first detectors")
        scales.label(ax.xaxis, scales.TIME)
        ax.set(ylabel="displacement", xlim=(0, last))

    yield "signals", style.single(signals, None, style.PAGE)
