"""Long relaxations, checked at random steps against dense solves from the stored bonds and events.

    python tests/campaigns/relaxation.py STEPS

tests/test_relaxation.py has the short ones.
"""

import sys
from itertools import product
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1]))

import numpy as np
from mpi4py import MPI
from reference import Reference

from pgran.experiments.relaxation.scene import relax
from pgran.medium.lattice import Lattice
from pgran.medium.law import BondLaw
from pgran.run.crew import Crew

UNIFORM = BondLaw("uniform")


def relaxed(lattice, sites, comm=MPI.COMM_SELF, ranks=1, law=UNIFORM, omega=0.5, **choices):
    """A relaxation, on every rank of `comm`; so many of them share a lattice."""
    with Crew(comm, ranks) as crew:
        return comm.bcast(relax(lattice, law, omega, sites, crew, **choices))


def exact_amplitudes(lattice, omega, sites, places, constants, steps):
    """Yield the amplitudes after some steps, increasing, by dense solves; places: axes, indices."""
    stiffness, done = [k.copy() for k in lattice.stiffness], 0
    changes = list(zip(*places, constants, strict=True))
    for step in steps:
        for axis, index, constant in changes[done:step]:
            stiffness[axis][tuple(index)] = constant
        done = step
        yield Reference(stiffness, lattice.mass, lattice.damping).amplitudes(omega, sites)


def largest_error(lattice, relaxation, steps, trajectory=0):
    """The largest relative error of the amplitudes after some steps."""
    steps, stored = sorted(steps), relaxation.stiffness[trajectory]
    places = relaxation.bond_axis[trajectory], relaxation.bond_index[trajectory]
    sites = relaxation.detector
    exact = np.array([*exact_amplitudes(lattice, relaxation.omega, sites, places, stored, steps)])
    wrong = relaxation.displacement[trajectory, steps] - exact
    return float(np.max(np.abs(wrong) / np.abs(exact)))


def main(steps):
    """Print the largest errors at 200 random steps of long runs."""
    laws = {"uniform": UNIFORM, "bonds of 0": BondLaw("bimodal", kmin=0.0, fraction=0.7)}
    places = ((30,), [[14]]), ((7, 6), [[3, 2]]), ((4, 3, 4), [[1, 1, 2]])
    print("largest relative error at 200 random steps, drift, steps that miss their accuracy")
    for (shape, sites), beta, name in product(places, (1e-4, 1e-2, 1.0), laws):
        lattice = Lattice.random(shape, 5, laws[name], damping=beta)
        run = relaxed(lattice, sites, law=laws[name], omega=0.6, steps=steps)
        good = np.flatnonzero(np.isfinite(run.displacement[0, :, 0]))
        chosen = np.random.default_rng(1).choice(good, min(200, len(good)), False)
        worst = largest_error(lattice, run, chosen)
        print(f"{shape}, beta {beta:g}, {name}: {worst:.1e} {run.drift:.1e} {run.failures}")


if __name__ == "__main__":
    main(int(sys.argv[1]))
