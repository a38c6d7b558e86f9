"""One experiment on many samples: the task that repeats it, bands, and measures in words."""

import numpy as np

from pgran.errors import InputError, PgranError, is_bad_input, is_petsc, log
from pgran.experiments.ensemble.record import Ensemble, measures, sampled_of
from pgran.run.machine import check_memory
from pgran.run.task import Task
from pgran.store.estimate import MOST, counted, mean_of, with_error, with_errors
from pgran.store.record import ball_names, columns_of, row_of
from pgran.store.si import SI

# What is kept with curves only: of modes, of pulses, and of responses, whose bands are kept always.
LARGE = "mode_omega", "participation", "mode_width", "drive", "square"
CURVES = "displacement", "sample_delay"
# What `over_samples` returns: a tenth of the samples lies below `low`, a tenth above `high`.
STATISTICS = ("mean", "error", "median", "low", "high")
QUANTILES = (0.5, 0.1, 0.9)


class Samples(Task):
    """The experiment `of` on each sample, a seed a unit.

    Collective over a group of ranks, `draw(seed, group)` returns the medium of a sample, of `most`
    unknowns or fewer, and `experiment(medium, number, crew)` its records on the first rank.
    `choices` are the experiment's keywords.
    """

    items = "samples"

    def __init__(self, of, seeds, draw, experiment, first, most, keep, choices):
        self.of, self.units, self.curves = of, seeds, keep == "curves"
        self.draw, self.experiment = draw, experiment
        omegas, detectors = choices.get("omegas"), choices.get("detectors")
        self.omegas = None if omegas is None else np.asarray(omegas, dtype=float)
        self.sites = None if detectors is None else first.sites(detectors)
        self.sampled = sampled_of(of)
        for name in () if self.curves else LARGE:
            self.sampled.pop(name, None)
        if choices.get("interval") is not None:  # there may be others above omega_mx
            self.sampled.pop("above", None)
        self.time = None
        if "square" in self.sampled:
            self.time = np.linspace(0.0, choices["time"], choices["points"])
        lengths = {
            "time": np.shape(self.time),
            "omega": () if omegas is None else self.omegas.shape,
            "detector_number": () if detectors is None else (len(self.sites),),
            "mode": (most,),
        }
        others = sampled_of().keys() - self.sampled
        self.row = np.dtype(row_of(Ensemble, others, **lengths))
        check_memory("ensemble_samples", len(self.units) * self.row.itemsize)

    def work(self, unit, group):
        """See `Task`; a sample that cannot be computed is no good, which is said."""
        from pgran.run.crew import AgreeingCrew

        rows = np.zeros(1, self.row)
        for name in self.sampled:
            rows[name] = np.nan
        try:
            medium = self.draw(unit, group)
            with AgreeingCrew(group, group.size) as crew:
                records = self.experiment(medium, unit - self.units[0], crew)
        except Exception as error:  # which all ranks of the group meet alike
            if isinstance(error, InputError):
                raise InputError(f"sample of seed {unit}: {error}") from error
            if type(error) is not PgranError and (not is_petsc(error) or is_bad_input(error)):
                raise
            if group.rank == 0:
                log.warning("sample of seed %d is left out: %s", unit, error)
            return rows
        if records:
            # damped modes have what is read of modes
            groups = {record.group.removeprefix("damped_"): record for record in records}
            for name, sampled in self.sampled.items():
                if sampled.group in groups:  # too short a relaxation has no spectrum
                    value = np.asarray(sampled.read(groups[sampled.group], medium))
                    # samples may have fewer modes than the row has places
                    rows[name][(0, *map(slice, value.shape))] = value
            rows["good"] = not any(record.failures for record in records)
        return rows

    def collect(self, rows, seconds):
        """See `Task`; bands are over those samples that are good."""
        good = rows["good"] > 0
        columns = columns_of(Ensemble, rows)
        if self.of == "response":
            columns["sample_delay"] = columns["delay"]
            columns |= _bands(rows[good])
            for name in () if self.curves else CURVES:
                columns.pop(name)
        if self.time is not None:
            columns |= _squares(rows[good])
        return Ensemble(
            of=self.of,
            solve_seconds=seconds,
            left_out=int(np.count_nonzero(~good)),
            seed=np.array(self.units),
            detector=self.sites,
            omega=self.omegas if self.of == "response" else None,
            time=self.time,
            **columns,
        )


