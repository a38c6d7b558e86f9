"""The slices of the spectrum that hold the wanted modes."""

import contextlib

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from pgran.solve.counting import SLICE, ModeCounter, cut, shared
from pgran.solve.normal import ModeSolver
from pgran.solve.operators import Operators


@contextlib.contextmanager
def hermitian_stiffness(lattice):
    """Return, for a `with`, the stiffness of a lattice on this rank, flagged as what it is.

    Not collective.
    """
    with Operators(lattice, MPI.COMM_SELF) as operators:
        for flag in (PETSc.Mat.Option.SYMMETRIC, PETSc.Mat.Option.HERMITIAN):
            operators.K.setOption(flag, True)
        yield operators.K


def find_slices(K, lattice, crew, interval=None, targets=None, count=None):
    """Return the slices of the spectrum (low, high, count) that hold the wanted modes.

    Collective: the ranks share out the counts. In a dry run one slice amid the wanted modes stands
    for all.

    Parameters
    ----------
    K : petsc4py.PETSc.Mat
        The stiffness, flagged symmetric and Hermitian, of this rank alone.
    lattice : pgran.physics.lattice.Lattice or pgran.physics.network.Network
        Below the lowest frequency 0 lie the modes that are unstable, if there are any.
    crew : pgran.parallel.crew.Crew
    interval, targets, count
        Which modes are wanted, as `pgran.find_modes` takes it.
    """
    world, mass = crew.world, lattice.mass
    with ModeCounter(K, lattice) as counter:
        if targets is None:
            low, high = interval or (0.0, np.inf)
            ends = [counter.interval(mass * low**2, mass * high**2, world)]
        else:
            wanted = targets[:: max(1, len(targets) // 3)] if crew.dry else targets
            around = shared(world, list(wanted), lambda omega: counter.around(omega, mass, count))
            ends = _united([found for _, found in around])
        if ModeSolver.whole():
            slices = [(*found, max(found.values()) - min(found.values())) for found in ends]
            return [piece for piece in slices if piece[2] > 0]
        if not crew.dry:
            return [piece for found in ends for piece in cut(counter, found, world)]
        return _like_one_slice(counter, ends, mass)


def _like_one_slice(counter, intervals, mass):
    """Return as many slices as intervals need, all of them one that lies amid the first."""
    total = sum(max(found.values()) - min(found.values()) for found in intervals)
    low, high = (min(max(end, 0.0), counter.norm) for end in intervals[0])
    omega = (0.5 * (low + high) / mass) ** 0.5
    pieces = []
    while total > 0:
        found = counter.around(omega, mass, min(SLICE, total))
        count = max(found.values()) - min(found.values())
        pieces += [(*found, count)] * max(1, total // count)
        total -= count * max(1, total // count)
    return pieces


def _united(intervals):
    """Return intervals with overlapping ones joined."""
    joined = []
    for low, high in sorted(list(ends.items()) for ends in intervals):
        if joined and low <= joined[-1][1]:
            joined[-1][1] = max(joined[-1][1], high)
        else:
            joined.append([low, high])
    return [dict(ends) for ends in joined]
