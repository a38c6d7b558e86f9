"""The slopes of the phase of many samples, from the paper's grid, against a finer grid.

`python tests/campaigns/slopes.py [SEEDS [TIMES]]`, 10 times as fine unless given: resolved curves,
and frequencies solved one by one, must give no slope that differs by more than its standard error
from that of the fine grid.
"""

import sys

import numpy as np

import pgran

PAPER, SITE = np.linspace(0.01, 1.3, 1291), (8, 10)


def slope(response):
    """The least-squares slope between .3 and 1 of the phase at equal distances."""
    inside = (response.omega >= 0.3) & (response.omega <= 1)
    phase = np.unwrap(np.angle(response.displacement[:, 0]))
    return np.polyfit(response.omega[inside], phase[inside], 1)[0]


def main(seeds=100, times=10):
    """Compare, print, and return the number of wrong slopes."""
    fine = np.linspace(PAPER[0], PAPER[-1], 1290 * times + 1)
    wrong, withheld, differences = 0, {"curve": 0, "points": 0}, {"curve": [], "points": []}
    for seed in range(1, seeds + 1):
        lattice = pgran.Lattice.random((20, 20), seed)
        exact = slope(pgran.sweep(lattice, fine, SITE, method="points"))
        for method in withheld:
            found = pgran.sweep(lattice, PAPER, SITE, method=method)
            if np.isnan(found.phase_slope[0]):
                withheld[method] += 1
                continue
            part = abs(found.phase_slope[0] - exact) / found.phase_slope_error[0]
            differences[method].append(part)
            if part > 1:
                wrong += 1
                print(f"seed {seed}, {method}: {found.phase_slope[0]:.4f}, and not {exact:.4f}")
    for method, parts in differences.items():
        print(
            f"{method}: {len(parts)} slopes, differing by at most {max(parts, default=0):.2g} of "
            f"their standard errors, {withheld[method]} withheld"
        )
    return wrong


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])) > 0)
