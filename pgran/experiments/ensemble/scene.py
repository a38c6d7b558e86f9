"""Scene `ensemble`: one experiment on many samples, and what holds over them."""

import os
from collections.abc import Callable
from glob import glob
from typing import Any

import numpy as np

from pgran.arguments import shown
from pgran.catalogue import EXPERIMENTS
from pgran.errors import InputError, log
from pgran.experiments.ensemble.record import Ensemble
from pgran.experiments.ensemble.sampling import Samples, in_words
from pgran.medium.base import medium
from pgran.medium.lattice import Lattice
from pgran.medium.sample import LATTICE, make_lattice
from pgran.run.agreement import agreeing
from pgran.run.experiment import PROGRESS, Caution, Scene, asked_of, in_parallel
from pgran.run.numbers import windows_of
from pgran.run.options import INTEGER, REALS, TEXT, Option
from pgran.run.task import carry_out
from pgran.store.estimate import FEWEST_SAMPLES, counted

KEPT = ("response", "modes", "pulse")  # what has curves
ENSEMBLE = (
    Option(
        "ensemble_of", TEXT, "response", "the experiment that is repeated",
        choices=("response", "modes", "relaxation", "pulse", "sensitivity"),
    ),
    Option(
        "ensemble_samples", INTEGER, 100,
        "number of samples; seeds go up from -bonds_seed, of relaxations -relax_seed too", low=2
    ),
    Option(
        "ensemble_keep", TEXT, "measures",
        "what is stored of each sample: measures, a few numbers; curves, of a response its "
        "amplitudes, of modes all frequencies and participation ratios, of pulses the mean square "
        "in parts of the samples, as well",
        choices=("measures", "curves"),
    ),
    Option(
        "statistics_windows", REALS, None,
        "of responses: measure the noise of their curves in these windows, low,high or "
        "low,high,low,high; needs -ensemble_keep curves", "angular", above=0,
    ),
    Option(
        "transport_depths", REALS, None,
        "of responses and pulses: the lowest and the highest depth of lines and fits, low,high; "
        "without it a seventh of the system is left out at both ends", "spacing", low=0,
    ),
)  # fmt: skip
OF, SAMPLES, KEEP = ENSEMBLE[:3]
SEED = next(option for option in LATTICE if option.name == "bonds_seed")
SEEDS = 2**63  # that options and files can hold
# What makes no sense for many samples: options and what stands for them, and keywords.
LEFT_OUT = {
    "output_fields": False, "output_models": False, "sweep_resolve": 0.0,
    "modes_target": None, "modes_count": None, "modes_density": None, "modes_detectors": None,
    "modes_certificate": None, "modes_density_method": "count", "modes_density_vectors": 8,
    "modes_density_moments": None, "modes_density_diffusivity": "none",
}  # fmt: skip
NOT_TAKEN = {
    "crew", "seed", "progress", "fields", "shapes", "resolve", "keep_models", "solver", "targets",
    "count", "certificate",
}  # fmt: skip


def check(values, given):
    """Raise where options contradict each other."""
    kind = values["ensemble_of"]
    values |= LEFT_OUT
    EXPERIMENTS[kind].check(values, given)
    check_kept(kind, values["ensemble_keep"])
    if values["bonds_law"] == "file":
        raise InputError("-ensemble_of: samples are drawn by a law, and a file holds one only")
    if values["network_file"] is not None:
        _check_files(values, given)
    jumps = values["bonds_law"] == "hertz" and values["bonds_kmax"] is None
    if jumps and values.get("sweep_unit") == "omega_mx":
        raise InputError(
            "-sweep_unit omega_mx: differs between samples of hertz; -bonds_kmax says which it is"
        )
    if values["statistics_windows"] is not None:
        if (kind, values["ensemble_keep"]) != ("response", "curves"):
            raise InputError("-statistics_windows: needs responses, -ensemble_keep curves")
        windows_of("-statistics_windows", values["statistics_windows"])
        if values["ensemble_samples"] < FEWEST_SAMPLES:
            raise InputError(f"-statistics_windows: {FEWEST_SAMPLES} samples or more are needed")
    if values["transport_depths"] is not None:
        from pgran.experiments.ensemble import transport

        transport.window_of(values["transport_depths"])
        if kind not in ("response", "pulse") or values["ensemble_keep"] != "curves":
            raise InputError("-transport_depths: needs responses or pulses, -ensemble_keep curves")


