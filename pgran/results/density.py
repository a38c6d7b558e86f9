"""The record of how many modes there are below each frequency."""

from dataclasses import dataclass

import numpy as np

from pgran.physics.modes import weyl
from pgran.record import Record, array, attribute


@dataclass(frozen=True, eq=False, repr=False)
class Density(Record):
    """How many normal modes lie below each of N frequencies, unstable ones included.

    A count is exact where `certified`; where a mode is so close to the frequency that it is open on
    which side it lies, the count is that at `omega - margin`. Unstable modes, whose omega^2 < 0,
    have a negative omega; `unstable` says how many there are, without those that rounding hides at
    0, and -1 if that is not certain. Between neighbouring frequencies the
    `density` is the modes there, per ball and per `omega_mx`: its integral over omega / omega_mx is
    the number of modes a ball, NaN next to a count that is not certified.
    """

    group = "density"
    balls: int
    omega_mx: float
    solve_seconds: float
    unstable: int = attribute(since=5)
    omega: np.ndarray = array("frequency, angular", "sqrt(k/m)")
    count: np.ndarray = array("how many modes lie below; -1: not certain", "1", "omega", dtype=int)
    certified: np.ndarray = array("the count is exact at omega - margin", "1", "omega", dtype=bool)
    margin: np.ndarray = array(
        "by how much less than omega the modes are counted at", "sqrt(k/m)", "omega"
    )
    middle: np.ndarray = array("middle between neighbouring frequencies, angular", "sqrt(k/m)")
    density: np.ndarray = array("modes there per ball and omega_mx", "1", "middle")

    @property
    def failures(self):
        """How many counts are not certified."""
        return int(np.count_nonzero(~self.certified))

    @staticmethod
    def weyl(lattice, omega):
        """Return Weyl's law for the record of a lattice, None where it has none.

        Not collective. That is a lattice of two axes whose bonds are all equal.

        Parameters
        ----------
        lattice : pgran.results.LatticeRecord or pgran.results.NetworkRecord
        omega : numpy.ndarray
        """
        if lattice.group != "lattice" or len(lattice.shape) != 2:
            return None
        bonds = np.concatenate([k.ravel() for k in lattice.stiffness])
        if not np.all(bonds == bonds[0]):
            return None
        return weyl(omega, lattice.shape, np.sqrt(bonds[0] / lattice.mass))
