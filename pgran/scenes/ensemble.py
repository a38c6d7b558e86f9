"""Scene `ensemble`: one experiment on many samples, and what holds over them."""

import contextlib
from dataclasses import dataclass

import numpy as np

from pgran.errors import InputError
from pgran.files.options import INTEGER, TEXT, Option
from pgran.machine import check_memory
from pgran.parallel.task import Task, carry_out
from pgran.physics.bands import STATISTICS, over_samples
from pgran.results import Ensemble, record_of
from pgran.scenes import common, modes, pulse, relaxation, response, sensitivity
from pgran.scenes.scene import Scene

EXPERIMENTS = {
    "response": response,
    "modes": modes,
    "relaxation": relaxation,
    "pulse": pulse,
    "sensitivity": sensitivity,
}
ENSEMBLE = (
    Option(
        "ensemble_of", TEXT, "response", "the experiment that is repeated",
        choices=tuple(EXPERIMENTS),
    ),
    Option("ensemble_samples", INTEGER, 100, "samples, of seeds from -bonds_seed on", low=2),
    Option(
        "ensemble_keep", TEXT, "measures",
        "what is stored of each sample: measures, a few numbers; curves, its curves as well",
        choices=("measures", "curves"),
    ),
)  # fmt: skip
# Numbers of a sample, what to call them, and their unit.
MEASURES = {
    "velocity": ("phase velocity", " spacings x omega_mx"),
    "exponent": ("exponent psi", ""),
    "above": ("modes above omega_mx", ""),
    "arrival": ("arrival of the front", ""),
    "centre": ("centre of the envelope", ""),
    "decay": ("rate of decay", ""),
    "effective_bonds": ("bonds that matter, on the mean over frequencies,", ""),
}
# What an experiment is told here that it would decide by itself.
FIXED = {
    "response": {"sweep_resolve": 0.0, "output_models": False, "output_fields": False},
    "modes": {"output_fields": False, "modes_density": None},
    "pulse": {"output_fields": False},
    "sensitivity": {},
    "relaxation": {},
}


def check(values, given):
    """Raise unless the options are those of the experiment; unset all others. Not collective."""
    kind = values["ensemble_of"]
    experiment = EXPERIMENTS[kind].SCENE
    used = {option.name for option in (*experiment.options, *ENSEMBLE)}
    for name in [option.name for option in SCENE.options if option.name not in used]:
        if name in given:
            raise InputError(f"-{name}{given[name].where}: -ensemble_of {kind} does not use it")
        values[name] = None
    for name, value in FIXED[kind].items():
        if name in given and values[name] != value:
            raise InputError(f"-{name}{given[name].where}: not of many samples")
    if values["ranks_per_lattice"] > 1 and not experiment.shares_lattice:
        raise InputError("-ranks_per_lattice: of modes, each lattice has one rank only")
    experiment.check(values, given)
    if values["network_file"] is not None or values["bonds_law"] == "file":
        raise InputError("-ensemble_of: samples are drawn by a law, and a file holds one only")
    values |= FIXED[kind]


def run(options, world, crew):
    """Return the first sample's lattice and the ensemble, on rank 0; None on the others.

    Collective. Parameters are those of `pgran.scenes.scene.Scene`.
    """
    lattice = common.make_lattice(options, world)
    shared = EXPERIMENTS[options.ensemble_of].SCENE.shares_lattice
    ranks = common.ranks_per_lattice(options, lattice, world) if shared else 1
    with crew(ranks) as workers:
        ensemble = carry_out(Samples(options, lattice), workers, options.output_progress)
    return ensemble and [record_of(lattice), ensemble]


def summary(result):
    """Return in words what a run found. Not collective."""
    found = result.ensemble
    yield f"{len(found.seed)} samples of scene {found.of} in {found.solve_seconds:.2f} s"
    if found.left_out:
        yield (
            f"{found.left_out} of them are left out of all that follows: they failed, or missed "
            "the accuracy asked for (good)"
        )
    for name, (words, unit) in MEASURES.items():
        values = getattr(found, name)
        if values is None:
            continue
        for d, column in enumerate(np.atleast_2d(values[found.good > 0].T)):
            where = f"ball {tuple(found.detector[d].tolist())}: " if values.ndim > 1 else ""
            known = column[np.isfinite(column)]
            line, missing = f"{where}{words} ", len(column) - len(known)
            if len(known) > 1:
                spread = known.std(ddof=1)
                error = spread / np.sqrt(len(known))
                line += f"{known.mean():.4g} +- {error:.1g}{unit}, spread {spread:.2g}"
            else:
                line += "unknown"
            yield line + (f"; {missing} samples have none that is certain" if missing else "")


@dataclass(frozen=True)
class Reading:
    """What is read of an experiment's records: fields of a row, and the function that fills it."""

    fields: tuple
    read: callable


