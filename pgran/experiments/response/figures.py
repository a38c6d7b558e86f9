"""The figures of a sweep: amplitude, phase, delay and the wall's force (freqres, phaseres)."""

import math

import numpy as np

from pgran.draw import bonds, captions, marks, style, together
from pgran.draw.marks import known_amplitudes
from pgran.errors import FileError
from pgran.experiments.response.record import LINES
from pgran.store.estimate import two_digits

EDGES = (0.0, 0.3, 1.0, math.inf)  # of the three regimes, in units of omega_mx
REGIMES = (
    r"low frequencies, $\omega < 0.3\,\omega_{mx}$",
    r"intermediate frequencies",
    r"high frequencies, $\omega > \omega_{mx}$",
)

SAID = {
    "amplitude": "Amplitude of the steady response relative to the driven wall, against the "
    "driving frequency.",
    "phase": "Unwrapped phase of the steady response against the driving frequency, and straight "
    "lines fitted to it.",
    "delay": "Group delay $-d \\arg A / d\\omega$ of the steady response; the axis is linear up to "
    "the median, logarithmic beyond.",
}
WALL = (
    "Magnitude of the force that drives the wall.",
    "Its phase.",
    "Mean power that the wall puts in.",
)


def figures(result, modes=None, **_):
    """Yield the amplitudes, a panel a regime, phases, group delay, wall's force, and bonds."""
    response, lattice = result.response, result.medium
    yield "amplitude", amplitude_page([(response, lattice, None, {})], modes)
    single = {"phase": phase}
    if lattice.damping and response.delay is not None and np.isfinite(response.delay).any():
        single["delay"] = delay
    for name, panel in single.items():
        figure, (ax,) = style.page(style.COLUMN, 2.3)
        panel(ax, response, lattice, modes)
        figure.set_figheight(2.3 + 0.13 * style.legend_above([ax]))
        figure.caption = SAID[name] + (captions.slopes(response) if name == "phase" else "")
        yield name, figure
    if response.force is not None and np.any(known_force(response)):
        panels = (force, force_phase, power)[: 3 if np.any(known_power(response)) else 2]
        figure, axes = style.page(style.COLUMN, 0.7 + 1.25 * len(panels), nrows=len(panels))
        for ax, panel in zip(axes, panels, strict=True):
            panel(ax, response, lattice, modes)
            ax.label_outer()
        figure.align_ylabels()
        style.legend_above(axes)
        figure.caption = style.lettered(WALL[: len(panels)])
        yield "wall", figure
    if lattice.group == "lattice":
        yield "bonds", bonds.page(lattice, response.detector)


def amplitude(ax, response, lattice, modes=None, within=(0.0, math.inf), labels=None, **line):
    """Draw the amplitudes against frequency, a curve a detector (paper: freqres).

    Points that missed the accuracy asked for are gaps in the curves and crosses on the upper edge;
    of amplitudes at the floor the upper limit is drawn. Returns the curves.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    response : pgran.results.Response
    lattice : pgran.results.LatticeRecord
    modes : array_like, optional
        Angular frequencies of normal modes, marked by ticks.
    within : tuple of float
        Range of the driving frequencies that are drawn, in units of omega_mx.
    labels : sequence of str, optional
        Of the curves, instead of the detectors' names.
    **line
        For `Axes.plot`.
    """
    x, values = response.omega / lattice.omega_mx, response.amplitude
    inside = (within[0] <= x) & (x <= within[1])
    limit = np.where(inside[:, None], marks.upper_limits(response), np.nan)
    ax.set(yscale="log", ylabel=style.AMPLITUDE)
    style.frequencies(ax, x, within=within)
    names = labels or style.ball_names(response.detector)
    drawn = marks.curves(
        ax,
        x,
        values,
        inside[:, None] & known_amplitudes(response),
        names,
        limit,
        **_look(response) | line,
    )
    _finish(ax, response, lattice, modes)
    return drawn


