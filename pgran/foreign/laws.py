"""The law F = c h^power of contacts, as far as the digits of overlaps h tell.

c is one number, or goes like R^(power - 1), R = R_i R_j / (R_i + R_j), as of one material: then
F R = c (h R)^power. `scales` are 1 and R, `error` is what rounding changes h by, at most.
"""

import numpy as np

from pgran.medium.packing import POWERS

NEAR, MOST = 2.0, 0.9  # within how many errors a law must hold, for which part of the contacts
CLEAR, FEWEST = 10.0, 9  # errors that an overlap must have to tell the power, and how many do,
ALIKE = 0.5  # unless their logarithms lie as near to each other
FINE = 1e-8  # of an overlap: errors that need no law
UNLIKE = 0.1  # of two powers, beyond three standard errors


def power_of(force, overlap, error, scales):
    """Return the power, how far another is from it for certain, which contacts tell, and words.

    Too few overlaps, or too similar ones, tell nothing: there are no words then.
    """
    weight = overlap / error
    clear = (force > 0) & (weight > CLEAR) & (weight < np.inf)
    F, h, weight = np.log(force[clear]), np.log(overlap[clear]), weight[clear]
    if len(h) < FEWEST or min(np.ptp(F), np.ptp(h)) < ALIKE:
        return np.nan, np.inf, clear, ""
    logs = [np.broadcast_to(np.log(r), clear.shape)[clear] for r in scales]
    lines = [np.polyfit(F + r, h + r, 1, w=weight, cov=True) for r in logs]
    best = int(np.argmin([spread[0, 0] for _, spread in lines]))
    (line, spread), x = lines[best], F + logs[best]  # of h by F, whose scatter makes it flatter
    power, scatter = 1 / line[0], np.var(h + logs[best] - np.polyval(line, x))
    sigma = power**2 * (np.sqrt(spread[0, 0]) + power * scatter / np.var(x))
    far = UNLIKE + 3 * sigma
    laws = [f": --law {law} fits" for law, known in POWERS.items() if abs(known - power) < far]
    fits = laws[0] if len(laws) == 1 else ""
    return power, far, clear, f"forces go like h^({power:.3g} +- {sigma:.1g}), h the overlap{fits}"


def overlaps_of(force, overlap, error, scales, power):
    """Return overlaps by forces under a law, and by which part one is off, at most.

    Contacts that do not obey it, or have all digits, keep their own; all where few obey it.
    """
    pushing, found = force > 0, []
    for scale in scales:
        unit = (np.where(pushing, force, 0.0) * scale) ** (1 / power) / scale
        size, off = (_median(x / unit, unit / error) for x in (overlap, error))
        misfits = (np.abs(overlap - size * unit) / error)[pushing]
        if np.count_nonzero(misfits <= NEAR) >= MOST * len(misfits):
            found.append((misfits.sum(), off / size, size * unit))
    _, off, own = min(found, key=lambda each: each[0], default=(0, 0, np.inf))
    off += sum(np.abs(other / own - 1)[pushing].max(initial=0.0) for *_, other in found)
    obeying = pushing & (np.abs(overlap - own) <= NEAR * error) & (error > FINE * overlap)
    off = np.where(obeying, off, error / overlap)[pushing].max(initial=0.0)
    return np.where(obeying, own, overlap), off


def _median(values, weights):
    """Return the median of values that have weights."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return values[order[np.searchsorted(total, total[-1] / 2)]]
