"""Loud sound in random packings, against motions in time.

    python tests/campaigns/loud.py FIRST LAST [LEAST MOST]

tries packings of these seeds, of so many balls (60 to 150), in two or three dimensions, by both
laws, with dashpots that stay and that follow: harmonics against DOP853 of the same equations, their
estimated errors, and multipliers against the monodromy matrix. What is WRONG is printed.
"""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))  # before this script's folder

from loud_samples import Motion, packing

import pgran

REACH, KNOWN = 3.0, 1e-7  # how well motions in time are known, in units of the field
RATIOS = 0.3, 3.0  # of an estimate and the error
ALIKE = 1e-3  # of multipliers


def judged(seed, least, most):
    """Yield what is wrong with a packing, then what was seen of it."""
    rng = np.random.default_rng([47, seed])
    law, power = ("hertz", "harmonic")[seed % 2], float(seed // 2 % 2)
    dimension, balls = int(rng.integers(2, 4)), int(rng.integers(least, most + 1))
    quality, frequency = 10 ** rng.uniform(0.5, 1.2), rng.uniform(0.15, 0.5)
    amplitude = 10 ** rng.uniform(-0.52, 0.48)
    network, omega = packing(balls, dimension, law, seed, quality, frequency, power)
    found = pgran.loud(network, [omega], network.free, [amplitude], unit="opening", reach=REACH)
    said = f"seed {seed}: {balls} balls, {dimension}D, {law}, p = {power:g}, {amplitude:.2f} a*, "
    said += f"{100 * found.clapping[0, 0]:.1f} % clap, |mu| {abs(found.multiplier[0, 0]):.4f}"
    if not found.reached[0, 0] or abs(found.multiplier[0, 0]) > 1 - ALIKE:
        yield f"{said}: not reached, or not stable"
        return
    steps = int(np.ceil(6 * np.sqrt(network.stiffness_norm / network.mass) / omega))
    motion = Motion(network, REACH).periodic(omega, found.drive[0, 0], 20, steps=4 * steps)
    unknowns, weights = network.readings(network.sites(network.free))
    exact = np.einsum("da,dan->dn", weights, motion[0][unknowns])[:, : found.harmonic.shape[-1]]
    error, estimate = (
        np.linalg.norm(x[:, 1]) / np.linalg.norm(exact)
        for x in (found.harmonic[0, 0] - exact, found.harmonic_error[0, 0])
    )
    largest = np.abs(np.linalg.eigvals(motion[1])).max()
    off = abs(abs(found.multiplier[0, 0]) / largest - 1)
    said += f", error {error:.1e}, estimate {estimate:.1e}, multiplier off by {off:.0e}"
    known = max(KNOWN, 10 * motion[2])
    within = error < known or RATIOS[0] <= estimate / error <= RATIOS[1]
    yield f"{'' if within and off < ALIKE else 'WRONG '}{said}"


def main(first, last, least=60, most=150):
    """Try the seeds; return the number of faults."""
    lines = [line for seed in range(first, last) for line in judged(seed, least, most)]
    print(*lines, sep="\n")
    wrong = sum(line.startswith("WRONG") for line in lines)
    print(f"{len(lines)} packings, {wrong} wrong")
    return wrong


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])) > 0)
