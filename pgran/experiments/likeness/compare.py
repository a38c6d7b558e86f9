"""How alike two signals are in a window, and how far one is stretched or shifted against the other.

x_a and x_b are vectors of equal steps of t, <x, y> = Re sum conj(x) y; y is x_b moved by e:

    CC(e) = <x_a, y> / (|x_a| |y|),    y(t) = x_b(t (1 + e)), x_b(t / (1 + e)) or x_b(t + e).

Errors suppose x_b = X x_a + sqrt(1 - X^2) n, n of the spectrum of x_a but independent of it; p is
this power spectrum, of sum 1, q that of z, the part of dx_a/de across x_a (`pgran manual
comparing` has where they come from):

    var e = (1 - X^2) / X^2 <(n, z)^2> / |z|^4,    var CC = (1 - X^2)^2 <(n, x_a)^2>,
    <(n, z)^2> = sum_k p_k q_(k+1),    half of that for complex signals.
"""

import math
import os
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pgran.arguments import called_right
from pgran.errors import FileError, InputError, log
from pgran.experiments.likeness.record import Likeness
from pgran.medium.differences import labels_of
from pgran.medium.network_file import load
from pgran.run.numbers import number, windows_of
from pgran.store.estimate import Estimate, counted, with_errors
from pgran.store.record import Record, Result, ball_names

TRIALS = 8, 400  # of moves of either sign, at least and at most
ROUNDING = 1e-13  # of the reach
UNLIKE = 3.5  # errors of artanh CC within which strangers are: no move is known
WIDER = 6  # times as far as asked, where B has been heard, no move may be better
MOVES = {  # where x_b is read, and the derivative of that by e; a stretch makes all in B faster
    "response": {
        "stretch": lambda t, e: (t * (1 + e), t),
        "shift": lambda t, e: (t + e, np.ones_like(t)),
    },
    "pulse": {"stretch": lambda t, e: (t / (1 + e), -t / (1 + e) ** 2)},
}
LOWEST, WIDTH = 0.1, 0.15  # of omega_mx: where windows of responses begin, about how wide they are
WINDOWS = 6  # of a coda
REST = 1e-3  # of its largest: how far from its last place a wall that rests may be
COARSE = 0.1  # of a signal's size: an error that hides it
FEWEST = 8  # points of a window
STEPS = 256, 8192  # of a window, at least and at most
INSIDE = np.linspace(0, 1, 18)[1:-1, None]  # of an interval, where its model is evaluated


