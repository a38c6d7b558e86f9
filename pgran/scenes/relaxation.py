"""Scene `relaxation`: the amplitude at the detectors while one bond a step is redrawn."""

import logging
import time

import numpy as np

from pgran.errors import InputError
from pgran.parallel.progress import Progress
from pgran.physics.accuracy import is_accurate
from pgran.physics.changes import draw_changes
from pgran.physics.lattice import bond_count, bond_places, check_frequency, detector_sites
from pgran.physics.spectrum import check_window, power_spectrum
from pgran.results import LatticeRecord, Relaxation
from pgran.scenes.common import (
    below_relative_accuracy,
    make_crew,
    make_lattice,
    make_law,
    reached_accuracy,
)
from pgran.solve.changing import ChangingBonds
from pgran.solve.operators import Operators
from pgran.solve.steady import SteadySolver
from pgran.solve.windows import Windows, window_length

log = logging.getLogger(__name__)

STEPS_IN_UNIT = 512  # what a group of ranks solves at a stretch, in whole windows


def run(options, world, journal=None):
    """Return lattice, relaxation and spectrum, on rank 0; None on the others. Collective."""
    steps, trajectories = options.relax_steps, options.relax_trajectories
    window = options.spectrum_fit_min, options.spectrum_fit_max
    check_window(*window)  # before any work; too short a series only has no spectrum
    lattice = make_lattice(options, world)
    with make_crew(options, lattice, world, journal) as crew:
        relaxation = relax(
            lattice,
            make_law(options),
            options.relax_omega,
            options.detectors,
            crew,
            steps=steps,
            trajectories=trajectories,
            seed=options.relax_seed,
            method=options.relax_method,
            window=options.relax_window,
            error_tolerance=options.error_tolerance,
            error_floor=options.error_floor,
            refresh_iterations=options.steady_refresh_iterations,
            progress=options.output_progress,
        )
    if relaxation is None:
        return None
    records = [LatticeRecord.of(lattice), relaxation]
    if relaxation.failures:
        log.warning("no spectrum: some steps have no amplitude")
        return records
    if relaxation.at_floor[:, :, 0].any():
        log.warning("no spectrum: some amplitudes have an upper limit only (at_floor)")
        return records
    try:
        series, memory = relaxation.amplitude[:, :, 0], bond_count(lattice.shape)
        records.append(power_spectrum(series, *window, memory=memory))
    except InputError as error:
        log.warning("no spectrum: %s", error)
    return records


def summary(records):
    """Return in words what a run found. Not collective."""
    relaxation = records[1]
    steps = relaxation.bond_axis.size
    yield (
        f"{steps} steps with {relaxation.factorizations} factorizations in "
        f"{relaxation.solve_seconds:.2f} s"
    )
    yield from reached_accuracy(relaxation, ~np.isnan(relaxation.displacement).any(axis=2))
    if relaxation.drift > 0:
        yield (
            f"largest relative difference between a window's end and the next one's start: "
            f"{relaxation.drift:.1e}"
        )
    for spectrum in records[2:]:
        yield (
            f"power spectrum S(f) ~ f^-psi with psi = {spectrum.exponent:.3f} +- "
            f"{spectrum.exponent_error:.3f} between {spectrum.fit_min:g} and "
            f"{spectrum.fit_max:g} cycles per step"
        )


