"""What scenes return: frozen dataclasses of plain values and NumPy arrays.

The metadata of a field say what it is, its unit, and its axes. `pgran.files.store` writes arrays as
datasets with these, and plain values as attributes. An axis is named after the array that holds its
coordinates, an array of one axis, or counts from 0; `balls` stands for the axes of the lattice. An
array without axes is a coordinate itself.
"""

from dataclasses import dataclass, field

import numpy as np


def array(long_name, units, *axes):
    """Declare an array: a dataset of the result."""
    return field(metadata={"long_name": long_name, "units": units, "axes": axes})


def optional_array(long_name, units, *axes):
    """Declare an array that may be missing."""
    return field(default=None, metadata={"long_name": long_name, "units": units, "axes": axes})


def run_fact():
    """Declare a plain value that is an attribute of the whole file."""
    return field(metadata={"of_run": True})


@dataclass(frozen=True)
class LatticeRecord:
    """The lattice a result belongs to."""

    group = "lattice"
    shape: tuple
    mass: float
    damping: float
    omega_mx: float
    bonds_sha256: str = run_fact()
    stiffness_x: np.ndarray = array("constants of the bonds along x", "k")
    stiffness_y: np.ndarray | None = optional_array("constants of the bonds along y", "k")
    stiffness_z: np.ndarray | None = optional_array("constants of the bonds along z", "k")

    @classmethod
    def of(cls, lattice):
        """Return the record of a `pgran.physics.lattice.Lattice`."""
        names = ("stiffness_x", "stiffness_y", "stiffness_z")
        stiffness = dict(zip(names, lattice.stiffness, strict=False))
        return cls(
            lattice.shape,
            lattice.mass,
            lattice.damping,
            lattice.omega_mx,
            lattice.bonds_sha256,
            **stiffness,
        )


@dataclass(frozen=True)
class Response:
    """The frequency response of single balls (paper: freqres, phaseres).

    `nw` frequencies, `nd` detectors. A point whose `converged_reason` is not positive failed or
    missed the accuracy asked for.
    """

    group = "response"
    factorizations: int
    solve_seconds: float
    phase_slope: np.ndarray
    phase_velocity: np.ndarray
    phase_intercept: np.ndarray
    phase_fit_min: float
    phase_fit_max: float
    omega: np.ndarray = array("driving frequency, angular", "sqrt(k/m)")
    detector: np.ndarray = array("indices of the detecting balls", "1", "detector_number", "axis")
    displacement: np.ndarray = array(
        "amplitude at the detectors relative to the driven wall, convention exp(+i omega t)",
        "1", "omega", "detector_number",
    )  # fmt: skip
    amplitude: np.ndarray = array("magnitude of the displacement", "1", "omega", "detector_number")
    phase: np.ndarray = array(
        "phase, unwrapped along omega; without damping 0 or pi", "rad", "omega", "detector_number"
    )
    backward_error: np.ndarray = array("normwise backward error of the field", "1", "omega")
    error_bound: np.ndarray = array(
        "bound of the error of the displacement; NaN: none is known",
        "1", "omega", "detector_number",
    )  # fmt: skip
    at_floor: np.ndarray = array(
        "1: the bound is below error_floor, but not small against the amplitude",
        "1", "omega", "detector_number",
    )  # fmt: skip
    iterations: np.ndarray = array("Krylov iterations, adjoints included", "1", "omega")
    converged_reason: np.ndarray = array("positive: as accurate as asked", "1", "omega")
    field: np.ndarray | None = optional_array(
        "amplitudes of all balls relative to the driven wall", "1", "omega", "balls"
    )

    @property
    def failures(self):
        """How many frequencies missed the accuracy asked for."""
        return int(np.count_nonzero(self.converged_reason <= 0))


@dataclass(frozen=True)
class Modes:
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
    vector: np.ndarray | None = optional_array(
        "shape of the mode, orthonormal, its largest entry positive", "1", "omega", "balls"
    )

    @property
    def failures(self):
        """How many modes are missing or inaccurate."""
        missing = abs(self.count_expected - len(self.omega))
        return 0 if self.count_certified else max(1, missing)