def _look(response):
    """Return how curves are drawn: few points that lines do not join rightly as points alone."""
    few = len(response.omega) <= style.FEW and 2 * np.count_nonzero(response.unresolved) >= len(
        response.unresolved
    )
    return {"linestyle": "none", "clip_on": False} if few else {}


def phase(ax, response, lattice, modes=None, labels=None, **line):
    """Draw the unwrapped phase with the straight lines fitted (paper: phaseres).

    A line covers the points that it was fitted to; the phase velocity (`phsvel`), or without
    positions its slope, is in the label of the curve. Points that missed the accuracy asked for
    are as in the amplitudes. Returns the curves.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    response : pgran.results.Response
    lattice : pgran.results.LatticeRecord
    modes : array_like, optional
        Angular frequencies of normal modes, marked by ticks.
    labels : sequence of str, optional
        Of the curves, instead of the detectors' names.
    **line
        For `Axes.plot`.
    """
    x, low, high = response.omega / lattice.omega_mx, response.phase_fit_min, response.phase_fit_max
    good = (response.converged_reason > 0)[:, None] & np.isfinite(response.phase)
    ends = _fitted_ends(response, x, good)
    fitted = np.flatnonzero(np.isfinite(response.phase_slope) & np.isfinite(ends[0]))
    labels = list(labels or style.ball_names(response.detector))
    for d in fitted:
        labels[d] += f": {_velocity(response, lattice, d)}"
    ax.set(ylabel=style.PHASE)
    ax.yaxis.set_major_locator(style.round_ticks(ax.figure))
    style.frequencies(ax, x)
    drawn = marks.curves(ax, x, response.phase, good, labels, **_look(response) | line)
    label = rf"fit, {low:g} to {high:g} $\omega_{{mx}}$"
    for d in fitted:
        fit = response.phase_slope[d] * ends[:, d] + response.phase_intercept[d]
        shade = style.pale(drawn[d].get_color())
        ax.plot(ends[:, d], fit, color=shade, linewidth=3, zorder=1, label=label)
        label = None
    _finish(ax, response, lattice, modes)
    return drawn


def _velocity(response, lattice, d):
    """Return the phase velocity of a detector, or the slope of its phase, as a label has it."""
    name, unit = "phase_velocity", r"$d\,\omega_{mx}$"
    if not np.isfinite(response.phase_velocity[d]):  # without positions
        name, unit = "phase_slope", r"rad/$\omega_{mx}$"
    said, error = f"{getattr(response, name)[d]:.3g}", getattr(response, f"{name}_error")
    if error is not None:  # as it is in a file of version 0.1
        said += rf" \pm {two_digits(error[d])}"
    return f"${'v' if 'velocity' in name else 's'} = {said}$ {unit}"


def delay(ax, response, lattice, modes=None):
    """Draw the group delay -d arg A / d omega; linear up to the median, logarithmic beyond.

    Returns the curves. Parameters are those of `phase`.
    """
    x, values = response.omega / lattice.omega_mx, response.delay * lattice.omega_mx
    good = (response.converged_reason > 0)[:, None] & np.isfinite(values)
    middle = float(f"{np.median(np.abs(values[good])):.1g}")
    style.symmetric(ax, values[good], middle or 1.0)
    ax.set_ylabel(style.DELAY)
    style.frequencies(ax, x)
    drawn = marks.curves(
        ax, x, values, good, style.ball_names(response.detector), **_look(response)
    )
    _finish(ax, response, lattice, modes)
    return drawn


def known_force(response):
    """Return which forces are proven to a part of `LINES`, or solved for where nothing is proven.

    Parameters
    ----------
    response : pgran.results.Response
    """
    doubtful = response.force_bound > LINES * np.abs(response.force)
    return (response.converged_reason > 0) & (np.abs(response.force) > 0) & ~doubtful


