"""Results of one scene over each other in one figure, and what was measured over a response.

Curves differ by colour and, for print in grey, by line style; points by their marks.
"""

import re
import textwrap

import numpy as np

from pgran.errors import FileError
from pgran.figures import modes, relaxation, response, style

LINES = ("-", (0, (4, 1)), (0, (1, 0.8)), (0, (4, 1, 1, 1)), (0, (1.5, 2)), (0, (3, 1, 1, 1, 1, 1)))
COLOURS = ("black", "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9")
MARKS = (".", "+", "x", "^", "s", "d")
MOST = len(LINES)
WIDE = 48  # characters of a line in a legend


def figures(results, labels):
    """Yield the names and the pages of results of one scene, up to `MOST`, each with its label."""
    scene = str(results[0].scene)
    if scene not in PAGES:
        raise FileError(f"results of the scene {scene} are not laid over each other, but of "
                        f"{', '.join(PAGES)}")  # fmt: skip
    if len(results) > MOST:
        raise FileError(f"{len(results)} results: at most {MOST} are told apart in one figure")
    labels = [_wrap(label) for label in labels]
    units = [f"{result.medium.omega_mx:.6g}" for result in results]
    if len(set(units)) > 1:  # axes are in units of each one's own
        pairs = zip(labels, units, strict=True)
        labels = [rf"{label}, $\omega_{{mx}}$ = {unit}" for label, unit in pairs]
    for name, figure in PAGES[scene](results, labels):
        if len(set(units)) > 1:
            figure.caption += r" Each result is in units of its own $\omega_{mx}$."
        yield name, figure


def _wrap(label):
    """Return a label in lines, no key of an option parted from its value."""
    joined = re.sub(r"(?<!\S)(-\w+) (?=[^-])", "\\1\xa0", label.replace("$", r"\$"))
    lines = textwrap.wrap(joined, WIDE, break_long_words=False, break_on_hyphens=False)
    return "\n".join(lines).replace("\xa0", " ")


def _finish(figure):
    """Put a legend above a figure of one panel, and make it as high as that needs."""
    rows = style.legend_above(figure.panels)
    legend = figure.panels[0].get_legend()
    texts = [text.get_text() for text in legend.get_texts()] if legend else [""]
    figure.set_figheight(2.4 + 0.14 * rows * max(1 + text.count("\n") for text in texts))


def _look(number):
    """Return the colour and the line style of a result."""
    width = 1.0 if number else 0.8  # dashes and dots look thinner than they are
    return {"color": COLOURS[number], "linestyle": LINES[number], "linewidth": width}


def _responses(results, labels):
    """Yield amplitudes and phases (paper: freqres, phaseres).

    Of several detectors each has a colour, and line styles tell the results apart.
    """
    shown, alone = [], all(len(result.response.detector) == 1 for result in results)
    for number, (result, label) in enumerate(zip(results, labels, strict=True)):
        balls, look = style.ball_names(result.response.detector), _look(number)
        if not alone:
            del look["color"]
        names = [label] if alone else [f"{label}, {ball}" for ball in balls]
        shown.append((result.response, result.medium, names, look))
    yield "amplitude", response.amplitude_page(shown)
    figure, (ax,) = style.page(style.COLUMN, 2.5)
    ends = []
    for record, lattice, names, look in shown:
        response.phase(ax, record, lattice, labels=names, **look)
        ends.append(ax.get_xlim())
    ax.set_xlim(np.min(ends), np.max(ends))
    _finish(figure)
    figure.caption = response.SAID["phase"]
    yield "phase", figure


