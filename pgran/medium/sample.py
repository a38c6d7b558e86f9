"""The medium of a run: its options, their checks, and the lattice or network they make."""

import dataclasses

from pgran.errors import InputError, PgranError
from pgran.medium.base import ALONG, BETA
from pgran.medium.law import GRAVITY, LAWS, PARAMETERS, SEED, STEPS, make_law, redrawn
from pgran.run.agreement import on_root
from pgran.run.options import FILE, FILES, INTEGER, INTEGERS, REAL, TEXT, Option, alternatives

OF_LATTICE = (
    Option("lattice_shape", INTEGERS, (20, 20), "balls along each axis, 1 to 3 numbers", low=1),
    Option("lattice_mass", REAL, 1.0, "mass m of a ball", above=0),
    Option("lattice_damping", REAL, BETA, "damping beta of every bond", "mass x frequency", low=0),
    Option("lattice_free", TEXT, None, "sides without a wall, y+ or x-,y-,y+"),
    Option(
        "bonds_law", TEXT, "uniform",
        "uniform on [kmin, kmax]; constant, kmax; loguniform on [kmin, kmax]; bimodal, kmin or "
        "kmax; hertz, 3/2 c^(2/3) F^(1/3) with exponential forces F; file, of -bonds_file",
        choices=(*LAWS, "file"),
    ),
    *(PARAMETERS[name] for name in ("kmin", "kmax", "fraction", "force")),
    GRAVITY,
    PARAMETERS["hertz"],
    Option("bonds_seed", INTEGER, 1993, "which sample: seed of its bonds", low=0, high=2**63 - 1),
    Option("bonds_file", FILE, None, "of law file: HDF5 file with /lattice/stiffness_x ..."),
)  # fmt: skip
OF_NETWORK = (
    Option(
        "network_file", FILES, None,
        "HDF5 file of a network, which takes the place of a lattice; for an ensemble several "
        "files, one for each sample, a.h5,b.h5 or a quoted pattern, 'pack_*.h5'"
    ),
    Option(
        "network_damping", REAL, None, "damping beta of every contact; by default the file's",
        "mass x frequency", low=0
    ),
    Option(
        "network_rattlers", TEXT, None,
        "balls that too few contacts hold: keep them, or remove, which leaves out their contacts "
        "and holds them at rest, so that all balls keep their numbers",
        choices=("keep", "remove")
    ),
)  # fmt: skip
OF_DAMPING = (
    Option(
        "damping_power", REAL, None,
        "p of dashpots beta (k / k_ref)^p, k_ref the mean k: 0, all alike; 1, in proportion to "
        "stiffness; 0.5, as usual in simulations of contacts; by default the file's, or 0",
    ),
    Option(
        "damping_mass", REAL, None, "alpha of a drag -alpha m v; by default the file's, or 0",
        "angular", low=0
    ),
    Option(
        "damping_loss", REAL, None,
        "eta of springs k (1 + i eta), which lose the same part of the energy in a cycle at all "
        "frequencies; by default the file's, or 0", low=0, high=1e6
    ),
    Option(
        "damping_part", TEXT, None,
        "of networks with vectors: dashpots act on all of the relative velocity at a contact, or "
        "on its normal part; by default as the file says", choices=("all", "normal")
    ),
)  # fmt: skip
OF_SOURCE = (
    Option(
        "drive_part", TEXT, None,
        "which part drives: places of the wall, or held balls, by a condition such as 'y>=5 and "
        "y<15'; all else is at rest"
    ),
    Option(
        "drive_direction", TEXT, "drive", f"of networks with vectors: how held balls move: {ALONG}"
    ),
    Option(
        "drive_balls", INTEGERS, None,
        "a force on these balls drives instead: indices from 0, as of -detectors; in all it has "
        "the size kmax, and amplitudes are in units of that force over kmax",
        low=0, high=2**63 - 1
    ),
    Option("drive_force", TEXT, "drive", f"of networks with vectors: how it acts: {ALONG}"),
)  # fmt: skip
LATTICE = (*OF_LATTICE, *OF_NETWORK, *OF_DAMPING, *OF_SOURCE, STEPS, SEED)
LAW = ("bonds_law", *(option.name for option in PARAMETERS.values()))
OWN_KMAX = ("hertz", "file")  # laws of bonds whose largest constant is not known beforehand
# What is of networks alone, and what to say of it for a lattice.
OF_NETWORKS = {
    "network_damping": " belongs to -network_file; of a lattice -lattice_damping",
    "damping_part": " belongs to -network_file: bonds of a lattice have one part",
    "network_rattlers": " belongs to -network_file: a lattice has none",
    "detectors_component": ": balls of a lattice have one displacement",
    "detectors_at": ": balls of a lattice are named by their indices, -detectors",
}


