"""Scene `structure`: sound waves in a medium, their dispersion, and where they scatter at once."""

import logging
import time

import numpy as np

from pgran.driven.drive import STEADY, UNSTABLE, is_unstable
from pgran.errors import InputError
from pgran.experiments.structure.record import Structure
from pgran.experiments.structure.waves import Spectra, Waves, ioffe_regel
from pgran.medium.base import medium
from pgran.medium.units import warn_above_modes
from pgran.run.agreement import agreeing, on_root
from pgran.run.experiment import (
    PROGRESS,
    Asked,
    Caution,
    Scene,
    in_parallel,
    option,
    options_of,
    run_of,
)
from pgran.run.frequencies import SWEEP, check_sweep
from pgran.run.numbers import numbers
from pgran.run.options import INTEGER, REAL, Option
from pgran.run.task import carry_out
from pgran.store.estimate import counted, with_error
from pgran.store.si import SI

log = logging.getLogger("pgran")
COUNT = Option(
    "structure_count", INTEGER, 6, "how many magnitudes of wave vectors, from the smallest", low=1
)
WAVEVECTORS = Asked(
    (COUNT,),
    COUNT.of_run,
    lambda value: numbers("wavevectors", value) if np.ndim(value) else COUNT.check(value),
)


@in_parallel(
    "structure", shares_lattice=True, lattice=medium, wavevectors=WAVEVECTORS, omegas=SWEEP
)
def structure(
    lattice,
    wavevectors,
    omegas,
    crew=None,
    *,
    direction=option(
        "all", "an axis that waves run along; all, with the diagonals of periodic ones",
        choices=("all", "x", "y", "z"),
    ),
    width=option(
        None,
        "sigma, the real part of s: peaks get wider by 2 sigma, which fits allow for; by default "
        "twice the distance of neighbouring frequencies; 0: width by dashpots alone, one sweep",
        "angular", kind=REAL, low=0,
    ),
    error_tolerance=STEADY["error_tolerance"],
    progress=PROGRESS,
) -> Structure:  # fmt: skip
    """Compute the dynamic structure factor of sound waves, and fit damped oscillators to it.

    S(q, omega) = -(2 omega m / pi) Im f^H S(i omega)^-1 f, with f = M^(1/2) g / (g^H M g)^(1/2), is
    the power that a medium takes up from a force of the form g of a wave. Its integral over
    omega > 0 is 1, its second moment f^H K f / m. Waves of vectors are longitudinal or transverse.
    Omega(q) is the dispersion. Gamma(q), from a second sweep without dashpots, is the rate of
    scattering: waves end where pi Gamma = Omega (Ioffe and Regel).

    Parameters
    ----------
    wavevectors : int or array_like of float, shape (nq, d)
        How many magnitudes of wave vectors, the smallest that fit into the medium; or the vectors
        themselves, which are sorted, of components 2 pi n / L along periodic axes and n pi / L
        between walls.
    """
    started = time.perf_counter()
    with agreeing(crew.world):
        if len(omegas) < 2:
            raise InputError("-sweep_points: a spectrum takes two frequencies at least")
        if width is None:
            width = 2 * np.gradient(omegas)
        elif not (width or lattice.dissipates):
            raise InputError("-structure_width 0: without dashpots peaks have no width")
        waves, asked = Waves(lattice), wavevectors
        groups = waves.given(asked) if np.ndim(asked) else waves.first(asked, direction)
        choices = {"error_tolerance": error_tolerance}
        task = Spectra(lattice, omegas, width, waves, groups, choices)
    warn_above_modes(lattice, crew.world, omegas[0])
    if is_unstable(lattice, crew.world) and crew.world.rank == 0:
        log.warning("%s: motions that would grow have no place in structure factors", UNSTABLE)
    swept = elastic = carry_out(task, crew, progress)
    if lattice.dissipates and np.all(width):
        elastic = carry_out(task.without_dashpots(), crew, progress)

    def record():
        return task.record(swept, elastic, time.perf_counter() - started)

    return on_root(crew.world, record, keep=True)


def summary(result):
    """Yield in words what a run found."""
    record, medium, si = result.structure, result.medium, SI.of(result)
    work = f"{counted(len(record.omega), 'frequency')} with "
    work += counted(record.factorizations, "factorization")
    yield f"{counted(len(record.q), 'wave number')} at {work} in {record.solve_seconds:.2f} s"
    yield Caution(record.exactness()) if record.failures else record.exactness()
    missing, coarse = np.count_nonzero(np.isnan(record.frequency)), np.count_nonzero(record.coarse)
    total = record.frequency.size
    if missing:
        yield Caution(f"no oscillator fits {missing} of {total} spectra within the sweep")
    if coarse:
        yield Caution(
            f"the frequencies are too far apart for {coarse} of {total} peaks, which are narrower: "
            "take more -sweep_points, or a larger -structure_width"
        )
    for b, branch in enumerate(record.branch):
        for n in np.flatnonzero(np.isfinite(record.frequency[b] * record.scattering[b]))[:1]:
            speed, q = record.velocity[b, n], record.q[n]
            rate = with_error(record.scattering[b, n], record.scattering_error[b, n])
            known = with_error(speed, record.frequency_error[b, n] / q)
            yield (
                f"{branch} waves of q = {q:.4g}: speed {known} {medium.length} x "
                f"sqrt(k/m){si.say('m/s', speed)}, Gamma {rate}, "
                f"mean free path {record.mean_free_path[b, n]:.3g} {medium.length}"
            )
        limit, said = ioffe_regel(record.frequency[b], record.scattering[b])
        place = f"omega = {limit:.4g}, {limit / medium.omega_mx:.4g} omega_mx{si.say('Hz', limit)}"
        where = "; ".join(filter(None, [place if np.isfinite(limit) else "", said]))
        yield f"Ioffe-Regel limit of {branch} waves, pi Gamma = Omega: {where}"


SCENE = Scene(options_of(structure), run_of(structure), summary, check_sweep, shares_lattice=True)
