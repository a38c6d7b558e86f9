"""The curve of a response: intervals of frequencies, each a proven model, and a resolved curve.

A curve is resolved where straight lines between its points are right. With the derivatives at both
ends the amplitude between two neighbours is a cubic (Hermite's). Where that cubic leaves the
straight line between them, the line is wrong; where it does so by a large part of the amplitude,
the phase may have turned unseen. A resonance much narrower than the distance hides from the cubic;
what rules it out is a proven model, that no mode is near, or that all poles are too far from the
real axis. Nothing here loads PETSc before a task begins.
"""

import contextlib
from functools import partial

import numpy as np

from pgran.errors import InputError
from pgran.experiments.response.models import evaluate, moments_of, point_dtype
from pgran.experiments.response.record import Models, model_dtype
from pgran.medium.base import EPSILON
from pgran.run.agreement import on_root
from pgran.run.machine import check_memory
from pgran.run.task import Task, carry_out
from pgran.store.record import columns_of

# Intervals that a unit of work is expected to need; it begins with a factorization of its own.
UNIT_INTERVALS, MAX_UNITS = 22, 64
# A curve pays where so many frequencies are asked for in each interval that it is expected to need;
# where none are added to resolve it, it gives no more than points, and must be faster by itself.
PAYS, PAYS_ALONE = 4, 20
FEW_POINTS = 8  # frequencies in an interval: where fewer are asked for, others are looked at, too
STORED_BYTES = 2**24  # of models that are stored unasked
COMPARED_PLACES = 0.25, 0.5, 0.75  # between neighbours, of the cubic with the line
AIMED_SHARE = 0.8  # aim at this part of the deviation allowed, which the cubic only estimates
DOUBTFUL_SHARE = 0.3  # of that part: where the cubic says more, the line is looked at once more
DENSE_UNKNOWNS = 1000  # unknowns, of which all normal frequencies are found in a tenth of a second
MAX_ADDED = 7  # frequencies between two neighbours in one pass
RESOLVING_PASSES = 40
LARGEST_DEVIATION = 0.5  # of the amplitude: lines further off than that are wrong for any use


def choose_method(method, lattice, omegas, tolerance, fields, kept=False):
    """Return `points` or `curve`: what is asked for, or predicted to be cheaper."""
    if method in ("points", "moments"):
        if fields and method == "moments":
            raise InputError("-sweep_method moments: no whole fields; take points")
        for key, asked in (("sweep_resolve", tolerance), ("output_models", kept)):
            if asked:
                raise InputError(f"-{key}: needs models; -sweep_method curve makes them")
        return method
    why_not = _why_no_curve(lattice, omegas, fields)
    if method == "curve" or tolerance or kept:
        forced = "sweep_resolve" if tolerance else "output_models"
        key = "sweep_method curve" if method == "curve" else forced
        if why_not:
            raise InputError(f"-{key}: {why_not}; -sweep_method points does without")
        return "curve"
    if why_not:
        return "points"
    _, counts = expected_intervals(lattice, omegas[0], omegas[-1])
    pays = PAYS_ALONE if tolerance == 0 else PAYS
    return "curve" if len(omegas) >= pays * max(counts[-1], FEW_POINTS) else "points"


def _why_no_curve(lattice, omegas, fields):
    """Return in words what makes models impossible, or None."""
    from pgran.driven.counting import smallest_damping, smallest_loss
    from pgran.driven.linear import is_factored

    if not lattice.dissipates:
        return "without damping the curve has poles, and nothing bounds it between frequencies"
    if not lattice.isotropic and smallest_damping(lattice) == smallest_loss(lattice) == 0:
        return "what damps leaves some motions undamped, and bounds S^-1 at no whole interval"
    if fields:
        return "whole fields (-output_fields) belong to frequencies solved for one by one"
    if not is_factored():
        return "models are made with a factorization (-steady_pc_type cholesky or lu)"
    return "a curve needs two frequencies or more" if len(omegas) < 2 else None


