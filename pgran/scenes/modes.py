"""Scene `modes`: normal modes, all of them, those of an interval, or those nearest to a target."""

import dataclasses
import time

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from pgran.parallel.crew import Crew
from pgran.parallel.progress import Progress
from pgran.physics.lattice import check_frequency
from pgran.physics.modes import participation
from pgran.results import LatticeRecord, Modes
from pgran.scenes.common import make_lattice
from pgran.solve.counting import ModeCounter, cut, shared
from pgran.solve.normal import RESIDUAL, ModeSolver
from pgran.solve.operators import Operators


def run(options, world, journal=None):
    """Return the lattice and its modes, on rank 0; None on the others. Collective."""
    lattice = make_lattice(options, world)
    with Crew(world, 1, journal) as crew:
        modes = find_modes(
            lattice,
            crew,
            **chosen(options),
            shapes=options.output_fields,
            progress=options.output_progress,
        )
    return modes and [LatticeRecord.of(lattice), modes]


def chosen(options):
    """Return which modes the options ask for, as `find_modes` takes it. Not collective."""
    if options.modes_omega_min is not None:
        return {"interval": (options.modes_omega_min, options.modes_omega_max)}
    if options.modes_target is not None:
        return {"targets": [options.modes_target], "count": options.modes_count}
    return {}


def summary(records):
    """Return in words what a run found. Not collective."""
    _, modes = records
    yield f"{len(modes.omega)} modes in {modes.solve_seconds:.2f} s"
    yield certificate(modes, len(modes.omega))
    if len(modes.omega):
        yield f"omega from {modes.omega[0]:.6g} to {modes.omega[-1]:.6g}"
        yield f"residuals at most {modes.residual.max():.1e} of |K|"
        yield (
            f"participation from {modes.participation.min():.3g} to "
            f"{modes.participation.max():.3g} balls"
        )


def certificate(record, found):
    """Return in words whether all modes were found. Not collective."""
    if record.count_certified:
        return f"all {record.count_expected} modes found, certified by their count"
    if found != record.count_expected:
        return f"NOT ALL MODES: {found} found where there are {record.count_expected}"
    return f"NOT CERTIFIED: the residuals of some of the {found} modes are above {RESIDUAL:g}"


def find_modes(
    lattice, crew, *, interval=None, targets=None, count=None, shapes=False, progress="none"
):
    """Find the normal modes K f = m omega^2 f, all unless an interval or targets are given.

    Collective. The spectrum is cut into slices by counts, which every rank makes, and the slices
    are shared out over the ranks; no slice depends on the number of ranks.

    Parameters
    ----------
    lattice : pgran.physics.lattice.Lattice
    crew : pgran.parallel.crew.Crew
        Of groups of one rank.
    interval : tuple of float, optional
        Lowest and highest omega; both ends belong to it.
    targets : sequence of float, optional
        Modes are wanted that are among the `count` nearest to any of these omegas.
    count : int, optional
    shapes : bool
        Keep the shapes.
    progress : str
        Style of `pgran.parallel.progress.Progress`.

    Returns
    -------
    pgran.results.Modes or None
        None on all ranks but rank 0. `count_certified` is False if modes are missing.

    Raises
    ------
    InputError
        If the interval or the targets are too high to compute with.
    PgranError
        If the modes cannot be counted.
    """
    started, root = time.perf_counter(), crew.world.rank == 0
    lattice, _ = dataclasses.replace(lattice, damping=0.0).in_own_unit()
    check_frequency(lattice, max(targets if targets is not None else interval or (0.0,)))
    with Operators(lattice, MPI.COMM_SELF) as operators:
        K = operators.K
        for flag in (PETSc.Mat.Option.SYMMETRIC, PETSc.Mat.Option.HERMITIAN):
            K.setOption(flag, True)
        with ModeCounter(K) as counter:
            intervals = _intervals(lattice, counter, crew.world, interval, targets, count)
            slices = _slices(counter, crew.world, intervals)
        found, row = [], _mode_dtype(lattice.shape if shapes else None)
        expected = sum(size for *_, size in slices)
        with (
            ModeSolver(lattice, K) as solver,
            Progress(expected, "modes", progress if root else "none") as done,
        ):

            def work(unit):
                number, piece = unit
                values, vectors, missed = solver.solve(*piece)
                rows = np.zeros(len(values), row)
                rows["slice"] = number
                rows["value"] = values
                rows["residual"] = missed
                rows["participation"] = participation(vectors)
                if shapes:
                    rows["vector"] = vectors
                return rows

            def deliver(rows):
                found.append(rows)
                done.advance(len(rows))

            crew.share(list(enumerate(slices)), work, deliver, row)
    if not root:
        return None
    modes = np.concatenate([np.zeros(0, row), *found])
    return _assemble(lattice, modes, slices, targets, count, started)


def _intervals(lattice, counter, world, interval, targets, count):
    """Return disjoint intervals of lambda that hold the wanted modes, each {end: count below}."""
    if targets is not None:
        around = shared(
            world, list(targets), lambda omega: counter.around(omega, lattice.mass, count)
        )
        return _united([ends for _, ends in around])
    low, high = interval or (0.0, np.inf)
    return [counter.interval(lattice.mass * low**2, lattice.mass * high**2, world)]


def _united(intervals):
    """Return intervals with overlapping ones joined."""
    joined = []
    for low, high in sorted(list(ends.items()) for ends in intervals):
        if joined and low <= joined[-1][1]:
            joined[-1][1] = max(joined[-1][1], high)
        else:
            joined.append([low, high])
    return [dict(ends) for ends in joined]


def _slices(counter, world, intervals):
    """Return the slices (low, high, count) to solve."""
    if not ModeSolver.whole():
        return [piece for ends in intervals for piece in cut(counter, ends, world)]
    slices = [(*ends, max(ends.values()) - min(ends.values())) for ends in intervals]
    return [piece for piece in slices if piece[2] > 0]


def _mode_dtype(shape):
    """Return the dtype that a mode travels in."""
    fields = [("slice", int), ("value", float), ("residual", float), ("participation", float)]
    return np.dtype(fields + ([("vector", float, shape)] if shape else []))


def _assemble(lattice, modes, slices, targets, count, started):
    """Return the Modes that the rows of all slices make up, certified slice by slice."""
    sizes = [size for *_, size in slices]
    expected = sum(sizes)
    found = np.bincount(modes["slice"], minlength=len(slices))
    certified = np.array_equal(found, sizes) and bool(np.all(modes["residual"] <= RESIDUAL))
    modes = modes[np.argsort(modes["value"], kind="stable")]
    # zero modes come out as rounding, of either sign
    omega = np.sqrt(np.maximum(modes["value"], 0.0) / lattice.mass)
    if targets is not None:
        wanted = np.zeros(len(modes), dtype=bool)
        for target in targets:
            wanted[np.argsort(np.abs(omega - target), kind="stable")[:count]] = True
        expected += np.count_nonzero(wanted) - len(modes)
        modes, omega = modes[wanted], omega[wanted]
    return Modes(
        count_expected=int(expected),
        count_certified=certified,
        solve_seconds=time.perf_counter() - started,
        omega=omega,
        residual=modes["residual"],
        participation=modes["participation"],
        vector=modes["vector"] if "vector" in modes.dtype.names else None,
    )
