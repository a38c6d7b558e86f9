"""Loud sound in packings of glass beads under loads of 1 to 300 of their weights, at 4 kHz.

python jobs/paper_loud.py results/paper    makes the packings, prints the words of each run
"""

import sys
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
from paper_beads import DIAMETER, heard_at, nearest, packed, weights_of

FREQUENCY = 4000  # Hz: the experiment's, where its detector moved by 1.4 g, the last amplitude
QUALITIES, SEEDS = (5, 20), (1, 2, 3)  # of contacts at that frequency; of packings of a load
NM = {  # amplitudes of the wall by loads; under one weight 1.6 nm are much
    1: (0.02, 0.06, 0.2, 0.6, 1.6),
    30: (0.1, 0.3, 1.6, 5, 22),
    300: (0.5, 1.6, 5, 22),
}
MIDDLE = 1.6  # nm, .1 g
LITTLE = 0.01  # a change of the fundamental that is called small


def make(folder, balls, case):
    """Make the packing of a load and a seed; return the name and the words of a run a quality."""
    weights, seed = case
    path, packing, time = packed(folder, balls, *case)
    omega = 2 * np.pi * FREQUENCY * time
    amplitudes = ",".join(f"{1e-9 * nm / DIAMETER:.6g}" for nm in NM[weights])
    words = (
        f"-network_file {path} -detectors {heard_at(packing, [0.5])[0]} -sweep_omega {omega:.6g} "
    )
    words += f"-units_length {DIAMETER:g} -units_time {time:.6g} -loud_amplitudes {amplitudes} "
    betas = [packing.stiffness.mean() / (quality * omega) for quality in QUALITIES]
    names = [f"loud_{weights}_{quality}_{seed}" for quality in QUALITIES]
    return [
        f"{name} {words}-network_damping {beta:.6g}"
        for name, beta in zip(names, betas, strict=True)
    ]


def case_of(result):
    """Return load and quality of a result, those of NM and QUALITIES that are nearest."""
    network, omega = result.network, result.loud.omega[0]
    quality = network.stiffness.mean() / (network.damping * omega)
    return nearest(NM, weights_of(result)), nearest(QUALITIES, quality)


def measures(results, weights, quality):
    """Return in words what is found of one load and one quality; see `told`.

    What opens the first contact, and 1 % of them, up to where changes are LITTLE, in nm; in % the
    change at 1.6 nm, and that at the last amplitude; the second harmonic, the mean, the part that
    claps and the size of the multiplier there; from where on states are unstable.
    """
    louds = [result.loud for result in results if case_of(result) == (weights, quality)]
    if not louds:
        return ["-"] * 10
    nm = 1e9 * DIAMETER
    ends = [100 * np.array([getattr(x, name)[0, -1] for x in louds])
            for name in ("change", "second", "mean", "clapping")]  # fmt: skip
    middle = [x.change[0, np.abs(nm * x.drive[0] - MIDDLE).argmin()] for x in louds]
    first = [nm * x.drive[0, x.unstable[0]].min(initial=np.inf) for x in louds]
    unstable = np.isfinite(first)
    return [
        told(nm * x.opening[0, 0] for x in louds),
        told(nm * x.opening_part[0, 0] for x in louds),
        told(nm * up_to(x.drive[0], x.change[0]) for x in louds),
        told(100 * np.array(middle)), *map(told, ends),
        told(abs(x.multiplier[0, -1]) for x in louds),
        f"{unstable.sum()} of {len(louds)}"
        f"{f', from {min(first):.2g} nm on' * bool(unstable.any())}",
    ]  # fmt: skip


def up_to(drive, change):
    """Return the amplitude at which a change becomes LITTLE, by its power law in between."""
    above = np.flatnonzero(change > LITTLE)
    if not len(above) or not above[0]:
        return np.nan
    part = slice(above[0] - 1, above[0] + 1)
    return np.exp(np.interp(np.log(LITTLE), np.log(change[part]), np.log(drive[part])))


def told(values):
    """Return the median of packings with the range, and how many have no number."""
    values = np.array([*values])
    known = values[np.isfinite(values)]
    missing = f", {len(values) - len(known)} without" * (len(known) < len(values))
    if not len(known):
        return f"none{missing}"
    return f"{np.median(known):.2g} ({known.min():.2g} to {known.max():.2g}{missing})"


def main(folder, loads=tuple(NM), seeds=SEEDS, balls=400):
    """Make the packings, two at a time, and print the words of each run."""
    folder.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(2) as pool:
        for lines in pool.map(partial(make, folder, balls), product(loads, seeds)):
            print("\n".join(lines), flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