def interval_length(lattice, omega):
    """Return about how long an interval is at some frequencies, which is where a march begins.

    Where modes overlap it follows their width, beta / m near the bottom and about four times that
    at omega_mx; where they do not, an interval holds some five modes. Measured on lattices of 1 to
    3 axes, 200 to 40,000 balls.
    """
    unit = lattice.omega_mx
    overlapping = lattice.damping / lattice.mass * (1 + 3 * np.asarray(omega) / unit)
    if lattice.drags is not None:
        overlapping = overlapping + np.mean(lattice.drags)
    if lattice.losses is not None:
        overlapping = overlapping + np.mean(lattice.loss) * np.asarray(omega)
    return np.maximum(overlapping, 5 * unit / lattice.size)


def expected_intervals(lattice, low, high):
    """Return frequencies of a sweep, and how many intervals are expected to end below each."""
    omega = np.linspace(low, high, 1001)
    density = 1 / interval_length(lattice, omega)
    steps = 0.5 * (density[1:] + density[:-1]) * np.diff(omega)
    return omega, np.append(0.0, np.cumsum(steps))


def solve_curve(task, crew, tolerance, keep_models, progress):
    """Return the points of the curve, and the record of its models if they are kept, on rank 0.

    Collective. Where no model is proven the frequencies asked for are solved for one by one by the
    `task`, a ResponseSweep, and so are points of the curve that a proven model misses, as where the
    amplitude almost vanishes. Models are kept by default, None, where they are few.
    """
    intervals = IntervalSweep(task.scaled, task.omegas, task.sites, task.choices["error_tolerance"])
    if tolerance:  # measured: so many points at most
        check_memory("sweep_resolve", intervals.counts[-1] / tolerance**0.5 * task.row.itemsize)
    models = crew.world.bcast(carry_out(intervals, crew, progress))
    if crew.dry:
        models["proven"] = 1
        points = np.zeros(len(task.omegas), task.row)
    else:
        points = _rows(task, models, intervals.limits, crew, tolerance, progress)
    if crew.world.rank > 0:
        return None, None
    points["factorizations"][:1] += models["factorizations"].sum()
    # how much of the sweep below each frequency no proven model covers
    lengths = np.where(models["proven"], 0.0, models["high"] - models["low"])
    ends = np.append(models["low"][:1], models["high"])
    unproven = np.interp(points["omega"], ends, np.append(0.0, np.cumsum(lengths)))
    points["modelled"][1:] = np.diff(unproven) == 0
    if keep_models or (keep_models is None and models.nbytes <= STORED_BYTES):
        proven = columns_of(Models, models[models["proven"] > 0])
        return points, Models(**vars(intervals.limits), **proven)
    return points, None


def _rows(task, models, limits, crew, tolerance, progress):
    """Return rows of the task by proven models, and others one by one, on rank 0. Collective."""
    from pgran.run.petsc import logged

    points = logged("models")(carry_out)(CurvePoints(models, limits, task.omegas, tolerance), crew)
    rows = None if points is None else task.accurate(points)

    def missing():
        return np.setdiff1d(np.union1d(task.omegas, points["omega"]), rows["omega"])

    others = on_root(crew.world, missing)
    if len(others):
        solved = carry_out(task.at(others), crew, progress)
        if crew.world.rank == 0:
            rows = np.concatenate([rows, solved])
            rows = rows[np.argsort(rows["omega"], kind="stable")]
    return rows


