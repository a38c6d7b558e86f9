"""The figure of a relaxing network: amplitude against time, power spectrum (paper: timeres)."""

from functools import partial

import numpy as np

from pgran.draw import captions, marks, scales, style
from pgran.errors import FileError
from pgran.store.estimate import with_error

SHOWN_STEPS = 2000  # steps
PM = r"\pm"  # no backslash stands within braces of an f-string

errors = captions.amplitudes


def figures(result, **_):
    """Yield the beginning of the series above its power spectrum and its memory, if there are."""
    relaxation, found = result.relaxation, getattr(result, "memory", None)
    panels = [partial(series, relaxation=relaxation)]
    if getattr(result, "spectrum", None):
        corner = np.array([1.0, max(found.order, 1.0) if found else 1.0])
        corner /= 2 * np.pi * len(result.medium.built.existing)
        look = {"spectrum": result.spectrum, "step": relaxation.step, "corner": corner}
        panels.append(partial(spectrum, **look))
    if found:
        panels.append(partial(memory, memory=found))
    figure = style.stack(panels, height=2.3)
    omega = scales.frequency(relaxation.omega / result.medium.omega_mx, result.medium)
    trajectories, count = relaxation.displacement.shape[:2]
    figure.caption += (
        f" Driven at {omega}; the first {min(SHOWN_STEPS, count - 1)} of {count - 1} steps"
    )
    figure.caption += f" of one of {trajectories} trajectories" * (trajectories > 1) + "."
    missed = np.isnan(relaxation.displacement).any(axis=2)
    if missed.any():
        count = f"{np.count_nonzero(missed)} of {missed.size} amplitudes"
        style.note(figure, f"{count} missed the accuracy asked for")
    yield "timeres", figure


def series(ax, relaxation, steps=SHOWN_STEPS):
    """Amplitude against time; in a step one bond is drawn anew.

    The first steps of the first trajectory are drawn (paper: timeres).
    """
    amplitude = np.abs(relaxation.displacement[0, : steps + 1])
    limit = marks.upper_limits(relaxation)[0, : steps + 1]
    step, unit = (1, "steps of one bond") if relaxation.step is None else (relaxation.step, "s")
    time, good = step * np.arange(len(amplitude)), np.isfinite(amplitude) & np.isnan(limit)
    ax.set(xlabel=f"time ({unit})", ylabel=scales.AMPLITUDE)
    ax.set_xlim(0, step * max(len(time) - 1, 1))
    ax.locator_params("x", nbins=5)
    drawn = marks.curves(ax, time, amplitude, good, style.ball_names(relaxation.detector), limit)
    if np.isfinite(amplitude).any():
        ax.set_ylim(bottom=0)
    marks.failed(ax, time[np.isnan(amplitude).any(axis=1)])
    return drawn


def spectrum(ax, spectrum, step=None, corner=None):
    r"""Power spectrum, the power law fitted to it, and slope -2; what $k$ of $M$ bonds make jointly
    is flat below $k/(2\pi M)$ cycles per step.

    With the seconds of a `step` in Hz. Two frequencies in cycles per step are marked, the `corner`
    for k = 1 and k = kbar.
    """
    label = exponent(spectrum)
    if np.isfinite(spectrum.exponent):
        label = rf"$S \propto (2\sin\pi f)^{{-\psi}}$, {label}"
    curve, law = power(ax, spectrum, label, style.ACCENT, shade="#777777", step=step)
    window, values = law.get_data()
    middle = len(window) // 2
    height = values[middle]
    if not np.isfinite(height):
        law.set_linestyle("none")  # whose words stay in the legend
        height = np.interp(window[middle], *curve.get_data())
    parallel = 6.0 * height * (window / window[middle]) ** -2.0  # well above the spectrum
    look = {"color": "black", "linestyle": "--", "label": r"slope $-2$"}
    lines = [curve, law, *ax.plot(window, parallel, **look)]
    if corner is not None:
        words = r"corners of 1 to $\bar k$ bonds" if np.ptp(corner) else "corner of one bond"
        lines.append(ax.axvspan(*corner / (step or 1), color="#cccccc", zorder=0.5, label=words))
    return lines


def power(ax, spectrum, label, color, shade=None, linestyle="-", step=None):
    """Draw a power spectrum, pale, and its law, with the seconds of a step in Hz."""
    units = ("cycles per step", "steps per cycle") if step is None else ("Hz", "1/Hz")
    ax.set(xscale="log", xlabel=f"frequency $f$ ({units[0]})")
    ax.set(yscale="log", ylabel=f"power density $S$ ({units[1]})")
    step = step or 1.0
    window = np.geomspace(spectrum.fit_min, spectrum.fit_max, 100)
    look = {"color": color, "linewidth": 1.5, "linestyle": linestyle, "label": label}
    shade = shade or style.pale(color)
    return [
        *ax.plot(spectrum.frequency / step, spectrum.power * step, color=shade, linewidth=0.5),
        *ax.plot(window / step, spectrum.power_law(window) * step, **look),
    ]


def exponent(spectrum):
    """Return the exponent of a power law with its error, as a legend has it, or that it is none."""
    if not np.isfinite(spectrum.exponent):
        return r"$\psi$ withheld: too few steps"
    return rf"$\psi = {with_error(spectrum.exponent, spectrum.exponent_error, PM)}$"


def memory(ax, memory):
    """Autocorrelation, and the band that it must lie in."""
    ax.set(xlabel="steps in between", ylabel="autocorrelation of $|A|$")
    ax.set(xscale="symlog", xlim=(0, memory.lag[-1]))
    words = r"$(1 - \bar k/M)^t$ to $(1 - 1/M)^t$"
    law = ax.fill_between(memory.lag, memory.lowest, memory.highest, color="#cccccc", label=words)
    label = rf"$\bar k = {with_error(memory.order, memory.order_error, PM)}$"
    look = {"color": style.ACCENT, "linewidth": 0.8, "marker": ".", "markersize": 3}
    values = memory.lag, memory.correlation, memory.correlation_error
    return law, ax.errorbar(*values, label=label, **look)


def over(results, looks):
    """Yield the power spectra, each with the law fitted to it (paper: timeres)."""
    if any(getattr(result, "spectrum", None) is None for result in results):
        raise FileError("a result has no spectrum to lay over others: its run was too short")
    steps = [result.relaxation.step for result in results]
    if None in steps:  # of some the seconds are not known
        steps = [None] * len(steps)

    def spectra(ax):
        """Power spectra of the amplitude, pale, and the laws fitted to them."""
        for result, look, step in zip(results, looks, steps, strict=True):
            told = f":\n{exponent(result.spectrum)}" if len(results) <= len(style.COLOURS) else ""
            power(ax, result.spectrum, look.label + told, look.colour, None, look.line, step)

    yield "spectrum", style.single(spectra, None, style.PAGE)
