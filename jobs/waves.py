"""Sound waves in packings on their way to where they lose their rigidity: a table.

    python jobs/waves.py [BALLS [PRESSURE ...]]

Periodic packings of harmonic discs of two sizes, without dashpots: their contacts beyond 2 a disc;
speed and rate of scattering of the longest waves, longitudinal and transverse; the frequency where
these end (omega_IR, pi Gamma = Omega); where D(omega) / omega is largest (omega*, the boson peak),
and of the modes there D and the share P / N of discs that take part. "<": the packing is too small
to tell; "?": some shorter waves are below the limit again. In (k/m)^(1/2) and mean diameters, of
one sample. A pressure takes 15 s of one core for 1000 discs, 4 min for 10,000.
"""

import dataclasses
import sys

import numpy as np

import pgran
from pgran.experiments.structure.scene import ioffe_regel

OMEGA = np.geomspace(0.004, 2.4, 120)  # of waves
EDGES = np.geomspace(0.004, 2.4, 100)  # below which modes are counted
MAGNITUDES, MODES = 14, 30  # of wave vectors; that a density is made of
HEAD = ["pressure", "discs", "contacts - 2", "smallest q"]
HEAD += [f"{name}_{branch}" for branch in "LT" for name in ("c", "Gamma", "omega_IR")]
HEAD += ["omega*", "D(omega*)", "P/N(omega*)"]


def measured(balls, pressure):
    """Return the row of a packing."""
    network = dataclasses.replace(pgran.pack(balls, pressure=pressure), damping=0.0)
    discs = network.free_balls
    row = [f"{pressure:g}", str(discs), f"{network.bonds / discs - 2:.3f}"]
    waves = pgran.structure(network, MAGNITUDES, OMEGA)
    row.append(f"{waves.q[0]:.3g}")
    for b in range(2):
        error = waves.frequency_error[b, 0] / waves.q[0]
        limit, said = ioffe_regel(waves.frequency[b], waves.scattering[b])
        doubtful = f"{limit:.2g}{'?' if said else ''}"
        small = f"< {waves.frequency[b, 0]:.2g}" if "too small" in said else "-"
        row.append(f"{waves.velocity[b, 0]:.3f} +- {error:.1g}")
        row += [f"{waves.scattering[b, 0]:.2g}", doubtful if np.isfinite(limit) else small]
    counted = pgran.count_modes(network, EDGES).count
    edges = np.interp(np.arange(0, counted[-1], MODES), counted, EDGES)  # of so many modes each
    middle, density = 0.5 * (edges[1:] + edges[:-1]), MODES / np.diff(edges) / discs
    at = np.argmax(density / middle)
    modes = pgran.find_modes(network, targets=[middle[at]], count=MODES)
    numbers = [density[at], modes.participation.mean() / discs]
    star = f"{'' if at else '< '}{middle[at]:.2g}"
    return [*row, star, *(f"{number:.2g}" for number in numbers)]


def main(balls=1000, *pressures):
    """Print the table."""
    print(f"| {' | '.join(HEAD)} |\n|{'---|' * len(HEAD)}")
    for pressure in pressures or (1e-1, 1e-2, 1e-3):
        print(f"| {' | '.join(measured(int(balls), float(pressure)))} |", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
