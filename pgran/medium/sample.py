"""What several scenes share: options and what must hold between them, and what these make."""

import dataclasses

from pgran.arguments import shown
from pgran.errors import InputError, PgranError
from pgran.medium.lattice import Lattice
from pgran.medium.law import LAWS, BondLaw
from pgran.medium.network import Network
from pgran.run.agreement import on_root
from pgran.run.options import FILE, INTEGER, INTEGERS, REAL, TEXT, Option, alternatives

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
OWN_KMAX = ("hertz", "file")  # laws of bonds whose largest constant is not known beforehand
# Beyond this many balls all ranks share one lattice, unless options say otherwise; beyond this
# work of a factorization a network.
LARGE, LARGE_WORK = {1: 10**7, 2: 100_000, 3: 20_000}, 3e9


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
        from pgran.medium.network_file import read_network

        component = getattr(options, "detectors_component", "drive")
        lattice = on_root(world, lambda: read_network(options.network_file))
        changes = {"component": component if lattice.displacement != "scalar" else "drive"}
        if options.network_damping is not None:
            changes["damping"] = options.network_damping
        lattice = dataclasses.replace(lattice, **changes)
    elif options.bonds_law == "file":
        from pgran.medium.bonds_file import read_bonds

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


def make_law(options):
    """Return the law that the bond constants are drawn from. Not collective."""
    _, names = LAWS[options.bonds_law]
    return BondLaw(options.bonds_law, **{name: getattr(options, f"bonds_{name}") for name in names})


def ranks_per_lattice(options, lattice, world):
    """Return how many ranks share the lattice: as the options say, or all if it is large.

    Not collective.

    Parameters
    ----------
    options : pgran.run.options.Options
    lattice : pgran.medium.lattice.Lattice
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