def _bands(rows):
    """Return what the curves of responses have in common."""
    A, count = rows["displacement"], np.float64(len(rows))
    with np.errstate(invalid="ignore"):  # without any sample NaN
        coherent, intensity = A.sum(axis=0) / count, (np.abs(A) ** 2).sum(axis=0) / count
    return {
        "statistic": np.array(STATISTICS),
        "ln_amplitude": over_samples(rows["ln_amplitude"]),
        "delay": over_samples(rows["delay"]),
        "delay_samples": np.count_nonzero(np.isfinite(rows["delay"]), axis=0),
        "coherent": coherent,
        "intensity": intensity,
    }


def _squares(rows):
    """Return what pulses have in common: means over all samples, and over each of some parts."""
    parts = np.array_split(rows, max(1, min(len(rows), MOST)))
    with np.errstate(invalid="ignore"):  # without any sample NaN
        means = {
            name: np.array([part[name].sum(axis=0) / np.float64(len(part)) for part in parts])
            for name in ("drive", "square")
        }
    return means | with_errors(mean_square=mean_of(rows["square"]))


def over_samples(curves):
    """Return the STATISTICS, shape (5, ...), of curves over samples, shape (samples, ...).

    What is not finite in a sample, an unknown delay, say, is left out at that place; where fewer
    than two samples are left all is NaN.
    """
    if len(curves) < 2:
        return np.full((len(STATISTICS), *curves.shape[1:]), np.nan)
    known = np.isfinite(curves)
    count = np.count_nonzero(known, axis=0)
    with np.errstate(all="ignore"):
        mean = np.where(known, curves, 0.0).sum(axis=0) / count
        squares = np.where(known, curves - mean, 0.0) ** 2
        error = np.sqrt(squares.sum(axis=0) / (count - 1) / count)
        # what is left out comes last, so that the first `count` of each column are the samples
        ordered = np.sort(np.where(known, curves, np.inf), axis=0)
        quantiles = (_quantile(ordered, count, part) for part in QUANTILES)
        statistics = np.stack([mean, error, *quantiles])
    return np.where(count > 1, statistics, np.nan)


def _quantile(ordered, count, part):
    """Return a quantile of the first `count` of sorted samples, linear between neighbours."""
    place = np.maximum(count - 1, 0) * part
    below = np.floor(place).astype(int)
    above = np.minimum(below + 1, np.maximum(count - 1, 0))
    low, high = (np.take_along_axis(ordered, n[None], axis=0)[0] for n in (below, above))
    return low + (place - below) * (high - low)


def in_words(result):
    """Yield in words the measures of samples, one after the other."""
    for name, measure in measures().items():
        if getattr(result.ensemble, name) is not None:
            yield from _told(result, name, measure)


def _told(result, name, measure):
    """Yield in words a measure at each detector; where it is unknown at several, in one line."""
    ensemble, medium, si = result.ensemble, result.medium, SI.of(result)
    values = getattr(ensemble, name)
    balls = [None] if values.ndim == 1 else ball_names(ensemble.detector)
    columns = np.atleast_2d(values[ensemble.good > 0].T)  # a detector a row
    finite = [column[np.isfinite(column)] for column in columns]
    few = [len(values) for values in finite if len(values) < 2]
    *_, physical, power = measure.quantity
    # numbers in units of sqrt(m/k) are told without a unit, as everywhere
    unit = f" {measure.units.replace('length', medium.length)}" if power else ""
    for ball, values in zip(balls, finite, strict=True):
        line = measure.words if ball is None else f"{ball}: {measure.words}"
        if len(values) > 1:
            mean, spread = values.mean(), values.std(ddof=1)
            error = spread / np.sqrt(len(values))
            in_si = si.say(physical, medium.omega_mx**power * mean) if physical else ""
            line += f" {with_error(mean, error)}{unit}{in_si}, spread {spread:.2g}"
        elif len(few) == 1:
            line += " unknown"
        else:
            continue
        yield line + _uncertain("", columns.shape[1] - len(values))
    if len(few) > 1:
        uncertain = _uncertain("up to ", columns.shape[1] - min(few))
        yield f"{measure.words} unknown at {len(few)} balls{uncertain}"


def _uncertain(most, samples):
    """Return in words in how many samples a measure is not certain."""
    return f"; not certain in {most}{counted(samples, 'sample')}" if samples else ""
