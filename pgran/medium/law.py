"""Bond constants as a pure function of seed, bond and generation.

Bond b of a lattice (axis after axis, each array in C order) has the b-th number of the Philox
stream keyed by the seed: a counter-based generator whose raw output NumPy guarantees for good. So
the constants depend neither on the number of ranks nor on the order in which they are drawn.
Elementary functions are evaluated in extended precision and rounded once, because double-precision
exp and log differ in the last bit between processors and NumPy versions.
"""

import numpy as np

from pgran.arguments import called_right, choice, shown
from pgran.errors import InputError, PgranError
from pgran.medium.units import check_size
from pgran.run.numbers import number, numbers
from pgran.run.options import REAL, Option


def unit_numbers(seed, first, count, generation=0):
    """Return numbers uniform on [0, 1), multiples of 2**-53: `count` of a stream, from `first` on.

    The seed lies in [0, 2**64); its generations are independent streams.
    """
    block, skip = divmod(first, 4)  # Philox makes four numbers for each value of its counter
    stream = np.random.Philox(key=seed, counter=[block, 0, generation, 0])
    raw = stream.random_raw(skip + count)[skip:]
    return (raw >> np.uint64(11)) * 2.0**-53  # the upper 53 of 64 bits, which doubles hold


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

    F = c h^(3/2) linearised at F gives k = dF/dh = 3/2 c^(2/3) F^(1/3); F is exponentially
    distributed with mean `force`, c is `contact`.
    """
    forces = -np.longdouble(force) * np.log1p(-u.astype(np.longdouble))
    return (1.5 * np.cbrt(np.longdouble(contact) ** 2 * forces)).astype(float)


# Of each law its function, and which parameters it has.
LAWS = {
    "uniform": (_uniform, ("kmin", "kmax")),
    "constant": (_constant, ("kmax",)),
    "loguniform": (_loguniform, ("kmin", "kmax")),
    "bimodal": (_bimodal, ("kmin", "kmax", "fraction")),
    "hertz": (_hertz, ("force", "hertz")),
}
# A law in words, of parameters in words; formulas between dollars.
IN_WORDS = {
    "uniform": "uniform on [{kmin}, {kmax}]",
    "constant": "all {kmax}",
    "loguniform": "log-uniform on [{kmin}, {kmax}]",
    "bimodal": "{kmax} with probability {fraction}, else {kmin}",
    "hertz": "by Hertz's law with $c$ = {hertz}, of exponential forces of mean {force}",
    "file": "read from {file}",
}
DEFAULTS = {"kmin": 0.0, "kmax": 0.25, "fraction": 0.5, "force": 1.0, "hertz": 1.0}
HERTZ = Option(
    "bonds_hertz", REAL, DEFAULTS["hertz"], "hertz: c in F = c h^(3/2)",
    "force / length^(3/2)", above=0
)  # fmt: skip


@called_right
class BondLaw:
    """The law that bond constants are drawn from, with its parameters.

    Parameters
    ----------
    name : str
        A key of `LAWS`.
    kmin, kmax, fraction, force, hertz : float, optional
        Parameters of this law, the options `-bonds_kmin` and so on; by default as `DEFAULTS`.

    Raises
    ------
    InputError
        If the parameters are impossible, or another law's.
    """

    def __init__(self, name, *, kmin=None, kmax=None, fraction=None, force=None, hertz=None):
        self.function, names = LAWS[choice("-bonds_law", name, LAWS)]
        own = {"kmin": kmin, "kmax": kmax, "fraction": fraction, "force": force, "hertz": hertz}
        own = {key: value for key, value in own.items() if value is not None}
        for key in own:
            if key not in names:
                raise InputError(
                    f"-bonds_{key}: no parameter of the law {name}; it has {' and '.join(names)}"
                )
        values = {key: number(f"bonds_{key}", own.get(key, DEFAULTS[key])) for key in names}
        for key, value in values.items():
            check_size(f"-bonds_{key}", value, positive=key not in ("kmin", "fraction"))
        if "kmin" in names and values["kmin"] > values["kmax"]:
            raise InputError(f"-bonds_kmin: {values['kmin']} exceeds -bonds_kmax {values['kmax']}")
        if name == "loguniform" and values["kmin"] == 0:
            raise InputError("-bonds_kmin: must be positive for -bonds_law loguniform")
        if name == "bimodal" and values["fraction"] > 1:
            raise InputError(f"-bonds_fraction: must lie in [0, 1], not {values['fraction']}")
        self.name, self.parameters, self.kmax = name, values, values.get("kmax")

    def __call__(self, u):
        """Return the constants that belong to numbers uniform on [0, 1)."""
        return self.function(u, *self.parameters.values())

    def deeper(self, weight, above):
        """Return by how much Hertz's law is stiffer below so many balls of a weight.

        The mean force grows from `force` to force + weight * above, k like its cube root. Raises
        InputError of another law, or of an impossible weight.
        """
        check_size("-bonds_gravity", number("-bonds_gravity", weight), positive=False)
        if self.name != "hertz":
            raise InputError("-bonds_gravity: forces make constants by -bonds_law hertz only")
        return np.cbrt(1 + weight * above / self.parameters["force"])

    def __repr__(self):
        parameters = (f"{key}={value}" for key, value in self.parameters.items())
        return f"BondLaw({', '.join([repr(self.name), *parameters])})"


def drawn(law, u):
    """Return the constants that a law of the user's makes of numbers uniform on [0, 1).

    Raises InputError unless there is one for each number, finite and not negative.
    """
    try:
        returned = law(u.copy())
    except PgranError:
        raise
    except Exception as error:
        raise InputError(f"law: fails: {type(error).__name__}: {error}") from error
    constants = numbers("law: what it returns", returned)
    if constants.shape != u.shape:
        raise InputError(
            f"law: returns numbers of the shape {constants.shape} for {u.shape}; it must turn each "
            "number between 0 and 1 into a bond constant"
        )
    impossible = constants[~(np.isfinite(constants) & (constants >= 0))]
    if impossible.size:
        raise InputError(
            f"law: bond constants must be finite and not negative, and it returns {impossible[0]:g}"
        )
    return constants


def check_law(law):
    """Return a law of the user's, or None for none, once it has been tried; raise InputError.

    Each constant must depend on its own number alone: else results would depend on how many are
    drawn at a time.
    """
    if law is None:
        return None
    if not callable(law):
        hint = "pgran.BondLaw makes one"
        raise InputError(f"law: {shown(law)} is no function of numbers between 0 and 1; {hint}")
    whole = drawn(law, TRIED)
    parts = np.concatenate([drawn(law, TRIED[:3]), drawn(law, TRIED[3:])])
    if not np.allclose(whole, parts, rtol=1e-12, atol=0):
        raise InputError(
            "law: returns other constants for the same numbers; each must depend on its own number "
            "alone, not on others, earlier calls or another source of chance"
        )
    return law


TRIED = unit_numbers(0, 0, 16)  # what laws are tried with


def make_law(options):
    """Return the law that the bond constants are drawn from."""
    _, names = LAWS[options.bonds_law]
    return BondLaw(options.bonds_law, **{name: getattr(options, f"bonds_{name}") for name in names})
