"""Scene `structure`: sound waves in a medium, their dispersion, and where they scatter at once.

The spectrum of a damped oscillator,

    S(s) = (2 / pi) Re [s / (s^2 + s Gamma + Omega^2)],    s = sigma + i omega,

is for sigma = 0 that of its velocity, (2 / pi) omega^2 Gamma / ((omega^2 - Omega^2)^2 +
omega^2 Gamma^2), and wider by 2 sigma else: Omega and Gamma can be told from either.
"""

import contextlib
import logging
import math
import time
import warnings

import numpy as np
from numpy.typing import ArrayLike

from pgran.driven.drive import STEADY, UNSTABLE, is_unstable, work_of
from pgran.driven.sweeps import METHOD, PatternSweep, carry_out_sweep
from pgran.errors import InputError
from pgran.experiments.structure.record import Structure
from pgran.medium.base import EPSILON, Medium, medium, warn_above_modes
from pgran.medium.waves import Waves
from pgran.run.agreement import agreeing, on_root
from pgran.run.crew import Crew
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
from pgran.store.estimate import Estimate, counted, with_error, with_errors
from pgran.store.record import columns_of, row_of
from pgran.store.si import SI

log = logging.getLogger("pgran")
FEWEST = 6  # points that a fit takes
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
    lattice: Medium,
    wavevectors: "int | ArrayLike",
    omegas: "ArrayLike",
    crew: Crew | None = None,
    *,
    direction: str = option(
        "all", "an axis that waves run along; all, with the diagonals of periodic ones",
        choices=("all", "x", "y", "z"),
    ),
    width: float | None = option(
        None,
        "sigma, the real part of s: peaks get wider by 2 sigma, which fits allow for; by default "
        "twice the distance of neighbouring frequencies; 0: width by dashpots alone, one sweep",
        "angular", kind=REAL, low=0,
    ),
    method: str = METHOD,
    error_tolerance: float = STEADY["error_tolerance"],
    progress: str = PROGRESS,
) -> Structure:  # fmt: skip
    """Compute the dynamic structure factor of sound waves, and fit damped oscillators to it.

    S(q, omega) = -(2 omega m / pi) Im f^H S(i omega)^-1 f, with f = M^(1/2) g / (g^H M g)^(1/2), is
    the power that a medium takes up from a force of the form g of a wave. Its integral over
    omega > 0 is 1, its second moment f^H K f / m. Waves of vectors are longitudinal or transverse.
    Omega(q) is the dispersion. Gamma(q), from a second sweep without dashpots, is the rate of
    scattering: waves end where pi Gamma = Omega, the limit of Ioffe and Regel (H. Shintani and
    H. Tanaka, Nature Materials 7, 870 (2008)).

    Parameters
    ----------
    wavevectors : int or array_like of float, shape (nq, d)
        How many magnitudes of wave vectors, the smallest that fit into the medium; or the vectors
        themselves, which are sorted, of components 2 pi n / L along periodic axes and n pi / L
        between walls.

    Examples
    --------
    >>> lattice = pgran.Lattice.random((6, 5), seed=1)
    >>> found = pgran.structure(lattice, 2, [0.1, 0.2, 0.3, 0.4])
    >>> found.structure_factor.shape  # frequencies, polarisations, wave numbers
    (4, 1, 2)
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
    swept, moments = carry_out_sweep(task, method, crew, progress)
    elastic = swept
    if lattice.dissipates and np.all(width):
        undamped = task.without_dashpots()
        elastic, more = carry_out_sweep(undamped, method, crew, progress)
        moments += more
    seconds = time.perf_counter() - started
    return on_root(crew.world, lambda: task.record(swept, elastic, moments, seconds), keep=True)


class Spectra(PatternSweep):
    """S of groups of waves at sigma + i omega; `sigma` may be one number or one a frequency.

    `waves` are those that fit into the medium.
    """

    by = "-structure_method"

    def __init__(self, lattice, omegas, sigma, waves, groups, choices):
        self.waves, self.groups = waves, groups
        self.shape = len(waves.branches), len(groups)
        row = row_of(Structure, branch=self.shape[:1], q=self.shape[1:])
        super().__init__(lattice, omegas, None, row, choices, sigma)
        self.sources, self.places = waves.patterns(groups)

    def without_dashpots(self):
        """Return the same task for the medium without damping."""
        return Spectra(
            self.lattice.undamped(), self.omegas, self.s.real, self.waves, self.groups, self.choices
        )

    def keep(self, point, solver):
        """See `PatternSweep`."""
        s, (G, bounds) = solver.s, solver.diagonal(self.sources)
        bounds = bounds + (len(G) + 8) * EPSILON * np.abs(G)  # what follows is rounded, too
        # Re(s G), of the velocity that a force makes, is -omega Im G at s = i omega
        scale = 2 * self.scaled.mass / np.pi
        value = point["structure_factor"] = self._summed(scale * np.real(s * G))
        bound = point["error_bound"] = self._summed(scale * abs(s) * bounds)
        point["converged_reason"] = np.all(bound <= solver.tolerance * np.abs(value))

    def _summed(self, numbers):
        """Return the sums of the patterns' numbers over each branch and wave number."""
        return np.bincount(self.places, numbers, np.prod(self.shape)).reshape(self.shape)

    def record(self, swept, elastic, moments, seconds):
        """Return the record of the rows with dashpots and without, which may be the same."""
        sweeps = [swept] if elastic is swept else [swept, elastic]
        columns = columns_of(Structure, swept)
        columns["converged_reason"] = np.min([rows["converged_reason"] for rows in sweeps], axis=0)
        # of those of moments NaN
        columns["backward_error"] = np.fmax.reduce([rows["backward_error"] for rows in sweeps])
        frequency, width = self._oscillators(swept)
        _, scattering = self._oscillators(elastic)
        lattice, waves = self.lattice, self.waves
        fields = self.sources.reshape(-1, *lattice.shape)
        stretched = zip(
            lattice.stretch(fields), lattice.blocks(lattice.damped_springs), strict=True
        )
        # f^T B^T d B f
        power = sum(np.sum((d * b**2).reshape(len(b), -1), axis=1) for b, d in stretched)
        dashpots = self._summed(power) * lattice.damping / lattice.mass
        limits = zip(frequency.value, scattering.value, strict=True)
        return Structure(
            **columns,
            **with_errors(frequency=frequency, width=width, scattering=scattering),
            factorizations=sum(int(rows["factorizations"].sum()) for rows in sweeps),
            solve_seconds=seconds,
            moments=moments,
            omega=self.omegas,
            resolution=self.s.real,
            branch=np.array(waves.branches),
            q=np.array([waves.magnitude(group[0]) for group in self.groups]),
            wavevector=np.array([waves.unit * group[0] for group in self.groups]),
            directions=np.array([len(group) for group in self.groups]),
            dashpots=dashpots + self._summed(lattice.other_widths(self.sources)),
            ioffe_regel=np.array([ioffe_regel(*branch)[0] for branch in limits]),
        )

    def _oscillators(self, rows):
        """Return Omega and Gamma of each branch and group, an Estimate each."""
        values = np.where(rows["converged_reason"][:, None, None], rows["structure_factor"], np.nan)
        fits = [fitted(self.s, each) for each in values.reshape(len(rows), -1).T]
        numbers = np.array([(fit.value, fit.error) for fit in fits])
        return [Estimate(*each.T.reshape(2, *self.shape)) for each in np.moveaxis(numbers, 2, 0)]


