"""Scene `accuracy`: error against run time, one experiment by several solvers and tolerances."""

from pathlib import Path

import numpy as np

from pgran.catalogue import EXPERIMENTS
from pgran.errors import InputError
from pgran.experiments.accuracy.study import REPEATED, Comparison, Configuration, Reference, Study
from pgran.medium.sample import ranks_per_lattice
from pgran.run.agreement import on_root
from pgran.run.experiment import Scene
from pgran.run.keys import read_solver
from pgran.run.options import FILES, INTEGER, REALS, TEXT, Option
from pgran.run.task import carry_out

STUDY = (
    Option(
        "accuracy_of", TEXT, "response", "the experiment that is repeated",
        choices=tuple(REPEATED),
    ),
    Option(
        "accuracy_solvers", FILES, None,
        "options files of the solvers to compare: a.opts,b.opts; each holds solver keys alone"
    ),
    Option(
        "accuracy_tolerances", REALS, (1e-2, 1e-4, 1e-6, 1e-8),
        "accuracies to ask each solver for; of modes, its -normal_eps_tol", above=0, high=0.5
    ),
    Option("accuracy_repeats", INTEGER, 5, "repeats of each timing", low=1, high=10**6),
)  # fmt: skip
# What the file of a solver may set besides keys of PETSc's solvers, and the keywords of these.
CHOICES = {
    "steady_refresh_iterations": "refresh_iterations",
    "sweep_method": "method",
    "modes_method": "method",
    "pulse_method": "method",
    "relax_method": "method",
    "relax_window": "window",
}


def check(values, given):
    """Raise where options contradict each other."""
    if values["accuracy_solvers"] is None:
        raise InputError("-accuracy_solvers is missing: options files of the solvers to compare")
    EXPERIMENTS[values["accuracy_of"]].check(values, given)


def summary(result):
    """Return in words what a run found: a table, a row a configuration."""
    accuracy = result.accuracy
    yield (
        f"{accuracy.compared} of {accuracy.values} numbers compared with a reference that is wrong "
        f"by at most {accuracy.reference_bound:.1e}, relatively; no smaller error can be seen"
    )
    width = max(len(name) for name in ("solver", *accuracy.solver))
    yield f"  {'solver':{width}}   asked  seconds   error  median   bound iterations failures"
    errors = np.transpose([accuracy.error_max, accuracy.error_median, accuracy.error_bound_max])
    for row, iterations in enumerate(accuracy.iterations):
        numbers = " ".join(f"{'-' if np.isnan(x) else f'{x:.1e}':>7}" for x in errors[row])
        yield (
            f"{'*' if accuracy.on_front[row] else ' '} {accuracy.solver[row]:{width}} "
            f"{accuracy.tolerance[row]:7.0e} {accuracy.seconds[row]:8.4f} {numbers} "
            f"{'-' if iterations < 0 else iterations:>10} {accuracy.failures[row]:8}"
        )
    yield "* on the front: no other one without failures is faster and as accurate"


def read_configurations(options):
    """Return the configurations that the options ask for, from the files of the solvers."""
    of, paths = options.accuracy_of, options.accuracy_solvers
    own = {option.name: option for option in EXPERIMENTS[of].options}
    own = {name: option for name, option in own.items() if name in CHOICES}
    names = [Path(path).stem for path in paths]
    if len(set(names)) < len(names):
        names = paths
    configurations = []
    for name, path in zip(names, paths, strict=True):
        values, keys = read_solver(path, own)
        choices = {CHOICES[key]: values.get(key, getattr(options, key)) for key in own}
        for tolerance in options.accuracy_tolerances:
            if of == "modes":
                asked = choices, keys | {"normal_eps_tol": repr(tolerance)}
            else:
                asked = choices | {"error_tolerance": tolerance}, keys
            configurations.append(Configuration(name, tolerance, *asked))
    return configurations


def run(lattice, options, crew):
    """Return the comparison; see `pgran.run.experiment.Scene`."""
    from pgran.run.crew import AgreeingCrew

    world = crew.world
    configurations = on_root(world, lambda: read_configurations(options))
    shared = EXPERIMENTS[options.accuracy_of]
    with AgreeingCrew(world, ranks_per_lattice(shared, options, lattice, world)) as workers:
        study = Study(options, lattice, world)
        reference = carry_out(Reference(study, workers), crew)
        task = Comparison(study, configurations, options.accuracy_repeats, reference, workers)
        accuracy = carry_out(task, crew, options.output_progress)
    return accuracy and [accuracy]


# Of the experiments' options, a study takes those of the one that it repeats; but it decides itself
# how accurate results are, and what is kept of them.
DECIDED = (
    "error_tolerance", "error_floor", "sweep_resolve", "phase_fit_min", "phase_fit_max",
    "output_fields", "output_models", "modes_detectors", "modes_damped", "modes_certificate",
    "modes_density", "modes_density_method", "modes_density_vectors", "modes_density_moments",
    "modes_density_diffusivity", "spectrum_fit_min", "spectrum_fit_max",
)  # fmt: skip
SCENE = Scene(STUDY, run, summary, check, shares_lattice=True, whole=True, decides=DECIDED)
