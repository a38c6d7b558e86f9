"""The figures of an ensemble: curves with their band, histograms of numbers, densities of modes;
of its responses noise beside the Gaussian laws, and transport: what falls with depth, and how.
"""

import math
from functools import partial

import numpy as np

from pgran.draw import captions, marks, scales, style
from pgran.draw.scales import Quantity
from pgran.experiments.ensemble.record import ABOVE_FLOOR, measures
from pgran.experiments.modes import figures as modes
from pgran.store.estimate import counted

# Numbers of a sample, by their names in the record, which declares how they are called.
NUMBERS = {name: Quantity(*measure.quantity) for name, measure in measures().items()}
SINGLE = " Thin lines: single samples; dots: where lines from point to point are not their curve."
BAND, MOST_BINS = "#C8C8C8", 30
COARSE_LINE = 0.1  # of an amplitude, that such a line may be wrong
PANEL_ROWS, NARROWEST_PANEL = 5, 3.0  # of curves, before there is another column; inches of one
NAMES = {"whole": "computed", "incoherent": r"less $\langle A\rangle$"}  # parts of a noisy response
HALF_WIDTHS = 6  # half widths up to which correlations are drawn
LAW = {"color": "#777777", "linewidth": 1.2}
LOOK = {"markersize": 2.5, "elinewidth": 0.6, "fillstyle": "none", "markeredgewidth": 0.6}
SHOWN_CURVES = 4  # frequencies, depths or times of transport
FALLS = {  # what amplitudes fall with, and how many times their lengths are drawn
    "length": ("typical", 1),
    "intensity_length": ("root mean square", 2),
    "scattering_length": ("coherent", 2),
}


def figures(result, **_):
    """Yield what there is: curves, densities of modes, histograms; noise; transport, diffusion."""
    medium = result.medium
    if hasattr(result, "ensemble"):
        found = result.ensemble
        style.check_any(found.seed[found.good > 0], "sample that is as accurate as asked")
        for name, figure in _samples(found, medium):
            if found.left_out:
                style.note(figure, f"left out: {found.left_out} of {len(found.seed)} samples")
            yield name, figure
    if hasattr(result, "statistics"):
        yield from _noise(result.statistics, medium)
    if getattr(result, "diffusion", None):
        yield "diffusion", style.single(decay, found=result.diffusion, lattice=medium)
    elif hasattr(result, "transport"):
        yield "transport", _transport(result.transport, medium)


def errors(record, _):
    """Return how many samples are good."""
    if record.group != "ensemble":
        return ""
    lost = f"; left out: {record.left_out}" if record.left_out else ""
    good = counted(np.count_nonzero(record.good), "sample")
    return f"Each of {good} has the accuracy asked for{lost}."


def _samples(found, lattice):
    """Yield curves with their band, densities of modes, and histograms of numbers."""
    curves = {"amplitude": (amplitude, found.ln_amplitude), "delay": (delay, found.delay)}
    for name, (panel, values) in curves.items():
        if found.omega is not None and np.isfinite(values).any():
            yield name, _curves_page(found, lattice, panel)
    if found.mode_omega is not None and len(np.unique(known(found, "mode_omega"))) > 1:
        several = len(np.unique(found.widths(lattice)[0])) > 1
        for panel in (density, participation, *[widths] * several):
            yield panel.__name__, style.single(panel, found=found, lattice=lattice)
    for name in NUMBERS:
        values = getattr(found, name)
        columns = range(0 if values is None else np.size(values[:1]))
        numbers = [known(found, name, d) for d in columns]
        shown = [d for d in columns if len(numbers[d]) > style.TOO_FEW and np.ptp(numbers[d])]
        if shown:
            yield name, _histograms(found, name, shown)


def known(found, name, detector=None):
    """Return a number of all samples that are good and have it, shape (n,)."""
    values = getattr(found, name)[found.good > 0]
    if detector is not None and values.ndim > 1:
        values = values[:, detector]
    return values[np.isfinite(values)]


def withheld(found, name, detector=None):
    """Return how many samples that are good lack a number, as it is not certain."""
    return np.count_nonzero(found.good) - len(known(found, name, detector))


