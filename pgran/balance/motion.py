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

from pgran.errors import InputError
from pgran.medium.packing import nearest_images, total_forces
from pgran.medium.springs import differences


@dataclass(frozen=True)
class ContactLaw:
    """F = c h^power, with c = modulus (R_i R_j / (R_i + R_j))^(power - 1)."""

    power: float
    modulus: float = 1.0

    def constants(self, first, second):
        """Return c of contacts between balls of these radii."""
        return self.modulus * (first * second / (first + second)) ** (self.power - 1)

    def force(self, constants, overlap):
        """Return F; none where balls do not overlap."""
        return constants * np.maximum(overlap, 0.0) ** self.power

    def stiffness(self, constants, overlap):
        """Return dF/dh; none where balls do not overlap."""
        touching = overlap > 0
        height = np.where(touching, overlap, 1.0)
        return np.where(touching, self.power * constants * height ** (self.power - 1), 0.0)


def near_pairs(position, radius, box, reach):
    """Return the pairs (n, 2) of balls nearer than `reach` to touching, and the vectors between.

    `box` are the periods along each axis, infinite where there is none. Raises InputError where
    the box is so small that a ball could touch two images of another.
    """
    from scipy.spatial import cKDTree  # here: SciPy takes its time

    cutoff, periodic = 2 * radius.max() + reach, np.isfinite(box)
    if np.any(box[periodic] < 2 * cutoff):
        raise InputError(
            f"the box is {box[periodic].min():.4g} wide, less than {2 * cutoff:.4g}: "
            "balls could touch two images of another; more balls are needed"
        )
    inside = position - position.min(axis=0)
    inside[:, periodic] = position[:, periodic] % box[periodic]
    inside[:, periodic] *= inside[:, periodic] < box[periodic]  # rounded up to the period
    tree = cKDTree(inside, boxsize=np.where(periodic, box, 0.0))
    pairs = tree.query_pairs(cutoff, output_type="ndarray")
    pairs = pairs[np.lexsort(pairs.T[::-1])]
    away, _ = nearest_images(position[pairs[:, 1]] - position[pairs[:, 0]], box)
    near = np.linalg.norm(away, axis=1) < radius[pairs].sum(axis=1) + reach
    return pairs[near], away[near]


def pair_numbers(pairs, balls):
    """Return a number of each pair (n, 2), the same in whichever order its two balls are."""
    return np.sort(pairs, axis=1) @ [balls, 1]


SOLVE = 20  # multiplications of a factorization that take as long as an entry of a solve
FEWEST = 20  # solves that a factorization must cost, or it is not kept
INEXACT = 1e-6  # the part of a step that conjugate gradients leave out


class Factors:
    """Factors of the last matrix that was factored, which solve with others near it, too.

    Where a step opens or closes a few contacts, seven or so solves do. In three dimensions the time
    of a factorization grows like N^2: of 5000 spheres it is that of 50 solves. Where it is that of
    `FEWEST` or less, factors are not kept.
    """

    def __init__(self):
        self.factors, self.solves = None, 0

    def keep(self, factors):
        """Keep factors, if they are worth it."""
        lengths = np.diff(factors.L.indptr).astype(float)
        self.solves = int(lengths @ lengths / (SOLVE * lengths.sum()))
        self.factors = factors if self.solves >= FEWEST else None

    def solve(self, K, right):
        """Return x of K x = right by conjugate gradients, None where factoring K is cheaper.

        None, too, where K is seen not to be positive definite. In any case x leads downhill.
        """
        if self.factors is None:
            return None
        x, residual = np.zeros_like(right), right.copy()
        along = near = self.factors.solve(residual)
        size = first = residual @ near
        for _ in range(self.solves):
            product = K @ along
            curvature = along @ product
            if not curvature > 0:
                break
            x += size / curvature * along
            residual -= size / curvature * product
            near = self.factors.solve(residual)
            before, size = size, residual @ near
            if size <= INEXACT**2 * first:
                return x
            along = near + size / before * along
        self.factors = None
        return None


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


