"""Bond constants of an HDF5 file: `python -m pgran.medium.bonds_file FILE` tries one."""

import dataclasses
import sys

import numpy as np

from pgran.errors import FileError, InputError
from pgran.medium.lattice import Lattice
from pgran.medium.record import LatticeRecord
from pgran.store import file as store
from pgran.store.paths import check_seal, has_seal


def read_bonds(path):
    """Return the arrays `/lattice/stiffness_x` and so on, and kmax or None; raise FileError.

    A result that is as it was written is read directly; any other HDF5 file is tried first by a
    process of its own.
    """
    if has_seal(path):
        check_seal(path)
    else:
        store.try_apart(path, "pgran.medium.bonds_file")
    with store.opened(path) as file:
        stiffness, kmax = bonds(file)
    try:
        Lattice(stiffness)
    except InputError as error:
        raise FileError(f"{path}: /lattice/{error}") from None
    return stiffness, kmax


def bonds(file):
    """Return the arrays of a `CarefulFile`, and kmax by its omega_mx, None if unknown."""
    names = [f.name for f in dataclasses.fields(LatticeRecord) if "axes" in f.metadata]
    there = file.members("lattice", names)
    if not there or there != names[: len(there)]:
        file.refuse("lattice", f"needs {names[0]}, and the others of {', '.join(names)} in order")
    stiffness = tuple(file.array(f"lattice/{name}", float) for name in there)
    attributes = file.attributes("lattice")
    mass, unit = (np.asarray(attributes.get(name, np.nan)) for name in ("mass", "omega_mx"))
    if any(value.shape or value.dtype.kind not in "fiu" for value in (mass, unit)):
        return stiffness, None
    with np.errstate(all="ignore"):
        kmax = float(mass * unit.astype(float) ** 2 / (2 * len(stiffness)))
    return stiffness, kmax if 0 < kmax < np.inf else None


if __name__ == "__main__":
    sys.exit(store.read_within_limits(sys.argv[1], bonds))
