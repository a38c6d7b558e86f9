"""Transport through an ensemble: amplitude, attenuation length and group delay against depth."""

import math
from functools import cached_property
from itertools import pairwise

import numpy as np

from pgran.arguments import called_right
from pgran.errors import InputError
from pgran.experiments.ensemble.noise import finite_samples
from pgran.experiments.ensemble.record import Ensemble, Transport
from pgran.experiments.modes.levels import REGIMES, first_mode
from pgran.medium.base import medium as medium_of
from pgran.store import estimate
from pgran.store.estimate import FEWEST_SAMPLES, Estimate, jackknife_samples, mean_of
from pgran.store.si import SI

FEWEST_DEPTHS = 3  # of a straight line
FALLS = 2.0  # errors that a slope is negative by, for an attenuation length


class Profiles:
    """Responses of samples at detectors of several depths, and their means against depth.

    `depth` are those of the detectors, shape (nd,); `amplitude` and `derivative` are A and
    dA/domega, shape (samples, nw, nd). Samples that are not finite everywhere are left out, aloud.
    Means have the shape (nw, nx), of frequencies and of `depths`, ascending; detectors of one depth
    are averaged in each sample. An InputError says what is too little.
    """

    def __init__(self, depth, amplitude, derivative):
        """Check, leave out, and find which detectors are of one depth."""
        if not np.all(np.isfinite(depth)):
            raise InputError("depth: every one must be finite")
        kept = finite_samples(np.where(np.isfinite(derivative), amplitude, math.nan))
        self.samples = np.count_nonzero(kept)
        if self.samples < FEWEST_SAMPLES:
            few = f"{self.samples} samples are too few"
            raise InputError(f"amplitude: {few}; {FEWEST_SAMPLES} are needed")
        self.amplitude, self.derivative = amplitude[kept], derivative[kept]
        self.depths, place = np.unique(depth, return_inverse=True)
        # one column a depth: 1/n at each of its n detectors, so that numbers @ share are the means
        self.share = (place[:, None] == np.arange(len(self.depths))) / np.bincount(place)
        self.intensities = np.abs(self.amplitude) ** 2 @ self.share
        if not np.all(self.intensities.any(axis=0)):
            raise InputError("amplitude: it vanishes in all samples")
        if len(self.depths) < FEWEST_DEPTHS:
            few = f"{len(self.depths)} depths are too few for a line"
            raise InputError(f"depth: {few}; {FEWEST_DEPTHS} are needed")

    @cached_property
    def levels(self):
        """ln|A| of each sample, shape (samples, nw, nx), whose mean is the typical amplitude.

        It averages itself where <|A|^2> is ruled by few samples (Sheng, Introduction to Wave
        Scattering, Localization and Mesoscopic Phenomena, 2006, ch. 8).
        """
        size = np.abs(self.amplitude)
        if np.any(size == 0):
            sample, frequency, detector = np.argwhere(size == 0)[0]
            where = f"sample {sample}, frequency {frequency}, detector {detector}"
            raise InputError(f"amplitude: that of {where} vanishes and has no logarithm")
        return np.log(size) @ self.share

    def attenuation(self):
        """Return 1 / length and length of the line <ln|A|> = a - depth / length, by frequency.

        Depths weigh by the variance of their <ln|A|>. The line through the means is the mean of the
        samples' lines, and its error is that over samples: depths of one sample are not
        independent, so weights alone would claim too much. Depths should be those where the fall is
        straight: not next to the walls, and not below the first mode, where walls alone make it.
        The length is NaN where <ln|A|> does not fall by `FALLS` errors at least.
        """
        depths, levels = self.depths, self.levels
        variance = levels.var(axis=0)
        floor = 1e-12 * np.maximum(variance.max(axis=1, keepdims=True), np.finfo(float).tiny)
        weights = 1 / np.maximum(variance, floor)
        # least squares: slope = sum w (x - <x>) y / sum w (x - <x>)^2, <x> = sum w x / sum w
        middle = np.average(np.broadcast_to(depths, weights.shape), 1, weights, keepdims=True)
        along = weights * (depths - middle)
        rate = mean_of(-np.sum(along * levels, axis=2) / np.sum(along * (depths - middle), axis=1))
        with np.errstate(all="ignore"):
            falls = rate.value > FALLS * rate.error
            length = np.where(falls, 1 / rate.value, math.nan)
            error = np.where(falls, rate.error / rate.value**2, math.nan)
        return rate, Estimate(length, error)

    def delay(self, over=None):
        """Return the mean group delay, each sample's weighted by its intensity.

            tau = < |A|^2 (-d arg A / d omega) > / < |A|^2 > = -< Im(A* dA/domega) > / < |A|^2 >

        For a complex Gaussian field this is the mean delay itself, whose own distribution has no
        variance (van Tiggelen, Sebbah, Stoytchev and Genack, Phys. Rev. E 59, 7166 (1999)); where
        modes of one width Gamma overlap it is 1/Gamma. `over`, shape (n, nw), are averages over
        frequencies, one a row, that are wanted in place of single frequencies.
        """
        return jackknife_samples(self._delay(over), self.samples)

    def delay_growth(self, over=None):
        """Return by how much the mean group delay grows with depth, 1 / speed, by frequency.

        The slope of the straight line through `delay`, all depths alike, with the error over
        samples. What stands and rings between walls has none; what propagates has.
        """
        measure, away = self._delay(over), self.depths - self.depths.mean()
        return jackknife_samples(lambda some: measure(some) @ away / np.sum(away**2), self.samples)

    def _delay(self, over):
        """Return the function of a mask of samples that is their mean delay."""
        flow = -np.imag(np.conj(self.amplitude) * self.derivative) @ self.share

        def measure(some):
            late = flow[some].mean(axis=0) / self.intensities[some].mean(axis=0)
            return late if over is None else over @ late

        return measure


