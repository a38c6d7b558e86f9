"""The figures of loud sound: harmonics, parts, resonances that fold, and contacts that clap."""

from functools import partial

import numpy as np
from matplotlib.collections import LineCollection

from pgran.draw import captions, marks, network, scales, style
from pgran.draw.view import View
from pgran.medium.overlaps import are_lengths, overlaps_of

MOTION = scales.Quantity("displacement $|u_n|$", "(length)", "m")
HARMONICS, PANELS = 4, 4  # from the mean on; for detectors and frequencies, at most
DOWN = {"label": None, "linewidth": 2.5, "zorder": 1}
STATES = " Dashed: unstable states, which no motion stays in; hollow: less accurate than asked."


def figures(result, **_):
    """Yield harmonics and parts by amplitude, or resonances, and the contacts that clap."""
    record, medium = result.loud, result.medium
    shown, swept = {"record": record, "medium": medium}, record.follow == "frequency"
    heard, panels = range(len(record.detector)), [change, clapping]
    if not swept:
        drawn = [partial(harmonics, w=w, d=d) for d in heard for w in range(len(record.omega))]
        figure = style.stack(drawn[:PANELS], style.caption_of(harmonics), fewest=1, **shown)
        more = len(drawn) - PANELS
        figure.caption += STATES + f" Not drawn: {more} more detectors or frequencies." * (more > 0)
        yield "harmonics", figure
    panels = [partial(ratio, d=d) for d in heard if swept] + panels
    caption = style.lettered(map(style.caption_of, panels)) + STATES
    name = "resonance" if swept else "parts"
    yield name, style.stack(panels, caption, shared=True, fewest=1, height=1.8, **shown)
    if medium.group == "network" and medium.has_places and record.clapped[record.reached].any():
        yield "claps", claps(record, medium)


def errors(record, _):
    """Return how large errors are as they are estimated, and which states are doubtful."""
    good, reached = record.converged_reason > 0, record.reached
    part = record.harmonic_error[good] / np.abs(record.harmonic[good][..., 1:2])
    words = "Errors are estimated, by a Newton step with twice the harmonics"
    words += f": at most {captions.number(part.max())} of a fundamental." if part.size else "."
    known = {"less accurate than asked": reached & ~good, "not reached": ~reached}
    known["perhaps unstable, without a multiplier"] = reached & ~np.isfinite(record.multiplier)
    for what, those in known.items():
        count = np.count_nonzero(those)
        words += f" {count} of {those.size} states are {what}." * bool(count)
    return words


def harmonics(ax, record, medium, w=0, d=0):
    """Harmonics $u_n$ of the displacement of a detector, $n$ = 0 its mean, against the amplitude of
    the drive; pale: slopes 1 and 2; dotted line: there the linear field opens its first contact.
    """
    x, size = followed(ax, record, medium, w)[w], np.abs(record.harmonic[w, :, d])
    size = np.where(record.harmonic_error[w, :, d] < size, size, np.nan)
    ax.set_yscale("log")
    scales.label(ax.yaxis, _length(MOTION, medium))
    where, drawn = scales.frequency(record.omega[w] / medium.omega_mx, medium), []
    style.title(ax, style.ball_names(record.detector)[d], where)
    for n in range(min(HARMONICS, size.shape[1])):
        shade, known = style.COLOURS[(n - 1) % HARMONICS], np.isfinite(size[:, n])
        drawn += states(ax, record, w, x, size[:, n], label=f"$n$ = {n}", color=shade)
        if n in (1, 2) and known.any():
            look = {"color": style.pale(shade), "linewidth": 3, "zorder": 1, "scaley": False}
            ax.plot(x, (size[:, n] / x**n)[known][0] * x**n, label=f"slope {n}", **look)
    return drawn


def ratio(ax, record, medium, d=0):
    """Fundamental of a detector over the amplitude of the drive against the driving frequency,
    followed up and, pale, down; ticks: folds.
    """
    ax.set(yscale="log", ylabel="$|u_1|$ (drive = 1)")
    style.title(ax, style.ball_names(record.detector)[d])
    size = medium.built.drive_size * record.drive
    return along(ax, record, medium, np.abs(record.harmonic[:, :, d, 1]) / size)


def change(ax, record, medium):
    """How far the fundamental of the whole field differs from that of springs."""
    ax.set(yscale="log", ylabel="change of the field")
    return along(ax, record, medium, np.where(record.change > 0, record.change, np.nan))


def clapping(ax, record, medium):
    """Part of the contacts that open and close in each period."""
    drawn = along(ax, record, medium, record.clapping)
    ax.set(ylabel="part that claps", ylim=(0, max(1.05 * ax.dataLim.y1, 0.001)))
    return drawn


