"""The figures of a sweep: amplitude, phase, delay and the wall's force (freqres, phaseres)."""

import math
from functools import partial

import numpy as np

from pgran.draw import bonds, captions, marks, scales, style
from pgran.errors import FileError
from pgran.experiments.response.record import LINES
from pgran.store.estimate import with_error

FITTED = {"phase_slope": ("s", scales.SLOPE), "phase_velocity": ("v", scales.VELOCITY)}
EDGES = (0.0, 0.3, 1.0, math.inf)  # of the three regimes, in units of omega_mx
REGIMES = (
    r"low frequencies, $\omega < 0.3\,\omega_{mx}$",
    r"intermediate frequencies",
    r"high frequencies, $\omega > \omega_{mx}$",
)

errors = captions.amplitudes


def figures(result, modes=None, **_):
    """Yield the amplitudes, a panel a regime, phases, group delay, wall's force, and bonds."""
    response, lattice = result.response, result.medium
    shown = {"response": response, "lattice": lattice, "modes": modes}
    figure = amplitude_page([(response, lattice, None, {})], modes)
    figure.panels = figure.panels if len(response.omega) > style.TOO_FEW else ()
    yield "amplitude", figure
    figure = style.single(phase, height=2.1, **shown)
    figure.caption += _fits(response, lattice, style.ball_names(response.detector))
    yield "phase", figure
    if lattice.built.dissipates and response.delay is not None:
        count = len(response.detector)
        delays = [partial(delay, d=d) for d in range(count)]
        height = 2.1 if count == 1 else 1.5 if count < 5 else 1.0
        caption = style.caption_of(delay)
        yield "delay", style.stack(delays, caption, height=height, shared=True, **shown)
    panels = []
    if response.force is not None and np.any(known_force(response)):
        panels = [force, force_phase, power][: 3 if np.any(known_power(response)) else 2]
    if response.opening is not None and np.any(response.opening > 0):
        panels.append(opening)
    if panels:
        yield "wall", style.stack(panels, height=1.4, shared=True, **shown)
    if lattice.group == "lattice":
        yield "bonds", bonds.page(lattice, response.detector)


def amplitude(ax, response, lattice, modes=None, within=(0.0, math.inf), labels=None, **line):
    """Amplitude of the steady response relative to the driven wall, against the driving frequency.

    (Paper: freqres.) Points that missed the accuracy asked for are gaps in the curves and crosses
    on the upper edge; of amplitudes at the floor the upper limit is drawn. `modes` are angular
    frequencies of normal modes, marked by ticks, `within` is the range of driving frequencies that
    is drawn, in units of omega_mx; `labels` stand for the detectors' names, `line` is for
    `Axes.plot`.
    """
    x = response.omega / lattice.omega_mx
    inside = ((within[0] <= x) & (x <= within[1]))[:, None]
    limit = np.where(inside, marks.upper_limits(response), np.nan)
    ax.set(yscale="log", ylabel=scales.AMPLITUDE)
    values, good = response.amplitude, inside & marks.known_amplitudes(response)
    look = {"labels": labels, "limit": limit, "within": within} | line
    return _curves(ax, response, lattice, modes, values, good, **look)


def amplitude_page(shown, modes=None):
    """Return the figure of amplitudes of (response, lattice, labels, look), a panel a regime."""
    few = all(len(response.omega) <= style.HANDFUL for response, *_ in shown)
    edges = EDGES[:1] + EDGES[-1:] if few else EDGES
    reached = [
        _regimes(response.omega / lattice.omega_mx, edges) for response, lattice, *_ in shown
    ]
    present = np.unique(np.concatenate(reached))
    figure, panels = style.page(style.PAGE, 0.4 + 1.75 * len(present), nrows=len(present))
    for regime, ax in zip(present, panels, strict=True):
        within = edges[regime : regime + 2]
        for (response, lattice, names, look), there in zip(shown, reached, strict=True):
            if regime in there:
                amplitude(ax, response, lattice, modes, within, names, **look)
        ax.set_title("" if few else REGIMES[regime])
        ax.set(xlabel="", ylabel="")
    scales.label(panels[-1].xaxis, scales.FREQUENCY)
    figure.supylabel(scales.AMPLITUDE, fontsize="medium")
    several = [f"({letter}) {REGIMES[n]}" for letter, n in zip("abc", present, strict=False)]
    figure.caption = style.caption_of(amplitude) + f" {', '.join(several)}." * (len(present) > 1)
    style.legend_above(panels)
    return figure


def _regimes(x, edges):
    """Return the regimes between edges that frequencies in units of omega_mx reach."""
    # An edge belongs to the regime below, the first point of all to the one above.
    return np.unique(np.searchsorted(edges[1:-1], [np.nextafter(x[0], math.inf), *x[1:]]))


