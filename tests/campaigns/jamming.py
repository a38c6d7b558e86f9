"""Contacts beyond isostatic against the mean overlap h of packings: z - z_iso grows like h^.5.

`python tests/campaigns/jamming.py [SEEDS [BALLS [DIMENSIONS [DECADES]]]]`, 6 seeds of 500 discs (2)
and spheres (3), 23, over 3 decades of pressure below 1e-2 unless given: of both laws, the mean over
the seeds of z - z_iso, z_iso = 2 d (1 - 1/N), at each pressure, and the exponent of a straight line
through them, with the error that leaving out each seed in turn says. O'Hern, Silbert, Liu, Nagel,
Phys. Rev. E 68, 011306 (2003): 1/2; lines through so few balls drift by .03.
"""

import sys

import numpy as np

from pgran.balance.pack import packed_network

LOW, HIGH = 0.45, 0.60


def packings(dimension, law, pressure, seeds, balls):
    """Return mean overlaps and z - z_iso, a row of a packing each."""
    rows = []
    for seed in range(1, seeds + 1):
        network, packed = packed_network(balls, dimension, law, pressure=pressure, seed=seed)
        assert packed.excess >= 0, f"BROKEN: seed {seed} lacks {-packed.excess} contacts"
        rows.append((network.overlap.mean(), 2 * (packed.excess + 1) / len(network.held)))
    return np.array(rows)


def exponent(rows):
    """Return the slope of ln (z - z_iso) over ln h, of means over seeds; rows (pressures, ., 2)."""
    h, more = np.log(rows.mean(axis=1)).T
    return np.polyfit(h, more, 1)[0]


def main(seeds=6, balls=500, dimensions=23, decades=3):
    """Pack, print, and return how many exponents are wrong by two of their errors."""
    wrong = 0
    for dimension in map(int, str(dimensions)):
        for law in ("harmonic", "hertz"):
            pressures = 10.0 ** -np.arange(2, 3 + decades)
            rows = [packings(dimension, law, p, seeds, balls) for p in pressures]
            each = np.array(rows)
            others = [exponent(np.delete(each, n, axis=1)) for n in range(seeds)]
            slope, error = exponent(each), np.std(others) * np.sqrt(seeds - 1)
            inside = LOW - 2 * error <= slope <= HIGH + 2 * error
            wrong += not inside
            more = " ".join(f"{z:.3f}" for z in each[:, :, 1].mean(axis=1))
            print(
                f"{dimension}D {law}: z - z_iso {more} at pressures {pressures[0]:.0e} to "
                f"{pressures[-1]:.0e}: h^{slope:.3f} +- {error:.3f}{'' if inside else ' WRONG'}",
                flush=True,
            )
    return wrong


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])) > 0)