def along(ax, record, medium, values):
    """Draw values of states, shape (nw, na), against what was followed; return the curves."""
    x, drawn, swept = followed(ax, record, medium), [], record.follow == "frequency"
    names = [scales.frequency(each, medium) for each in record.omega / medium.omega_mx]
    names, shades = names if len(names) > 1 else [None], style.colours(len(names))
    if swept:
        unit = _length(scales.OPENING._replace(own=""), medium)
        drives = medium.built.drive_size * record.drive[0]
        names = [f"drive {scales.said(each, medium, unit)}" for each in drives]
        if record.unit == "overlap":
            names = [f"drive {each:g} overlaps" for each in record.amplitude]
        shades = np.repeat(style.colours(len(names) // 2), 2, axis=0)
    for n, (name, shade) in enumerate(zip(names, shades, strict=True)):
        look = {"color": shade, "label": name}
        if swept and record.direction[n] == "down":
            look |= DOWN | {"color": style.pale(shade)}
        index = (slice(None), n) if swept else n
        drawn += states(ax, record, index, x[index], values[index], **look)
    return drawn


def states(ax, record, index, x, y, label=None, **look):
    """Draw the states of a record at an index as a curve, which is returned; NaN: not drawn."""
    kept, unstable = np.isfinite(y) & record.reached[index], record.unstable[index]
    missed = kept & (record.converged_reason[index] <= 0)
    drawn = marks.curves(ax, x, y, kept, linestyle="--", **look)
    ax.plot(x, np.ma.masked_where(~kept | unstable, y), label=label, **look)
    hollow = {"markeredgecolor": look["color"], "markersize": 3, "zorder": 3}
    ax.plot(x[missed], y[missed], **style.RING | hollow)
    return drawn


def followed(ax, record, medium, index=...):
    """Return what was followed, shape (nw, na), as it is along x, where its marks are.

    These are folds, states that were not reached, and what opens the first contact.
    """
    swept, size = record.follow == "frequency", medium.built.drive_size
    unit, opening = 1 / medium.omega_mx if swept else size, size * record.opening[index][..., 0]
    x = unit * (record.omega[:, None] + 0 * record.drive if swept else record.drive)
    if swept:
        scales.frequencies(ax, x[:, 0])
    else:
        opening = opening[(opening > 0.1 * x.min()) & (opening < 10 * x.max())]
        ends = [*opening, x.min(), x.max()]
        ax.set(xscale="log", xlim=(min(ends) / 1.2, max(ends) * 1.2))
        scales.label(ax.xaxis, _length(scales.OPENING, medium))
        for each in opening:
            ax.axvline(each, color=style.MODE, linestyle=":", zorder=0.5, label="first opens")
    marks.failed(ax, np.unique(x[index][~record.reached[index]]), "not reached")
    folds = np.unique(record.fold[index][np.isfinite(record.fold[index])])
    if folds.size:
        marks.modes(ax, unit * folds, "folds")
    return x


def _length(quantity, medium):
    """Return a quantity, without a unit in SI where lengths of a medium have none."""
    known = are_lengths(medium.built, overlaps_of(medium.built))
    return quantity if known else quantity._replace(unit=None)


def claps(record, medium):
    """Return the figure of a network with the contacts that clap in the state with most of them."""
    at = np.unravel_index(np.nanargmax(record.clapping), record.clapping.shape)
    clapped, balls = record.contact[record.clapped[at] == 1], record.detector[:, 0]
    figure, view = network.page(medium, balls), View(medium, balls[0])
    (ax,), cut = figure.panels, view.seen[medium.bond].all(axis=1)
    view.seen[:] = True  # of others the projection
    segments, numbers = view.lines(medium.bond)
    look = {"colors": style.UNRESOLVED, "linewidths": 2.0, "zorder": 3}
    for part, alpha in ((clapped[cut[clapped]], 1.0), (clapped[~cut[clapped]], 0.4)):
        ax.add_collection(LineCollection(segments[np.isin(numbers, part)], alpha=alpha, **look))
    ax.plot([], [], color=style.UNRESOLVED, linewidth=2.0, label="clap")
    style.legend_above([ax])
    where = scales.frequency(record.omega[at[0]] / medium.omega_mx, medium)
    drive = scales.said(medium.built.drive_size * record.drive[at], medium, scales.OPENING)
    figure.caption += (
        f" Orange: {len(clapped)} of {len(record.contact)} contacts, which open and close in each "
        f"period at {where}, drive {drive}{', an unstable state' * bool(record.unstable[at])}"
        f"{'; pale: before or behind the plane' * bool(view.plane)}."
    )
    return figure
