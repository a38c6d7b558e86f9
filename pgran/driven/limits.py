"""What bounds the response of a lattice or a network, in its own unit."""

from dataclasses import dataclass


@dataclass(frozen=True, eq=False)
class Limits:
    """Norms from which bounds follow.

    Attributes
    ----------
    stability : float
        |S(i omega) x|_2 >= omega stability |x|_2: beta lambda_min(C).
    stiffness, damping, mass : float
        No less than the norms of |K|, |C| and |M|, entries taken by magnitude, all damping in C.
    drive, drive_damping : float
        |f(s)|_2 is at most drive + |s| drive_damping.
    """

    stability: float
    stiffness: float
    damping: float
    mass: float
    drive: float
    drive_damping: float