def _curves_page(found, lattice, panel):
    """Return a figure with a panel a detector."""
    (order, names), count = captions.by_depth(lattice, found.detector), len(found.detector)
    draws = [partial(panel, found=found, lattice=lattice, detector=d) for d in order]

    def height(rows):
        return 0.5 + rows * (2.4 if rows <= 3 else 1.7 if rows <= PANEL_ROWS else 0.9)

    figure, columns = style.grid(draws, height, PANEL_ROWS, NARROWEST_PANEL, sharex=True)
    for d, ax in zip(order, figure.panels, strict=True):
        ax.set_title(names[d] if count > 1 else "")
    single = any("seed" in str(line.get_gid()) for line in figure.panels[0].get_lines())
    figure.caption = style.caption_of(panel) + SINGLE * single
    style.legend_above([figure.panels[columns - 1]])
    return figure


def amplitude(ax, found, lattice, detector=0):
    r"""Amplitude against the driving frequency over samples: the band of 80 % of them, their
    median, and the coherent part $|\langle A\rangle|$, where it is more than the mean of so many
    samples has by chance, less that.

    Some samples are drawn, too, if they are kept.
    """
    each = None if found.displacement is None else np.abs(found.displacement)
    drawn = _band(ax, found, lattice, np.exp(found.ln_amplitude), each, detector)
    part = coherent(found, detector)
    if np.isfinite(part).any():
        look = {"color": style.UNRESOLVED, "linestyle": (0, (3, 1)), "linewidth": 1.2}
        label = r"coherent, $|\langle A\rangle|$"
        ax.plot(found.omega / lattice.omega_mx, part, label=label, **look)
    ax.set(yscale="log", ylabel=scales.AMPLITUDE)
    return drawn


def coherent(found, detector):
    """Return |<A>| where it is more than chance, NaN elsewhere.

    Of N samples without a coherent part |<A>|^2 still is <I>/N on the mean, and beyond ABOVE_FLOOR
    times that in one of 150. That floor is taken off.
    """
    samples = np.count_nonzero(found.good)
    square, intensity = np.abs(found.coherent[:, detector]) ** 2, found.intensity[:, detector]
    floor = (intensity - square) / max(samples - 1, 1)
    beyond = square > ABOVE_FLOOR * intensity / samples
    return np.sqrt(np.where(beyond, square - floor, np.nan))


def delay(ax, found, lattice, detector=0):
    """Group delay against the driving frequency over samples: the band of 80 % of them, and their
    median; with a pale band the axis is linear in it, and logarithmic beyond.
    """
    values, each = found.delay * lattice.omega_mx, found.sample_delay
    each = None if each is None else each * lattice.omega_mx
    drawn = _band(ax, found, lattice, values, each, detector)
    alone = [np.ma.compressed(line.get_ydata()) for line in ax.get_lines() if line.get_gid()]
    scales.delays(ax, np.concatenate([*values[:, :, detector], *alone]))
    return drawn


def _band(ax, found, lattice, values, each, detector):
    """Draw the band of curves, shape (statistics, nw), three of them, and their median."""
    x, row = found.omega / lattice.omega_mx, found.statistic.tolist().index
    values = values[:, :, detector]
    band = values[row("low")], values[row("high")]
    ax.fill_between(x, *band, color=BAND, linewidth=0, label="10 to 90 %")
    if each is not None:
        for n, shade in zip(np.flatnonzero(found.good), style.COLOURS[1:4], strict=False):
            good = resolved(found, n, detector)
            y, look = each[n, :, detector], {"color": shade, "linewidth": 0.4, "markersize": 1.2}
            look["gid"] = f"seed {found.seed[n]}"
            ax.plot(x, np.ma.masked_where(~good, y), label="single samples", **look)
            ax.plot(x[~good], y[~good], ".", **look)
    (median,) = ax.plot(x, values[row("median")], color="black", linewidth=1.0, label="median")
    scales.frequencies(ax, x)
    return median


def resolved(found, sample, detector):
    """Return where lines from point to point are right to about COARSE_LINE of the amplitude.

    Without a point the line between its neighbours is four times as wrong as those to them.
    """
    x, y = found.omega, found.displacement[sample, :, detector]
    part = (x[1:-1] - x[:-2]) / (x[2:] - x[:-2])
    bend = np.abs(y[1:-1] - (1 - part) * y[:-2] - part * y[2:])
    return np.pad(bend <= 4 * COARSE_LINE * np.abs(y[1:-1]), 1, constant_values=True)


