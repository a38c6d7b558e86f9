"""Balls under a contact law come to rest: Newton's method on their energy, in increments.

With x = (X + u) e^eps about a reference X, whose contacts have the vectors v0 of length r0 and the
overlaps h0,

    v = v0 + u_j - u_i,   h = h0 - (2 v0 . du + du . du) / (|v| + r0) - (e^eps - 1) |v|,

so that no overlap is a small difference of positions: those would balance no better than eps L / h
of the mean force. H = sum of F h / (alpha + 1) - load . u + P V is the enthalpy; at a fixed box eps
is 0 and P V is left out. Newton's matrix is made positive definite by a shift where its pivots are
not, steps are halved until H falls, and end before a ball could meet one that is not in the list of
pairs, which is then made anew.

No search on |force| does this: its least value, 0, is also that of balls that have flown apart.
"""

import dataclasses
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pgran.balance.contacts import ContactLaw, near_pairs, total_forces
from pgran.errors import PgranError

BALANCED = 1e-12  # of the mean force: the largest force that is left on a ball
PATIENCE = 4  # steps in a row that lower neither the energy, beyond its rounding, nor the forces
STEPS, ROUNDS = 100, 40  # of Newton's method with one list of pairs, and lists
LEAST_SHIFT = 1e-10  # of the mean diagonal of K: what is less is rounding
SADDLE = 1e-10  # of the mean diagonal: how negative a pivot is that counts


class NotBalancedError(PgranError):
    """Balls found no rest."""


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


class Rest(NamedTuple):
    """Balls at rest: where and with which contacts, and how they came there.

    `residual` is the largest force left on a ball in units of the mean one, `unstable` how often
    the matrix needed a shift, `saddle` whether the rest is one of least energy in no neighbourhood.
    """

    balls: Balls
    contacts: Contacts
    residual: float
    unstable: int
    saddle: bool
    factorizations: int
    evaluations: int


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
    number = lambda pairs: np.sort(pairs, axis=1) @ [len(balls.radius), 1]  # noqa: E731
    added = found.of(~np.isin(number(found.pairs), number(contacts.pairs)))
    both = zip(dataclasses.astuple(contacts), dataclasses.astuple(added), strict=True)
    return Contacts(*map(np.concatenate, both))


class Motion:
    """Balls, displaced about a reference, with their energy and its derivatives."""

    def __init__(self, balls, contacts, pressure=None):
        """Start at the reference; with a pressure the box is unknown, too."""
        self.balls, self.contacts, self.pressure = balls, contacts, pressure
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
        forces = total_forces(
            self.contacts.pairs, state.force[:, None] * state.normal, len(self.number)
        )
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
        energy = after.force * np.maximum(after.overlap, 0) - before.force * np.maximum(
            before.overlap, 0
        )
        change = energy.sum() / (self.balls.law.power + 1) - np.sum(self.balls.load * step)
        if self.pressure is not None:
            old, new = (self.size * growth for growth in growths)
            change += self.pressure * self.volume * math.exp(old) * math.expm1(new - old)
        return change

    def matrix(self, state, growth):
        """Return d2H/du2 of the free balls, and with a pressure d2H/du deps and d2H/deps2."""
        touching = np.flatnonzero(state.force > 0)
        n, r, F = (x[touching] for x in (state.normal, state.distance, state.force))
        stiffness = self.balls.law.power * F / state.overlap[touching]
        pull = F / r
        blocks = (stiffness + pull)[:, None, None] * n[:, :, None] * n[:, None, :]
        blocks -= pull[:, None, None] * np.eye(self.size)
        i, j = self.number[self.contacts.pairs[touching]].T
        K = assembled(i, j, blocks, len(self.free)) * math.exp(2 * growth)
        if self.pressure is None:
            return K, None, None
        along = (stiffness * r - F)[:, None] * n
        border = total_forces(self.contacts.pairs[touching], along, len(self.number))
        volume = self.volume * math.exp(self.size * growth)
        corner = np.sum((stiffness * r - F) * r) + self.size**2 * self.pressure * volume
        return K, border[self.free].ravel() * math.exp(growth), corner


def assembled(first, second, blocks, balls):
    """Return the sparse sum over contacts of blocks b on the diagonal and -b beside it.

    `first` and `second` are the balls of each, -1 for one that is held.
    """
    from scipy.sparse import coo_matrix  # here: SciPy takes its time

    size = blocks.shape[1]
    rows, columns, values = [], [], []
    for one, other, sign in (
        (first, first, 1),
        (second, second, 1),
        (first, second, -1),
        (second, first, -1),
    ):
        there = (one >= 0) & (other >= 0)
        place = np.arange(size)
        shape = blocks[there].shape
        rows.append(np.broadcast_to((size * one[there])[:, None, None] + place[:, None], shape))
        columns.append(np.broadcast_to((size * other[there])[:, None, None] + place, shape))
        values.append(sign * blocks[there])
    flat = [np.concatenate(parts).ravel() for parts in (values, rows, columns)]
    return coo_matrix((flat[0], (flat[1], flat[2])), (size * balls, size * balls)).tocsc()


def factored(K):
    """Return the factors of a symmetric matrix in SuperLU's symmetric mode, None if singular."""
    from scipy.sparse.linalg import splu  # here: SciPy takes its time

    from pgran.medium.graph import SYMMETRIC

    try:
        return splu(K, "MMD_AT_PLUS_A", **SYMMETRIC)
    except RuntimeError:
        return None


