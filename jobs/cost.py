"""Seconds that structure factors take by moments and by factorizations, over balls: a figure.

    python jobs/cost.py FIGURE.png [MOST BALLS]

One wave of square and cubic lattices at 120 frequencies, on one rank. Of factorizations two are
timed, and only where balls are not too many for these. A minute of one core, and 4 GB.
"""

import itertools
import sys
import time

import numpy as np
from matplotlib.figure import Figure

import pgran

BALLS = (1000, 10**4, 10**5, 10**6)
MOST = {2: 10**6, 3: 10**5}  # that are factored
OMEGA = 1.2 * np.arange(1, 121) / 120
LOOKS = {"factor": "--", "moments": "-"}
COLOURS = {2: "tab:blue", 3: "tab:red"}


def seconds(balls, axes, method):
    """Return the size of a lattice of about so many balls, and how long its frequencies take."""
    lattice = pgran.Lattice.random((round(balls ** (1 / axes)),) * axes, damping=0.0)
    omegas = OMEGA[39:80:40] if method == "factor" else OMEGA
    started = time.perf_counter()
    pgran.structure(lattice, 1, omegas, direction="x", width=2 * OMEGA[0], method=method)
    return lattice.size, (time.perf_counter() - started) * len(OMEGA) / len(omegas)


def main(path, most=BALLS[-1]):
    """Measure, print a table, and draw."""
    seconds(100, 2, "factor"), seconds(100, 2, "moments")  # what takes its time but once
    figure = Figure((4.8, 3.4), layout="constrained")
    ax = figure.subplots()
    print("| lattice | method | balls | seconds |\n|---|---|---|---|")
    for axes, method in itertools.product(COLOURS, LOOKS):
        largest = min(int(most), MOST[axes] if method == "factor" else BALLS[-1])
        found = [seconds(balls, axes, method) for balls in BALLS if balls <= largest]
        for size, took in found:
            print(f"| {axes}D | {method} | {size} | {took:.2g} |", flush=True)
        look = {"linestyle": LOOKS[method], "color": COLOURS[axes], "label": f"{axes}D, {method}"}
        ax.loglog(*zip(*found, strict=True), marker="o", **look)
    ax.set(xlabel="balls", ylabel="seconds for 120 frequencies")
    ax.set_ylim(top=50 * ax.get_ylim()[1])  # room for the legend
    ax.legend(loc="upper left", ncols=2)
    figure.savefig(path, dpi=150)


if __name__ == "__main__":
    main(*sys.argv[1:])
