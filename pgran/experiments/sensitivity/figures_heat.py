"""The figures of what a warm ball, or a cut bond, does to a signal."""

from functools import partial
from itertools import cycle

import numpy as np

from pgran.draw import balls, captions, marks, scales, style
from pgran.errors import FileError
from pgran.experiments.sensitivity import maps
from pgran.experiments.sensitivity.maps import Map
from pgran.medium.packing import nearest_images
from pgran.store.estimate import counted
from pgran.store.si import SI

QUARTER = 25.0  # %, what the heater of the experiment changed
CHANGE = r"change $|A' - A|\,/\,|A|$ (%)"
AWAY = scales.Quantity("distance of the warm ball from the detector", unit="m")
LABELS = {"warmed": "ball warmed", "frozen": "rest frozen", "cut": "bond cut"}
LINES = "-", "--", ":"  # of what is changed
GROUPS = 8  # of balls by their distance

errors = captions.amplitudes


def figures(result, **_):
    """Yield maps of warm balls and cut bonds, how the changes are distributed, and over omega."""
    heat, medium = result.heat, result.medium
    if not maps.few(heat):
        return
    for name in LABELS if medium.has_places else ():
        if getattr(heat, name) is not None:
            draw, what = partial(warm, name=name), "change of |A|"
            if name == "cut":
                draw, what = cut, "change in dB"
            words = partial(_words, name=name)
            yield from maps.pages(name, draw, heat, medium, what, words)
    apart = heat.growth is not None and heat.warmed is not None and medium.has_places
    panels = [distribution, over_frequency] + [over_distance] * apart
    figure = style.stack(panels, heat=heat, medium=medium)
    maps.note_failed(figure, heat)
    yield "changes", figure


def change(heat, name):
    """Return by what part amplitudes change, |A'| / |A| - 1 and |A' - A| / |A|, NaN if not known.

    That is where the error is larger than the change, and than a thousandth of the amplitude.
    `name`: of LABELS.
    """
    before, after = heat.displacement[..., None], getattr(heat, name)
    size = np.abs(before)
    with np.errstate(all="ignore"):
        moved, grown = np.abs(after - before) / size, np.abs(after) / size - 1
        error = (getattr(heat, f"{name}_bound") + heat.error_bound[..., None]) / size
    known = (error <= np.maximum(moved, 1e-3)) & (heat.converged_reason > 0)[:, None, None]
    return np.where(known, grown, np.nan), np.where(known, moved, np.nan)


def changes(heat):
    """Yield what is changed, the changes in %, shape (nw, nd, count)."""
    for name, label in LABELS.items():
        if getattr(heat, name) is not None:
            yield label, 100 * change(heat, name)[1]


def warm(ax, record, medium, at, d=0, name="warmed"):
    """Draw by how much each ball, warm, changes |A|, in units of the largest change that is seen.

    Grey: balls that were not warmed. Of the record what has this `name`.
    """
    seen = Map(medium, record.detector[d])
    values = np.full(len(seen.network.held), np.nan)
    values[record.ball] = change(record, name)[0][at, d]
    unit = balls.scale_of(np.nan_to_num(values[seen.free]))
    drawn = seen.discs(ax, values / unit)
    maps.title(ax, record, medium, at, f"{100 * unit:.3g} %", balls.beyond(drawn))
    return drawn


def cut(ax, record, medium, at, d=0):
    """Draw by how many dB each bond, cut, changes |A|, in units of the largest that is seen.

    What falls by more than 60 dB is drawn as if by 60. Where bonds are too many to be seen, each
    ball has the mean of its bonds.
    """
    seen = Map(medium, record.detector[d])
    drawn, unit = seen.on_bonds(ax, decibels(record, at, d), mean=True)
    maps.title(ax, record, medium, at, f"{unit:.3g} dB", balls.beyond(drawn))
    return drawn


def decibels(heat, at, d):
    """Return what each bond that is cut changes in dB, no less than -60; see `cut`."""
    return 20 * np.log10(np.maximum(1 + change(heat, "cut")[0][at, d], 1e-3))


def _words(seen, record, at, d, name):
    """Return what a map shows, in words: bonds cut, or balls that are warm, and how."""
    if name == "cut":
        return f"each bond cut alone; {seen.words(decibels(record, at, d), '|A| grows', 'mean')}"
    how = f"bonds {record.factor:g} times as stiff"
    if record.growth is not None:
        rest = "all at a new rest" if record.relaxed and name == "warmed" else LABELS["frozen"]
        growth = scales.said(np.abs(record.growth).max(), seen.medium, scales.PLACES[0], 3)
        how = f"radii larger by up to {growth}, {rest}"
    elif not np.isfinite(record.factor):
        how = f"overlaps larger by {record.overlap:g}"
    return f"each ball warmed alone, {how}; red: |A| grows; blue, with a bar: it falls"


def distribution(ax, heat, medium=None):
    """Share of balls warmed, or bonds cut, that change the amplitude by more, at all frequencies;
    dotted: a quarter, and numbers: the share of cases with more.
    """
    drawn, names = [], style.ball_names(heat.detector)
    for line, (label, moved) in zip(LINES, changes(heat), strict=False):
        for d, (name, shade) in enumerate(zip(names, style.colours(len(names)), strict=True)):
            size, share = maps.shares(moved[:, d])
            quarter = np.count_nonzero(size >= QUARTER) / max(len(size), 1)
            words = f"{name}, " * (len(names) > 1)
            words += f"{label}: {100 * quarter:.3g} %"
            drawn += ax.plot(size, share, color=shade, linestyle=line, label=words)
    ax.axvline(QUARTER, color=style.UNRESOLVED, linestyle=":")
    ax.set(xlabel=CHANGE, ylabel="share of cases with more")
    maps.logarithmic(ax, drawn, QUARTER)
    return drawn