def _histograms(found, name, shown):
    """Return a figure of histograms of a number, a panel each detector that is shown."""
    draws = [partial(histogram, found=found, name=name, detector=d) for d in shown]
    figure, _ = style.grid(
        draws, lambda rows: min(2.0 * rows, 5.4 + 0.6 * rows), PANEL_ROWS, NARROWEST_PANEL
    )
    what = f"{NUMBERS[name].name} {NUMBERS[name].own}".strip()
    figure.caption = style.caption_of(histogram).replace("a number", what)
    if any(withheld(found, name, d) for d in shown):
        figure.caption += " Withheld: samples in which it is not certain."
    return figure


def histogram(ax, found, name, detector=0):
    """Histogram over samples of a number; line and band: mean and its standard error.

    It has its `name` of NUMBERS.
    """
    values, quantity = known(found, name, detector), NUMBERS[name]
    whole = np.all(values == np.round(values)) and np.ptp(values) <= MOST_BINS
    bins = np.arange(values.min() - 0.5, values.max() + 1) if whole else _bins(values)
    counts, edges = np.histogram(values, bins)
    ax.stairs(counts, edges, fill=True, color=style.pale(style.ACCENT))
    outline = ax.stairs(counts, edges, color=style.ACCENT)
    mean, error = values.mean(), values.std(ddof=1) / math.sqrt(len(values))
    ax.axvspan(mean - error, mean + error, color="black", alpha=0.35, linewidth=0)
    ax.axvline(mean, color="black")
    where = "" if found.detector is None else f"{style.ball_names(found.detector)[detector]}: "
    places = max(0, 1 - math.floor(math.log10(error)))
    numbers = rf"${mean:.{places}f} \pm {error:.{places}f}$ {quantity.own.strip('()')}"
    ax.set_title(f"{where}mean {numbers.strip()}")
    missing = withheld(found, name, detector)
    of = f"{len(values)}; {missing} withheld" if missing else f"of {len(values)}"
    ax.set(ylabel=f"samples ({of})")
    scales.label(ax.xaxis, quantity)
    ax.set_ylim(bottom=0)
    ax.locator_params("x", nbins=6)
    ax.locator_params("y", integer=True)
    return outline


def _bins(values):
    """Return edges of bins as wide as 2 IQR / n^(1/3) (Freedman and Diaconis), few at most."""
    width = 2 * np.subtract(*np.percentile(values, [75, 25])) / len(values) ** (1 / 3)
    count = math.ceil(np.ptp(values) / width) if width > 0 else MOST_BINS
    return np.linspace(values.min(), values.max(), min(max(count, 4), MOST_BINS) + 1)


def density(ax, found, lattice):
    r"""Density of the modes of a sample per ball and $\omega_{mx}$, with its standard error."""
    x = found.mode_omega[found.good > 0] / lattice.omega_mx
    edges = modes.bin_edges(x)
    each = np.array([np.histogram(row, edges)[0] for row in x])
    each = each / np.diff(edges) / lattice.free_balls
    mean, error = each.mean(axis=0), each.std(axis=0, ddof=1) / math.sqrt(len(x))
    shade = {"fill": True, "color": "#999999", "label": "standard error"}
    ax.stairs(mean + error, edges, baseline=mean - error, **shade)
    outline = ax.stairs(mean, edges, color="black", label=f"mean of {len(x)} samples")
    modes.counts.density_axes(ax, edges)
    return outline


def widths(ax, found, lattice):
    r"""Density of $\log_{10}\Gamma$ over all modes of samples that ring; filled: those in which
    fewer than 5 % of the balls take part.
    """
    width, localized = found.widths(lattice)
    x = np.log10(width / lattice.omega_mx)
    edges = np.linspace(x.min(), x.max(), 2 * MOST_BINS + 1)
    all_of_them, few = (np.histogram(x[which], edges)[0] for which in (width > 0, localized))
    of_one = len(x) * np.diff(edges)
    if few.any():
        ax.stairs(few / of_one, edges, fill=True, color=style.pale(style.ACCENT), label="localized")
    outline = ax.stairs(all_of_them / of_one, edges, color="black", label="all modes")
    ax.set(xlabel=r"$\log_{10}(\Gamma/\omega_{mx})$", ylabel="density per decade")
    ax.set_ylim(bottom=0)
    return outline