def phase(ax, response, lattice, modes=None, labels=None, alone=True, **line):
    """Unwrapped phase of the steady response against the driving frequency, and straight lines
    fitted to it.

    (Paper: phaseres.) A line covers the points that it was fitted to; the phase velocity
    (`phsvel`), or without positions its slope, is in the label of a curve that is `alone`. All else
    is as in `amplitude`.
    """
    x = response.omega / lattice.omega_mx
    good = (response.converged_reason > 0)[:, None] & np.isfinite(response.phase)
    ends = _fitted_ends(response, x, good)
    fitted = np.flatnonzero(np.isfinite(response.phase_slope) & np.isfinite(ends[0]))
    labels, fit = list(labels or style.ball_names(response.detector)), "fit"
    if alone and len(labels) == len(fitted) == 1:
        name = "phase_velocity" if np.isfinite(response.phase_velocity[0]) else "phase_slope"
        number, unit = _number(response, lattice, name, 0)
        letter = FITTED[name][0]
        labels = [f"{labels[0]}: ${letter} = {number}$"]
        fit = f"fit, {name.replace('_', ' ')} ${letter}$ in {unit}"
    ax.set_ylabel(scales.PHASE)
    ax.yaxis.set_major_locator(scales.round_ticks(ax.figure))
    drawn = _curves(ax, response, lattice, modes, response.phase, good, labels, **line)
    for d in fitted:
        y = response.phase_slope[d] * ends[:, d] + response.phase_intercept[d]
        look = {"color": style.pale(drawn[d].get_color()), "linewidth": 3, "zorder": 1}
        ax.plot(ends[:, d], y, label=fit, **look)
    return drawn


def _fitted_ends(response, x, good):
    """Return the first and the last point that each line was fitted to; NaN where there is none."""
    if response.phase_used_min is not None:
        return np.array([response.phase_used_min, response.phase_used_max])
    # before format version 3
    window = (response.phase_fit_min < x) & (x < response.phase_fit_max)
    columns = [x[window & known] for known in good.T]
    return np.transpose([c[[0, -1]] if c.size else [np.nan] * 2 for c in columns])


def _number(response, lattice, name, d):
    """Return a number of a fitted line, with its error if that is known, and its unit."""
    value, errors = getattr(response, name)[d], getattr(response, f"{name}_error")
    factor, unit = scales.unit_of(FITTED[name][1], lattice, abs(value))
    unit = unit.replace(r"$d\,", rf"{lattice.length} $\times\,")
    if errors is None:
        return f"{factor * value:.3g}", unit
    return with_error(factor * value, factor * errors[d], r"\pm"), unit


def _fits(response, lattice, names):
    """Return what the lines fitted to phases tell of each curve, none where none is fitted."""
    told = []
    for d in np.flatnonzero(np.isfinite(response.phase_slope)):
        known = [name for name in FITTED if np.isfinite(getattr(response, name)[d])]
        numbers = [(name, *_number(response, lattice, name, d)) for name in known]
        texts = [f"{name.replace('_', ' ')} ${number}$ {unit}" for name, number, unit in numbers]
        told.append(f"{names[d]}: {', '.join(texts)}")
    ends = response.phase_fit_min, response.phase_fit_max
    window = " to ".join(scales.frequency(end, lattice) for end in ends)
    return f" Fits from {window}: {'; '.join(told)}." if told else ""


def delay(ax, response, lattice, modes=None, d=0):
    r"""Group delay $-d \arg A / d\omega$ of the steady response; with a grey band the axis is
    linear in it, up to the median, and logarithmic beyond.
    """
    values = response.delay[:, [d]] * lattice.omega_mx
    good = (response.converged_reason > 0)[:, None] & np.isfinite(values)
    scales.delays(ax, values[good])
    ax.set_title(style.ball_names(response.detector)[d])
    return _curves(ax, response, lattice, modes, values, good)


def force(ax, response, lattice, modes=None):
    """Magnitude of the force that drives the wall."""
    ax.set(yscale="log", ylabel="force $|F|$ (drive = 1)")
    values = np.abs(response.force)
    return _curves(ax, response, lattice, modes, values, known_force(response))


def force_phase(ax, response, lattice, modes=None):
    r"""Phase of that force, from 0 (a spring) to $\pi$ (a mass)."""
    values = np.abs(np.angle(response.force))  # rounding alone could make it negative
    ax.set(ylim=(-0.1 * math.pi, 1.1 * math.pi), ylabel="phase of $F$")
    ax.set_yticks([0, math.pi / 2, math.pi], ["0", r"$\pi/2$", r"$\pi$"])
    return _curves(ax, response, lattice, modes, values, known_force(response))


def power(ax, response, lattice, modes=None):
    """Mean power that the wall puts in, which dashpots dissipate."""
    ax.set(yscale="log", ylabel=r"power $\frac{1}{2}\omega\,\mathrm{Im}\,F$")
    return _curves(ax, response, lattice, modes, response.power, known_power(response))


