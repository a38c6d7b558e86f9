"""What scenes return and results hold, group by group: every array and value is declared here.

`pgran.record` says what the declarations mean. `pgran.files.store` writes and reads by them: arrays
as datasets, plain values as attributes.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from pgran.errors import PgranError
from pgran.record import SPACE, MisfitError, Record, array, attribute, attribute_array, part

LINES = 1e-2  # of the amplitude, that straight lines between neighbours should be right to
# What more than one record holds.
DETECTOR = "indices of the detecting balls"
PHASE = "phase, unwrapped along omega; without damping 0 or pi"
BOUND = "bound of the error of the displacement; NaN: none is known"
FLOOR = "1: the bound is below error_floor, but not small against the amplitude"


@dataclass(frozen=True, eq=False, repr=False)
class LatticeRecord(Record):
    """The lattice a result belongs to."""

    group = "lattice"
    shape: tuple[int, ...]
    mass: float
    damping: float
    omega_mx: float
    bonds_sha256: str = field(metadata={"of_run": True})  # an attribute of the whole file
    stiffness_x: np.ndarray = array("constants of the bonds along x", "k", "bonds_x")
    stiffness_y: np.ndarray | None = array(
        "constants of the bonds along y", "k", "bonds_y", optional=True
    )
    stiffness_z: np.ndarray | None = array(
        "constants of the bonds along z", "k", "bonds_z", optional=True
    )

    def __post_init__(self):
        """Hold one array of bonds for each axis."""
        there = [k is not None for k in (self.stiffness_x, self.stiffness_y, self.stiffness_z)]
        axes = len(self.shape)
        if there != [True] * axes + [False] * (3 - axes) or min(self.shape) < 1:
            raise MisfitError(f"shape: {self.shape} does not fit {sum(there)} arrays stiffness_*")

    @property
    def stiffness(self):
        """The constants of the bonds, an array for each axis, as `Lattice` takes them."""
        return (self.stiffness_x, self.stiffness_y, self.stiffness_z)[: len(self.shape)]

    @property
    def axes(self):
        """How long the axes of the lattice and of its bonds are, by name."""
        balls = dict(zip(SPACE, self.shape, strict=False))
        return {"axis": len(balls)} | balls | {f"bond_{name}": n + 1 for name, n in balls.items()}

    @classmethod
    def of(cls, lattice):
        """Return the record of a `pgran.physics.lattice.Lattice`."""
        same = ("shape", "mass", "damping", "omega_mx", "bonds_sha256")
        arrays = {f"stiffness_{x}": k for x, k in zip(SPACE, lattice.stiffness, strict=False)}
        return cls(**{name: getattr(lattice, name) for name in same}, **arrays)


@dataclass(frozen=True, eq=False, repr=False)
class Models(Record):
    """Models of the response, an interval of frequencies each; `pgran.physics.interval` says what.

    The plain values bound their errors. All are in the unit that the lattice was solved in, which
    amplitudes and frequencies do not depend on.
    """

    group, within = "models", "response"
    stability: float
    stiffness: float
    damping: float
    mass: float
    drive: float
    drive_damping: float
    rounding: float
    sum_rounding: float
    low: np.ndarray = array("lower end of the interval, angular", "sqrt(k/m)", "interval")
    high: np.ndarray = array("upper end of the interval, angular", "sqrt(k/m)", "interval")
    own: np.ndarray = array(
        "X^T W of each system: that of A, then one a detector",
        "k", "interval", "system", "column", "place", dtype=complex,
    )  # fmt: skip
    cross: np.ndarray = array(
        "Z^T W with the W of A", "k", "interval", "detector_number", "column", "place",
        dtype=complex,
    )  # fmt: skip
    triangle: np.ndarray = array(
        "R of W = Q R", "k", "interval", "system", "row", "place", dtype=complex
    )
    reading: np.ndarray = array(
        "e_d^T X", "1", "interval", "detector_number", "column", dtype=complex
    )
    sizes: np.ndarray = array(
        "|Z|^T |S| |X|", "k", "interval", "detector_number", "column", "other"
    )
    drive_sizes: np.ndarray = array("|Z|^T |f|", "k", "interval", "detector_number", "column")


@dataclass(frozen=True, eq=False, repr=False)
class Response(Record):
    """The frequency response of single balls (paper: freqres, phaseres).

    `nw` frequencies, `nd` detectors. A point whose `converged_reason` is not positive failed or
    missed the accuracy asked for. The `method` is `points`, each frequency solved for, or `curve`,
    models of intervals; `resolve` is what straight lines between neighbours were asked to be right
    to, relative to the amplitude; 0: no frequency was added.
    """

    group = "response"
    factorizations: int
    solve_seconds: float
    method: str = attribute(since=3)
    resolve: float = attribute(since=3)
    phase_slope: np.ndarray = attribute_array("detector_number")
    phase_slope_error: np.ndarray = attribute_array("detector_number", since=3)
    phase_velocity: np.ndarray = attribute_array("detector_number")
    phase_velocity_error: np.ndarray = attribute_array("detector_number", since=3)
    phase_intercept: np.ndarray = attribute_array("detector_number")
    phase_fit_min: float
    phase_fit_max: float
    phase_used_min: np.ndarray = attribute_array("detector_number", since=3)
    phase_used_max: np.ndarray = attribute_array("detector_number", since=3)
    omega: np.ndarray = array("driving frequency, angular", "sqrt(k/m)")
    requested: np.ndarray = array(
        "1: this frequency was asked for, 0: added to resolve the curve", "1", "omega",
        dtype=np.int8, since=3,
    )  # fmt: skip
    detector: np.ndarray = array(DETECTOR, "1", "detector_number", "axis", dtype=int)
    displacement: np.ndarray = array(
        "amplitude at the detectors relative to the driven wall, convention exp(+i omega t)",
        "1", "omega", "detector_number", dtype=complex,
    )  # fmt: skip
    amplitude: np.ndarray = array("magnitude of the displacement", "1", "omega", "detector_number")
    phase: np.ndarray = array(PHASE, "rad", "omega", "detector_number")
    backward_error: np.ndarray = array("normwise backward error of the field", "1", "omega")
    error_bound: np.ndarray = array(BOUND, "1", "omega", "detector_number")
    derivative: np.ndarray = array(
        "derivative of the displacement along omega", "sqrt(m/k)", "omega", "detector_number",
        dtype=complex, since=3,
    )  # fmt: skip
    derivative_bound: np.ndarray = array(
        "bound of the error of the derivative; NaN: none is known",
        "sqrt(m/k)", "omega", "detector_number", since=3,
    )  # fmt: skip
    delay: np.ndarray = array(
        "group delay, minus the derivative of the phase along omega; NaN: the amplitude may vanish",
        "sqrt(m/k)", "omega", "detector_number", since=3,
    )  # fmt: skip
    delay_bound: np.ndarray = array(
        "bound of the error of the delay", "sqrt(m/k)", "omega", "detector_number", since=3
    )
    line_error: np.ndarray = array(
        "how far the curve leaves the straight line from the frequency before, relative to the "
        "amplitude, by the derivatives at both; infinite: unknown",
        "1", "omega", "detector_number", since=3,
    )  # fmt: skip
    at_floor: np.ndarray = array(FLOOR, "1", "omega", "detector_number", dtype=np.int8, since=2)
    iterations: np.ndarray = array("Krylov iterations, adjoints included", "1", "omega", dtype=int)
    converged_reason: np.ndarray = array("positive: as accurate as asked", "1", "omega", dtype=int)
    field: np.ndarray | None = array(
        "amplitudes of all balls relative to the driven wall",
        "1", "omega", "balls", dtype=complex, optional=True,
    )  # fmt: skip
    models: Models | None = part(Models)

    @property
    def failures(self):
        """How many frequencies missed the accuracy asked for."""
        return int(np.count_nonzero(self.converged_reason <= 0))

    @property
    def unresolved(self):
        """Which straight lines to the next frequency are not the curve, shape (nw - 1,)."""
        if self.line_error is None:
            return np.zeros(len(self.omega) - 1, dtype=bool)
        return ~np.all(self.line_error[1:] <= (self.resolve or LINES), axis=1)

    def at(self, omega):
        """Return the curve at any frequencies of the sweep, without PETSc.

        Not collective.

        Parameters
        ----------
        omega : array_like of float, shape (n,)
            Driving frequencies, angular.

        Returns
        -------
        Curve
            NaN, with infinite bounds, where no interval's model is proven.

        Raises
        ------
        PgranError
            If the result holds no models.
        """
        if self.models is None:
            raise PgranError(
                "the response holds no models to tell the amplitude at any frequency: compute it "
                "with -sweep_method curve and -output_models (keep_models=True)"
            )
        from pgran.physics.interval import evaluate_all

        return Curve(*evaluate_all(self.models, np.asarray(omega, dtype=float)))


class Curve(NamedTuple):
    """The response at some frequencies: arrays of shape (n, nd), but for `omega`.

    `displacement` and `derivative` are wrong by at most `error_bound` and `derivative_bound`.
    """

    omega: np.ndarray
    displacement: np.ndarray
    error_bound: np.ndarray
    derivative: np.ndarray
    derivative_bound: np.ndarray


@dataclass(frozen=True, eq=False, repr=False)
class Signals(Record):
    """What balls do in time when the driven wall moves: `nt` times, `nd` detectors.

    A front has arrived when a displacement first exceeds a tenth of its largest, NaN where the
    bounds leave that open; `centre` is the mean time, weighted by the square of the displacement.
    `sigma` and `period` are those of the inverse Laplace transform.
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
    arrival: np.ndarray = attribute_array("detector_number")
    centre: np.ndarray = attribute_array("detector_number")
    time: np.ndarray = array("time", "sqrt(m/k)")
    wall: np.ndarray = array("displacement of the driven wall", "1", "time")
    detector: np.ndarray = array(DETECTOR, "1", "detector_number", "axis", dtype=int)
    displacement: np.ndarray = array(
        "displacement of the detectors", "1", "time", "detector_number"
    )
    error_bound: np.ndarray = array(
        "bound of the error of the displacement", "1", "time", "detector_number"
    )
    velocity: np.ndarray = array(
        "velocity of the detectors", "sqrt(k/m)", "time", "detector_number"
    )
    velocity_bound: np.ndarray = array(
        "bound of the error of the velocity", "sqrt(k/m)", "time", "detector_number"
    )

    @property
    def failures(self):
        """How many detectors' signals miss the accuracy asked for, relative to their largest."""
        largest = np.abs(self.displacement).max(axis=0)
        return int(np.count_nonzero(~(self.error_bound.max(axis=0) <= self.tolerance * largest)))


