"""How far the contacts of a medium overlap, and by which law they push: where springs end.

A contact that overlaps by h pushes by F(h) = C h^alpha, and is a spring of k = dF/dh for motions
that are small against h: it opens where these part its balls by h. A network knows F and k of each
contact, and alpha, so h = alpha F / k; a lattice knows k, and its c of Hertz's law if it is given
one, so h = (k / (3/2 c))^2.
"""

from dataclasses import dataclass

import numpy as np

from pgran.errors import InputError

NO_LAW = (
    "the network does not know its contact law and forces: pgran pack makes some that do, "
    "and pgran import with --law hertz or harmonic and forces as pre-stress"
)


@dataclass(frozen=True, eq=False)
class Overlaps:
    """The contacts of a medium under their law, arrays of the shape (contacts,).

    `contact` are their numbers, which are those of their rows in the first block of B, `springs.B`,
    and of `constants`: all of a network, of a lattice the bonds with k > 0. `overlap` is h, at
    least 0, `constant` is C and `power` alpha of F = C h^alpha, which with h gives F and k of the
    medium, but for rounding.
    """

    contact: np.ndarray
    overlap: np.ndarray
    constant: np.ndarray
    power: float

    def force(self, stretch=0.0):
        """Return F(h - e) of contacts stretched by e, (..., contacts); 0 of those that are open."""
        return self.constant * np.maximum(self.overlap - stretch, 0.0) ** self.power

    def stiffness(self, stretch=0.0):
        """Return dF/dh at h - e, like `force`."""
        height = self.overlap - stretch
        closed = self.power * self.constant * np.maximum(height, 0.0) ** (self.power - 1)
        return np.where(height > 0, closed, 0.0)  # 0^0 is 1


def overlaps_of(medium):
    """Return the `Overlaps` of a medium; raise an InputError that says why they are unknown."""
    if medium.is_grid:
        if medium.hertz is None:
            raise InputError("-bonds_hertz: needed, c of F = c h^(3/2): how far contacts overlap")
        contact = np.flatnonzero(medium.constants)
        overlap = (medium.constants[contact] / (1.5 * medium.hertz)) ** 2
        return Overlaps(contact, overlap, np.full(len(contact), medium.hertz), 1.5)
    if medium.overlap is None:
        raise InputError(NO_LAW)
    force, overlap, power = medium.force, medium.overlap, medium.power
    for contact in np.flatnonzero(force < 0 if power == 1 else force <= 0)[:1]:
        raise InputError(f"contact {contact} bears no repulsive force: no contact law has it")
    constant = medium.stiffness / (power * overlap ** (power - 1))  # harmonic: k, at h = 0 too
    return Overlaps(np.arange(medium.bonds), overlap, constant, power)


def are_lengths(medium, overlaps):
    """Return whether overlaps are in a medium's unit of length, as they fit into its spacing.

    That c of a lattice is in force / spacing^(3/2) nothing else says.
    """
    from pgran.medium.packing import DEEP

    return not medium.is_grid or bool(np.max(overlaps.overlap, initial=0.0) <= DEEP)
