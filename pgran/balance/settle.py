"""Balls come to rest under a pressure, or under gravity, from random positions.

FIRE runs down to a millionth of the mean force, under pressures that fall by factors of 10: it is
cheap, and from there Newton's method on the enthalpy needs two or three factorizations. Rattlers
are left out. Lengths are in mean diameters, constants in the law's modulus.
"""

import dataclasses
import math
from typing import NamedTuple

import numpy as np

from pgran.balance.equilibrium import NotBalancedError, Rest, at_rest
from pgran.balance.motion import Balls, listed
from pgran.medium.graph import loose_balls
from pgran.medium.packing import nearest_images, total_forces

DENSITY = {2: 0.9, 3: 0.7}  # of random positions: the part of the box that balls fill
FIRST_PRESSURES = {1.0: 1e-2}  # the pressure where a descent begins, of laws by their power
FIRST_PRESSURE = 1e-3  # of others
NEWTON_RESIDUAL = 1e-6  # of the mean force: from where Newton's method is quick
BALANCED = 1e-13  # of the mean force
RATTLER_OVERLAP = 1e-13  # mean diameters by which a rattler may overlap: rounding of positions
RETURNS = 20  # to FIRE, where Newton's method finds no rest
FIRST_GRAVITY = 1e-3  # under which balls settle first; then it falls by factors of 3 or so
FLOOR_OVERLAP = 0.2  # mean diameters by which balls at the floor overlap while others settle
FLOOR_SPACING = 0.7  # mean diameters between the balls of a floor, which let none through
FLOOR_ROUGHNESS = 0.2  # mean diameters by which their heights differ
# Of FIRE
SKIN = 0.3  # mean diameters between balls that are listed as neighbours
RENEWED = 20  # steps after which the time step follows the contacts
LARGEST_STEP = 0.1  # mean diameters
MOST_GROWTH = 0.02  # of a box in one step
LEAST_CONTACTS = 4.0  # a ball, by which the time step is set, where there are fewer


class Packed(NamedTuple):
    """A packing at rest without its rattlers, how many these are, and FIRE's steps."""

    rest: Rest
    rattlers: int
    descents: int

    @property
    def contacts(self):
        """The contacts that bear forces."""
        return self.rest.contacts.of(self.rest.contacts.overlap > 0)

    @property
    def excess(self):
        """Contacts less those of an isostatic packing: d N, in a periodic box d (N - 1) + 1."""
        balls = self.rest.balls
        size = balls.position.shape[1]
        least = size * np.count_nonzero(~balls.held)
        if not balls.held.any():
            least += 1 - size
        return np.count_nonzero(self.rest.contacts.overlap > 0) - least


def under_pressure(diameter, dimension, law, pressure, rng, shape=None):
    """Return a `Packed` of balls in a periodic box, whose sides are in the ratio of `shape`."""
    sides = np.ones(dimension) if shape is None else np.asarray(shape, dtype=float)
    volume = _first_volume(diameter, dimension)
    box = sides * (volume / sides.prod()) ** (1 / dimension)
    position = rng.random((len(diameter), dimension)) * box
    free = np.zeros(len(diameter), dtype=bool)
    balls, descents = fire(Balls(position, diameter / 2, free, box, law), None, 1e-2, steps=3000)
    stage = max(pressure, FIRST_PRESSURES.get(law.power, FIRST_PRESSURE))
    while stage > pressure:
        balls, steps = fire(balls, stage, 1e-3, pressed=0.1)
        descents += steps
        stage = max(pressure, stage / 10)
    balls, steps = fire(balls, pressure, NEWTON_RESIDUAL)
    return settled(balls, pressure, dimension + 1, descents + steps)


