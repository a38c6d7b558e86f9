"""How many modes lie below a frequency: the steps that the spectrum makes."""

import contextlib

from pgran.solve.condensation import Condensation
from pgran.solve.counting import ATTEMPTS, ModeCounter
from pgran.solve.slicing import hermitian_operators

# In mean distances of eigenvalues: how far a count stays clear of them, the next one where rounding
# is larger than that; and how far it is moved first where one is closer.
CLEARANCES, MARGIN = (0.01, 0.1), 1e-6


@contextlib.contextmanager
def counter_of(lattice):
    """Return, for a `with`, what counts the eigenvalues of K: `below`, `norm`, `order`.

    Not collective. Boxes of a lattice are condensed; networks, which have no boxes, are factored.

    Parameters
    ----------
    lattice : pgran.physics.lattice.Lattice or pgran.physics.network.Network
        In its own unit.
    """
    if not lattice.irregular:
        yield Condensation(lattice)
        return
    with hermitian_operators(lattice) as operators, ModeCounter(operators.K, lattice) as counter:
        yield counter


def count_below(counter, shift):
    """Return how many eigenvalues lie below a shift, and by how much less it was counted at.

    Not collective. Where an eigenvalue is so close that it is open on which side it lies, the shift
    is moved down: that eigenvalue, and those equal to it, are not counted.

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
    unit = counter.norm / counter.order
    for part in CLEARANCES:
        count = counter.below(shift, part * unit)
        if count is not None:
            return count, 0.0
    margin = MARGIN * unit
    for _ in range(ATTEMPTS):
        if shift <= margin and counter.semidefinite:
            return 0, shift
        count = counter.below(shift - margin, 0.5 * margin)
        if count is not None:
            return count, margin
        margin *= 4
    return None, margin
