"""The figures of an ensemble: curves with their band, histograms of numbers, densities of modes."""

import math

import numpy as np

from pgran.draw import captions, scales, style
from pgran.draw.scales import Quantity
from pgran.experiments.ensemble.record import ABOVE_FLOOR, measures
from pgran.experiments.modes import figures as modes
from pgran.store.estimate import counted

# Numbers of a sample, by their names in the record, which declares how they are called.
NUMBERS = {name: Quantity(*measure.quantity) for name, measure in measures().items()}
CAPTIONS = {
    "amplitude": "Amplitude against the driving frequency over samples: the band of 80 % of them, "
    "their median, and the coherent part $|\\langle A\\rangle|$, where it is more than the mean of "
    "so many samples has by chance, less that.",
    "delay": "Group delay against the driving frequency over samples: the band of 80 % of them, "
    "and their median; the axis is linear up to a power of ten next to the median, logarithmic "
    "beyond.",
    "density": "Density of the normal modes of a sample per ball and $\\omega_{mx}$, with its "
    "standard error.",
    "widths": r"Density of $\log_{10}\Gamma$ over all modes of samples that ring; filled: those in "
    "which fewer than 5 % of the balls take part.",
    "participation": "Participation ratio of the normal modes against their frequency: the band of "
    "80 % of them, and their median.",
}
SINGLE = " Thin lines: single samples; dots: where lines from point to point are not their curve."
BAND, BINS = "#C8C8C8", 30
COARSE = 0.1  # of an amplitude, that such a line may be wrong
ROWS, NARROWEST = 5, 3.0  # of curves, before there is another column; inches of one


def figures(result, **_):
    """Yield what there is: bands of curves, densities of modes, and histograms of numbers."""
    found = result.ensemble
    style.check_any(found.seed[found.good > 0], "sample that is as accurate as asked")
    for name, figure in _pages(found, result.medium):
        if found.left_out:
            style.note(figure, f"left out: {found.left_out} of {len(found.seed)} samples")
        yield name, figure


def _pages(found, lattice):
    """Yield the names and the figures."""
    curves = {"amplitude": (amplitude, found.ln_amplitude), "delay": (delay, found.delay)}
    for name, (panel, values) in curves.items():
        if found.omega is not None and np.isfinite(values).any():
            yield name, _curves_page(found, lattice, panel)
    if found.mode_omega is not None and len(np.unique(known(found, "mode_omega"))) > 1:
        several = len(np.unique(found.widths(lattice)[0])) > 1
        for panel in (density, participation, *[widths] * several):
            yield panel.__name__, style.single(panel, CAPTIONS, found=found, lattice=lattice)
    for name, quantity in NUMBERS.items():
        values = getattr(found, name)
        columns = range(0 if values is None else np.size(values[:1]))
        shown = [d for d in columns if len(np.unique(known(found, name, d))) > 1]
        if shown:
            figure, panels, _ = style.grid(
                len(shown), ROWS, NARROWEST, lambda rows: min(2.0 * rows, 5.4 + 0.6 * rows)
            )
            for d, ax in zip(shown, panels, strict=True):
                histogram(ax, found, name, d)
            what = f"{quantity.name} {quantity.own}".strip()
            figure.caption = (
                f"Histogram over samples: {what}; line and band: mean and its standard error."
            )
            if any(withheld(found, name, d) for d in shown):
                figure.caption += " Withheld: samples in which it is not certain."
            yield name, figure


def errors(record, _):
    """Return how many samples are good."""
    lost = f"; left out: {record.left_out}" if record.left_out else ""
    good = counted(np.count_nonzero(record.good), "sample")
    return f"Each of {good} has the accuracy asked for{lost}."


def known(found, name, detector=None):
    """Return a number of all samples that are good and have it, shape (n,)."""
    values = getattr(found, name)[found.good > 0]
    if detector is not None and values.ndim > 1:
        values = values[:, detector]
    return values[np.isfinite(values)]


def withheld(found, name, detector=None):
    """Return how many samples that are good lack a number, as it is not certain."""
    return np.count_nonzero(found.good) - len(known(found, name, detector))


