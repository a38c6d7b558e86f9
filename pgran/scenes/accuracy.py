"""Scene `accuracy`: error against run time, one experiment by several solvers and tolerances."""

import logging
import time
from functools import partial
from pathlib import Path

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from pgran.errors import PgranError
from pgran.files.options import SCENES
from pgran.files.reading import read_solver
from pgran.parallel.agreement import agree, on_root
from pgran.parallel.crew import Crew, automatic_ranks
from pgran.parallel.progress import Progress
from pgran.physics.accuracy import (
    ENTRY,
    Configuration,
    Study,
    front,
    matched,
    read_modes,
    read_relaxation,
    read_response,
    relative_bounds,
    relative_errors,
)
from pgran.results import Accuracy, LatticeRecord
from pgran.scenes.common import driving_frequencies, make_lattice, make_law
from pgran.solve.database import holding, unused

log = logging.getLogger(__name__)

# What the file of a solver may set besides keys of PETSc's solvers, and what `sweep` and `relax`
# call it.
CHOICES = {
    "steady_refresh_iterations": "refresh_iterations",
    "relax_method": "method",
    "relax_window": "window",
}
REFERENCE = 1e-10  # what the reference of driven amplitudes asks for, or a tenth of the smallest
MODES_REFERENCE = 1e-6  # how well a mode must be known to be compared with

ROW = np.dtype(
    [
        ("configuration", np.int64),
        ("seconds", float),
        ("error_max", float),
        ("error_median", float),
        ("error_bound_max", float),
        ("iterations", np.int64),
        ("failures", np.int64),
    ]
)


def run(options, world, journal=None):
    """Return the lattice and the comparison, on rank 0; None on the others. Collective."""
    configurations = on_root(world, lambda: read_configurations(options))
    lattice = make_lattice(options, world)
    automatic = 1 if options.accuracy_of == "modes" else automatic_ranks(lattice.shape, world.size)
    ranks = options.ranks_per_lattice or automatic
    with Crew(world, world.size, journal) as whole, AgreeingCrew(world, ranks) as crew:
        accuracy = compare(
            make_study(options, lattice),
            configurations,
            whole,
            crew,
            repeats=options.accuracy_repeats,
            progress=options.output_progress,
        )
    return accuracy and [LatticeRecord.of(lattice), accuracy]


def summary(records):
    """Return in words what a run found: a table, a row a configuration. Not collective."""
    accuracy = records[1]
    yield (
        f"{accuracy.compared} of {accuracy.values} numbers compared with a reference that is wrong "
        f"by at most {accuracy.reference_bound:.1e}, relatively; no smaller error can be seen"
    )
    width = max(len(name) for name in ("solver", *accuracy.solver))
    yield (
        f"  {'solver':{width}} {'asked':>7} {'seconds':>8} {'error':>7} {'median':>7} {'bound':>7} "
        f"{'iterations':>10} {'failures':>8}"
    )
    for row in range(len(accuracy.label)):
        numbers = [
            getattr(accuracy, f"error_{name}")[row] for name in ("max", "median", "bound_max")
        ]
        errors = " ".join(f"{'-' if np.isnan(x) else f'{x:.1e}':>7}" for x in numbers)
        iterations = accuracy.iterations[row]
        yield (
            f"{'*' if accuracy.on_front[row] else ' '} {accuracy.solver[row]:{width}} "
            f"{accuracy.tolerance[row]:7.0e} {accuracy.seconds[row]:8.4f} {errors} "
            f"{'-' if iterations < 0 else iterations:>10} {accuracy.failures[row]:8}"
        )
    yield "* on the front: no other one without failures is faster and as accurate"


