"""Lattices to test with. Their bonds come from NumPy's default generator, not from pgran's laws.

And PETSc options: those of a text, and whether this PETSc has KLU.
"""

import numpy as np
import pytest
from petsc4py import PETSc

from pgran.command.doctor import has_solver
from pgran.command.resolve import SCENES
from pgran.parallel.crew import Crew
from pgran.physics.lattice import Lattice

HAS_KLU = has_solver(PETSc, "klu")
needs_klu = pytest.mark.skipif(not HAS_KLU, reason="this PETSc has no KLU")


def bond_arrays(shape, draw):
    """One array of bonds for each axis, filled by `draw(size)`."""
    return tuple(
        draw(tuple(n + (a == axis) for a, n in enumerate(shape))) for axis in range(len(shape))
    )


def random_lattice(shape, seed=0, damping=0.003, mass=1.0, law="uniform"):
    """A lattice of random bonds, the same on every rank."""
    rng = np.random.default_rng(seed)
    laws = {
        "uniform": lambda size: rng.uniform(0, 0.25, size),
        "bimodal": lambda size: rng.choice([0.0, 0.25], size, p=[0.3, 0.7]),
        "wide": lambda size: 0.25 * 10 ** rng.uniform(-6, 0, size),
    }
    return Lattice(bond_arrays(shape, laws[law]), mass, damping, kmax=0.25)


def uniform_lattice(shape, stiffness=0.25, damping=0.003, mass=1.0):
    """A lattice of equal bonds."""
    return Lattice(bond_arrays(shape, lambda size: np.full(size, stiffness)), mass, damping)


def paper_lattice(seed=0):
    """20 x 20 balls at the paper's parameters."""
    return random_lattice((20, 20), seed)


def skip_unless_ranks_fit(shape, comm):
    """Skip a test where PETSc cannot cut so few balls among the ranks."""
    if max(shape) < comm.size:
        pytest.skip("fewer balls along every axis than ranks")


def option_values(text):
    """The PETSc options of a text, `-key value -flag ...`, as a dictionary."""
    found = {}
    for word in text.split():
        if word.startswith("-") and word[1].isalpha():
            key = word[1:]
            found[key] = ""
        else:
            found[key] = word
    return found


def run_scene(options, world, journal=None):
    """Run the scene of some options; return its records on rank 0, None on the others."""
    scene = SCENES[options.scene]
    return scene.run(options, world, lambda ranks: Crew(world, ranks, journal))