class IntervalSweep(Task):
    """Models of the response of a lattice, in its own unit, to a relative `tolerance`."""

    items = "intervals"

    def __init__(self, lattice, omegas, sites, tolerance):
        self.lattice, self.sites, self.tolerance = lattice, sites, tolerance
        width = min(2 * moments_of(lattice), lattice.size)
        self.row = model_dtype(width, len(sites), lattice.size)
        self.frequencies, self.counts = expected_intervals(lattice, omegas[0], omegas[-1])
        total = self.counts[-1]
        check_memory("sweep_method", int(total) * self.row.itemsize)
        # An even number, and some at least, so that few ranks have equal shares: towards the ends
        # of a sweep, where the curve is smooth, intervals are longer than is expected.
        units = max(2 * round(total / (2 * UNIT_INTERVALS)), min(6, int(total / 8)))
        units = min(max(units, 1), MAX_UNITS)
        ends = np.interp(np.linspace(0, total, units + 1), self.counts, self.frequencies)
        ends[[0, -1]] = omegas[[0, -1]]
        self.units = list(zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True))

    @contextlib.contextmanager
    def open(self, group):
        """See `Task`."""
        from pgran.driven.operators import Operators
        from pgran.experiments.response.intervals import IntervalModels

        length = partial(interval_length, self.lattice)
        with (
            Operators(self.lattice, group) as operators,
            IntervalModels(operators, self.sites, self.tolerance, length) as models,
        ):
            self.limits = models.limits
            yield lambda unit: np.concatenate(list(models.cover(*unit)))

    def length(self, unit):
        """See `Task`: as many as are expected."""
        low, high = np.interp(unit, self.frequencies, self.counts)
        return max(1, round(high - low))

    def sample(self, unit):
        """See `Task`."""
        low, high = unit
        return low, low + 0.2 * (high - low)


class CurvePoints(Task):
    """The curve at the frequencies asked for, and at those that resolve it.

    Straight lines between neighbours are to be right to the relative `tolerance`; 0 adds none.
    """

    items = "intervals"

    def __init__(self, models, limits, omegas, tolerance):
        self.models, self.limits, self.omegas, self.tolerance = models, limits, omegas, tolerance
        self.row = point_dtype(models["reading"].shape[1])
        self.units = np.flatnonzero(models["proven"]).tolist()

    def work(self, unit, group):
        """Return the points of one interval, without its upper end if another one follows."""
        model = self.models[unit]
        low, high = model["low"], model["high"]
        follows = unit + 1 < len(self.models) and self.models["proven"][unit + 1]
        first = np.searchsorted(self.omegas, low)
        last = np.searchsorted(self.omegas, high, "left" if follows else "right")
        asked = self.omegas[first:last]
        if not self.tolerance:
            return evaluate(model, asked, self.limits)
        between = np.linspace(low, high, FEW_POINTS + 1 if len(asked) < FEW_POINTS else 2)
        above = model["poles"][np.isfinite(model["poles"])]
        start = np.unique(np.concatenate([asked, between, above]))
        points = resolve(partial(evaluate, model, limits=self.limits), start, self.tolerance)
        return points[:-1] if follows else points


def resolve(evaluate, omegas, tolerance):
    """Return a curve so close that straight lines are right to a part of the amplitude.

    `evaluate` takes frequencies, and whether `derivatives` are wanted, and returns points, as
    `models.evaluate` does; `omegas`, ascending, are those to begin with.
    """
    points = evaluate(omegas)
    for _ in range(RESOLVING_PASSES):
        omega = points["omega"]
        missed = deviation(omega, points["displacement"], points["derivative"]).max(axis=1)
        missed /= AIMED_SHARE * tolerance
        missed[(np.diff(omega) <= 1e-12 * omega[1:]) | ~np.isfinite(missed)] = 0.0
        # the deviation falls with the square of the distance
        count = np.clip(np.ceil(np.sqrt(missed)) - 1, 0, MAX_ADDED).astype(int)
        if not count.any():
            count = _astray(evaluate, points, missed > DOUBTFUL_SHARE, tolerance).astype(int)
        if not count.any():
            break
        # count[i] frequencies cut line i into equal parts
        part = np.concatenate([np.arange(1, n + 1) / (n + 1) for n in count])
        start, width = (np.repeat(x, count) for x in (omega[:-1], np.diff(omega)))
        points = np.concatenate([points, evaluate(start + part * width)])
        points = points[np.argsort(points["omega"], kind="stable")]
    return points


def _astray(evaluate, points, doubtful, tolerance):
    """Return which doubtful lines miss the curve halfway, though the cubic does not say so."""
    before, after = points[:-1][doubtful], points[1:][doubtful]
    half = evaluate(0.5 * (before["omega"] + after["omega"]), derivatives=False)["displacement"]
    with np.errstate(all="ignore"):
        missed = np.abs(half - 0.5 * (before["displacement"] + after["displacement"]))
    astray = np.zeros(len(doubtful), dtype=bool)
    astray[doubtful] = np.any(missed > tolerance * np.abs(half), axis=1)
    return astray


