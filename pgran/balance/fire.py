"""FIRE: balls slide downhill with inertia, which is taken from them whenever they move uphill.

Bitzek, Koskinen, Gaehler, Moseler, Gumbsch, Phys. Rev. Lett. 97, 170201 (2006). It needs forces
alone, and finds a packing from random positions; the last digits are Newton's (`equilibrium`).
"""

import dataclasses

import numpy as np

from pgran.balance.motion import near_pairs
from pgran.medium.packing import nearest_images, total_forces

SKIN = 0.3  # mean diameters between balls that are listed as neighbours
RENEWED = 20  # steps after which the time step follows the contacts
LARGEST_STEP = 0.1  # mean diameters
MOST_GROWTH = 0.02  # of a box in one step
LEAST_CONTACTS = 4.0  # a ball, by which the time step is set, where there are fewer


def fire(balls, pressure=None, tolerance=1e-6, pressed=1e-2, steps=100_000):
    """Return balls after a descent, its number of steps, and the largest force in mean forces.

    It ends at a `tolerance` of the mean force. With a `pressure` the box grows or shrinks as a
    whole, until that is right to the part `pressed`.
    """
    count, size = balls.position.shape
    diameter = 2 * float(balls.radius.mean())
    position, box = balls.position.copy(), balls.box.copy()
    velocity, swelling, weight = np.zeros_like(position), 0.0, np.sqrt(count)
    mixing, downhill, step, listed_at, residual = 0.1, 0, None, None, np.inf
    for number in range(steps):
        if listed_at is None or np.abs(position - listed_at).max() > SKIN * diameter / 4:
            pairs, _ = near_pairs(position, balls.radius, box, SKIN * diameter)
            pairs = pairs[~balls.held[pairs].all(axis=1)]
            reach = balls.radius[pairs].sum(axis=1)
            constants = balls.law.constants(*balls.radius[pairs].T)
            listed_at = position.copy()
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
    return dataclasses.replace(balls, position=position, box=box), number + 1, residual


def _time_step(balls, constants, overlap, count):
    """Return how long a step may be, by the mean stiffness and the contacts of a ball."""
    if not len(overlap):
        return 0.5 / np.sqrt(balls.law.modulus)
    stiffness = balls.law.stiffness(constants, overlap).mean()
    return 1.2 / np.sqrt(stiffness * max(2 * len(overlap) / count, LEAST_CONTACTS))