def participation(ax, found, lattice):
    """Participation ratio of the normal modes against their frequency: the band of 80 % of them,
    and their median.
    """
    x, values = known(found, "mode_omega") / lattice.omega_mx, known(found, "participation")
    edges = modes.bin_edges(x)
    bins = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)
    low, middle, high = np.full((3, len(edges) - 1), np.nan)
    for n in np.unique(bins):
        low[n], middle[n], high[n] = np.percentile(values[bins == n], (10, 50, 90))
    shade = {"fill": True, "color": BAND, "label": "10 to 90 % of the modes"}
    ax.stairs(high, edges, baseline=low, **shade)
    median = ax.stairs(middle, edges, baseline=None, color="black", label="median")
    modes.participation_axes(ax, edges, lattice)
    return median


def _noise(found, medium):
    """Yield densities, and correlations in known half widths, a panel a window and detector."""

    def titled(ax, panel, window, detector):
        panel(ax, found, window, detector)
        ends = found.low[window], found.high[window]
        low, high = (scales.frequency(end / medium.omega_mx, medium) for end in ends)
        ax.set_title(f"{low} to {high}, {style.ball_names(found.detector)[detector]}")

    everywhere = list(np.ndindex(found.coherent_part.shape))
    scaled = [place for place in everywhere if np.isfinite(found.half_width[place]).any()]
    for panel, places in ((intensity, everywhere), (correlation, scaled)):
        if places:
            draws = [partial(titled, panel=panel, window=w, detector=d) for w, d in places]
            yield panel.__name__, style.stack(draws, style.caption_of(panel))


def intensity(ax, found, window=0, detector=0):
    """Density of the intensity $I = |A|^2$ over its mean, with standard errors, beside the Gaussian
    law.
    """
    middle = 0.5 * (found.edge[1:] + found.edge[:-1])
    # of a Gaussian field the mean over each bin, as the points are
    law = -np.diff(np.exp(-found.edge)) / np.diff(found.edge)
    (line,) = ax.plot(middle, law, label=r"Gaussian, $e^{-x}$", **LAW)
    values, errors = (each[window, detector] for each in (found.density, found.density_error))
    values, names = np.where(values > 0, values, np.nan), [NAMES[part] for part in found.part]
    marks.points(ax, middle, values, errors, names, **LOOK)
    ax.set_xlim(found.edge[0], found.edge[-1])
    ax.set(yscale="log", xlabel=r"$x = I/\langle I\rangle$", ylabel="density $P(x)$")
    return line


def correlation(ax, found, window=0, detector=0):
    """Correlation of the intensity along the driving frequency, shifts in half widths; thin: 0."""
    known = np.isfinite(found.correlation[window, detector])
    reach = found.shift[window] / found.half_width[window, detector][:, None]
    furthest = min(HALF_WIDTHS, np.max(reach, where=known & np.isfinite(reach), initial=1.0))
    x = np.linspace(0, furthest, 200)
    (line,) = ax.plot(x, 1 / (1 + x**2), label="Lorentzian", **LAW)
    values, names = found.correlation[window, detector], [NAMES[part] for part in found.part]
    values = np.where(reach <= furthest, values, np.nan)
    errors = found.correlation_error[window, detector]
    marks.points(ax, reach, values, errors, names, **LOOK)
    ax.axhline(0, color="black", linewidth=0.4)
    ax.set(xlim=(0, furthest), xlabel=r"shift of $\omega$ (half widths)")
    ax.set_ylabel("correlation of $I$")
    return line


def _transport(found, lattice):
    """Return the figure of profiles over depth, lengths and wave numbers by frequency, delays."""
    panels = [profile, length]
    known = found.wave_number is not None and np.isfinite(found.wave_number)
    if np.count_nonzero(known) > style.HANDFUL:
        panels.append(wave_number)
    if found.band_delay is not None:  # files before version 5 have none
        panels.append(band_delay)
    figure = style.stack(panels, found=found, lattice=lattice)
    figure.caption += " Bars: standard errors over samples."
    return figure


