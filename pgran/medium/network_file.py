"""Networks on disk: one HDF5 file, `/network`, which h5py writes in five lines as well.

    with h5py.File("mine.h5", "w") as file:
        file["network/bond"] = [[0, 1], [1, 2]]
        file["network/stiffness"] = [1.0, 2.0]
        file["network/held"] = [2, 0, 1]

What is missing has a default or follows from the rest; what is there must be right.
"""

import contextlib
import difflib
import io
import os
import sys
from pathlib import Path

import h5py
import numpy as np

from pgran.arguments import called_right, choice, shown
from pgran.errors import FileError, InputError
from pgran.medium.base import Medium
from pgran.medium.checks import KINDS
from pgran.medium.springs import FREE
from pgran.store import file as store
from pgran.store.paths import check_seal, has_seal, open_regular, whole, writing
from pgran.store.record import Result, Shown

FORMAT, FORMAT_VERSION = "pgran network", 1
# Of each dataset: its type, units, and what it is.
DATASETS = {
    "position": (float, "length", "positions of the balls"),
    "mass": (float, "mass", "masses of the balls"),
    "radius": (float, "length", "radii of the balls"),
    "held": (int, "1", "0: free, 1: at rest, 2: driven"),
    "bond": (int, "1", "the balls of each contact, from 0"),
    "stiffness": (float, "force/length", "stiffness of each contact along its normal"),
    "tangential": (float, "force/length", "stiffness of each contact along its tangents"),
    "normal": (float, "1", "direction from the first ball of each contact to the second"),
    "distance": (float, "length", "distance of the centres of each contact"),
    "force": (float, "force", "repulsive force that each contact bears: the pre-stress"),
    "push": (float, "force", "force on each ball, which drives instead of held balls"),
    "dashpot": (float, "1", "dashpot of each contact as a multiple of damping"),
    "tangential_dashpot": (float, "1", "tangential dashpot as a multiple of damping"),
    "drag": (float, "1/time", "alpha of each ball, on which a force -alpha m v acts"),
    "loss": (float, "1", "loss factor eta of each contact, k (1 + i eta)"),
    "id": (int, "1", "numbers of the balls in the program that they come from"),
}
LISTS = ("direction", "box", "gravity")  # attributes that are more than one number
ATTRIBUTES = (
    "displacement", "damped", "damping", "kmax", "median_mass", "power", "damping_power",
    "damping_reference", *LISTS,
)  # fmt: skip


def write_network(path, members, attributes, overwrite=False):
    """Write a network whole, or leave what was there as it was; raise FileError. For rank 0.

    `members` are named by `DATASETS`, what is None is left out; `attributes` are those of
    `/network`. `overwrite` says that a network that is there may be replaced; nothing else ever
    may.
    """
    path = Path(path)
    check_output(path, overwrite)
    memory = io.BytesIO()
    with h5py.File(memory, "w", libver=store.CHECKED) as file:
        file.attrs.update(format=FORMAT, format_version=FORMAT_VERSION)
        group = file.create_group("network")
        group.attrs.update(attributes)
        for name, value in members.items():
            if value is not None:
                dtype, units, long_name = DATASETS[name]
                texts = np.asarray(value).dtype.kind == "S"
                data = np.asarray(value, dtype=None if texts else dtype)
                # compressed, which helps whole numbers most, and with a checksum
                data = group.create_dataset(name, data=data, compression="gzip", fletcher32=True)
                data.attrs.update(units=units, long_name=long_name)
    with whole(path, lambda: check_output(path, overwrite)) as stream:
        stream.write(memory.getbuffer())


def parts_of(network):
    """Return the members and the attributes of a network, as `write_network` takes them."""
    members = {name: getattr(network, name, None) for name in DATASETS} | {"id": None}
    attributes = {name: getattr(network, name) for name in ATTRIBUTES}
    attributes["damping_power"] = network.damping_power or None
    if network.displacement == "scalar":
        attributes["direction"] = None
    there = {name: value for name, value in attributes.items() if value is not None}
    return members | {"mass": network.masses}, there


def check_output(path, overwrite):
    """Raise a FileError unless a network can be written there."""
    ours = False
    with writing(path):
        if not os.path.lexists(path):
            return
    with contextlib.suppress(FileError), store.opened(path) as file:
        ours = str(file.attributes("/").get("format")) == FORMAT
    if not ours:
        raise FileError(f"{path}: exists and is no network of pgran's: move it away yourself")
    if not overwrite:
        raise FileError(f"{path}: exists already; --overwrite replaces it")


def members_of(file):
    """Return `/network` of a `CarefulFile` as keywords of `Network`."""
    datasets = file.members("network", DATASETS)
    attributes = file.attributes("network", ATTRIBUTES)
    _check_names(file)
    for name in ("bond", "stiffness"):
        if name not in datasets:
            file.refuse(f"network/{name}", "is missing")
    arrays = [name for name in datasets if name != "id"]
    values = {name: file.array(f"network/{name}", DATASETS[name][0]) for name in arrays}
    for name in ATTRIBUTES:
        if name in attributes:
            alone = np.shape(attributes[name]) == (1,) and name not in LISTS
            values[name] = attributes[name][0] if alone else attributes[name]
    of_balls = [values[name] for name in ("held", "mass", "position") if name in values]
    counts = [len(array) for array in of_balls if array.ndim]
    if not counts:
        file.refuse("network", "does not say how many balls there are: it needs position or mass")
    values.setdefault("held", np.full(counts[0], FREE))
    if "mass" in values:
        values["masses"] = values.pop("mass")
    vectors = {"normal", "position"} & values.keys()
    values.setdefault("displacement", "vector" if vectors else "scalar")
    return values


