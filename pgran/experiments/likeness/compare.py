"""The likeness of two results: their signals, the windows that both have, and what is measured."""

import logging
import math
import os
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pgran.arguments import called_right
from pgran.errors import FileError, InputError
from pgran.experiments.likeness.record import Likeness
from pgran.experiments.likeness.stretching import MOVES, Pair
from pgran.medium.labels import labels_of
from pgran.medium.network_file import load
from pgran.run.numbers import number, windows_of
from pgran.store.estimate import counted, with_errors
from pgran.store.fields import ball_names
from pgran.store.record import Record, Result

log = logging.getLogger("pgran")

LOWEST, WIDTH = 0.1, 0.15  # of omega_mx: where windows of responses begin, about how wide they are
WINDOWS = 6  # of a coda
REST = 1e-3  # of its largest: how far from its last place a wall that rests may be
COARSE = 0.1  # of a signal's size: an error that hides it
FEWEST = 8  # points of a window
STEPS = 256, 8192  # of a window, at least and at most
INSIDE = np.linspace(0, 1, 18)[1:-1, None]  # of an interval, where its model is evaluated


class Side(NamedTuple):
    """Signals of shape (n, nd) at omega, or at the time from the middle, `origin`, of the drive.

    `good` are those whose errors are small; by default windows begin no sooner than at `begin`.
    """

    time: np.ndarray
    values: np.ndarray
    slopes: np.ndarray
    good: np.ndarray
    origin: float
    begin: float


def _response(response, unit):
    """Return amplitudes, by models as well where there are some."""
    if response.derivative is None:
        raise FileError("compare: a response of this age has no derivatives; run it again")
    parts, models = [response], response.models
    if models is not None:
        parts.append(response.at((models.low + (models.high - models.low) * INSIDE).ravel()))
    elif response.unresolved.any():
        log.warning("a curve is not resolved between its points; -sweep_resolve adds some")
    names = "omega", "displacement", "derivative", "error_bound"
    omega, *rest = (np.concatenate([getattr(part, name) for part in parts]) for name in names)
    omega, order = np.unique(omega, return_index=True)
    A, slopes, error = (column[order] for column in rest)
    return Side(omega, A, slopes, _good(A, error), 0.0, LOWEST * unit)


def _pulse(signals, unit):
    """Return displacements."""
    time, wall = signals.time, signals.wall
    power = np.gradient(wall, time) ** 2
    middle = power @ time / power.sum()
    moving = time[np.abs(wall - wall[-1]) > REST * np.abs(wall).max()]
    good = _good(signals.envelope, signals.error)
    begin = moving.max() - middle
    return Side(time - middle, signals.displacement, signals.velocity, good, middle, begin)


def _good(size, error):
    """Return where sizes are numbers above 0, and errors small parts of them."""
    with np.errstate(invalid="ignore"):
        return (error <= COARSE * np.abs(size)) & (np.abs(size) > 0)


KINDS = {"response": (_response, ("ln|A|", "A")), "pulse": (_pulse, ("u",))}


