"""What several scenes share: options and what must hold between them, and what these make."""

import dataclasses

from pgran.errors import InputError, PgranError
from pgran.medium.dissipation import OF_DAMPING
from pgran.medium.lattice import Lattice
from pgran.medium.law import DEFAULTS, HERTZ, LAWS, make_law
from pgran.medium.redraw import REDRAWN, redrawn
from pgran.medium.source import OF_SOURCE, with_source
from pgran.medium.units import BETA
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
    Option(
        "bonds_kmin", REAL, DEFAULTS["kmin"], "smallest bond constant", "mass x frequency^2", low=0
    ),
    Option(
        "bonds_kmax", REAL, DEFAULTS["kmax"],
        "largest bond constant; of hertz and file that of omega_mx, by default the largest",
        "mass x frequency^2", above=0
    ),
    Option(
        "bonds_fraction", REAL, DEFAULTS["fraction"], "bimodal: part of the bonds that is kmax",
        low=0, high=1
    ),
    Option("bonds_force", REAL, DEFAULTS["force"], "hertz: mean contact force", "force", above=0),
    Option(
        "bonds_gravity", REAL, 0.0,
        "hertz: by how much the mean force grows with each ball above, along the last axis",
        "force", low=0
    ),
    HERTZ,
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
LAW = ("bonds_law", "bonds_kmin", "bonds_kmax", "bonds_fraction", "bonds_force", "bonds_hertz")
LATTICE = (*OF_LATTICE, *OF_NETWORK, *OF_DAMPING, *OF_SOURCE, *REDRAWN)
OWN_KMAX = ("hertz", "file")  # laws of bonds whose largest constant is not known beforehand


def check_lattice(values, given, draws=False, several=False):
    """Raise where the options of a medium contradict each other.

    `draws` says that the experiment draws constants itself, of networks by the law, too, `several`
    that there may be more than one network.
    """
    law = LAW if draws else ()
    if values["network_file"] is not None:  # no word about a lattice makes one of it
        named = [option.name for option in OF_LATTICE if option.name not in law]
        alternatives(("network_file",), named, values, given, whole=())
    draws = draws or values["bonds_redrawn"] > 0
    if values.get("detectors_at") is not None:
        alternatives(("detectors_at",), ("detectors",), values, given)
    if values["network_file"] is not None:
        if len(values["network_file"]) > 1 and not several:
            raise InputError("-network_file: several networks are samples of -scene ensemble")
        return
    if values["network_damping"] is not None:
        raise InputError("-network_damping belongs to -network_file; of a lattice -lattice_damping")
    if values["damping_part"] is not None:
        raise InputError("-damping_part belongs to -network_file: bonds of a lattice have one part")
    if values["network_rattlers"] is not None:
        raise InputError("-network_rattlers belongs to -network_file: a lattice has none")
    if values.get("detectors_component") not in ("drive", None):
        raise InputError("-detectors_component: balls of a lattice have one displacement")
    if values.get("detectors_at") is not None:
        raise InputError("-detectors_at: balls of a lattice are named by their indices, -detectors")
    if len(values["lattice_shape"]) > 3:
        raise InputError("-lattice_shape: a lattice has 1 to 3 axes")
    if values["bonds_gravity"] and (draws or values["bonds_law"] != "hertz"):
        why = "a bond that is redrawn would lose its load" if draws else "it needs -bonds_law hertz"
        raise InputError(f"-bonds_gravity: {why}")
    from_file = values["bonds_law"] == "file"
    if from_file and values["bonds_redrawn"]:
        raise InputError("-bonds_redrawn: -bonds_law file is no law to draw new constants from")
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


def make_lattice(options, world):
    """Return the lattice or the network that the options describe, the same on every rank.

    Collective. Raises InputError or FileError if the options or the bonds file are impossible,
    PgranError if the ranks disagree on the bonds.
    """
    medium = (_lattice if options.network_file is None else _network)(options, world)
    if options.bonds_redrawn:
        law = options.bonds_law and make_law(options)
        medium = redrawn(medium, options.bonds_redrawn, options.bonds_redrawn_seed, law)
    medium = with_source(medium, *(getattr(options, option.name) for option in OF_SOURCE))
    if len(set(world.allgather(medium.bonds_sha256))) > 1:
        raise PgranError("the ranks drew different bonds: do they run the same NumPy?")
    return medium


def _network(options, world):
    """Return the network of a file, changed as the options ask. Collective."""
    from pgran.medium.network_file import read_network

    network = on_root(world, lambda: read_network(options.network_file[0]))
    if options.network_rattlers == "remove":
        from pgran.medium.graph import with_rattlers_at_rest

        network = with_rattlers_at_rest(network)
    changes = {"component": getattr(options, "detectors_component", None) or "drive"}
    if network.displacement == "scalar":
        changes["component"] = "drive"
    asked = {"damping": options.network_damping, "damped": options.damping_part} | _laws(options)
    changes |= {name: value for name, value in asked.items() if value is not None}
    return dataclasses.replace(network, **changes)


def _laws(options):
    """Return the laws of damping that options ask for, None where they do not, by their fields."""
    power = options.damping_power
    return {"damping_power": power, "drag": options.damping_mass, "loss": options.damping_loss}


def _lattice(options, world):
    """Return the lattice of a bonds file or of a law. Collective."""
    facts = {name: value or 0.0 for name, value in _laws(options).items()}
    facts |= {"mass": options.lattice_mass, "damping": options.lattice_damping}
    facts |= {"free": options.lattice_free or ()}
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