def over_frequency(ax, heat, medium):
    """Median and largest change against the driving frequency; dotted: a quarter."""
    x, drawn = heat.omega / medium.omega_mx, []
    looks = zip(LINES, ("full", "none", "left"), strict=True)
    for (line, fill), (label, moved) in zip(looks, changes(heat), strict=False):
        known = np.ma.masked_invalid(moved)
        good, median = known.count(axis=-1) > 0, np.ma.median(known, axis=-1).filled(np.nan)
        largest = known.max(axis=-1).filled(np.nan)
        for what, y, width, mark in (("median", median, 0.7, "."), ("largest", largest, 1.4, "^")):
            look = {"linestyle": line, "linewidth": width}
            if len(x) <= style.FEW:  # where a line would be a polygon
                look = {"linestyle": "none", "marker": mark, "fillstyle": fill, "markersize": 3}
                look["markeredgewidth"] = 0.5
            names = [f"{what}, {label}"] + [None] * (len(heat.detector) - 1)
            drawn += marks.curves(ax, x, y, good, names, **look)
    ax.axhline(QUARTER, color=style.UNRESOLVED, linestyle=":")
    ax.set(yscale="log", ylabel=CHANGE)
    scales.frequencies(ax, x)
    marks.failed(ax, x[heat.converged_reason <= 0])
    return drawn


def over_distance(ax, heat, medium):
    """Change against the distance of the warm ball from the detector, at all frequencies; lines:
    medians of as many balls each; dotted: a quarter.
    """
    moved, drawn = 100 * change(heat, "warmed")[1], []
    names, shades = style.ball_names(heat.detector), style.colours(len(heat.detector))
    looks = zip(names, shades, distances(heat, medium), strict=True)
    for d, (name, shade, distance) in enumerate(looks):
        look = {"color": style.pale(shade), "linestyle": "none", "marker": ".", "markersize": 1.5}
        ax.plot(np.tile(distance, len(moved)), moved[:, d].ravel(), rasterized=True, **look)
        groups = np.array_split(np.argsort(distance), min(GROUPS, len(distance)))
        middle = [np.median(distance[group]) for group in groups]
        known = np.ma.masked_invalid(moved[:, d])
        median = [np.ma.filled(np.ma.median(known[:, group]), np.nan) for group in groups]
        drawn += ax.plot(middle, median, color=shade, marker="o", markersize=3, label=name)
    ax.axhline(QUARTER, color=style.UNRESOLVED, linestyle=":")
    scales.label(ax.xaxis, AWAY)
    ax.set(yscale="log", ylabel=CHANGE)
    return drawn


def distances(heat, medium):
    """Return how far each warm ball is from each detector, by the nearest images, (nd, balls)."""
    position, box = medium.position, getattr(medium, "box", None)
    periods = np.full(position.shape[1], np.inf) if box is None else np.where(box > 0, box, np.inf)
    away = position[heat.ball] - position[heat.detector[:, 0]][:, None]
    vectors, _ = nearest_images(away.reshape(-1, position.shape[1]), periods)
    return np.linalg.norm(vectors, axis=1).reshape(away.shape[:2])


def growths(results):
    """Return the page of several results: what one warm ball changes, how often, by its growth."""
    by_growth = {}
    for result in results:
        heat = getattr(result, "heat", None)
        if heat is None or heat.growth_overlap is None or heat.warmed is None:
            raise FileError(
                "several results of the scene sensitivity are drawn together if balls of packings "
                "grow in them (-heat_radius, -heat_kelvin)"
            )
        growth, moved = heat.growth.mean(), np.abs(change(heat, "warmed")[0])
        name = f"radii grow by {growth:.3g}{SI.of(result).say('m', growth)}"
        known = moved[np.isfinite(moved)]
        if not known.size:
            continue
        shares = *np.quantile(known, [0.5, 0.9]), np.mean(known >= 0.25)
        point = heat.growth_overlap.mean(), *(100 * share for share in shares)
        by_growth.setdefault(name, []).append(point)
    figure = style.stack([sizes, often], fewest=0, points=by_growth)
    if failed := sum(result.heat.failures for result in results):
        style.note(figure, f"NOT IN IT: {counted(failed, 'case')} that failed")
    return figure


def sizes(ax, points):
    """Change of |A| by one ball that grows, median and 90 % quantile over balls, frequencies and
    detectors; a point of each for a result, against the growth in units of the mean overlap of its
    contacts.
    """
    drawn = _by_growth(ax, points, {1: None, 2: "90 % quantile"})
    ax.axhline(QUARTER, color=style.UNRESOLVED, linestyle=":", label="a quarter")
    ax.set(yscale="log", ylabel=r"change of $|A|$, median (%)")
    return drawn


def often(ax, points):
    """Share of cases in which |A| changes by a quarter or more, against that growth."""
    drawn = _by_growth(ax, points, {3: None})
    ax.set(ylim=(0, None), ylabel="a quarter or more (% of cases)")
    return drawn


def _by_growth(ax, points, columns):
    """Draw columns of rows of points, by growth; labelled by the name of the rows, or as said."""
    drawn = []
    for name, shade, mark in zip(points, style.colours(len(points)), cycle("o^sdvx")):
        rows = np.array(sorted(points[name]))
        for (column, label), fill in zip(columns.items(), ("full", "none"), strict=False):
            look = {"color": shade, "marker": mark, "fillstyle": fill, "clip_on": False}
            label = label or name
            drawn += ax.plot(*rows[:, [0, column]].T, linestyle="none", label=label, **look)
    ax.set(xscale="log", xlabel="growth / mean overlap of contacts")
    return drawn
