"""The record of Green's functions between balls."""

from dataclasses import dataclass

import numpy as np

from pgran.store.record import FLOOR, Frequencies, array, attribute, attribute_array, error_of

PAIRS, OWN = ("omega", "receiver_number", "source_number"), ("omega", "source_number")
NO_BOUND = "bound of its error; infinite: none is known"


@dataclass(frozen=True, eq=False, repr=False)
class Green(Frequencies):
    """Displacements under unit forces, G = e_d^T S^-1 e_p, and local densities of states.

    Forces and displacements are along one `direction`, (axes,); (1,) where balls have one
    displacement. A frequency without a positive `converged_reason` failed or missed the accuracy
    asked for, as where no bound is known.
    """

    group = "green"
    direction: np.ndarray = attribute_array("of forces and displacements", "1", "component")
    source: np.ndarray = array(
        "indices of the balls that are pushed", "1", "source_number", "axis", dtype=int
    )
    receiver: np.ndarray = array(
        "indices of the balls that are heard", "1", "receiver_number", "axis", dtype=int
    )
    mass: np.ndarray = array("mass of each ball that is pushed", "m", "source_number")
    green: np.ndarray = array(
        "displacement under a unit force, convention exp(+i omega t)", "1/k", *PAIRS,
        dtype=complex, row=True,
    )  # fmt: skip
    error_bound: np.ndarray = error_of(green, NO_BOUND)
    at_floor: np.ndarray = array(FLOOR, "1", *PAIRS, dtype=np.int8)
    local_density: np.ndarray = array(
        "local density of states, -(2 omega m / pi) Im G of each ball that is pushed",
        "sqrt(m/k)", *OWN,
    )  # fmt: skip
    local_density_bound: np.ndarray = error_of(local_density, NO_BOUND)
    backward_error: np.ndarray = array(
        "largest normwise backward error of the fields", "1", "omega", row=True
    )

    moments: int | None = attribute(
        "how many moments of each source gave it; 0 or none: factorizations alone",
        optional=True,
    )

    @property
    def detector(self):
        """The balls that are heard."""
        return self.receiver

    @property
    def displacement(self):
        """The displacements under unit forces."""
        return self.green

    @property
    def amplitude(self):
        """Their magnitudes."""
        return np.abs(self.green)

    @property
    def power(self):
        """The mean power that a unit force on each source puts in, -omega Im G / 2, (nw, ns)."""
        return np.pi * self.local_density / (4 * self.mass)
