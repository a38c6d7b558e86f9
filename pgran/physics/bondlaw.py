"""Bond constants as a pure function of seed, bond and generation.

Bond b of a lattice (axis after axis, each array in C order) has the b-th number of the Philox
stream keyed by the seed: a counter-based generator whose raw output NumPy guarantees for good. So
the constants depend neither on the number of ranks nor on the order in which they are drawn.
Elementary functions are evaluated in extended precision and rounded once, because double-precision
exp and log differ in the last bit between processors and NumPy versions.
"""

import math

import numpy as np

from pgran.errors import InputError


def unit_numbers(seed, first, count, generation=0):
    """Return numbers uniform on [0, 1), multiples of 2**-53, those of the bonds from `first` on.

    Not collective.

    Parameters
    ----------
    seed : int
        0 <= seed < 2**64.
    first, count : int
        Which part of the stream.
    generation : int
        Independent streams of the same seed.
    """
    block, skip = divmod(first, 4)  # Philox makes four numbers for each value of its counter
    stream = np.random.Philox(key=seed, counter=[block, 0, generation, 0])
    raw = stream.random_raw(skip + count)[skip:]
    return (raw >> np.uint64(11)) * 2.0**-53


def _uniform(u, kmin, kmax):
    """Uniform on [kmin, kmax), the paper's law with kmin = 0."""
    return kmin + (kmax - kmin) * u


def _constant(u, kmax):
    """Every bond the same."""
    return np.full_like(u, kmax)


def _loguniform(u, kmin, kmax):
    """Uniform in log k between kmin and kmax."""
    low, high = np.log(np.array([kmin, kmax], dtype=np.longdouble))
    k = np.exp(low + (high - low) * u.astype(np.longdouble)).astype(float)
    return np.clip(k, kmin, kmax)


def _bimodal(u, kmin, kmax, fraction):
    """A `fraction` of the bonds kmax, the others kmin."""
    return np.where(u < fraction, kmax, kmin)


def _hertz(u, force, contact):
    """Springs of Hertzian contacts under random forces (paper: hertz, basespr).

    F = c h^(3/2) linearised at the force F gives k = 3/2 c h^(1/2) = 3/2 c^(2/3) F^(1/3); F is
    exponentially distributed with mean `force`, c is `contact`.
    """
    forces = -np.longdouble(force) * np.log1p(-u.astype(np.longdouble))
    return (1.5 * np.cbrt(np.longdouble(contact) ** 2 * forces)).astype(float)


LAWS = {
    "uniform": (_uniform, ("kmin", "kmax")),
    "constant": (_constant, ("kmax",)),
    "loguniform": (_loguniform, ("kmin", "kmax")),
    "bimodal": (_bimodal, ("kmin", "kmax", "fraction")),
    "hertz": (_hertz, ("force", "hertz")),
}


class BondLaw:
    """The law that bond constants are drawn from, with its parameters.

    Parameters
    ----------
    name : str
        A key of `LAWS`.
    kmin, kmax, fraction, force, hertz : float
        The options `-bonds_kmin` and so on; a law reads only its own.

    Raises
    ------
    InputError
        If the parameters are impossible.
    """

    def __init__(self, name, *, kmin=0.0, kmax=0.25, fraction=0.5, force=1.0, hertz=1.0):
        """Check and keep the parameters."""
        if name not in LAWS:
            raise InputError(f"bonds_law: {name!r} is none of {', '.join(LAWS)}")
        given = {"kmin": kmin, "kmax": kmax, "fraction": fraction, "force": force, "hertz": hertz}
        self.function, names = LAWS[name]
        self.parameters = [given[key] for key in names]
        for key, value in zip(names, self.parameters, strict=True):
            positive = key not in ("kmin", "fraction")
            if not math.isfinite(value) or value < 0 or (positive and value == 0):
                raise InputError(
                    f"bonds_{key}: must be {'positive' if positive else '0 or more'} "
                    f"and finite, not {value}"
                )
        if "kmin" in names and kmin > kmax:
            raise InputError(f"bonds_kmin: {kmin} is above bonds_kmax, {kmax}")
        if name == "loguniform" and kmin == 0:
            raise InputError("bonds_kmin: must be positive for -bonds_law loguniform")
        if name == "bimodal" and fraction > 1:
            raise InputError(f"bonds_fraction: must lie in [0, 1], not {fraction}")
        self.kmax = kmax if "kmax" in names else None

    def __call__(self, u):
        """Return the constants that belong to numbers uniform on [0, 1)."""
        return self.function(u, *self.parameters)