def check_lattice(values, given, draws=False, several=False):
    """Raise where the options of a medium contradict each other.

    `draws`: the experiment draws constants itself, of networks too; `several` networks may be.
    """
    network = values["network_file"]
    if network is not None:  # no word about a lattice makes one of it
        law = LAW if draws else ()
        named = [option.name for option in OF_LATTICE if option.name not in law]
        alternatives(("network_file",), named, values, given, whole=())
        network = values["network_file"]
    if values.get("detectors_at") is not None:
        alternatives(("detectors_at",), ("detectors",), values, given)
    if network is None:
        _check_grid(values, given, draws or values["bonds_redrawn"] > 0)
    elif len(network) > 1 and not several:
        raise InputError("-network_file: several networks are samples of -scene ensemble")


def _check_grid(values, given, draws):
    """Raise where options of a lattice contradict each other; unset what a file says instead."""
    for name, why in OF_NETWORKS.items():
        if values.get(name) not in (None, "drive"):
            raise InputError(f"-{name}{why}")
    if len(values["lattice_shape"]) > 3:
        raise InputError("-lattice_shape: a lattice has 1 to 3 axes")
    if values["bonds_gravity"] and (draws or values["bonds_law"] != "hertz"):
        why = "a bond that is redrawn would lose its load" if draws else "it needs -bonds_law hertz"
        raise InputError(f"-bonds_gravity: {why}")
    if values["bonds_law"] != "hertz" and "bonds_hertz" not in given:
        values["bonds_hertz"] = None  # the default is that of the law
    from_file = values["bonds_law"] == "file"
    if from_file and values["bonds_redrawn"]:
        raise InputError("-bonds_redrawn: -bonds_law file is no law to draw new constants from")
    if from_file != (values["bonds_file"] is not None):
        raise InputError("-bonds_file and -bonds_law file belong together: give both or neither")
    if values["bonds_law"] in OWN_KMAX:
        # a kmax set by a weaker source than the law, as by the file if the law is on the command
        # line, belonged to the other law
        kmax = given.get("bonds_kmax")
        if kmax is None or kmax.rank < given["bonds_law"].rank:
            values["bonds_kmax"] = None
    if from_file:
        for name in ("lattice_shape", "bonds_kmin"):
            if name in given and given[name].rank >= given["bonds_file"].rank:
                raise InputError(f"-{name}{given[name].where}: contradicts -bonds_file")
            values[name] = None


def make_lattice(options, world):
    """Return the lattice or the network that the options describe, the same on every rank.

    Collective. Raises PgranError if they are impossible, or the ranks disagree on the bonds.
    """
    medium = (_lattice if options.network_file is None else _network)(options, world)
    if options.bonds_redrawn:
        law = options.bonds_law and make_law(options)
        medium = redrawn(medium, options.bonds_redrawn, options.bonds_redrawn_seed, law)
    source = {option: getattr(options, option.name) for option in OF_SOURCE}
    if any(value != option.default for option, value in source.items()):
        from pgran.medium.source import with_source

        medium = with_source(medium, *source.values())
    if len(set(world.allgather(medium.bonds_sha256))) > 1:
        raise PgranError("the ranks drew different bonds: do they run the same NumPy?")
    return medium


def _network(options, world):
    """Return the network of a file, changed as the options ask. Collective."""
    from pgran.medium.graph import with_rattlers_at_rest
    from pgran.medium.network_file import read_network

    network = on_root(world, lambda: read_network(options.network_file[0]))
    if options.network_rattlers == "remove":
        network = with_rattlers_at_rest(network)
    component = getattr(options, "detectors_component", None)
    if network.displacement == "scalar" or component is None:
        component = "drive"
    asked = {"damping": options.network_damping, "damped": options.damping_part} | _laws(options)
    asked = {name: value for name, value in asked.items() if value is not None}
    return dataclasses.replace(network, component=component, **asked)


def _laws(options):
    """Return the laws of damping that options ask for, None where they do not, by their fields."""
    power = options.damping_power
    return {"damping_power": power, "drag": options.damping_mass, "loss": options.damping_loss}


def _lattice(options, world):
    """Return the lattice of a bonds file or of a law. Collective."""
    from pgran.medium.lattice import Lattice

    facts = {name: value or 0.0 for name, value in _laws(options).items()}
    facts |= {"mass": options.lattice_mass, "damping": options.lattice_damping}
    facts |= {"free": options.lattice_free or (), "hertz": options.bonds_hertz}
    if options.bonds_law == "file":
        from pgran.medium.bonds_file import read_bonds

        stiffness, kmax = on_root(world, lambda: read_bonds(options.bonds_file))
        lattice = Lattice(stiffness, kmax=kmax, **facts)
    else:
        drawn = options.lattice_shape, options.bonds_seed, make_law(options)
        lattice = Lattice.random(*drawn, gravity=options.bonds_gravity, **facts)
    if options.bonds_law in OWN_KMAX and options.bonds_kmax:
        lattice = dataclasses.replace(lattice, kmax=options.bonds_kmax)
    return lattice


def ranks_per_lattice(scene, options, medium, world):
    """Return how many ranks share the medium of a run: as asked, or all if it is large."""
    if not scene.shares_lattice:
        return 1
    return options.ranks_per_lattice or (world.size if medium.is_large else 1)
