"""The figures of normal modes: shapes, participation, density (paper: modepic)."""

import contextlib
import math
from dataclasses import replace
from functools import partial

import numpy as np

from pgran.draw import balls, captions, marks, scales, style
from pgran.errors import FileError, InputError
from pgran.experiments.modes import figures_density as counts
from pgran.experiments.modes.record import exactness
from pgran.store.estimate import counted

ASIDE = 0.02  # of an axis: room beside points
AROUND_MIDDLE = 0.05  # omega_mx: modes around the middle one that is pictured
MODES_OF_A_DENSITY = 20  # modes that have a density
WAVES, LARGEST = 1000, 1e10  # modes that take as long as waves do; work of some seconds
LEAST_PEAK = 1e-10  # of the largest peak: fainter ones are not drawn


def figures(result, **_):
    """Yield three shapes if they are stored, participation ratios, what detectors hear of modes,
    and the density of many modes; those at rest are left out.
    """
    lattice, made = result.medium, {}
    record = result.modes.moving(lattice.built)
    both = {"modes": record, "lattice": lattice}
    style.check_any(record.omega, "modes that move")
    if record.vector is not None and lattice.has_places:
        picked = pick(record.omega / lattice.omega_mx, record.participation)
        panels = [partial(shape, mode=mode, **both) for mode in picked]
        made["shapes"] = balls.motions(lattice, panels, style.caption_of(shape))
        work = (len(record.omega) + WAVES) * record.vector[0].size ** 2
        with contextlib.suppress(InputError):  # no waves fit
            if np.any(record.omega > 0) and work < LARGEST:
                made["speeds"] = style.single(speeds, **both)
    made["participation"] = style.single(participation, **both)
    if record.residue is not None and np.any(record.width):
        made["resonances"] = style.single(resonances, **both)
    if len(record.omega) >= MODES_OF_A_DENSITY and np.ptp(record.omega) > 0:
        level = counts.debye(lattice)
        made["density"] = style.single(density, level=level, **both)
        if counts.dimension(lattice) and np.any(record.omega > 0):
            bins = counts.log_bins(record.omega / lattice.omega_mx)
            made["reduced"] = style.single(counts.reduced, lattice=lattice, level=level, **bins)
    left = len(result.modes.omega) - len(record.omega)
    unstable = counted(np.count_nonzero(record.omega < 0), "unstable mode")
    for name, figure in made.items():
        figure.caption += f" Left out: {counted(left, 'mode')} at rest." * (left > 0)
        if np.any(record.omega < 0) and name in ("reduced", "speeds"):
            style.note(figure, f"NOT SHOWN: {unstable}")
        elif np.any(record.omega < 0):
            figure.caption += rf" At $\omega_i = -\sqrt{{-\omega_i^2}}$: {unstable}."
        note_missing(figure, record)
        yield name, figure


def note_missing(figure, record):
    """Say in a figure if modes are missing or inaccurate, in a record of modes or on modes."""
    if record.count_found != record.count_expected:
        style.note(figure, f"NOT ALL MODES: {record.count_found} of {record.count_expected} found")
    elif not record.count_certified:
        style.note(figure, "NOT CERTIFIED: some modes are inaccurate")


def errors(record, _):
    """Return how many modes were found, and whether their count certifies them."""
    words = f"{record.count_found} of {record.count_expected} normal modes"
    if not record.count_certified:
        return f"{words} were found; they are not certified."
    residual = getattr(record, "residual", ())  # a projection has none
    largest = f"; residuals at most {captions.number(residual.max())}" if len(residual) else ""
    return f"{words}, {exactness(record, captions.number)}{largest}."


def shape(ax, modes, lattice, mode):
    """Shapes of normal modes; $P_i$: how many balls take part.

    In units of the largest entry, as `balls.motion` draws displacements (paper: modepic). The
    lowest mode is number 0; the record has its `vector`.
    """
    values = lattice.built.displacements(modes.vector[mode])
    drawn, _, plane = balls.motion(ax, lattice, values)
    omega = scales.frequency(modes.omega[mode] / lattice.omega_mx, lattice)
    style.title(ax, omega, f"$P_i$ = {modes.participation[mode]:.3g} balls", plane)
    return drawn


def pick(x, participation):
    """Return the indices of the modes to picture, ascending, each once; all if there are three.

    The second lowest mode, one near .6 that is extended as the median of those around it, and the
    one nearest to 1 (paper: modepic). `x`: frequencies in units of omega_mx.
    """
    if len(x) <= 3:
        return list(range(len(x)))
    distance = np.abs(x - 0.6)
    near = np.flatnonzero(distance <= max(AROUND_MIDDLE, distance.min()))
    usual = np.median(participation[near])
    middle = near[np.abs(participation[near] - usual).argmin()]
    return sorted({1, int(middle), int(np.abs(x - 1.0).argmin())})


def speeds(ax, modes, lattice):
    r"""Speed $c_i = \omega_i/k_i$ of stable normal modes, $k_i$ that of the waves of which each is
    made most; broken: sound by statics, if it is known.
    """
    stable = modes.omega > 0
    modes = replace(modes, omega=modes.omega[stable], vector=modes.vector[stable])
    x, (k, branches, _) = modes.omega / lattice.omega_mx, modes.wave_numbers(lattice)
    known = counts.sound_of(lattice)
    for branch, colour in zip(np.unique(branches), style.COLOURS, strict=False):
        some = branches == branch
        ax.plot(x[some], x[some] / k[some], ".", label=branch, color=colour)
        if known is not None:
            speed = getattr(known, branch.replace("scalar", "longitudinal")).speed
            ax.axhline(speed / lattice.omega_mx, linestyle="--", color=colour)
    ax.set_yscale("log" if scales.wide(x / k) else "linear")
    scales.label(ax.yaxis, scales.MODE_SPEED)
    scales.frequencies(ax, x, scales.MODE_FREQUENCY, aside=ASIDE, log=scales.wide(x))
    return [line for line in ax.get_lines() if line.get_marker() == "."]


