"""Random cases of what drives: pushes, parts of walls and of held balls, lattices with free sides.

References are those of `network_samples`, in many digits.
"""

import dataclasses
import itertools

import numpy as np
from amplitude_faults import network_faults, sweep_faults
from network_samples import NetworkReference, as_network, random_network
from samples import random_case

FEW = 9  # balls of a lattice: elimination in many digits is dense


def random_source(seed):
    """A random case, of a lattice or of a network, whose source is another one.

    The sum of a push is kmax, so that its amplitudes are compared with 1.
    """
    rng = np.random.default_rng([19, seed])

    def push(balls, axes, size):
        forces = rng.standard_normal((balls, axes)) * 10 ** rng.uniform(-3, 0, (balls, 1))
        forces *= rng.random((balls, 1)) < 0.5
        forces[rng.integers(balls)] = 1.0
        return forces * (size / np.linalg.norm(forces, axis=1).sum())

    if rng.random() < 0.5:
        case = random_network(seed)
        network = case.network
        free = np.flatnonzero(network.held == 0)
        forces = np.zeros((len(network.held), network.axes))
        forces[free] = push(len(free), network.axes, network.kmax)
        change = {"push": forces, "held": np.minimum(network.held, 1)}
        return dataclasses.replace(case, network=dataclasses.replace(network, **change))
    cases = (random_case(number) for number in itertools.count(1000 * seed))
    case = next(case for case in cases if case.lattice.size <= FEW)
    lattice = case.lattice
    sides = [f"{axis}{end}" for axis in "xyz"[: lattice.axes] for end in "-+"]
    free = rng.permutation(sides)[1:].tolist()  # one side at least has a wall
    free = [side for side in free if rng.random() < 0.5]
    if "x+" in free or rng.random() < 0.5:
        change = {"push": push(lattice.size, 1, lattice.kmax).reshape(lattice.shape)}
    else:
        moved = np.array(1.0 * (rng.random(lattice.shape[1:]) < 0.5))
        moved.flat[rng.integers(moved.size)] = 1.0
        change = {"wall": moved}
    return dataclasses.replace(case, lattice=dataclasses.replace(lattice, free=free, **change))


def source_faults(case, seen):
    """Compare amplitudes with elimination in many digits."""
    if hasattr(case, "network"):
        yield from network_faults(case, seen)
        return
    reference = None

    def eliminated(stiffness, mass, damping, omega, sites):
        nonlocal reference  # made at the digits of the case
        reference = reference or NetworkReference(as_network(case.lattice))
        return reference.amplitudes(1j * omega, case.lattice.numbers_of(np.asarray(sites)))

    yield from sweep_faults(case, seen, eliminate=eliminated)
