"""A damped oscillator seen through a spectrum, and where waves scatter within a wave length.

    S(s) = (2 / pi) Re [s / (s^2 + s Gamma + Omega^2)],    s = sigma + i omega,

is for sigma = 0 the spectrum of its velocity, (2 / pi) omega^2 Gamma / ((omega^2 - Omega^2)^2 +
omega^2 Gamma^2), and wider by 2 sigma else: Omega and Gamma can be told from either.
"""

import contextlib
import math
import warnings

import numpy as np

from pgran.store.estimate import Estimate

FEWEST = 6  # points that a fit takes


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
                lambda _, *o: spectrum(s, *o),
                s.imag,
                values,
                start,
                jac=lambda _, *o: derivatives(s, *o),
            )
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