def _all_modes(results, labels):
    """Yield participation ratios, and densities if each result has 20 modes or more."""
    found = [result.modes.omega / result.medium.omega_mx for result in results]
    for x in found:
        style.check_any(x, "modes")
    shown = list(zip(results, found, labels, strict=True))
    figure, (ax,) = style.page(style.COLUMN, 2.5)
    for number, (result, x, label) in enumerate(shown):
        look = {"markersize": 3, "markeredgewidth": 0.5, "fillstyle": "none", "clip_on": False}
        look |= {"marker": MARKS[number], "color": COLOURS[number], "linestyle": "none"}
        ax.plot(x, result.modes.participation, label=label, **look)
    most = max(result.medium.free_balls for result in results)
    ax.set(yscale="log", ylim=(1, max(most, 10)), ylabel="participation ratio $P_i$ (balls)")
    style.frequencies(ax, np.concatenate(found), style.MODE_FREQUENCY)
    figure.caption = modes.SAID["participation"]
    made = {"participation": figure}
    if min(map(len, found)) >= 20:
        made["density"], (ax,) = style.page(style.COLUMN, 2.5)
        bins = round(max(map(len, found)) ** 0.5)
        edges = np.histogram_bin_edges(np.concatenate(found), bins)
        for number, (result, x, label) in enumerate(shown):
            counts = np.histogram(x, edges)[0] / np.diff(edges) / result.medium.free_balls
            look = {"edgecolor": COLOURS[number], "linestyle": LINES[number]}
            ax.stairs(counts, edges, label=label, **look)
        ax.set(ylim=(0, None), ylabel=style.DENSITY)
        style.frequencies(ax, edges, style.MODE_FREQUENCY)
        made["density"].caption = modes.SAID["density"]
    missing = sum(not result.modes.count_certified for result in results)
    for name, page in made.items():
        _finish(page)
        if missing:
            style.note(page, f"NOT CERTIFIED: modes of {missing} of {len(results)} results")
        yield name, page


def _relaxations(results, labels):
    """Yield the power spectra, each with the law fitted to it (paper: timeres)."""
    if any(getattr(result, "spectrum", None) is None for result in results):
        raise FileError(
            "spectra are laid over each other: a result has none, its run was too short"
        )
    figure, (ax,) = style.page(style.COLUMN, 2.5)
    for number, (result, label) in enumerate(zip(results, labels, strict=True)):
        said = f"{label}:\n{relaxation.exponent(result.spectrum)}"
        look = _look(number)
        relaxation.power(ax, result.spectrum, said, look["color"], linestyle=look["linestyle"])
    _finish(figure)
    figure.caption = "Power spectra of the amplitude, and the laws fitted to them."
    yield "spectrum", figure


def _pulses(results, labels):
    """Yield the signals of the first detector; not those that are below their error."""
    figure, (ax,) = style.page(style.PAGE, 2.5)
    for number, (result, label) in enumerate(zip(results, labels, strict=True)):
        signals, time = result.pulse, result.pulse.time * result.medium.omega_mx
        moved, error = signals.displacement[:, 0], signals.error[:, 0]
        if not np.abs(moved).max() > error.max():
            label, moved = f"{label}: below its error", np.full_like(moved, np.nan)
        ax.plot(time, moved, label=label, **_look(number))
    first = {style.ball_names(result.pulse.detector[:1])[0] for result in results}
    ax.set_title(first.pop() if len(first) == 1 else "first detectors")
    last = max(result.pulse.time[-1] * result.medium.omega_mx for result in results)
    ax.set(xlabel=style.TIME, ylabel="displacement", xlim=(0, last))
    _finish(figure)
    figure.caption = "Displacement of a ball against time."
    yield "signals", figure


PAGES = {"response": _responses, "modes": _all_modes, "relaxation": _relaxations, "pulse": _pulses}


def add_measured(made, results, data, label):
    """Draw what was measured into the figures of responses: circles over amplitudes and phases.

    Parameters
    ----------
    made : dict of str: matplotlib.figure.Figure
        Of `response`, or of `figures`.
    results : sequence of pgran.record.Result
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
    _finish(made["phase"])
    for part in ("amplitude", "phase"):
        made[part].caption += f" Circles: measured ({label})." if part in data else ""
    if not seen.any():
        raise FileError(f"{label}: none of its frequencies is one of the sweep; omega is angular, "
                        "in the unit of the result")  # fmt: skip
    return int(np.count_nonzero(~seen))
