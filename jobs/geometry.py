"""How much of a signal comes from random forces, and how much from random places: a table.

    python jobs/geometry.py [SEEDS [BALLS [DIMENSION]]]

Packings of Hertzian balls and their ordered counterparts, as scalars, with stiffnesses that are
alike, at random, or where they belong; the lattice also with the paper's. Means and their standard
errors. The paper's .3 and 1 omega_mx are .42 and 1.41 sqrt(2 kmax / m), the unit here; its damping.
"""

import dataclasses
import sys

import numpy as np

import pgran

LOW, HIGH, WEAK = 0.42, 1.41, 0.01
BANDS = ((0.0, LOW), (LOW, 1.0), (1.0, HIGH), (HIGH, 9.0))
HEAD = ["lowest mode", f"last A > {WEAK}", "maxima per omega", "phase slope", "spread of A, dB"]
HEAD += [f"P {low:g}-{high:g}" for low, high in BANDS]


def networks(seed, balls, dimension):
    """Yield names and networks."""
    chosen = {"law": "hertz", "pressure": 1e-5, "sizes": 0.2, "walls": "x", "seed": seed}
    packed, rng = pgran.pack(balls, dimension, **chosen), np.random.default_rng([seed, 1])
    packing = dataclasses.replace(packed, displacement="scalar", direction=None)
    for place, network in (("lattice", pgran.ordered(packed, seed)), ("packing", packing)):
        k = network.stiffness
        laws = {"alike": np.full(len(k), k.mean()), "random": rng.permutation(k)}
        laws |= {"uniform": network.kmax * rng.random(len(k))} if place == "lattice" else {"own": k}
        for law, stiffness in laws.items():
            yield f"{place}, {law}", dataclasses.replace(network, stiffness=stiffness)


def measured(network):
    """Return |A| in dB between LOW and HIGH, of three balls as deep as the paper's, and numbers."""
    unit = network.omega_mx
    network = dataclasses.replace(network, damping=0.003 * np.sqrt(2) * network.mass * unit)
    depth = network.depths(network.free[:, None])
    heard = network.free[np.argsort(np.abs(depth - 12 / 21 * depth.max()))[:3]]
    omega = np.linspace(0.02, 2, 1981)
    A = pgran.sweep(network, unit * omega, heard, resolve=0).displacement
    last = np.mean([omega[np.abs(a) > WEAK][-1] for a in A.T])
    A, omega = (x[(omega >= LOW) & (omega < HIGH)] for x in (A, omega))
    level, phase = 20 * np.log10(np.abs(A)), np.unwrap(np.angle(A), axis=0)
    tops = (level[1:-1] > level[:-2]) & (level[1:-1] > level[2:])
    modes = pgran.find_modes(network)
    numbers = [modes.omega[0] / unit, last, tops.sum(axis=0).mean() / (HIGH - LOW)]
    numbers += [-np.polyfit(omega, phase, 1)[0].mean()]
    bands = [(modes.omega >= a * unit) & (modes.omega < b * unit) for a, b in BANDS]
    return level, numbers, [1 / np.mean(1 / modes.participation[band]) for band in bands]


def main(seeds=10, balls=500, dimension=2):
    """Print the table."""
    found = {}
    for seed in range(1, seeds + 1):
        for name, network in networks(seed, balls, dimension):
            found.setdefault(name, []).append(measured(network))
    print(f"| stiffnesses | {' | '.join(HEAD)} |\n|{'---|' * (len(HEAD) + 1)}")
    for name, each in found.items():
        level, numbers, balls = map(np.array, zip(*each, strict=True))
        away = level - level.mean(axis=(0, 2), keepdims=True)
        rows = np.column_stack([numbers, np.sqrt(np.mean(away**2, axis=(1, 2))), balls])
        errors = rows.std(axis=0, ddof=1) / np.sqrt(seeds)
        cells = [f"{m:.3g} +- {e:.1g}" for m, e in zip(rows.mean(axis=0), errors, strict=True)]
        print(f"| {name} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