def amplitude(ax, found, lattice, detector=0):
    """Draw the band, the median, some samples, and the `coherent` part; return the median."""
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
    """Draw band, median and samples of the group delay, linear up to it; return the median."""
    values, each = found.delay * lattice.omega_mx, found.sample_delay
    each = None if each is None else each * lattice.omega_mx
    drawn = _band(ax, found, lattice, values, each, detector)
    values = values[:, :, detector]
    middle = np.nanmedian(np.abs(values[found.statistic.tolist().index("median")]))
    threshold = 10.0 ** round(math.log10(middle)) if middle > 0 else 1.0
    scales.symmetric(ax, values[np.isfinite(values)], threshold)
    scales.label(ax.yaxis, scales.DELAY)
    return drawn


def resolved(found, sample, detector):
    """Return where lines from point to point are right to COARSE of a sample's amplitude, about.

    Without a point the line between its neighbours is four times as wrong as those to them.
    """
    x, y = found.omega, found.displacement[sample, :, detector]
    part = (x[1:-1] - x[:-2]) / (x[2:] - x[:-2])
    bend = np.abs(y[1:-1] - (1 - part) * y[:-2] - part * y[2:])
    return np.pad(bend <= 4 * COARSE * np.abs(y[1:-1]), 1, constant_values=True)


def _band(ax, found, lattice, values, each, detector):
    """Draw the band of curves, shape (statistics, nw), three of them, and their median."""
    x, row = found.omega / lattice.omega_mx, found.statistic.tolist().index
    values = values[:, :, detector]
    band = values[row("low")], values[row("high")]
    ax.fill_between(x, *band, color=BAND, linewidth=0, label="10 to 90 % of the samples")
    if each is not None:
        for n, shade in zip(np.flatnonzero(found.good), style.COLOURS[1:4], strict=False):
            good = resolved(found, n, detector)
            y, look = each[n, :, detector], {"color": shade, "linewidth": 0.4, "markersize": 1.2}
            ax.plot(x, np.ma.masked_where(~good, y), label=f"seed {found.seed[n]}", **look)
            ax.plot(x[~good], y[~good], ".", **look)
    (median,) = ax.plot(x, values[row("median")], color="black", linewidth=1.0, label="median")
    scales.frequencies(ax, x)
    return median


def _curves_page(found, lattice, panel):
    """Return a figure with a panel a detector."""
    (order, names), count = captions.by_depth(lattice, found.detector), len(found.detector)
    figure, panels, columns = style.grid(
        count, ROWS, NARROWEST, sharex=True,
        height=lambda rows: 0.5 + rows * (2.4 if rows <= 3 else 1.7 if rows <= ROWS else 0.9),
    )  # fmt: skip
    named = range(0, count, columns)
    named = named if len(named) <= ROWS else named[len(named) // 2 :][:1]  # they run together
    for n, (d, ax) in enumerate(zip(order, panels, strict=True)):
        panel(ax, found, lattice, d)
        if count > 1:
            ax.set_title(names[d])
        if n + columns < count:  # another stands below
            ax.set_xlabel("")
        else:
            ax.tick_params(labelbottom=True)
        if n not in named:
            ax.set_ylabel("")
    style.legend_above([panels[columns - 1]])
    single = any("seed" in str(line.get_label()) for line in panels[0].get_lines())
    figure.caption = CAPTIONS[panel.__name__] + SINGLE * single
    return figure


def histogram(ax, found, name, detector=0):
    """Draw the histogram of a number (of NUMBERS), its mean and error; return the outline."""
    values, quantity = known(found, name, detector), NUMBERS[name]
    whole = np.all(values == np.round(values)) and np.ptp(values) <= BINS
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
    count = math.ceil(np.ptp(values) / width) if width > 0 else BINS
    return np.linspace(values.min(), values.max(), min(max(count, 4), BINS) + 1)


def density(ax, found, lattice):
    """Draw the density of modes a sample, with its standard error; return the outline."""
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
    """Draw the density of log widths, filled that of localized modes; return the outline."""
    width, localized = found.widths(lattice)
    x = np.log10(width / lattice.omega_mx)
    edges = np.linspace(x.min(), x.max(), 2 * BINS + 1)
    all_of_them, few = (np.histogram(x[which], edges)[0] for which in (width > 0, localized))
    of_one = len(x) * np.diff(edges)
    if few.any():
        ax.stairs(few / of_one, edges, fill=True, color=style.pale(style.ACCENT), label="localized")
    outline = ax.stairs(all_of_them / of_one, edges, color="black", label="all modes")
    ax.set(xlabel=r"$\log_{10}(\Gamma/\omega_{mx})$", ylabel="density per decade")
    ax.set_ylim(bottom=0)
    return outline


def participation(ax, found, lattice):
    """Draw participation ratios against frequency, band and median in bins; return the median."""
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
