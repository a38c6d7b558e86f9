"""Measured numbers with their standard errors, by leaving out one part of the data at a time."""

import math
from dataclasses import dataclass

import numpy as np

FEWEST, MOST = 5, 20  # parts that a standard error is taken from
FEWEST_SAMPLES = 8


@dataclass(frozen=True, eq=False)
class Estimate:
    """The value of a statistic and its standard error; NaN where there is none."""

    value: float | np.ndarray
    error: float | np.ndarray


def jackknife(measure, parts):
    """Return a statistic with its standard error, and without its bias of first order.

    With T of all data and T_g of all but part g, one of n independent ones:

        value = n T - (n - 1) <T_g>,    error^2 = (n - 1) / n sum_g (T_g - <T_g>)^2

    (Quenouille, Biometrika 43, 353 (1956); Tukey, Ann. Math. Stat. 29, 614 (1958)). `measure(None)`
    is T, `measure(g)` is T_g, numbers or arrays of one shape; `parts` is n.
    """
    # the measure of all data but a part, for each part: their scatter is the error's
    replicas = np.array([measure(part) for part in range(parts)])
    mean = replicas.mean(axis=0)
    value = parts * measure(None) - (parts - 1) * mean
    error = np.sqrt((parts - 1) / parts * np.sum((replicas - mean) ** 2, axis=0))
    return Estimate(value, error) if np.ndim(value) else Estimate(float(value), float(error))


def jackknife_samples(measure, samples):
    """Return a statistic of independent samples with its standard error.

    As `jackknife`, with the samples, at least `FEWEST_SAMPLES`, dealt out to at most `MOST` parts:
    `measure` is called with masks, shape (samples,), of those that count.
    """
    part_of = np.arange(samples) % min(samples, MOST)
    return jackknife(
        lambda part: measure(np.full(samples, True) if part is None else part_of != part),
        min(samples, MOST),
    )


def plug_in(measure, samples):
    """Return a statistic of all samples as it is, with its standard error.

    The bias stays: to take it off adds scatter where weights are of the same samples. `measure` is
    to find these anew: fixed ones make errors too small. Misses over errors of n parts are as
    Student's t, whose variance (n - 1) / (n - 3) is in the error.
    """
    error, n = jackknife_samples(measure, samples).error, min(samples, MOST)
    return Estimate(measure(np.full(samples, True)), error * math.sqrt((n - 1) / (n - 3)))


def mean_of(numbers):
    """Return the mean of independent numbers along the first axis, and its standard error."""
    numbers = np.asarray(numbers, dtype=float)
    count = len(numbers)
    nothing = np.full(numbers.shape[1:], math.nan)[()]
    value = numbers.mean(axis=0) if count else nothing  # NaN of no numbers, the error of one
    error = numbers.std(axis=0, ddof=1) / math.sqrt(count) if count > 1 else nothing
    return Estimate(value, error)


def with_errors(**estimates):
    """Return the fields of a record that estimates are: `length`, and its error `length_error`."""
    errors = {f"{name}_error": estimate.error for name, estimate in estimates.items()}
    return {name: estimate.value for name, estimate in estimates.items()} | errors


def with_error(value, error, sign="+-"):
    """Return a number and its error, both as far as two digits of the error reach.

    As "0.0717 +- 0.0022", "1980 +- 140", "(3.10 +- 0.12)e-05"; no digits by an error of 0 or NaN.
    """
    if not (error > 0 and math.isfinite(error) and math.isfinite(value)):
        return f"{value:.4g} {sign} {error:g}"
    power = math.floor(math.log10(max(abs(value), error)))
    power = power if power < -4 else 0  # as few numbers need
    value, error = value / 10.0**power, float(f"{error / 10.0**power:.1e}")
    places = 1 - math.floor(math.log10(error))
    both = f" {sign} ".join(f"{round(x, places):.{max(places, 0)}f}" for x in (value, error))
    exponent = f"e{power:03d}" if sign == "+-" else rf"\times10^{{{power}}}"  # of a formula
    return f"({both}){exponent}" if power else both


def told(record, name, place=()):
    """Return a measured number of a record with its error, or that it is unknown."""
    value, error = (np.asarray(getattr(record, each))[place] for each in (name, f"{name}_error"))
    return with_error(value, error) if np.isfinite(error) else "unknown"


def counted(count, name):
    """Return a number of things in words, "1 frequency", "2 frequencies"."""
    if count != 1:
        name = f"{name[:-1]}ies" if name.endswith("y") else f"{name}s"
    return f"{count} {name}"
