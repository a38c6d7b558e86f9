"""Balls that repel where they overlap: contacts, energy, forces, second derivatives.

Two balls whose overlap h = R_i + R_j - |x_j - x_i| is positive repel with F = c h^alpha; alpha = 1
is harmonic, 3/2 Hertz. c belongs to the material and, where alpha > 1, to the curvature of both:
c = C (R_i R_j / (R_i + R_j))^(alpha - 1), which for Hertz is 4/3 E* sqrt(R*).

Displaced, with x = (X + u) e^eps about a reference X, whose contacts have the vectors v0 of length
r0 and the overlaps h0,

    v = v0 + u_j - u_i,   h = h0 - (2 v0 . du + du . du) / (|v| + r0) - (e^eps - 1) |v|,

so that no overlap is a small difference of positions: those would balance no better than eps L / h
of the mean force. H = sum of F h / (alpha + 1) - load . u + P V is the enthalpy; at a fixed box eps
is 0 and P V is left out. NumPy and SciPy only.
"""

import dataclasses
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pgran.medium.packing import ContactLaw, near_pairs, total_forces
from pgran.medium.springs import differences


def pair_numbers(pairs, balls):
    """Return a number of each pair (n, 2), the same in whichever order its two balls are."""
    return np.sort(pairs, axis=1) @ [balls, 1]


@dataclass(frozen=True, eq=False)
class Balls:
    """N balls in d dimensions: where they are, what they are, and what acts on them.

    `held` ones (N,) do not move; `box` are the periods (d,), infinite where there is none; `load`
    (N, d) is what else pulls at them.
    """

    position: np.ndarray
    radius: np.ndarray
    held: np.ndarray
    box: np.ndarray
    law: ContactLaw
    load: np.ndarray | float = 0.0

    def of(self, chosen):
        """Return some of them."""
        each = {name: getattr(self, name)[chosen] for name in ("position", "radius", "held")}
        load = self.load[chosen] if np.ndim(self.load) else self.load
        return dataclasses.replace(self, load=load, **each)


@dataclass(frozen=True, eq=False)
class Contacts:
    """Pairs (n, 2) of balls that touch or are near: the reference of increments.

    `away` (n, d) leads from the first to the second, `overlap` (n,) is negative across a gap,
    `constants` are c of F = c h^alpha.
    """

    pairs: np.ndarray
    away: np.ndarray
    overlap: np.ndarray
    constants: np.ndarray

    def of(self, chosen):
        """Return some of them."""
        return Contacts(*(getattr(self, item.name)[chosen] for item in dataclasses.fields(self)))

    def grown(self, law, before, after):
        """Return the contacts of balls whose radii (N,) have changed where they are."""
        old, new = before[self.pairs].T, after[self.pairs].T
        overlap = self.overlap + np.sum(new - old, axis=0)
        constants = self.constants * (law.constants(*new) / law.constants(*old))
        return dataclasses.replace(self, overlap=overlap, constants=constants)


def listed(balls, contacts=None, *, reach):
    """Return the pairs of balls nearer than `reach` to touching; known contacts keep their numbers.

    What is in the list already is exact; others follow from positions.
    """
    pairs, away, distance = near_pairs(balls.position, balls.radius, balls.box, reach)
    overlap = balls.radius[pairs].sum(axis=1) - distance
    moving = ~balls.held[pairs].all(axis=1)
    found = Contacts(pairs, away, overlap, balls.law.constants(*balls.radius[pairs].T)).of(moving)
    if contacts is None:
        return found
    contacts = contacts.of(contacts.overlap > -reach)
    numbers = [pair_numbers(each.pairs, len(balls.radius)) for each in (found, contacts)]
    added = found.of(~np.isin(*numbers))
    both = zip(dataclasses.astuple(contacts), dataclasses.astuple(added), strict=True)
    return Contacts(*map(np.concatenate, both))


class State(NamedTuple):
    """Contacts after displacements u (N, d) of balls and the growth eps of the box."""

    u: np.ndarray
    growth: float
    normal: np.ndarray  # (n, d); what follows (n,)
    distance: np.ndarray
    overlap: np.ndarray
    force: np.ndarray

    @property
    def work(self):
        """F h of each contact: alpha + 1 times its energy."""
        return self.force * np.maximum(self.overlap, 0.0)


