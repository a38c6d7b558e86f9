"""What scenes return and results hold, group by group: every array and value is declared here.

`pgran.record` says what the declarations mean. `pgran.files.store` writes and reads by them: arrays
as datasets, plain values as attributes.
"""

from dataclasses import dataclass

import numpy as np

from pgran.record import Record, array, attribute_array
from pgran.results.density import Density as Density
from pgran.results.ensemble import Ensemble as Ensemble
from pgran.results.medium import LatticeRecord as LatticeRecord
from pgran.results.medium import NetworkRecord as NetworkRecord
from pgran.results.medium import record_of as record_of
from pgran.results.noise import NoiseStatistics as NoiseStatistics
from pgran.results.relaxation import Memory as Memory
from pgran.results.relaxation import Relaxation as Relaxation
from pgran.results.relaxation import Spectrum as Spectrum
from pgran.results.response import DETECTOR, PHASE, Frequencies
from pgran.results.response import Models as Models
from pgran.results.response import Response as Response
from pgran.results.sensitivity import Heat as Heat
from pgran.results.sensitivity import Sensitivity as Sensitivity
from pgran.results.transport import Transport as Transport


@dataclass(frozen=True, eq=False, repr=False)
class Signals(Record):
    """What balls do in time when the driven wall moves: `nt` times, `nd` detectors.

    A front has arrived when a thousandth of the signal's energy, the integral of the velocity's
    square, has passed, NaN where errors leave that open, or it would be before the wall's own,
    `wall_arrival`. (Files before version 5: when a displacement first exceeds a tenth of its
    largest.) `centre` is the mean time, weighted by the square of the envelope, `decay` the rate at
    which the envelope decays after it, with its standard error. The `method` is `laplace`, with
    bounds of the errors, `sigma` and `period` those
    of the inverse transform and `solves` points on its line; or `integrate`, with estimates,
    `solves` the steps of the last integration.
    """

    group = "pulse"
    shape: str
    pulse_omega: float
    pulse_width: float
    method: str
    sigma: float
    period: float
    solves: int
    factorizations: int
    solve_seconds: float
    tolerance: float
    wall_arrival: float
    arrival: np.ndarray = attribute_array("detector_number")
    centre: np.ndarray = attribute_array("detector_number")
    decay: np.ndarray = attribute_array("detector_number")
    decay_error: np.ndarray = attribute_array("detector_number")
    time: np.ndarray = array("time", "sqrt(m/k)")
    wall: np.ndarray = array("displacement of the driven wall", "1", "time")
    force: np.ndarray = array("force on the driven wall", "k", "time")
    work: np.ndarray = array("work of the driven wall until then", "k", "time")
    detector: np.ndarray = array(DETECTOR, "1", "detector_number", "axis", dtype=int)
    displacement: np.ndarray = array(
        "displacement of the detectors", "1", "time", "detector_number"
    )
    velocity: np.ndarray = array(
        "velocity of the detectors", "sqrt(k/m)", "time", "detector_number"
    )
    envelope: np.ndarray = array(
        "sqrt(u^2 + (v / omega)^2), omega^2 the mean of v^2 over that of u^2",
        "1", "time", "detector_number",
    )  # fmt: skip
    energy: np.ndarray | None = array("energy of the balls and springs", "k", "time", optional=True)
    dissipated: np.ndarray | None = array(
        "work taken by damping until then", "k", "time", optional=True
    )
    error_bound: np.ndarray | None = array(
        "bound of the error of the displacement", "1", "time", "detector_number", optional=True
    )
    velocity_bound: np.ndarray | None = array(
        "bound of the error of the velocity", "sqrt(k/m)", "time", "detector_number", optional=True
    )
    force_estimate: np.ndarray | None = array(
        "estimate of the error of the force", "k", "time", optional=True
    )
    work_estimate: np.ndarray | None = array(
        "estimate of the error of the work", "k", "time", optional=True
    )
    energy_estimate: np.ndarray | None = array(
        "estimate of the error of the energy", "k", "time", optional=True
    )
    dissipated_estimate: np.ndarray | None = array(
        "estimate of the error of the work taken by damping", "k", "time", optional=True
    )
    error_estimate: np.ndarray | None = array(
        "estimate of the error of the displacement", "1", "time", "detector_number", optional=True
    )
    velocity_estimate: np.ndarray | None = array(
        "estimate of the error of the velocity", "sqrt(k/m)", "time", "detector_number",
        optional=True,
    )  # fmt: skip
    field_time: np.ndarray | None = array("times of the field", "sqrt(m/k)", optional=True)
    field: np.ndarray | None = array(
        "displacement of all balls", "1", "field_time", "balls", optional=True
    )

    @property
    def error(self):
        """The bound of the displacement's error, or its estimate."""
        return self.error_estimate if self.error_bound is None else self.error_bound

    @property
    def failures(self):
        """How many detectors' signals miss the accuracy asked for, relative to their largest."""
        largest = np.abs(self.displacement).max(axis=0)
        return int(np.count_nonzero(~(self.error.max(axis=0) <= self.tolerance * largest)))


def _missing(record):
    """Return how many modes are missing, at least 1 unless they are certified."""
    return 0 if record.count_certified else max(1, abs(record.count_expected - record.count_found))