def read_configurations(options):
    """Return the configurations that the options ask for, from the files of the solvers.

    Not collective.

    Raises
    ------
    FileError, InputError
        If a file cannot be read, or holds what is no solver's.
    """
    own = {o.name: o for o in SCENES[options.accuracy_of] if o.name in CHOICES}
    paths = options.accuracy_solvers
    names = [Path(path).stem for path in paths]
    if len(set(names)) < len(names):
        names = paths
    configurations = []
    for name, path in zip(names, paths, strict=True):
        values, keys = read_solver(path, own)
        given = {key: values.get(key, getattr(options, key)) for key in own}
        choices = {CHOICES[key]: value for key, value in given.items()}
        for tolerance in options.accuracy_tolerances:
            if options.accuracy_of == "modes":
                asked = choices, keys | {"normal_eps_tol": repr(tolerance)}
            else:
                asked = choices | {"error_tolerance": tolerance}, keys
            configurations.append(Configuration(name, tolerance, *asked))
    return configurations


def make_study(options, lattice):
    """Return the experiment that the options name. Not collective."""
    if options.accuracy_of == "modes":
        from pgran.scenes.modes import chosen, find_modes
        from pgran.solve.normal import RESIDUAL

        solve = partial(find_modes, lattice, **chosen(options))
        read = partial(read_modes, lattice, largest=RESIDUAL)
        return Study("modes", solve, read, {}, MODES_REFERENCE)
    certified = 0.1 * min(options.accuracy_tolerances)
    exact = {"error_tolerance": min(REFERENCE, certified)}
    if options.accuracy_of == "response":
        from pgran.scenes.response import sweep

        omegas = driving_frequencies(options)
        solve = partial(sweep, lattice, omegas, options.detectors, error_floor=0.0)
        return Study("response", solve, read_response, exact, certified)
    from pgran.scenes.relaxation import relax

    solve = partial(
        relax,
        lattice,
        make_law(options),
        options.relax_omega,
        options.detectors,
        steps=options.relax_steps,
        trajectories=options.relax_trajectories,
        seed=options.relax_seed,
        error_floor=0.0,
    )
    return Study("relaxation", solve, read_relaxation, exact | {"method": "direct"}, certified)


class AgreeingCrew(Crew):
    """Ranks of which all raise what one of them meets: where a study goes on, others end."""

    def share(self, units, work, deliver, row):
        """Do as a Crew does; after an error a rank takes part without working. Collective."""
        met = []

        def tried(unit):
            if not met:
                try:
                    return work(unit)
                except (PgranError, PETSc.Error) as error:
                    met.append(error)
            return np.zeros(0, row)

        super().share(units, tried, deliver, row)
        agree(self.world, met[0] if met else None)


def compare(study, configurations, whole, crew, *, repeats, progress="none"):
    """Repeat an experiment by every configuration in turn, and compare with a reference.

    Collective.

    Parameters
    ----------
    study : Study
    configurations : sequence of Configuration
    whole : pgran.parallel.crew.Crew
        One group of all ranks, which takes one run after the other.
    crew : AgreeingCrew
        What shares out the work of a run.
    repeats : int
    progress : str
        Style of `pgran.parallel.progress.Progress`.

    Returns
    -------
    pgran.results.Accuracy or None
        None on all ranks but rank 0.

    Raises
    ------
    PgranError
        If no number of the reference is good enough.
    """
    world, rows, broken, said = whole.world, [], set(), set()
    reference = find_reference(study, whole, crew)
    units = [
        (repeat, number, configuration)
        for repeat in range(repeats)
        for number, configuration in enumerate(configurations)
    ]
    with Progress(len(units), "runs", progress if world.rank == 0 else "none") as counter:

        def say(line):
            if world.rank == 0 and line not in said:
                said.add(line)
                log.warning(line)

        def work(unit):
            _, number, configuration = unit
            result, seconds = None, np.nan
            if number not in broken:
                try:
                    result, seconds = timed(study, configuration, crew, say)
                except (PgranError, PETSc.Error) as error:  # on all ranks alike
                    broken.add(number)
                    say(f"{configuration.solver} does not work: {str(error).splitlines()[-1]}")
            if world.rank > 0:
                return None
            return judged(study, reference, unit, result, seconds)

        def deliver(row):
            rows.append(row)
            counter.advance(1)

        whole.share(units, work, deliver, ROW)
    if world.rank > 0:
        return None
    return assemble(study, configurations, reference, np.concatenate(rows), repeats)


