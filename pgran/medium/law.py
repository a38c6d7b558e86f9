"""Bond constants drawn by a law, at first and again: a pure function of seed, bond and generation.

Bond b of a lattice (axis after axis, each array in C order) has the b-th number of the Philox
stream keyed by the seed: a counter-based generator whose raw output NumPy guarantees for good. So
the constants depend neither on the number of ranks nor on the order in which they are drawn.
Elementary functions are evaluated in extended precision and rounded once, because double-precision
exp and log differ in the last bit between processors and NumPy versions.

At each step of a relaxation one bond, drawn uniformly, gets a new constant. Both draws are a pure
function of (seed, trajectory, step): the next changes are known ahead.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from pgran.arguments import called_right, choice, shown
from pgran.errors import InputError, PgranError, log
from pgran.medium.base import Medium
from pgran.medium.base import medium as medium_of
from pgran.run.numbers import numbers
from pgran.run.options import INTEGER, REAL, Option

# The parameters of laws, by their keywords.
HERTZ = Option(
    "bonds_hertz", REAL, 1.0,
    "hertz: c in F = c h^(3/2); given with any law it says how far contacts overlap, h = "
    "(k / 1.5 c)^2, and at which drive they open", "force / length^(3/2)", above=0
)  # fmt: skip
PARAMETERS = {
    "kmin": Option("bonds_kmin", REAL, 0.0, "smallest bond constant", "mass x frequency^2", low=0),
    "kmax": Option(
        "bonds_kmax", REAL, 0.25,
        "largest bond constant; of hertz and file that of omega_mx, by default the largest",
        "mass x frequency^2", above=0
    ),
    "fraction": Option(
        "bonds_fraction", REAL, 0.5, "bimodal: part of the bonds that is kmax", low=0, high=1
    ),
    "force": Option("bonds_force", REAL, 1.0, "hertz: mean contact force", "force", above=0),
    "hertz": HERTZ,
}  # fmt: skip
GRAVITY = Option(
    "bonds_gravity", REAL, 0.0,
    "hertz: by how much the mean force grows with each ball above, along the last axis",
    "force", low=0
)  # fmt: skip
# A law in words, of parameters in words; formulas between dollars.
IN_WORDS = {
    "uniform": "uniform on [{kmin}, {kmax}]",
    "constant": "all {kmax}",
    "loguniform": "log-uniform on [{kmin}, {kmax}]",
    "bimodal": "{kmax} with probability {fraction}, else {kmin}",
    "hertz": "by Hertz's law with $c$ = {hertz}, of exponential forces of mean {force}",
    "file": "read from {file}",
}
STEPS = Option(
    "bonds_redrawn", INTEGER, 0,
    "how many steps of a relaxation come before: each redraws a bond by the law, or a contact "
    "of a network from all of its constants", low=0, high=10**7
)  # fmt: skip
SEED = Option(
    "bonds_redrawn_seed", INTEGER, 1, "seed of these changes, like -relax_seed",
    low=0, high=2**63 - 1
)  # fmt: skip


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
    """Springs k = dF/dh = 3/2 c^(2/3) F^(1/3) of contacts F = c h^(3/2) (paper: hertz, basespr).

    F is exponentially distributed with mean `force`, c is `contact`.
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


@called_right
class BondLaw:
    """The law that bond constants are drawn from, with its parameters.

    Parameters
    ----------
    name : str
        `uniform`, `constant`, `loguniform`, `bimodal`, or `hertz`: k = 3/2 c^(2/3) F^(1/3).
    kmin, kmax, fraction, force, hertz : float, optional
        Parameters of this law, the options `-bonds_kmin` and so on; by default as `PARAMETERS` say.

    Raises
    ------
    InputError
        If the parameters are impossible, or another law's.

    Examples
    --------
    >>> import pgran
    >>> law = pgran.BondLaw("uniform", kmax=2.0)
    >>> law
    BondLaw('uniform', kmin=0.0, kmax=2.0)
    >>> float(law(0.75))
    1.5
    """

    def __init__(
        self, name: str, *, kmin: float | None = None, kmax: float | None = None,
        fraction: float | None = None, force: float | None = None, hertz: float | None = None,
    ):  # fmt: skip
        self.function, names = LAWS[choice("-bonds_law", name, LAWS)]
        own = {"kmin": kmin, "kmax": kmax, "fraction": fraction, "force": force, "hertz": hertz}
        own = {key: value for key, value in own.items() if value is not None}
        for key in own:
            if key not in names:
                raise InputError(
                    f"-bonds_{key}: no parameter of the law {name}; it has {' and '.join(names)}"
                )
        values = {key: own.get(key, PARAMETERS[key].default) for key in names}
        values = {key: PARAMETERS[key].check(value) for key, value in values.items()}
        if "kmin" in names and values["kmin"] > values["kmax"]:
            raise InputError(f"-bonds_kmin: {values['kmin']} exceeds -bonds_kmax {values['kmax']}")
        if name == "loguniform" and values["kmin"] == 0:
            raise InputError("-bonds_kmin: must be positive for -bonds_law loguniform")
        self.name, self.parameters, self.kmax = name, values, values.get("kmax")

    def __call__(self, u):
        """Return the constants that belong to numbers uniform on [0, 1)."""
        return self.function(u, *self.parameters.values())

    def __repr__(self):
        parameters = (f"{key}={value}" for key, value in self.parameters.items())
        return f"BondLaw({', '.join([repr(self.name), *parameters])})"


