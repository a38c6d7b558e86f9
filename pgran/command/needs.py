"""What each scene needs: its work, tried on this machine in small, and the sizes of its arrays."""

import math
import time
from dataclasses import dataclass, replace

import numpy as np

from pgran import results
from pgran.command.costs import SLICE_BYTES, SPEED_UP, stored_bytes
from pgran.parallel.agreement import on_root
from pgran.parallel.crew import Crew, automatic_ranks
from pgran.physics.lattice import bond_count, detector_sites
from pgran.scenes.common import driving_frequencies

PART = 64  # frequencies of the exact series that are tried
SERIES_BYTES = 5e6  # what the terms of a part of them take
DENSE_BYTES = 80  # for each entry of a dense matrix, where LAPACK finds all modes
IN_SLICE, COUNTS_IN_SEARCH = 75, 6  # modes to a slice; counts to find the modes near a target
BLOCK = 96  # columns of the blocks that a window of a relaxation solves with
# Solves to a step of a relaxation, the iterations of the paper's lattice among them.
SOLVES = {"window": 1, "krylov": 5, "direct": 2}
STEPS = 32  # of a relaxation in a unit of a trial, where each is solved by itself


@dataclass(frozen=True)
class Needs:
    """What a scene will need.

    Attributes
    ----------
    shape : tuple of int or None
        Of the lattice.
    factor : float
        Bytes of the factor on all ranks of a lattice; 0 if there is none.
    work : str
        In words.
    disk : float
        Bytes of the result's arrays.
    memory : float
        Bytes of a rank, beside those of the program itself and of the result.
    seconds : float or None
        Of the work, once the program has started; None if it cannot be foreseen.
    gathered, sent : float
        Bytes beside these: on rank 0; and on each other rank, of results not yet sent.
    """

    shape: tuple | None
    factor: float
    work: str
    disk: float
    memory: float = 0.0
    seconds: float | None = 0.0
    gathered: float = 0.0
    sent: float = 0.0


def response(options, world, scene):
    """Return the Needs of a sweep. Collective."""
    from pgran.command.trials import spread, trial_lattice

    shape, small = trial_lattice(options, world)
    sites, omegas = detector_sites(shape, options.detectors), driving_frequencies(options)
    units, ranks = scene.units(len(omegas)), _ranks_per_lattice(options, shape, world)
    trial, seconds, costs, systems = _sweep(
        options, world, ranks, shape, small, sites, omegas, spread(units), options.output_fields
    )
    lengths = {"omega": len(omegas), "balls": costs.balls}
    lengths |= {"detector_number": len(sites), "axis": len(shape)}
    disk = _lattice_bytes(shape) + stored_bytes(
        results.Response, lengths, () if options.output_fields else ("field",)
    )
    kept = len(units[0]) if options.output_fields else 0
    return Needs(
        shape,
        costs.factor_bytes,
        f"{len(omegas)} frequencies, {_factorizations(trial, len(omegas))}",
        disk,
        costs.bytes(systems, ranks, kept),
        seconds,
        sent=disk * ranks / world.size,
    )


def projection(options, world, scene):
    """Return the Needs of a projection. Collective."""
    from pgran.command.trials import product_seconds, spread, trial_lattice, try_modes

    shape, small = trial_lattice(options, world)
    balls, omegas = math.prod(shape), driving_frequencies(options)
    which = scene.which_modes(options, balls, omegas)
    modes = try_modes(world, small, _reach(which))
    found, _, seconds = _mode_work(modes, which, shape, world)
    units = scene.units(len(omegas))
    nowhere = np.empty((0, len(shape)), dtype=np.int64)
    trial, swept, costs, systems = _sweep(
        options, world, 1, shape, small, nowhere, omegas, spread(units), True
    )
    share = math.ceil(len(units) / world.size) / len(units)
    products = product_seconds(world, found, small.balls) * balls / small.balls
    lengths = {"omega": len(omegas), "mode_omega": found}
    disk = _lattice_bytes(shape) + stored_bytes(results.Projection, lengths)
    shapes = 8 * found * balls
    return Needs(
        shape,
        costs.factor_bytes,
        f"{len(omegas)} frequencies on {found} modes, {_factorizations(trial, len(omegas))}",
        disk,
        costs.bytes(systems) + SLICE_BYTES * balls + shapes,
        None if swept is None else seconds + swept + products * len(omegas) * share,
        gathered=shapes,
        sent=disk / world.size,
    )