def participation(ax, modes, lattice, **look):
    """Participation ratio $P_i$ of each normal mode, about how many of the balls take part, against
    its frequency.
    """
    x = modes.omega / lattice.omega_mx
    look = {"marker": ".", "markeredgewidth": 0, "color": "black"} | look
    (points,) = ax.plot(x, modes.participation, linestyle="none", clip_on=False, **look)
    participation_axes(ax, x, lattice)
    return points


def participation_axes(ax, x, lattice):
    """Make axes those of participation ratios of modes at `x`, on the right of their shares."""
    scales.frequencies(ax, x, scales.MODE_FREQUENCY, aside=ASIDE, log=scales.wide(x))
    top = ax.get_ylim()[1] if ax.get_yscale() == "log" else 10  # of another result
    balls = lattice.free_balls
    ax.set(yscale="log", ylim=(0.8, max(1.25 * balls, top)))
    ax.set_ylabel("participation ratio $P_i$ (balls)")
    if not ax.child_axes:
        both = (lambda ratio: ratio / balls), (lambda share: share * balls)
        share = ax.secondary_yaxis("right", functions=both)
        share.set_ylabel(f"$P_i/N$, of $N$ = {balls} balls")


def resonances(ax, modes, lattice):
    """What the drive makes of each normal mode: $|A|$ of a detector at the mode's peak, if it stood
    alone, to first order in the damping.

    Peaks fainter than LEAST_PEAK of the largest are left out.
    """
    peaks = modes.peak
    good = np.isfinite(peaks) & (peaks > LEAST_PEAK * np.nanmax(peaks, initial=0.0))
    names = style.ball_names(modes.detector) if len(modes.detector) > 1 else None
    look = {"dots": True, "linestyle": "none", "clip_on": False}
    ax.set(yscale="log", ylabel="$|A|$ at the mode's peak (drive = 1)")
    x = modes.omega / lattice.omega_mx
    scales.frequencies(ax, x, scales.MODE_FREQUENCY, aside=ASIDE)
    return marks.curves(ax, x, peaks, good, names, **look)


def density(ax, modes, lattice, edges=None, level=None, **look):
    r"""Density of the normal modes per ball and $\omega_{mx}$; on linear axes its area is the share
    of the modes that are shown; bars: square roots of the counts.

    See `figures_density.histogram`.
    """
    x = modes.omega / lattice.omega_mx
    edges = bin_edges(x) if edges is None else edges
    return counts.histogram(ax, edges, np.histogram(x, edges)[0], lattice, level=level, **look)


def bin_edges(x, count=None):
    """Return the edges of about as many bins as there are modes in one, from end to end.

    Or for a `count` of modes. 0 is one of them where some are unstable; those of a `wide` range are
    at equal ratios.
    """
    count, low, high = count or np.count_nonzero(np.isfinite(x)), np.nanmin(x), np.nanmax(x)
    bins = min(60, max(4, round(math.sqrt(count))))
    if scales.wide((low, high)):
        return np.geomspace(low, high, bins // 2 + 1)
    if low >= 0 or high <= 0:
        return np.linspace(low, high, bins + 1)
    below = min(max(1, round(-low / (high - low) * bins)), bins - 1)
    ends = np.linspace(low, 0.0, below + 1), np.linspace(0.0, high, bins - below + 1)
    return np.append(ends[0][:-1], ends[1])


def over(results, looks):
    """Yield participation ratios, and both densities if each result has many modes."""
    if not all(hasattr(result, "modes") for result in results):
        raise FileError("of the scene modes normal modes alone are laid over each other")
    media = [result.medium for result in results]
    moving = [result.modes.moving(result.medium.built) for result in results]
    x = [modes.omega / medium.omega_mx for modes, medium in zip(moving, media, strict=True)]
    for each in x:
        style.check_any(each, "modes that move")
    several = list(zip(moving, media, looks, strict=True))

    def points(ax):
        size = {"markersize": 3, "markeredgewidth": 0.5, "fillstyle": "none"}
        for modes, medium, look in several:
            drawn = {"label": look.label, "marker": look.mark, "color": look.colour}
            participation(ax, modes, medium, **drawn, **size)
        if len({medium.free_balls for medium in media}) > 1:
            ax.child_axes[0].remove()

    def outlines(ax):
        edges = bin_edges(np.concatenate(x), max(map(len, x)))
        for modes, medium, look in several:
            density(ax, modes, medium, edges, **look.outline)

    def reductions(ax):
        edges = counts.log_bins(np.concatenate(x))["edges"]
        for each, (_, medium, look) in zip(x, several, strict=True):
            counts.reduced(ax, edges, np.histogram(each, edges)[0], medium, **look.outline)

    made = {participation: points}
    if min(map(len, x)) >= MODES_OF_A_DENSITY:
        made[density] = outlines
        axes = {*map(counts.dimension, media)}
        if len(axes) == 1 and 0 not in axes and min(map(np.max, x)) > 0:
            made[counts.reduced] = reductions
    missing = sum(not result.modes.count_certified for result in results)
    for panel, draw in made.items():
        page = style.single(draw, style.caption_of(panel))
        if panel is counts.reduced and min(map(np.min, x)) < 0:
            style.note(page, "NOT SHOWN: unstable modes")
        if missing:
            style.note(page, f"NOT CERTIFIED: modes of {missing} of {len(results)} results")
        yield panel.__name__, page
