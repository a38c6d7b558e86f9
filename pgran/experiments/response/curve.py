"""The curve of a response: intervals of frequencies, each a proven model, and its points."""

import contextlib
import dataclasses
from functools import partial

import numpy as np

from pgran.errors import InputError
from pgran.experiments.response.models import ARRAYS, MOMENTS, evaluate, model_dtype, point_dtype
from pgran.experiments.response.record import Models
from pgran.experiments.response.resolution import expected_intervals, interval_length, resolve
from pgran.run.machine import check_memory
from pgran.run.task import Task, carry_out

# Intervals that a unit of work is expected to need; it begins with a factorization of its own.
UNIT = 22
MOST_UNITS = 64
# A curve pays where so many frequencies are asked for in each interval that it is expected to need.
PAYS = 4
ALONE = 20  # the same where no others are wanted, which points would not give: only time counts
FEW_BYTES = 2**24  # of models that are few
FEW = 8  # frequencies in an interval: with fewer asked for, others are looked at as well


def choose_method(method, lattice, omegas, resolve, fields):
    """Return `points` or `curve`: what is asked for, or what is predicted to be cheaper.

    Not collective.

    Parameters
    ----------
    method : str
        `points`, `curve` or `auto`.
    lattice : pgran.medium.lattice.Lattice
        In its own unit.
    omegas : numpy.ndarray
    resolve : float or None
        What straight lines are asked to be right to.
    fields : bool
        Whether whole fields are wanted.

    Raises
    ------
    InputError
        If a curve is asked for where none can be had.
    """
    from pgran.driven.linear import is_factored

    reasons = {
        "without damping the curve has poles, and nothing bounds it between frequencies": (
            lattice.damping == 0
        ),
        "whole fields (-output_fields) belong to frequencies solved for one by one": fields,
        "models are made with a factorization (-steady_pc_type cholesky or lu)": not is_factored(),
        "a curve needs two frequencies or more": len(omegas) < 2,
    }
    why_not = next((reason for reason, holds in reasons.items() if holds), None)
    if method == "points":
        if resolve:
            raise InputError("-sweep_resolve: needs models; -sweep_method curve makes them")
        return method
    key = "sweep_method curve" if method == "curve" else "sweep_resolve" if resolve else None
    if key:
        if why_not:
            raise InputError(f"-{key}: {why_not}; -sweep_method points does without")
        return "curve"
    if why_not:
        return "points"
    counts, _ = expected_intervals(lattice, omegas[0], omegas[-1])
    pays = ALONE if resolve == 0 else PAYS
    return "curve" if len(omegas) >= pays * max(counts[-1], FEW) else "points"


class IntervalSweep(Task):
    """Models of the response of one lattice, from its lowest driving frequency to the highest.

    Parameters
    ----------
    lattice : pgran.medium.lattice.Lattice
        In its own unit.
    omegas : numpy.ndarray, shape (nw,)
        Driving frequencies, angular, increasing.
    sites : numpy.ndarray of int, shape (nd, dim)
        The detectors.
    tolerance : float
        Relative accuracy asked of each amplitude.
    """

    items = "intervals"

    def __init__(self, lattice, omegas, sites, tolerance):
        """Cut the sweep where equal parts of the intervals are expected to end."""
        self.lattice, self.sites, self.tolerance = lattice, sites, tolerance
        self.row = model_dtype(min(2 * MOMENTS, lattice.balls), len(sites), lattice.balls)
        self.counts, self.frequencies = expected_intervals(lattice, omegas[0], omegas[-1])
        total = self.counts[-1]
        check_memory("sweep_method", int(total) * self.row.itemsize)
        # an even number, and some at least, so that few ranks have equal shares
        parts = max(2 * round(total / (2 * UNIT)), min(4, int(total / 8)))
        parts = min(max(parts, 1), MOST_UNITS)
        ends = np.interp(np.linspace(0, total, parts + 1), self.counts, self.frequencies)
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

            def work(unit):
                return np.concatenate(list(models.cover(*unit)))

            yield work

    def length(self, unit):
        """See `Task`; how many intervals there are shows only later."""
        low, high = np.interp(unit, self.frequencies, self.counts)
        return max(1, round(high - low))

    def sample(self, unit):
        """See `Task`."""
        low, high = unit
        return low, low + 0.2 * (high - low)

    def collect(self, rows, seconds):
        """See `Task`."""
        return rows


