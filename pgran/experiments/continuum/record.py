"""The record of the exact box."""

from dataclasses import dataclass

import numpy as np

from pgran.store.record import PHASE, Record, array


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
        "1", "omega", dtype=complex, row=True,
    )  # fmt: skip
    amplitude: np.ndarray = array("magnitude of the displacement", "1", "omega")
    phase: np.ndarray = array(PHASE, "rad", "omega")
    resonance: np.ndarray = array("driven resonances, angular", "sqrt(K0/m)/length")
