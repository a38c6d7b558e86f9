"""What several scenes share: options and what must hold between them, and what these make."""

import dataclasses

import numpy as np

from pgran.arguments import shown
from pgran.errors import FileError, InputError, PgranError
from pgran.files.options import FILE, INTEGER, INTEGERS, REAL, REALS, TEXT, Option
from pgran.machine import check_memory
from pgran.parallel.agreement import on_root
from pgran.physics.bondlaw import LAWS, BondLaw
from pgran.physics.lattice import Lattice
from pgran.physics.network import Network
from pgran.physics.numbers import numbers

LATTICE = (
    Option("lattice_shape", INTEGERS, (20, 20), "balls along each axis, 1 to 3 numbers", low=1),
    Option("lattice_mass", REAL, 1.0, "mass m of a ball", above=0),
    Option("lattice_damping", REAL, 0.003, "damping beta of every bond", "mass x frequency", low=0),
    Option(
        "bonds_law", TEXT, "uniform",
        "uniform on [kmin, kmax]; constant kmax; loguniform on [kmin, kmax]; bimodal, kmin or "
        "kmax; hertz, 3/2 c^(2/3) F^(1/3) with exponential forces F; file",
        choices=(*LAWS, "file"),
    ),
    Option("bonds_kmin", REAL, 0.0, "smallest bond constant", "mass x frequency^2", low=0),
    Option(
        "bonds_kmax", REAL, 0.25,
        "largest bond constant; of hertz and file what omega_mx belongs to, where given",
        "mass x frequency^2", above=0
    ),
    Option("bonds_fraction", REAL, 0.5, "bimodal: part of the bonds that is kmax", low=0, high=1),
    Option("bonds_force", REAL, 1.0, "hertz: mean contact force", "force", above=0),
    Option("bonds_hertz", REAL, 1.0, "hertz: c in F = c h^(3/2)", "force / length^(3/2)", above=0),
    Option("bonds_seed", INTEGER, 1993, "which sample", low=0, high=2**63 - 1),
    Option("bonds_file", FILE, None, "law file: HDF5 file with /lattice/stiffness_x ..."),
)  # fmt: skip
NETWORK = (
    Option(
        "network_file", FILE, None,
        "HDF5 file with /network/bond, stiffness ..., instead of a lattice and its bonds"
    ),
    Option(
        "network_damping", REAL, None, "damping beta of every contact; else the file's",
        "mass x frequency", low=0
    ),
)  # fmt: skip
LATTICE = (*LATTICE, *NETWORK)
DETECTORS = (
    Option(
        "detectors", INTEGERS, (8, 10), "ball indices from 0, flat: 8,10 or 8,10,3,4",
        low=0, high=2**63 - 1
    ),
    Option(
        "detectors_component", TEXT, "drive",
        "of networks with vectors: what of a displacement is read, along the drive or an axis",
        choices=("drive", "x", "y", "z")
    ),
)  # fmt: skip
FREQUENCIES = (
    Option("sweep_min", REAL, 0.01, "lowest driving frequency", "angular", above=0),
    Option("sweep_max", REAL, 1.3, "highest driving frequency", "angular", above=0),
    Option("sweep_points", INTEGER, 1291, "frequencies of the linear grid", low=1),
    Option(
        "sweep_omega", REALS, None, "driving frequencies, instead of a grid", "angular", above=0
    ),
)
SWEEP = (
    *FREQUENCIES,
    Option(
        "sweep_unit", TEXT, "absolute", "what the frequencies of a sweep are given in",
        choices=("absolute", "omega_mx")
    ),
)  # fmt: skip
OWN_KMAX = ("hertz", "file")  # laws of bonds whose largest constant is not known beforehand
# Beyond this many balls all ranks share one lattice, unless options say otherwise; beyond this
# work of a factorization a network.
LARGE, LARGE_WORK = {1: 10**7, 2: 100_000, 3: 20_000}, 3e9