def find_reference(study, whole, crew):
    """Return the numbers to compare with, on rank 0; those are good whose bounds are small enough.

    Collective.

    Raises
    ------
    PgranError
        If none is.
    """
    found = []

    def work(choices):
        result = study.solve(crew, **choices)
        return result and study.read(result, choices)

    whole.share([study.exact], work, found.append, ENTRY)

    def check():
        reference = found[0].copy()
        reference["good"] = relative_bounds(reference) <= study.certified
        good = np.count_nonzero(reference["good"])
        if good == 0:
            raise PgranError(
                f"no reference to compare with: of its {len(reference)} numbers none has an error "
                f"certified to be below {study.certified:g}; the experiment's own solver keys, or "
                "larger -accuracy_tolerances, may help"
            )
        if good < len(reference):
            log.warning(
                "%d of %d numbers are not compared: the reference's own error is not certified to "
                "be below %g there", len(reference) - good, len(reference), study.certified,
            )  # fmt: skip
        return reference

    return on_root(whole.world, check, keep=True)


def timed(study, configuration, crew, say):
    """Return the result of a run, and how long the slowest rank took.

    Collective. Solver keys that nothing used are said.
    """
    with holding(configuration.keys):
        crew.world.Barrier()
        started = time.perf_counter()
        result = study.solve(crew, **configuration.choices)
        seconds = crew.world.allreduce(time.perf_counter() - started, MPI.MAX)
        for key in unused(configuration.keys):
            say(f"-{key} of {configuration.solver} was not used: its solver has no such option")
    return result, seconds


def judged(study, reference, unit, result, seconds):
    """Return a run's row of the comparison; a run that did not work has no result. Not collective.

    Numbers that failed count as failures, and in no error.
    """
    _, number, configuration = unit
    found = np.zeros(len(reference), ENTRY)
    if result is not None:
        found = study.read(result, configuration.choices)
        if study.name == "modes":
            found = matched(found, reference)
    good = found["good"]
    bounds = relative_bounds(found[good])
    compared = good & reference["good"]
    errors = relative_errors(found[compared], reference[compared])
    row = np.zeros(1, ROW)
    row["configuration"], row["seconds"] = number, seconds
    row["error_max"] = errors.max() if len(errors) else np.nan
    row["error_median"] = np.median(errors) if len(errors) else np.nan
    row["error_bound_max"] = bounds.max() if len(bounds) else np.nan
    row["iterations"] = result.iterations.sum() if hasattr(result, "iterations") else -1
    row["failures"] = np.count_nonzero(~good)
    return row


def assemble(study, configurations, reference, rows, repeats):
    """Return the Accuracy that the runs make up. Not collective."""
    seconds = np.full((len(configurations), repeats), np.nan)
    for number, mine in enumerate(seconds):
        mine[:] = rows["seconds"][rows["configuration"] == number]
    _, first = np.unique(rows["configuration"], return_index=True)
    first = rows[first]  # what is not time is the same in all repeats
    compared = reference[reference["good"]]
    median = np.median(seconds, axis=1)
    return Accuracy(
        experiment=study.name,
        repeats=repeats,
        values=len(reference),
        compared=len(compared),
        reference_bound=float(relative_bounds(compared).max()),
        label=np.array([c.label for c in configurations]),
        solver=np.array([c.solver for c in configurations]),
        tolerance=np.array([c.tolerance for c in configurations]),
        seconds=median,
        seconds_min=seconds.min(axis=1),
        seconds_max=seconds.max(axis=1),
        **{name: first[name] for name in ROW.names[2:]},
        on_front=front(median, first["error_max"], first["failures"]),
    )