def opening(ax, response, lattice, modes=None):
    """Amplitude of the drive, F / kmax of a force, up to which, by the linear field and for
    certain, no contact opens, and less than 1 % do.
    """
    from pgran.medium.overlaps import are_lengths, overlaps_of

    scales.label(ax.yaxis, scales.OPENING)
    if not are_lengths(lattice.built, overlaps_of(lattice.built)):
        ax.yaxis.quantity = None
    ax.set_yscale("log")
    drawn = []
    of = {"first contact opens": response.opening, "1 % of contacts open": response.opening_part}
    for (name, ends), shade in zip(of.items(), style.COLOURS[1:], strict=False):
        look, least = {"labels": [name], "color": shade}, lattice.built.drive_size * ends[:, 0]
        drawn += _curves(ax, response, lattice, modes, least, least > 0, **look)
    return drawn


def known_force(response):
    """Return which forces are proven to a part of `LINES`, or solved for if nothing is proven."""
    doubtful = response.force_bound > LINES * np.abs(response.force)
    return (response.converged_reason > 0) & (np.abs(response.force) > 0) & ~doubtful


def known_power(response):
    """Return which powers are proven to a part of `LINES`."""
    bound = 0.5 * response.omega * response.force_bound
    good = (response.converged_reason > 0) & (response.power > 0)
    return good & (bound <= LINES * response.power)


def _curves(ax, response, lattice, modes, values, good, labels=(None,), limit=None, **line):
    """Draw curves over the driving frequency; mark failed and unresolved points, normal modes."""
    x, unresolved = response.omega / lattice.omega_mx, response.unresolved
    labels = labels or style.ball_names(response.detector)
    if len(x) <= style.FEW and 2 * np.count_nonzero(unresolved) >= len(unresolved):
        # few points that lines do not join rightly are points alone
        line = {"linestyle": "none", "clip_on": False} | line
    drawn = marks.over_frequency(ax, response, lattice, values, good, labels, limit, **line)
    marks.unresolved(ax, 0.5 * (x[1:] + x[:-1])[unresolved])
    if modes is not None:
        marks.modes(ax, np.asarray(modes) / lattice.omega_mx)
    return drawn


def over(results, looks):
    """Yield amplitudes and phases: line styles tell results apart, colours several detectors."""
    shown, alone = [], all(len(result.response.detector) == 1 for result in results)
    many = len(results) > len(style.COLOURS)  # whose colours are a scale
    if many and not alone:
        raise FileError(f"{len(results)} results: so many are drawn of one detector each")
    for result, look in zip(results, looks, strict=True):
        balls, line = style.ball_names(result.response.detector), look.curve
        if not alone:
            del line["color"]
        names = [look.label] if alone else [f"{look.label}, {ball}" for ball in balls]
        shown.append((result.response, result.medium, names, line))

    def phases(ax):
        for response, lattice, names, look in shown:
            phase(ax, response, lattice, labels=names, alone=False, **look)

    yield "amplitude", amplitude_page(shown)
    figure = style.single(phases, style.caption_of(phase), style.PAGE)
    for response, lattice, names, _ in shown[: 0 if many else None]:
        figure.caption += _fits(response, lattice, names)
    yield "phase", figure


def add_measured(made, results, data, label, scale=1.0):
    """Draw what was measured into the figures of responses: circles over amplitudes and phases.

    `made` has the figures by name; `data` has `omega`, `amplitude`, maybe `phase`; the caption says
    by what `scale` amplitudes were multiplied. Returns how many points lie beyond all sweeps, and
    are not drawn.
    """
    units = {result.medium.omega_mx for result in results}
    if len(units) > 1:
        raise FileError(f"{label}: the results have different omega_mx, so frequencies measured "
                        "in one unit are laid over one of them only")  # fmt: skip
    x = data["omega"] / units.pop()
    look = style.RING | {"markersize": 3, "markeredgewidth": 0.6, "zorder": 4}
    seen, name = np.zeros(len(x), dtype=bool), label.replace("$", r"\$")
    for part in [part for part in ("amplitude", "phase") if part in data and part in made]:
        for ax in made[part].panels:
            low, high = ax.get_xlim()
            inside = (low <= x) & (x <= high)
            if inside.any():
                ax.plot(x[inside], data[part][inside], label=name, scalex=False, **look)
            seen |= inside
        style.legend_above(made[part].panels)
        times = rf" $\times$ {captions.number(scale, 4)}" * (part == "amplitude" and scale != 1)
        made[part].caption += f" Circles: measured ({label}){times}."
    if not seen.any():
        raise FileError(f"{label}: none of its frequencies is within the sweep; -plot_unit says "
                        "what they are given in")  # fmt: skip
    return int(np.count_nonzero(~seen))