def modes(options, world, scene):
    """Return the Needs of normal modes. Collective."""
    from pgran.command.trials import trial_lattice, try_modes

    shape, small = trial_lattice(options, world)
    which = scene.chosen(options)
    trial = try_modes(world, small, _reach(which))
    found, slices, seconds = _mode_work(trial, which, shape, world)
    balls, costs = math.prod(shape), replace(trial.costs, shape=shape)
    without = () if options.output_fields else ("vector",)
    lengths = {"omega": found, "balls": balls}
    disk = _lattice_bytes(shape) + stored_bytes(results.Modes, lengths, without)
    return Needs(
        shape,
        costs.factor_bytes,
        f"{'about ' if which else ''}{found} modes in about {slices} slices",
        disk,
        costs.bytes(0) + (DENSE_BYTES * balls**2 if trial.whole else SLICE_BYTES * balls),
        seconds,
        sent=disk / world.size,
    )


def relaxation(options, world, scene):
    """Return the Needs of a relaxation. Collective."""
    from pgran.command.trials import steady_solver, trial_lattice, trial_sites, try_steady
    from pgran.physics.changes import draw_changes
    from pgran.physics.spectrum import check_window, fewest_steps, segment_length
    from pgran.scenes.common import make_law
    from pgran.solve.changing import ChangingBonds
    from pgran.solve.windows import window_length

    steps, trajectories, method = (
        options.relax_steps, options.relax_trajectories, options.relax_method
    )  # fmt: skip
    window = options.spectrum_fit_min, options.spectrum_fit_max
    check_window(*window)
    shape, small = trial_lattice(options, world)
    sites = detector_sites(shape, options.detectors)
    law, omega = make_law(options), options.relax_omega
    serves = options.relax_window or window_length(math.prod(shape))
    length = scene.unit_length(serves)
    tried = length if method == "window" else min(length, STEPS)
    march = scene.march_windows if method == "window" else scene.march_steps

    small, unit = small.in_own_unit()

    def draw(trajectory, first, count):
        return draw_changes(law, small.shape, options.relax_seed, trajectory, first, count, unit)

    ranks = _ranks_per_lattice(options, shape, world)
    with (
        Crew(world, ranks) as crew,
        steady_solver(
            small, shape, crew.group, trial_sites(sites, shape, small.shape),
            options.error_tolerance, options.steady_refresh_iterations,
            error_floor=options.error_floor,
        ) as (operators, solver),
    ):  # fmt: skip
        changing = ChangingBonds(small, operators, draw)

        def work(first):
            changing.move_to(0, first)
            solver.restart()
            changes = draw(0, first, min(tried, steps - first))
            march(changing, solver, 1j * omega, changes, serves, method)
            return len(changes), SOLVES[method] * len(changes)

        trial = try_steady(world, small.shape, solver, omega, range(0, steps, length), work)
        systems, groups = 1 + len(solver.adjoints), crew.groups
    units = trajectories * math.ceil(steps / length)
    costs, seconds = _scaled(trial, shape, trajectories * steps, units, groups, ranks)
    lengths = {
        "trajectory": trajectories, "step": steps, "state": steps + 1, "axis": len(shape),
        "detector_number": len(sites),
    }  # fmt: skip
    disk = _lattice_bytes(shape) + stored_bytes(results.Relaxation, lengths)
    if steps + 1 >= fewest_steps(trajectories, window[0]):
        segment = segment_length(trajectories, steps + 1, *window)
        disk += stored_bytes(results.Spectrum, {"frequency": segment // 2})
    return Needs(
        shape,
        costs.factor_bytes,
        f"{trajectories * steps} steps, {_factorizations(trial, trajectories * steps)}",
        disk,
        costs.bytes(systems, ranks, BLOCK if method == "window" else 0),
        seconds,
        sent=disk * ranks / world.size,
    )


def continuum(options, world, scene):
    """Return the Needs of the exact series. Collective."""

    def tried():
        box, omegas = scene.make_box(options), driving_frequencies(options)
        part = omegas[:: max(1, len(omegas) // PART)]
        began = time.perf_counter()
        box.response(part, options.continuum_point)
        seconds = (time.perf_counter() - began) * len(omegas) / len(part)
        return len(omegas), len(box.resonances(omegas[-1])), seconds

    points, resonances, seconds = on_root(world, tried)
    lengths = {"omega": points, "resonance": resonances}
    return Needs(
        None,
        0.0,
        f"{points} frequencies",
        stored_bytes(results.ContinuumResponse, lengths),
        seconds=seconds,
        gathered=SERIES_BYTES,
    )


SCENES = {
    "response": response,
    "projection": projection,
    "modes": modes,
    "relaxation": relaxation,
    "continuum": continuum,
}


def _ranks_per_lattice(options, shape, world):
    """Return how many ranks share a lattice. Not collective."""
    return options.ranks_per_lattice or automatic_ranks(shape, world.size)


def _sweep(options, world, ranks, shape, small, sites, omegas, units, whole_field):
    """Return the Trial of a sweep, its seconds and costs, and how many systems a solve has."""
    from pgran.command.trials import steady_solver, trial_sites, try_steady

    small, _ = small.in_own_unit()
    with (
        Crew(world, ranks) as crew,
        steady_solver(
            small, shape, crew.group, trial_sites(sites, shape, small.shape),
            options.error_tolerance, options.steady_refresh_iterations, whole_field,
            error_floor=getattr(options, "error_floor", 0.0),
        ) as (_, solver),
    ):  # fmt: skip
        systems = 1 + len(solver.adjoints)

        def work(unit):
            solver.restart()
            iterations = sum(solver.solve(1j * omegas[index]).iterations for index in unit)
            return len(unit), systems * len(unit) + 2 * iterations

        trial = try_steady(world, small.shape, solver, omegas[0], units, work)
        groups = crew.groups
    costs, seconds = _scaled(trial, shape, len(omegas), len(units), groups, ranks)
    return trial, seconds, costs, systems


def _scaled(trial, shape, points, units, groups, ranks):
    """Return the costs of a lattice and the seconds of the points, shared out in units."""
    costs = replace(trial.costs, shape=shape)
    pace = trial.scaled(costs)
    if pace is None:
        return costs, None
    first, seconds = pace
    mine = points * math.ceil(units / groups) / units
    alone = shape != trial.costs.shape  # the trial's lattice was not shared
    return costs, (first + seconds * max(0.0, mine - 1)) / (ranks**SPEED_UP if alone else 1.0)


def _reach(which):
    """Return the interval of omega that the wanted modes lie in or around."""
    targets = which.get("targets")
    if targets is not None:
        return min(targets), max(targets)
    return which.get("interval", (0.0, math.inf))


def _mode_work(trial, which, shape, world):
    """Return how many modes there will be, in how many slices, and the seconds they take."""
    balls, targets = math.prod(shape), which.get("targets")
    inside, counts = math.ceil(trial.part * balls), 2
    found = computed = inside
    if targets is not None:
        counts, wanted = COUNTS_IN_SEARCH * len(targets), which["count"]
        found = min(balls, inside + wanted, wanted * len(targets))
        computed = min(balls, found + found // 5 + 4)
    there, here = replace(trial.costs, shape=shape), trial.costs
    if trial.whole:
        return found, 1, trial.slicing * (balls / here.balls) ** 3
    slices = max(1, round(computed / IN_SLICE))
    rounds, counted = (math.ceil(n / world.size) for n in (slices, counts + 2 * slices))
    seconds = rounds * trial.slicing * there.slicing / here.slicing
    return found, slices, seconds + counted * trial.counting * there.factoring / here.factoring


def _lattice_bytes(shape):
    """Return the size of the bonds in a result, and of the indices along their axes."""
    return 8 * (bond_count(shape) + 2 * sum(shape))


def _factorizations(trial, points):
    """Return in words how many factorizations there will be."""
    if not trial.costs.fill:
        return "no factorization"
    return f"about {max(1, round(trial.factorizations * points))} factorizations"