def under_gravity(diameter, dimension, law, gravity, rng):
    """Return a `Packed` of balls on a floor of held ones, along the last axis; sides are periodic.

    The surface is free. The floor's balls, of mean diameter, come last.
    """
    volume = _first_volume(diameter, dimension)
    width = volume ** (1 / dimension)
    across = max(round(width / FLOOR_SPACING), 1)
    spots = np.stack(np.meshgrid(*[np.arange(across) * width / across] * (dimension - 1)), axis=-1)
    floor = np.zeros((across ** (dimension - 1), dimension))
    floor[:, :-1] = spots.reshape(len(floor), -1)
    floor[:, -1] = -FLOOR_ROUGHNESS * rng.random(len(floor))
    position = rng.random((len(diameter), dimension)) * width
    position[:, -1] *= volume / width**dimension
    position[:, -1] += diameter.max()
    held = np.arange(len(diameter) + len(floor)) >= len(diameter)
    diameter = np.append(diameter, np.ones(len(floor)))
    box = np.append(np.full(dimension - 1, float(width)), np.inf)
    down = np.zeros((len(held), dimension))
    down[:, -1] = -gravity * diameter**dimension
    balls = Balls(np.concatenate([position, floor]), diameter / 2, held, box, law)
    descents = 0
    layers = np.sum(diameter**dimension) / width ** (dimension - 1)
    strongest = law.force(law.constants(0.5, 0.5), FLOOR_OVERLAP) / layers
    stages = max(math.ceil(2 * math.log10(FIRST_GRAVITY / gravity)), 3)
    stages = min(stages, max(math.floor(2 * math.log10(strongest / gravity)), 0))
    for stage in range(stages, -1, -1):
        balls = dataclasses.replace(balls, load=10 ** (stage / 2) * down)
        balls, steps = fire(balls, tolerance=1e-2 if stage else NEWTON_RESIDUAL, steps=20000)
        descents += steps
    fallen = np.count_nonzero(balls.position[~held, -1] < -1)
    if fallen:
        raise NotBalancedError(
            f"{fallen} balls have fallen through the floor: gravity is too strong for the contacts"
        )
    return settled(balls, None, dimension, descents)


def _first_volume(diameter, dimension):
    """Return the volume of a box that balls at random positions fill to their DENSITY."""
    fraction = math.pi / (4 if dimension == 2 else 6)
    return fraction * np.sum(diameter**dimension) / DENSITY[dimension]


def settled(balls, pressure, least, descents):
    """Return a `Packed`: Newton's rest without rattlers, which have fewer than `least` contacts.

    Where there is none, or where it squeezes a rattler, FIRE goes on.
    """
    for _ in range(RETURNS):
        try:
            rest, carrying = _rest_without_rattlers(balls, pressure, least)
        except NotBalancedError:
            squeezed = True
        else:
            balls, squeezed = _rattlers_placed(balls, rest.balls, carrying)
            if not squeezed:
                return Packed(rest, np.count_nonzero(~carrying), descents)
        balls, steps = fire(balls, pressure, NEWTON_RESIDUAL / 10)
        descents += steps
    raise NotBalancedError(f"no balanced packing after {RETURNS} descents: try another seed")


def _rest_without_rattlers(balls, pressure, least):
    """Return the rest of the balls that bear forces, and which ones these are."""
    carrying, pairs = np.arange(len(balls.held)), listed(balls, reach=0.0).pairs
    while True:
        rattling = loose_balls(pairs, balls.held[carrying], least)
        carrying = carrying[~rattling]
        if not len(carrying):
            raise NotBalancedError("no ball has contacts enough to be held by them")
        own = balls.of(carrying)
        if not own.held.any() and np.all(np.isfinite(own.box)):
            own.held[0] = True  # else all could move together
        rest = at_rest(own, None, pressure, BALANCED)
        pairs = rest.contacts.pairs[rest.bearing]
        if not loose_balls(pairs, own.held, least).any():
            held = balls.held[carrying]
            rest = rest._replace(balls=dataclasses.replace(rest.balls, held=held))
            return rest, np.isin(np.arange(len(balls.held)), carrying)


def _rattlers_placed(balls, carriers, carrying):
    """Return all balls, the rattlers where the others leave them room, and whether none is left."""
    position, periodic = balls.position.copy(), np.isfinite(balls.box)
    position[:, periodic] *= carriers.box[periodic] / balls.box[periodic]
    position[carrying] = carriers.position
    placed = dataclasses.replace(balls, position=position, box=carriers.box, held=carrying)
    deepest = 0.0
    if not carrying.all():
        placed, _ = fire(placed, tolerance=0.0, steps=2000)
        deepest = listed(placed, reach=0.0).overlap.max(initial=0.0)
    return dataclasses.replace(placed, held=balls.held), deepest > RATTLER_OVERLAP


