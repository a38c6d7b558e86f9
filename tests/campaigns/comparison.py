"""The default sweep of chains and squares, compared with 60 digits at every STRIDE-th frequency.

    python tests/campaigns/comparison.py STRIDE [SHAPE ...]

Shapes are written 31 or 40,40; of chains every frequency is compared.

tests/test_comparison.py has the short ones.
"""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1]))

import numpy as np
from campaigns.random_sweeps import points, report
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
        shape = tuple(map(int, text.split(",")))
        lattice = Lattice.random(shape)
        site, omegas = np.array([(8, 10)[: len(shape)]]), np.linspace(0.01, 1.3, 1291)
        case = Case(1993, lattice, omegas, site, "default", 1e-4, 1e-20, 60)
        report(str(shape), points(case, refined, int(stride) if len(shape) > 1 else 1))


if __name__ == "__main__":
    main(*sys.argv[1:])