def alternatives(some, others, values, given):
    """Let one of two ways to say the same stand: what was given, and of both the winning source.

    Not collective.

    Parameters
    ----------
    some, others : sequence of str
        Options. `some` stand only where given; without any, `others` have their defaults.
    values : dict
        Of all options; those of the way that does not stand become None.
    given : dict of pgran.files.reading.Given

    Raises
    ------
    InputError
        If both ways are given at the same place.
    """
    first, second = (
        max((given[k].rank for k in keys if k in given), default=-1) for keys in (some, others)
    )
    if first == second >= 0:
        one, other = (next(given[k] for k in keys if k in given) for keys in (some, others))
        raise InputError(
            f"-{other.key}{other.where}: contradicts -{one.key}{one.where}; give one of them"
        )
    if max(first, second) >= 0 or values[some[0]] is not None:
        values.update(dict.fromkeys(others if first > second else some))


def check_lattice(values, given, law=()):
    """Raise where the options of a lattice contradict each other.

    Not collective. `law` are names of options that say more than what a lattice is made of.
    """
    named = [o.name for o in LATTICE if o not in NETWORK and o.name not in law]
    alternatives(("network_file", "network_damping"), named, values, given)
    if values["network_file"] is not None:
        return
    if values["network_damping"] is not None:
        raise InputError("-network_damping belongs to -network_file; of a lattice -lattice_damping")
    if values.get("detectors_component") not in ("drive", None):
        raise InputError("-detectors_component: balls of a lattice have one displacement")
    if len(values["lattice_shape"]) > 3:
        raise InputError("-lattice_shape: a lattice has 1 to 3 axes")
    from_file = values["bonds_law"] == "file"
    if from_file != (values["bonds_file"] is not None):
        raise InputError("-bonds_file and -bonds_law file belong together: give both or neither")
    if values["bonds_law"] in OWN_KMAX:  # a kmax from a source before the law's is another law's
        kmax = given.get("bonds_kmax")
        if kmax is None or kmax.rank < given["bonds_law"].rank:
            values["bonds_kmax"] = None
    if from_file:
        for name in ("lattice_shape", "bonds_kmin"):
            if name in given and given[name].rank >= given["bonds_file"].rank:
                raise InputError(f"-{name}{given[name].where}: contradicts -bonds_file")
            values[name] = None


def check_sweep(values, given):
    """Raise where the options of a sweep contradict each other. Not collective."""
    alternatives(("sweep_omega",), ("sweep_min", "sweep_max", "sweep_points"), values, given)
    omega = values["sweep_omega"]
    if omega is None:
        check_ends("sweep", values)
    elif list(omega) != sorted(set(omega)):
        raise InputError("-sweep_omega: the frequencies must increase")


def check_values(options, **values):
    """Raise unless values given in Python are possible for the options of their names.

    Not collective.

    Raises
    ------
    InputError
        As for the same value on the command line.
    """
    for option in options:
        if option.name in values:
            option.check(values[option.name])


def medium(value):
    """Return a lattice or a network that was handed in, as a result's record, too.

    Not collective. Raises InputError if it is none.
    """
    value = getattr(value, "built", value)
    if not isinstance(value, (Lattice, Network)):
        raise InputError(
            f"lattice: a pgran.Lattice or a pgran.Network is needed, not {shown(value)}"
        )
    return value


def checks(options, prefix=""):
    """Return what checks values of options, by their names without a prefix. Not collective."""
    return {option.name.removeprefix(prefix): option.check for option in options}


def window(name, options, ends):
    """Return the two ends of a window that was handed in, by options `name`_min and `name`_max.

    Not collective. Raises InputError if there are not two, or they are impossible for these.
    """
    ends = numbers(f"-{name}_min, -{name}_max", ends)
    if ends.shape != (2,):
        raise InputError(f"-{name}_min, -{name}_max: a window has two ends, not {ends.size}")
    values = dict(zip((f"{name}_min", f"{name}_max"), ends, strict=True))
    check_values(options, **values)
    check_ends(name, values)
    return tuple(ends.tolist())