def known_power(response):
    """Return which powers are proven to a part of `LINES`. Parameters are as above."""
    bound = 0.5 * response.omega * response.force_bound
    good = (response.converged_reason > 0) & (response.power > 0)
    return good & (bound <= LINES * response.power)


def force(ax, response, lattice, modes=None):
    """Draw the magnitude of the force that drives the wall; return the curve.

    Parameters are those of `phase`.
    """
    ax.set_yscale("log")
    values, name = np.abs(response.force), "force $|F|$ (drive = 1)"
    return _wall(ax, response, lattice, modes, values, known_force(response), name)


def force_phase(ax, response, lattice, modes=None):
    """Draw the phase of that force, from 0 (a spring) to pi (a mass); return the curve.

    Parameters are those of `phase`.
    """
    values = np.abs(np.angle(response.force))  # rounding alone could make it negative
    ax.set(ylim=(-0.1 * math.pi, 1.1 * math.pi), yticks=[0, math.pi / 2, math.pi])
    ax.set_yticklabels(["0", r"$\pi/2$", r"$\pi$"])
    return _wall(ax, response, lattice, modes, values, known_force(response), "phase of $F$")


def power(ax, response, lattice, modes=None):
    """Draw the mean power that the wall puts in and dashpots dissipate; return the curve.

    Parameters are those of `phase`.
    """
    ax.set_yscale("log")
    values, name = response.power, r"power $\frac{1}{2}\omega\,\mathrm{Im}\,F$"
    return _wall(ax, response, lattice, modes, values, known_power(response), name)


def _wall(ax, response, lattice, modes, values, good, name):
    """Draw a quantity of the wall against frequency."""
    x = response.omega / lattice.omega_mx
    ax.set_ylabel(name)
    style.frequencies(ax, x)
    drawn = marks.curves(ax, x, values, good, **_look(response))
    _finish(ax, response, lattice, modes)
    return drawn


def _fitted_ends(response, x, good):
    """Return the first and the last point that each line was fitted to; NaN where there is none."""
    if response.phase_used_min is not None:
        return np.array([response.phase_used_min, response.phase_used_max])
    # before format version 3
    window = (response.phase_fit_min < x) & (x < response.phase_fit_max)
    columns = [x[window & known] for known in good.T]
    return np.transpose([c[[0, -1]] if c.size else [np.nan] * 2 for c in columns])


def _finish(ax, response, lattice, modes):
    """Mark failed frequencies, unresolved ones and normal modes, and label the frequency axis."""
    x = response.omega / lattice.omega_mx
    marks.failed(ax, x[response.converged_reason <= 0])
    marks.unresolved(ax, 0.5 * (x[1:] + x[:-1])[response.unresolved])
    if modes is not None:
        marks.modes(ax, np.asarray(modes) / lattice.omega_mx)


def amplitude_page(shown, modes=None):
    """Return the figure of amplitudes, a panel a regime that a sweep reaches.

    Parameters
    ----------
    shown : sequence of tuple
        Each a response, its lattice, labels of its curves or None, and their look.
    modes : array_like, optional
        Angular frequencies of normal modes, marked by ticks.
    """
    few = all(len(response.omega) <= style.HANDFUL for response, *_ in shown)
    edges = EDGES[:1] + EDGES[-1:] if few else EDGES
    reached = [
        _regimes(response.omega / lattice.omega_mx, edges) for response, lattice, *_ in shown
    ]
    present = np.unique(np.concatenate(reached))
    figure, panels = style.page(style.PAGE, 0.4 + 1.75 * len(present), nrows=len(present))
    for regime, ax in zip(present, panels, strict=True):
        drawn, ends = [], []
        for (response, lattice, names, look), there in zip(shown, reached, strict=True):
            if regime in there:
                within = edges[regime : regime + 2]
                drawn += amplitude(ax, response, lattice, modes, within, names, **look)
                ends.append(ax.get_xlim())
        ax.set_xlim(np.min(ends), np.max(ends))
        if len(shown) == len(drawn) == 1:
            drawn[0].set_label("")
        ax.set_title("" if few else REGIMES[regime])
        ax.set(xlabel="", ylabel="")
    rows = style.legend_above(panels)
    figure.set_figheight(figure.get_figheight() + 0.13 * rows)
    panels[-1].set_xlabel(style.FREQUENCY)
    figure.supylabel(style.AMPLITUDE, fontsize="medium")
    several = [f"({letter}) {REGIMES[n]}" for letter, n in zip("abc", present, strict=False)]
    figure.caption = SAID["amplitude"] + (f" {', '.join(several)}." if len(present) > 1 else "")
    return figure


