"""The record of an accuracy study."""

from dataclasses import dataclass

import numpy as np

from pgran.store.record import Record, array, attribute


@dataclass(frozen=True, eq=False, repr=False)
class Accuracy(Record):
    """Error against run time: one experiment by several solvers, each at several tolerances.

    A row a configuration, each timed `repeats` times. Errors are relative and true, against a
    reference whose own relative error is at most `reference_bound`; what is smaller than that is
    given as that bound. The `experiment` has `values` amplitudes or modes; `compared` of them are
    those that the reference is good enough for.
    """

    group = "accuracy"
    experiment: str = attribute("the experiment that is repeated")
    repeats: int = attribute("how often each is timed", "1")
    values: int = attribute("amplitudes or modes of the experiment", "1")
    compared: int = attribute("those that the reference is good enough for", "1")
    reference_bound: float = attribute("relative error of the reference, at most", "1")
    label: np.ndarray = array("configuration: solver and tolerance", "1", dtype=str)
    solver: np.ndarray = array("solver, after its options file", "1", "label", dtype=str)
    tolerance: np.ndarray = array("accuracy asked for", "1", "label")
    seconds: np.ndarray = array("run time, median of the repeats", "s", "label", row=True)
    seconds_min: np.ndarray = array("shortest run time", "s", "label")
    seconds_max: np.ndarray = array("longest run time", "s", "label")
    error_max: np.ndarray = array(
        "largest relative error; NaN: nothing computed", "1", "label", row=True
    )
    error_median: np.ndarray = array("median of the relative errors", "1", "label", row=True)
    error_bound_max: np.ndarray = array(
        "largest bound of the relative error that the solver gives itself; NaN: none",
        "1", "label", row=True,
    )  # fmt: skip
    iterations: np.ndarray = array(
        "Krylov iterations; -1: not counted", "1", "label", dtype=int, row=True
    )
    failures: np.ndarray = array(
        "amplitudes that miss the accuracy asked for, or modes that are missing or inaccurate",
        "1", "label", dtype=int, row=True,
    )  # fmt: skip
    on_front: np.ndarray = array(
        "no other configuration without failures is faster and as accurate",
        "1", "label", dtype=bool,
    )  # fmt: skip
