"""Maps of what a signal depends on: small results of them, and what tests read off their axes."""

from itertools import product

import figure_results
import numpy as np
from matplotlib.collections import EllipseCollection, LineCollection, PolyCollection
from matplotlib.colors import to_rgb
from samples import random_lattice

import pgran
from pgran.medium.crystals import crystal

OMEGAS = [0.3, 0.6, 0.8, 1.1]
LATTICE = random_lattice((4, 3), seed=5, damping=0.05)


def result_of(record, medium=LATTICE):
    return figure_results.result_of(record, medium)


def title(ax):
    """The title of a panel, which this style has on the left, and others in the middle."""
    return ax.get_title(loc="left") or ax.get_title()


def depends(lattice=LATTICE, detectors=((1, 1),), omegas=OMEGAS, **wanted):
    return pgran.sensitivity(lattice, omegas, np.ravel(detectors), **wanted)


def heated(lattice=LATTICE, detectors=((1, 1),), omegas=OMEGAS, **wanted):
    wanted = {"factor": 1.1, "cut": True} | wanted
    return pgran.heat(lattice, omegas, np.ravel(detectors), **wanted)


def strip():
    """A strip of discs, periodic across, with stiffness at random."""
    return crystal(
        "triangular", (4, 3), lambda u: 0.5 + u / 2,
        periodic=(False, True), damping=0.05,
    )  # fmt: skip


def joined(shape):
    """Where each bond begins and ends, axis after axis, each in C order."""
    ends = []
    for axis in range(len(shape)):
        for index in product(*(range(n + (a == axis)) for a, n in enumerate(shape))):
            lower = np.array(index) - (np.arange(len(shape)) == axis)
            ends.append([lower, np.array(index)])
    return np.array(ends)


def bond_lines(ax):
    """The lines that have colours of their own, and the white ones that make them hollow."""
    found = [c for c in ax.collections if isinstance(c, LineCollection)]
    (coloured,) = (c for c in found if c.get_array() is not None)
    (hollow,) = (c for c in found if c.get_label() == "negative")
    assert np.all(hollow.get_colors()[:, :3] == to_rgb("white"))
    return coloured, hollow


def discs(ax):
    """The balls that have colours."""
    (drawn,) = (c for c in ax.collections
                if isinstance(c, EllipseCollection) and c.get_array() is not None)  # fmt: skip
    return drawn


def wedges(ax):
    """Where each wedge begins and ends, and how broad it is."""
    (drawn,) = (c for c in ax.collections if isinstance(c, PolyCollection))
    corners = np.array([path.vertices[:3] for path in drawn.get_paths()])
    start = corners[:, :2].mean(axis=1)
    return start, corners[:, 2], np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)
