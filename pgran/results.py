"""What scenes return: frozen dataclasses of plain values and NumPy arrays.

The metadata of a field say what it is, its unit, and its axes. `pgran.store` writes arrays as
datasets with these, and plain values as attributes. An axis is named after the array that holds its
coordinates; `balls` stands for the axes of the lattice.
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
        """Return the record of a `pgran.lattice.Lattice`."""
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
    detector: np.ndarray = array("indices of the detecting balls", "1")
    displacement: np.ndarray = array(
        "amplitude at the detectors relative to the driven wall, convention exp(+i omega t)",
        "1", "omega", "detector",
    )  # fmt: skip
    amplitude: np.ndarray = array("magnitude of the displacement", "1", "omega", "detector")
    phase: np.ndarray = array("phase, unwrapped along omega", "rad", "omega", "detector")
    backward_error: np.ndarray = array("normwise backward error of the field", "1", "omega")
    error_bound: np.ndarray = array(
        "bound of the error of the displacement; NaN: none is known", "1", "omega", "detector"
    )
    iterations: np.ndarray = array("Krylov iterations, adjoints included", "1", "omega")
    converged_reason: np.ndarray = array("positive: as accurate as asked", "1", "omega")
    field: np.ndarray | None = optional_array(
        "amplitudes of all balls relative to the driven wall", "1", "omega", "balls"
    )

    @property
    def failures(self):
        """How many frequencies missed the accuracy asked for."""
        return int(np.count_nonzero(self.converged_reason <= 0))