@called_right
def compare(a, b, windows=None, stretch=0.02):
    """Measure how alike two response curves or two codas are, and how much faster one is.

    Coda wave interferometry (Snieder, Gret, Douma and Scales, Science 295, 2253 (2002)), and the
    same of response curves. The two may differ in anything.

    Parameters
    ----------
    a, b : pgran.store.record.Result, str or os.PathLike, or pgran.results.Response, or Signals
        What `load` returns, or the path of its file, or what `sweep` or `pulse` returns: two
        responses or two pulses, heard at as many balls each.
    windows : array_like of float, shape (n, 2), optional
        Lowest and highest angular frequency, or time, of each. By default equal ones, .15 omega_mx
        wide or so from .1 omega_mx on (of records alone, whose omega_mx is not known, six), or six
        from the end of the wall's motion on.
    stretch : float
        Largest relative change of frequencies or speeds that is tried.

    Returns
    -------
    pgran.results.Likeness

    Raises
    ------
    FileError
        If a file cannot be read, or the two are not of one kind, or not heard at as many balls.
    InputError
        If a window is outside of what both have, or has too few points.
    """
    stretch = number("-stretch", stretch)
    if not 0 < stretch < 0.5:
        raise InputError(f"-stretch: a number between 0 and .5 is needed, not {stretch:g}")
    is_path = [isinstance(each, (str, os.PathLike)) for each in (a, b)]
    results = [load(x) if path else x for x, path in zip((a, b), is_path, strict=True)]
    results = [Result([x], scene=x.group) if isinstance(x, Record) else x for x in results]
    files = [Path(x).name if p else n for x, p, n in zip((a, b), is_path, "AB", strict=True)]
    kind = next((k for k in KINDS if all(hasattr(result, k) for result in results)), None)
    if kind is None:
        scenes = " and ".join(str(getattr(result, "scene", "network")) for result in results)
        raise FileError(f"compare: two responses or two pulses are needed, not {scenes}")
    read, signals = KINDS[kind]
    unit = next((x.medium.omega_mx for x in results if hasattr(x, "medium")), 0.0)
    records = [getattr(result, kind) for result in results]
    balls = [ball_names(record.detector) for record in records]
    if len(balls[0]) != len(balls[1]):
        raise FileError(
            "compare: A is heard at {}, B at {}".format(*(counted(len(b), "ball") for b in balls))
        )
    if balls[0] != balls[1]:
        log.info("A is heard at %s, B at %s", *(", ".join(each) for each in balls))
    sides = [read(record, unit) for record in records]
    windows = _windows(sides, windows, stretch, WIDTH * unit if kind == "response" else None)
    labels = labels_of(results, files) if all(hasattr(r, "options") for r in results) else files
    shape = len(windows), len(balls[0]), len(signals)
    told = [
        _measure(sides, windows[w], d, signals[n], kind, stretch) for w, d, n in np.ndindex(shape)
    ]
    return Likeness(
        of=kind,
        label_a=labels[0],
        label_b=labels[1],
        omega_mx=unit or math.nan,
        reach=stretch,
        signal=np.array(signals),
        detector=records[0].detector,
        low=windows[:, 0] + sides[0].origin,
        high=windows[:, 1] + sides[0].origin,
        **{name: np.reshape([each[name] for each in told], shape) for name in told[0]},
    )


def _windows(sides, wanted, reach, width):
    """Return the windows that are wanted, or those of about a `width`; None: of a coda."""
    known = [side.time[side.good.all(axis=1)] for side in sides]
    for times, name in zip(known, "AB", strict=True):
        if not times.size:
            raise FileError(f"compare: {name} is nowhere larger than its errors at all its balls")
    (a, b), origin = known, sides[0].origin
    low, high = max(a[0], b[0] / (1 - reach), 0.0), min(a[-1], b[-1] * (1 - reach))
    if not low < high:
        both = f"{a[0]:g} to {a[-1]:g} and {b[0]:g} to {b[-1]:g}"
        raise InputError(f"compare: {both} have nothing in common with room for -stretch {reach:g}")
    if wanted is not None:
        within = low + origin, high + origin
        kind = "times" if width is None else "angular frequencies"
        both = f"the {kind} that both have, stretched too"
        return windows_of("-windows", wanted, within, both) - origin
    begin = max(low, *(side.begin for side in sides))
    if begin >= high and width is None:
        raise InputError("compare: the wall moves until the end; listen longer, or give -windows")
    begin = begin if begin < high else low
    count = max(1, round((high - begin) / width)) if width else WINDOWS
    edges = np.linspace(begin, high, count + 1)
    return np.stack([edges[:-1], edges[1:]], axis=1)


def _measure(sides, window, d, signal, kind, reach):
    """Return what a record has of a signal in a window at detector d; say what is left out."""
    from scipy.interpolate import CubicHermiteSpline  # here: SciPy takes its time

    (low, high), splines, steps = window, [], [STEPS[0]]
    where = "{:g} to {:g}".format(*(window + sides[0].origin))
    for side, name in zip(sides, "AB", strict=True):
        good, inside = side.good[:, d], (low <= side.time) & (side.time <= high)
        points, left = np.count_nonzero(inside & good), np.count_nonzero(inside & ~good)
        if points < FEWEST:
            raise InputError(
                f"-windows: {where} holds {counted(points, 'good point')} of {name}, and needs "
                f"{FEWEST}: a wider window, or a result of more points"
            )
        if left:
            log.warning("%s: errors hide %s of %s", where, counted(left, "point"), name)
        arrays = side.time, side.values[:, d], side.slopes[:, d]
        splines.append(CubicHermiteSpline(*(x[good] for x in arrays)))
        steps.append(2 * points)
    pair = Pair(*splines, np.linspace(low, high, min(max(steps), STEPS[1])), signal == "ln|A|")
    reaches = {"stretch": reach, "shift": reach * low}
    best = {name: pair.best(move, reaches[name]) for name, move in MOVES[kind].items()}
    moves = {name: move for name, (move, _) in best.items()}
    if any(np.isinf(move.error) for move in moves.values()):
        log.warning("the best is at the end of what -stretch %g tries, or beyond, somewhere", reach)
    return with_errors(correlation=pair.correlation(), **moves) | {"stretched": best["stretch"][1]}
