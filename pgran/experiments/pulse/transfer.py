"""Spectra of signals over that of the wall, next to the amplitudes of a steady response."""

import numpy as np

from pgran.draw import captions, marks, scales, style
from pgran.errors import FileError

LOUD = 0.01  # of the largest of the wall's spectrum: what spectra are divided by
FADING = 0.25  # part of the time, the last one, over which motions are faded out before that
FINER = 8  # times as many frequencies as a signal has: peaks are round
NARROWEST = 2.0  # inches of a column
ROWS = 6  # of spectra, before there is another column


def spectrum(ax, signals, lattice, number, response=None):
    r"""Draw the spectrum of one detector's signal over the wall's, and a steady response.

    Velocities are faded out over the last quarter of the time T. This blurs the spectrum of a ball
    that moves there still, over 2 pi / T or, if it began late, more: the title says how much of its
    largest velocity is left there. What is below its error, or where the wall's own velocity has
    next to no spectrum, is not drawn. Of a response of the same lattice the amplitude is drawn
    where it has the detector. Returns the curve.
    """
    omega, size, good = ratio(signals, number)
    x = omega / lattice.omega_mx
    ax.set(yscale="log", ylabel=scales.AMPLITUDE)
    scales.frequencies(ax, x[np.isfinite(size)])
    low, high = ax.get_xlim()
    for d in [] if response is None else shared(signals.detector[number], response):
        swept, there = response.omega / lattice.omega_mx, marks.known_amplitudes(response)[:, d]
        there &= (low <= swept) & (swept <= high)
        look = {"color": style.pale(style.ACCENT), "linewidth": 2.5, "dots": False}
        marks.curves(ax, swept, response.amplitude[:, d], there, ["steady response"], **look)
    look = {"color": "black", "dots": False}
    (curve,) = marks.curves(ax, x, size, good, ["signal/drive"], **look)
    speed = np.abs(signals.velocity[:, number])
    left = speed[-round(FADING * len(speed)) :].max() / (speed.max() or 1.0)
    _, (name,) = captions.by_depth(lattice, signals.detector[[number]])
    ax.set_title(f"{name}; {100 * left:.3g} % left")
    return curve


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
    fading = max(round(FADING * len(window)), 1)
    bell = np.blackman(fading + 2)[1:-1]
    window[-fading:] -= np.cumsum(bell) / bell.sum()
    moved, wall = (
        np.abs(np.fft.rfft(np.diff(values) * window, count))
        for values in (signals.displacement[:, number], signals.wall)
    )
    loud = wall > LOUD * wall.max()
    size = np.divide(moved, wall, out=np.full_like(moved, np.nan), where=loud)
    error = signals.error[:, number]
    if not np.isfinite(error).all():
        return omega, size, np.zeros_like(loud)
    # An error e at one time adds e |w - z w'|, w and w' in the window before and after, |z| = 1.
    before, after = np.append(0.0, window), np.append(window, 0.0)
    turn = 2 * np.abs(np.sin(omega * step / 2))  # |1 - z|
    bound = turn * (after @ error) + np.abs(before - after) @ error
    return omega, size, loud & (moved > bound)


def shared(site, response):
    """Return the numbers of the response's detectors at a site."""
    return np.flatnonzero((response.detector == site).all(axis=1))


def page(signals, lattice, response):
    """Return the figure of the spectra, a panel a detector."""
    count = len(signals.detector)
    if response and not any(shared(site, response).size for site in signals.detector):
        raise FileError("the pulse and the response have no detector in common")
    figure, panels, columns = style.grid(
        count, ROWS, NARROWEST, lambda rows: 0.4 + max(1.2 * rows, 2.0), sharex=True, sharey=True
    )
    order, _ = captions.by_depth(lattice, signals.detector)
    for d, ax in zip(order, panels, strict=True):
        spectrum(ax, signals, lattice, d, response)
        ax.set(xlabel="", ylabel="")
    for ax in panels[max(0, count - columns) :]:  # nothing stands below these
        scales.label(ax.xaxis, scales.FREQUENCY)
        ax.tick_params(labelbottom=True)
    if response:
        style.legend_above([panels[columns - 1], *panels])
    end = signals.time[-1] * lattice.omega_mx
    until = rf"until $T$ = {scales.time(end, lattice)}"
    style.above(figure, f"signal/drive {until}", "left: of the largest speed, near that end")
    figure.caption = (
        f"Spectra of the signals of balls over that of the drive, {until}. Left: largest speed in "
        "the last quarter of that time over the largest of all; where some is left frequencies are "
        f"blurred by {scales.frequency(2 * np.pi / end, lattice, 2)} or more."
    )
    figure.supylabel(scales.AMPLITUDE, fontsize="medium")
    return figure