def direction(motion, state, growth, forces, swelling, shift):
    """Return a step downhill (N, d) and of eps, the shift it took, and the factorizations.

    `shift` is in units of the mean diagonal; it grows until K and the border are positive definite.
    """
    from scipy.sparse import identity

    K, border, corner = motion.matrix(state, growth)
    mean, tried = K.diagonal().mean(), 0
    while shift < 1:
        factors = factored(K + shift * mean * identity(K.shape[0], format="csc"))
        tried += 1
        if factors is not None and np.all(factors.U.diagonal() > 0):
            step, swell, rest = factors.solve(forces.ravel()), 0.0, 1.0
            if border is not None:
                turned = factors.solve(border)
                rest = corner - border @ turned  # what is left of the last pivot
                swell = (swelling - border @ step) / rest
                step = step - swell * turned
            if rest > 0:
                moved = np.zeros((len(motion.number), motion.size))
                moved[motion.free] = step.reshape(-1, motion.size)
                return moved, swell, shift, tried
        shift = max(4 * shift, LEAST_SHIFT)
    raise NotBalancedError("the packing has lost its rigidity: no shift makes its matrix definite")


def newton(motion, reach, tolerance):
    """Return displacements, eps, state, residual and counts of shifts and factorizations.

    It ends at rest, where `PATIENCE` steps make it no better, or where balls have moved so far that
    the pairs nearer than `reach` are no longer all that could touch.
    """
    u, growth = np.zeros((len(motion.number), motion.size)), 0.0
    state = motion.state(u, growth)
    best, shift, stalled = (math.inf, u, growth, state), 0.0, 0
    unstable = factorizations = evaluations = 0
    for _ in range(STEPS):
        if not np.any(state.force > 0):
            raise NotBalancedError("the balls have flown apart: no contact is left")
        forces, swelling = motion.forces(state, growth)
        residual = motion.residual(state, forces, swelling, growth)
        if residual < best[0]:
            best, stalled = (residual, u, growth, state), 0
        far = np.abs(u).max(initial=0.0) + 1.5 * abs(growth) > reach / 2
        if residual < tolerance or stalled > PATIENCE or far:
            break
        step, swell, shift, tried = direction(motion, state, growth, forces, swelling, shift)
        factorizations += tried
        unstable += shift > 0
        # downhill by the slope; near the end, where H rounds, by the slope's not having turned
        slope = np.sum(forces * step[motion.free]) + swelling * swell
        energy = np.sum(state.force * np.maximum(state.overlap, 0))
        if motion.pressure is not None:
            energy += motion.pressure * motion.volume
        part = min(1.0, 0.2 * reach / max(np.abs(step).max(), 1.5 * abs(swell), 1e-300))
        while True:
            there = u + part * step, growth + part * swell
            ahead = motion.state(*there)
            evaluations += 1
            rounds = part * slope <= 1e-11 * energy
            if not rounds:
                change = motion.enthalpy_change(state, ahead, part * step, (growth, there[1]))
                downhill = change <= -1e-4 * part * slope
            else:
                turned, swollen = motion.forces(ahead, there[1])
                downhill = np.sum(turned * step[motion.free]) + swollen * swell >= -0.9 * slope
            if downhill or part < 1e-9:
                break
            part /= 2
        stalled = stalled + 1 if rounds else 0
        if part < 0.1:
            shift = max(4 * shift, LEAST_SHIFT)
        elif part == 1:
            shift = shift / 10 if shift > 10 * LEAST_SHIFT else 0.0
        (u, growth), state = there, ahead
    residual, u, growth, state = best if not far else (residual, u, growth, state)
    return u, growth, state, residual, (unstable, factorizations, evaluations)


def at_rest(balls, contacts=None, pressure=None, tolerance=BALANCED):
    """Return balls at rest, as a `Rest`, from where they are.

    Contacts open and close. `contacts` are those that are known more exactly than positions say;
    with a `pressure` a periodic box finds its size. Raises NotBalancedError where they find no
    rest.
    """
    counts, residual = np.zeros(3, dtype=int), math.inf
    for _ in range(ROUNDS):
        reach = reach_of(balls, contacts)
        contacts = listed(balls, contacts, reach=reach)
        motion = Motion(balls, contacts, pressure)
        u, growth, state, residual, counted = newton(motion, reach, tolerance)
        counts += counted
        balls, contacts = displaced(balls, contacts, u, growth, state)
        if residual < tolerance:
            break
        if np.abs(u).max(initial=0.0) + 1.5 * abs(growth) <= reach / 2:
            raise NotBalancedError(
                f"the balls find no rest: {residual:.1e} of the mean force is left on one of them"
            )
    else:
        raise NotBalancedError(f"the balls still move after {ROUNDS} lists of neighbours")
    K, _, _ = Motion(balls, contacts).matrix(state, 0.0)
    factors = factored(K)
    lowest = -math.inf if factors is None else factors.U.diagonal().min()
    saddle = lowest < -SADDLE * K.diagonal().mean()
    unstable, factorizations, evaluations = counts.tolist()
    return Rest(balls, contacts, residual, unstable, saddle, factorizations + 1, evaluations)


def reach_of(balls, contacts):
    """Return how wide a gap may be between balls that are listed: some overlaps, no more."""
    size = 2 * float(np.mean(balls.radius))
    if contacts is None:
        return 0.02 * size
    overlap = contacts.overlap[contacts.overlap > 0]
    return (
        float(np.clip(10 * overlap.mean(), 2e-3 * size, 0.1 * size))
        if overlap.size
        else 0.02 * size
    )


def displaced(balls, contacts, u, growth, state):
    """Return balls and contacts with the displacements as their reference."""
    larger = math.exp(growth)
    balls = dataclasses.replace(
        balls, position=(balls.position + u) * larger, box=balls.box * larger
    )
    away = state.normal * state.distance[:, None]
    return balls, dataclasses.replace(contacts, away=away, overlap=state.overlap)