def check_ends(name, values):
    """Raise unless the lower end of a window lies below its upper end. Not collective."""
    low, high = (values.get(f"{name}_{end}") for end in ("min", "max"))
    if low is not None and low >= high:
        raise InputError(f"-{name}_min: {low:g} is not below -{name}_max, {high:g}")


def make_lattice(options, world):
    """Return the lattice or the network that the options describe, the same on every rank.

    Collective.

    Raises
    ------
    InputError, FileError
        If the options or the bonds file are impossible.
    PgranError
        If the ranks disagree on the bonds.
    """
    if options.network_file is not None:
        from pgran.files.network import read_network

        component = getattr(options, "detectors_component", "drive")
        lattice = on_root(world, lambda: read_network(options.network_file))
        changes = {"component": component if lattice.displacement != "scalar" else "drive"}
        if options.network_damping is not None:
            changes["damping"] = options.network_damping
        lattice = dataclasses.replace(lattice, **changes)
    elif options.bonds_law == "file":
        stiffness, kmax = on_root(world, lambda: read_bonds(options.bonds_file))
        lattice = Lattice(stiffness, options.lattice_mass, options.lattice_damping, kmax)
    else:
        lattice = Lattice.random(
            options.lattice_shape,
            options.bonds_seed,
            make_law(options),
            mass=options.lattice_mass,
            damping=options.lattice_damping,
        )
    if options.network_file is None and options.bonds_law in OWN_KMAX and options.bonds_kmax:
        lattice = dataclasses.replace(lattice, kmax=options.bonds_kmax)
    if len(set(world.allgather(lattice.bonds_sha256))) > 1:
        raise PgranError("the ranks drew different bonds: do they run the same NumPy?")
    return lattice


def read_bonds(path):
    """Return the bond constants in a file, which make a lattice, and what sets their unit.

    Not collective.

    Returns
    -------
    stiffness : tuple of numpy.ndarray
    kmax : float or None
        As `pgran.files.store.read_stiffness` returns them.

    Raises
    ------
    FileError
        If the file is no good, or no lattice has such bonds.
    """
    from pgran.files.store import read_stiffness

    stiffness, kmax = read_stiffness(path)
    try:
        Lattice(stiffness)
    except InputError as error:
        raise FileError(f"{path}: /lattice/{error}") from None
    return stiffness, kmax


def make_law(options):
    """Return the law that the bond constants are drawn from. Not collective."""
    _, names = LAWS[options.bonds_law]
    return BondLaw(options.bonds_law, **{name: getattr(options, f"bonds_{name}") for name in names})


def ranks_per_lattice(options, lattice, world):
    """Return how many ranks share the lattice: as the options say, or all if it is large.

    Not collective.

    Parameters
    ----------
    options : pgran.files.options.Options
    lattice : pgran.physics.lattice.Lattice
    world : mpi4py.MPI.Comm
    """
    return options.ranks_per_lattice or automatic_ranks(lattice, world.size)


def automatic_ranks(lattice, ranks):
    """Return how many of the ranks should share a lattice: one, unless it is large.

    Not collective.
    """
    if lattice.irregular:
        return ranks if lattice.graph.work > LARGE_WORK else 1
    return ranks if lattice.balls > LARGE[lattice.axes] else 1


def driving_frequencies(options, lattice=None):
    """Return the frequencies of the sweep, angular, increasing; the lattice may be their unit.

    Not collective.

    Raises
    ------
    InputError
        If the lattice has no omega_mx to measure them in.
    """
    if options.sweep_omega:
        omegas = np.array(options.sweep_omega)
    else:
        check_memory("sweep_points", 8 * options.sweep_points)
        omegas = np.linspace(options.sweep_min, options.sweep_max, options.sweep_points)
    if lattice is None or options.sweep_unit == "absolute":
        return omegas
    if not lattice.omega_mx > 0:
        raise InputError("-sweep_unit omega_mx: without stiff bonds omega_mx is 0")
    return omegas * lattice.omega_mx
