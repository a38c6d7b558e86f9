"""How many modes lie below a frequency: the steps that the spectrum makes."""

import contextlib

from pgran.driven.counting import ATTEMPTS, MARGIN, ModeCounter
from pgran.experiments.modes.condensation import Condensation
from pgran.experiments.modes.slicing import hermitian_operators

# In mean distances of eigenvalues: how far a count stays clear of them; the second where rounding
# is larger than the first, the others, down to MARGIN of |K|, where one is closer.
CLEARANCES = (0.01, 0.1, 1e-4, 1e-6, 1e-8, 1e-10)


@contextlib.contextmanager
def counter_of(lattice):
    """Return, for a `with`, what counts the eigenvalues of K: `below`, `norm`, `order`.

    Not collective. Boxes of a lattice are condensed; networks, which have no boxes, are factored.

    Parameters
    ----------
    lattice : pgran.medium.lattice.Lattice or pgran.medium.network.Network
        In its own unit.
    """
    if lattice.is_grid:
        yield Condensation(lattice)
        return
    with hermitian_operators(lattice) as operators, ModeCounter(operators.K, lattice) as counter:
        yield counter


def count_below(counter, shift):
    """Return how many eigenvalues lie below a shift, and by how much less it was counted at.

    Not collective. Where an eigenvalue is so close that it is open on which side it lies, the shift
    is moved down, below 0 where K may be indefinite: that eigenvalue, and those equal to it, are
    not counted.

    Parameters
    ----------
    counter : Condensation or ModeCounter
    shift : float

    Returns
    -------
    count : int or None
        Certain for shift - margin; None if no count is certain.
    margin : float
    """
    if shift <= 0 and counter.semidefinite:
        return 0, 0.0
    if shift > (1 + 1e-12) * counter.norm:  # which is rounded itself
        return counter.order, 0.0
    unit, margin = counter.norm / counter.order, MARGIN * counter.norm
    for part in CLEARANCES:
        count = counter.below(shift, part * unit) if part * unit > margin else None
        if count is not None:
            return count, 0.0
    for _ in range(ATTEMPTS):
        if shift <= margin and counter.semidefinite:
            return 0, shift
        count = counter.below(shift - margin, 0.5 * margin)
        if count is not None:
            return count, margin
        margin *= 4
    return None, margin