class CurvePoints(Task):
    """The curve at the frequencies asked for, and at those that resolve it.

    Parameters
    ----------
    models : numpy.ndarray of `models.model_dtype`
        Of intervals that follow each other.
    limits : pgran.experiments.response.models.ModelLimits
    omegas : numpy.ndarray, shape (nw,)
        The frequencies asked for.
    tolerance : float
        Of straight lines between neighbours, relative to the amplitude; 0 adds no frequency.
    """

    items = "intervals"

    def __init__(self, models, limits, omegas, tolerance):
        """Look at each proven interval."""
        self.models, self.limits, self.omegas, self.tolerance = models, limits, omegas, tolerance
        self.row = point_dtype(models["reading"].shape[1])
        self.units = np.flatnonzero(models["proven"]).tolist()

    @contextlib.contextmanager
    def open(self, group):
        """See `Task`."""
        yield self.points

    def length(self, unit):
        """See `Task`."""
        return 1

    def points(self, unit):
        """Return the points of one interval, without its upper end if another one follows."""
        model = self.models[unit]
        low, high = model["low"], model["high"]
        first, last = np.searchsorted(self.omegas, [low, high])
        follows = unit + 1 < len(self.models) and self.models["proven"][unit + 1]
        asked = self.omegas[first : last if follows else last + np.sum(self.omegas[last:] == high)]
        if not self.tolerance:
            return evaluate(model, asked, self.limits) if len(asked) else np.zeros(0, self.row)
        between = np.linspace(low, high, FEW + 1) if len(asked) < FEW else [low, high]
        above = model["poles"][np.isfinite(model["poles"])]
        start = np.unique(np.concatenate([asked, between, above]))
        found = resolve(partial(evaluate, model, limits=self.limits), start, self.tolerance)
        return found[:-1] if follows else found

    def collect(self, rows, seconds):
        """See `Task`."""
        return rows


def solve_curve(task, crew, resolve, keep_models, progress):
    """Return the points of the curve, and the record of its models if they are kept, on rank 0.

    Collective. Where no model is proven the frequencies asked for are solved for one by one, and so
    are points of the curve that a proven model misses, as where the amplitude almost vanishes.

    Parameters
    ----------
    task : pgran.experiments.response.points.ResponseSweep
        That solves for the frequencies one by one.
    crew : pgran.run.crew.Crew
    resolve : float
        What straight lines between neighbours are to be right to, relative to the amplitude.
    keep_models : bool or None
        None: where they are few.
    progress : str
        Style of `pgran.run.progress.Progress`.
    """
    intervals = IntervalSweep(task.scaled, task.omegas, task.sites, task.choices["error_tolerance"])
    models = crew.world.bcast(carry_out(intervals, crew, progress))
    if crew.dry:
        found, models["proven"] = np.zeros(0, task.row), 1
    else:
        found = carry_out(CurvePoints(models, intervals.limits, task.omegas, resolve), crew)
    kept, missing = None, None
    if crew.world.rank == 0:
        wanted = np.union1d(task.omegas, found["omega"])
        found = task.accurate(found)
        missing = np.setdiff1d(wanted, found["omega"])
        few = models.nbytes <= FEW_BYTES if keep_models is None else keep_models
        kept = _stored(models, intervals.limits) if few else None
    missing = crew.world.bcast(missing)
    if crew.dry:
        found = np.zeros(len(missing), task.row)
    elif len(missing):
        others = carry_out(task.at(missing), crew, progress)
        if crew.world.rank == 0:
            found = np.concatenate([found, others])
            found = found[np.argsort(found["omega"], kind="stable")]
    if crew.world.rank == 0:
        found["factorizations"][:1] += models["factorizations"].sum()
        found["modelled"][1:] = np.diff(_unproven(models, found["omega"])) == 0
    return found, kept


def _unproven(models, omega):
    """Return how much of the sweep below some frequencies no proven model covers."""
    lengths = np.where(models["proven"], 0.0, models["high"] - models["low"])
    ends = np.append(models["low"][:1], models["high"])
    return np.interp(omega, ends, np.append(0.0, np.cumsum(lengths)))


def _stored(models, limits):
    """Return the record of the models that are proven."""
    proven = models[models["proven"] > 0]
    arrays = {name: np.ascontiguousarray(proven[name]) for name in ARRAYS}
    return Models(**dataclasses.asdict(limits), **arrays)