def _missing(record, found):
    """Return how many modes are missing, at least 1 unless they are certified."""
    return 0 if record.count_certified else max(1, abs(record.count_expected - found))


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
    def failures(self):
        """How many modes are missing or inaccurate."""
        return _missing(self, len(self.omega))


@dataclass(frozen=True, eq=False, repr=False)
class Projection(Record):
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
    def failures(self):
        """How many frequencies missed their accuracy, and how many modes are missing."""
        failed = int(np.count_nonzero(self.converged_reason <= 0))
        return failed + _missing(self, len(self.mode_omega))


@dataclass(frozen=True, eq=False, repr=False)
class Relaxation(Record):
    """The amplitude at the detectors while one bond a step is redrawn (paper: timeres).

    R trajectories of T steps, all from the bonds of the lattice. `drift` is the largest relative
    difference between the amplitude at the end of a window, from algebra, and the same amplitude
    solved for afresh.
    """

    group = "relaxation"
    omega: float
    factorizations: int
    solve_seconds: float
    drift: float
    bond_axis: np.ndarray = array(
        "axis of the bond that changes", "1", "trajectory", "step", dtype=int
    )
    bond_index: np.ndarray = array(
        "its index into that axis's stiffness", "1", "trajectory", "step", "axis", dtype=int
    )
    stiffness: np.ndarray = array("its new constant", "k", "trajectory", "step")
    detector: np.ndarray = array(DETECTOR, "1", "detector_number", "axis", dtype=int)
    displacement: np.ndarray = array(
        "amplitude at the detectors relative to the driven wall, entry 0 before any change",
        "1", "trajectory", "state", "detector_number", dtype=complex,
    )  # fmt: skip
    error_bound: np.ndarray = array(BOUND, "1", "trajectory", "state", "detector_number", since=2)
    at_floor: np.ndarray = array(
        FLOOR, "1", "trajectory", "state", "detector_number", dtype=np.int8, since=2
    )

    @property
    def amplitude(self):
        """Magnitude of the displacement."""
        return np.abs(self.displacement)

    @property
    def failures(self):
        """How many steps miss the accuracy asked for; they hold NaN."""
        return int(np.count_nonzero(np.isnan(self.displacement).any(axis=2)))


@dataclass(frozen=True, eq=False, repr=False)
class Spectrum(Record):
    """The power spectrum of amplitude series, and the power law fitted to it (paper: timeres).

    S(f) = scale / (2 sin(pi f))^exponent from `fit_min` to `fit_max` cycles per step, `scale` in
    the unit of `power`, `exponent_error` the standard error; a segment has `segment` steps.
    `exponent_plain` is minus the slope of log S against log f, aliases and all, as in the paper.
    """

    group = "spectrum"
    exponent: float
    exponent_error: float
    exponent_plain: float
    scale: float
    fit_min: float
    fit_max: float
    segment: int
    frequency: np.ndarray = array("frequency", "cycles per step")
    power: np.ndarray = array(
        "one-sided power density of the amplitude, averaged over segments and trajectories",
        "steps per cycle", "frequency",
    )  # fmt: skip

    def power_law(self, frequency):
        """Return the fitted law at some frequencies, in the unit of `power`."""
        return self.scale / (2 * np.sin(np.pi * np.asarray(frequency))) ** self.exponent


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
RECORDS = {kind.group: kind for kind in Record.__subclasses__() if not kind.within}