def _regimes(x, edges):
    """Return the regimes between edges that frequencies in units of omega_mx reach."""
    # An edge belongs to the regime below, the first point of all to the one above.
    return np.unique(np.searchsorted(edges[1:-1], [np.nextafter(x[0], math.inf), *x[1:]]))


def over(results, labels):
    """Yield amplitudes and phases (paper: freqres, phaseres).

    Of several detectors each has a colour, and line styles tell the results apart.
    """
    shown, alone = [], all(len(result.response.detector) == 1 for result in results)
    for number, (result, label) in enumerate(zip(results, labels, strict=True)):
        balls, look = style.ball_names(result.response.detector), together.look_of(number)
        if not alone:
            del look["color"]
        names = [label] if alone else [f"{label}, {ball}" for ball in balls]
        shown.append((result.response, result.medium, names, look))
    yield "amplitude", amplitude_page(shown)
    figure, (ax,) = style.page(style.COLUMN, 2.5)
    ends = []
    for record, lattice, names, look in shown:
        phase(ax, record, lattice, labels=names, **look)
        ends.append(ax.get_xlim())
    ax.set_xlim(np.min(ends), np.max(ends))
    together.finish(figure)
    figure.caption = SAID["phase"]
    yield "phase", figure


def add_measured(made, results, data, label):
    """Draw what was measured into the figures of responses: circles over amplitudes and phases.

    Parameters
    ----------
    made : dict of str: matplotlib.figure.Figure
        Of `response`, or of `figures`.
    results : sequence of pgran.store.record.Result
        What they show.
    data : dict of str: numpy.ndarray
        `omega`, `amplitude`, and maybe `phase`.
    label : str

    Returns
    -------
    int
        How many points lie beyond all sweeps, and are not drawn.
    """
    if not all(hasattr(result, "response") for result in results):
        raise FileError(f"{label}: what was measured is laid over responses only")
    units = {result.medium.omega_mx for result in results}
    if len(units) > 1:
        raise FileError(f"{label}: the results have different omega_mx, so frequencies measured "
                        "in one unit are laid over one of them only")  # fmt: skip
    x = data["omega"] / units.pop()
    look = {"linestyle": "none", "marker": "o", "markersize": 3, "markerfacecolor": "white"}
    look |= {"color": "black", "markeredgewidth": 0.6, "zorder": 4}
    seen, name = np.zeros(len(x), dtype=bool), label.replace("$", r"\$")
    for part in ("amplitude", "phase"):
        for ax in made[part].panels if part in data else ():
            low, high = ax.get_xlim()
            inside = (low <= x) & (x <= high)
            if inside.any():
                ax.plot(x[inside], data[part][inside], label=name, scalex=False, **look)
            seen |= inside
    style.legend_above(made["amplitude"].panels)
    made["amplitude"].set_figheight(made["amplitude"].get_figheight() + 0.13)
    together.finish(made["phase"])
    for part in ("amplitude", "phase"):
        made[part].caption += f" Circles: measured ({label})." if part in data else ""
    if not seen.any():
        raise FileError(f"{label}: none of its frequencies is one of the sweep; omega is angular, "
                        "in the unit of the result")  # fmt: skip
    return int(np.count_nonzero(~seen))