def _check_files(values, given):
    """Let as many samples be as there are networks; raise unless there are several."""
    files = []
    for each in values["network_file"]:
        found = [each] if os.path.exists(each) else sorted(glob(each))
        if not found:
            raise InputError(f"-network_file {each}: no file is called so, or matches it")
        files += found
    if len(set(map(os.path.realpath, files))) < len(files):
        raise InputError("-network_file: a file is named twice")
    if len(files) < 2:
        raise InputError(
            f"-network_file {files[0]}: a file holds one sample only; give several, a.h5,b.h5 or a "
            "quoted pattern, 'pack_*.h5'"
        )
    samples = values["ensemble_samples"]
    if given.get("ensemble_samples") and samples != len(files):
        raise InputError(f"-ensemble_samples {samples}: -network_file lists {len(files)}")
    if values.get("sweep_unit") == "omega_mx":
        raise InputError("-sweep_unit omega_mx: differs between networks; give angular frequencies")
    values["network_file"], values["ensemble_samples"] = tuple(files), len(files)


def check_kept(of, keep):
    """Raise unless an experiment has curves that are to be kept."""
    if keep == "curves" and of not in KEPT:
        raise InputError(f"-ensemble_keep curves: only {', '.join(KEPT)} have some, not {of}")


def seeds_of(first, samples):
    """Return the seeds of so many samples, or raise where there are none."""
    if first + samples > SEEDS:
        raise InputError(f"-ensemble_samples {samples}: no seeds are left beyond {SEEDS - 1}")
    return range(first, first + samples)


@in_parallel(of=OF.check, samples=SAMPLES.check)
def ensemble(
    of: str,
    samples: int,
    crew=None,
    *,
    lattice: "dict | Callable | list",
    seed=SEED,
    keep=KEEP,
    progress=PROGRESS,
    **experiment: Any,
) -> Ensemble:
    """Repeat an experiment on many samples.

    Parameters
    ----------
    of : {"response", "modes", "relaxation", "pulse", "sensitivity"}
        `sweep`, `find_modes`, `relax`, `pulse` or `sensitivity` is repeated.
    samples : int
    lattice : dict, callable or list
        What `pgran.Lattice.random` takes besides the seed; or a function of the seed that returns
        a lattice or a network, the same on every rank; or the samples: lattices, networks, or paths
        of networks' files or of results. Lattices have one size.
    seed : int
        Of the first sample; the others' follow one by one. Samples of a list are numbered from 0.
    **experiment
        What the repeated function takes besides the lattice. A relaxation's changes are those of
        the seeds 1, 2, ..., one a sample.

    Examples
    --------
    >>> heard = {"omegas": np.linspace(0.3, 0.9, 61), "detectors": [(2, 3)]}
    >>> found = pgran.ensemble("response", 8, lattice={"shape": (6, 5)}, **heard)
    >>> mean, error, median, low, high = found.ln_amplitude
    >>> bool(np.all(low <= high)), found.left_out
    (True, 0)
    """
    check_kept(of, keep)
    function = EXPERIMENTS[of].function
    listed = isinstance(lattice, (list, tuple))
    seeds = seeds_of(0 if listed else seed, samples)
    with agreeing(crew.world) as asked:
        of_modes = {"detectors"} if of == "modes" else set()
        if refused := (NOT_TAKEN | of_modes) & experiment.keys():
            raise InputError(f"ensemble: {sorted(refused)[0]} cannot be kept of each sample")
        if listed and len(lattice) != samples:
            raise InputError(f"ensemble: {samples} samples are asked for, {len(lattice)} given")
        first = _sample(lattice, seeds[0])
        asked["lattice"] = first.fingerprint
        call = function.check(first, **experiment)
        call.apply_defaults()
        taken = call.arguments.keys() - {"lattice"} - NOT_TAKEN
        choices = {name: call.arguments[name] for name in taken}

    def draw(seed, group):
        medium = _sample(lattice, seed)
        other = type(medium) is not type(first) or (medium.is_grid and medium.shape != first.shape)
        if other or (of == "modes" and medium.size > first.size and not listed):
            raise InputError(f"ensemble: the sample of seed {seed} is of another size")
        return medium

    record = repeated(of, seeds, draw, first, keep, choices, crew, progress, listed)
    return record and record.computed_on(first)