def relax(
    lattice,
    law,
    omega,
    detectors,
    crew,
    *,
    steps,
    trajectories=1,
    seed=1,
    method="window",
    window=0,
    error_tolerance=1e-4,
    error_floor=1e-20,
    refresh_iterations=0,
    progress="none",
):
    """Redraw one bond a step and solve the steady state each time (paper: section 5, timeres).

    Collective.

    Parameters
    ----------
    lattice : pgran.physics.lattice.Lattice
        Before any change.
    law : callable
        Turns numbers uniform on [0, 1) into bond constants.
    omega : float
        Driving frequency, angular.
    detectors : array_like of int
        Ball indices, flat or one row a detector.
    crew : pgran.parallel.crew.Crew
    steps, trajectories, seed : int
        Trajectories are independent and all start from the lattice's bonds.
    method : {"window", "krylov", "direct"}
        Windows of known changes on one factorization; an iteration from the last step, with an
        earlier factorization as preconditioner; or a factorization a step.
    window : int
        Steps to a window; 0 decides by the size of the lattice.
    error_tolerance, refresh_iterations, error_floor
        See `pgran.solve.steady.SteadySolver`.
    progress : str
        Style of `pgran.parallel.progress.Progress`.

    Returns
    -------
    pgran.results.Relaxation or None
        None on all ranks but rank 0.
    """
    sites = detector_sites(lattice.shape, detectors)
    scaled, unit = lattice.in_own_unit()
    check_frequency(scaled, omega)
    root = crew.world.rank == 0
    window = window or window_length(lattice.balls)
    length = unit_length(window)
    units = [
        (trajectory, first, min(length, steps - first))
        for trajectory in range(trajectories)
        for first in range(0, steps, length)
    ]
    row = np.dtype(
        [
            ("trajectory", np.int64),
            ("first", np.int64),
            ("count", np.int64),
            ("drift", float),
            ("factorizations", np.int64),
            ("displacement", complex, (length + 1, len(sites))),
            ("error_bound", float, (length + 1, len(sites))),
        ]
    )
    displacement = np.empty((trajectories, steps + 1, len(sites)), complex) if root else None
    error_bound = np.empty(displacement.shape) if root else None
    drift, factorizations, started = 0.0, 0, time.perf_counter()
    with (
        Operators(scaled, crew.group) as operators,
        SteadySolver(
            operators, sites, error_tolerance, refresh_iterations, error_floor=error_floor
        ) as solver,
        Progress(trajectories * steps, "steps", progress if root else "none") as counter,
    ):

        def draw(trajectory, first, count):
            return draw_changes(law, lattice.shape, seed, trajectory, first, count, unit)

        changing = ChangingBonds(scaled, operators, draw)
        march = {"window": march_windows, "krylov": march_steps, "direct": march_steps}[method]

        def work(unit):
            trajectory, first, count = unit
            before = solver.factorizations
            changing.move_to(trajectory, first)
            solver.restart()
            changes = draw(trajectory, first, count)
            found, bound, drift = march(changing, solver, 1j * omega, changes, window, method)
            rows = np.zeros(1, row)
            rows[0]["trajectory"], rows[0]["first"], rows[0]["count"] = unit
            rows[0]["drift"] = drift
            rows[0]["factorizations"] = solver.factorizations - before
            rows[0]["displacement"][: count + 1] = found
            rows[0]["error_bound"][: count + 1] = bound
            return rows

        def deliver(rows):
            nonlocal drift, factorizations
            for part in rows:
                trajectory, first, count = part["trajectory"], part["first"], part["count"]
                new = slice(int(first > 0), count + 1)  # a state between units is the earlier one's
                for whole, name in ((displacement, "displacement"), (error_bound, "error_bound")):
                    whole[trajectory, first + new.start : first + count + 1] = part[name][new]
                drift = max(drift, part["drift"])
                factorizations += part["factorizations"]
                counter.advance(int(part["count"]))

        crew.share(units, work, deliver, row)
    if not root:
        return None
    changes = [draw_changes(law, lattice.shape, seed, r, 0, steps) for r in range(trajectories)]
    axis, index = bond_places(lattice.shape, np.stack([c.bond for c in changes]))
    return Relaxation(
        omega=omega,
        factorizations=factorizations,
        solve_seconds=time.perf_counter() - started,
        drift=drift,
        bond_axis=axis,
        bond_index=index,
        stiffness=np.stack([c.stiffness for c in changes]),
        detector=sites,
        displacement=displacement,
        error_bound=error_bound,
        at_floor=below_relative_accuracy(error_bound, displacement, error_tolerance),
    )


def unit_length(window):
    """Return how many steps a unit of work has. Not collective."""
    return max(1, STEPS_IN_UNIT // window) * window


def march_windows(changing, solver, s, changes, window, method):
    """Return the amplitudes before and after each change, their bounds, and how windows drift.

    Collective. Each window starts from a state solved for afresh, which is compared with what the
    window before made of it.
    """
    found = np.empty((len(changes) + 1, len(solver.adjoints)), dtype=complex)
    bound = np.empty(found.shape)
    done, known, drift, reach = 0, 0, 0.0, window
    with Windows(changing, solver, s) as windows:
        while True:
            start, start_bound = good(windows.start())
            if done and known == done:
                compared = is_accurate(start_bound, start, solver.tolerance)
                compared &= is_accurate(bound[done], found[done], solver.tolerance)
                moved = np.abs(found[done] - start)[compared] / np.abs(start[compared])
                drift = max(drift, moved.max(initial=0.0))
            found[done], bound[done] = start, start_bound
            if done == len(changes):
                return found, bound, drift
            after, after_bound = windows.follow(changes[done : done + reach])
            known = done + len(after)
            found[done + 1 : known + 1], bound[done + 1 : known + 1] = after, after_bound
            steps = max(1, len(after))
            changing.apply(changes[done : done + steps])
            done += steps
            reach = min(window, 2 * steps)  # after an early end not much more may be reached


def march_steps(changing, solver, s, changes, window, method):
    """Return the amplitudes before and after each change, solved for one by one; their bounds.

    Collective.
    """
    states = [good(solver.solve(s))]
    for step in range(len(changes)):
        changing.apply(changes[step : step + 1])
        if method == "direct":
            solver.restart()
        states.append(good(solver.solve(s)))
    found, bound = zip(*states, strict=True)
    return np.stack(found), np.stack(bound), 0.0


def good(state):
    """Return a state's amplitudes and their bounds, NaN where they miss their accuracy.

    Not collective.
    """
    if state.converged_reason > 0:
        return state.displacement, state.error_bound
    missing = np.full(state.displacement.shape, np.nan)
    return missing, missing