@dataclass(frozen=True, eq=False, repr=False)
class Modes(Record):
    """Normal modes K f = m omega^2 f (paper: modepic), `nm` of them.

    `count_expected` says how many there are, `count_certified` whether all of these were found,
    each with a residual of rounding size.
    """

    group = "modes"
    count_expected: int
    count_certified: bool
    solve_seconds: float
    omega: np.ndarray = array("frequency of the mode, angular", "sqrt(k/m)")
    residual: np.ndarray = array("|K f - m omega^2 f| / |K|", "1", "omega")
    participation: np.ndarray = array("how many balls take part, 1 / sum f^4", "1", "omega")
    vector: np.ndarray | None = array(
        "shape of the mode, orthonormal, its largest entry positive",
        "1", "omega", "balls", optional=True,
    )  # fmt: skip

    @property
    def count_found(self):
        """How many modes there are here."""
        return len(self.omega)

    @property
    def failures(self):
        """How many modes are missing or inaccurate."""
        return _missing(self)


@dataclass(frozen=True, eq=False, repr=False)
class Projection(Frequencies, Record):
    """The driven lattice in terms of its normal modes (paper: cidef, onefreq, maxci, cifreq).

    `nw` driving frequencies, `nm` modes. A frequency whose `converged_reason` is not positive
    missed the accuracy asked for.
    """

    group = "projection"
    count_expected: int
    count_certified: bool
    factorizations: int
    solve_seconds: float
    omega: np.ndarray = array("driving frequency, angular", "sqrt(k/m)")
    mode_omega: np.ndarray = array("frequency of the mode, angular", "sqrt(k/m)")
    coefficient: np.ndarray = array(
        "sum over balls of amplitude times mode shape", "1", "omega", "mode_omega", dtype=complex
    )
    dominant: np.ndarray = array(
        "mode of the largest coefficient; -1: none", "1", "omega", dtype=int
    )
    error_bound: np.ndarray = array(
        "bound of the field's part in each coefficient's error; NaN: none is known", "1", "omega"
    )
    converged_reason: np.ndarray = array("positive: as accurate as asked", "1", "omega", dtype=int)

    @property
    def count_found(self):
        """How many modes there are here."""
        return len(self.mode_omega)

    @property
    def failures(self):
        """How many frequencies missed their accuracy, and how many modes are missing."""
        return super().failures + _missing(self)


@dataclass(frozen=True, eq=False, repr=False)
class ContinuumResponse(Record):
    """The exact response of the homogeneous box at one point (paper: axysol, exactpl)."""

    group = "continuum"
    point: tuple[float, ...]
    size: tuple[float, ...]
    mass: float
    stiffness: float
    damping: float
    omega: np.ndarray = array("driving frequency, angular", "sqrt(K0/m)/length")
    displacement: np.ndarray = array(
        "amplitude relative to the driven wall, convention exp(+i omega t)",
        "1", "omega", dtype=complex,
    )  # fmt: skip
    amplitude: np.ndarray = array("magnitude of the displacement", "1", "omega")
    phase: np.ndarray = array(PHASE, "rad", "omega")
    resonance: np.ndarray = array("driven resonances, angular", "sqrt(K0/m)/length")


@dataclass(frozen=True, eq=False, repr=False)
class Accuracy(Record):
    """Error against run time: one experiment by several solvers, each at several tolerances.

    A row a configuration, each timed `repeats` times. Errors are relative and true, against a
    reference whose own relative error is at most `reference_bound`; what is smaller than that is
    given as that bound. The `experiment` (`response`, `modes` or `relaxation`) has `values`
    amplitudes or modes; `compared` of them are those that the reference is good enough for.
    """

    group = "accuracy"
    experiment: str
    repeats: int
    values: int
    compared: int
    reference_bound: float
    label: np.ndarray = array("configuration: solver and tolerance", "1", dtype=str)
    solver: np.ndarray = array("solver, after its options file", "1", "label", dtype=str)
    tolerance: np.ndarray = array("accuracy asked for", "1", "label")
    seconds: np.ndarray = array("run time, median of the repeats", "s", "label")
    seconds_min: np.ndarray = array("shortest run time", "s", "label")
    seconds_max: np.ndarray = array("longest run time", "s", "label")
    error_max: np.ndarray = array("largest relative error; NaN: nothing computed", "1", "label")
    error_median: np.ndarray = array("median of the relative errors", "1", "label")
    error_bound_max: np.ndarray = array(
        "largest bound of the relative error that the solver gives itself; NaN: none",
        "1", "label",
    )  # fmt: skip
    iterations: np.ndarray = array("Krylov iterations; -1: not counted", "1", "label", dtype=int)
    failures: np.ndarray = array(
        "amplitudes that miss the accuracy asked for, or modes that are missing or inaccurate",
        "1", "label", dtype=int,
    )  # fmt: skip
    on_front: np.ndarray = array(
        "no other configuration without failures is faster and as accurate",
        "1", "label", dtype=bool,
    )  # fmt: skip


# Every record by the name of its group; the lattice, whose axes the others share, comes first.
KINDS = tuple(Record.__subclasses__())
RECORDS = {kind.group: kind for kind in KINDS if not kind.within}