def repeated(
    of, seeds, draw, first, keep, choices, crew, progress, listed, changes=1, fit=None, places=None
):
    """Return the Ensemble of an experiment with these keywords, on samples as `Samples` has them.

    Collective. Samples that are `listed` may differ in size. Of a relaxation the first sample's
    changes have the seed `changes`, and exponents are fitted in the window `fit`. The balls nearest
    to `places` listen in each sample.
    """
    from mpi4py import MPI

    function, world, sizes = EXPERIMENTS[of].function, crew.world, [first.size]
    with agreeing(world):  # before any work: the last of many files may be the one that is bad
        for seed in seeds[world.rank :: world.size] if listed else ():
            try:
                medium = draw(seed, MPI.COMM_SELF)
                sizes.append(medium.size)
                if of != "modes":
                    medium.check_driven()
                if places is not None:
                    medium.nearest_free(places)
                elif choices.get("detectors") is not None:
                    medium.sites(choices["detectors"])
            except InputError as error:
                raise InputError(f"sample of seed {seed}: {error}") from error
    # overdamped modes are twice as many
    most = max(map(max, world.allgather(sizes))) * (1 + bool(choices.get("damped")))
    if of == "response":
        choices |= {"resolve": 0.0, "keep_models": False}

    def one(medium, number, crew):
        # of one seed for all samples these would become the same network
        own = {"seed": changes + number} if of == "relaxation" else {}
        if places is not None:
            own["detectors"] = medium.nearest_free(places)
        record = function(medium, crew=crew, **choices | own)
        if record and of == "relaxation":
            from pgran.experiments.relaxation import fluctuations

            return fluctuations.measured(record, fit or fluctuations.FIT, len(medium.existing))
        return record and [record]

    with agreeing(crew.world):
        task = Samples(of, seeds, draw, one, first, most, keep, choices)
    return carry_out(task, crew, progress)


def _sample(lattice, seed):
    """Return the sample of a seed from the keyword `lattice` of `ensemble`."""
    if isinstance(lattice, dict):
        if "seed" in lattice:
            raise InputError("ensemble: seed says which samples, not lattice")
        return Lattice.random(seed=seed, **lattice)
    if isinstance(lattice, (list, tuple)):
        sample = lattice[seed]
        if isinstance(sample, (str, os.PathLike)):
            from pgran.medium.network_file import load

            sample = load(sample)
        return medium(getattr(sample, "medium", sample))
    if not callable(lattice):
        raise InputError(
            "ensemble: lattice is what pgran.Lattice.random takes, as a dict, a function of the "
            f"seed, or a list of samples, not {shown(lattice)}"
        )
    try:
        sample = lattice(seed)
    except Exception as error:
        reason = f"{type(error).__name__}: {error}"
        raise InputError(f"ensemble: lattice({seed}) fails: {reason}") from error
    return medium(sample)


