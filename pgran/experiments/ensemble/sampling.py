"""One experiment on many samples: what is read of each, and the task that repeats it."""

import contextlib
import logging

import numpy as np

from pgran.errors import PgranError, is_bad_input, is_petsc
from pgran.experiments.ensemble.bands import STATISTICS, over_samples
from pgran.experiments.ensemble.record import Ensemble
from pgran.run.machine import check_memory
from pgran.run.task import Task
from pgran.store.estimate import two_digits
from pgran.store.fields import ball_names
from pgran.store.si import SI

log = logging.getLogger("pgran")

CURVES = "displacement", "ln_amplitude", "delay"  # of a response
# Numbers of a sample, what to call them, their unit, and that in SI.
MEASURES = {
    "velocity": ("phase velocity", " {length} x omega_mx", "m/s"),
    "exponent": ("exponent psi", "", None),
    "order": ("bonds that act jointly", "", None),
    "modes": ("modes found", "", None),
    "above": ("modes above omega_mx", "", None),
    "arrival": ("arrival of the front", "", "s"),
    "centre": ("centre of the envelope", "", "s"),
    "decay": ("rate of decay", "", "1/s"),
    "effective_bonds": ("bonds that matter, on the mean over frequencies,", "", None),
}


def fields_of(of, lattice, omegas, detectors, curves, whole):
    """Return what is read of each sample, pairs of a name and a shape. Not collective.

    Parameters
    ----------
    of : str
    lattice : pgran.medium.lattice.Lattice or pgran.medium.network.Network
    omegas : numpy.ndarray or None
    detectors : array_like of int or None
    curves : bool
        Whether to read spectra of modes.
    whole : bool
        Whether modes are all there are.
    """
    if of == "modes":
        above = [("above", ())] if whole else []
        spectra = ("mode_omega", "participation") if curves else ()
        return [("modes", ()), *above, *((name, (lattice.balls,)) for name in spectra)]
    if of == "relaxation":
        return [(name, ()) for name in ("exponent", "exponent_error", "order")]
    nd = len(lattice.sites(detectors))
    names = {
        "response": ("slope", "velocity"),
        "pulse": ("arrival", "centre", "decay"),
        "sensitivity": ("effective_bonds",),
    }[of]
    curves = [(name, (len(omegas), nd)) for name in CURVES] if of == "response" else []
    return curves + [(name, (nd,)) for name in names]


def read_response(row, lattice, response):
    """Fill a row with a response. Not collective."""
    floored, failed = response.at_floor > 0, response.converged_reason <= 0
    row["displacement"], row["delay"] = response.displacement, response.delay
    with np.errstate(divide="ignore"):
        logs = np.log(response.amplitude)
    row["ln_amplitude"] = np.where(floored | failed[:, None], np.nan, logs)
    row["slope"], row["velocity"] = response.phase_slope, response.phase_velocity


def read_modes(row, lattice, modes):
    """Fill a row with normal modes. Not collective."""
    row["modes"] = len(modes.omega)
    if "above" in row.dtype.names:
        row["above"] = np.count_nonzero(modes.omega > lattice.omega_mx)
    if "mode_omega" in row.dtype.names:  # NaN where there are less
        found = slice(min(len(modes.omega), len(row["mode_omega"])))
        for name, values in (("mode_omega", modes.omega), ("participation", modes.participation)):
            row[name][found] = values[found]


def read_relaxation(row, lattice, relaxation, spectrum=None, memory=None):
    """Fill a row with a relaxation's spectrum and memory, if it has them. Not collective."""
    if spectrum is not None:
        row["exponent"], row["exponent_error"] = spectrum.exponent, spectrum.exponent_error
    if memory is not None:
        row["order"] = memory.order


def read_pulse(row, lattice, signals):
    """Fill a row with the times of a pulse. Not collective."""
    for name in ("arrival", "centre", "decay"):
        row[name] = getattr(signals, name)


def read_sensitivity(row, lattice, found, heat=None):
    """Fill a row with the participation ratio of squared derivatives. Not collective."""
    squares = found.log_amplitude**2
    row["effective_bonds"] = np.mean(squares.sum(axis=2) ** 2 / (squares**2).sum(axis=2), axis=0)


READ = {
    "response": read_response,
    "modes": read_modes,
    "relaxation": read_relaxation,
    "pulse": read_pulse,
    "sensitivity": read_sensitivity,
}