def _check_names(file):
    """Raise where a file has names of a network that are misspelt, elsewhere, or unknown."""
    facts = file.attributes("/")
    newest = {FORMAT: FORMAT_VERSION, store.FORMAT: store.FORMAT_VERSION}
    if "format_version" in facts and (kind := str(facts.get("format", FORMAT))) in newest:
        file.check_version(facts, newest[kind])
    nouns = dict.fromkeys(DATASETS, "dataset") | dict.fromkeys(ATTRIBUTES, "attribute")
    words = [name for name in nouns if name != "id"]  # a common word, of which nothing depends
    own = nouns | dict.fromkeys(("omega_mx", "unknowns"), "attribute")  # those of results
    for group in ("/", "/network"):
        for name, noun, data in file.contents(group):
            if group == "/network" and own.get(name) == noun:
                continue
            near = difflib.get_close_matches(name.lower(), words, 1, 0.8)
            if near:
                meant = f"is the {nouns[near[0]]} {near[0]} of /network meant?"
                file.refuse(f"{group}/{name}", f"is not known; {meant}")
            if group == "/network" and data and name[0] != "_":  # where nobody else has any
                file.refuse(f"{group}/{name}", "is not known; others' data may be in other groups")


def read_network(path, **overrides):
    """Return the network in an HDF5 file: `read_network("packing.h5", damping=0.01)`.

    The file is tried first by a process of its own, because HDF5 can crash on damage. Overrides are
    what `pgran.Network` takes, instead of what the file says. Raises FileError if the file is
    damaged, lacks something or makes no network, InputError if the overrides make none.
    """
    store.try_apart(path, "pgran.medium.network_file")
    with store.opened(path) as file:
        values = members_of(file)
    try:
        with np.errstate(all="ignore"):  # of absurd numbers: what comes of them is checked
            network = _made(values)
    except InputError as error:
        raise FileError(f"{path}: {error}") from None
    return _made(values, **overrides) if overrides else network


def _made(values, **overrides):
    """Return the network of a file; if it is scalar, without the file's direction, of vectors."""
    from pgran.medium.network import Network

    kind = overrides.get("displacement", values["displacement"])
    if choice("network: displacement", kind, KINDS) == "scalar":
        values = {name: value for name, value in values.items() if name != "direction"}
    return Network(**values | overrides)


@called_right
def load(path: str | os.PathLike) -> Result | Medium:
    """Return the result in a file, `load(path).response.omega`, or the lattice or network.

    The structure of the file is checked; its checksum only where that costs nothing, in a small
    file that still has its seal, because HDF5 can crash on damage. Groups that pgran does not know
    are left out.

    Returns
    -------
    pgran.store.record.Result, pgran.Lattice or pgran.Network
        Each group as the record that declares it, and the attributes of the file. A network of
        `pgran import`, or one that other programs wrote, is read by `read_network`; a lattice is
        what its `save` wrote.

    Raises
    ------
    FileError
        If the file is neither, is damaged, or lacks what its records declare.

    Examples
    --------
    >>> import h5py, pgran, tempfile
    >>> path = f"{tempfile.mkdtemp()}/chain.h5"
    >>> with h5py.File(path, "w") as file:
    ...     file["network/bond"] = [[0, 1], [1, 2]]
    ...     file["network/stiffness"], file["network/mass"] = [1.0, 2.0], [1.0, 1.0, 1.0]
    >>> pgran.load(path)
    Network(3 balls, 3 of them free, 2 contacts, scalar, beta 0.003, omega_mx=2)
    """
    open_regular(path, ".h5").close()
    if os.path.getsize(path) <= store.MODEST and has_seal(path):
        check_seal(path)
    with store.opened(path) as file:
        facts = file.attributes("/")
        ours = str(facts.get("format")) == store.FORMAT
        if not ours and not file.members("/", ["network"]):
            raise FileError(f"{path}: neither a result of pgran nor a network")
    found = store.read_result(path) if ours else read_network(path)
    return found.lattice.built if getattr(found, "scene", None) == "lattice" else found


@called_right
def save(thing: Shown, path: str | os.PathLike, overwrite: bool = False) -> None:
    """Write what `load` reads again, bit for bit; `response.save("a.h5")` does the same.

    A record that a function returned becomes a result with its medium, as of `pgran run`. Lattices
    and networks are loaded as such. `overwrite`: a result replaces a result, a network a network;
    what else is there stays, by a FileError. Collective: all ranks call it, rank 0 writes.

    Examples
    --------
    >>> import tempfile
    >>> path, lattice = f"{tempfile.mkdtemp()}/a.h5", pgran.Lattice.random((6, 5))
    >>> pgran.sweep(lattice, [0.3, 0.6], [(2, 3)]).save(path)
    >>> pgran.load(path)
    Result(scene='response', status='complete', lattice, response)
    """
    from pgran.run.agreement import on_root
    from pgran.run.launch import start

    on_root(start().COMM_WORLD, lambda: _write(thing, path, overwrite))


def _write(thing, path, overwrite):
    """Write a result, a record of one, or a medium, on rank 0."""
    if not (isinstance(thing, Shown) and isinstance(path, (str, os.PathLike))):
        raise InputError(f"save: a result or medium, and a path, not {shown(thing)}, {shown(path)}")
    if os.path.lexists(path) and not overwrite:
        raise FileError(f"{path}: exists already; overwrite=True replaces a result or a network")
    thing = getattr(thing, "built", thing)  # of a medium's record the medium
    if not getattr(thing, "is_grid", True):
        return write_network(path, *parts_of(thing), overwrite)
    result = thing.as_result()
    store.write(path, result.attributes, [*result.records.values()], overwrite)


if __name__ == "__main__":
    sys.exit(store.read_within_limits(sys.argv[1], members_of))
