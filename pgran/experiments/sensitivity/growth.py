"""A ball of a packing grows, and the packing finds its new rest: which contacts bear what then.

Contacts open and close, stiffnesses, forces, normals and distances change. What the forces of a
network leave unbalanced, as gravity does, or rounding, is a load that stays as it is. Balls grow in
steps of at most half an overlap, so that the packing follows one path. Where contacts have changed
it is shrunk again, at once, and if that leads elsewhere, by the steps by which it was grown: if it
does not return to where it was, it has been rearranged, and what it does then depends on how it was
grown. NumPy and SciPy only.
"""

import dataclasses
import logging
import math
from typing import NamedTuple

import numpy as np

from pgran.balance.contacts import pair_numbers
from pgran.balance.equilibrium import NotBalancedError
from pgran.balance.networks import GROWTH, balls_of, changed_contacts, grown, network_of
from pgran.experiments.sensitivity.record import OUTCOMES
from pgran.experiments.sensitivity.warmth import with_vectors
from pgran.medium.network import Network
from pgran.medium.packing import total_forces
from pgran.medium.rounding import EPSILON

log = logging.getLogger("pgran")
SMOOTH, CHANGED, REARRANGED, LOST = range(len(OUTCOMES))
UNBALANCED = 1e-3  # of the mean force: what is said of a network
RETURNED = 1e-6  # of the mean overlap: how far overlaps may be from where they were


class Grown(NamedTuple):
    """A packing after a ball has grown.

    `network` is None where the balls found no rest; `opened` and `closed` count contacts, `balance`
    is the largest force left on a ball, in units of the mean one. `left` is what `Unrest` takes.
    """

    network: Network | None
    outcome: int
    opened: int = 0
    closed: int = 0
    balance: float = math.nan
    left: tuple = ()


class Packing:
    """A network as balls at rest under its contact law, which `warmth.check_law` has seen."""

    def __init__(self, network):
        self.network, packing = network, with_vectors(network)
        balls, self.contacts = balls_of(packing)
        pushes = network.force[:, None] * packing.normal
        load = -total_forces(network.bond, pushes, len(network.held))
        self.balls = dataclasses.replace(balls, load=load)
        left = np.linalg.norm((load - balls.load)[network.free], axis=1)
        self.unbalanced = float(left.max() / network.force.mean())

    def warn(self):
        """Warn where the network is no packing at rest under its contact law alone."""
        if self.unbalanced > UNBALANCED:
            log.warning(
                "the forces of the network leave %.1e of the mean one unbalanced, which is taken "
                "as a load that stays while balls grow; pgran.equilibrate finds a rest without it",
                self.unbalanced,
            )

    def grown(self, ball, growth):
        """Return the packing at rest after a ball's radius has grown by so much."""
        radius, contacts = self.balls.radius.copy(), self.contacts
        radius[ball] += growth
        rounded = growth - (radius[ball] - self.balls.radius[ball])
        overlap = contacts.overlap + rounded * np.any(contacts.pairs == ball, axis=1)
        try:
            rest = grown(self.balls, dataclasses.replace(contacts, overlap=overlap), radius)
        except NotBalancedError:
            return Grown(None, LOST)
        network = network_of(rest, self.network)
        opened, closed = changed_contacts(self.network, network)
        outcome = SMOOTH
        if opened or closed:
            returns = any(self._is_reached_from(rest, step) for step in (math.inf, GROWTH))
            outcome = CHANGED if returns else REARRANGED
        left = self._left(rest, network, abs(growth))
        return Grown(network, outcome, opened, closed, rest.residual, left)

    def _left(self, rest, network, growth):
        """Return what `Unrest` takes: forces left, rounding of overlaps, the narrowest gap.

        Overlaps are summed up step by step, those of contacts that have closed from positions.
        """
        position, both, size = rest.balls.position, (network, self.network), len(network.held)
        closed = ~np.isin(*(pair_numbers(one.bond, size) for one in both))
        moved = 4 * np.abs(position - self.balls.position).max() + growth
        blurred = network.overlap + moved + 2 * closed * np.ptp(position, axis=0).max()
        blurred *= 4 * EPSILON * (2 + growth / self.network.overlap.mean())
        forces = np.concatenate([one.force for one in both]) * 8 * EPSILON
        forces[: network.bonds] += network.stiffness * blurred
        left = total_forces(network.bond, network.force[:, None] * network.normal, size)
        left = np.linalg.norm(left + self.balls.load, axis=1)
        ends = np.concatenate([one.bond.ravel() for one in both])
        left += np.bincount(ends, np.repeat(forces, 2), size)
        apart = (rest.contacts.overlap <= 0) & np.isin(rest.contacts.pairs, network.bond).all(
            axis=1
        )
        gap = -rest.contacts.overlap[apart].max(initial=-network.radius.min())
        return left[network.free], blurred, 0.0 if rest.undecided else gap

    def _is_reached_from(self, rest, step):
        """Return whether balls shrink back to where they were: who touches, and overlaps."""
        try:
            back = grown(rest.balls, rest.contacts, self.balls.radius, step)
        except NotBalancedError:
            return False
        network = network_of(back, self.network)
        if any(changed_contacts(self.network, network)):
            return False
        orders = [np.argsort(pair_numbers(x.bond, len(x.held))) for x in (self.network, network)]
        here, there = self.network.overlap[orders[0]], network.overlap[orders[1]]
        return bool(np.abs(here - there).max() <= RETURNED * here.mean())
