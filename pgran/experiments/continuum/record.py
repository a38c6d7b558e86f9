"""The record of the exact box."""

from dataclasses import dataclass

import numpy as np

from pgran.store.record import PHASE, Record, array, attribute


@dataclass(frozen=True, eq=False, repr=False)
class ContinuumResponse(Record):
    """The exact response of the homogeneous box at one point (paper: axysol, exactpl)."""

    group = "continuum"
    point: tuple[float, ...] = attribute("where the amplitude is taken", "length")
    size: tuple[float, ...] = attribute("extent of the box along each axis", "length")
    mass: float = attribute("mass per area", "m")
    stiffness: float = attribute("K0", "k")
    damping: float = attribute("beta", "sqrt(K0 m) length")
    omega: np.ndarray = array("driving frequency, angular", "sqrt(K0/m)/length")
    displacement: np.ndarray = array(
        "amplitude relative to the driven wall, convention exp(+i omega t)",
        "1", "omega", dtype=complex, row=True,
    )  # fmt: skip
    amplitude: np.ndarray = array("magnitude of the displacement", "1", "omega")
    phase: np.ndarray = array(PHASE, "rad", "omega")
    resonance: np.ndarray = array("driven resonances, angular", "sqrt(K0/m)/length")