def profile(ax, found, lattice):
    """Mean logarithm of the amplitude against the distance from the driven wall, at some driving
    frequencies; pale: where lines go through.
    """
    chosen = _some(found.omega)
    if found.depth_low is not None:
        ax.axvspan(found.depth_low, found.depth_high, color="#F0F0F0", zorder=0)
    scales.label(ax.xaxis, scales.DISTANCE)
    ax.set_ylabel(r"$\langle\ln|A|\rangle$")
    labels = [scales.frequency(x / lattice.omega_mx, lattice, 3) for x in found.omega[chosen]]
    values, errors = found.ln_amplitude[chosen], found.ln_amplitude_error[chosen]
    return marks.points(ax, found.depth, values, errors, labels)


def length(ax, found, lattice):
    r"""Attenuation length against the driving frequency where sound propagates, above the first
    mode: of the typical amplitude $e^{\langle\ln|A|\rangle}$, of the root mean square,
    twice the intensity's, and of the coherent $|\langle A\rangle|$, twice the scattering length.
    Circled: $\langle\ln|A|\rangle$ is not straight, p < .01.
    """
    ax.set_yscale("log")
    scales.label(ax.yaxis, scales.ATTENUATION)
    if found.first_mode is not None:
        look = {"color": "black", "linestyle": "--", "linewidth": 0.6}
        first = found.first_mode / lattice.omega_mx
        ax.axvline(first, label="first mode", **look)
        scales.frequencies(ax, [0.0, first])
    drawn = _by_frequency(ax, found, lattice, FALLS)
    if found.straightness is not None:
        refused = found.omega[found.refused] / lattice.omega_mx, found.length[found.refused]
        ax.plot(*refused, "o", markersize=4, color="black", markerfacecolor="none", linewidth=0.6)
    return drawn


def wave_number(ax, found, lattice):
    """Wave number of the coherent field against the driving frequency."""
    ax.set_ylabel(r"wave number $k$ (rad/spacing)")
    return _by_frequency(ax, found, lattice, {"wave_number": (None, 1)})


def _by_frequency(ax, found, lattice, named):
    """Draw numbers of a record as far as it has them, so many times."""
    x, rows = found.omega / lattice.omega_mx, []
    for name, (words, times) in named.items():
        values, errors = (getattr(found, name + end) for end in ("", "_error"))
        if values is not None and np.isfinite(values).any():
            rows.append((times * values, times * errors, words))
    if not rows:
        return []
    drawn = marks.points(ax, x, *zip(*rows, strict=True), markersize=2, elinewidth=0.6)
    scales.frequencies(ax, x[np.isfinite([values for values, *_ in rows]).any(axis=0)])
    return drawn


def band_delay(ax, found, lattice):
    """Mean group delay in bands of frequencies, by their middle, against the distance. Hollow: it
    does not grow for certain.
    """
    scales.label(ax.xaxis, scales.DISTANCE)
    scales.label(ax.yaxis, scales.DELAY)
    middles = 0.5 * (found.edge[1:] + found.edge[:-1]) / lattice.omega_mx
    labels = [scales.frequency(middle, lattice, 2) for middle in middles]
    late, error = found.band_delay * lattice.omega_mx, found.band_delay_error * lattice.omega_mx
    drawn = marks.points(ax, found.depth, late, error, labels)
    for points, propagates in zip(drawn, found.propagates, strict=True):
        if not propagates:
            points.lines[0].set_markerfacecolor("none")
    return drawn


def decay(ax, found, lattice):
    r"""Mean of $u^2 + (v/\omega)^2$ over samples against time, at some distances from what is
    driven; lines: the fit of diffusion between two walls. Bars: standard errors.
    """
    chosen, time = _some(found.depth), found.time * lattice.omega_mx
    scales.label(ax.xaxis, scales.TIME)
    ax.set(yscale="log", ylabel=r"$\langle u^2 + (v/\omega)^2\rangle$")
    labels = [f"{depth:g} spacings" for depth in found.depth[chosen]]
    square, error, fit = (
        x[:, chosen] for x in (found.mean_square, found.mean_square_error, found.fit)
    )
    drawn = marks.points(ax, time, square.T, error.T, labels)
    for points, line in zip(drawn, fit.T, strict=True):
        ax.plot(time, line, color=points.lines[0].get_color(), linewidth=0.8)
    return drawn


def _some(values):
    """Return the numbers of a few values, equally far from each other."""
    return np.unique(np.linspace(0, len(values) - 1, SHOWN_CURVES + 2).astype(int)[1:-1])
