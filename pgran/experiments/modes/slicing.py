"""The slices of the spectrum that hold the wanted modes."""

import contextlib

import numpy as np
from mpi4py import MPI

from pgran.driven.counting import SLICE, ModeCounter, cut, shared
from pgran.driven.operators import Operators
from pgran.experiments.modes.normal import ModeSolver
from pgran.run.petsc import PETSc

SPARE = 4  # modes that are searched for beyond those that are wanted


@contextlib.contextmanager
def hermitian_operators(lattice):
    """Return, for a `with`, the operators of a lattice on this rank, K flagged as what it is.

    Not collective.
    """
    with Operators(lattice, MPI.COMM_SELF) as operators:
        for flag in (PETSc.Mat.Option.SYMMETRIC, PETSc.Mat.Option.HERMITIAN):
            operators.K.setOption(flag, True)
        yield operators


def find_slices(operators, crew, interval=None, targets=None, count=None):
    """Return the slices of the spectrum (low, high, count) that hold the wanted modes.

    Collective: the ranks share out the counts. In a dry run one slice amid the wanted modes stands
    for all.

    Parameters
    ----------
    operators : pgran.driven.operators.Operators
        Of this rank alone, K flagged symmetric and Hermitian. Below the lowest frequency 0 lie the
        modes that are unstable, if there are any.
    crew : pgran.run.crew.Crew
    interval, targets, count
        Which modes are wanted, as `pgran.find_modes` takes it.
    """
    world, mass = crew.world, operators.mass
    with ModeCounter(operators.K, operators.lattice) as counter:
        if targets is None:
            low, high = interval or (0.0, np.inf)
            ends = [counter.interval(mass * low**2, mass * high**2, world)]
        else:
            wanted = targets[:: max(1, len(targets) // 3)] if crew.dry else targets
            costly = counter.costly
            with ModeSolver(operators) as solver:

                def around(omega):
                    near = solver.nearest(mass * omega**2, count + SPARE) if costly else ()
                    found = np.sign(near) * np.sqrt(np.abs(near) / mass)
                    reach = _reach(found, omega, count)
                    return counter.around(omega, mass, count, reach)

                ends = _united([found for _, found in shared(world, list(wanted), around)])
        if ModeSolver.whole():
            slices = [(*found, max(found.values()) - min(found.values())) for found in ends]
            return [piece for piece in slices if piece[2] > 0]
        if not crew.dry:
            return [piece for found in ends for piece in cut(counter, found, world)]
        return _like_one_slice(counter, ends, mass)


def _reach(found, omega, count):
    """Return a distance from omega within which there seem to be `count` modes; None if unknown."""
    apart = np.sort(np.abs(found - omega))[max(count - 1, 0) : count + SPARE]
    if len(apart) < 2:
        return None
    widest = np.argmax(np.diff(apart))  # there the count is the surest
    return 0.5 * (apart[widest] + apart[widest + 1])


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