def reading_of(options, lattice):
    """Return the Reading of the experiment that options name. Not collective."""
    kind, keep = options.ensemble_of, options.ensemble_keep == "curves"
    nd = len(lattice.sites(options.detectors)) if options.detectors is not None else 0
    if kind == "response":
        nw = len(common.driving_frequencies(options))
        curves = ("displacement", complex, (nw, nd)), ("delay", float, (nw, nd))
        return Reading(
            (*curves, ("slope", float, (nd,)), ("velocity", float, (nd,))), read_response
        )
    if kind == "modes":
        whole = not modes.chosen(options)
        fields = [("above", float)]
        if keep and whole:
            fields += [(name, float, (lattice.balls,)) for name in ("mode_omega", "participation")]
        return Reading(tuple(fields), read_modes)
    if kind == "relaxation":
        return Reading((("exponent", float), ("exponent_error", float)), read_relaxation)
    if kind == "pulse":
        return Reading(tuple((n, float, (nd,)) for n in ("arrival", "centre", "decay")), read_pulse)
    return Reading((("effective_bonds", float, (nd,)),), read_sensitivity)


def read_response(row, lattice, response):
    """Fill a row with a response; say if it is as accurate as asked. Not collective."""
    for name in ("displacement", "delay"):
        row[name] = getattr(response, name)
    row["slope"], row["velocity"] = response.phase_slope, response.phase_velocity
    return response.failures == 0


def read_modes(row, lattice, modes):
    """Fill a row with normal modes; say if they are certified. Not collective."""
    row["above"] = np.count_nonzero(modes.omega > lattice.omega_mx)
    if "mode_omega" in row.dtype.names and len(modes.omega) == len(row["mode_omega"]):
        row["mode_omega"], row["participation"] = modes.omega, modes.participation
    return modes.count_certified


def read_relaxation(row, lattice, relaxation, spectrum=None):
    """Fill a row with a relaxation; say if all its states are accurate. Not collective."""
    row["exponent"] = row["exponent_error"] = np.nan
    if spectrum is not None:
        row["exponent"], row["exponent_error"] = spectrum.exponent, spectrum.exponent_error
    return relaxation.failures == 0


def read_pulse(row, lattice, signals):
    """Fill a row with a pulse; say if its signals are as accurate as asked. Not collective."""
    for name in ("arrival", "centre", "decay"):
        row[name] = getattr(signals, name)
    largest = np.abs(signals.displacement).max(axis=0)
    return bool(np.all(signals.error.max(axis=0) <= signals.tolerance * largest))


def read_sensitivity(row, lattice, found, heat=None):
    """Fill a row with the participation ratio of squared derivatives. Not collective."""
    squares = found.log_amplitude**2
    row["effective_bonds"] = np.mean(squares.sum(axis=2) ** 2 / (squares**2).sum(axis=2), axis=0)
    return found.failures == 0 and (heat is None or heat.failures == 0)


class Samples(Task):
    """The experiment on each sample, a seed a unit.

    Parameters
    ----------
    options : pgran.files.options.Options
    lattice : pgran.physics.lattice.Lattice
        Of the first seed.
    """

    items = "samples"

    def __init__(self, options, lattice):
        """Say what a sample's numbers travel in."""
        self.options, self.lattice = options, lattice
        self.reading = reading_of(options, lattice)
        self.row = np.dtype([("good", np.int8), *self.reading.fields])
        check_memory("ensemble_samples", options.ensemble_samples * self.row.itemsize)
        first = options.bonds_seed
        self.units = list(range(first, first + options.ensemble_samples))

    @contextlib.contextmanager
    def open(self, group):
        """See `Task`."""
        from pgran.parallel.crew import AgreeingCrew

        experiment = EXPERIMENTS[self.options.ensemble_of]

        def work(seed):
            options = self.options.changed(bonds_seed=seed, output_progress="none")
            records = experiment.run(options, group, lambda _: AgreeingCrew(group, group.size))
            rows = np.zeros(1, self.row)
            if records is not None:
                lattice, *found = records
                rows[0]["good"] = self.reading.read(rows[0], lattice, *found)
            return rows

        yield work

    def length(self, unit):
        """See `Task`."""
        return 1

    def collect(self, rows, seconds):
        """See `Task`; bands are over those samples that are good."""
        good, kept = rows["good"] > 0, {}
        names = rows.dtype.names
        for name in names[1:]:
            if name not in ("displacement", "delay"):
                kept[name] = rows[name].copy()
        if "displacement" in names:
            curves = rows[good]
            with np.errstate(divide="ignore"):
                logs = np.log(np.abs(curves["displacement"]))
            kept["statistic"] = np.array(STATISTICS)
            kept["ln_amplitude"] = over_samples(logs)
            kept["delay"] = over_samples(curves["delay"])
            kept["coherent"] = curves["displacement"].mean(axis=0)
            kept["intensity"] = np.mean(np.abs(curves["displacement"]) ** 2, axis=0)
            kept["omega"] = common.driving_frequencies(self.options)
            if self.options.ensemble_keep == "curves":
                kept["displacement"] = rows["displacement"].copy()
        detectors = self.options.detectors
        return Ensemble(
            of=self.options.ensemble_of,
            solve_seconds=seconds,
            left_out=int(np.count_nonzero(~good)),
            seed=np.array(self.units),
            good=rows["good"].copy(),
            detector=None if detectors is None else self.lattice.sites(detectors),
            **kept,
        )


SCENE = Scene(
    options=tuple(
        {
            o.name: o
            for o in (*ENSEMBLE, *(o for e in EXPERIMENTS.values() for o in e.SCENE.options))
        }.values()
    ),
    run=run,
    summary=summary,
    check=check,
    shares_lattice=True,
)