@dataclass(frozen=True)
class Projection:
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
        "sum over balls of amplitude times mode shape", "1", "omega", "mode_omega"
    )
    dominant: np.ndarray = array("mode of the largest coefficient; -1: none", "1", "omega")
    error_bound: np.ndarray = array(
        "bound of the field's part in each coefficient's error; NaN: none is known", "1", "omega"
    )
    converged_reason: np.ndarray = array("positive: as accurate as asked", "1", "omega")

    @property
    def failures(self):
        """How many frequencies missed their accuracy, and how many modes are missing."""
        failed = int(np.count_nonzero(self.converged_reason <= 0))
        missing = abs(self.count_expected - len(self.mode_omega))
        return failed + (0 if self.count_certified else max(1, missing))


@dataclass(frozen=True)
class Relaxation:
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
    bond_axis: np.ndarray = array("axis of the bond that changes", "1", "trajectory", "step")
    bond_index: np.ndarray = array(
        "its index into that axis's stiffness", "1", "trajectory", "step", "axis"
    )
    stiffness: np.ndarray = array("its new constant", "k", "trajectory", "step")
    detector: np.ndarray = array("indices of the detecting balls", "1", "detector_number", "axis")
    displacement: np.ndarray = array(
        "amplitude at the detectors relative to the driven wall, entry 0 before any change",
        "1", "trajectory", "state", "detector_number",
    )  # fmt: skip
    error_bound: np.ndarray = array(
        "bound of the error of the displacement; NaN: none is known",
        "1", "trajectory", "state", "detector_number",
    )  # fmt: skip
    at_floor: np.ndarray = array(
        "1: the bound is below error_floor, but not small against the amplitude",
        "1", "trajectory", "state", "detector_number",
    )  # fmt: skip

    @property
    def amplitude(self):
        """Magnitude of the displacement."""
        return np.abs(self.displacement)

    @property
    def failures(self):
        """How many steps miss the accuracy asked for; they hold NaN."""
        return int(np.count_nonzero(np.isnan(self.displacement).any(axis=2)))


@dataclass(frozen=True)
class Spectrum:
    """The power spectrum of amplitude series, and the power law fitted to it (paper: timeres).

    Attributes
    ----------
    exponent, exponent_error : float
        psi of S(f) = scale / (2 sin(pi f))^psi, and its standard error.
    exponent_plain : float
        Minus the slope of log S against log f, aliases and all, as the paper reads it.
    scale : float
        The prefactor, in the unit of `power`.
    fit_min, fit_max : float
        Window of the fit, cycles per step.
    segment : int
        Steps to a segment.
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


@dataclass(frozen=True)
class ContinuumResponse:
    """The exact response of the homogeneous box at one point (paper: axysol, exactpl)."""

    group = "continuum"
    point: tuple
    size: tuple
    mass: float
    stiffness: float
    damping: float
    omega: np.ndarray = array("driving frequency, angular", "sqrt(K0/m)/length")
    displacement: np.ndarray = array(
        "amplitude relative to the driven wall, convention exp(+i omega t)", "1", "omega"
    )
    amplitude: np.ndarray = array("magnitude of the displacement", "1", "omega")
    phase: np.ndarray = array(
        "phase, unwrapped along omega; without damping 0 or pi", "rad", "omega"
    )
    resonance: np.ndarray = array("driven resonances, angular", "sqrt(K0/m)/length")


@dataclass(frozen=True)
class Accuracy:
    """Error against run time: one experiment by several solvers, each at several tolerances.

    A row a configuration. Errors are relative and true, against a reference with a bound of its
    own error; what is smaller than that is given as that bound.

    Attributes
    ----------
    experiment : str
        `response`, `modes` or `relaxation`.
    repeats : int
        Repeats of each timing.
    values, compared : int
        Amplitudes or modes of the experiment, and how many the reference is good enough for.
    reference_bound : float
        The relative error of the reference is at most this.
    """

    group = "accuracy"
    experiment: str
    repeats: int
    values: int
    compared: int
    reference_bound: float
    label: np.ndarray = array("configuration: solver and tolerance", "1")
    solver: np.ndarray = array("solver, after its options file", "1", "label")
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
    iterations: np.ndarray = array("Krylov iterations; -1: not counted", "1", "label")
    failures: np.ndarray = array(
        "amplitudes that miss the accuracy asked for, or modes that are missing or inaccurate",
        "1", "label",
    )  # fmt: skip
    on_front: np.ndarray = array(
        "no other configuration without failures is faster and as accurate", "1", "label"
    )


class Result:
    """Records by group."""

    def __init__(self, records, **attributes):
        """Keep them."""
        self.__dict__.update(attributes)
        for record in records:
            setattr(self, record.group, record)
