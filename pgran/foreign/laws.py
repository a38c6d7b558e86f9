"""The law F = c h^power of contacts, as far as the digits of forces and overlaps tell.

c is one number, or goes like R^(power - 1), R = R_i R_j / (R_i + R_j), as of one material: then
F R = c (h R)^power. `scales` are 1 and R, `error` is what rounding changes h by, at most.
"""

from typing import NamedTuple

import numpy as np

from pgran.medium.packing import POWERS

NEAR, MOST = 2.0, 0.9  # within how many errors a law must hold, for which part of the contacts
CLEAR, FEWEST = 10.0, 9  # errors that an overlap must have to tell the power, and how many do
UNLIKE = 0.1  # of two powers, beyond three standard errors


class Power(NamedTuple):
    """The power of the law, its standard error, and which contacts tell it."""

    value: float
    error: float
    clear: np.ndarray

    def differs(self, power):
        """Return whether it is another one for certain."""
        return abs(self.value - power) > UNLIKE + 3 * self.error

    def __str__(self):
        """Say it, with the law that has it."""
        laws = [name for name, power in POWERS.items() if not self.differs(power)]
        fits = f": --law {laws[0]} fits" if len(laws) == 1 else ""
        return f"forces go like h^({self.value:.3g} +- {self.error:.1g}), h the overlap{fits}"


def power_of(force, overlap, error, scales):
    """Return the `Power` of contacts, None where too few, or too similar, overlaps are clear."""
    clear = (force > 0) & (overlap > CLEAR * error) & np.isfinite(overlap)
    if np.count_nonzero(clear) < FEWEST or np.ptp(np.log(overlap[clear])) < 0.5:
        return None
    F, h, weight = force[clear], overlap[clear], (overlap / error)[clear]
    scales = [np.broadcast_to(r, clear.shape)[clear] for r in scales]
    lines = [np.polyfit(np.log(F * r), np.log(h * r), 1, w=weight, cov=True) for r in scales]
    (slope, _), spread = min(lines, key=lambda line: line[1][0, 0])  # of h by F, which is exact
    return Power(1 / slope, np.sqrt(spread[0, 0]) / slope**2, clear)


def overlaps_of(force, overlap, error, scales, power):
    """Return overlaps by forces under a law, and by which part one is off, at most.

    Contacts that do not obey it keep their own; so do all where more than a few do not.
    """
    pushing, found = force > 0, []
    for scale in scales:
        unit = (np.where(pushing, force, 0.0) * scale) ** (1 / power) / scale
        size, off = (_median(x / unit, unit / error) for x in (overlap, error))
        misfits = (np.abs(overlap - size * unit) / error)[pushing]
        if np.count_nonzero(misfits <= NEAR) >= MOST * len(misfits):
            found.append((misfits.sum(), off / size, size * unit))
    off, own = min(found, key=lambda each: each[0])[1:] if found else (0.0, np.inf)
    off += sum(np.abs(other / own - 1)[pushing].max(initial=0.0) for *_, other in found)
    obeying = pushing & (np.abs(overlap - own) <= NEAR * error)
    off = np.where(obeying, off, error / overlap)[pushing]
    return np.where(obeying, own, overlap), off.max(initial=0.0)


def _median(values, weights):
    """Return the median of values that have weights."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return values[order[np.searchsorted(total, total[-1] / 2)]]
