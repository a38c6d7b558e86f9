"""The default sweep of chains and squares, compared with 60 digits at every STRIDE-th frequency.

    python tests/campaigns/comparison.py STRIDE [SHAPE ...]

Shapes are written 31 or 40,40; of chains every frequency is compared.

tests/test_comparison.py has the short ones.
"""

import sys
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from amplitude_faults import sweep_faults
from reference import refined_field
from samples import Case

from pgran.medium.lattice import Lattice


def refined(stiffness, mass, damping, omega, sites):
    """The amplitudes at some balls, by a method for larger lattices."""
    field = refined_field(stiffness, mass, damping, omega)
    return [field[tuple(site)] for site in sites]


def main(stride, *shapes):
    """Compare, and print what is false."""
    for text in shapes or ("31", "100", "40,40", "60,60"):
        shape, seen = tuple(map(int, text.split(","))), Counter()
        site, omegas = np.array([(8, 10)[: len(shape)]]), np.linspace(0.01, 1.3, 1291)
        case = Case(1993, Lattice.random(shape), omegas, site, "default", 1e-4, 1e-20, 60)
        for fault in sweep_faults(
            case, seen, eliminate=refined, stride=int(stride) if len(shape) > 1 else 1
        ):
            print(fault)
        print(f"{shape}:", ", ".join(f"{n:.7g} {what}" for what, n in seen.items()), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
