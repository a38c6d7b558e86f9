"""Warm balls and cut contacts: which springs change, and by how much (paper: section 2, heater).

A warm ball expands and presses harder on its neighbours. Either the constants of all its contacts
grow by a factor; or the overlap h of each grows by dh, and by Hertz's law F = c h^(3/2), of
which k = (3/2) c h^(1/2) is the slope, k becomes sqrt(k^2 + (9/4) c^2 dh).
"""

import numpy as np

from pgran.errors import InputError


def contacts_of(medium, balls):
    """Return the contacts of some free balls, by their numbers, a row each; -1 fills rows up."""
    springs, components = medium.springs, medium.components
    half = springs.columns.shape[1] // 2
    columns = springs.columns[: medium.bonds]
    # the first component of either ball, -1 where it is held
    ends = np.stack([columns[:, :half].max(axis=1), columns[:, half:].max(axis=1)], axis=1)
    ends = np.where(ends >= 0, ends // components, -1).ravel()
    # Sorted, the ends at one ball stand side by side; end number e is of the contact e // 2.
    order = np.argsort(ends, kind="stable")
    first = np.searchsorted(ends[order], balls)
    counts = np.searchsorted(ends[order], balls, side="right") - first
    place = np.arange(max(counts.max(initial=0), 1))
    inside = place < counts[:, None]
    contacts = order[np.where(inside, first[:, None] + place, 0)] // 2
    return np.where(inside, contacts, -1)


def grown_by_overlap(medium, overlap, hertz):
    """Return how far the constants of all springs grow with the overlaps, shape (springs,).

    A contact that opens has no stiffness left; tangential springs grow by the same part. `overlap`
    is dh; `hertz` is c, unless a network knows the forces, from which c follows contact by contact.
    Raises an InputError where Hertz's law gives no such contact.
    """
    elastic = medium.springs.elastic.reshape(-1, medium.bonds)
    k, squared = elastic[0], 2.25 * hertz**2
    force, strange = getattr(medium, "force", None), k < 0
    if force is not None:
        strange |= (k > 0) & (force <= 0)
    if np.any(strange):
        raise InputError(
            f"-heat_overlap: contact {np.argmax(strange)} of the network has a negative constant, "
            "or one without a repulsive force, which is not Hertz's law; use -heat_factor"
        )
    if force is not None:
        # (9/4) c^2 = k^2 / h, h = (3/2) F / k
        squared = np.divide(k**3, 1.5 * force, out=np.zeros_like(k), where=force > 0)
    growth = np.sqrt(np.maximum(k * k + squared * overlap, 0.0)) - k
    part = np.divide(growth, k, out=np.zeros_like(k), where=k != 0)
    return np.concatenate([growth, (elastic[1:] * part).ravel()])


def changes(medium, contacts, growth):
    """Return the springs of groups of contacts, and how far their constants change.

    `growth` is that of each spring's constant. Contacts have the shape (count, c), springs and
    changes (count, r); -1 fills up, and stands for springs that do not change.
    """
    # springs stand block by block, one of each for every contact
    grown = growth.reshape(-1, medium.bonds)
    blocks = np.flatnonzero(np.any(grown, axis=1) | (np.arange(len(grown)) == 0))
    springs = [np.where(contacts >= 0, contacts + b * medium.bonds, -1) for b in blocks]
    springs = np.concatenate(springs, axis=1)
    return _changed(springs, np.where(springs >= 0, growth[springs], 0.0))


def cuts(medium, s):
    """Return the springs of each contact, and what its being cut takes away at the drive s.

    Its dashpots, too. As `changes` does; what is zero at one s > 0 is so at any other one.
    """
    constants = medium.springs.constants + s * medium.damping * medium.springs.damped
    springs = np.arange(len(constants)).reshape(-1, medium.bonds).T
    return _changed(springs, -constants[springs])


def _changed(springs, delta):
    """Return groups of springs, -1 for those that do not change, and the changes."""
    return np.where(delta != 0, springs, -1), delta
