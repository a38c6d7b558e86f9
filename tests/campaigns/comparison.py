"""The default sweep of chains and squares, compared with 60 digits at every STRIDE-th frequency.

    python tests/campaigns/comparison.py STRIDE

tests/test_comparison.py has the short ones.
"""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1]))

import numpy as np
from mpmath import mp
from reference import refined_field
from samples import swept

from pgran.physics.lattice import Lattice


def report(shape, site, stride):
    """Print how many bounds are broken, and how sharp the others are."""
    lattice = Lattice.random(shape)
    found = swept(lattice, np.linspace(0.01, 1.3, 1291), site)
    some = slice(None, None, stride)
    bound, wrong, size = found.error_bound[some, 0], [], []
    with mp.workdps(60):
        for omega, amplitude in zip(found.omega[some], found.displacement[some, 0], strict=True):
            exact = refined_field(lattice.stiffness, lattice.mass, lattice.damping, omega)[site]
            wrong.append(float(abs(mp.mpmathify(complex(amplitude)) - exact)))
            size.append(float(abs(exact)))
    wrong, size = np.array(wrong), np.array(size)
    relative = ~(found.at_floor[some, 0] > 0)
    print(
        f"{shape}, ball {site}: {found.failures} of {len(found.omega)} marked, "
        f"{np.count_nonzero(found.at_floor)} at the floor; of {len(bound)} compared "
        f"{np.count_nonzero(wrong > bound)} bounds are broken; smallest |A| {size.min():.1e}, "
        f"largest relative error {np.max((wrong / size)[relative]):.1e}; "
        f"bound / error: median {np.median(bound / wrong):.3g}",
        flush=True,
    )


if __name__ == "__main__":
    report((31,), (8,), 1)
    report((100,), (8,), 1)
    for side in (40, 60):
        report((side, side), (8, 10), int(sys.argv[1]))