@called_right
def transport(medium, ensemble):
    """Return what an ensemble's responses say of transport.

    Only samples count that are good. A delay that is not certain, as the amplitude may vanish
    there, has no weight. Below the first mode walls alone make amplitudes fall, in a length that is
    geometry, and there is none.

    Parameters
    ----------
    medium : pgran.Lattice or pgran.Network
        One of the samples, or of their size.
    ensemble : pgran.results.Ensemble
        Of responses at detectors of three depths or more, with their curves.

    Returns
    -------
    pgran.results.Transport

    Raises
    ------
    InputError
        If there are no curves, or too few depths or samples, or an amplitude vanishes, or all
        frequencies lie below the first mode.
    """
    if not isinstance(ensemble, Ensemble) or ensemble.displacement is None:
        raise InputError("transport: this ensemble has no curves; -ensemble_keep curves keeps them")
    medium = medium_of(medium)
    first, omega = first_mode(medium), ensemble.omega
    waves = omega >= first
    if not waves.any():
        raise InputError(f"transport: all frequencies lie below the first mode, at {first:.4g}")
    good = ensemble.good > 0
    displacement = ensemble.displacement[good]
    # dA/domega along the circle |A| alone: d arg A / domega is minus the delay
    turned = -1j * np.nan_to_num(ensemble.sample_delay[good]) * displacement
    depth = np.asarray(medium.depths(ensemble.detector), dtype=float)
    profiles = Profiles(depth, displacement, turned)
    rate, length = profiles.attenuation()
    edges, over = _bands(omega, first, medium.omega_mx)
    return Transport(
        samples=len(displacement),
        first_mode=first,
        depth=profiles.depths,
        omega=omega,
        edge=edges,
        **estimate.with_errors(
            ln_amplitude=mean_of(profiles.levels),
            intensity=mean_of(profiles.intensities),
            rate=rate,
            length=Estimate(*(np.where(waves, x, np.nan) for x in (length.value, length.error))),
            group_delay=profiles.delay(),
            band_delay=profiles.delay(over),
            delay_growth=profiles.delay_growth(over),
        ),
    )


def _bands(omega, first, unit):
    """Return the edges of bands above the first mode, and the averages over each, (bands, nw)."""
    ends, rows = [], []
    for _, low, high in REGIMES:
        inside = (omega >= max(first, low * unit)) & (omega < high * unit)
        if inside.any():
            lowest = max(first, low * unit, omega.min())
            # the upper end of a band is the lower one of the next, which replaces it
            ends[len(rows) :] = [lowest, min(high * unit, omega.max())]
            rows.append(inside / np.count_nonzero(inside))
    return np.array(ends), np.array(rows)


def is_line(medium, detectors):
    """Return whether detectors have so many depths that a run looks at transport unasked."""
    depth = np.asarray(medium.depths(detectors), dtype=float)
    return bool(np.all(np.isfinite(depth)) and len(np.unique(depth)) >= FEWEST_DEPTHS)


def summary(result):
    """Return in words how far sound gets."""
    found, si = result.transport, SI.of(result)
    known, waves = np.isfinite(found.length), found.omega >= found.first_mode
    if not known.any():
        yield "no attenuation length: amplitudes do not fall with depth for certain"
    else:
        shortest = np.flatnonzero(known)[np.argmin(found.length[known])]
        length, omega = found.length[shortest], found.omega[shortest]
        error = estimate.two_digits(found.length_error[shortest])
        yield (
            f"amplitudes fall with depth at {np.count_nonzero(known)} of "
            f"{np.count_nonzero(waves)} frequencies above the first mode, {found.first_mode:.4g}; "
            f"the shortest attenuation length is {length:.3g} +- {error} "
            f"spacings{si.say('m', length)}, at omega = {omega:.4g}{si.say('Hz', omega)}"
        )
    growths = zip(found.delay_growth, found.delay_growth_error, strict=True)
    for (low, high), (growth, error) in zip(pairwise(found.edge), growths, strict=True):
        yield (
            f"from {low:.3g} to {high:.3g}{si.say('Hz', low, high)} the group delay grows by "
            f"{growth:.3g} +- {estimate.two_digits(error)} a spacing"
        )