class Motion:
    """Balls, displaced about a reference, with their energy and its derivatives."""

    def __init__(self, balls, contacts, pressure=None):
        self.balls, self.contacts, self.pressure = balls, contacts, pressure
        self.free = np.flatnonzero(~balls.held)
        self.number = np.full(len(balls.held), -1)
        self.number[self.free] = np.arange(len(self.free))
        self.length = np.linalg.norm(contacts.away, axis=1)
        self.volume = math.prod(balls.box) if pressure is not None else 0.0
        self.size = balls.position.shape[1]

    def state(self, u, growth):
        """Return the State after displacements and a growth."""
        i, j = self.contacts.pairs.T
        moved, away = u[j] - u[i], self.contacts.away
        vector = away + moved
        distance = np.linalg.norm(vector, axis=1)
        change = np.einsum("nd,nd->n", 2 * away + moved, moved) / (distance + self.length)
        overlap = self.contacts.overlap - change - math.expm1(growth) * distance
        force = self.balls.law.force(self.contacts.constants, overlap)
        normal = vector / distance[:, None]
        return State(u, growth, normal, distance * math.exp(growth), overlap, force)

    def of_all(self, step):
        """Return the displacements (N, d) of all balls from those of the free ones."""
        displacement = np.zeros((len(self.number), self.size))
        displacement[self.free] = step.reshape(-1, self.size)
        return displacement

    def forces(self, state):
        """Return -dH/du of the free balls, shape (free, d), and -dH/deps."""
        repulsion = state.force[:, None] * state.normal
        forces = total_forces(self.contacts.pairs, repulsion, len(self.number))
        swelling = 0.0
        if self.pressure is not None:
            swelling = state.force @ state.distance - self.size * self.pressure * self._volume(
                state
            )
        return (forces + self.balls.load)[self.free] * math.exp(state.growth), swelling

    def _volume(self, state):
        """Return V, whose derivative by eps is d V."""
        return self.volume * math.exp(self.size * state.growth)

    def residual(self, state, forces, swelling):
        """Return the larger of the force on a ball and the part by which the pressure is wrong."""
        mean = state.force[state.force > 0].mean()
        largest = np.linalg.norm(forces, axis=1).max(initial=0.0) / mean
        if self.pressure is None:
            return largest
        return max(largest, abs(swelling) / (self.size * self.pressure * self._volume(state)))

    def enthalpy_change(self, before, after, step):
        """Return H after a step less H before it, summed contact by contact."""
        energy = after.work - before.work
        change = energy.sum() / (self.balls.law.power + 1) - np.sum(self.balls.load * step)
        if self.pressure is not None:
            old, new = self.size * before.growth, self.size * after.growth
            change += self.pressure * self.volume * math.exp(old) * math.expm1(new - old)
        return change

    def matrix(self, state):
        """Return d2H/du2 of the free balls, and with a pressure d2H/du deps and d2H/deps2."""
        from scipy.sparse import bsr_matrix  # here: SciPy takes its time

        touching = np.flatnonzero(state.force > 0)
        n, r, F = (x[touching] for x in (state.normal, state.distance, state.force))
        stiffness = self.balls.law.power * F / state.overlap[touching]
        pull = F / r
        blocks = (stiffness + pull)[:, None, None] * n[:, :, None] * n[:, None, :]
        blocks -= pull[:, None, None] * np.eye(self.size)
        blocks = bsr_matrix((blocks, np.arange(len(n)), np.arange(len(n) + 1)))
        ends = self.number[self.contacts.pairs[touching]]
        parted = differences(ends, self.size, len(self.free))
        K = (parted.T @ blocks @ parted).tocsc() * math.exp(2 * state.growth)
        if self.pressure is None:
            return K, None, None
        along = (stiffness * r - F)[:, None] * n
        border = total_forces(self.contacts.pairs[touching], along, len(self.number))
        corner = np.sum((stiffness * r - F) * r)
        corner += self.size**2 * self.pressure * self._volume(state)
        return K, border[self.free].ravel() * math.exp(state.growth), corner