def summary(result):
    """Return in words what a run found."""
    found = result.ensemble
    yield f"{len(found.seed)} samples of scene {found.of} in {found.solve_seconds:.2f} s"
    if found.left_out:
        yield Caution(
            f"{found.left_out} of {len(found.seed)} samples are left out of all that follows: they "
            "failed, or missed the accuracy asked for (good)"
        )
    yield from in_words(result)
    if found.mode_omega is not None:
        from pgran.experiments.modes.levels import spacings

        spectra = [omega[np.isfinite(omega)] for omega in found.mode_omega[found.good > 0]]
        yield from spacings(spectra, result.medium.omega_mx)
        yield from modes_widths(found, result.medium)
    if found.delay_samples is not None:
        unknown = np.count_nonzero(found.good) - found.delay_samples
        if unknown.any():
            yield f"group delays: not certain in up to {counted(unknown.max(), 'sample')}"
    if getattr(result, "statistics", None):
        from pgran.experiments.ensemble import statistics

        yield from statistics.summary(result.statistics)
    if getattr(result, "transport", None) or getattr(result, "diffusion", None):
        from pgran.experiments.ensemble import transport

        yield from transport.summary(result)


def modes_widths(found, medium):
    """Yield in words how wide the modes of all samples are, and localized ones of them."""
    width, localized = found.widths(medium)
    for name, such in (("ringing", width > 0), ("localized", localized)):
        if np.any(such):
            low, middle, high = np.quantile(width[such], (0.1, 0.5, 0.9))
            number = counted(np.count_nonzero(such), f"{name} mode")
            yield f"width of {number}: median {middle:.4g}, 80 % of them {low:.4g} to {high:.4g}"


def run(lattice, options, crew):
    """Return the ensemble, its noise and transport; see `pgran.run.experiment.Scene`."""
    of, windows = options.ensemble_of, options.statistics_windows
    files = crew.world.bcast(options.network_file)
    samples = len(files or ()) or options.ensemble_samples
    seeds = seeds_of(0 if files else options.bonds_seed, samples)
    relax_seed = getattr(options, "relax_seed", 0)
    for first in (relax_seed, options.bonds_redrawn_seed):
        seeds_of(first, samples)
    choices = asked_of(EXPERIMENTS[of].function, options, crew.world, lattice, without=NOT_TAKEN)
    if windows is not None:
        windows = windows_of("-statistics_windows", windows, choices["omegas"])

    def draw(seed, group):
        own = {"network_file": files[seed : seed + 1]} if files else {"bonds_seed": seed}
        # by one sequence of changes all samples would become the same in the end
        own["bonds_redrawn_seed"] = options.bonds_redrawn_seed + seed - seeds[0]
        return make_lattice(options.changed(**own), group)

    how = lattice, options.ensemble_keep, choices, crew, options.output_progress
    fit = (options.spectrum_fit_min, options.spectrum_fit_max) if of == "relaxation" else None
    places = getattr(options, "detectors_at", None)
    record = repeated(of, seeds, draw, *how, files is not None, relax_seed, fit, places)
    if record is None or crew.dry or options.ensemble_keep != "curves" or of == "modes":
        return record and [record]
    from pgran.experiments.ensemble import statistics, transport

    records = [record]

    def measure(name, function, *given):
        try:
            records.append(function(*given))
        except InputError as error:  # samples may be left out: what there is of them is kept
            log.warning("no %s: %s", name, str(error).removeprefix(f"{name}: "))

    if windows is not None:
        measure("statistics", statistics.statistics, record, windows)
    line = transport.is_line(lattice, record.detector)
    if line and files and places is None:
        log.info("no transport: a ball is elsewhere in each packing; -detectors_at names places")
    elif not line and options.transport_depths is not None:
        log.warning("-transport_depths: no transport; detectors at three depths are needed")
    elif line:
        measure("transport", transport.transport, lattice, record, options.transport_depths)
    return records


SCENE = Scene(ENSEMBLE, run, summary, check, shares_lattice=True, decides=tuple(LEFT_OUT))