def spectrum(s, frequency, width):
    """Return the spectrum S(s) of an oscillator; its integral over omega > 0 is 1."""
    return 2 / math.pi * np.real(s / (s * s + s * width + frequency**2))


def derivatives(s, frequency, width):
    """Return the derivatives of that spectrum by Omega and Gamma, shape (n, 2)."""
    below = (s * s + s * width + frequency**2) ** 2
    return -2 / math.pi * np.real([2 * frequency * s / below, s * s / below]).T


def fitted(s, values):
    """Return Omega and Gamma of the oscillator nearest to a spectrum, an Estimate of both.

    Standard errors are by the scatter around the fit, which at neighbouring points is alike as far
    as sigma reaches. Both are NaN where the spectrum has its maximum at an end, or none fits.
    """
    from scipy.optimize import OptimizeWarning, curve_fit

    known = np.isfinite(values)
    s, values = s[known], values[known]
    best, errors = np.full((2, 2), math.nan)
    top = np.argmax(values) if len(values) >= FEWEST else 0
    if 0 < top < len(values) - 1:
        # at its maximum S is 2 / (pi (Gamma + 2 sigma))
        start = s[top].imag, max(2 / (math.pi * values[top]) - 2 * s[top].real, 0.0)
        # it does not converge, or nothing says how well
        with contextlib.suppress(RuntimeError, OptimizeWarning), warnings.catch_warnings():
            warnings.simplefilter("error", OptimizeWarning)
            # The steps of SciPy's own differences are as small as Gamma: none where it is 0.
            found, covariance = curve_fit(
                lambda _, *o: spectrum(s, *o), s.imag, values, start,
                jac=lambda _, *o: derivatives(s, *o),
            )  # fmt: skip
            if s[0].imag < found[0] < s[-1].imag:
                # What a Lorentzian of half width sigma smooths is correlated as one of 2 sigma,
                # whose area is 2 pi sigma: so many points count as one.
                alike = np.maximum(2 * math.pi * s.real / np.gradient(s.imag), 1.0)
                best, errors = found, np.sqrt(alike.mean() * np.diag(covariance))
    return Estimate(best, errors)


def ioffe_regel(frequency, width):
    """Return the frequency at which pi Gamma is first Omega, and what there is to say of it.

    It is interpolated between neighbouring wave numbers, in whose order the arrays are; NaN if
    there is none.
    """
    known = np.isfinite(frequency) & np.isfinite(width)
    frequency, ratio = frequency[known], math.pi * width[known] / frequency[known]
    beyond = np.flatnonzero(ratio >= 1)
    if not len(ratio):
        return math.nan, "not known, as no oscillator fits"
    if not len(beyond):
        return math.nan, f"not reached: pi Gamma / Omega is at most {ratio.max():.2g}"
    if beyond[0] == 0:
        return math.nan, (
            "below the smallest wave number, for which the sample is too small: there "
            f"pi Gamma / Omega is {ratio[0]:.3g} already"
        )
    pair = slice(beyond[0] - 1, beyond[0] + 1)
    limit = float(np.interp(1.0, ratio[pair], frequency[pair]))
    again = np.count_nonzero(ratio[beyond[0] :] < 1)
    return limit, f"pi Gamma < Omega again at {again} of the larger wave numbers" if again else ""


def summary(result):
    """Yield in words what a run found."""
    record, medium, si = result.structure, result.medium, SI.of(result)
    work = f"{counted(len(record.omega), 'frequency')} with {work_of(record)}"
    yield f"{counted(len(record.q), 'wave number')} at {work}"
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