def deviation(omega, amplitude, derivative):
    """Return how far the curve leaves straight lines between neighbours, relative to itself.

    Of amplitudes and derivatives, complex, of the shape (n, nd), at `omega` (n,). Between two
    neighbours, at the part t of their distance h, the cubic leaves its chord c by

        t (1 - t) ((1 - t) (h A'_below - c) - t (h A'_above - c)).

    What is returned has the shape (n - 1, nd), and is infinite where an end is unknown.
    """
    with np.errstate(all="ignore"):
        chord = np.diff(amplitude, axis=0)
        width = np.diff(omega)[:, None]
        below, above = width * derivative[:-1] - chord, width * derivative[1:] - chord
        # besides, where the line is nearest to zero
        nearest = np.where(chord == 0, 0.5, np.clip((-amplitude[:-1] / chord).real, 0, 1))
        t = np.stack(np.broadcast_arrays(*COMPARED_PLACES, nearest))
        bend = t * (1 - t) * ((1 - t) * below - t * above)
        relative = np.abs(bend) / np.abs(amplitude[:-1] + t * chord + bend)
    return np.where(np.isfinite(relative), relative, np.inf).max(axis=0)


def line_errors(medium, omega, amplitude, derivative, modelled, tolerance):
    """Return how far the curve may leave straight lines between neighbours, relative to itself.

    Where no proven model was compared with a line, `modelled` (n - 1,), the `deviation`, which the
    cubic only estimates, is raised by 1 / `AIMED_SHARE`, and by what it would miss of a resonance
    between the neighbours. The medium is in its own unit; its normal frequencies are looked for
    only if a line's meeting the `tolerance` hangs on them.
    """
    seen = deviation(omega, amplitude, derivative)
    hides = np.where(modelled, 1.0, hidden_part(omega, medium.relaxation_rate) / AIMED_SHARE)
    with np.errstate(invalid="ignore"):
        doubtful = (seen <= LARGEST_DEVIATION) & (seen * hides[:, None] > tolerance)
    if doubtful.any() and medium.size <= DENSE_UNKNOWNS:
        # which lines have no mode between their ends, nor as near as these are to each other
        lowest, highest = normal_frequencies(medium)
        width = np.diff(omega)
        begun = np.searchsorted(lowest, omega[1:] + width, side="right")
        clear = begun <= np.searchsorted(highest, omega[:-1] - width)
        hides[clear & ~modelled] = 1 / AIMED_SHARE
    with np.errstate(invalid="ignore"):  # 0 times infinity
        return np.where(np.isinf(hides)[:, None], np.inf, seen * hides[:, None])


def hidden_part(omega, relaxation_rate):
    """Return by what factor a resonance between neighbours exceeds what the cubic shows of it.

    A damped mode x, S(s) x = 0, has |s|^2 = x^H K x / x^H M x and -2 Re s = x^H C x / x^H M x, and
    x^H K x <= q x^H C x, q being the largest k / beta of a spring, the `relaxation_rate`; infinite
    if one has no dashpot. So all poles lie in the disc |s + q| <= q, and none is nearer to i omega
    than

        h = sqrt(q^2 + omega^2) - q.

    Of a pole at the distance h, halfway between neighbours d apart, the cubic shows a deviation
    that is too small by the factor 1 + (d / 2 h)^2; at other places it shows more.
    """
    low, q = omega[:-1], relaxation_rate
    with np.errstate(all="ignore"):
        # 1 / h = (sqrt(q^2 + omega^2) + q) / omega^2, which cancels nothing
        return 1 + (np.diff(omega) * (np.hypot(q, low) + q) / (2 * low**2)) ** 2


def normal_frequencies(medium):
    """Return ascending bounds of each normal frequency, by dense K; an unstable mode is at 0."""
    units = np.eye(medium.size).reshape(-1, *medium.shape)
    values = np.linalg.eigvalsh(medium.restoring_forces(units).reshape(-1, medium.size))
    error = 4 * len(values) * EPSILON * medium.stiffness_norm
    return tuple(np.sqrt(np.maximum(values + e, 0.0) / medium.mass) for e in (-error, error))