def deeper(law, weight, above):
    """Return by how much Hertz's law is stiffer below so many balls of a weight.

    The mean force grows from `force` to force + weight * above, k like its cube root.
    """
    GRAVITY.check(weight)
    if getattr(law, "name", None) != "hertz":
        raise InputError("-bonds_gravity: forces make constants by -bonds_law hertz only")
    return np.cbrt(1 + weight * above / law.parameters["force"])


def make_law(options):
    """Return the law that the options of a run describe."""
    _, names = LAWS[options.bonds_law]
    return BondLaw(options.bonds_law, **{name: getattr(options, f"bonds_{name}") for name in names})


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


def drawn(law, u):
    """Return a law's constants, finite and not negative, one for each number; raise InputError."""
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


@called_right
def redrawn(medium: Medium, steps: int, seed: int = 1, law: Callable | None = None) -> Medium:
    """Return a medium after so many steps of the first trajectory of `relax`.

    Parameters
    ----------
    medium : pgran.Lattice or pgran.Network
    steps : int
        Each redraws one bond; other bonds, and omega_mx, stay.
    seed : int
        Seed of the changes, as of `relax`.
    law : callable, optional
        As of `relax`: None draws from the constants that the medium has.

    Returns
    -------
    pgran.Lattice or pgran.Network

    Raises
    ------
    InputError
        If the steps or the law are impossible.

    Examples
    --------
    >>> import numpy as np, pgran
    >>> lattice = pgran.Lattice.random((6, 5), seed=1)
    >>> later = pgran.redrawn(lattice, 3, law=pgran.BondLaw("uniform"))
    >>> int(np.count_nonzero(later.constants != lattice.constants))
    3
    """
    medium = medium_of(medium)
    changes = Redraw(medium, check_law(law), SEED.check(seed))(0, 0, STEPS.check(steps))
    constants = medium.constants.copy()
    constants[changes.bond] = changes.stiffness  # of several of one bond the last holds
    if len(changes) and np.array_equal(constants, medium.constants):
        log.warning("-bonds_redrawn %d: each bond has its old constant again", len(changes))
    return medium.with_constants(constants)


class Redraw:
    """The changes of a medium's bonds, by a law; None draws from the constants that it has."""

    def __init__(self, medium, law, seed):
        self.bonds, self.seed = medium.existing, seed
        constants = medium.constants[self.bonds]

        def own(u):
            return constants[(u * len(constants)).astype(np.int64)]

        self.law = own if law is None else partial(drawn, law)

    def __call__(self, trajectory, first, count, unit=1.0):
        """Return the changes of some steps, constants in a unit; see `draw_changes`."""
        changes = draw_changes(self.law, len(self.bonds), self.seed, trajectory, first, count, unit)
        return dataclasses.replace(changes, bond=self.bonds[changes.bond])


def draw_changes(law, bonds, seed, trajectory, first, count, unit=1.0):
    """Return the changes of `count` steps from step `first` on, counted from 0, in a unit.

    Trajectories of one seed are independent. `law` turns numbers uniform on [0, 1) into constants.
    """
    # two numbers a step: u[0] u[1] | u[2] u[3] | ...  say  bond, constant | bond, constant | ...
    u = unit_numbers(seed, 2 * first, 2 * count, generation=1 + trajectory)
    return Changes(np.minimum((u[::2] * bonds).astype(np.int64), bonds - 1), law(u[1::2]) / unit)


@dataclass(frozen=True)
class Changes:
    """Bonds that change, and their new constants."""

    bond: np.ndarray  # numbers of bonds, axis after axis, each array in C order
    stiffness: np.ndarray  # their new constants

    def __getitem__(self, steps):
        return Changes(self.bond[steps], self.stiffness[steps])

    def __len__(self):
        return len(self.bond)

    def extended(self, count):
        """Return at least `count` changes, the last one repeated, which changes nothing more."""
        return self[np.minimum(np.arange(max(count, len(self))), len(self) - 1)]