class State(NamedTuple):
    """Contacts after a displacement: arrays (n,), and (n, d) of the normals."""

    normal: np.ndarray
    distance: np.ndarray
    overlap: np.ndarray
    force: np.ndarray

    @property
    def work(self):
        """F h of each contact: alpha + 1 times its energy."""
        return self.force * np.maximum(self.overlap, 0.0)


def listed(balls, contacts=None, *, reach):
    """Return the pairs of balls nearer than `reach` to touching; known contacts keep their numbers.

    What is in the list already is exact; others follow from positions.
    """
    pairs, away = near_pairs(balls.position, balls.radius, balls.box, reach)
    overlap = balls.radius[pairs].sum(axis=1) - np.linalg.norm(away, axis=1)
    moving = ~balls.held[pairs].all(axis=1)
    found = Contacts(pairs, away, overlap, balls.law.constants(*balls.radius[pairs].T)).of(moving)
    if contacts is None:
        return found
    contacts = contacts.of(contacts.overlap > -reach)
    numbers = [pair_numbers(each.pairs, len(balls.radius)) for each in (found, contacts)]
    added = found.of(~np.isin(*numbers))
    both = zip(dataclasses.astuple(contacts), dataclasses.astuple(added), strict=True)
    return Contacts(*map(np.concatenate, both))


class Motion:
    """Balls, displaced about a reference, with their energy and its derivatives."""

    def __init__(self, balls, contacts, pressure=None):
        self.balls, self.contacts, self.pressure = balls, contacts, pressure
        self.factors = Factors()  # of a matrix on the way
        self.free = np.flatnonzero(~balls.held)
        self.number = np.full(len(balls.held), -1)
        self.number[self.free] = np.arange(len(self.free))
        self.length = np.linalg.norm(contacts.away, axis=1)
        self.volume = math.prod(balls.box) if pressure is not None else 0.0
        self.size = balls.position.shape[1]

    def state(self, u, growth):
        """Return the contacts after displacements (N, d) and the growth eps of the box."""
        i, j = self.contacts.pairs.T
        moved, away = u[j] - u[i], self.contacts.away
        vector = away + moved
        distance = np.linalg.norm(vector, axis=1)
        change = np.einsum("nd,nd->n", 2 * away + moved, moved) / (distance + self.length)
        overlap = self.contacts.overlap - change - math.expm1(growth) * distance
        force = self.balls.law.force(self.contacts.constants, overlap)
        return State(vector / distance[:, None], distance * math.exp(growth), overlap, force)

    def forces(self, state, growth):
        """Return -dH/du of the free balls, shape (free, d), and -dH/deps."""
        repulsion = state.force[:, None] * state.normal
        forces = total_forces(self.contacts.pairs, repulsion, len(self.number))
        swelling = 0.0
        if self.pressure is not None:
            volume = self.volume * math.exp(self.size * growth)
            swelling = state.force @ state.distance - self.size * self.pressure * volume
        return (forces + self.balls.load)[self.free] * math.exp(growth), swelling

    def residual(self, state, forces, swelling, growth):
        """Return the larger of the force on a ball and the part by which the pressure is wrong."""
        mean = state.force[state.force > 0].mean()
        largest = np.linalg.norm(forces, axis=1).max(initial=0.0) / mean
        if self.pressure is None:
            return largest
        volume = self.volume * math.exp(self.size * growth)
        return max(largest, abs(swelling) / (self.size * self.pressure * volume))

    def enthalpy_change(self, before, after, step, growths):
        """Return H after a step less H before it, summed contact by contact."""
        energy = after.work - before.work
        change = energy.sum() / (self.balls.law.power + 1) - np.sum(self.balls.load * step)
        if self.pressure is not None:
            old, new = (self.size * growth for growth in growths)
            change += self.pressure * self.volume * math.exp(old) * math.expm1(new - old)
        return change

    def matrix(self, state, growth):
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
        K = (parted.T @ blocks @ parted).tocsc() * math.exp(2 * growth)
        if self.pressure is None:
            return K, None, None
        along = (stiffness * r - F)[:, None] * n
        border = total_forces(self.contacts.pairs[touching], along, len(self.number))
        volume = self.volume * math.exp(self.size * growth)
        corner = np.sum((stiffness * r - F) * r) + self.size**2 * self.pressure * volume
        return K, border[self.free].ravel() * math.exp(growth), corner