@called_right
def compare(
    a: str | os.PathLike | Result | Record,
    b: str | os.PathLike | Result | Record,
    windows: "ArrayLike | None" = None,
    stretch: float = 0.02,
) -> Likeness:
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

    Examples
    --------
    >>> soft, stiff = (pgran.Lattice.random((6, 5), seed=1, kmax=k) for k in (0.25, 0.2525))
    >>> omega = [0.05 + 0.004 * n for n in range(300)]
    >>> curves = [pgran.sweep(lattice, omega, [(2, 2)]) for lattice in (soft, stiff)]
    >>> found = pgran.compare(*curves, windows=[0.2, 0.4, 0.4, 0.6])
    >>> found.stretch[:, 0, 0].round(3).tolist()  # by 1 % of all springs
    [0.005, 0.005]
    """
    stretch = number("-stretch", stretch)
    if not 0 < stretch < 0.5:
        raise InputError(f"-stretch: a number between 0 and .5 is needed, not {stretch:g}")
    (one, file_a), (other, file_b) = _opened(a, "A"), _opened(b, "B")
    results = one, other
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
    labels = file_a, file_b
    if all(hasattr(result, "options") for result in results):
        labels = labels_of(results, labels)
    shape = len(windows), len(balls[0]), len(signals)
    found = [
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
        **{name: np.reshape([each[name] for each in found], shape) for name in found[0]},
    )


def _opened(given, name):
    """Return a result that was given, or is in a file, and what to call it."""
    if isinstance(given, (str, os.PathLike)):
        return load(given), Path(given).name
    return Result([given], scene=given.group) if isinstance(given, Record) else given, name


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


class Pair:
    """Two signals, SciPy's splines, at the equal steps `time` of a window.

    Complex ones over the exponential of the straight line through ln|x_a|, so that no end rules;
    with `logarithm` ln|x|, less its line.
    """

    def __init__(self, a, b, time, logarithm=False):
        self.b, self.time, self.logarithm, self.weight = b, time, logarithm, 1.0
        line = np.stack([np.ones_like(time), time - time.mean()])[: 2 * logarithm]
        self.line = line / np.linalg.norm(line, axis=1, keepdims=True)
        self.raw = self.read(a, time)
        if np.iscomplexobj(self.raw[0]):
            fall, level = np.polyfit(time, np.log(np.abs(self.raw[0])), 1)
            self.weight = np.exp(-level - fall * time)
            self.raw = self.read(a, time)
        self.x, _ = self.unit(*self.raw)
        self.alone = self.noise(self.x)  # 1 / N, N the independent numbers in the window

    def read(self, signal, time):
        """Return a signal at some times, and its derivative."""
        x, slope = signal(time), signal(time, 1)
        if self.logarithm:
            return np.log(np.abs(x)), (slope / x).real
        return self.weight * x, self.weight * slope

    def unit(self, x, slope):
        """Return x without its line as a vector of length 1, and the derivative of that vector."""
        x, slope = (each - self.line.T @ (self.line @ each) for each in (x, slope))
        x, slope = x / np.linalg.norm(x), slope / np.linalg.norm(x)
        return x, slope - np.vdot(x, slope).real * x

    def moved(self, move, e):
        """Return x_b, moved by e, as a vector of length 1, and its derivative by e."""
        time, rate = move(self.time, e)
        y, slope = self.read(self.b, time)
        return self.unit(y, rate * slope)

    def in_part(self, move, e):
        """Return CC(e) over what x_b is known of, 0 of less than half the window."""
        time, (first, *_, last) = move(self.time, e)[0], self.b.x
        known = (first <= time) & (time <= last)
        y, _ = self.unit(*self.read(self.b, np.clip(np.nan_to_num(time), first, last)))
        size = np.linalg.norm(self.x[known]) * np.linalg.norm(y[known])
        return np.vdot(self.x[known], y[known]).real / size if 2 * known.sum() > len(time) else 0.0

    def noise(self, z):
        """Return <(n, z)^2>; neighbours of a periodogram are independent, <p_k^2> = 2 <p_k>^2."""
        p, q = (np.abs(np.fft.fft(each)) ** 2 / len(self.time) for each in (self.x, z))
        return p @ np.roll(q, 1) / (2 if np.iscomplexobj(z) else 1)

    def correlation(self, move=MOVES["pulse"]["stretch"], e=0.0):
        """Return CC(e), an Estimate; its error to first order in 1/N."""
        less = 0.5 * np.linalg.norm(self.x - self.moved(move, e)[0]) ** 2  # 1 - CC, not cancelled
        return Estimate(1 - less, less * (2 - less) * math.sqrt(self.alone * (1 + 2 * self.alone)))

    def best(self, move, reach):
        """Return the move of the largest correlation, at most `reach`, an Estimate, and that one.

        NaN where signals are too little alike, with an infinite error if it is at an end or beyond.
        """
        from scipy.optimize import brentq  # here: SciPy takes its time

        z = self.unit(self.raw[0], move(self.time, 0.0)[1] * self.raw[1])[1]
        steepness = np.linalg.norm(z)  # of x_a with itself 1 - CC is (steepness e)^2 / 2
        trials = np.linspace(-reach, reach, 2 * int(np.clip(2 * reach * steepness, *TRIALS)) + 1)
        found = [[np.vdot(self.x, y).real for y in self.moved(move, e)] for e in trials]
        values, slopes = np.transpose(found)
        top, least = values.argmax(), math.tanh(UNLIKE * math.sqrt(self.alone))
        others = np.linspace(1, WIDER, (WIDER - 1) * len(trials) // 2)  # as dense as these
        with np.errstate(all="ignore"):
            beyond = max(self.in_part(move, e) for e in np.outer([-reach, reach], others).flat)
        if top in (0, len(trials) - 1) or beyond > max(values[top], least):
            return Estimate(math.nan, math.inf), float(values[top])

        def slope(e):
            return np.vdot(self.x, self.moved(move, e)[1]).real

        near, far = trials[top], trials[top + (1 if slopes[top] > 0 else -1)]
        while slope(far) * slopes[top] > 0 and abs(far - near) > ROUNDING * reach:
            far = 0.5 * (near + far)  # where deep minima of ln|x| meet the top is a cusp
        crossed = slope(far) * slopes[top] <= 0
        e = brentq(slope, near, far, xtol=ROUNDING * reach) if crossed else near
        there = self.correlation(move, e).value
        if there < least:
            return Estimate(math.nan, math.nan), there
        less = (1 / there**2 - 1) * (1 + 4 * self.alone)
        return Estimate(float(e), math.sqrt(max(less, 0.0) * self.noise(z)) / steepness**2), there
