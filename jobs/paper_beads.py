"""The heater of the experiment in packings of glass beads under loads of 1 to 300 of their weights.

python jobs/paper_beads.py results/paper    makes the packings, prints the words of each run
"""

import sys
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

import pgran
from pgran.command.units import GRAVITY
from pgran.experiments.sensitivity.figures_heat import change, distances
from pgran.medium import hertz
from pgran.medium.network_file import parts_of, write_network

GLASS, DIAMETER = hertz.MATERIALS["glass"], 5e-3  # m
LOADS = 1, 3, 10, 30, 100, 300  # mean forces of contacts, in weights of a bead
GROWTHS = 1000, 180  # Angstrom: the paper's, and what .8 K make of it by thermal expansion
HEATERS = 20  # of each packing
BETA = 0.003  # in units of m omega_mx
PLACES = 0.25, 0.5  # of detectors, from the wall at rest to the driven one
APART = 0, 2.5, 5, np.inf  # diameters between heater and detector


def packed(folder, balls, weights, seed):
    """Make the packing of a load and a seed; return its path, it, and its unit of time in s."""
    scale = hertz.Scale(GLASS, DIAMETER, weights * hertz.ball_mass(GLASS, DIAMETER) * GRAVITY, 3)
    force, time = scale.packed
    pressure = hertz.pressure_of_force(scale.force, DIAMETER) * DIAMETER**2 / force
    shape = {"sizes": 0.1, "shape": (2, 1, 1), "walls": "x", "seed": seed}
    packing = pgran.pack(balls, 3, "hertz", pressure=pressure, **shape)
    path = folder / f"packing_{weights}_{seed}.h5"
    write_network(path, *parts_of(packing), overwrite=True)
    return path, packing, time


def heard_at(packing, places):
    """Return the balls nearest to the axis of a packing, at places between its walls."""
    x, heard = packing.position[:, 0], []
    for place in places:
        middle = packing.box / 2
        middle[0] = x.min() + place * np.ptp(x)
        away = np.linalg.norm(packing.position[packing.free] - middle, axis=1)
        heard.append(packing.free[np.argmin(away)])
    return heard


def make(folder, balls, case):
    """Make the packing of a load and a seed; return the name and the words of a run a growth.

    There are two detectors, the balls nearest to the axis of the packing at their places.
    """
    weights, seed = case
    path, packing, time = packed(folder, balls, *case)
    heard = heard_at(packing, PLACES)
    beta = BETA * packing.mass * packing.omega_mx
    words = f"-network_file {path} -network_damping {beta:.6g} -heat_samples {HEATERS} "
    words += f"-detectors {','.join(map(str, heard))} -units_length {DIAMETER:g} "
    words += f"-units_time {time:.6g} -heat_radius "
    names = [f"beads_{weights}_{seed}_{growth} {words}" for growth in GROWTHS]
    return [f"{name}{x * 1e-10 / DIAMETER:g}" for name, x in zip(names, GROWTHS, strict=True)]


def nearest(known, value):
    """Return the one of some known numbers that is nearest to a value by their ratio."""
    return min(known, key=lambda each: abs(np.log(each / value)))


def weights_of(result):
    """Return the load of a result, the mean force of contacts in weights of a bead."""
    acceleration = result.network.force.mean() / result.network.median_mass
    return acceleration * result.units_length / result.units_time**2 / GRAVITY


def case_of(result):
    """Return load and growth of a result, those of LOADS and GROWTHS that are nearest."""
    growth = result.heat.growth.mean() * result.units_length * 1e10
    return nearest(LOADS, weights_of(result)), nearest(GROWTHS, growth)


def measures(results, weights, growth):
    """Return what is found of one load and one growth.

    Of the changes of |A| the median, the 90 % quantile and the share of a quarter or more; dR/h,
    contacts that opened; medians by distance; how many heaters, packings, and of these without
    rest there are.
    """
    results = [result for result in results if case_of(result) == (weights, growth)]
    if not results:
        return [np.nan] * 8 + [0] * 3
    heats = [result.heat for result in results]
    changes = [np.abs(change(heat, "warmed")[0]) for heat in heats]
    changes = np.concatenate([each.reshape(len(each), -1) for each in changes], axis=1)
    away = np.concatenate([distances(r.heat, r.network).ravel() for r in results])
    known = np.isfinite(changes)
    parts = [changes[known & (away >= low) & (away < high)] for low, high in pairwise(APART)]
    opened = np.concatenate([heat.opened[heat.outcome != "not balanced"] for heat in heats])
    return [
        *np.quantile(changes[known], [0.5, 0.9]), np.mean(changes[known] >= 0.25),
        np.mean([heat.growth_overlap.mean() for heat in heats]), opened.mean(),
        *[np.median(part) if part.size else np.nan for part in parts],
        sum(len(heat.ball) for heat in heats), len(heats), sum(heat.lost for heat in heats),
    ]  # fmt: skip


def main(folder, loads=LOADS, seeds=(1, 2), balls=400):
    """Make the packings, two at a time, and print the words of each run."""
    folder.mkdir(parents=True, exist_ok=True)
    cases = [(weights, seed) for weights in loads for seed in seeds]
    with ProcessPoolExecutor(2) as pool:
        for lines in pool.map(partial(make, folder, balls), cases):
            print("\n".join(lines), flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
