"""Short trials of a run's own work, on its lattice or on a smaller one like it.

They tell how fast this machine is, with all ranks at work as in the run, and how many
factorizations and modes to expect.
"""

import contextlib
import dataclasses
import time
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from pgran.command.costs import Costs
from pgran.physics.lattice import Lattice
from pgran.scenes.common import make_lattice, make_law
from pgran.solve.linear import factor_package
from pgran.solve.operators import Operators
from pgran.solve.steady import SteadySolver

# A trial takes so long, and at least so many units of work: low and high frequencies differ.
SECONDS, FEWEST = 0.15, 3
LARGEST = {1: 4000, 2: 1600, 3: 1000}  # balls


@dataclass(frozen=True)
class Trial:
    """What points (frequencies, or steps of a relaxation) took.

    Attributes
    ----------
    costs : pgran.command.costs.Costs
        Of the lattice that was tried.
    first, seconds : float
        Of the first point, symbolic factorization included, and of any later one.
    factorizations, solves : float
        To a point.
    """

    costs: Costs
    first: float
    seconds: float
    factorizations: float
    solves: float

    def scaled(self, costs):
        """Return the seconds of the first and of a later point of another lattice.

        Not collective. None where iterations without a factorization grow in their own ways.
        """
        if costs.shape == self.costs.shape:
            return self.first, self.seconds
        if not costs.fill:
            return None
        there, here = (
            self.factorizations * c.factoring + self.solves * c.solving for c in (costs, self.costs)
        )
        return self.first * costs.entries / self.costs.entries, self.seconds * there / here


def trial_lattice(options, world):
    """Return the shape of the options' lattice, and the lattice, cut down where it is large.

    Collective. Errors are those that the run would meet.
    """
    if options.bonds_law == "file":
        whole = make_lattice(options, world)
        shape, small, kmax = whole.shape, trial_shape(whole.shape), whole.kmax
        stiffness = [
            k[tuple(slice(n + (a == axis)) for a, n in enumerate(small))]
            for axis, k in enumerate(whole.stiffness)
        ]
    else:
        law = make_law(options)
        shape, kmax = options.lattice_shape, law.kmax
        stiffness = law.draw(trial_shape(shape), options.bonds_seed)
    damping = getattr(options, "lattice_damping", 0.0)
    return shape, Lattice(tuple(stiffness), options.lattice_mass, damping, kmax)


def trial_shape(shape):
    """Return a shape of few balls, the longest axes cut first. Not collective."""
    room, sides = float(LARGEST[len(shape)]), [1] * len(shape)
    shortest_first = sorted(range(len(shape)), key=shape.__getitem__)
    for place, axis in enumerate(shortest_first):
        sides[axis] = min(shape[axis], round(room ** (1 / (len(shape) - place))))
        room /= sides[axis]
    return tuple(sides)


def trial_sites(sites, shape, small):
    """Return detectors inside a smaller lattice, as far from the driven wall. Not collective."""
    inside = sites * np.array(small) // np.array(shape)
    inside[:, 0] = np.maximum(sites[:, 0] - shape[0] + small[0], 0)
    return inside


@contextlib.contextmanager
def steady_solver(lattice, shape, group, *arguments, **keywords):
    """Make operators and a solver for a trial, with the factorization that `shape` would have.

    Collective. A small lattice is shared by the ranks of `group` as in the run.
    """
    database, key = PETSc.Options("steady_"), "pc_factor_mat_solver_type"
    comm = group if lattice.shape == shape else MPI.COMM_SELF
    borrowed = comm is not group and not database.hasName(key)
    if borrowed:
        database.setValue(key, factor_package(shape, group.size))
    try:
        with (
            Operators(lattice, comm) as operators,
            SteadySolver(operators, *arguments, **keywords) as solver,
        ):
            yield operators, solver
    finally:
        if borrowed:
            database.delValue(key)


