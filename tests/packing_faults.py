"""What is false of packings made from random numbers: balance, pressure, counts of contacts."""

import dataclasses

import numpy as np
from packing_samples import pushes

from pgran.balance.pack import packed_network
from pgran.medium.packing import near_pairs


@dataclasses.dataclass(frozen=True)
class PackingCase:
    """What a packing is asked to be."""

    seed: int
    choices: dict


def random_packing(seed):
    """Discs or spheres of any kind, under a pressure or gravity."""
    rng = np.random.default_rng([28, seed])
    push = {"pressure": 10.0 ** rng.choice([-2.0, -3, -4, -5])}
    if rng.random() < 0.2:
        push = {"gravity": 10.0 ** rng.uniform(-7, -4)}
    choices = {
        "balls": int(rng.integers(80, 200)),
        "dimension": int(rng.integers(2, 4)),
        "law": rng.choice(["harmonic", "hertz"]).item(),
        "sizes": [("bidisperse", "equal")[rng.integers(2)], rng.uniform(0, 0.4)][rng.integers(2)],
        "seed": seed,
    }
    return PackingCase(seed, choices | push)


def packing_faults(case, seen):
    """Yield what is wrong with a packing; forces are summed anew, over each pair of balls."""
    network, packed = packed_network(**case.choices)
    what, axes = f"case {case.seed} {case.choices}", network.axes
    seen["packings"] += 1
    mean = network.force.mean()
    total = pushes(network)
    if network.gravity is not None:
        total += network.masses[:, None] * network.gravity
    left = np.linalg.norm(total[network.free], axis=1).max() / mean
    if not left < 1e-13 * (1 + 1 / np.sqrt(len(network.free))) + 4e-15:
        yield f"UNBALANCED {what}: {left:.1e} of the mean force"
    if network.gravity is None:
        pressure = network.force @ network.distance / (axes * network.box.prod())
        if not abs(pressure / case.choices["pressure"] - 1) < 1e-12:
            yield f"PRESSURE {what}: {pressure}"
    else:
        weight = -network.masses[network.free].sum() * network.gravity[-1]
        held = network.held > 0
        carried = network.masses[held].sum() * network.gravity[-1] - total[held, -1].sum()
        if not abs(carried / weight - 1) < 1e-10:
            yield f"WEIGHT {what}: {carried / weight}"
    if packed.excess < 0:
        yield f"FLOPPY {what}: {packed.excess} contacts more than isostatic"
    if packed.rest.saddle:
        yield f"SADDLE {what}"
    box = np.where(network.box > 0, network.box, np.inf)
    pairs, *_ = near_pairs(network.position, network.radius, box, -1e-12)
    touching = np.any(network.held[pairs] == 0, axis=1)
    if len(pairs[touching]) > network.bonds:
        yield f"OVERLAP {what}: {len(pairs[touching])} pairs overlap, {network.bonds} contacts"
    force = network.overlap**network.power
    if network.power > 1:
        first, second = network.radius[network.bond].T
        force *= np.sqrt(first * second / (first + second))
    if not np.allclose(force, network.force, rtol=1e-12):
        yield f"LAW {what}"
