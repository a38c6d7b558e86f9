"""What bounds the response of a lattice or a network, in its own unit."""

from dataclasses import dataclass


@dataclass(frozen=True, eq=False)
class Limits:
    """Norms from which bounds of a response follow, in the medium's own unit.

    |S(i omega) x|_2 >= omega stability |x|_2, with stability = beta lambda_min(C). The norms of
    |K|, |C| and |M|, entries taken by magnitude, all damping in C, are no more than `stiffness`,
    `damping` and `mass`; |f(s)|_2 is at most drive + |s| drive_damping.
    """

    stability: float
    stiffness: float
    damping: float
    mass: float
    drive: float
    drive_damping: float