def try_steady(world, shape, solver, omega, units, work):
    """Return the Trial of some of the units.

    Collective.

    Parameters
    ----------
    world : mpi4py.MPI.Comm
    shape : tuple of int
        Of the lattice tried.
    solver : pgran.solve.steady.SteadySolver
    omega : float
        The first point's frequency.
    units : sequence
    work : callable
        Takes a unit, and returns how many points and how many solves it was.
    """
    world.Barrier()
    began = time.perf_counter()
    solver.solve(1j * omega)
    first = time.perf_counter() - began
    before, points, solves, began = solver.factorizations, 0, 0, time.perf_counter()
    for count, unit in enumerate(units, 1):
        more = work(unit)
        points, solves = points + more[0], solves + more[1]
        if count >= FEWEST and solver.comm.bcast(time.perf_counter() - began) > SECONDS:
            break
    seconds = (time.perf_counter() - began) / points
    factorizations = (solver.factorizations - before) / points
    package = PETSc.Options("steady_").getString(
        "pc_factor_mat_solver_type", factor_package(shape, solver.comm.size)
    )
    costs = Costs(shape, package)
    fill = 0.0
    if solver.factor is not None:
        found = solver.factor.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"]
        fill = found / costs.entries if found else 1.0
    costs = dataclasses.replace(costs, fill=fill)
    first, seconds = (mean(world, t) for t in (first, seconds))
    return Trial(costs, first, seconds, factorizations, solves / points)


@dataclass(frozen=True)
class ModeTrial:
    """What a slice of modes and a count took.

    Attributes
    ----------
    costs : pgran.command.costs.Costs
        Of the lattice that was tried.
    slicing, counting : float
        Seconds.
    part : float
        Of all modes that the interval asked for holds.
    whole : bool
        Whether all modes are found at once instead of slices.
    """

    costs: Costs
    slicing: float
    counting: float
    part: float
    whole: bool


def try_modes(world, lattice, interval):
    """Return the ModeTrial of a slice in the middle of an interval of omega. Collective."""
    from pgran.solve.counting import SLICE, ModeCounter
    from pgran.solve.normal import ModeSolver

    costs, (lattice, _) = Costs(lattice.shape, "petsc"), lattice.in_own_unit()
    low, high = (lattice.mass * omega**2 for omega in interval)
    with Operators(dataclasses.replace(lattice, damping=0.0), MPI.COMM_SELF) as operators:
        for flag in (PETSc.Mat.Option.SYMMETRIC, PETSc.Mat.Option.HERMITIAN):
            operators.K.setOption(flag, True)
        with ModeCounter(operators.K) as counter, ModeSolver(lattice, operators.K) as solver:
            below = list(counter.interval(low, high).values())
            middle = 0.5 * (min(low, counter.norm) + min(high, counter.norm))
            world.Barrier()
            began = time.perf_counter()
            counter.below(middle, counter.clearance)
            counting = time.perf_counter() - began
            ends = counter.around((middle / lattice.mass) ** 0.5, lattice.mass, SLICE)
            began = time.perf_counter()
            solver.solve(*ends, abs(np.diff(list(ends.values()))[0]))
            slicing = time.perf_counter() - began
    slicing, counting = (mean(world, t) for t in (slicing, counting))
    part = (below[1] - below[0]) / lattice.balls
    return ModeTrial(costs, slicing, counting, part, ModeSolver.whole())


def product_seconds(world, modes, balls):
    """Return the seconds that projecting a complex field on so many modes takes. Collective."""
    rows = min(modes, 1 + 1_000_000 // balls)
    shapes, field = np.ones((rows, balls)), np.ones(balls)
    world.Barrier()
    began = time.perf_counter()
    for _ in range(3):
        shapes @ field
    seconds = (time.perf_counter() - began) / 3 * 2 * modes / rows
    return mean(world, seconds)


def mean(world, seconds):
    """Return the mean over the ranks, which scatters less than the slowest. Collective."""
    return world.allreduce(seconds) / world.size


def spread(units):
    """Return units from all over the run first. Not collective."""
    golden = 0.6180339887498949
    return [units[i] for i in sorted(range(len(units)), key=lambda i: i * golden % 1)]