class Samples(Task):
    """The experiment on each sample, a seed a unit.

    Parameters
    ----------
    of : str
        What the experiment is, a key of READ.
    seeds : sequence of int
    solve : callable
        Takes a seed and the ranks of a group; returns the sample's lattice and the experiment's
        records on the first of them. Collective over the group.
    lattice : pgran.medium.lattice.Lattice or pgran.medium.network.Network
        Of the first seed; all are of its size.
    keep : {"measures", "curves"}
    omegas, detectors : array_like, optional
        Of the experiment, if it has them.
    whole : bool
        Whether modes are all there are.
    """

    items = "samples"

    def __init__(self, of, seeds, solve, lattice, keep, omegas=None, detectors=None, whole=False):
        """Say what a sample's numbers travel in."""
        self.of, self.units, self.solve, self.curves = of, list(seeds), solve, keep == "curves"
        self.omegas = None if omegas is None else np.asarray(omegas, dtype=float)
        self.sites = None if detectors is None else lattice.sites(detectors)
        fields = fields_of(of, lattice, self.omegas, detectors, self.curves, whole)
        self.names, kinds = [name for name, _ in fields], {"displacement": complex}
        self.row = np.dtype(
            [("good", np.int8), *((n, kinds.get(n, float), shape) for n, shape in fields)]
        )
        check_memory("ensemble_samples", len(self.units) * self.row.itemsize)

    @contextlib.contextmanager
    def open(self, group):
        """See `Task`; a sample that cannot be computed is no good, which is said."""

        def work(seed):
            rows = np.zeros(1, self.row)
            for name in self.names:
                rows[name] = np.nan
            try:
                found = self.solve(seed, group)
            except Exception as error:  # which all ranks of the group meet alike
                if type(error) is not PgranError and (not is_petsc(error) or is_bad_input(error)):
                    raise
                if group.rank == 0:
                    log.warning("sample of seed %d is left out: %s", seed, error)
                return rows
            if found is not None:
                medium, *records = found
                READ[self.of](rows[0], medium, *records)
                rows["good"] = not any(record.failures for record in records)
            return rows

        yield work

    def length(self, unit):
        """See `Task`."""
        return 1

    def collect(self, rows, seconds):
        """See `Task`; bands are over those samples that are good."""
        good = rows["good"] > 0
        kept = {name: rows[name].copy() for name in self.names if name not in CURVES}
        if self.of == "response":
            kept |= self._bands(rows[good])
            if self.curves:
                kept["displacement"] = rows["displacement"].copy()
                kept["sample_delay"] = rows["delay"].copy()
        return Ensemble(
            of=self.of,
            solve_seconds=seconds,
            left_out=int(np.count_nonzero(~good)),
            seed=np.array(self.units),
            good=rows["good"].copy(),
            detector=self.sites,
            omega=self.omegas if self.of == "response" else None,
            **kept,
        )

    def _bands(self, rows):
        """Return what the curves of good samples have in common."""
        A, count = rows["displacement"], np.float64(len(rows))
        with np.errstate(invalid="ignore"):  # without any sample NaN
            coherent, intensity = A.sum(axis=0) / count, (np.abs(A) ** 2).sum(axis=0) / count
        return {
            "statistic": np.array(STATISTICS),
            "ln_amplitude": over_samples(rows["ln_amplitude"]),
            "delay": over_samples(rows["delay"]),
            "delay_samples": np.count_nonzero(np.isfinite(rows["delay"]), axis=0),
            "coherent": coherent,
            "intensity": intensity,
        }


def measures(result):
    """Yield in words the numbers of samples, measure by measure. Not collective."""
    for name in MEASURES:
        if getattr(result.ensemble, name) is not None:
            yield from _told(result, name)


def _told(result, name):
    """Yield in words a measure at each detector; where it is unknown at several, in one line."""
    words, unit, physical = MEASURES[name]
    unit = unit.format(length=result.medium.length)
    found, si = result.ensemble, SI.of(result)
    values = getattr(found, name)
    sites = [None] if values.ndim == 1 else ball_names(found.detector)
    columns = np.atleast_2d(values[found.good > 0].T)
    factor = result.medium.omega_mx if "omega_mx" in unit else 1.0
    known = [column[np.isfinite(column)] for column in columns]
    few = [len(values) for values in known if len(values) < 2]
    for site, values in zip(sites, known, strict=True):
        line = words if site is None else f"{site}: {words}"
        if len(values) > 1:
            mean, spread = values.mean(), values.std(ddof=1)
            error = spread / np.sqrt(len(values))
            in_si = si.say(physical, factor * mean) if physical else ""
            line += f" {mean:.4g} +- {two_digits(error)}{unit}{in_si}, spread {spread:.2g}"
        elif len(few) == 1:
            line += " unknown"
        else:
            continue
        missing = columns.shape[1] - len(values)
        yield line + (f"; {missing} samples have none that is certain" if missing else "")
    if len(few) > 1:
        line, missing = f"{words} unknown at {len(few)} balls", columns.shape[1] - min(few)
        yield line + (f"; up to {missing} samples have none that is certain" if missing else "")