def fire(balls, pressure=None, tolerance=1e-6, pressed=1e-2, steps=100_000):
    """Return balls that slid downhill by FIRE, and in how many steps.

    They have inertia, which is taken from them whenever they move uphill: Bitzek, Koskinen,
    Gaehler, Moseler, Gumbsch, Phys. Rev. Lett. 97, 170201 (2006). It ends at a `tolerance` of the
    mean force. With a `pressure` the box grows or shrinks as a whole, until that is right to the
    part `pressed`.
    """
    count, size = balls.position.shape
    diameter = 2 * float(balls.radius.mean())
    position, box = balls.position.copy(), balls.box.copy()
    velocity, swelling, weight = np.zeros_like(position), 0.0, np.sqrt(count)
    mixing, downhill, step, listed_at = 0.1, 0, None, None
    for number in range(steps):
        if listed_at is None or np.abs(position - listed_at).max() > SKIN * diameter / 4:
            balls = dataclasses.replace(balls, position=position, box=box)
            near = listed(balls, reach=SKIN * diameter)
            pairs, constants = near.pairs, near.constants
            reach, listed_at = balls.radius[pairs].sum(axis=1), position.copy()
        away, _ = nearest_images(position[pairs[:, 1]] - position[pairs[:, 0]], box)
        squares = np.einsum("nd,nd->n", away, away)
        touching = np.flatnonzero(squares < reach**2)
        distance = np.sqrt(squares[touching])
        overlap = reach[touching] - distance
        force = balls.law.force(constants[touching], overlap)
        forces = total_forces(pairs[touching], (force / distance)[:, None] * away[touching], count)
        forces += balls.load
        forces[balls.held] = 0.0
        if number % RENEWED == 0:  # a fixed one is wrong for Hertz and for low pressures
            fastest = _time_step(balls, constants[touching], overlap, count)
            step = fastest / 10 if step is None else min(step, fastest)
        mean = force.mean() if len(force) else 0.0
        push = missed = 0.0
        if pressure is not None:
            work = size * np.prod(box) * pressure
            push = (force @ distance - work) / weight
            missed = abs(force @ distance / work - 1)
        residual = np.sqrt(np.einsum("nd,nd->n", forces, forces).max()) / mean if mean else np.inf
        if residual < tolerance and missed < pressed:
            break
        if np.vdot(forces, velocity) + push * swelling > 0:
            downhill += 1
            speed = np.sqrt(np.vdot(velocity, velocity) + swelling**2)
            pull = max(np.sqrt(np.vdot(forces, forces) + push**2), 1e-300)
            velocity = (1 - mixing) * velocity + (mixing * speed / pull) * forces
            swelling = (1 - mixing) * swelling + mixing * speed / pull * push
            if downhill > 5:
                step, mixing = min(1.1 * step, fastest), 0.99 * mixing
        else:
            velocity[:], swelling, downhill, mixing = 0.0, 0.0, 0, 0.1
            step = max(step / 2, 1e-3 * fastest)
        velocity += step * forces
        swelling += step * push
        largest = step * np.abs(velocity).max()
        velocity *= min(1.0, LARGEST_STEP * diameter / max(largest, 1e-300))
        position += step * velocity
        if pressure is not None:
            larger = np.exp(np.clip(step * swelling / weight, -MOST_GROWTH, MOST_GROWTH))
            position, box, listed_at = position * larger, box * larger, listed_at * larger
    return dataclasses.replace(balls, position=position, box=box), number + 1


def _time_step(balls, constants, overlap, count):
    """Return how long a step may be, by the mean stiffness and the contacts of a ball."""
    if not len(overlap):
        return 0.5 / np.sqrt(balls.law.modulus)
    stiffness = balls.law.stiffness(constants, overlap).mean()
    return 1.2 / np.sqrt(stiffness * max(2 * len(overlap) / count, LEAST_CONTACTS))
